//! Commands: COMMAND_LONG and COMMAND_INT. Each is answered to its sender with COMMAND_ACK.
//!
//! A command to a node is acknowledged when the node has answered. If the station repeats the
//! command before that, as stations do, the answer is IN_PROGRESS and the command is not executed
//! twice. Component 0 and the bridge's own component stand for all nodes where that is
//! safe: all nodes can be saved at once, but not erased or restarted.

use crate::calls::{OPCODE_TIMEOUTS, Timeouts, Urgency};
use crate::forward::Forward;
use crate::message::{Command, Content, command, id as message_id, text};
use crate::node::Node;
use crate::post::{Asker, PeerId, To};
use crate::queue::Class;
use crate::state::{Rights, State};
use crate::task::Purpose;
use dronecan_host::{Message, NodeId, Opcode, RESTART_MAGIC, types};
use mavlink::dialects::common::MavResult;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

const RESTART_TIMEOUTS: Timeouts = Timeouts::from_ms(1000, 2000);
/// Maximum number of commands in progress; more are rejected.
const PENDING_MAX: usize = 64;

const ACCEPTED: MavResult = MavResult::MAV_RESULT_ACCEPTED;
const REJECTED: MavResult = MavResult::MAV_RESULT_TEMPORARILY_REJECTED;
const DENIED: MavResult = MavResult::MAV_RESULT_DENIED;
const UNSUPPORTED: MavResult = MavResult::MAV_RESULT_UNSUPPORTED;
const FAILED: MavResult = MavResult::MAV_RESULT_FAILED;
const IN_PROGRESS: MavResult = MavResult::MAV_RESULT_IN_PROGRESS;

/// A command that waits for answers of nodes.
#[derive(Clone, Debug, PartialEq)]
struct Pending {
    asker: Asker,
    /// The component that the command was for, which acknowledges it.
    component: u8,
    command: Command,
    waiting_for: BTreeSet<NodeId>,
    failed: bool,
}

/// The commands in progress, each with its own number.
#[derive(Default)]
pub struct Commands {
    pending: BTreeMap<u32, Pending>,
    next: u32,
}

/// The nodes that a command is for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Target {
    /// The bridge, or all.
    Bridge,
    Node(NodeId),
}

impl Commands {
    pub fn command(
        &mut self,
        state: &mut State,
        forward: &mut Forward,
        now: Duration,
        asker: Asker,
        component: u8,
        command: Command,
    ) {
        // If the bridge's component ID is the ID of a node that is online, commands that only a
        // node can execute are for that node.
        let same = NodeId::new(component).filter(|id| state.nodes.contains_key(id));
        let target = match NodeId::new(component) {
            _ if component == state.settings.component
                && same.is_some()
                && is_for_one_node(&command) =>
            {
                same.map_or(Target::Bridge, Target::Node)
            }
            _ if component == 0 || component == state.settings.component => Target::Bridge,
            Some(id) if state.nodes.contains_key(&id) && !state.is_other_component(component) => {
                Target::Node(id)
            }
            // Another component of this system may answer it.
            _ => return,
        };
        let component = match target {
            Target::Bridge => state.settings.component,
            Target::Node(id) => id.get(),
        };
        if self.is_in_progress(&asker, component, &command) {
            return acknowledge(state, asker, component, command.number, IN_PROGRESS);
        }
        // Stations send integers as floats. Other values become 0, which no command uses.
        let param = |at: usize| {
            if command.params[at].fract() == 0.0 { command.params[at] as i64 } else { 0 }
        };
        if let Some(why) = why_not_allowed(state.settings.rights, command.number) {
            return deny(state, asker, component, command, why);
        }
        let result = match command.number {
            command::UAVCAN_GET_NODE_INFO => {
                // For any target: MAVLink's chapter on UAVCAN requires one for every known node.
                let is_known = |node: &Node| node.is_online || node.info.known.is_some();
                let nodes = state
                    .nodes
                    .iter()
                    .filter(|(_, node)| is_known(node))
                    .map(|(id, _)| *id)
                    .collect();
                return self.send_infos(state, now, asker, component, command, nodes);
            }
            command::REQUEST_MESSAGE => {
                return self.request_message(state, now, asker, target, component, command);
            }
            command::REQUEST_AUTOPILOT_CAPABILITIES => {
                acknowledge(state, asker, component, command.number, ACCEPTED);
                return post_capabilities(state, asker, target);
            }
            command::REQUEST_PROTOCOL_VERSION => UNSUPPORTED,
            command::CAN_FORWARD => forward.subscribe(state, now, asker, param(0)),
            command::PREFLIGHT_STORAGE => {
                return self.storage(state, asker, target, component, command);
            }
            command::PREFLIGHT_REBOOT_SHUTDOWN => {
                return self.reboot(state, asker, target, component, command);
            }
            _ => UNSUPPORTED,
        };
        acknowledge(state, asker, component, command.number, result);
    }

