//! Finds the nodes to update, without I/O.

use std::collections::BTreeMap;
use std::str::FromStr;
use std::time::Duration;

use dronecan_host::{CanId, Message, Mode, NodeId, NodeInfo, Transfer};

use crate::update::file::FirmwareFile;
use crate::update::heard::Heard;
use crate::update::session::{PATH, another_update, server_asked};

/// Each node sends NodeStatus once a second. A bootloader is silent for a moment while it checks
/// the program.
const LISTEN: Duration = Duration::from_millis(2500);
/// A bootloader that has just started on a silent bus listens for three seconds before it sends. It
/// sends NodeStatus within a second then. One that reads a file from a program that was stopped
/// sends a request each three seconds.
const LISTEN_IF_SILENT: Duration = Duration::from_secs(5);
/// This bit of the major hardware version says that the node takes no updates (docs/update.md).
pub const TAKES_NO_UPDATES: u8 = 0x80;
/// The names of this project's nodes begin with this. A bootloader has no name.
pub const NAME: &str = "org.dronecan.servo";

/// The nodes to update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Nodes {
    /// All nodes with the hardware of the file.
    All,
    One(NodeId),
}

impl Nodes {
    /// True for the ID of a node to update.
    pub fn includes(self, id: u8) -> bool {
        match self {
            Nodes::All => true,
            Nodes::One(one) => one.get() == id,
        }
    }
}

impl FromStr for Nodes {
    type Err = String;

    fn from_str(text: &str) -> Result<Nodes, String> {
        if text == "all" { Ok(Nodes::All) } else { node_id(text).map(Nodes::One) }
    }
}

/// Reads a node ID.
///
/// # Errors
/// If the text is not one.
pub fn node_id(text: &str) -> Result<NodeId, String> {
    text.parse()
        .ok()
        .and_then(NodeId::new)
        .ok_or_else(|| format!("\"{text}\" is not a node ID, which is 1 to 127"))
}

/// A node to update.
#[derive(Clone, Debug)]
pub struct Candidate {
    pub id: NodeId,
    pub info: NodeInfo,
}

/// A node on the bus.
#[derive(Clone, Default)]
struct Seen {
    info: Option<NodeInfo>,
    /// True if its last NodeStatus has the mode SOFTWARE_UPDATE.
    is_in_update: bool,
    /// The node that it asks for a file.
    server: Option<NodeId>,
    /// True if it asks for the path of this program's files.
    asks_for_our_path: bool,
}

/// The nodes that a file is for.
pub struct Chosen {
    /// Lowest ID first; why there is none.
    pub nodes: Result<Vec<Candidate>, String>,
    /// Why other nodes are not updated.
    pub others: Vec<String>,
}

/// What is known of the nodes on the bus.
pub struct Search {
    meant: Nodes,
    begin: Duration,
    nodes: BTreeMap<u8, Seen>,
}

impl Search {
    /// A search for `meant` that listens from `begin` on.
    pub fn new(meant: Nodes, begin: Duration) -> Search {
        Search { meant, begin, nodes: BTreeMap::new() }
    }

    /// True until each node must have been heard. Nothing should be sent before.
    pub fn is_listening(&self, now: Duration) -> bool {
        let mut found = self.meant_nodes().peekable();
        let is_found = found.peek().is_some();
        let is_server_unknown = found.any(|(_, node)| node.is_in_update && node.server.is_none());
        let listen = if is_found && !is_server_unknown { LISTEN } else { LISTEN_IF_SILENT };
        now < self.begin + listen
    }

    /// The node ID of a program like this one that was stopped: its nodes ask for more of the file.
    pub fn left_server(&self, heard: &Heard, now: Duration) -> Option<NodeId> {
        self.meant_nodes()
            .filter(|(_, node)| node.asks_for_our_path)
            .filter_map(|(_, node)| node.server)
            .find(|server| !heard.is_on_bus(*server, now))
    }

