//! The checks that need no hands. docs/hardware.md has their list.

use std::collections::BTreeMap;
use std::rc::Rc;
use std::time::Duration;

use dronecan_host::text::hex;
use dronecan_host::{
    ActuatorCommand, CommandUnit, Message, Mode, NodeInfo, NodeStatus, ParameterRequest,
    ParameterResponse, RESTART_MAGIC, TransportStats, Value,
};
use half::f16;
use node_update::file::FirmwareFile;
use node_update::session::{Outcome, Session as Update};

use crate::desk::{Desk, Heard, Output, State};
use crate::measure::{clock_error_percent, deviation, median, quick};
use crate::report::Verdict::{Failed, Skipped};
use crate::session::Plan;

/// Each node sends NodeStatus once a second; a bootloader that hears nothing waits for three.
const LISTEN: Duration = Duration::from_secs(5);
/// A board that the serial port has reset runs in this time, also behind a bootloader that waits
/// for an upload first, and with a first start that makes the unique ID.
const BOOT: Duration = Duration::from_secs(6);
/// From the request of a restart to the first status. The node waits for 100 ms, and a loader
/// checks its program for 0.2 s.
const RESTART_MS: u64 = 1000;
const CLOCK: Duration = Duration::from_secs(20);
/// The ceramic resonator of an Uno is up to 0.5 % off; the computer's clock and the arrival of the
/// frames add 0.1 %.
const CLOCK_LIMIT_PERCENT: f64 = 0.6;
const SAVES: usize = 6;
/// A byte of EEPROM takes 3.4 ms (DS40002061B 8.4) by an RC oscillator that is up to 10 % off. The
/// node looks once a millisecond whether it is written.
const EEPROM_MS: f64 = 3.4;
const EEPROM_LIMITS_MS: std::ops::RangeInclusive<f64> = 2.8..=4.6;
/// Commands of a burst, and the frames of each: 15 actuators.
const BURST: u32 = 200;
const BURST_FRAMES: u32 = 9;
/// Frames of a request that reads a parameter with a name of 11 characters.
const REQUEST_FRAMES: u32 = 3;
/// Frames that wait for the adapter at most: never so many that it drops one.
const WAITING_MAX: usize = 60;
/// Deviation of the temperature with a quiet ADC, in degrees.
const NOISE_LIMIT: f64 = 0.35;
/// Pages of the flash are erased and written in 3.7 to 4.5 ms each (DS40002061B 31.8).
const PAGE_LIMIT_MS: f64 = 12.0;
/// Bits of the vendor-specific status code (docs/status.md).
mod bit {
    pub const RESET: u16 = 7;
    pub const BROKEN: u16 = 1 << 3;
    pub const SAME_ID: u16 = 1 << 4;
    pub const LOST: u16 = 1 << 5;
    pub const PASSIVE: u16 = 1 << 6;
    pub const BUS_OFF: u16 = 1 << 7;
    pub const CONTROLLER: u16 = 1 << 8;
    pub const PARAMETERS: u16 = 1 << 13;
}
/// This bit of the major hardware version says that the node takes no updates (docs/update.md).
const TAKES_NO_UPDATES: u8 = 0x80;
const BUS_ADVICE: &str = "look at 120 ohms at both ends, CAN high and low, a common ground";
const BANNER: &str = "DroneCAN servo node ";
const NAME: &str = "org.dronecan.servo";
/// This project's version.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// What is known of the board.
pub struct Board {
    pub info: NodeInfo,
    pub parameters: BTreeMap<String, ParameterResponse>,
    /// Median time of a request and its response.
    round_trip: Duration,
    has_port: bool,
}

impl Board {
    /// The value of a parameter, if the node has it.
    pub fn value(&self, name: &str) -> Option<i64> {
        match self.parameters.get(name)?.value {
            Value::Integer(value) => Some(value),
            _ => None,
        }
    }

    /// True if the program prints lines on the serial port: all but the preset `remote`.
    fn has_monitor(&self) -> bool {
        let has = |name: &str| self.parameters.contains_key(name);
        let is_remote = has("STATS_RATE") && has("SAFE_MODE") && !has("OUT_COUNT");
        !is_remote
    }
}

/// All checks.
pub async fn all(desk: Desk, plan: Plan) {
    until_silence(&desk, &plan).await;
    // The reason, if the node no longer answers.
    let is_known = desk.state().report.rows.iter().any(|row| row.what == "Bus errors");
    if !is_known && desk.adapter_errors().await == Some(true) {
        desk.check(
            "Bus errors",
            "none",
            format!("the adapter has seen errors, {BUS_ADVICE}"),
            false,
        );
    }
}

