//! Commands: COMMAND_LONG and COMMAND_INT. Each is answered to its sender with COMMAND_ACK.
//!
//! A command to a node is acknowledged when the node has answered. If the station repeats the
//! command before that, as stations do, the answer is IN_PROGRESS and the command is not executed
//! twice. Component 0 and the bridge's own component stand for all nodes where that is
//! safe: all nodes can be saved at once, but not erased or restarted.

use crate::forward::Forward;
use crate::identity::own_version;
use crate::message::{Command, Content, command, id as message_id};
use crate::node::Node;
use crate::post::{Asker, PeerId, To};
use crate::state::{Rights, State};
use crate::task::Purpose;
use dronecan_host::{Message, NodeId, Opcode, RESTART_MAGIC};
use mavlink::dialects::common::MavResult;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Maximum number of commands in progress; more are rejected.
const PENDING_MAX: usize = 64;

const ACCEPTED: MavResult = MavResult::MAV_RESULT_ACCEPTED;
const REJECTED: MavResult = MavResult::MAV_RESULT_TEMPORARILY_REJECTED;
const DENIED: MavResult = MavResult::MAV_RESULT_DENIED;
const UNSUPPORTED: MavResult = MavResult::MAV_RESULT_UNSUPPORTED;
const FAILED: MavResult = MavResult::MAV_RESULT_FAILED;
const IN_PROGRESS: MavResult = MavResult::MAV_RESULT_IN_PROGRESS;

/// A command, with its sender and its target.
#[derive(Clone, Debug, PartialEq)]
struct Given {
    asker: Asker,
    /// The node that it is for; `None`: the bridge, or all nodes.
    node: Option<NodeId>,
    /// The component that it is for, which acknowledges it.
    component: u8,
    command: Command,
}

/// A command that waits for answers of nodes.
#[derive(Clone, Debug, PartialEq)]
struct Pending {
    given: Given,
    waiting_for: BTreeSet<NodeId>,
    failed: bool,
}

/// The commands in progress, each with its own number.
#[derive(Default)]
pub struct Commands {
    pending: BTreeMap<u32, Pending>,
    next: u32,
}

impl Given {
    /// True if a station repeats this command. Some use NaN for "not given", and NaN is not equal
    /// to itself.
    fn is_repeated(&self, other: &Given) -> bool {
        let key = |given: &Given| {
            let Given { asker, component, command, .. } = given;
            (asker.peer, asker.from, *component, command.number, command.params.map(f32::to_bits))
        };
        key(self) == key(other)
    }

    fn acknowledge(&self, state: &mut State, result: MavResult) {
        let content = Content::Ack { command: self.command.number, result, to: self.asker.from };
        state.answer(self.asker, self.component, content);
    }

    /// Acknowledges the command, and says why it has this result.
    fn end(&self, state: &mut State, result: MavResult, why: &str) {
        self.acknowledge(state, result);
        state.say(To::One(self.asker.peer), self.component, why);
    }
}

impl Commands {
    /// Executes a command to a component.
    pub fn take(
        &mut self,
        state: &mut State,
        forward: &mut Forward,
        now: Duration,
        asker: Asker,
        component: u8,
        command: Command,
    ) {
        let own = state.settings.component;
        let node = match NodeId::new(component).filter(|id| state.nodes.contains_key(id)) {
            // If the bridge's component ID is the ID of a node that is online, commands that only a
            // node can execute are for that node.
            Some(id) if component == own && is_for_one_node(&command) => Some(id),
            _ if component == 0 || component == own => None,
            Some(id) if !state.is_other_component(component) => Some(id),
            // Another component of this system may answer it.
            _ => return,
        };
        let given = Given { asker, node, component: node.map_or(own, NodeId::get), command };
        if self.pending.values().any(|pending| pending.given.is_repeated(&given)) {
            return given.acknowledge(state, IN_PROGRESS);
        }
        if let Some(why) = why_not_allowed(state.settings.rights, command.number) {
            return given.end(state, DENIED, why);
        }
        let result = match command.number {
            command::UAVCAN_GET_NODE_INFO => {
                // For any target: MAVLink's chapter on UAVCAN requires one for every known node.
                let is_known = |node: &Node| node.is_online || node.info.known.is_some();
                let nodes = state.nodes.iter().filter(|(_, node)| is_known(node));
                let nodes = nodes.map(|(id, _)| *id).collect();
                return self.send_infos(state, now, given, nodes);
            }
            command::REQUEST_MESSAGE => return self.request_message(state, now, given),
            command::REQUEST_AUTOPILOT_CAPABILITIES => {
                given.acknowledge(state, ACCEPTED);
                return post_capabilities(state, &given);
            }
            command::REQUEST_PROTOCOL_VERSION => UNSUPPORTED,
            command::CAN_FORWARD => {
                // Stations send integers as floats. Other values become 0, which ends it.
                let [bus, ..] = command.params;
                let bus = if bus.fract() == 0.0 { bus as i64 } else { 0 };
                forward.subscribe(state, now, asker, bus)
            }
            command::PREFLIGHT_STORAGE => return self.storage(state, given),
            command::PREFLIGHT_REBOOT_SHUTDOWN => return self.reboot(state, given),
            _ => UNSUPPORTED,
        };
        given.acknowledge(state, result);
    }

