//! Updates several nodes at the same time, so that none waits for one that is slow or does not end.

use std::collections::VecDeque;

use anyhow::Error;
use dronecan_host::NodeId;
use dronecan_host::text::visible;

use crate::Failure;
use crate::args::Args;
use crate::client::Client;
use crate::file::FirmwareFile;
use crate::progress::{Display, Progress};
use crate::search::Candidate;
use crate::session::{Action, Outcome, Session};

/// Nodes that are updated at the same time. One that reads takes up to a quarter of a bus of
/// 1 Mbit/s.
const AT_A_TIME: usize = 4;

/// The update of a node, and what is shown of it.
struct Running<'a> {
    session: Session<'a>,
    progress: Progress,
}

/// Updates the nodes. `own_id` is the ID of this program.
pub fn update(
    client: &mut Client,
    args: &Args,
    file: &FirmwareFile,
    own_id: NodeId,
    nodes: Vec<Candidate>,
) -> Result<(), Failure> {
    let display = Display::new(args.plain);
    let count = nodes.len();
    let mut waiting = VecDeque::from(nodes);
    let mut running: Vec<Running> = Vec::new();
    let mut failed = Vec::new();
    loop {
        while running.len() < AT_A_TIME
            && let Some(Candidate { id, info }) = waiting.pop_front()
        {
            running.push(Running {
                session: Session::new(id, info.software, file, own_id, client.now()),
                progress: display.progress(id, file.bytes.len()),
            });
        }
        if running.is_empty() {
            break;
        }
        if client.is_interrupted() {
            return Err(interrupt(&display, running));
        }
        let ended = turn(client, &mut running).map_err(Failure::Bus)?;
        for (n, outcome) in ended.into_iter().rev() {
            let Running { session, progress } = running.remove(n);
            progress.end();
            match outcome {
                Outcome::Updated(text) => {
                    display.line(&format!("node {}: {}", session.node, visible(&text)))
                }
                Outcome::Failed(text) => {
                    display.line(&format!("node {}: FAILED: {}", session.node, visible(&text)));
                    failed.push(session.node);
                }
            }
        }
    }
    if failed.is_empty() {
        return Ok(());
    }
    failed.sort();
    let failed: Vec<String> = failed.iter().map(ToString::to_string).collect();
    let error = format!("{} of {count} nodes not updated: {}", failed.len(), failed.join(", "));
    Err(Failure::Nodes(Error::msg(error)))
}

/// Receives for a moment, and does what is due. Returns the updates that have ended, by index.
fn turn(client: &mut Client, running: &mut [Running]) -> anyhow::Result<Vec<(usize, Outcome)>> {
    for transfer in client.receive()? {
        for Running { session, .. } in running.iter_mut() {
            if let Some(answer) = session.take(&transfer, client.now()) {
                client.answer(&transfer, &answer);
            }
        }
    }
    let mut ended = Vec::new();
    for (n, Running { session, progress }) in running.iter_mut().enumerate() {
        match session.poll(client.now()) {
            Some(Action::Request(message)) => client.request(&message, session.node),
            Some(Action::End(outcome)) => ended.push((n, outcome)),
            None => {}
        }
        progress.show(session);
    }
    Ok(ended)
}

/// Says in which state each node is.
fn interrupt(display: &Display, running: Vec<Running>) -> Failure {
    for Running { session, progress } in running {
        progress.end();
        display.line(&format!("node {}: {}", session.node, session.state_if_ended_now()));
    }
    Failure::Interrupted
}
