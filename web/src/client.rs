//! A tool on the bus: reads, sets, saves and erases parameters, and restarts a node, one request
//! after the other. It sends NodeStatus like any node.

use std::cell::RefCell;
use std::collections::{HashMap, VecDeque};
use std::rc::Rc;

use bench::can::{Id, SoftNode, StationRef};
use bench::dronecan::{
    Assembler, CanId, Message, NodeId, NodeInfo, NodeStatus, Opcode, Outcome, ParameterRequest,
    ParameterResponse, RESTART_MAGIC, TransferId, Value, frames, types,
};
use bench::{Cycles, F_CPU_HZ, elapsed};

/// Node ID of the tool: the highest, which DroneCAN reserves for tools.
const TOOL: u8 = 127;
/// Priorities of services, commands and NodeStatus, as in DroneCAN's own tools.
const SERVICE_PRIORITY: u8 = 16;
const COMMAND_PRIORITY: u8 = 16;
const STATUS_PRIORITY: u8 = 20;
const STATUS_PERIOD: Cycles = F_CPU_HZ;
/// Time without an answer after which a request is repeated. A SAVE of eight outputs is answered
/// after 0.95 s.
const ANSWER_TIMEOUT: Cycles = F_CPU_HZ * 3 / 2;
/// Requests are sent this often before the tool gives up.
const ATTEMPTS: u32 = 4;

/// A request that waits for its answer.
struct Pending {
    message: Message,
    transfer_id: TransferId,
    sent_at: Cycles,
    attempts: u32,
}

/// What the tool knows and does.
pub struct Client {
    station: Rc<RefCell<SoftNode>>,
    assembler: Assembler,
    transfer_ids: HashMap<u16, TransferId>,
    status_transfer_id: TransferId,
    next_status_at: Cycles,
    node: NodeId,
    queue: VecDeque<Message>,
    pending: Option<Pending>,
    /// True while the tool reads parameters by index, up to the first that does not exist.
    reads_all: bool,
    /// Parameters in the order of their indices.
    pub parameters: Vec<ParameterResponse>,
    pub info: Option<NodeInfo>,
    /// What happened last, in words; empty before the first request.
    pub message: String,
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
            queue: VecDeque::new(),
            pending: None,
            reads_all: false,
            parameters: Vec::new(),
            info: None,
            message: String::new(),
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

    /// True while a request waits for its answer, or to be sent.
    pub fn is_busy(&self) -> bool {
        self.pending.is_some() || !self.queue.is_empty()
    }

    /// Queues a request.
    pub fn request(&mut self, message: Message) {
        self.queue.push_back(message);
    }

    /// Reads the node's information and all its parameters.
    pub fn read_all(&mut self) {
        self.parameters.clear();
        self.reads_all = true;
        self.request(Message::NodeInfoRequest);
        self.request(read(0));
    }

    /// Sets a parameter.
    pub fn set(&mut self, name: &str, value: i64) {
        self.request(Message::ParameterRequest(ParameterRequest {
            value: Value::Integer(value),
            name: name.into(),
            ..ParameterRequest::default()
        }));
    }

    /// Saves all parameters, or erases the saved ones.
    pub fn execute(&mut self, opcode: Opcode) {
        self.request(Message::ExecuteOpcode(opcode));
    }

    /// Restarts the node.
    pub fn restart(&mut self) {
        self.request(Message::RestartNode(RESTART_MAGIC));
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
                && let CanId::Service { request: false, destination, source, .. } = transfer.id
                && (destination.get(), source) == (TOOL, self.node)
                && self.pending.as_ref().is_some_and(|p| p.transfer_id == transfer.transfer_id)
            {
                self.answer(Message::decode(&transfer));
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
        self.repeat(now);
        if self.pending.is_none()
            && let Some(message) = self.queue.pop_front()
        {
            self.ask(message, now, 1);
        }
    }

    fn repeat(&mut self, now: Cycles) {
        let is_late = |pending: &mut Pending| now - pending.sent_at >= ANSWER_TIMEOUT;
        let Some(pending) = self.pending.take_if(is_late) else { return };
        if pending.attempts < ATTEMPTS {
            self.ask(pending.message, now, pending.attempts + 1);
        } else {
            self.message = format!("no answer to {}", pending.message);
            self.queue.clear();
            self.reads_all = false;
        }
    }

    fn ask(&mut self, message: Message, sent_at: Cycles, attempts: u32) {
        let Some((data_type, payload)) = message.encode() else { return };
        let id = CanId::Service {
            priority: SERVICE_PRIORITY,
            service_id: data_type.id as u8,
            request: true,
            destination: self.node,
            source: own_id(),
        };
        let transfer_id = self.transfer_ids.entry(data_type.id).or_default().advance();
        self.send(id, &payload, transfer_id);
        self.pending = Some(Pending { message, transfer_id, sent_at, attempts });
    }

    fn send(&mut self, id: CanId, payload: &[u8], transfer_id: TransferId) {
        let mut station = self.station.borrow_mut();
        for frame in frames(id, payload, transfer_id) {
            station.send(frame);
        }
    }

    fn answer(&mut self, answer: Message) {
        let Some(Pending { message, .. }) = self.pending.take() else { return };
        self.message = answer.to_string();
        match (message, answer) {
            (Message::ParameterRequest(request), Message::ParameterResponse(response)) => {
                self.take_parameter(&request, response);
            }
            (_, Message::NodeInfo(info)) => self.info = Some(*info),
            _ => {}
        }
    }

    fn take_parameter(&mut self, request: &ParameterRequest, response: ParameterResponse) {
        if response.name.is_empty() {
            self.reads_all = false;
            self.message = format!("{} parameters read", self.parameters.len());
        } else if let Some(known) =
            self.parameters.iter_mut().find(|known| known.name == response.name)
        {
            if let Value::Integer(asked) = request.value
                && response.value != request.value
            {
                self.message = format!("{} is not {asked}: the node rejected it", response.name());
            }
            *known = response;
        } else {
            self.parameters.push(response);
            if self.reads_all {
                self.queue.push_front(read(request.index + 1));
            }
        }
    }
}

fn own_id() -> NodeId {
    NodeId::new(TOOL).expect("a node ID")
}

fn read(index: u16) -> Message {
    Message::ParameterRequest(ParameterRequest { index, ..ParameterRequest::default() })
}
