//! The checks that move an output or need hands. Each is done after a yes, and a key skips it.

use std::time::Duration;

use dronecan_host::{Message, NodeStatus, Opcode, ParameterRequest, Value};

use crate::check::board::{Board, Plan, bit, codes};
use crate::check::desk::{Answer, Desk, Output};
use crate::check::report::Verdict::{Failed, Passed, Skipped};
use crate::check::store::harmless;
use crate::check::vcd::{self, Pulses};

/// Pulses that are commanded, in microseconds.
const WIDTHS: [i64; 3] = [1000, 1500, 2000];
/// A ceramic resonator is 0.5 % off, and the analyser has 4 MHz.
const WIDTH_LIMIT: f64 = 0.006;
/// The node reads a frame at most so many microseconds after INT has fallen.
const CS_LIMIT_US: f64 = 50.0;
/// Frames of the node in the first second after the plug is in again: messages, and no old ones.
const FRAMES_AFTER_PLUG: usize = 60;
const SECONDS: u64 = 60;

/// All of them.
pub async fn all(desk: &Desk, plan: &Plan, board: &Board) {
    let actuator = board.value("OUT1_ID").unwrap_or(1);
    let others: Vec<String> = desk.state().others.iter().map(ToString::to_string).collect();
    let others = match others.join(", ") {
        text if text.is_empty() => text,
        text => format!(
            " Nodes {text} are on this bus: what follows actuator {actuator} there moves, too."
        ),
    };
    let question = format!(
        "The next checks move output 1 (actuator {actuator}), and some need your hands: five \
         minutes.{others} Take propellers off. Go on?"
    );
    let reason = if desk.state().commander.is_some() {
        "another node commands outputs"
    } else if board.value("OUT1_TYPE").unwrap_or(0) != 0 || board.value("ARM_REQ") == Some(1) {
        "output 1 is no servo, or ARM_REQ is 1: it moves only while armed"
    } else if !desk.is_allowed(question).await {
        "not wanted"
    } else {
        ""
    };
    if !reason.is_empty() {
        return desk.skip("Servo, failsafe, plug and supply", reason);
    }
    servo(desk, plan, board, actuator as u8).await;
    same_id(desk).await;
    if desk.state().others.is_empty() {
        other_rate(desk, plan).await;
    }
    plug(desk).await;
    for (what, result) in [
        ("Supply cut in a SAVE", cut(desk, board).await),
        ("Supply of the MCP2515", chip_supply(desk).await),
    ] {
        if let Err(why) = result {
            desk.check(what, "the node works again", why, false);
        }
    }
}

/// The pulses, and the failsafe when commands stop.
async fn servo(desk: &Desk, plan: &Plan, board: &Board, actuator: u8) {
    let limits = [board.value("OUT1_MIN"), board.value("OUT1_MAX")].map(|end| end.unwrap_or(1500));
    for width in WIDTHS {
        let width = width.clamp(limits[0].min(limits[1]), limits[0].max(limits[1]));
        desk.state_mut().command = Some((actuator, width as f32));
        desk.pause(Duration::from_secs(1)).await;
        let expected = format!("output 1 follows {width} us");
        if plan.has_analyser {
            analysed(desk, width as f64).await;
            continue;
        }
        let question =
            format!("Is the servo where {width} us has it ({} of its travel)?", place(width));
        let (seen, verdict) = match desk.question(question).await {
            Answer::Yes => ("it does", Passed),
            Answer::No => (
                "it does not: is it on the pin of output 1? With CS on D10 that is D9, else D10",
                Failed,
            ),
            Answer::Skip => ("", Skipped),
        };
        desk.row("Servo", expected, seen, verdict);
    }
    let stopped = desk.now();
    desk.state_mut().command = None;
    let timeout = board.value("OUT1_TIMEOUT").unwrap_or(0) as u64;
    if timeout == 0 {
        return desk.skip("Failsafe", "OUT1_TIMEOUT is 0");
    }
    let seen = desk.code(bit::FAILSAFE, stopped, timeout + 2000).await;
    desk.check(
        "Failsafe",
        format!("reported {timeout} ms after the last command, and a second"),
        seen.map_or("not reported".into(), |at| format!("{} ms", (at - stopped).as_millis())),
        seen.is_some(),
    );
}

fn place(width: i64) -> &'static str {
    match width {
        ..1400 => "one end",
        1400..=1600 => "the middle",
        _ => "the other end",
    }
}

async fn analysed(desk: &Desk, width: f64) {
    desk.state_mut().recording = None;
    desk.output(Output::Record);
    let recording =
        desk.wait(desk.now() + Duration::from_secs(30), |state| state.recording.take()).await;
    let measured = match recording.unwrap_or(Err("the analyser has not answered".into())) {
        Ok(text) => vcd::measure(&text),
        Err(why) => Err(why),
    };
    let expected = format!("{width} us each 20 ms, within 0.5 %");
    let (pulses, latency) = match measured {
        Ok(measured) => measured,
        Err(why) => return desk.check("Servo", expected, why, false),
    };
    match pulses {
        Some(Pulses { width_us, period_ms, jitter_us }) => desk.check(
            "Servo",
            expected,
            format!("{width_us:.1} us each {period_ms:.2} ms, jitter {jitter_us:.1} us"),
            (width_us / width - 1.0).abs() < WIDTH_LIMIT && jitter_us < 5.0,
        ),
        None => desk.check(
            "Servo",
            expected,
            "no pulse at D0 of the analyser: the pin of output 1?",
            false,
        ),
    }
    if let Some(latency) = latency {
        desk.check(
            "INT to CS",
            format!("{CS_LIMIT_US} us at most"),
            format!("{latency:.1} us at most"),
            latency <= CS_LIMIT_US,
        );
    }
}