async fn until_silence(desk: &Desk, plan: &Plan) {
    let Some(mut board) = find(desk, plan).await else { return };
    if !desk.state().changed.is_empty() {
        desk.note("puts back what an earlier run has changed");
        if let Err(why) = desk.put_back().await {
            return desk.check("Put back", "what an earlier run has changed", why, false);
        }
    }
    if let Err(why) = read_parameters(desk, plan, &mut board).await {
        return desk.check("Parameters", "all are read", why, false);
    }
    if let Err(why) = round_trip(desk, &mut board).await {
        desk.check("Requests", "each is answered", why, false);
    }
    if let Err(why) = save_and_restart(desk, &board).await {
        desk.check("Save and restart", "the value that was set", why, false);
    }
    if let Err(why) = bursts_and_watch(desk, plan, &board).await {
        desk.check("On the bus", "the node responds", why, false);
    }
    if let Err(why) = update(desk, plan, &board).await {
        desk.check("Update", "the same program", why, false);
    }
}

/// Listens, opens the port, and asks the node who it is. `None` if it does not say.
async fn find(desk: &Desk, plan: &Plan) -> Option<Board> {
    let node = plan.node;
    desk.note(format!("listens for {} s, and sends nothing", LISTEN.as_secs()));
    desk.pause(LISTEN).await;
    // Opening the port resets the board, and so does a later check.
    let commander = desk.state().commander;
    if let Some(by) = commander
        && !desk
            .is_allowed(format!(
                "Node {by} commands outputs. The checks restart node {node}, which ends its pulses \
                 until the next command. May they?"
            ))
            .await
    {
        desk.row("Vehicle", "no commands", format!("node {by} sends commands"), Skipped);
        return None;
    }
    let opened = desk.now();
    if plan.has_port {
        desk.note("opens the serial port, which resets the board");
        desk.output(Output::OpenPort);
        desk.wait(opened + BOOT, |state| {
            state.line_with(opened, BANNER)?;
            state.statuses.iter().rfind(|status| status.at >= opened).map(drop)
        })
        .await;
    }
    // A node that hears only errors sends nothing, and says why once it has heard frames.
    let has_errors = desk.adapter_errors().await == Some(true);
    if desk.state().statuses.is_empty() && desk.state().others.is_empty() {
        let _ = desk.state_mut().tool.take_id(None, None);
        desk.state_mut().is_silent = false;
        desk.pause(LISTEN).await;
    }
    let status = desk.state().status();
    let Some(status) = status else {
        silent(desk, plan, opened, has_errors);
        return None;
    };
    let mode = if status.mode == Mode::Maintenance { "the bootloader waits" } else { "" };
    desk.check(
        "On the bus",
        format!("node {node} at {} bit/s, OPERATIONAL", plan.bit_rate),
        match mode {
            "" => status.to_string(),
            mode => format!("{status}: {mode} for a program. \"make update\" sends one"),
        },
        matches!(status.mode, Mode::Operational | Mode::Initialization),
    );
    if let Err(why) = desk.state_mut().tool.take_id(None, None) {
        desk.check("On the bus", "a free node ID", why.to_string(), false);
        return None;
    }
    desk.state_mut().is_silent = false;
    let info = match info(desk).await {
        Ok(info) => info,
        Err(why) => {
            desk.check("Program", "GetNodeInfo is answered", why, false);
            return None;
        }
    };
    let expected: Vec<u8> = VERSION.split('.').filter_map(|part| part.parse().ok()).collect();
    let is_ours = info.name().starts_with(NAME);
    desk.check(
        "Program",
        format!("{NAME}.. {}.{}", expected[0], expected[1]),
        if is_ours {
            info.to_string()
        } else {
            format!("{info}: not a program of this project, so nothing is changed")
        },
        is_ours && [info.software.0, info.software.1] == expected[..2],
    );
    let board = Board {
        info,
        parameters: BTreeMap::new(),
        round_trip: Duration::ZERO,
        has_port: plan.has_port,
    };
    is_ours.then_some(board)
}

async fn info(desk: &Desk) -> Result<NodeInfo, String> {
    match desk.ask(&Message::NodeInfoRequest).await?.what {
        Message::NodeInfo(info) => Ok(*info),
        other => Err(format!("an unexpected response: {other}")),
    }
}