    /// The nodes whose information is not known.
    pub fn unknown(&self) -> Vec<NodeId> {
        self.meant_nodes()
            .filter(|(_, node)| node.info.is_none())
            .filter_map(|(id, _)| NodeId::new(*id))
            .collect()
    }

    fn meant_nodes(&self) -> impl Iterator<Item = (&u8, &Seen)> {
        self.nodes.iter().filter(|(id, _)| self.meant.includes(**id))
    }

    /// Handles a transfer.
    pub fn take(&mut self, transfer: &Transfer) {
        let Some(source) = transfer.id.source() else { return };
        if let Some(server) = server_asked(transfer) {
            let node = self.nodes.entry(source.get()).or_default();
            node.server = Some(server);
            node.asks_for_our_path = transfer.payload.get(5..) == Some(PATH);
            return;
        }
        match (transfer.id, Message::decode(transfer)) {
            (_, Message::NodeInfo(info)) if self.meant.includes(source.get()) => {
                self.nodes.entry(source.get()).or_default().info = Some(*info);
            }
            (CanId::Message { .. }, Message::NodeStatus(status)) => {
                let node = self.nodes.entry(source.get()).or_default();
                node.is_in_update = status.mode == Mode::SoftwareUpdate;
                if !node.is_in_update {
                    node.server = None;
                }
            }
            _ => {}
        }
    }

    /// Returns the nodes of `meant` that the file is for.
    pub fn choose(
        &self,
        meant: Nodes,
        file: &FirmwareFile,
        heard: &Heard,
        now: Duration,
    ) -> Chosen {
        let mut nodes = self.nodes.clone();
        for node in nodes.values_mut() {
            node.server = node.server.filter(|server| heard.is_on_bus(*server, now));
        }
        match meant {
            Nodes::One(id) => {
                Chosen { nodes: choose_one(&nodes, id, file).map(|one| vec![one]), others: vec![] }
            }
            Nodes::All => choose_all(nodes, file),
        }
    }
}

/// The IDs of the nodes in words.
fn list(nodes: &BTreeMap<u8, Seen>) -> String {
    let ids: Vec<_> = nodes.keys().map(u8::to_string).collect();
    if ids.is_empty() {
        "none: is this the right bus, with its bit rate?".to_owned()
    } else {
        ids.join(", ")
    }
}

fn choose_one(
    nodes: &BTreeMap<u8, Seen>,
    id: NodeId,
    file: &FirmwareFile,
) -> Result<Candidate, String> {
    let info = match nodes.get(&id.get()) {
        None => {
            return Err(format!("node {id} is not on the bus. Nodes that are: {}", list(nodes)));
        }
        Some(Seen { server: Some(server), .. }) => {
            return Err(format!("node {id}: {}", another_update(*server)));
        }
        Some(Seen { info: None, .. }) => {
            return Err(format!("node {id} does not answer GetNodeInfo"));
        }
        Some(Seen { info: Some(info), .. }) => info.clone(),
    };
    match why_unsuitable(&info, file) {
        Some(why) => Err(format!("node {id} {why}")),
        None => Ok(Candidate { id, info }),
    }
}

fn choose_all(nodes: BTreeMap<u8, Seen>, file: &FirmwareFile) -> Chosen {
    let seen = list(&nodes);
    let (mut candidates, mut others) = (Vec::new(), Vec::new());
    for (id, Seen { info, server, .. }) in nodes {
        let why = match (server, NodeId::new(id).zip(info)) {
            (Some(server), _) => another_update(server),
            (None, None) => "it does not answer GetNodeInfo".to_owned(),
            (None, Some((id, info))) => match why_unsuitable(&info, file) {
                Some(why) => format!("it {why}"),
                None => {
                    candidates.push(Candidate { id, info });
                    continue;
                }
            },
        };
        others.push(format!("node {id}: not updated: {why}"));
    }
    let nodes = if candidates.is_empty() {
        Err(format!("the file is for no node on the bus. Nodes: {seen}"))
    } else {
        Ok(candidates)
    };
    Chosen { nodes, others }
}