/// This program sends a status with the ID of the node.
async fn same_id(desk: &Desk) {
    let (since, node) = (desk.now(), desk.state().node);
    desk.broadcast(&Message::NodeStatus(NodeStatus::default()), node);
    let seen = desk.code(bit::SAME_ID, since, 2500).await;
    desk.check(
        "Two nodes with one ID",
        "reported in two seconds",
        seen.map_or("not reported".into(), |at| format!("{} ms", (at - since).as_millis())),
        seen.is_some(),
    );
}

/// The adapter sends with half the bit rate.
async fn other_rate(desk: &Desk, plan: &Plan) {
    let since = desk.now();
    desk.output(Output::BitRate(plan.bit_rate / 2));
    desk.pause(Duration::from_secs(3)).await;
    desk.output(Output::BitRate(plan.bit_rate));
    desk.pause(Duration::from_secs(4)).await;
    let state = desk.state();
    let line = ["another bit rate", "error-passive", "bus-off"]
        .iter()
        .find_map(|text| state.line_with(since, text));
    let is_back =
        state.statuses.last().is_some_and(|status| status.at + Duration::from_secs(2) > state.now);
    let has_seen = line.is_some() || codes(&state, since) & (bit::PASSIVE | bit::CONTROLLER) != 0;
    drop(state);
    let expected = "the node notices it, and is back in two seconds";
    match (has_seen, is_back) {
        (_, false) => desk.check("Another bit rate", expected, "it is not back", false),
        (true, true) => {
            desk.check("Another bit rate", expected, line.unwrap_or("noticed".into()), true)
        }
        (false, true) => {
            desk.skip("Another bit rate", "nothing noticed: the adapter may not have that rate")
        }
    }
}

async fn plug(desk: &Desk) {
    let begin = desk.now();
    let mut gone = None;
    let back = desk
        .hands(
            "Pull the bus plug of the node, and put it back after ten seconds",
            SECONDS,
            |state| {
                let last = *state.frames.last()?;
                if state.now > last + Duration::from_secs(5) {
                    gone = Some(last);
                }
                gone.filter(|gone| last > *gone).map(|_| last)
            },
        )
        .await;
    let Some(back) = back else { return desk.skip("Bus plug", "not done") };
    desk.pause(Duration::from_secs(2)).await;
    let state = desk.state();
    let second = back..back + Duration::from_secs(1);
    let frames = state.frames.iter().filter(|at| second.contains(at)).count();
    let has_noticed = codes(&state, begin) & (bit::PASSIVE | bit::CONTROLLER) != 0;
    drop(state);
    desk.check(
        "Bus plug",
        "error-passive in the status, and no burst of old messages",
        format!(
            "{}reported, {frames} frames in the first second",
            if has_noticed { "" } else { "not " }
        ),
        has_noticed && frames < FRAMES_AFTER_PLUG,
    );
}

async fn cut(desk: &Desk, board: &Board) -> Result<(), String> {
    let Some((name, value, other)) = harmless(board) else { return Ok(()) };
    desk.change(name, other).await?;
    desk.state_mut().is_saved = true;
    desk.output(Output::ClosePort);
    let begin = desk.now();
    let (mut next, mut saves, mut last) = (begin, 0, 0);
    let task =
        "Switch the board's supply off, also that of the USB cable, and on again: it saves now";
    let started = desk
        .hands(task, SECONDS, |state| {
            if state.now >= next {
                next = state.now + Duration::from_millis(100);
                saves += 1;
                let value = Value::Integer(if saves % 2 == 0 { value } else { other });
                let set = ParameterRequest { index: 0, value, name: name.into() };
                let node = state.node;
                state.tool.request(&Message::ParameterRequest(set), node);
                state.tool.request(&Message::ExecuteOpcode(Opcode::SAVE), node);
            }
            let uptime = state.statuses.last().filter(|status| status.at > begin)?.what.uptime_s;
            let has_restarted = uptime < last;
            last = uptime;
            has_restarted.then_some(state.now)
        })
        .await;
    let Some(started) = started else {
        desk.put_back().await?;
        desk.skip("Supply cut in a SAVE", "not done");
        return Ok(());
    };
    desk.pause(Duration::from_secs(3)).await;
    let kept = desk.get(name).await?;
    let is_lost = codes(&desk.state(), started) & bit::PARAMETERS != 0;
    desk.put_back().await?;
    desk.check(
        "Supply cut in a SAVE",
        format!("{name} {value} or {other}, and no parameters lost"),
        format!("{kept}{}", if is_lost { ", parameters lost" } else { "" }),
        !is_lost && [value, other].contains(&kept),
    );
    Ok(())
}

async fn chip_supply(desk: &Desk) -> Result<(), String> {
    let begin = desk.now();
    let seen = desk
        .hands(
            "Interrupt the supply of the CAN board for a second, not that of the Arduino",
            SECONDS,
            |state| (codes(state, begin) & bit::CONTROLLER != 0).then_some(()),
        )
        .await;
    if seen.is_none() {
        desk.skip("Supply of the MCP2515", "not done");
        return Ok(());
    }
    desk.ask(&Message::NodeInfoRequest).await?;
    desk.check("Supply of the MCP2515", "reported, and the node is back", "it is", true);
    Ok(())
}
