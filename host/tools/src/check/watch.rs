//! Bursts of frames, and then what the node counts and reports for a while.

use std::time::Duration;

use dronecan_host::{ActuatorCommand, CommandUnit, Message, ParameterRequest, TransportStats};
use half::f16;

use crate::check::board::{BUS_ADVICE, Board, Plan, bit, codes};
use crate::check::desk::{Desk, Heard, Output};
use crate::check::measure::{clock_error_percent, deviation};

const CLOCK: Duration = Duration::from_secs(20);
/// The ceramic resonator of an Uno is up to 0.5 % off; the computer's clock and the arrival of the
/// frames add 0.1 %.
const CLOCK_LIMIT_PERCENT: f64 = 0.6;
/// Commands of a burst, and the frames of each: 15 actuators.
const BURST: u32 = 200;
const BURST_FRAMES: u32 = 9;
/// Frames of a request that reads a parameter with a name of 11 characters.
const REQUEST_FRAMES: u32 = 3;
/// Frames that wait for the adapter at most: never so many that it drops one.
const WAITING_MAX: usize = 60;
/// Deviation of the temperature with a quiet ADC, in degrees.
const NOISE_LIMIT: f64 = 0.35;

async fn stats(desk: &Desk, board: &Board) -> Result<Option<TransportStats>, String> {
    if !board.parameters.contains_key("STATS_RATE") {
        return Ok(None);
    }
    match desk.ask(&Message::TransportStatsRequest).await?.what {
        Message::TransportStats(stats) => Ok(Some(stats)),
        other => Err(format!("an unexpected response: {other}")),
    }
}

/// The counters of the serial monitor: overruns.
async fn overruns(desk: &Desk, board: &Board) -> Option<u32> {
    if !board.has_port || !board.has_monitor() {
        return None;
    }
    let since = desk.now();
    desk.output(Output::Serial(b"?".to_vec()));
    let line = desk
        .wait(since + Duration::from_secs(1), |state| state.line_with(since, "overruns "))
        .await?;
    let (_, count) = line.split_once("overruns ")?;
    count.split(',').next()?.parse().ok()
}

/// Sends bursts, and then observes the node: counters of errors, conditions, clock, noise.
pub async fn bursts_and_watch(desk: &Desk, plan: &Plan, board: &Board) -> Result<(), String> {
    let began = desk.now();
    desk.adapter_errors().await;
    let before = stats(desk, board).await?;
    let overruns_before = overruns(desk, board).await;
    let (sent, seconds) = bursts(desk, board).await?;
    let after = stats(desk, board).await?;
    let lost = overruns(desk, board).await.zip(overruns_before).map(|(b, a)| b.wrapping_sub(a));
    desk.pause(Duration::from_millis(1200)).await;
    let lost_bits = codes(&desk.state(), began) & (bit::LOST | bit::BROKEN) != 0;
    // The rest of the difference are the requests between.
    let received = before.as_ref().zip(after.as_ref()).and_then(|(before, after)| {
        Some(after.interfaces.first()?[1].wrapping_sub(before.interfaces.first()?[1]) as u32)
    });
    let missing = received.map(|received| u64::from(sent).saturating_sub(u64::from(received)));
    let broken =
        if lost_bits { ", frames lost or transfers broken, says the status code" } else { "" };
    let seen = match (missing, lost) {
        (Some(missing), _) => format!("{missing} of {sent}"),
        (None, Some(lost)) => format!("{sent} sent, {lost} overruns on the serial monitor"),
        (None, None) => {
            format!("{sent} sent; the preset has no counters")
        }
    };
    desk.check(
        "Frames lost",
        "none",
        format!("{seen}{broken}; {:.0} frames a second", f64::from(sent) / seconds),
        !lost_bits && missing.unwrap_or(0) == 0 && lost.unwrap_or(0) == 0,
    );
    watch(desk, plan, board, began, before).await
}

