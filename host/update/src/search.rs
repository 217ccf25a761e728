//! Finds the nodes to update.

use std::collections::BTreeMap;
use std::time::Duration;

use anyhow::Error;
use dronecan_host::text::visible;
use dronecan_host::{CanId, Message, NodeId, NodeInfo};

use crate::Failure;
use crate::args::{Args, Nodes};
use crate::client::Client;
use crate::file::FirmwareFile;

/// Each node sends NodeStatus once a second. A bootloader is silent for a moment while it checks
/// the program.
const LISTEN: Duration = Duration::from_millis(2500);
/// A bootloader that has just started on a silent bus listens for three seconds before it sends. It
/// sends NodeStatus within a second then.
const LISTEN_IF_SILENT: Duration = Duration::from_secs(5);
/// Timeout of GetNodeInfo, and number of attempts.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(500);
const ATTEMPTS: u32 = 5;
/// The names of this project's nodes begin with this. A bootloader has no name.
const NAME: &str = "org.dronecan.servo";

/// A node to update.
pub struct Candidate {
    pub id: NodeId,
    pub info: NodeInfo,
}

/// Listens for nodes, takes an ID of its own, and requests the nodes' information. Returns the ID,
/// and the nodes to update, lowest ID first.
pub fn search(
    client: &mut Client,
    args: &Args,
    file: &FirmwareFile,
) -> Result<(NodeId, Vec<Candidate>), Failure> {
    println!("listening for nodes");
    let mut nodes: BTreeMap<u8, Option<NodeInfo>> = BTreeMap::new();
    let begin = client.now();
    let mut listen = LISTEN_IF_SILENT;
    while client.now() < begin + listen {
        receive(client, &mut nodes, args)?;
        if nodes.keys().any(|id| args.node.includes(*id)) {
            listen = LISTEN;
        }
    }
    let own_id = client.take_id(args.own_id).map_err(Failure::Usage)?;
    for _ in 0..ATTEMPTS {
        let asked: Vec<u8> = nodes
            .iter()
            .filter(|(id, info)| info.is_none() && args.node.includes(**id))
            .map(|(id, _)| *id)
            .collect();
        if asked.is_empty() {
            break;
        }
        for id in asked.into_iter().filter_map(NodeId::new) {
            client.request(&Message::NodeInfoRequest, id);
        }
        let answers_until = client.now() + ANSWER_TIMEOUT;
        while client.now() < answers_until
            && nodes.iter().any(|(id, info)| info.is_none() && args.node.includes(*id))
        {
            receive(client, &mut nodes, args)?;
        }
    }
    let nodes = choose(nodes, args.node, file).map_err(|text| Failure::Nodes(Error::msg(text)))?;
    Ok((own_id, nodes))
}

/// Handles received transfers for a moment.
fn receive(
    client: &mut Client,
    nodes: &mut BTreeMap<u8, Option<NodeInfo>>,
    args: &Args,
) -> Result<(), Failure> {
    if client.is_interrupted() {
        return Err(Failure::Interrupted);
    }
    for transfer in client.receive().map_err(Failure::Bus)? {
        let Some(source) = transfer.id.source() else { continue };
        match (transfer.id, Message::decode(&transfer)) {
            (_, Message::NodeInfo(info)) if args.node.includes(source.get()) => {
                nodes.insert(source.get(), Some(*info));
            }
            (CanId::Message { .. }, Message::NodeStatus(_)) => {
                nodes.entry(source.get()).or_default();
            }
            _ => {}
        }
    }
    Ok(())
}

/// Returns the nodes that the file is for.
fn choose(
    nodes: BTreeMap<u8, Option<NodeInfo>>,
    meant: Nodes,
    file: &FirmwareFile,
) -> Result<Vec<Candidate>, String> {
    let seen: Vec<_> = nodes.keys().map(u8::to_string).collect();
    let seen =
        if seen.is_empty() { "none: is the bit rate right?".to_owned() } else { seen.join(", ") };
    if let Nodes::One(id) = meant {
        let info = match nodes.get(&id.get()) {
            None => return Err(format!("node {id} is not on the bus. Nodes that are: {seen}")),
            Some(None) => return Err(format!("node {id} does not answer GetNodeInfo")),
            Some(Some(info)) => info.clone(),
        };
        return match why_unsuitable(&info, file) {
            Some(why) => Err(format!("node {id} {why}")),
            None => Ok(vec![Candidate { id, info }]),
        };
    }
    let mut candidates = Vec::new();
    for (id, info) in nodes {
        let (Some(id), Some(info)) = (NodeId::new(id), info) else {
            println!("node {id}: not updated: it does not answer GetNodeInfo");
            continue;
        };
        match why_unsuitable(&info, file) {
            Some(why) => println!("node {id}: not updated: it {}", visible(&why)),
            None => candidates.push(Candidate { id, info }),
        }
    }
    if candidates.is_empty() {
        Err(format!("the file is for no node on the bus. Nodes: {seen}"))
    } else {
        Ok(candidates)
    }
}

/// Why the file is not for this node; `None` if it is.
fn why_unsuitable(info: &NodeInfo, file: &FirmwareFile) -> Option<String> {
    let name = info.name();
    if !name.is_empty() && !name.starts_with(NAME) {
        return Some(format!("is another device: {name}"));
    }
    let ((major, minor), (file_major, file_minor)) = (info.hardware, file.hardware);
    (info.hardware != file.hardware).then(|| {
        format!(
            "has hardware {major}.{minor}, and the file is for {file_major}.{file_minor}: build \
             it with its BOARD and SHIELD"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::file::tests::file_of;

    fn node(name: &str, hardware: (u8, u8)) -> Option<NodeInfo> {
        Some(NodeInfo { name: name.into(), hardware, ..NodeInfo::default() })
    }

    fn one(id: u8) -> Nodes {
        NodeId::new(id).map(Nodes::One).unwrap()
    }

    fn fleet() -> BTreeMap<u8, Option<NodeInfo>> {
        BTreeMap::from([
            (1, node("org.ardupilot", (2, 1))),
            (2, None),
            (42, node("org.dronecan.servo328", (2, 1))),
            (43, node("org.dronecan.servo168", (1, 0))),
            // A node in its bootloader.
            (120, node("", (2, 1))),
        ])
    }

    #[test]
    fn all_selects_each_node_of_this_project_with_the_hardware_of_the_file() {
        let chosen = choose(fleet(), Nodes::All, &file_of(1000)).unwrap();
        assert_eq!(chosen.iter().map(|node| node.id.get()).collect::<Vec<_>>(), [42, 120]);
        assert!(choose(BTreeMap::new(), Nodes::All, &file_of(1000)).is_err());
    }

    #[test]
    fn an_unsuitable_node_is_rejected_with_the_reason() {
        let refused = |id: u8| choose(fleet(), one(id), &file_of(1000)).err().unwrap();
        assert!(refused(1).contains("another device: org.ardupilot"));
        assert!(refused(2).contains("does not answer"));
        assert!(refused(43).contains("has hardware 1.0, and the file is for 2.1"));
        assert!(refused(44).contains("not on the bus. Nodes that are: 1, 2, 42, 43, 120"));
        assert_eq!(choose(fleet(), one(120), &file_of(1000)).unwrap().len(), 1);
    }
}
