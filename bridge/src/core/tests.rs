//! The bridge between nodes that answer or do not and a ground station, on a clock of its own.

use super::*;
use crate::message::{Command, command};
use crate::number::Number;
use dronecan_host::{Message, Opcode, ParameterRequest, ParameterResponse, Value};
use mavlink::dialects::common::{CAN_FILTER_MODIFY_DATA, CAN_FRAME_DATA, CanFilterOp, MavParamError, MavResult};
use std::collections::BTreeSet;

const BRIDGE: NodeId = NodeId::new(126).unwrap();
const NODE: NodeId = NodeId::new(42).unwrap();
const STATION: Asker = Asker { peer: 1, from: (255, 190), custom: Custom::Bytewise };
const INT32: u8 = 6;

/// A node that does what it is asked.
struct Simulated {
    id: NodeId,
    uptime_s: u32,
    parameters: Vec<ParameterResponse>,
    /// Requests that it hears, and of these every n-th is lost.
    requests: u32,
    lose_every: Option<u32>,
    deaf: bool,
    saved: u32,
    erased: u32,
    restarts: u32,
    info_requests: u32,
    assembler: Assembler,
}

impl Simulated {
    fn new(id: u8, count: usize) -> Simulated {
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
            deaf: false,
            saved: 0,
            erased: 0,
            restarts: 0,
            info_requests: 0,
            assembler: Assembler::new(),
        }
    }

    fn status(&self) -> Frame {
        let status = NodeStatus { uptime_s: self.uptime_s, ..NodeStatus::default() };
        let id = types::NODE_STATUS.message_id(24, self.id).build();
        Frame::extended(id, &split(&status.encode(), TransferId::new(self.uptime_s as u8), 0)[0])
    }

    fn hear(&mut self, now: Duration, frame: &Frame) -> Vec<Frame> {
        let Id::Extended(raw) = frame.id else { return Vec::new() };
        let Outcome::Complete(transfer) = self.assembler.push(raw, frame.data(), now) else { return Vec::new() };
        match transfer.id {
            CanId::Service { request: true, destination, .. } if destination == self.id => {}
            _ => return Vec::new(),
        }
        self.requests += 1;
        if self.deaf || self.lose_every.is_some_and(|every| self.requests.is_multiple_of(every)) {
            return Vec::new();
        }
        let CanId::Service { priority, service_id, source, .. } = transfer.id else { return Vec::new() };
        let response = self.respond(&transfer);
        let (data_type, payload) = response.encode().unwrap();
        let id = CanId::Service { priority, service_id, request: false, destination: source, source: self.id };
        let parts = split(&payload, transfer.transfer_id, data_type.signature.unwrap());
        parts.iter().map(|data| Frame::extended(id.build(), data)).collect()
    }

    fn respond(&mut self, transfer: &Transfer) -> Message {
        match Message::decode(transfer) {
            Message::NodeInfoRequest => {
                self.info_requests += 1;
                let name = format!("org.example.node{}", self.id).into();
                Message::NodeInfo(Box::new(NodeInfo { name, hardware: (3, 4), ..NodeInfo::default() }))
            }
            Message::ParameterRequest(request) => Message::ParameterResponse(self.get_set(&request)),
            Message::ExecuteOpcode(opcode) => {
                self.saved += u32::from(opcode == Opcode::SAVE);
                self.erased += u32::from(opcode == Opcode::ERASE);
                Message::OpcodeExecuted(true)
            }
            Message::RestartNode(magic) => {
                assert_eq!(magic, dronecan_host::RESTART_MAGIC);
                self.restarts += 1;
                self.uptime_s = 0;
                Message::Restarting(true)
            }
            other => panic!("nobody asks {other:?}"),
        }
    }

    fn get_set(&mut self, request: &ParameterRequest) -> ParameterResponse {
        let found = match request.name.as_slice() {
            [] => self.parameters.get_mut(usize::from(request.index)),
            name => self.parameters.iter_mut().find(|parameter| parameter.name == name),
        };
        let Some(parameter) = found else { return ParameterResponse::default() };
        match (&request.value, &parameter.value) {
            (Value::Integer(wanted), Value::Integer(_)) => parameter.value = Value::Integer((*wanted).clamp(0, 5000)),
            (Value::Real(_), Value::Real(_)) | (Value::Boolean(_), Value::Boolean(_)) => {
                parameter.value = request.value.clone();
            }
            _ => {}
        }
        parameter.clone()
    }
}

/// Bridge, nodes and a ground station.
struct Rig {
    now: Duration,
    bridge: Bridge,
    nodes: Vec<Simulated>,
    /// Everything posted, with its time.
    posts: Vec<(Duration, Post)>,
}