/// What a board says on the serial port that does not work, and what to do.
const TROUBLES: [(&str, &str, &str); 6] = [
    (
        "another bit rate or crystal",
        "Crystal of the MCP2515",
        "the program is for another crystal than the one on the board: read its stamp",
    ),
    ("SI SO SCK", "MCP2515", "the program does not find the MCP2515: compare the wires"),
    ("never idle", "Bus errors", "CAN high is shorted, or another node holds the bus"),
    ("not sent", "Bus errors", "nobody acknowledges: CAN high and low, and 120 ohms at both ends"),
    ("bus-off", "Bus errors", "CAN high and low are open, shorted or exchanged"),
    ("error-passive", "Bus errors", "CAN high and low, and 120 ohms at both ends"),
];

/// Says why the node is not on the bus, as far as that is known.
fn silent(desk: &Desk, plan: &Plan, opened: Duration, has_errors: bool) {
    let (others, lines, bytes) = {
        let state = desk.state();
        let others: Vec<String> = state.others.iter().map(ToString::to_string).collect();
        let lines: Vec<_> =
            TROUBLES.iter().filter_map(|(text, ..)| state.line_with(opened, text)).collect();
        (others.join(", "), lines, state.serial_bytes)
    };
    let heard = if others.is_empty() { "nobody".into() } else { format!("only node {others}") };
    desk.check(
        "On the bus",
        format!("node {} at {} bit/s", plan.node, plan.bit_rate),
        format!(
            "{heard} in {} s. Look at the wires, at the bit rate (--bitrate), and at the node's ID",
            (desk.now().as_secs())
        ),
        false,
    );
    // The first one is the reason of the others.
    let first = TROUBLES.iter().find_map(|(text, what, advice)| {
        lines.iter().find(|line| line.contains(text)).map(|line| (what, advice, line))
    });
    if let Some((what, advice, line)) = first {
        desk.check(what, "no fault", format!("\"{line}\": {advice}"), false);
    }
    if !lines.iter().any(|line| line.contains(TROUBLES[0].0)) {
        let half = plan.bit_rate / 2;
        let advice = format!(
            "with 8 MHz and a program for 16 MHz the node has half the rate: try --bitrate {half}"
        );
        let (seen, verdict) = match has_errors {
            true => ("the adapter sees errors and no frame: somebody has another bit rate", Failed),
            false => ("not known", Skipped),
        };
        desk.row(
            "Crystal of the MCP2515",
            "the one of the program",
            format!("{seen}; {advice}"),
            verdict,
        );
    }
    if plan.has_port {
        let seen = if bytes == 0 { "nothing" } else { "no line that begins with this" };
        let line = desk.state().line_with(opened, BANNER);
        desk.check(
            "Boot line",
            BANNER,
            line.clone().unwrap_or(format!("{seen}: is it the port of this board?")),
            line.is_some(),
        );
    }
}

async fn read_parameters(desk: &Desk, plan: &Plan, board: &mut Board) -> Result<(), String> {
    let mut wrong = Vec::new();
    for index in 0..u16::MAX {
        let parameter = desk.parameter_at(index).await?;
        if parameter.name.is_empty() {
            break;
        }
        if let (Value::Integer(value), Value::Integer(min), Value::Integer(max)) =
            (&parameter.value, &parameter.min, &parameter.max)
            && !(min..=max).contains(&value)
        {
            wrong.push(parameter.name());
        }
        board.parameters.insert(parameter.name(), parameter);
    }
    let count = board.parameters.len();
    desk.check(
        "Parameters",
        "all are read, each in its range",
        format!("{count}{}", wrong.iter().map(|name| format!(", {name} out")).collect::<String>()),
        count > 0 && wrong.is_empty(),
    );
    if let Some(rate) = board.value("CAN_BAUDRATE").filter(|rate| *rate != 0) {
        desk.check(
            "Crystal of the MCP2515",
            format!("CAN_BAUDRATE {rate} is the rate of the bus"),
            if rate == i64::from(plan.bit_rate) {
                format!("{rate} bit/s")
            } else {
                format!(
                    "{} bit/s: the program is for another crystal than the one on the board, or \
                     CAN_BAUDRATE is for the next restart",
                    plan.bit_rate
                )
            },
            rate == i64::from(plan.bit_rate),
        );
    }
    if board.has_port {
        boot_line(desk, board, plan);
    }
    Ok(())
}

fn boot_line(desk: &Desk, board: &Board, plan: &Plan) {
    let (line, bytes) = {
        let state = desk.state();
        (state.line_with(Duration::ZERO, BANNER), state.serial_bytes)
    };
    let expected = format!("{BANNER}.., node ID {}, reset: reset pin", plan.node);
    match line {
        Some(line) => {
            let is_board = line.contains(&format!("node ID {},", plan.node));
            let is_usual =
                ["reset: reset pin", "reset: power-on"].iter().any(|cause| line.ends_with(cause));
            let advice = if is_board { "" } else { ": this is the port of another board" };
            desk.check("Boot line", expected, format!("{line}{advice}"), is_board && is_usual);
        }
        None if !board.has_monitor() => {
            desk.skip("Boot line", "the preset \"remote\" prints nothing");
        }
        None => {
            let seen = match bytes {
                0 => "nothing: is it the port of this board, and does a wire hold D0 or D1?",
                _ => "signs that are no text: the processor has another clock, or D1 a wire",
            };
            desk.check("Boot line", expected, seen, false);
        }
    }
}

