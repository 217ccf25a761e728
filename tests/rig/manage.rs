//! The rig as a management tool: sends requests to the node and reads its answers.

use super::{MS, NODE, Rig, by_node_clock, parse_frames};
use bench::Cycles;
use bench::can::{Frame, Id};
use bench::dronecan::{
    CanId, Message, NodeId, NodeInfo, Opcode, ParameterRequest, ParameterResponse, RESTART_MAGIC,
    TransferId, Value, frames,
};

/// Node ID of the tool.
pub const TOOL: u8 = 127;
/// Priority of a GUI tool's requests.
const PRIORITY: u8 = 30;
/// Limit of the time from a request to its answer while the node has little other work.
pub const ANSWER_TIMEOUT_MS: u64 = 50;
/// Limit for an answer that follows a write to the EEPROM. Clients wait for a second.
pub const SAVE_TIMEOUT_MS: u64 = 1000;

impl Rig {
    /// The tool sends a request and does not wait. Returns the transfer ID.
    pub fn request(&mut self, request: &Message) -> TransferId {
        self.request_to(NODE as u8, request)
    }

    /// Like [`Rig::request`] to this node.
    pub fn request_to(&mut self, node: u8, request: &Message) -> TransferId {
        let transfer_id = TransferId::new(Self::next_transfer_id(&mut self.request_transfer_id));
        let (data_type, payload) = request.encode().expect("a request");
        let id = CanId::Service {
            priority: PRIORITY,
            service_id: data_type.id as u8,
            request: true,
            destination: NodeId::new(node).expect("a node ID"),
            source: NodeId::new(TOOL).expect("a node ID"),
        };
        for frame in frames(id, &payload, transfer_id) {
            self.send(id.build(), frame.data());
        }
        transfer_id
    }

    /// All answers to the tool in the record.
    pub fn answers(&self) -> Vec<(Cycles, TransferId, Message)> {
        let to_tool = |id: &CanId| {
            matches!(
                id,
                CanId::Service { request: false, destination, .. } if destination.get() == TOOL
            )
        };
        let answers = self.transfers.iter().filter(|(_, transfer)| to_tool(&transfer.id));
        answers
            .map(|(at, transfer)| (*at, transfer.transfer_id, Message::decode(transfer)))
            .collect()
    }

    /// Sends a request and waits for the answer.
    #[track_caller]
    pub fn ask(&mut self, request: &Message) -> Message {
        self.ask_for(request, ANSWER_TIMEOUT_MS)
    }

    #[track_caller]
    fn ask_for(&mut self, request: &Message, timeout_ms: u64) -> Message {
        let seen = self.answers().len();
        let number = self.request(request);
        self.wait_for(&format!("answer to {request}"), timeout_ms, |rig| {
            rig.answers().len() > seen
        });
        let (_, transfer_id, answer) = self.answers().remove(seen);
        assert_eq!(transfer_id, number, "the answer has the number of the request");
        answer
    }

    #[track_caller]
    fn ask_for_parameter(&mut self, request: ParameterRequest) -> ParameterResponse {
        match self.ask(&Message::ParameterRequest(request)) {
            Message::ParameterResponse(response) => response,
            other => panic!("{other}"),
        }
    }

    /// Reads the parameter with this index. The name in the answer is empty if the index is beyond
    /// the last parameter.
    #[track_caller]
    pub fn parameter_at(&mut self, index: u16) -> ParameterResponse {
        self.ask_for_parameter(ParameterRequest { index, ..ParameterRequest::default() })
    }

    /// Reads a parameter by name: value, default and limits.
    #[track_caller]
    pub fn parameter(&mut self, name: &str) -> ParameterResponse {
        self.ask_for_parameter(ParameterRequest {
            name: name.into(),
            ..ParameterRequest::default()
        })
    }

    /// Reads the value of a parameter.
    #[track_caller]
    pub fn get(&mut self, name: &str) -> i64 {
        integer(&self.parameter(name).value)
    }

    /// Sends a GetSet request with a value. Returns the value in the answer.
    #[track_caller]
    pub fn request_value(&mut self, name: &str, value: Value) -> Value {
        let response =
            self.ask_for_parameter(ParameterRequest { index: 0, value, name: name.into() });
        assert_eq!(response.name(), name);
        response.value
    }

    /// Sets a parameter. Panics if the node answers another value.
    #[track_caller]
    pub fn set(&mut self, name: &str, value: i64) {
        assert_eq!(
            self.request_value(name, Value::Integer(value)),
            Value::Integer(value),
            "{name}"
        );
    }

    /// Like [`Rig::set`] for each of these, in order.
    #[track_caller]
    pub fn set_all(&mut self, values: &[(&str, i64)]) {
        for (name, value) in values {
            self.set(name, *value);
        }
    }