    /// Sends UAVCAN_NODE_INFO of these nodes, at once or when they have answered.
    fn send_infos(&mut self, state: &mut State, now: Duration, given: Given, nodes: Vec<NodeId>) {
        if nodes.is_empty() {
            return given.end(state, FAILED, "No node is online");
        }
        let (known, unknown): (Vec<_>, Vec<_>) =
            nodes.into_iter().partition(|id| state.nodes[id].info.known.is_some());
        for id in known {
            state.post_info(now, id, To::One(given.asker.peer));
        }
        if unknown.is_empty() {
            return given.acknowledge(state, ACCEPTED);
        }
        let Some(ticket) = self.begin(state, given, &unknown) else { return };
        for id in unknown {
            state.request_info(id);
            if let Some(node) = state.nodes.get_mut(&id) {
                node.info.waiting.push(ticket);
            }
        }
    }

    fn request_message(&mut self, state: &mut State, now: Duration, given: Given) {
        let [number, which, ..] = given.command.params;
        // Parameter 2 may also name a node.
        let named = NodeId::new(which as u8).filter(|id| state.nodes.contains_key(id));
        let nodes: Vec<NodeId> = match given.node.or(named) {
            Some(id) => vec![id],
            None => state.online_nodes().collect(),
        };
        match number as u32 {
            message_id::NODE_INFO => self.send_infos(state, now, given, nodes),
            message_id::NODE_STATUS if !nodes.is_empty() => {
                given.acknowledge(state, ACCEPTED);
                for id in nodes {
                    let status = state.nodes[&id].status;
                    let content = state.status_content(now, &status);
                    state.answer(given.asker, id.get(), content);
                }
            }
            // There is no node to report.
            message_id::NODE_STATUS => given.acknowledge(state, FAILED),
            message_id::AUTOPILOT_VERSION => {
                given.acknowledge(state, ACCEPTED);
                post_capabilities(state, &given);
            }
            message_id::HEARTBEAT => {
                given.acknowledge(state, ACCEPTED);
                state.answer(given.asker, given.component, state.heartbeat(given.node));
            }
            _ => given.acknowledge(state, DENIED),
        }
    }

    /// MAV_CMD_PREFLIGHT_STORAGE. Parameter 1: 1 saves; 2 to 4 reset to the defaults.
    fn storage(&mut self, state: &mut State, given: Given) {
        let opcode = match (given.command.params[0], given.node) {
            (1.0, _) => Opcode::SAVE,
            (2.0 | 3.0 | 4.0, Some(_)) => Opcode::ERASE,
            (2.0 | 3.0 | 4.0, None) => {
                let why = "Erase one node at a time: address its component";
                return given.end(state, DENIED, why);
            }
            // DroneCAN has no service to read back the saved parameters.
            _ => return given.acknowledge(state, DENIED),
        };
        let nodes: Vec<NodeId> = match given.node {
            Some(id) => vec![id],
            None => state.online_nodes().filter(|id| !state.is_other_component(id.get())).collect(),
        };
        if nodes.is_empty() {
            return given.end(state, FAILED, "No node is online");
        }
        let Some(ticket) = self.begin(state, given, &nodes) else { return };
        for id in nodes {
            state.calls.ask(id, &Message::ExecuteOpcode(opcode), Purpose::Opcode(ticket));
        }
    }

    /// MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN. Either parameter 1 is 1 and the target is the node, or
    /// parameter 3 is 1 and parameter 4 is the node's component.
    fn reboot(&mut self, state: &mut State, given: Given) {
        let [whole, _, part, which, ..] = given.command.params;
        let node = match (given.node, whole, part) {
            (Some(id), 1.0, _) => Some(id),
            (_, 0.0, 1.0) => NodeId::new(which as u8).filter(|id| state.nodes.contains_key(id)),
            _ => None,
        };
        let Some(id) = node else {
            let why = "Restart one node at a time: address its component";
            return given.end(state, DENIED, why);
        };
        let Some(ticket) = self.begin(state, given, &[id]) else { return };
        state.calls.ask(id, &Message::RestartNode(RESTART_MAGIC), Purpose::Restart(ticket));
    }