async fn round_trip(desk: &Desk, board: &mut Board) -> Result<(), String> {
    let mut times = Vec::new();
    for _ in 0..100 {
        let sent = desk.now();
        times.push(desk.ask(&Message::NodeInfoRequest).await?.at - sent);
    }
    times.sort();
    board.round_trip = median(&times);
    let ms = |time: Duration| format!("{:.1} ms", time.as_secs_f64() * 1e3);
    desk.check(
        "Requests",
        "100 of 100 answered; 3 ms, and the adapter's own time",
        format!("median {}, longest {}", ms(board.round_trip), ms(times[times.len() - 1])),
        board.round_trip < Duration::from_millis(50),
    );
    Ok(())
}

/// A parameter whose value has no effect now, and another value of it that differs in both bytes.
fn harmless(board: &Board) -> Option<(&'static str, i64, i64)> {
    let is_used = board.value("OUT1_FS") == Some(2);
    let name = ["OUT1_FS_PWM", "TEMP_ID"][usize::from(is_used)];
    let value = board.value(name)?;
    let max = match board.parameters[name].max {
        Value::Integer(max) => max,
        _ => return None,
    };
    Some((name, value, if value + 257 <= max { value + 257 } else { value - 257 }))
}

async fn save_and_restart(desk: &Desk, board: &Board) -> Result<(), String> {
    let Some((name, value, other)) = harmless(board) else {
        desk.skip("Save and restart", "the program has no parameter for it");
        return Ok(());
    };
    desk.note(format!("sets {name} from {value} to {other}, saves it, restarts, and puts it back"));
    // What a SAVE takes without a changed byte: it compares all of them.
    let (mut empty, mut full) = (Vec::new(), Vec::new());
    let settle = Duration::from_millis(700);
    for n in 0..SAVES {
        desk.change(name, if n % 2 == 0 { other } else { value }).await?;
        full.push(desk.save().await?);
        desk.pause(settle).await;
        empty.push(desk.save().await?);
        desk.pause(settle).await;
    }
    // The two bytes of the value, those of the CRC, and the two of the selector.
    let bytes = 6.0;
    let byte_ms = (median(&full).as_secs_f64() - median(&empty).as_secs_f64()) * 1e3 / bytes;
    desk.check(
        "EEPROM byte",
        format!("{EEPROM_MS} ms, and up to 1 ms until the node sees it"),
        format!(
            "{byte_ms:.1} ms; {SAVES} SAVEs of {name}, {:.0} ms each",
            median(&full).as_secs_f64() * 1e3
        ),
        EEPROM_LIMITS_MS.contains(&byte_ms),
    );
    desk.change(name, other).await?;
    desk.save().await?;
    desk.pause(settle).await;
    restart(desk, board).await?;
    let kept = desk.get(name).await?;
    let id = info(desk).await?.unique_id;
    desk.check(
        "Unique ID",
        hex(&board.info.unique_id),
        hex(&id),
        id == board.info.unique_id && id.iter().any(|byte| *byte != 0),
    );
    desk.put_back().await?;
    let back = desk.get(name).await?;
    desk.check(
        "Save and restart",
        format!("{name} {other} after the restart, then {value} again"),
        format!("{kept}, then {back}"),
        (kept, back) == (other, value),
    );
    Ok(())
}

/// Restarts the node, and says how long that takes, and why it says that it has started.
async fn restart(desk: &Desk, board: &Board) -> Result<(), String> {
    let asked = desk.ask(&Message::RestartNode(RESTART_MAGIC)).await?;
    if asked.what != Message::Restarting(true) {
        return Err("the node refuses to restart".into());
    }
    let started = started(desk, asked.at, 10_000).await;
    let time = started.map(|started| (started - asked.by_adapter).as_millis() as u64);
    let asked = asked.at;
    desk.check(
        "Restart",
        format!("the first status in {RESTART_MS} ms; 0.2 s without a loader"),
        time.map_or("no status in 10 s".into(), |time| format!("{time} ms")),
        time.is_some_and(|time| time < RESTART_MS),
    );
    if board.has_port && board.has_monitor() {
        let line = desk
            .wait(desk.now() + Duration::from_secs(1), |state| state.line_with(asked, BANNER))
            .await;
        desk.check(
            "Reset cause",
            "reset: on request",
            line.clone().unwrap_or("no line".into()),
            line.is_some_and(|line| line.ends_with("reset: on request")),
        );
    }
    time.map(drop).ok_or("the node does not come back after its restart".into())
}

