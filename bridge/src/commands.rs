//! Commands: COMMAND_LONG and COMMAND_INT, each answered by COMMAND_ACK to whom it came from.
//!
//! What a node has to do is acknowledged when the node has answered. A command that comes again meanwhile, as they do, is
//! answered with IN_PROGRESS and not done twice. To component 0, or the bridge itself, all nodes are meant where that does no
//! harm: they can all be saved at once, but not erased or restarted.

use crate::calls::Patience;
use crate::core::{Asker, Bridge, To};
use crate::message::{Command, Content, command, id as message_id, text};
use crate::parameters::Purpose;
use crate::queue::Class;
use dronecan_host::{Message, NodeId, Opcode, RESTART_MAGIC, types};
use mavlink::dialects::common::MavResult;
use std::collections::BTreeSet;
use std::time::Duration;

/// Long: a small node writes all of its memory.
pub const OPCODE_PATIENCE: Patience = Patience::new(1500, 2);
const RESTART_PATIENCE: Patience = Patience::new(1000, 2);
/// Under way at once; more are rejected.
const PENDING_MAX: usize = 64;

const ACCEPTED: MavResult = MavResult::MAV_RESULT_ACCEPTED;
const REJECTED: MavResult = MavResult::MAV_RESULT_TEMPORARILY_REJECTED;
const DENIED: MavResult = MavResult::MAV_RESULT_DENIED;
const UNSUPPORTED: MavResult = MavResult::MAV_RESULT_UNSUPPORTED;
const FAILED: MavResult = MavResult::MAV_RESULT_FAILED;
const IN_PROGRESS: MavResult = MavResult::MAV_RESULT_IN_PROGRESS;

/// A command that nodes have to answer first.
#[derive(Clone, Debug, PartialEq)]
pub struct Pending {
    asker: Asker,
    /// The component that it was for, which acknowledges it.
    component: u8,
    command: Command,
    waiting_for: BTreeSet<NodeId>,
    failed: bool,
}

/// Whom a command is for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Target {
    /// The bridge, or everybody.
    Bridge,
    Node(NodeId),
}

impl Bridge {
    pub(crate) fn command(&mut self, now: Duration, asker: Asker, component: u8, command: Command) {
        let target = match NodeId::new(component) {
            _ if component == 0 || component == self.settings.component => Target::Bridge,
            Some(id) if self.nodes.contains_key(&id) => Target::Node(id),
            // Somebody else's: there may be other components in this system.
            _ => return,
        };
        let component = match target {
            Target::Bridge => self.settings.component,
            Target::Node(id) => id.get(),
        };
        if self.is_under_way(&asker, component, &command) {
            return self.acknowledge(asker, component, command.number, IN_PROGRESS);
        }
        // Whole numbers that came as floats; what is none is 0, which is no choice of any command.
        let param = |at: usize| if command.params[at].fract() == 0.0 { command.params[at] as i64 } else { 0 };
        let result = match command.number {
            command::UAVCAN_GET_NODE_INFO => self.get_node_info(now, asker, target),
            command::REQUEST_MESSAGE => return self.request_message(now, asker, target, component, command),
            command::REQUEST_AUTOPILOT_CAPABILITIES => {
                self.acknowledge(asker, component, command.number, ACCEPTED);
                return self.post_capabilities(asker, target);
            }
            command::REQUEST_PROTOCOL_VERSION => UNSUPPORTED,
            command::CAN_FORWARD => self.subscribe(now, asker, param(0)),
            command::PREFLIGHT_STORAGE => return self.storage(asker, target, component, command),
            command::PREFLIGHT_REBOOT_SHUTDOWN => return self.reboot(asker, target, component, command),
            _ => UNSUPPORTED,
        };
        self.acknowledge(asker, component, command.number, result);
    }

    fn is_under_way(&self, asker: &Asker, component: u8, command: &Command) -> bool {
        // NaN stands for "not given" in some stations, and is not equal to itself.
        let bits = |command: &Command| command.params.map(f32::to_bits);
        self.commands.values().any(|pending| {
            (pending.asker.peer, pending.asker.from, pending.component) == (asker.peer, asker.from, component)
                && (pending.command.number, bits(&pending.command)) == (command.number, bits(command))
        })
    }

    fn acknowledge(&mut self, asker: Asker, component: u8, number: u16, result: MavResult) {
        let content = Content::Ack { command: number, result, to: asker.from };
        self.post(To::One(asker.peer), Class::Answer, component, content);
    }