impl Rig {
    fn new(nodes: Vec<Simulated>) -> Rig {
        let settings = Settings {
            system: 1,
            component: 126,
            node: BRIDGE,
            unique_id: [7; 16],
            info_interval: Duration::from_secs(60),
            autosave: None,
            epoch_us: 1_000_000_000,
        };
        Rig { now: Duration::ZERO, bridge: Bridge::new(settings), nodes, posts: Vec::new() }
    }

    /// With one node that has been heard and has said who it is.
    fn with_node(parameters: usize) -> Rig {
        let mut rig = Rig::new(vec![Simulated::new(42, parameters)]);
        rig.run_ms(1500);
        rig.posts.clear();
        rig
    }

    fn node(&mut self) -> &mut Simulated {
        &mut self.nodes[0]
    }

    /// Milliseconds, with a status of each node at each full second.
    fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now += Duration::from_millis(1);
            if self.now.as_millis().is_multiple_of(1000) {
                for node in &mut self.nodes {
                    if !node.deaf {
                        self.bridge.frame(self.now, &node.status());
                        node.uptime_s += 1;
                    }
                }
            }
            self.bridge.poll(self.now);
            let frames = std::mem::take(&mut self.bridge.frames);
            for frame in frames {
                for node in &mut self.nodes {
                    for response in node.hear(self.now, &frame) {
                        self.bridge.frame(self.now, &response);
                    }
                }
            }
            self.posts.extend(self.bridge.posts.drain(..).map(|post| (self.now, post)));
        }
    }

    fn say(&mut self, to: (u8, u8), request: Request) {
        self.say_as(STATION, to, request);
    }

    fn say_as(&mut self, asker: Asker, to: (u8, u8), request: Request) {
        self.bridge.message(self.now, asker, In { from: asker.from, to, request });
    }

    fn command(&mut self, component: u8, number: u16, params: &[f32]) {
        let mut all = [0.0; 7];
        all[..params.len()].copy_from_slice(params);
        self.say((1, component), Request::Command(Command { number, params: all }));
    }

    /// What was said since the last time: component and content, without heartbeats and statuses.
    fn said(&mut self) -> Vec<(u8, Content)> {
        let posts = std::mem::take(&mut self.posts);
        let said = posts.into_iter().filter_map(|(_, post)| match post {
            Post::Message { out, .. } => Some((out.component, out.content)),
            _ => None,
        });
        let heartbeat =
            |content: &Content| matches!(content, Content::Message(m) if matches!(**m, MavMessage::HEARTBEAT(_)));
        said.filter(|(_, content)| !heartbeat(content)).collect()
    }

    fn acks(&mut self) -> Vec<(u8, u16, MavResult, (u8, u8))> {
        let ack = |(component, content)| match content {
            Content::Ack { command, result, to } => Some((component, command, result, to)),
            _ => None,
        };
        self.said().into_iter().filter_map(ack).collect()
    }

    fn parameters(&mut self) -> Vec<(String, Number, u16, u16)> {
        let parameter = |(_, content)| match content {
            Content::Parameter { name, number, count, index } => Some((name, number, count, index)),
            _ => None,
        };
        self.said().into_iter().filter_map(parameter).collect()
    }
}

fn infos(said: &[(u8, Content)]) -> Vec<(u8, UAVCAN_NODE_INFO_DATA)> {
    let info = |(component, content): &(u8, Content)| match content {
        Content::Message(message) => match &**message {
            MavMessage::UAVCAN_NODE_INFO(data) => Some((*component, data.clone())),
            _ => None,
        },
        _ => None,
    };
    said.iter().filter_map(info).collect()
}

fn errors(said: &[(u8, Content)]) -> Vec<MavParamError> {
    let error = |(_, content): &(u8, Content)| match content {
        Content::Message(message) => match &**message {
            MavMessage::PARAM_ERROR(data) => Some(data.error),
            _ => None,
        },
        _ => None,
    };
    said.iter().filter_map(error).collect()
}

fn texts(said: &[(u8, Content)]) -> Vec<String> {
    let text = |(_, content): &(u8, Content)| match content {
        Content::Message(message) => match &**message {
            MavMessage::STATUSTEXT(data) => Some(crate::message::name(&data.text)),
            _ => None,
        },
        _ => None,
    };
    said.iter().filter_map(text).collect()
}

const ACCEPTED: MavResult = MavResult::MAV_RESULT_ACCEPTED;
const DENIED: MavResult = MavResult::MAV_RESULT_DENIED;
const FAILED: MavResult = MavResult::MAV_RESULT_FAILED;

