//! Updates the nodes that were found, and shows how far each is.

use std::collections::HashMap;
use std::rc::Rc;

use anyhow::Error;
use dronecan_host::NodeId;
use dronecan_host::text::visible;
use node_tools::update::file::FirmwareFile;
use node_tools::update::fleet::{Due, Fleet};
use node_tools::update::search::Candidate;
use node_tools::update::session::Outcome;

use crate::Failure;
use crate::client::Client;
use crate::progress::{Display, Progress};
use node_tools::update::args::Args;

/// What is shown of each update.
type Shown = HashMap<NodeId, Progress>;

/// Updates the nodes. `own_id` is the ID of this program.
pub fn update(
    client: &mut Client,
    args: &Args,
    file: FirmwareFile,
    own_id: NodeId,
    nodes: Vec<Candidate>,
) -> Result<(), Failure> {
    let display = Display::new(args.plain);
    let count = nodes.len();
    let (len, file) = (file.bytes.len(), Rc::new(file));
    let mut fleet = Fleet::new(own_id);
    for node in nodes {
        fleet.add(node, Rc::clone(&file), client.now());
    }
    let mut shown = Shown::new();
    let mut failed = Vec::new();
    while !fleet.is_done() {
        if client.is_interrupted() {
            tell_states(&display, &fleet, &shown);
            return Err(Failure::Interrupted);
        }
        if client.tool.has_conflict() {
            tell_states(&display, &fleet, &shown);
            return Err(Failure::Other(Error::msg(format!(
                "another node sends with this program's node ID, {own_id}. Try again"
            ))));
        }
        let ended = match turn(client, &mut fleet) {
            Ok(ended) => ended,
            Err(error) => {
                tell_states(&display, &fleet, &shown);
                return Err(Failure::Bus(error));
            }
        };
        for session in fleet.running() {
            let node = session.node;
            shown.entry(node).or_insert_with(|| display.progress(node, len)).show(session);
        }
        for (node, outcome) in ended {
            if let Some(progress) = shown.remove(&node) {
                progress.end();
            }
            match outcome {
                Outcome::Updated(text) => {
                    display.line(&format!("node {node}: {}", visible(&text)));
                }
                Outcome::Failed(text) => {
                    display.line(&format!("node {node}: FAILED: {}", visible(&text)));
                    failed.push(node);
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

/// Receives for a moment, and does what is due. Returns the updates that have ended.
fn turn(client: &mut Client, fleet: &mut Fleet) -> anyhow::Result<Vec<(NodeId, Outcome)>> {
    for transfer in client.receive()? {
        if let Some(answer) = fleet.take(&transfer, client.now(), client.tool.heard()) {
            client.answer(&transfer, &answer);
        }
    }
    let mut ended = Vec::new();
    for (node, due) in fleet.poll(client.now()) {
        match due {
            Due::Request(message) => client.request(&message, node),
            Due::End(outcome) => ended.push((node, outcome)),
        }
    }
    Ok(ended)
}

/// Says in which state each node is if the program ends now.
fn tell_states(display: &Display, fleet: &Fleet, shown: &Shown) {
    shown.values().for_each(Progress::end);
    for session in fleet.running() {
        let state = session.state_if_ended_now();
        display.line(&format!("node {}: {state}", session.node));
    }
}