/// Waits for the first status of a program that has started after `since`. Returns its time by the
/// adapter's clock.
pub async fn started(desk: &Desk, since: Duration, within_ms: u64) -> Option<Duration> {
    desk.wait(since + Duration::from_millis(within_ms), |state| {
        let mut new = state.statuses.iter().filter(|status| status.at > since);
        new.find(|status| is_start(&status.what)).map(|status| status.by_adapter)
    })
    .await
}

fn is_start(status: &NodeStatus) -> bool {
    status.uptime_s < 3 && matches!(status.mode, Mode::Initialization | Mode::Operational)
}

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
async fn bursts_and_watch(desk: &Desk, plan: &Plan, board: &Board) -> Result<(), String> {
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
    let seen = match (received, lost) {
        (Some(received), _) => {
            format!("{received} of {sent} received, and the requests beside them")
        }
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
    for n in 0..BURST {
        desk.wait(Duration::MAX, |state| {
            (state.waiting + state.out.len() < WAITING_MAX).then_some(())
        })
        .await;
        if is_alone {
            desk.broadcast(&Message::ArrayCommand(vec![command; 15]), own, n as u8);
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

/// All bits of the status codes since a time.
pub fn codes(state: &State, since: Duration) -> u16 {
    let new = state.statuses.iter().filter(|status| status.at >= since);
    new.fold(0, |codes, status| codes | status.what.vendor_code)
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

/// Updates the node with the program that it has.
async fn update(desk: &Desk, plan: &Plan, board: &Board) -> Result<(), String> {
    let info = &board.info;
    let Some(crc) = info.image_crc else {
        desk.skip("Update", "the program has no feature \"update\"");
        return Ok(());
    };
    let has_loader = info.hardware.0 & TAKES_NO_UPDATES == 0;
    desk.check(
        "Bootloader",
        "takes updates over the bus",
        if has_loader {
            "takes them".into()
        } else {
            format!(
                "hardware {}.{}: it takes none, though the program does. \"make bootloader\" \
                 writes one that does",
                info.hardware.0, info.hardware.1
            )
        },
        has_loader,
    );
    if !has_loader {
        return Ok(());
    }
    let Some(file) = plan.files.iter().find(|file| file.image_crc == Some(crc)) else {
        desk.skip(
            "Update",
            format!("no file has the node's program, image CRC {crc:#X}: --firmware"),
        );
        return Ok(());
    };
    let question = format!(
        "Update node {} with the program that it has ({file})? The outputs have no pulse meanwhile.",
        plan.node
    );
    if !desk.is_allowed(question).await {
        desk.skip("Update", "not wanted");
        return Ok(());
    }
    update_with(desk, plan, board, file).await
}

async fn update_with(
    desk: &Desk,
    plan: &Plan,
    board: &Board,
    file: &FirmwareFile,
) -> Result<(), String> {
    {
        let mut state = desk.state_mut();
        let own = state.tool.id().ok_or("no node ID")?;
        let (node, now) = (state.node, state.now);
        state.reads.clear();
        state.update =
            Some(Update::new(node, board.info.software, Rc::new(file.clone()), own, now));
    }
    let outcome = desk.run_update().await;
    let gaps: Vec<Duration> = {
        let reads = &desk.state().reads;
        reads.windows(2).map(|pair| pair[1] - pair[0]).collect()
    };
    // A part of 256 bytes has 38 frames of 131 bits. It is two pages.
    let bus_ms = 38.0 * 131.0 * 1e3 / f64::from(plan.bit_rate);
    let page_ms = (quick(&gaps).as_secs_f64() * 1e3 - bus_ms) / 2.0;
    let (text, is_updated) = match outcome {
        Outcome::Updated(text) => (text, true),
        Outcome::Failed(text) => (text, false),
    };
    desk.check("Update", "the same program", text, is_updated);
    if is_updated {
        let adapter = board.round_trip.as_secs_f64() * 1e3 / 2.0;
        desk.check(
            "Page of flash",
            "7.4 to 9 ms to erase and write it",
            format!("{page_ms:.1} ms, with up to {adapter:.1} ms of the adapter"),
            page_ms - adapter < PAGE_LIMIT_MS,
        );
    }
    Ok(())
}