#[test]
fn each_status_of_a_node_is_passed_on_as_that_of_its_component() {
    let mut rig = Rig::new(vec![Simulated::new(42, 0)]);
    rig.run_ms(3500);
    let statuses: Vec<_> = rig.posts.iter().filter(|(_, post)| matches!(post, Post::Status { .. })).collect();
    assert_eq!(statuses.len(), 3);
    let (at, Post::Status { node, out }) = statuses[2] else { panic!() };
    let Content::Status { data, mode } = &out.content else { panic!() };
    assert_eq!((*node, out.component, data.uptime_sec, *mode), (NODE, 42, 2, 0));
    assert_eq!(data.time_usec, 1_000_000_000 + at.as_micros() as u64);
}

#[test]
fn a_node_that_appears_is_asked_who_it_is_and_all_are_told() {
    let mut rig = Rig::new(vec![Simulated::new(42, 0)]);
    rig.run_ms(1500);
    let infos = infos(&rig.said());
    assert_eq!(infos.len(), 1);
    assert_eq!((infos[0].0, crate::message::name(&infos[0].1.name)), (42, "org.example.node42".into()));
    assert_eq!((infos[0].1.hw_version_major, infos[0].1.hw_version_minor), (3, 4));
    rig.run_ms(20_000);
    assert_eq!(rig.node().info_requests, 1);
}

#[test]
fn a_node_that_restarts_is_asked_again() {
    let mut rig = Rig::with_node(0);
    rig.run_ms(3000);
    rig.said();
    rig.node().uptime_s = 0;
    rig.run_ms(1500);
    let said = rig.said();
    assert_eq!((infos(&said).len(), texts(&said)), (1, vec![String::from("Node 42 has restarted")]));
}

#[test]
fn nodes_are_asked_again_when_the_bus_is_back() {
    let mut rig = Rig::with_node(3);
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(100);
    rig.node().parameters.truncate(2);
    rig.said();
    rig.bridge.bus_is_back();
    rig.say((1, 42), Request::ParameterRead { index: Some(1), name: String::new() });
    rig.run_ms(100);
    let said = rig.said();
    assert_eq!(infos(&said).len(), 1);
    assert!(said.iter().any(|(_, content)| matches!(content, Content::Parameter { count: 2, index: 1, .. })));
}

#[test]
fn a_node_is_offline_after_five_seconds_and_that_is_said_once() {
    let mut rig = Rig::with_node(0);
    rig.node().deaf = true;
    // Its last status came at 1 s.
    rig.run_ms(4499);
    assert!(texts(&rig.said()).is_empty());
    rig.run_ms(20_000);
    assert_eq!(texts(&rig.said()), ["Node 42 is offline"]);
    rig.node().deaf = false;
    rig.run_ms(1500);
    assert_eq!(infos(&rig.said()).len(), 1, "it is asked again when it is back");
}

#[test]
fn only_nodes_that_are_there_have_heartbeats() {
    let mut rig = Rig::with_node(0);
    let heartbeats = |rig: &mut Rig| -> BTreeSet<u8> {
        let posts = std::mem::take(&mut rig.posts);
        let component = |(_, post): (Duration, Post)| match post {
            Post::Message { out, .. } if out.key().is_some_and(|key| key.1 == 0) => Some(out.component),
            _ => None,
        };
        posts.into_iter().filter_map(component).collect()
    };
    rig.run_ms(2000);
    assert_eq!(heartbeats(&mut rig), BTreeSet::from([42, 126]));
    rig.node().deaf = true;
    rig.run_ms(8000);
    rig.posts.clear();
    rig.run_ms(3000);
    assert_eq!(heartbeats(&mut rig), BTreeSet::from([126]));
}

#[test]
fn a_node_that_does_not_say_who_it_is_is_asked_less_and_less() {
    let mut rig = Rig::new(vec![Simulated::new(42, 0)]);
    rig.node().lose_every = Some(1);
    rig.run_ms(120_000);
    assert!((10..30).contains(&rig.node().requests), "{}", rig.node().requests);
    rig.node().lose_every = None;
    rig.run_ms(61_000);
    assert_eq!(infos(&rig.said()).len(), 1);
}

#[test]
fn infos_come_again_at_a_very_low_rate_and_to_whoever_is_new() {
    let mut rig = Rig::with_node(0);
    rig.run_ms(121_000);
    assert_eq!(infos(&rig.said()).len(), 2);
    rig.bridge.joined(rig.now, 9);
    rig.run_ms(1);
    assert!(matches!(rig.posts[0].1, Post::Message { to: To::One(9), class: Class::Answer, .. }), "a heartbeat");
    assert!(matches!(rig.posts[1].1, Post::Message { to: To::One(9), class: Class::Info, .. }));
}

