//! Tests of the real bus with an adapter that has two nodes: 42, which answers, and 1, which does
//! not.

use super::*;
use bench::dronecan::slcan::{self, Command, Lines};
use bench::dronecan::{
    Assembler, CanId, Id, Mode, NumberAndText, Outcome as Assembled, ParameterResponse, TransferId,
    Value, frames as frames_of,
};

const NODE: u8 = 42;
const FILE_LEN: usize = 600;
const IMAGE_CRC: u64 = 0x0123_4567;

fn id(id: u8) -> NodeId {
    NodeId::new(id).unwrap()
}

fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

/// CRC-16-CCITT-FALSE.
fn crc_of(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xFFFF_u16, |crc, byte| {
        (0..8).fold(crc ^ u16::from(*byte) << 8, |crc, _| {
            if crc & 0x8000 == 0 { crc << 1 } else { crc << 1 ^ 0x1021 }
        })
    })
}

/// A firmware file for hardware 2.1, version 1.3; docs/update.md has its form.
fn firmware() -> Vec<u8> {
    let mut bytes: Vec<u8> = (0..FILE_LEN - 2).map(|n| n as u8).collect();
    let [low, high] = (FILE_LEN as u16).to_le_bytes();
    bytes[0x68..0x6E].copy_from_slice(&[2, 1, 1, 3, low, high]);
    bytes[0x78..0x80].copy_from_slice(&[0x40, 0xA2, 0xE4, 0xF1, 0x64, 0x68, 0x91, 0x06]);
    bytes[0x80..0x88].copy_from_slice(&IMAGE_CRC.to_le_bytes());
    let crc = crc_of(&bytes);
    bytes.extend(crc.to_be_bytes());
    bytes
}

/// The bus with its adapter.
struct Rig {
    bus: RealBus,
    now: Duration,
    commands: Lines,
    assembler: Assembler,
    /// What the page has sent, in words.
    sent: Vec<String>,
    name: Vec<u8>,
    software: (u8, u8),
    mode: Mode,
    parameters: Vec<(&'static str, Value)>,
    /// The file as node 42 has read it.
    read: Vec<u8>,
    /// The node that node 42 reads a file from.
    server: Option<NodeId>,
    is_silent: bool,
    cannot_listen: bool,
    /// How the page has opened the adapter: true to send, false to listen only.
    opened: Vec<bool>,
    /// The frame that the page has sent last.
    last: Option<Frame>,
    next_id: TransferId,
}

impl Rig {
    /// An open adapter, before the first frame.
    fn new() -> Rig {
        let mut rig = Rig {
            bus: RealBus::default(),
            now: Duration::ZERO,
            commands: Lines::default(),
            assembler: Assembler::new(),
            sent: Vec::new(),
            name: b"org.dronecan.servo328".to_vec(),
            software: (1, 2),
            mode: Mode::Operational,
            parameters: vec![("OUT1_TRIM", Value::Integer(1500)), ("NAME", Value::Text(vec![]))],
            read: Vec::new(),
            server: None,
            is_silent: false,
            cannot_listen: false,
            opened: Vec::new(),
            last: None,
            next_id: TransferId::default(),
        };
        rig.bus.connect(1_000_000, rig.now);
        rig.run(1);
        assert_eq!(rig.snapshot()["state"], "open");
        rig
    }

    fn snapshot(&self) -> Json {
        self.bus.snapshot(self.now)
    }

    /// Lets time pass, with the statuses of both nodes each second.
    fn run(&mut self, seconds: u64) {
        for turn in 0..seconds * 50 {
            self.now += ms(20);
            if turn % 50 == 0 && self.bus.was_open && !self.is_silent {
                for node in [1, NODE] {
                    let mode = if node == NODE { self.mode } else { Mode::Operational };
                    let uptime_s = 100 + self.now.as_secs() as u32;
                    let status = NodeStatus { mode, uptime_s, ..NodeStatus::default() };
                    self.broadcast(node, &Message::NodeStatus(status));
                }
            }
            self.bus.poll(self.now);
            self.serve();
        }
    }

    fn receive(&mut self, frames: &[Frame]) {
        let bytes: Vec<u8> = frames.iter().flat_map(|frame| slcan::line(frame, None)).collect();
        self.bus.receive(&bytes, self.now);
    }

    fn broadcast(&mut self, node: u8, message: &Message) {
        let (data_type, payload) = message.encode().unwrap();
        let id = data_type.message_id(20, id(node));
        let transfer_id = self.next_id.advance();
        self.receive(&frames_of(id, &payload, transfer_id));
    }

