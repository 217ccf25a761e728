//! Finds the node, and asks it who it is.

use std::collections::BTreeMap;
use std::time::Duration;

use dronecan_host::{Message, Mode, NodeInfo};

use crate::check::board::{BANNER, Board, Plan};
use crate::check::desk::{Desk, Output};
use crate::check::report::Verdict::{Failed, Skipped};
use crate::update::search::{NAME, is_of_this_project};

/// Each node sends NodeStatus once a second; a bootloader that hears nothing waits for three.
const LISTEN: Duration = Duration::from_secs(5);
/// A board that the serial port has reset runs in this time, also behind a bootloader that waits
/// for an upload first, and with a first start that makes the unique ID.
const BOOT: Duration = Duration::from_secs(6);
/// This project's version.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Listens, opens the port, and asks the node who it is. `None` if it does not say.
pub async fn find(desk: &Desk, plan: &Plan) -> Option<Board> {
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
    let hears_nobody =
        |desk: &Desk| desk.state().statuses.is_empty() && desk.state().others.is_empty();
    let mut has_errors = desk.adapter_errors().await == Some(true);
    // Errors count only as long as nothing was sent: a frame that nobody acknowledges is one, too.
    if hears_nobody(desk) && !has_errors {
        desk.note("hears nothing, and listens twice as long again");
        desk.pause(2 * LISTEN).await;
        has_errors = desk.adapter_errors().await == Some(true);
    }
    // A node that hears only errors sends nothing, and says why once it has heard frames.
    if hears_nobody(desk) {
        let _ = desk.state_mut().tool.take_id(None, None);
        desk.state_mut().is_silent = false;
        desk.pause(LISTEN).await;
    }
    let status = desk.state().status();
    let Some(status) = status else {
        silent(desk, plan, opened, has_errors);
        return None;
    };
    desk.check(
        "On the bus",
        format!("node {node} at {} bit/s, OPERATIONAL", plan.bit_rate),
        match status.mode {
            Mode::Maintenance => {
                format!("{status}: the bootloader waits for a program. \"make update\" sends one")
            }
            _ => status.to_string(),
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
    let is_ours = is_of_this_project(&info);
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

pub async fn info(desk: &Desk) -> Result<NodeInfo, String> {
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

pub fn boot_line(desk: &Desk, board: &Board, plan: &Plan) {
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