#[test]
fn all_parameters_come_in_order_with_their_count() {
    let mut rig = Rig::with_node(26);
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(200);
    let parameters = rig.parameters();
    assert_eq!(parameters.len(), 26);
    for (at, parameter) in parameters.iter().enumerate() {
        let expected = (format!("PARAM_{at}"), Number::Int32(at as i32 * 10), 26, at as u16);
        assert_eq!(*parameter, expected);
    }
}

#[test]
fn a_node_that_loses_every_third_request_still_tells_all() {
    let mut rig = Rig::with_node(40);
    rig.node().lose_every = Some(3);
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(20_000);
    assert_eq!(rig.parameters().len(), 40);
}

#[test]
fn a_list_that_is_asked_for_twice_is_fetched_once_and_component_0_means_all_nodes() {
    let mut rig = Rig::new(vec![Simulated::new(42, 5), Simulated::new(43, 3)]);
    rig.run_ms(1500);
    rig.said();
    let before = rig.node().requests;
    rig.say((1, 0), Request::ParameterList);
    rig.say((1, 0), Request::ParameterList);
    rig.run_ms(200);
    assert_eq!(rig.parameters().len(), 8);
    // Up to four are on their way when the end is found.
    assert!((6..=10).contains(&(rig.node().requests - before)));
}

#[test]
fn a_parameter_is_read_by_index_and_by_name_and_told_with_its_index() {
    let mut rig = Rig::with_node(10);
    rig.say((1, 42), Request::ParameterRead { index: Some(3), name: String::new() });
    rig.say((0, 42), Request::ParameterRead { index: None, name: "PARAM_7".into() });
    rig.run_ms(100);
    let expected = |at: u16| (format!("PARAM_{at}"), Number::Int32(i32::from(at) * 10), 10, at);
    assert_eq!(rig.parameters(), [expected(3), expected(7)]);
}

#[test]
fn what_is_not_there_is_told_to_whoever_asked() {
    let mut rig = Rig::with_node(3);
    rig.say((1, 42), Request::ParameterRead { index: None, name: "NONE".into() });
    rig.say((1, 42), Request::ParameterRead { index: Some(3), name: String::new() });
    rig.say((1, 42), Request::ParameterSet { name: "NONE".into(), value: 1.0, kind: INT32 });
    rig.run_ms(100);
    let said = rig.said();
    assert_eq!(errors(&said), [MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST; 3]);
    assert_eq!(said.len(), 3);
}

#[test]
fn a_set_parameter_is_told_to_all_with_the_value_in_force() {
    let mut rig = Rig::with_node(3);
    rig.say((1, 42), Request::ParameterSet { name: "PARAM_1".into(), value: f32::from_bits(1900), kind: INT32 });
    rig.run_ms(100);
    let to_all = |(_, post): &(Duration, Post)| matches!(post, Post::Message { to: To::All, class: Class::Answer, out } if matches!(out.content, Content::Parameter { .. }));
    assert_eq!(rig.posts.iter().filter(|post| to_all(post)).count(), 1);
    assert_eq!(rig.parameters(), [(String::from("PARAM_1"), Number::Int32(1900), 3, 1)]);
    assert_eq!(rig.node().parameters[1].value, Value::Integer(1900));
    rig.say((1, 42), Request::ParameterSet { name: "PARAM_1".into(), value: f32::from_bits(9999), kind: INT32 });
    rig.run_ms(100);
    let said = rig.said();
    assert_eq!(errors(&said), [MavParamError::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE]);
    assert!(matches!(&said[0].1, Content::Parameter { number: Number::Int32(5000), .. }));
}

#[test]
fn a_value_of_no_use_changes_nothing_and_is_answered_with_what_is_in_force() {
    let mut rig = Rig::with_node(3);
    for (value, kind) in [(0.5, 9), (f32::NAN, 9), (1.0, 10), (1.0, 0), (1.0, 99)] {
        rig.say((1, 42), Request::ParameterSet { name: "PARAM_1".into(), value, kind });
        rig.run_ms(100);
        let said = rig.said();
        assert_eq!((errors(&said).len(), said.len()), (1, 2), "{said:?}");
        assert!(matches!(&said[0].1, Content::Parameter { number: Number::Int32(10), .. }));
    }
    // All nodes at once are not meant.
    rig.say((1, 0), Request::ParameterSet { name: "PARAM_1".into(), value: f32::from_bits(5), kind: INT32 });
    rig.run_ms(100);
    assert_eq!(rig.node().parameters[1].value, Value::Integer(10));
}