    fn is_in_progress(&self, asker: &Asker, component: u8, command: &Command) -> bool {
        // Some stations use NaN for "not given", and NaN is not equal to itself.
        let bits = |command: &Command| command.params.map(f32::to_bits);
        self.pending.values().any(|pending| {
            (pending.asker.peer, pending.asker.from, pending.component)
                == (asker.peer, asker.from, component)
                && (pending.command.number, bits(&pending.command))
                    == (command.number, bits(command))
        })
    }

    /// Sends UAVCAN_NODE_INFO of these nodes, at once or when they have answered.
    fn send_infos(
        &mut self,
        state: &mut State,
        now: Duration,
        asker: Asker,
        component: u8,
        command: Command,
        nodes: Vec<NodeId>,
    ) {
        if nodes.is_empty() {
            return fail(state, asker, component, command, "No node is online");
        }
        let (known, unknown): (Vec<_>, Vec<_>) =
            nodes.into_iter().partition(|id| state.nodes[id].info.known.is_some());
        for id in known {
            state.post_info(now, id, To::One(asker.peer));
        }
        if unknown.is_empty() {
            return acknowledge(state, asker, component, command.number, ACCEPTED);
        }
        let Some(ticket) = self.begin(state, asker, component, command, &unknown) else { return };
        for id in unknown {
            state.request_info(id);
            if let Some(node) = state.nodes.get_mut(&id) {
                node.info.waiting.push(ticket);
            }
        }
    }

    fn request_message(
        &mut self,
        state: &mut State,
        now: Duration,
        asker: Asker,
        target: Target,
        component: u8,
        command: Command,
    ) {
        let number = command.params[0] as u32;
        // Parameter 2 may also name a node.
        let named = NodeId::new(command.params[1] as u8).filter(|id| state.nodes.contains_key(id));
        let nodes: Vec<NodeId> = match (target, named) {
            (Target::Node(id), _) | (Target::Bridge, Some(id)) => vec![id],
            (Target::Bridge, None) => state.online_nodes().collect(),
        };
        match number {
            message_id::NODE_INFO => self.send_infos(state, now, asker, component, command, nodes),
            message_id::NODE_STATUS if !nodes.is_empty() => {
                acknowledge(state, asker, component, command.number, ACCEPTED);
                for id in nodes {
                    let status = state.nodes[&id].status;
                    let content = state.status_content(now, &status);
                    state.post(To::One(asker.peer), Class::Answer, id.get(), content);
                }
            }
            // There is no node to report.
            message_id::NODE_STATUS => {
                acknowledge(state, asker, component, command.number, FAILED);
            }
            message_id::AUTOPILOT_VERSION => {
                acknowledge(state, asker, component, command.number, ACCEPTED);
                post_capabilities(state, asker, target);
            }
            message_id::HEARTBEAT => {
                acknowledge(state, asker, component, command.number, ACCEPTED);
                let node = match target {
                    Target::Bridge => None,
                    Target::Node(id) => Some(id),
                };
                let heartbeat = state.heartbeat(node);
                state.post(To::One(asker.peer), Class::Answer, component, Content::from(heartbeat));
            }
            _ => acknowledge(state, asker, component, command.number, DENIED),
        }
    }

    /// MAV_CMD_PREFLIGHT_STORAGE. Parameter 1: 1 saves; 2 to 4 reset to the defaults.
    fn storage(
        &mut self,
        state: &mut State,
        asker: Asker,
        target: Target,
        component: u8,
        command: Command,
    ) {
        let opcode = match (command.params[0], target) {
            (1.0, _) => Opcode::SAVE,
            (2.0 | 3.0 | 4.0, Target::Node(_)) => Opcode::ERASE,
            (2.0 | 3.0 | 4.0, Target::Bridge) => {
                return deny(
                    state,
                    asker,
                    component,
                    command,
                    "Erase one node at a time: address its component",
                );
            }
            // DroneCAN has no service to read back the saved parameters.
            _ => return acknowledge(state, asker, component, command.number, DENIED),
        };
        let nodes: Vec<NodeId> = match target {
            Target::Node(id) => vec![id],
            Target::Bridge => {
                state.online_nodes().filter(|id| !state.is_other_component(id.get())).collect()
            }
        };
        if nodes.is_empty() {
            return fail(state, asker, component, command, "No node is online");
        }
        let Some(ticket) = self.begin(state, asker, component, command, &nodes) else { return };
        for id in nodes {
            let purpose = Purpose::Opcode(ticket);
            state.calls.request(
                id,
                types::EXECUTE_OPCODE,
                opcode.encode(),
                OPCODE_TIMEOUTS,
                Urgency::Now,
                purpose,
            );
        }
    }

