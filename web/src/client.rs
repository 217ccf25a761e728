//! A tool on the simulated bus, and its [`Dialogue`] with the node. It sends NodeStatus, as
//! each node does.

use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;

use bench::can::{Id, SoftNode, StationRef};
use bench::dronecan::{
    Assembler, CanId, Message, NodeId, NodeStatus, Outcome, TransferId, frames, types,
};
use bench::{Cycles, F_CPU_HZ, elapsed};

use crate::dialogue::Dialogue;

/// Node ID of the tool: the highest, which DroneCAN reserves for tools.
const TOOL: u8 = 127;
/// Priorities of services, commands and NodeStatus, as in DroneCAN's own tools.
const SERVICE_PRIORITY: u8 = 16;
const COMMAND_PRIORITY: u8 = 16;
const STATUS_PRIORITY: u8 = 20;
const STATUS_PERIOD: Cycles = F_CPU_HZ;

/// What the tool knows and does.
pub struct Client {
    station: Rc<RefCell<SoftNode>>,
    assembler: Assembler,
    transfer_ids: HashMap<u16, TransferId>,
    status_transfer_id: TransferId,
    next_status_at: Cycles,
    node: NodeId,
    pub dialogue: Dialogue,
}

impl Client {
    /// A tool for the node with the ID `node`.
    pub fn new(node: NodeId, bit_rate: u32) -> Client {
        Client {
            station: Rc::new(RefCell::new(SoftNode::new(bit_rate))),
            assembler: Assembler::new(),
            transfer_ids: HashMap::new(),
            status_transfer_id: TransferId::default(),
            next_status_at: F_CPU_HZ / 4,
            node,
            dialogue: Dialogue::default(),
        }
    }

    /// The station of the tool, to attach to a bus.
    pub fn station(&self) -> StationRef {
        self.station.clone()
    }

    /// The node to which the tool sends requests.
    pub fn node(&self) -> NodeId {
        self.node
    }

    /// Sends the next requests to another node.
    pub fn set_node(&mut self, node: NodeId) {
        self.node = node;
    }

    /// Sends a message to all nodes.
    pub fn broadcast(&mut self, message: &Message) {
        let Some((data_type, payload)) = message.encode() else { return };
        let transfer_id = self.transfer_ids.entry(data_type.id).or_default().advance();
        self.send(data_type.message_id(COMMAND_PRIORITY, own_id()), &payload, transfer_id);
    }

    /// Takes received frames, and sends what is due at `now`.
    pub fn serve(&mut self, now: Cycles) {
        let received = self.station.borrow_mut().take_received();
        for (at, frame) in received {
            let Id::Extended(id) = frame.id else { continue };
            if let Outcome::Complete(transfer) = self.assembler.push(id, frame.data(), elapsed(at))
                && let CanId::Service { destination, source, .. } = transfer.id
                && (destination.get(), source) == (TOOL, self.node)
            {
                self.dialogue.take(&transfer);
            }
        }
        if now >= self.next_status_at {
            self.next_status_at += STATUS_PERIOD;
            let uptime_s = (now / F_CPU_HZ) as u32;
            let status = NodeStatus { uptime_s, ..NodeStatus::default() };
            let id = types::NODE_STATUS.message_id(STATUS_PRIORITY, own_id());
            let transfer_id = self.status_transfer_id.advance();
            self.send(id, &status.encode(), transfer_id);
        }
        if let Some(message) = self.dialogue.poll(elapsed(now)) {
            let transfer_id = self.ask(&message);
            self.dialogue.sent(transfer_id);
        }
    }

    fn ask(&mut self, message: &Message) -> Option<TransferId> {
        let (data_type, payload) = message.encode()?;
        let id = CanId::Service {
            priority: SERVICE_PRIORITY,
            service_id: data_type.id as u8,
            request: true,
            destination: self.node,
            source: own_id(),
        };
        let transfer_id = self.transfer_ids.entry(data_type.id).or_default().advance();
        self.send(id, &payload, transfer_id);
        Some(transfer_id)
    }

    fn send(&mut self, id: CanId, payload: &[u8], transfer_id: TransferId) {
        let mut station = self.station.borrow_mut();
        for frame in frames(id, payload, transfer_id) {
            station.send(frame);
        }
    }
}

fn own_id() -> NodeId {
    NodeId::new(TOOL).expect("a node ID")
}