#[test]
fn a_node_that_does_not_answer_is_given_up_in_bounded_time() {
    let mut rig = Rig::with_node(3);
    rig.node().lose_every = Some(1);
    rig.say((1, 42), Request::ParameterRead { index: None, name: "PARAM_1".into() });
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(2000);
    let said = rig.said();
    assert_eq!(errors(&said), [MavParamError::MAV_PARAM_ERROR_READ_FAIL]);
    assert_eq!(texts(&said), ["Node 42 does not tell its parameters"]);
    rig.node().lose_every = None;
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(500);
    assert_eq!(rig.parameters().len(), 3);
}

#[test]
fn long_names_are_shortened_and_set_under_their_short_name_in_any_case() {
    let mut rig = Rig::with_node(2);
    rig.node().parameters[0].name = b"uavcan.equipment.esc.current_limit_max".to_vec();
    rig.node().parameters[1].name = b"uavcan.equipment.esc.current_limit_min".to_vec();
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(100);
    let short: Vec<String> = rig.parameters().into_iter().map(|parameter| parameter.0).collect();
    assert!(short.iter().all(|name| name.len() == 16) && short[0] != short[1]);
    let name = short[1].to_ascii_uppercase();
    rig.say((1, 42), Request::ParameterSet { name, value: f32::from_bits(77), kind: INT32 });
    rig.run_ms(100);
    assert_eq!(rig.node().parameters[1].value, Value::Integer(77));
    assert_eq!(rig.node().parameters[0].value, Value::Integer(0));
}

#[test]
fn a_restart_in_the_middle_of_a_list_begins_it_again() {
    let mut rig = Rig::with_node(100);
    rig.run_ms(4490);
    rig.said();
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(8);
    rig.node().uptime_s = 0;
    rig.node().parameters.truncate(60);
    rig.run_ms(1000);
    let parameters = rig.parameters();
    assert_eq!((parameters.len(), parameters[0].2), (60, 60));
}

#[test]
fn saving_and_erasing_are_acknowledged_when_the_node_has_done_it() {
    let mut rig = Rig::with_node(3);
    rig.command(42, command::PREFLIGHT_STORAGE, &[1.0]);
    assert!(rig.acks().is_empty());
    rig.run_ms(10);
    assert_eq!(rig.acks(), [(42, 245, ACCEPTED, (255, 190))]);
    rig.command(42, command::PREFLIGHT_STORAGE, &[2.0]);
    rig.run_ms(10);
    assert_eq!(rig.acks(), [(42, 245, ACCEPTED, (255, 190))]);
    assert_eq!((rig.node().saved, rig.node().erased), (1, 1));
    rig.command(42, command::PREFLIGHT_STORAGE, &[0.0]);
    rig.run_ms(10);
    assert_eq!(rig.acks(), [(42, 245, DENIED, (255, 190))]);
}

#[test]
fn all_nodes_are_saved_at_once_but_neither_erased_nor_restarted() {
    let mut rig = Rig::new(vec![Simulated::new(42, 1), Simulated::new(43, 1)]);
    rig.run_ms(1500);
    rig.said();
    for component in [0, 126] {
        rig.command(component, command::PREFLIGHT_STORAGE, &[1.0]);
        rig.run_ms(10);
        assert_eq!(rig.acks(), [(126, 245, ACCEPTED, (255, 190))]);
        rig.command(component, command::PREFLIGHT_STORAGE, &[2.0]);
        rig.command(component, command::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]);
        rig.run_ms(10);
        assert_eq!(rig.acks(), [(126, 245, DENIED, (255, 190)), (126, 246, DENIED, (255, 190))]);
    }
    assert_eq!(
        rig.nodes.iter().map(|node| (node.saved, node.erased, node.restarts)).collect::<Vec<_>>(),
        [(2, 0, 0); 2]
    );
}

#[test]
fn a_command_that_is_repeated_is_done_once() {
    let mut rig = Rig::with_node(3);
    rig.node().deaf = true;
    for _ in 0..3 {
        rig.command(42, command::PREFLIGHT_STORAGE, &[1.0]);
        rig.run_ms(300);
    }
    let in_progress = MavResult::MAV_RESULT_IN_PROGRESS;
    let results: Vec<MavResult> = rig.acks().into_iter().map(|ack| ack.2).collect();
    assert_eq!(results, [in_progress, in_progress]);
    rig.run_ms(3000);
    assert_eq!(rig.acks(), [(42, 245, FAILED, (255, 190))]);
    assert_eq!(rig.node().requests, 1 + 2, "the information and two attempts");
}