    /// The adapter and node 42: answers what the page sends.
    fn serve(&mut self) {
        loop {
            let output = self.bus.take_output();
            if output.is_empty() {
                return;
            }
            for byte in output {
                match self.commands.push(byte) {
                    Some(Ok(Command::Send(frame))) => self.hear(&frame),
                    Some(Ok(Command::Listen)) if self.cannot_listen => {
                        self.bus.receive(b"\x07", self.now);
                    }
                    Some(Ok(command)) => {
                        self.opened.extend((command == Command::Open).then_some(true));
                        self.opened.extend((command == Command::Listen).then_some(false));
                        self.bus.receive(b"\r", self.now);
                    }
                    Some(Err(())) => panic!("a wrong command"),
                    None => {}
                }
            }
            self.bus.poll(self.now);
        }
    }

    fn hear(&mut self, frame: &Frame) {
        self.last = Some(*frame);
        let Id::Extended(bits) = frame.id else { panic!("{frame}") };
        let pushed = self.assembler.push(bits, frame.data(), self.now);
        let Assembled::Complete(transfer) = pushed else { return };
        let message = Message::decode(&transfer);
        self.sent.push(message.name());
        let CanId::Service { service_id, request, destination, source, priority } = transfer.id
        else {
            return;
        };
        if destination != id(NODE) || self.is_silent {
            return;
        }
        if !request {
            self.take_part(&transfer.payload, source);
            return;
        }
        let Some(answer) = self.answer(message, source) else { return };
        let (_, payload) = answer.encode().unwrap();
        let (source, destination) = (id(NODE), source);
        let can_id = CanId::Service { priority, service_id, request: false, destination, source };
        self.receive(&frames_of(can_id, &payload, transfer.transfer_id));
        if let Some(server) = self.server
            && self.read.is_empty()
        {
            self.read_on(server);
        }
    }

    fn answer(&mut self, message: Message, source: NodeId) -> Option<Message> {
        Some(match message {
            Message::NodeInfoRequest => Message::NodeInfo(Box::new(NodeInfo {
                status: NodeStatus { mode: self.mode, ..NodeStatus::default() },
                name: self.name.clone(),
                software: self.software,
                hardware: (2, 1),
                image_crc: (self.software == (1, 3)).then_some(IMAGE_CRC),
                ..NodeInfo::default()
            })),
            Message::ParameterRequest(request) => {
                let by_name =
                    self.parameters.iter().position(|(name, _)| request.name == name.as_bytes());
                let index = by_name.unwrap_or(request.index.into());
                let mut response = ParameterResponse::default();
                if let Some((name, value)) = self.parameters.get_mut(index) {
                    if !request.value.is_empty() && request.value != Value::Integer(9999) {
                        *value = request.value;
                    }
                    (response.name, response.value) = (name.as_bytes().into(), value.clone());
                }
                Message::ParameterResponse(response)
            }
            Message::ExecuteOpcode(_) => Message::OpcodeExecuted(true),
            Message::BeginUpdate(_) => {
                (self.mode, self.server) = (Mode::SoftwareUpdate, Some(source));
                Message::UpdateBegun(NumberAndText::default())
            }
            _ => return None,
        })
    }

    /// Requests the next part of the file.
    fn read_on(&mut self, server: NodeId) {
        let offset = (self.read.len() % FILE_LEN) as u64;
        let payload = [&offset.to_le_bytes()[..5], b"fw.bin"].concat();
        let (source, destination) = (id(NODE), server);
        let can_id =
            CanId::Service { priority: 16, service_id: 48, request: true, destination, source };
        let transfer_id = self.next_id.advance();
        self.receive(&frames_of(can_id, &payload, transfer_id));
    }