/// Sends commands as fast as the adapter can. They are for actuators that the node does not have,
/// so nothing moves; beside other nodes they are requests to this node.
async fn bursts(desk: &Desk, board: &Board) -> Result<(u32, f64), String> {
    let began = desk.now();
    let is_alone = desk.state().others.is_empty();
    let own = desk.state().tool.id().ok_or("no node ID")?;
    let used: Vec<i64> = (1..=8).filter_map(|n| board.value(&format!("OUT{n}_ID"))).collect();
    let free = (0..=255u8).rev().find(|id| !used.contains(&i64::from(*id))).unwrap_or(255);
    let command = ActuatorCommand { actuator: free, unit: CommandUnit::Unitless, value: f16::ZERO };
    let read = ParameterRequest { name: b"OUT1_FS_PWM".to_vec(), ..ParameterRequest::default() };
    let mut sent = 0;
    for _ in 0..BURST {
        desk.wait(Duration::MAX, |state| {
            (state.waiting + state.out.len() < WAITING_MAX).then_some(())
        })
        .await;
        if is_alone {
            desk.broadcast(&Message::ArrayCommand(vec![command; 15]), own);
            sent += BURST_FRAMES;
        } else {
            let mut state = desk.state_mut();
            let node = state.node;
            state.tool.request(&Message::ParameterRequest(read.clone()), node);
            sent += REQUEST_FRAMES;
        }
    }
    // The response shows that the node has all of them.
    desk.ask(&Message::NodeInfoRequest).await?;
    let seconds = (desk.now() - began).as_secs_f64();
    desk.pause(Duration::from_millis(300)).await;
    Ok((sent, seconds))
}

async fn watch(
    desk: &Desk,
    plan: &Plan,
    board: &Board,
    began: Duration,
    before: Option<TransportStats>,
) -> Result<(), String> {
    desk.note(format!("observes the node for {} s", plan.watch.as_secs()));
    let begin = desk.now();
    let temperature_rate = match board.value("TEMP_RATE") {
        Some(rate) if !desk.state().temperatures.is_empty() => {
            desk.change("TEMP_RATE", 10.max(rate)).await?;
            10.max(rate)
        }
        _ => 0,
    };
    // First with requests, for the counters of errors.
    let quiet = begin + plan.watch.saturating_sub(CLOCK);
    let (mut asked, mut unanswered) = (0, 0);
    while desk.now() < quiet {
        asked += 1;
        unanswered += u32::from(desk.ask(&Message::NodeInfoRequest).await.is_err());
        desk.pause(Duration::from_millis(20)).await;
    }
    // Then without a NodeStatus of this program, which the node's would follow.
    desk.state_mut().is_silent = true;
    let silent = desk.now();
    desk.pause(CLOCK).await;
    desk.state_mut().is_silent = false;
    clock(desk, silent, temperature_rate);
    noise(desk, silent, temperature_rate);
    let after = stats(desk, board).await.unwrap_or_else(|_| {
        unanswered += 1;
        None
    });
    let by_adapter = desk.adapter_errors().await;
    let errors = before.zip(after).and_then(|(before, after)| {
        Some(after.interfaces.first()?[2].wrapping_sub(before.interfaces.first()?[2]) as u32)
    });
    let mut seen = vec![match errors {
        Some(count) => format!("{count} errors"),
        None => "the node has no counters".into(),
    }];
    seen.push(match by_adapter {
        Some(true) => "the adapter has seen errors".into(),
        Some(false) => "the adapter none".into(),
        None => "the adapter does not say".into(),
    });
    let codes = codes(&desk.state(), began);
    let states = [(bit::PASSIVE, "error-passive"), (bit::BUS_OFF, "bus-off")];
    let states = states.iter().filter(|(bit, _)| codes & bit != 0);
    let mut has_failed = errors.unwrap_or(0) > 0 || by_adapter == Some(true) || unanswered > 0;
    for (_, state) in states {
        has_failed = true;
        seen.push((*state).into());
    }
    if unanswered > 0 {
        seen.push(format!("{unanswered} of {asked} requests unanswered"));
    }
    if has_failed {
        seen.push(BUS_ADVICE.into());
    }
    let time = (desk.now() - began).as_secs();
    desk.check("Bus errors", format!("none in {time} s"), seen.join(", "), !has_failed);
    conditions(desk, began);
    if temperature_rate != 0 {
        desk.put_back().await?;
    }
    Ok(())
}