/// True for the information of a program of this project.
pub fn is_of_this_project(info: &NodeInfo) -> bool {
    info.name.starts_with(NAME.as_bytes())
}

/// Why the file is not for this node; `None` if it is.
pub fn why_unsuitable(info: &NodeInfo, file: &FirmwareFile) -> Option<String> {
    if !info.name.is_empty() && !is_of_this_project(info) {
        return Some(format!("is another device: {}", info.name()));
    }
    let ((major, minor), (file_major, file_minor)) = (info.hardware, file.hardware);
    if major & TAKES_NO_UPDATES != 0 {
        return Some(
            "takes no update over the bus: its program lacks the feature \"update\" (ATmega168: \
             FEATURES=remote), or its board the loader of \"make bootloader\". Upload one through \
             the serial port"
                .to_owned(),
        );
    }
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
    use crate::update::file::tests::{file_of, id};

    fn node(name: &str, hardware: (u8, u8)) -> Seen {
        let info = NodeInfo { name: name.into(), hardware, ..NodeInfo::default() };
        Seen { info: Some(info), ..Seen::default() }
    }

    fn fleet() -> BTreeMap<u8, Seen> {
        BTreeMap::from([
            (1, node("org.ardupilot", (2, 1))),
            (2, Seen::default()),
            (42, node("org.dronecan.servo328", (2, 1))),
            (43, node("org.dronecan.servo168", (1, 0))),
            (45, node("org.dronecan.servo328", (0x82, 1))),
            // A node in its bootloader.
            (120, node("", (2, 1))),
        ])
    }

    fn ids(candidates: Vec<Candidate>) -> Vec<u8> {
        candidates.iter().map(|node| node.id.get()).collect()
    }

    #[test]
    fn all_selects_each_node_of_this_project_with_the_hardware_of_the_file() {
        let chosen = choose_all(fleet(), &file_of(1000));
        assert_eq!(ids(chosen.nodes.unwrap()), [42, 120]);
        assert_eq!(chosen.others.len(), 4);
        assert!(choose_all(BTreeMap::new(), &file_of(1000)).nodes.is_err());
    }

    #[test]
    fn a_node_that_reads_a_file_from_another_node_is_not_chosen() {
        let mut nodes = fleet();
        nodes.get_mut(&42).unwrap().server = NodeId::new(126);
        let error = choose_one(&nodes, id(42), &file_of(1000)).unwrap_err();
        assert_eq!(error, "node 42: another update is under way: node 126 sends a file");
        assert_eq!(ids(choose_all(nodes, &file_of(1000)).nodes.unwrap()), [120]);
    }

    #[test]
    fn an_unsuitable_node_is_rejected_with_the_reason() {
        let refused = |node| choose_one(&fleet(), id(node), &file_of(1000)).unwrap_err();
        assert!(refused(1).contains("another device: org.ardupilot"));
        assert!(refused(2).contains("does not answer"));
        assert!(refused(43).contains("has hardware 1.0, and the file is for 2.1"));
        assert!(refused(45).contains("takes no update over the bus"));
        assert!(refused(44).contains("not on the bus. Nodes that are: 1, 2, 42, 43, 45, 120"));
        assert!(choose_one(&fleet(), id(120), &file_of(1000)).is_ok());
    }

    #[test]
    fn nodes_are_a_node_id_or_all() {
        assert_eq!("all".parse(), Ok(Nodes::All));
        assert_eq!("120".parse(), Ok(Nodes::One(id(120))));
        for wrong in ["", "0", "128", "-1", "120,121"] {
            assert!(wrong.parse::<Nodes>().is_err(), "{wrong}");
        }
    }
}
