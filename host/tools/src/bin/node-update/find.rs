//! Finds the nodes to update on the bus.

use std::hash::{BuildHasher as _, Hasher as _, RandomState};
use std::time::Duration;

use anyhow::Error;
use dronecan_host::text::visible;
use dronecan_host::{Message, NodeId};
use node_tools::update::file::FirmwareFile;
use node_tools::update::search::{Candidate, Search};

use crate::Failure;
use crate::client::Client;
use node_tools::update::args::Args;

/// The listening takes up to this much longer, by chance, so that two programs that start together
/// do not take the same node ID.
const LISTEN_LONGER_MS: u64 = 400;
/// Timeout of GetNodeInfo, and number of attempts.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(500);
const ATTEMPTS: u32 = 5;

/// Listens for nodes, takes an ID of its own, and requests the nodes' information. Returns the ID,
/// and the nodes to update, lowest ID first.
pub fn find(
    client: &mut Client,
    args: &Args,
    file: &FirmwareFile,
) -> Result<(NodeId, Vec<Candidate>), Failure> {
    println!("listening for nodes");
    let longer = RandomState::new().build_hasher().finish() % LISTEN_LONGER_MS;
    let mut search = Search::new(args.node, client.now() + Duration::from_millis(longer));
    while search.is_listening(client.now()) {
        receive(client, &mut search)?;
    }
    let left = search.left_server(client.tool.heard(), client.now());
    let own_id = client.tool.take_id(args.own_id, left).map_err(Failure::Usage)?;
    for _ in 0..ATTEMPTS {
        let asked = search.unknown();
        if asked.is_empty() {
            break;
        }
        for id in asked {
            client.request(&Message::NodeInfoRequest, id);
        }
        let answers_until = client.now() + ANSWER_TIMEOUT;
        while client.now() < answers_until && !search.unknown().is_empty() {
            receive(client, &mut search)?;
        }
    }
    let chosen = search.choose(args.node, file, client.tool.heard(), client.now());
    for other in chosen.others {
        println!("{}", visible(&other));
    }
    let nodes = chosen.nodes.map_err(|text| Failure::Nodes(Error::msg(text)))?;
    Ok((own_id, nodes))
}

/// Handles received transfers for a moment.
fn receive(client: &mut Client, search: &mut Search) -> Result<(), Failure> {
    if client.is_interrupted() {
        return Err(Failure::Interrupted);
    }
    for transfer in client.receive().map_err(Failure::Bus)? {
        search.take(&transfer);
    }
    Ok(())
}