#[test]
fn a_node_is_restarted_by_its_component_and_in_the_newer_way() {
    let mut rig = Rig::with_node(3);
    rig.command(42, command::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]);
    rig.run_ms(10);
    rig.command(126, command::PREFLIGHT_REBOOT_SHUTDOWN, &[0.0, 0.0, 1.0, 42.0]);
    rig.run_ms(10);
    assert_eq!(rig.acks(), [(42, 246, ACCEPTED, (255, 190)), (126, 246, ACCEPTED, (255, 190))]);
    assert_eq!(rig.node().restarts, 2);
    rig.command(42, command::PREFLIGHT_REBOOT_SHUTDOWN, &[2.0]);
    rig.run_ms(10);
    assert_eq!(rig.acks(), [(42, 246, DENIED, (255, 190))]);
    assert_eq!(rig.node().restarts, 2);
}

#[test]
fn a_restart_whose_answer_was_lost_is_known_by_the_uptime() {
    let mut rig = Rig::with_node(3);
    rig.run_ms(3000);
    rig.said();
    rig.node().lose_every = Some(1);
    rig.command(42, command::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]);
    rig.run_ms(200);
    rig.node().uptime_s = 0;
    rig.run_ms(400);
    assert_eq!(rig.acks(), [(42, 246, ACCEPTED, (255, 190))]);
}

#[test]
fn node_infos_are_told_once_each_on_command() {
    let mut rig = Rig::new(vec![Simulated::new(42, 1), Simulated::new(43, 1), Simulated::new(44, 1)]);
    rig.run_ms(1500);
    rig.said();
    rig.command(0, command::UAVCAN_GET_NODE_INFO, &[]);
    rig.run_ms(100);
    let said = rig.said();
    assert_eq!(infos(&said).iter().map(|info| info.0).collect::<Vec<_>>(), [42, 43, 44]);
    assert!(matches!(said[3].1, Content::Ack { command: 5200, result: ACCEPTED, .. }));
    rig.command(43, command::REQUEST_MESSAGE, &[311.0]);
    rig.run_ms(100);
    let said = rig.said();
    assert_eq!((infos(&said).len(), infos(&said)[0].0), (1, 43));
    assert_eq!(said[1], (43, Content::Ack { command: 512, result: ACCEPTED, to: (255, 190) }));
}

#[test]
fn a_requested_info_of_a_node_that_does_not_answer_fails() {
    let mut rig = Rig::new(vec![Simulated::new(42, 1)]);
    rig.node().lose_every = Some(1);
    rig.run_ms(3000);
    rig.said();
    rig.command(42, command::REQUEST_MESSAGE, &[311.0]);
    rig.run_ms(3000);
    assert_eq!(rig.acks(), [(42, 512, FAILED, (255, 190))]);
}

#[test]
fn other_messages_can_be_requested_and_unknown_ones_and_commands_are_answered() {
    let mut rig = Rig::with_node(1);
    rig.command(42, command::REQUEST_MESSAGE, &[310.0]);
    rig.command(126, command::REQUEST_MESSAGE, &[148.0]);
    rig.command(42, command::REQUEST_MESSAGE, &[30.0]);
    rig.command(42, 400, &[1.0]);
    rig.command(42, 42_000, &[1.0]);
    rig.run_ms(1);
    let said = rig.said();
    assert!(matches!(said[1], (42, Content::Status { .. })) && matches!(said[3], (126, Content::Capabilities { .. })));
    let results: Vec<(u16, MavResult)> = said
        .iter()
        .filter_map(|(_, content)| match content {
            Content::Ack { command, result, .. } => Some((*command, *result)),
            _ => None,
        })
        .collect();
    let unsupported = MavResult::MAV_RESULT_UNSUPPORTED;
    assert_eq!(results, [(512, ACCEPTED), (512, ACCEPTED), (512, DENIED), (400, unsupported), (42_000, unsupported)]);
}

#[test]
fn what_is_for_another_system_or_component_is_left_to_it() {
    let mut rig = Rig::with_node(2);
    rig.say((2, 42), Request::ParameterList);
    rig.say((1, 77), Request::ParameterList);
    rig.command(77, command::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]);
    rig.run_ms(500);
    assert!(rig.said().is_empty());
}

#[test]
fn what_is_for_a_node_that_is_heard_a_moment_later_is_not_lost() {
    let mut rig = Rig::new(vec![Simulated::new(42, 5), Simulated::new(43, 3)]);
    rig.say((1, 42), Request::ParameterList);
    rig.say((1, 42), Request::ParameterList);
    rig.command(43, command::PREFLIGHT_STORAGE, &[1.0]);
    rig.run_ms(1500);
    let said = rig.said();
    let parameters = said.iter().filter(|(_, content)| matches!(content, Content::Parameter { .. })).count();
    let acks = said.iter().filter(|(_, content)| matches!(content, Content::Ack { .. })).count();
    assert_eq!((parameters, acks, rig.nodes[1].saved), (5, 1, 1));
    let mut rig = Rig::new(vec![Simulated::new(42, 5), Simulated::new(43, 3)]);
    rig.say((0, 0), Request::ParameterList);
    rig.run_ms(3500);
    assert_eq!(rig.parameters().len(), 8);
    // After a while it is nobody's wish any more.
    let mut rig = Rig::new(vec![Simulated::new(42, 5)]);
    rig.node().deaf = true;
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(4500);
    rig.node().deaf = false;
    rig.run_ms(2000);
    assert!(rig.parameters().is_empty());
}

