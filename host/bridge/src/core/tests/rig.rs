//! A bridge with simulated nodes and a ground station, with a simulated clock.

pub use super::super::*;
pub use crate::message::{Command, command};
pub use crate::number::{IntegerEncoding, Number};
pub use dronecan_host::{Message, Opcode, ParameterRequest, ParameterResponse, Value, frames};
pub use mavlink::dialects::common::{
    CAN_FRAME_DATA, MavMessage, MavParamError, MavResult, UAVCAN_NODE_INFO_DATA,
};
pub use std::collections::BTreeSet;

pub const STATION: Asker = Asker { peer: 1, from: (255, 190), encoding: IntegerEncoding::Bytewise };
pub const INT32: u8 = 6;

/// A simulated node that executes requests.
pub struct Simulated {
    pub id: NodeId,
    pub uptime_s: u32,
    pub parameters: Vec<ParameterResponse>,
    /// Number of received requests; every `n`th is lost.
    pub requests: u32,
    pub lose_every: Option<u32>,
    pub is_silent: bool,
    /// True if it rejects ExecuteOpcode.
    pub rejects_opcodes: bool,
    pub saved: u32,
    pub erased: u32,
    pub restarts: u32,
    pub info_requests: u32,
    pub assembler: Assembler,
}

impl Simulated {
    pub fn new(id: u8, count: usize) -> Simulated {
        let parameter = |at: usize| ParameterResponse {
            value: Value::Integer(at as i64 * 10),
            min: Value::Integer(0),
            max: Value::Integer(5000),
            name: format!("PARAM_{at}").into(),
            ..ParameterResponse::default()
        };
        Simulated {
            id: NodeId::new(id).unwrap(),
            uptime_s: 0,
            parameters: (0..count).map(parameter).collect(),
            requests: 0,
            lose_every: None,
            is_silent: false,
            rejects_opcodes: false,
            saved: 0,
            erased: 0,
            restarts: 0,
            info_requests: 0,
            assembler: Assembler::new(),
        }
    }

    pub fn status(&self) -> Frame {
        let status = NodeStatus { uptime_s: self.uptime_s, ..NodeStatus::default() };
        let id = types::NODE_STATUS.message_id(24, self.id);
        frames(id, &status.encode(), TransferId::new(self.uptime_s as u8))[0]
    }

    fn receive(&mut self, now: Duration, frame: &Frame) -> Vec<Frame> {
        let Id::Extended(raw) = frame.id else { return Vec::new() };
        let Outcome::Complete(transfer) = self.assembler.push(raw, frame.data(), now) else {
            return Vec::new();
        };
        match transfer.id {
            CanId::Service { request: true, destination, .. } if destination == self.id => {}
            _ => return Vec::new(),
        }
        self.requests += 1;
        if self.is_silent
            || self.lose_every.is_some_and(|every| self.requests.is_multiple_of(every))
        {
            return Vec::new();
        }
        let CanId::Service { priority, service_id, source, .. } = transfer.id else {
            return Vec::new();
        };
        let response = self.respond(&transfer);
        let (_, payload) = response.encode().unwrap();
        let id = CanId::Service {
            priority,
            service_id,
            request: false,
            destination: source,
            source: self.id,
        };
        frames(id, &payload, transfer.transfer_id)
    }

    fn respond(&mut self, transfer: &Transfer) -> Message {
        match Message::decode(transfer) {
            Message::NodeInfoRequest => {
                self.info_requests += 1;
                let name = format!("org.example.node{}", self.id).into();
                Message::NodeInfo(Box::new(NodeInfo {
                    name,
                    hardware: (3, 4),
                    ..NodeInfo::default()
                }))
            }
            Message::ParameterRequest(request) => {
                Message::ParameterResponse(self.get_set(&request))
            }
            Message::ExecuteOpcode(opcode) => {
                self.saved += u32::from(opcode == Opcode::SAVE);
                self.erased += u32::from(opcode == Opcode::ERASE);
                Message::OpcodeExecuted(!self.rejects_opcodes)
            }
            Message::RestartNode(magic) => {
                assert_eq!(magic, dronecan_host::RESTART_MAGIC);
                self.restarts += 1;
                self.uptime_s = 0;
                Message::Restarting(true)
            }
            other => panic!("unexpected request {other:?}"),
        }
    }

    fn get_set(&mut self, request: &ParameterRequest) -> ParameterResponse {
        let found = match request.name.as_slice() {
            [] => self.parameters.get_mut(usize::from(request.index)),
            name => self.parameters.iter_mut().find(|parameter| parameter.name == name),
        };
        let Some(parameter) = found else { return ParameterResponse::default() };
        match (&request.value, &parameter.value) {
            (Value::Integer(wanted), Value::Integer(_)) => {
                parameter.value = Value::Integer((*wanted).clamp(0, 5000))
            }
            (Value::Real(_), Value::Real(_)) | (Value::Boolean(_), Value::Boolean(_)) => {
                parameter.value = request.value.clone();
            }
            _ => {}
        }
        parameter.clone()
    }
}

/// Bridge, nodes and a ground station.
pub struct Rig {
    pub now: Duration,
    pub bridge: Bridge,
    pub nodes: Vec<Simulated>,
    /// Every posted message with its time.
    pub posts: Vec<(Duration, Post)>,
}

impl Rig {
    pub fn new(nodes: Vec<Simulated>) -> Rig {
        let bridge = Bridge::new(Settings::of_tests());
        Rig { now: Duration::ZERO, bridge, nodes, posts: Vec::new() }
    }

