//! Parameters, the EEPROM and the restart.

use std::ops::RangeInclusive;
use std::time::Duration;

use dronecan_host::text::hex;
use dronecan_host::{Message, Mode, NodeStatus, RESTART_MAGIC, Value};

use crate::check::board::{BANNER, Board, Plan};
use crate::check::desk::Desk;
use crate::check::find::{boot_line, info};
use crate::check::measure::median;

/// From the request of a restart to the first status. The node waits for 100 ms, and a loader
/// checks its program for 0.2 s.
const RESTART_MS: u64 = 1000;
const SAVES: usize = 6;
/// A byte of EEPROM takes 3.4 ms (DS40002061B 8.4) by an RC oscillator that is up to 10 % off. The
/// node looks once a millisecond whether it is written.
const EEPROM_MS: f64 = 3.4;
const EEPROM_LIMITS_MS: RangeInclusive<f64> = 2.8..=4.6;

pub async fn read_parameters(desk: &Desk, plan: &Plan, board: &mut Board) -> Result<(), String> {
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

pub async fn round_trip(desk: &Desk, board: &mut Board) -> Result<(), String> {
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
pub fn harmless(board: &Board) -> Option<(&'static str, i64, i64)> {
    let is_used = board.value("OUT1_FS") == Some(2);
    let name = ["OUT1_FS_PWM", "TEMP_ID"][usize::from(is_used)];
    let value = board.value(name)?;
    let max = match board.parameters[name].max {
        Value::Integer(max) => max,
        _ => return None,
    };
    Some((name, value, if value + 257 <= max { value + 257 } else { value - 257 }))
}

pub async fn save_and_restart(desk: &Desk, board: &Board) -> Result<(), String> {
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