    /// For each known node that is there, once: now if it has said who it is, else when it has.
    fn get_node_info(&mut self, now: Duration, asker: Asker, target: Target) -> MavResult {
        let nodes: Vec<NodeId> = match target {
            Target::Bridge => self.online().collect(),
            Target::Node(id) => vec![id],
        };
        for id in nodes {
            if self.nodes[&id].info.known.is_some() {
                self.post_info(now, id, To::One(asker.peer));
            } else {
                self.ask_who_it_is(id);
            }
        }
        ACCEPTED
    }

    fn request_message(&mut self, now: Duration, asker: Asker, target: Target, component: u8, command: Command) {
        let number = command.params[0] as u32;
        // Parameter 2 may name a node too.
        let named = NodeId::new(command.params[1] as u8).filter(|id| self.nodes.contains_key(id));
        let nodes: Vec<NodeId> = match (target, named) {
            (Target::Node(id), _) | (Target::Bridge, Some(id)) => vec![id],
            (Target::Bridge, None) => self.online().collect(),
        };
        match number {
            message_id::NODE_INFO if !nodes.is_empty() => {
                let (known, unknown): (Vec<_>, Vec<_>) =
                    nodes.into_iter().partition(|id| self.nodes[id].info.known.is_some());
                for id in known {
                    self.post_info(now, id, To::One(asker.peer));
                }
                let Some(ticket) = self.begin(asker, component, command, &unknown) else { return };
                for id in unknown {
                    self.ask_who_it_is(id);
                    if let Some(node) = self.nodes.get_mut(&id) {
                        node.info.waiting.push(ticket);
                    }
                }
            }
            message_id::NODE_STATUS if !nodes.is_empty() => {
                self.acknowledge(asker, component, command.number, ACCEPTED);
                for id in nodes {
                    let status = self.nodes[&id].status;
                    let content = self.status_content(now, &status);
                    self.post(To::One(asker.peer), Class::Answer, id.get(), content);
                }
            }
            // Nobody is there to tell of.
            message_id::NODE_INFO | message_id::NODE_STATUS => {
                self.acknowledge(asker, component, command.number, FAILED);
            }
            message_id::AUTOPILOT_VERSION => {
                self.acknowledge(asker, component, command.number, ACCEPTED);
                self.post_capabilities(asker, target);
            }
            message_id::HEARTBEAT => {
                self.acknowledge(asker, component, command.number, ACCEPTED);
                let node = match target {
                    Target::Bridge => None,
                    Target::Node(id) => Some(id),
                };
                let heartbeat = self.heartbeat(node);
                self.post(To::One(asker.peer), Class::Answer, component, Content::from(heartbeat));
            }
            _ => self.acknowledge(asker, component, command.number, DENIED),
        }
    }

    /// AUTOPILOT_VERSION, which is also how one learns in what way integers are written.
    fn post_capabilities(&mut self, asker: Asker, target: Target) {
        let (component, (major, minor), unique_id) = match target {
            Target::Node(id) => {
                let known = self.nodes[&id].info.known.as_ref();
                (id.get(), known.map_or((0, 0), |info| info.software), known.map_or([0; 16], |info| info.unique_id))
            }
            Target::Bridge => (self.settings.component, (0, 1), self.settings.unique_id),
        };
        let [uid @ .., _, _, _, _, _, _, _, _] = unique_id;
        let software = u32::from(major) << 24 | u32::from(minor) << 16;
        let content = Content::Capabilities { software, uid: u64::from_le_bytes(uid) };
        self.post(To::One(asker.peer), Class::Answer, component, content);
    }

    /// MAV_CMD_PREFLIGHT_STORAGE. Parameter 1: 1 saves, 2 to 4 are the ways to get defaults back.
    fn storage(&mut self, asker: Asker, target: Target, component: u8, command: Command) {
        let opcode = match (command.params[0], target) {
            (1.0, _) => Opcode::SAVE,
            (2.0 | 3.0 | 4.0, Target::Node(_)) => Opcode::ERASE,
            (2.0 | 3.0 | 4.0, Target::Bridge) => {
                return self.deny(asker, component, command, "Erase one node at a time: address its component");
            }
            // Reading back what was saved is no service of the bus.
            _ => return self.acknowledge(asker, component, command.number, DENIED),
        };
        let nodes: Vec<NodeId> = match target {
            Target::Node(id) => vec![id],
            Target::Bridge => self.online().collect(),
        };
        let Some(ticket) = self.begin(asker, component, command, &nodes) else { return };
        for id in nodes {
            let purpose = Purpose::Opcode(ticket);
            self.calls.request(id, types::EXECUTE_OPCODE, opcode.encode(), OPCODE_PATIENCE, purpose);
        }
    }