    /// MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN. Either parameter 1 is 1 and the target is the node, or
    /// parameter 3 is 1 and parameter 4 is the node's component.
    fn reboot(
        &mut self,
        state: &mut State,
        asker: Asker,
        target: Target,
        component: u8,
        command: Command,
    ) {
        let [whole, _, part, which, ..] = command.params;
        let node = match (target, whole, part) {
            (Target::Node(id), 1.0, _) => Some(id),
            (_, 0.0, 1.0) => NodeId::new(which as u8).filter(|id| state.nodes.contains_key(id)),
            _ => None,
        };
        let Some(id) = node else {
            return deny(
                state,
                asker,
                component,
                command,
                "Restart one node at a time: address its component",
            );
        };
        let Some(ticket) = self.begin(state, asker, component, command, &[id]) else { return };
        let payload = Message::RestartNode(RESTART_MAGIC)
            .encode()
            .map(|(_, payload)| payload)
            .unwrap_or_default();
        state.calls.request(
            id,
            types::RESTART_NODE,
            payload,
            RESTART_TIMEOUTS,
            Urgency::Now,
            Purpose::Restart(ticket),
        );
    }

    /// Registers a command that nodes must answer. If too many are in progress, rejects the command
    /// and returns `None`.
    fn begin(
        &mut self,
        state: &mut State,
        asker: Asker,
        component: u8,
        command: Command,
        nodes: &[NodeId],
    ) -> Option<u32> {
        if self.pending.len() >= PENDING_MAX {
            acknowledge(state, asker, component, command.number, REJECTED);
            return None;
        }
        let ticket = self.next;
        self.next = self.next.wrapping_add(1);
        let waiting_for = nodes.iter().copied().collect();
        self.pending
            .insert(ticket, Pending { asker, component, command, waiting_for, failed: false });
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
            let (peer, component) = (pending.asker.peer, pending.component);
            state.post(
                To::One(peer),
                Class::Text,
                component,
                Content::from(text(&format!("Node {id} {why}"))),
            );
        }
        if pending.waiting_for.is_empty()
            && let Some(pending) = self.pending.remove(&ticket)
        {
            let result = if pending.failed { FAILED } else { ACCEPTED };
            acknowledge(state, pending.asker, pending.component, pending.command.number, result);
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
                let saves = self
                    .pending
                    .get(&ticket)
                    .is_none_or(|pending| pending.command.params[0] == 1.0);
                state.log.push(format!(
                    "node {id}: {}: {outcome}",
                    if saves { "save" } else { "erase" }
                ));
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
        for purpose in
            state.calls.remove_requests(id, |purpose| matches!(purpose, Purpose::Restart(_)))
        {
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
        self.pending.retain(|_, pending| pending.asker.peer != peer);
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

fn acknowledge(state: &mut State, asker: Asker, component: u8, number: u16, result: MavResult) {
    let content = Content::Ack { command: number, result, to: asker.from };
    state.post(To::One(asker.peer), Class::Answer, component, content);
}

fn fail(state: &mut State, asker: Asker, component: u8, command: Command, why: &str) {
    acknowledge(state, asker, component, command.number, FAILED);
    state.post(To::One(asker.peer), Class::Text, component, Content::from(text(why)));
}

fn deny(state: &mut State, asker: Asker, component: u8, command: Command, why: &str) {
    acknowledge(state, asker, component, command.number, DENIED);
    state.post(To::One(asker.peer), Class::Text, component, Content::from(text(why)));
}

/// Major and minor version of the bridge.
fn own_version() -> (u8, u8) {
    let number = |digits: &str| digits.parse().expect("cargo writes numbers");
    (number(env!("CARGO_PKG_VERSION_MAJOR")), number(env!("CARGO_PKG_VERSION_MINOR")))
}

/// AUTOPILOT_VERSION. Its capabilities say how integers are encoded.
fn post_capabilities(state: &mut State, asker: Asker, target: Target) {
    let (component, (major, minor), unique_id) = match target {
        Target::Node(id) => {
            let known = state.nodes[&id].info.known.as_ref();
            (
                id.get(),
                known.map_or((0, 0), |info| info.software),
                known.map_or([0; 16], |info| info.unique_id),
            )
        }
        Target::Bridge => (state.settings.component, own_version(), state.settings.unique_id),
    };
    let software = u32::from(major) << 24 | u32::from(minor) << 16;
    let content = Content::Capabilities { software, unique_id };
    state.post(To::One(asker.peer), Class::Answer, component, content);
}