    /// With nodes whose status and information the bridge has.
    pub fn online(nodes: Vec<Simulated>) -> Rig {
        let mut rig = Rig::new(nodes);
        rig.run_ms(1500);
        rig.posts.clear();
        rig
    }

    /// With node 42 online.
    pub fn with_node(parameters: usize) -> Rig {
        Rig::online(vec![Simulated::new(42, parameters)])
    }

    pub fn node(&mut self) -> &mut Simulated {
        &mut self.nodes[0]
    }

    /// Runs for `ms` milliseconds. Each node sends a status at each full second.
    pub fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now += Duration::from_millis(1);
            if self.now.as_millis().is_multiple_of(1000) {
                for node in &mut self.nodes {
                    if !node.is_silent {
                        self.bridge.frame(self.now, &node.status());
                        node.uptime_s += 1;
                    }
                }
            }
            self.bridge.poll(self.now);
            let frames = std::mem::take(&mut self.bridge.frames);
            for frame in frames {
                for node in &mut self.nodes {
                    for response in node.receive(self.now, &frame) {
                        self.bridge.frame(self.now, &response);
                    }
                }
            }
            self.posts.extend(self.bridge.take_posts().into_iter().map(|post| (self.now, post)));
        }
    }

    pub fn send_request(&mut self, to: (u8, u8), request: Request) {
        self.send_request_as(STATION, to, request);
    }

    pub fn send_request_as(&mut self, asker: Asker, to: (u8, u8), request: Request) {
        self.bridge.message(self.now, asker, In { from: asker.from, to, request });
    }

    pub fn list(&mut self, component: u8) {
        self.send_request((1, component), Request::ParameterList);
    }

    /// Reads a parameter of node 42.
    pub fn read(&mut self, name: &str) {
        self.send_request((1, 42), Request::ParameterRead { index: None, name: name.into() });
    }

    pub fn read_at(&mut self, index: u16) {
        let name = String::new();
        self.send_request((1, 42), Request::ParameterRead { index: Some(index), name });
    }

    /// Sets a parameter of node 42.
    pub fn set(&mut self, name: &str, value: f32, kind: u8) {
        self.send_request((1, 42), Request::ParameterSet { name: name.into(), value, kind });
    }

    pub fn set_integer(&mut self, name: &str, value: u32) {
        self.set(name, f32::from_bits(value), INT32);
    }

    pub fn command(&mut self, component: u8, number: u16, params: &[f32]) {
        let mut all = [0.0; 7];
        all[..params.len()].copy_from_slice(params);
        self.send_request((1, component), Request::Command(Command { number, params: all }));
    }

    /// Messages since the last call: component and content, without heartbeats and statuses.
    pub fn sent_messages(&mut self) -> Vec<(u8, Content)> {
        let posts = std::mem::take(&mut self.posts);
        let sent = posts.into_iter().filter_map(|(_, post)| match post {
            Post::Message { out, .. } => Some((out.component, out.content)),
            _ => None,
        });
        let heartbeat = |content: &Content| {
            matches!(
                content,
                Content::Message(m) if matches!(**m, MavMessage::HEARTBEAT(_))
            )
        };
        sent.filter(|(_, content)| !heartbeat(content)).collect()
    }

    pub fn acks(&mut self) -> Vec<(u8, u16, MavResult, (u8, u8))> {
        let ack = |(component, content)| match content {
            Content::Ack { command, result, to } => Some((component, command, result, to)),
            _ => None,
        };
        self.sent_messages().into_iter().filter_map(ack).collect()
    }

    pub fn parameters(&mut self) -> Vec<(String, Number, u16, u16)> {
        let parameter = |(_, content)| match content {
            Content::Parameter { name, number, count, index } => Some((name, number, count, index)),
            _ => None,
        };
        self.sent_messages().into_iter().filter_map(parameter).collect()
    }
}

/// What `pick` finds in messages, with their components.
pub fn picked<T>(sent: &[(u8, Content)], pick: impl Fn(&MavMessage) -> Option<T>) -> Vec<(u8, T)> {
    let pick = |(component, content): &(u8, Content)| match content {
        Content::Message(message) => pick(message).map(|found| (*component, found)),
        _ => None,
    };
    sent.iter().filter_map(pick).collect()
}

pub fn infos(sent: &[(u8, Content)]) -> Vec<(u8, UAVCAN_NODE_INFO_DATA)> {
    picked(sent, |message| match message {
        MavMessage::UAVCAN_NODE_INFO(data) => Some(data.clone()),
        _ => None,
    })
}

pub fn errors(sent: &[(u8, Content)]) -> Vec<MavParamError> {
    let found = picked(sent, |message| match message {
        MavMessage::PARAM_ERROR(data) => Some(data.error),
        _ => None,
    });
    found.into_iter().map(|(_, error)| error).collect()
}

pub fn texts(sent: &[(u8, Content)]) -> Vec<String> {
    let found = picked(sent, |message| match message {
        MavMessage::STATUSTEXT(data) => Some(crate::message::name(&data.text)),
        _ => None,
    });
    found.into_iter().map(|(_, text)| text).collect()
}

pub const ACCEPTED: MavResult = MavResult::MAV_RESULT_ACCEPTED;
pub const DENIED: MavResult = MavResult::MAV_RESULT_DENIED;
pub const FAILED: MavResult = MavResult::MAV_RESULT_FAILED;