fn can_frames(rig: &mut Rig) -> Vec<(u8, CAN_FRAME_DATA)> {
    let frame = |(component, content): (u8, Content)| match content {
        Content::Message(message) => match *message {
            MavMessage::CAN_FRAME(data) => Some((component, data)),
            _ => None,
        },
        _ => None,
    };
    rig.said().into_iter().filter_map(frame).collect()
}

#[test]
fn the_bus_is_shown_for_five_seconds_after_each_can_forward() {
    let mut rig = Rig::with_node(1);
    rig.say(
        (0, 0),
        Request::Command(Command { number: command::CAN_FORWARD, params: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0] }),
    );
    rig.run_ms(1000);
    let frames = can_frames(&mut rig);
    // The node's status, and the bridge's own.
    let ids: BTreeSet<u32> = frames.iter().map(|frame| frame.1.id).collect();
    assert_eq!(ids, BTreeSet::from([0x9801_552A, 0x9801_557E]));
    let frame = &frames[0].1;
    assert_eq!((frame.bus, frame.len, frame.target_system, frame.target_component), (0, 8, 255, 190));
    rig.run_ms(5000);
    can_frames(&mut rig);
    rig.run_ms(3000);
    assert!(can_frames(&mut rig).is_empty());
    rig.command(126, command::CAN_FORWARD, &[2.0]);
    rig.run_ms(1);
    assert_eq!(rig.acks(), [(126, 32_000, DENIED, (255, 190))]);
}

#[test]
fn a_frame_of_a_station_goes_to_the_bus_and_the_other_stations_but_not_back() {
    let mut rig = Rig::with_node(1);
    let other = Asker { peer: 2, from: (254, 189), ..STATION };
    let forward = Command { number: command::CAN_FORWARD, params: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0] };
    rig.say((0, 0), Request::Command(forward));
    rig.say_as(other, (0, 0), Request::Command(forward));
    let sent = CAN_FRAME_DATA {
        id: 0x9801_557F,
        target_system: 0,
        target_component: 0,
        bus: 0,
        len: 8,
        data: [1, 0, 0, 0, 0, 0, 0, 0xC0],
    };
    rig.say_as(other, (0, 0), Request::Frame(sent.clone()));
    assert_eq!(rig.bridge.frames, [Frame::extended(0x1801_557F, &sent.data)]);
    rig.run_ms(1);
    let posts = std::mem::take(&mut rig.posts);
    let shown = |(_, post): &(Duration, Post)| match post {
        Post::Message { to, class: Class::Frame, .. } => Some(*to),
        _ => None,
    };
    let to: Vec<To> = posts.iter().filter_map(shown).filter(|to| *to == To::One(2)).collect();
    // The bridge asks the new node 127 who it is: that is one frame, and none is the one that was sent.
    assert_eq!(to.len(), 1);
    assert!(posts.iter().filter_map(shown).filter(|to| *to == To::One(1)).count() == 2);
    assert!(rig.bridge.nodes().contains_key(&NodeId::new(127).unwrap()), "a station is a node too");
    for wrong in [
        CAN_FRAME_DATA { bus: 1, ..sent.clone() },
        CAN_FRAME_DATA { len: 9, ..sent.clone() },
        CAN_FRAME_DATA { id: 0xE000_0001, ..sent.clone() },
    ] {
        rig.bridge.frames.clear();
        rig.say((0, 0), Request::Frame(wrong));
        assert!(rig.bridge.frames.is_empty());
    }
}

#[test]
fn a_filter_lets_through_what_it_names() {
    let mut rig = Rig::with_node(1);
    rig.command(126, command::CAN_FORWARD, &[1.0]);
    let filter = |operation, id: u16| {
        let mut ids = [0; 16];
        ids[0] = id;
        Request::Filter(CAN_FILTER_MODIFY_DATA {
            ids,
            target_system: 1,
            target_component: 126,
            bus: 1,
            operation,
            num_ids: 1,
        })
    };
    rig.say((1, 126), filter(CanFilterOp::CAN_FILTER_REPLACE, 1010));
    rig.run_ms(2000);
    assert!(can_frames(&mut rig).is_empty());
    rig.say((1, 126), filter(CanFilterOp::CAN_FILTER_ADD, 341));
    rig.run_ms(1000);
    assert_eq!(can_frames(&mut rig).len(), 2);
    rig.command(126, command::CAN_FORWARD, &[1.0]);
    rig.say((1, 126), filter(CanFilterOp::CAN_FILTER_REMOVE, 341));
    rig.run_ms(1000);
    assert!(can_frames(&mut rig).is_empty());
}