    /// Reads the names and values of all parameters, in order.
    #[track_caller]
    pub fn parameters(&mut self) -> Vec<(String, i64)> {
        let mut all = Vec::new();
        loop {
            let response = self.parameter_at(all.len() as u16);
            if response.name.is_empty() {
                return all;
            }
            all.push((response.name(), integer(&response.value)));
        }
    }

    /// Executes an opcode. Returns true if the node reports success.
    #[track_caller]
    pub fn execute(&mut self, opcode: Opcode) -> bool {
        match self.ask_for(&Message::ExecuteOpcode(opcode), SAVE_TIMEOUT_MS) {
            Message::OpcodeExecuted(ok) => ok,
            other => panic!("{other}"),
        }
    }

    /// Saves the parameters.
    #[track_caller]
    pub fn save(&mut self) {
        assert!(self.execute(Opcode::SAVE));
    }

    /// Restarts the node over the bus and waits for its first status.
    #[track_caller]
    pub fn restart(&mut self) {
        assert_eq!(self.ask(&Message::RestartNode(RESTART_MAGIC)), Message::Restarting(true));
        self.forget();
        self.wait_for_line("reset:", 400);
        self.wait_until_up();
    }

    /// Reads the node's GetNodeInfo answer.
    #[track_caller]
    pub fn information(&mut self) -> NodeInfo {
        match self.ask(&Message::NodeInfoRequest) {
            Message::NodeInfo(info) => *info,
            other => panic!("{other}"),
        }
    }

    /// Sends the quoted frames and checks that the node answers the tool with exactly the quoted
    /// ones.
    #[track_caller]
    pub fn assert_answer(&mut self, request: &str, answer: &str) {
        self.forget();
        for frame in parse_frames(request) {
            self.send_frame(frame);
        }
        let expected = parse_frames(answer);
        let wait_ms = if request.contains("0AF8") { SAVE_TIMEOUT_MS } else { ANSWER_TIMEOUT_MS };
        self.wait_for(&format!("answer to {request}"), wait_ms, |rig| {
            rig.to_tool().len() >= expected.len()
        });
        self.run_ms(5);
        let heard = self.to_tool();
        let text =
            |frames: &[Frame]| frames.iter().map(|frame| frame.to_string()).collect::<Vec<_>>();
        assert_eq!(text(&heard), text(&expected), "answer to {request}");
    }

    /// Frames of services to the tool, oldest first.
    pub fn to_tool(&self) -> Vec<Frame> {
        let is_to_tool =
            |id: u32| id & 0x80FF == 0x0080 | NODE && id & 0x7F00 == u32::from(TOOL) << 8;
        let frames = self.traffic.iter().map(|(_, frame)| *frame);
        frames.filter(|frame| matches!(frame.id, Id::Extended(id) if is_to_tool(id))).collect()
    }

    /// Waits for the next NodeStatus. Returns its health and vendor-specific status code.
    #[track_caller]
    pub fn next_status(&mut self) -> (u8, u16) {
        let seen = self.statuses().len();
        self.wait_for("NodeStatus", 1100, |rig| rig.statuses().len() > seen);
        let (_, health, _, code) = super::status_fields(&self.statuses()[seen].1);
        (health, code)
    }

    /// Like [`Rig::next_status`] from the status in a GetNodeInfo answer, without waiting for the
    /// next NodeStatus.
    #[track_caller]
    pub fn status_now(&mut self) -> (u8, u16) {
        let status = self.information().status;
        (status.health as u8, status.vendor_code)
    }

    /// Broadcasts a message as node 10. Queues all frames at once.
    pub fn broadcast(&mut self, message: &Message, transfer_id: u8) {
        let (data_type, payload) = message.encode().expect("a message");
        let id = data_type.message_id(16, NodeId::new(10).expect("a node ID"));
        for frame in frames(id, &payload, TransferId::new(transfer_id)) {
            self.send(id.build(), frame.data());
        }
    }

    /// The node's messages, decoded, for which `pick` returns something.
    pub fn node_messages<T>(&self, pick: impl Fn(Message) -> Option<T>) -> Vec<(Cycles, T)> {
        let from_node =
            |id: &CanId| id.source().is_some_and(|source| u32::from(source.get()) == NODE);
        let transfers = self.transfers.iter().filter(|(_, transfer)| from_node(&transfer.id));
        transfers
            .filter_map(|(at, transfer)| Some((*at, pick(Message::decode(transfer))?)))
            .collect()
    }
}

/// The integer in a value. Panics if it is none.
#[track_caller]
pub fn integer(value: &Value) -> i64 {
    match value {
        Value::Integer(number) => *number,
        other => panic!("no integer: {other:?}"),
    }
}

/// Milliseconds between two times in cycles.
pub fn ms_between(from: Cycles, to: Cycles) -> f64 {
    by_node_clock(to.saturating_sub(from)) as f64 / MS as f64
}