fn clock(desk: &Desk, since: Duration, temperature_rate: i64) {
    let state = desk.state();
    // The first second may have a status that followed one of this program.
    let since = since + Duration::from_secs(1);
    let (what, times, period) = if state.others.is_empty() {
        ("NodeStatus", after(&state.statuses, since), 1.0)
    } else {
        ("Temperature", after(&state.temperatures, since), 1.0 / temperature_rate.max(1) as f64)
    };
    let has_stamps = state.has_stamps();
    drop(state);
    let expected = "within 0.5 % (ceramic resonator)";
    match clock_error_percent(&times, period) {
        Some(error) => desk.check(
            "Processor clock",
            expected,
            format!(
                "{error:+.2} %, {} {what} in {} s by the clock of {}",
                times.len(),
                CLOCK.as_secs() - 1,
                if has_stamps { "the adapter" } else { "this computer" }
            ),
            error.abs() <= CLOCK_LIMIT_PERCENT,
        ),
        None => desk.skip(
            "Processor clock",
            "too few messages of the node's own pace: its status follows that of another node",
        ),
    }
}

/// Times by the adapter's clock.
fn after<T>(all: &[Heard<T>], since: Duration) -> Vec<Duration> {
    all.iter().filter(|heard| heard.at >= since).map(|heard| heard.by_adapter).collect()
}

fn noise(desk: &Desk, since: Duration, temperature_rate: i64) {
    let state = desk.state();
    let values: Vec<f64> = state
        .temperatures
        .iter()
        .filter(|temperature| temperature.at >= since)
        .map(|temperature| f64::from(temperature.what))
        .collect();
    drop(state);
    if temperature_rate == 0 || values.len() < 10 {
        return desk.skip("Noise of the ADC", "no temperature sensor");
    }
    let deviation = deviation(&values);
    desk.check(
        "Noise of the ADC",
        format!("deviation below {NOISE_LIMIT} degrees at a steady temperature"),
        format!("{deviation:.2} degrees in {} values", values.len()),
        deviation < NOISE_LIMIT,
    );
}

/// The rest of the status code: supply, wires and EEPROM.
fn conditions(desk: &Desk, since: Duration) {
    let state = desk.state();
    let codes = codes(&state, since);
    let is_at_end = state.status().is_some_and(|status| status.vendor_code & bit::CONTROLLER != 0);
    let int = state.line_with(Duration::ZERO, "INT open or shorted");
    let lost =
        state.line_with(since, "MCP2515 settings lost").or(state.line_with(since, "SI SO SCK"));
    drop(state);
    // The node notices a wrong INT once, and a chip that restarts each time.
    let passes = codes & bit::CONTROLLER != 0 && !is_at_end;
    let is_int_wrong = int.is_some() || (passes && lost.is_none());
    let is_chip_lost = lost.is_some() || is_at_end;
    desk.check(
        "INT",
        "wired",
        match &int {
            Some(line) => format!("\"{line}\": the wire of INT"),
            None if is_int_wrong => {
                "the node restarted the MCP2515 once: look at the wire of INT".into()
            }
            None => "works".into(),
        },
        !is_int_wrong,
    );
    desk.check(
        "MCP2515",
        "keeps its registers",
        match &lost {
            Some(line) => format!("\"{line}\": the supply of the CAN board"),
            None if is_chip_lost => {
                "the node restarts it again and again: the supply of the CAN board".into()
            }
            None => "keeps them".into(),
        },
        !is_chip_lost,
    );
    let others = [
        (
            bit::RESET,
            "Restarts",
            "none by a fault",
            "a fault restarted the program: docs/status.md",
        ),
        (bit::SAME_ID, "Node ID", "of one node", "two nodes have it"),
        (bit::PARAMETERS, "Parameters in the EEPROM", "valid", "were lost: set and save them"),
    ];
    for (bit, what, expected, seen) in others {
        let is_set = codes & bit != 0;
        let seen =
            if is_set { format!("code {:#06X}: {seen}", codes & bit) } else { expected.into() };
        desk.check(what, expected, seen, !is_set);
    }
}