#[test]
fn the_bridge_is_a_node_that_says_who_it_is() {
    let mut rig = Rig::new(Vec::new());
    rig.bridge.poll(Duration::from_secs(1));
    assert_eq!(rig.bridge.frames[0].to_string().split_once('#').unwrap().0, "1801557E");
    rig.bridge.frames.clear();
    let ask = CanId::Service { priority: 20, service_id: 1, request: true, destination: BRIDGE, source: NODE };
    rig.bridge.frame(Duration::from_secs(1), &Frame::extended(ask.build(), &[0xC5]));
    let mut assembler = Assembler::new();
    let mut outcomes = rig.bridge.frames.iter().map(|frame| {
        let Id::Extended(id) = frame.id else { panic!() };
        assembler.push(id, frame.data(), Duration::ZERO)
    });
    let Some(Outcome::Complete(transfer)) = outcomes.find(|outcome| matches!(outcome, Outcome::Complete(_))) else {
        panic!()
    };
    let Message::NodeInfo(info) = Message::decode(&transfer) else { panic!() };
    assert_eq!((info.name(), transfer.transfer_id.get(), info.unique_id), (NAME.into(), 5, [7; 16]));
}

#[test]
fn another_node_with_the_bridges_id_is_told_of_and_not_shown() {
    let mut rig = Rig::new(vec![Simulated::new(126, 0)]);
    rig.run_ms(5500);
    assert_eq!(rig.bridge.log.len(), 1);
    assert!(rig.bridge.log[0].contains("--node-id") && rig.bridge.nodes().is_empty());
}

#[test]
fn autosave_saves_once_after_the_last_change() {
    let mut rig = Rig::with_node(3);
    rig.bridge.settings.autosave = Some(Duration::from_secs(2));
    for value in 1..=3 {
        rig.say((1, 42), Request::ParameterSet { name: "PARAM_1".into(), value: f32::from_bits(value), kind: INT32 });
        rig.run_ms(1500);
        assert_eq!(rig.node().saved, 0);
    }
    rig.run_ms(5000);
    assert_eq!(rig.node().saved, 1);
}

/// Random frames and messages neither panic nor leave anything behind.
#[test]
fn rubbish_from_both_sides_is_survived() {
    let mut rig = Rig::with_node(5);
    let mut seed = 0x1234_5678_9ABC_DEF1_u64;
    let mut random = move || {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        seed
    };
    for round in 0..20_000 {
        let data = random().to_le_bytes();
        let mut id = random() as u32 & 0x1FFF_FFFF;
        if round % 2 == 0 {
            // A response to the bridge, or a status.
            id = if round % 4 == 0 { 0x1E0B_7EAA } else { 0x1801_552A };
        }
        rig.bridge.frame(rig.now, &Frame::extended(id, &data[..(random() % 9) as usize]));
        let request = match random() % 6 {
            0 => Request::ParameterList,
            1 => Request::ParameterRead { index: Some(random() as u16), name: String::new() },
            2 => Request::ParameterRead { index: None, name: "PARAM_1".into() },
            3 => Request::ParameterSet {
                name: "PARAM_2".into(),
                value: f32::from_bits(random() as u32),
                kind: random() as u8,
            },
            4 => Request::Command(Command {
                number: [245, 246, 512, 519, 520, 5200, 32_000, random() as u16][(random() % 8) as usize],
                params: [
                    f32::from_bits(random() as u32),
                    (random() % 5) as f32,
                    f32::NAN,
                    f32::INFINITY,
                    -1.0,
                    1e30,
                    0.0,
                ],
            }),
            _ => Request::Frame(CAN_FRAME_DATA {
                id: random() as u32,
                len: random() as u8,
                bus: 0,
                ..CAN_FRAME_DATA::default()
            }),
        };
        let component = [0, 42, 126, random() as u8][(random() % 4) as usize];
        rig.say((1, component), request);
        if round % 100 == 0 {
            rig.run_ms(5);
            rig.posts.clear();
        }
    }
    rig.run_ms(20_000);
    rig.said();
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(2000);
    assert_eq!(rig.parameters().len(), 5);
    assert!(rig.bridge.commands.is_empty());
}