    /// Registers a command that nodes must answer. If too many are in progress, rejects the command
    /// and returns `None`.
    fn begin(&mut self, state: &mut State, given: Given, nodes: &[NodeId]) -> Option<u32> {
        if self.pending.len() >= PENDING_MAX {
            given.acknowledge(state, REJECTED);
            return None;
        }
        let ticket = self.next;
        self.next = self.next.wrapping_add(1);
        let waiting_for = nodes.iter().copied().collect();
        self.pending.insert(ticket, Pending { given, waiting_for, failed: false });
        Some(ticket)
    }

    /// Notes the result of a command at one node. Reports a failure to the sender, and acknowledges
    /// the command after the last node.
    pub fn done(&mut self, state: &mut State, ticket: u32, id: NodeId, done: Result<(), &str>) {
        let Some(pending) = self.pending.get_mut(&ticket) else { return };
        if !pending.waiting_for.remove(&id) {
            return;
        }
        if let Err(why) = done {
            pending.failed = true;
            let Given { asker, component, .. } = pending.given;
            state.say(To::One(asker.peer), component, &format!("Node {id} {why}"));
        }
        if pending.waiting_for.is_empty()
            && let Some(pending) = self.pending.remove(&ticket)
        {
            let result = if pending.failed { FAILED } else { ACCEPTED };
            pending.given.acknowledge(state, result);
        }
    }

    /// Handles a node's answer to ExecuteOpcode or RestartNode; `None` if there was none.
    pub fn answer(
        &mut self,
        state: &mut State,
        id: NodeId,
        purpose: Purpose,
        payload: Option<&[u8]>,
    ) {
        // Both responses have "ok" in the most significant bit of the last byte.
        let ok = payload.and_then(<[u8]>::last).is_some_and(|byte| byte & 1 << 7 != 0);
        let done = match payload {
            None => Err("does not answer"),
            Some(_) if ok => Ok(()),
            Some(_) => Err("refuses"),
        };
        let outcome = done.err().unwrap_or("done");
        match purpose {
            Purpose::Opcode(ticket) => {
                let saves = |pending: &Pending| pending.given.command.params[0] == 1.0;
                let is_save = self.pending.get(&ticket).is_none_or(saves);
                let what = if is_save { "save" } else { "erase" };
                state.log.push(format!("node {id}: {what}: {outcome}"));
                self.done(state, ticket, id, done);
            }
            Purpose::Restart(ticket) => {
                state.log.push(format!("node {id}: restart: {outcome}"));
                self.done(state, ticket, id, done);
            }
            Purpose::Autosave => state.log.push(format!("node {id}: saved by itself: {outcome}")),
            _ => {}
        }
    }

    /// Completes restart commands to a node that has restarted, even if its answer was lost.
    pub fn restarted(&mut self, state: &mut State, id: NodeId) {
        let is_restart = |purpose: &Purpose| matches!(purpose, Purpose::Restart(_));
        for purpose in state.calls.remove_requests(id, is_restart) {
            if let Purpose::Restart(ticket) = purpose {
                self.done(state, ticket, id, Ok(()));
            }
        }
    }

    /// True if no command is in progress.
    #[cfg(test)]
    pub fn is_idle(&self) -> bool {
        self.pending.is_empty()
    }

    /// Removes a ground station from all commands in progress.
    pub fn drop_station(&mut self, peer: PeerId) {
        self.pending.retain(|_, pending| pending.given.asker.peer != peer);
    }
}

/// Why a command is not allowed; `None` if it is.
fn why_not_allowed(rights: Rights, number: u16) -> Option<&'static str> {
    match number {
        command::PREFLIGHT_STORAGE | command::PREFLIGHT_REBOOT_SHUTDOWN if !rights.change => {
            Some("The bridge is read-only")
        }
        command::CAN_FORWARD if !rights.can => Some("The bridge forwards no frames: --allow-can"),
        _ => None,
    }
}

/// True for commands that are never sent to all nodes: restart and erase.
fn is_for_one_node(command: &Command) -> bool {
    match command.number {
        command::PREFLIGHT_REBOOT_SHUTDOWN => command.params[0] == 1.0,
        command::PREFLIGHT_STORAGE => matches!(command.params[0], 2.0 | 3.0 | 4.0),
        _ => false,
    }
}

/// AUTOPILOT_VERSION. Its capabilities say how integers are encoded.
fn post_capabilities(state: &mut State, given: &Given) {
    let ((major, minor), unique_id) = match given.node {
        Some(id) => match &state.nodes[&id].info.known {
            Some(info) => (info.software, info.unique_id),
            None => ((0, 0), [0; 16]),
        },
        None => (own_version(), state.settings.unique_id),
    };
    let software = u32::from(major) << 24 | u32::from(minor) << 16;
    let content = Content::Capabilities { software, unique_id };
    state.answer(given.asker, given.component, content);
}
