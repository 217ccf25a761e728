//! Tests of the real bus with an adapter that has two nodes: 42, which answers, and 1, which does
//! not. `web/check/bus.mjs` has more of them, on the page.

use super::*;
use bench::dronecan::slcan::{self, Command, Lines};
use bench::dronecan::{
    Assembler, CanId, Id, Outcome as Assembled, TransferId, frames as frames_of,
};

const NODE: u8 = 42;
const FILE_LEN: usize = 600;

fn id(id: u8) -> NodeId {
    NodeId::new(id).unwrap()
}

fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

/// A firmware file for hardware 2.1, version 1.3; docs/update.md has its form.
fn firmware() -> Vec<u8> {
    let mut bytes: Vec<u8> = (0..FILE_LEN - 2).map(|n| n as u8).collect();
    let [low, high] = (FILE_LEN as u16).to_le_bytes();
    bytes[0x68..0x6E].copy_from_slice(&[2, 1, 1, 3, low, high]);
    bytes[0x78..0x80].copy_from_slice(&[0x40, 0xA2, 0xE4, 0xF1, 0x64, 0x68, 0x91, 0x06]);
    let crc = bytes.iter().fold(0xFFFF, |crc, byte| dronecan_wire::crc::step(crc, *byte));
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
    is_silent: bool,
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
            is_silent: false,
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
                    let uptime_s = 100 + self.now.as_secs() as u32;
                    let status = NodeStatus { uptime_s, ..NodeStatus::default() };
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
                    Some(Ok(_)) => self.bus.receive(b"\r", self.now),
                    Some(Err(())) => panic!("a wrong command"),
                    None => {}
                }
            }
            self.bus.poll(self.now);
        }
    }

    fn hear(&mut self, frame: &Frame) {
        let Id::Extended(bits) = frame.id else { panic!("{frame}") };
        let pushed = self.assembler.push(bits, frame.data(), self.now);
        let Assembled::Complete(transfer) = pushed else { return };
        let message = Message::decode(&transfer);
        self.sent.push(message.name());
        let CanId::Service { service_id, request, destination, source, priority } = transfer.id
        else {
            return;
        };
        let is_asked = request && destination == id(NODE) && !self.is_silent;
        if is_asked && matches!(message, Message::NodeInfoRequest) {
            let info = NodeInfo::<NodeStatus> {
                name: self.name.clone(),
                hardware: (2, 1),
                ..NodeInfo::default()
            };
            let (source, destination) = (destination, source);
            let can_id =
                CanId::Service { priority, service_id, request: false, destination, source };
            self.receive(&frames_of(can_id, &info.encode(), transfer.transfer_id));
        }
    }
}

#[test]
fn the_page_listens_then_takes_a_free_id_and_learns_the_names() {
    let mut rig = Rig::new();
    rig.bus.ask_names();
    rig.run(1);
    assert_eq!((rig.sent.len(), &rig.snapshot()["listens_first"]), (0, &json!(true)));
    rig.run(7);
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