    /// A part of the file. After the last the first is read again, and the program starts.
    fn take_part(&mut self, response: &[u8], server: NodeId) {
        if self.read.len() < FILE_LEN {
            self.read.extend(&response[2..]);
            self.read_on(server);
        } else {
            (self.mode, self.server, self.software) = (Mode::Operational, None, (1, 3));
        }
    }
}

#[test]
fn the_page_listens_and_sends_nothing_until_the_user_asks() {
    let mut rig = Rig::new();
    rig.run(10);
    let snapshot = rig.snapshot();
    assert_eq!((rig.sent.len(), &snapshot["own_id"]), (0, &Json::Null));
    assert_eq!(snapshot["nodes"].as_array().unwrap().len(), 2);
    assert_eq!(
        (&snapshot["nodes"][1]["id"], &snapshot["nodes"][1]["name"]),
        (&json!(42), &Json::Null)
    );
    rig.bus.choose(id(NODE));
    rig.run(2);
    assert!(rig.sent.is_empty(), "{:?}", rig.sent);
}

#[test]
fn the_adapter_only_listens_until_the_user_asks() {
    let mut rig = Rig::new();
    rig.run(5);
    assert_eq!((&rig.opened[..], &rig.snapshot()["only_listens"]), (&[false][..], &json!(true)));
    rig.bus.ask_names();
    rig.run(1);
    assert_eq!((&rig.opened[..], &rig.snapshot()["own_id"]), (&[false, true][..], &json!(126)));
}

/// Opened to send it would acknowledge frames, and at a wrong bit rate disturb the bus.
#[test]
fn an_adapter_that_cannot_listen_only_is_opened_when_the_user_allows_it() {
    let mut rig = Rig::new();
    rig.cannot_listen = true;
    rig.bus.connect(1_000_000, rig.now);
    rig.run(5);
    assert_eq!((&rig.snapshot()["state"], &rig.opened[..]), (&json!("asks"), &[false][..]));
    rig.bus.allow_sending(rig.now);
    rig.run(3);
    let snapshot = rig.snapshot();
    assert_eq!((&snapshot["state"], &snapshot["only_listens"]), (&json!("open"), &json!(false)));
    assert_eq!((&rig.opened[..], rig.sent.len()), (&[false, true][..], 0));
}

#[test]
fn the_page_takes_a_free_id_and_learns_the_names() {
    let mut rig = Rig::new();
    rig.run(3);
    rig.bus.ask_names();
    rig.run(5);
    let snapshot = rig.snapshot();
    assert_eq!(snapshot["own_id"], 126);
    assert_eq!(snapshot["nodes"][1]["name"], "org.dronecan.servo328");
    // Node 1 does not answer: three requests, and no more.
    let asked = rig.sent.iter().filter(|name| *name == "GetNodeInfo request").count();
    assert_eq!(asked, 4, "{:?}", rig.sent);
    assert!(rig.sent.iter().all(|name| name == "NodeStatus" || name == "GetNodeInfo request"));
}

/// An autopilot asks each node for its information.
#[test]
fn the_page_tells_its_name_as_each_node_does() {
    let mut rig = Rig::new();
    rig.run(3);
    let ask = |rig: &mut Rig, destination| {
        let (source, destination) = (id(1), id(destination));
        let can_id =
            CanId::Service { priority: 16, service_id: 1, request: true, destination, source };
        rig.receive(&frames_of(can_id, &[], TransferId::new(3)));
        rig.run(1);
        rig.sent.iter().filter(|name| *name == "GetNodeInfo response").count()
    };
    assert_eq!(ask(&mut rig, 126), 0);
    rig.bus.ask_names();
    rig.run(1);
    assert_eq!((ask(&mut rig, 126), ask(&mut rig, 42)), (1, 1));
}

#[test]
fn the_page_listens_before_it_takes_an_id() {
    let mut rig = Rig::new();
    rig.bus.ask_names();
    rig.run(1);
    assert_eq!((rig.sent.len(), &rig.snapshot()["listens_first"]), (0, &json!(true)));
    rig.run(2);
    assert_eq!(rig.snapshot()["own_id"], 126);
}

#[test]
fn another_node_with_the_page_s_id_silences_the_page_until_it_is_asked_again() {
    let mut rig = Rig::new();
    rig.run(3);
    rig.bus.ask_names();
    rig.run(3);
    rig.broadcast(126, &Message::NodeStatus(NodeStatus::default()));
    rig.run(1);
    let snapshot = rig.snapshot();
    assert_eq!(snapshot["own_id"], Json::Null);
    let trouble = snapshot["trouble"].as_str().unwrap();
    assert!(trouble.contains("another node sends with node ID 126"), "{trouble}");
    let sent = rig.sent.len();
    rig.run(5);
    assert_eq!(rig.sent.len(), sent);
    rig.bus.ask_names();
    rig.run(1);
    assert_eq!(rig.snapshot()["own_id"], 127);
}

#[test]
fn parameters_of_any_type_are_read_set_and_saved() {
    let mut rig = Rig::new();
    rig.run(3);
    rig.bus.choose(id(NODE));
    rig.bus.read_parameters();
    rig.run(3);
    let client = &rig.snapshot()["client"];
    assert_eq!(client["message"], "2 parameters read");
    assert_eq!(client["parameters"][0]["value"], "1500");
    assert_eq!(client["parameters"][1]["kind"], "text");
    assert!(rig.bus.set_parameter("OUT1_TRIM", "wide").is_err());
    rig.bus.set_parameter("OUT1_TRIM", "1444").unwrap();
    rig.bus.set_parameter("NAME", "left <b>wing</b>").unwrap();
    rig.bus.save_parameters();
    rig.run(2);
    assert_eq!(rig.parameters[0].1, Value::Integer(1444));
    assert_eq!(rig.parameters[1].1, Value::Text(b"left <b>wing</b>".to_vec()));
    assert_eq!(rig.sent.iter().filter(|name| name.starts_with("param.ExecuteOpcode")).count(), 1);
}

/// Node 42 takes any value of OUT1_TRIM but 9999.
#[test]
fn the_parameters_of_a_node_are_written_to_a_file_and_come_back_from_it() {
    let mut rig = Rig::new();
    rig.run(3);
    rig.bus.ask_names();
    rig.run(2);
    rig.bus.choose(id(NODE));
    rig.bus.read_parameters();
    rig.run(2);
    let file = rig.bus.parameter_file();
    let title = "# Parameters of node 42, org.dronecan.servo328";
    assert_eq!(file, format!("{title}\nOUT1_TRIM 1500\n#text NAME \n"));
    rig.bus.set_parameter("OUT1_TRIM", "1444").unwrap();
    rig.bus.set_parameter("NAME", "left").unwrap();
    rig.run(1);
    rig.bus.load_parameters(&file).unwrap();
    assert!(rig.bus.load_parameters(&file).is_err());
    rig.run(2);
    assert_eq!(rig.parameters[0].1, Value::Integer(1500));
    assert_eq!(rig.parameters[1].1, Value::Text(vec![]));
    assert_eq!(rig.snapshot()["client"]["message"], "from the file: 2 set, 0 were so before");
    rig.bus.load_parameters("OUT1_TRIM,9999\nOUT9_TRIM,1\n").unwrap();
    rig.run(2);
    let client = &rig.snapshot()["client"];
    assert_eq!(client["message"], "from the file: 0 set, 0 were so before, 2 NOT");
    let expected = [
        "OUT9_TRIM is no parameter of the node",
        "OUT1_TRIM 9999 was refused: the node keeps 1500",
    ];
    assert_eq!(client["problems"], json!(expected));
    rig.is_silent = true;
    rig.bus.load_parameters("OUT1_TRIM 1501\n").unwrap();
    rig.run(8);
    let client = &rig.snapshot()["client"];
    assert!(client["message"].as_str().unwrap().starts_with("no answer to "), "{client}");
    assert_eq!(client["problems"], json!(["OUT1_TRIM is not set"]));
}

#[test]
fn a_node_reads_its_firmware_from_the_page() {
    let mut rig = Rig::new();
    rig.run(3);
    rig.bus.update(id(NODE), firmware(), rig.now).unwrap();
    assert!(rig.bus.update(id(NODE), firmware(), rig.now).is_err());
    rig.run(6);
    assert_eq!(rig.read, firmware());
    let update = &rig.snapshot()["updates"][0];
    assert_eq!((&update["node"], &update["is_updated"]), (&json!(42), &json!(true)), "{update}");
    assert!(update["text"].as_str().unwrap().starts_with("runs version 1.3, before 1.2"));
    rig.run(3);
    assert_eq!(rig.snapshot()["nodes"][1]["software"], "1.3");
    assert!(rig.bus.suits(id(NODE), firmware()));
    assert!(!rig.bus.suits(id(1), firmware()) && !rig.bus.suits(id(NODE), Vec::new()));
}

#[test]
fn a_program_that_takes_no_further_update_is_not_sent() {
    let mut rig = Rig::new();
    rig.run(3);
    let mut last = firmware();
    last[0x78] ^= 1;
    let crc = crc_of(&last[..FILE_LEN - 2]);
    last[FILE_LEN - 2..].copy_from_slice(&crc.to_be_bytes());
    let error = rig.bus.update(id(NODE), last, rig.now).unwrap_err();
    assert!(error.contains("takes no further update over the bus"), "{error}");
}

#[test]
fn an_update_that_the_user_stops_is_told_with_the_state_of_the_node() {
    let mut rig = Rig::new();
    rig.run(3);
    rig.bus.ask_names();
    rig.run(3);
    rig.is_silent = true;
    rig.bus.update(id(NODE), firmware(), rig.now).unwrap();
    rig.run(1);
    assert_eq!(rig.snapshot()["updates"][0]["text"], "asking");
    rig.bus.stop_update(id(NODE), rig.now);
    let update = &rig.snapshot()["updates"][0];
    assert_eq!((&update["runs"], &update["is_updated"]), (&json!(false), &json!(false)));
    assert_eq!(update["text"], "has perhaps not begun the update. Try again");
}

/// The adapter is pulled out; the node's bootloader asks the page that was.
#[test]
fn an_update_that_was_cut_goes_on_with_the_node_id_that_the_node_asks() {
    let mut rig = Rig::new();
    rig.run(3);
    rig.bus.ask_names();
    rig.run(3);
    rig.mode = Mode::SoftwareUpdate;
    rig.bus.close("the adapter has been unplugged");
    assert_eq!(rig.snapshot()["trouble"], "the adapter has been unplugged");
    rig.bus.connect(1_000_000, rig.now);
    rig.run(2);
    rig.read = firmware()[..256].to_vec();
    rig.server = Some(id(99));
    for _ in 0..6 {
        rig.read_on(id(99));
        rig.run(1);
    }
    rig.bus.update(id(NODE), firmware(), rig.now).unwrap();
    rig.read_on(id(99));
    rig.run(1);
    assert_eq!(rig.snapshot()["own_id"], 99);
    rig.read_on(id(99));
    rig.run(6);
    assert_eq!(rig.read, firmware());
    assert_eq!(rig.snapshot()["updates"][0]["is_updated"], true, "{}", rig.snapshot()["updates"]);
}

#[test]
fn a_file_that_is_no_firmware_or_for_another_node_is_rejected_in_words() {
    let mut rig = Rig::new();
    rig.run(3);
    let error = rig.bus.update(id(NODE), b"\x7FELF".to_vec(), rig.now).unwrap_err();
    assert!(error.contains("ELF"), "{error}");
    rig.name = b"org.ardupilot.gps".to_vec();
    rig.bus.update(id(NODE), firmware(), rig.now).unwrap();
    rig.bus.update(id(1), firmware(), rig.now).unwrap();
    rig.run(7);
    let updates = rig.snapshot()["updates"].to_string();
    assert!(updates.contains("is another device: org.ardupilot.gps"), "{updates}");
    assert!(updates.contains("node 1 does not answer GetNodeInfo"), "{updates}");
    assert!(!rig.sent.iter().any(|name| name.contains("BeginFirmwareUpdate")), "{:?}", rig.sent);
}

/// The adapter returns what it has sent, with time stamps of microseconds.
#[test]
fn lines_that_are_not_slcan_and_echoes_are_counted() {
    let mut rig = Rig::new();
    rig.bus.receive(b"hello\rt12\r", rig.now);
    assert_eq!(rig.snapshot()["invalid"], 2);
    rig.run(3);
    rig.bus.ask_names();
    rig.run(3);
    let mut echo = slcan::line(&rig.last.unwrap(), None);
    echo.splice(echo.len() - 1.., b"0123ABCD\r".iter().copied());
    rig.bus.receive(&echo, rig.now);
    let snapshot = rig.snapshot();
    assert_eq!((&snapshot["echoed"], &snapshot["own_id"]), (&json!(1), &json!(126)));
}

/// 127 nodes, random frames and a flood: no panic, and limited memory.
#[test]
fn a_hostile_bus_uses_limited_memory() {
    let mut rig = Rig::new();
    rig.run(3);
    rig.bus.choose(id(NODE));
    rig.bus.read_parameters();
    let mut noise = bench::Noise::new(1);
    for turn in 0..300_u32 {
        rig.now += ms(10);
        let frames: Vec<Frame> = (0..100)
            .map(|_| {
                let bytes = noise.next_u64().to_le_bytes();
                let random = noise.next_u64() as u32;
                let id = match noise.below(3) {
                    0 => 20 << 24 | 341 << 8 | random & 0x7F,
                    _ => random & 0x1FFF_FFFF,
                };
                Frame::extended(id, &bytes[..noise.below(9) as usize])
            })
            .collect();
        rig.receive(&frames);
        let bytes: Vec<u8> = (0..50).flat_map(|_| noise.next_u64().to_le_bytes()).collect();
        // An adapter that rejects its commands would end the session.
        if rig.snapshot()["state"] == "open" {
            rig.bus.receive(&bytes, rig.now);
        }
        rig.serve();
        if turn % 50 == 0 {
            rig.bus.ask_names();
        }
    }
    let snapshot = rig.snapshot();
    // Some arrive while the adapter is opened to send.
    assert!(snapshot["received"].as_u64().unwrap() >= 25_000);
    assert!(snapshot["nodes"].as_array().unwrap().len() <= 127);
    assert!(rig.bus.take_events().as_array().unwrap().len() <= 4096);
    assert!(snapshot.to_string().len() < 100_000, "{}", snapshot.to_string().len());
}