    /// MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: parameter 1 is 1 to the node itself; or 3 is 1, and 4 is its component.
    fn reboot(&mut self, asker: Asker, target: Target, component: u8, command: Command) {
        let [whole, _, part, which, ..] = command.params;
        let node = match (target, whole, part) {
            (Target::Node(id), 1.0, _) => Some(id),
            (_, 0.0, 1.0) => NodeId::new(which as u8).filter(|id| self.nodes.contains_key(id)),
            _ => None,
        };
        let Some(id) = node else {
            return self.deny(asker, component, command, "Restart one node at a time: address its component");
        };
        let Some(ticket) = self.begin(asker, component, command, &[id]) else { return };
        let payload = Message::RestartNode(RESTART_MAGIC).encode().map(|(_, payload)| payload).unwrap_or_default();
        self.calls.request(id, types::RESTART_NODE, payload, RESTART_PATIENCE, Purpose::Restart(ticket));
    }

    fn deny(&mut self, asker: Asker, component: u8, command: Command, why: &str) {
        self.acknowledge(asker, component, command.number, DENIED);
        self.post(To::One(asker.peer), Class::Text, component, Content::from(text(why)));
    }

    /// Notes that nodes have to answer; `None` if none has to, or if too much is under way, which is acknowledged.
    fn begin(&mut self, asker: Asker, component: u8, command: Command, nodes: &[NodeId]) -> Option<u32> {
        if nodes.is_empty() || self.commands.len() >= PENDING_MAX {
            let result = if nodes.is_empty() { ACCEPTED } else { REJECTED };
            self.acknowledge(asker, component, command.number, result);
            return None;
        }
        let ticket = self.next_command;
        self.next_command = self.next_command.wrapping_add(1);
        let waiting_for = nodes.iter().copied().collect();
        self.commands.insert(ticket, Pending { asker, component, command, waiting_for, failed: false });
        Some(ticket)
    }

    /// A node has done its part of a command, or has not.
    pub(crate) fn command_done(&mut self, ticket: u32, id: NodeId, done: bool) {
        let Some(pending) = self.commands.get_mut(&ticket) else { return };
        if !pending.waiting_for.remove(&id) {
            return;
        }
        pending.failed |= !done;
        if pending.waiting_for.is_empty()
            && let Some(pending) = self.commands.remove(&ticket)
        {
            let result = if pending.failed { FAILED } else { ACCEPTED };
            self.acknowledge(pending.asker, pending.component, pending.command.number, result);
        }
    }

    /// A node has answered ExecuteOpcode or RestartNode, or has not.
    pub(crate) fn command_answer(&mut self, id: NodeId, purpose: Purpose, payload: Option<&[u8]>) {
        // Both answers have their "ok" in the uppermost bit of the last byte.
        let ok = payload.and_then(<[u8]>::last).is_some_and(|byte| byte & 1 << 7 != 0);
        let said = match payload {
            None => "does not answer",
            Some(_) if ok => "done",
            Some(_) => "refused",
        };
        match purpose {
            Purpose::Opcode(ticket) => {
                let saves = self.commands.get(&ticket).is_none_or(|pending| pending.command.params[0] == 1.0);
                self.log.push(format!("node {id}: {}: {said}", if saves { "save" } else { "erase" }));
                self.command_done(ticket, id, ok);
            }
            Purpose::Restart(ticket) => {
                self.log.push(format!("node {id}: restart: {said}"));
                self.command_done(ticket, id, ok);
            }
            Purpose::Autosave => self.log.push(format!("node {id}: saved by itself: {said}")),
            _ => {}
        }
    }

    /// A node has restarted: a command that wanted that is done, even if its answer was lost.
    pub(crate) fn restarted(&mut self, id: NodeId) {
        for purpose in self.calls.take_back(id, |purpose| matches!(purpose, Purpose::Restart(_))) {
            if let Purpose::Restart(ticket) = purpose {
                self.command_done(ticket, id, true);
            }
        }
    }

    /// Nothing that this station wanted is of use any more.
    pub(crate) fn drop_commands_of(&mut self, peer: u32) {
        self.commands.retain(|_, pending| pending.asker.peer != peer);
    }
}
