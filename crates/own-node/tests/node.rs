//! The node on mcp2515-ordered, with a model of the MCP2515 on a simulated bus. Requests and
//! expected payloads are written from the DSDL, and split by a second implementation of transfers.

mod models;

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use can_model::{Frame as BusFrame, Id as BusId, PortId, RecordKind, SoftNode};
use dronecan_wire::golden;
use embedded_can::nb::Can;
use mcp2515_ordered::{Attempts, BitTiming, Configuration, Filters, SharedMcp2515};
use models::{BIT_RATE, CRYSTAL_HZ, MS, Memory, Wires, World};
use own_node::{Action, Node};

/// Signatures of the services that only this test asks for.
const RESTART_NODE: u64 = 0x569E_0539_4A30_17F0;
const EXECUTE_OPCODE: u64 = 0x3B13_1AC5_EB69_D2CD;

/// The bus, and an autopilot with the ID 10 on it.
struct Rig {
    world: World,
    wires: Wires,
    chip_port: PortId,
    peer: Rc<RefCell<SoftNode>>,
    memory: Memory,
    actions: Vec<Action>,
}

impl Rig {
    fn new() -> Rig {
        let world = World::new();
        let (wires, chip_port) = Wires::new(&world);
        let peer = Rc::new(RefCell::new(SoftNode::new(BIT_RATE)));
        world.attach("autopilot", peer.clone());
        world.run(MS);
        Rig { world, wires, chip_port, peer, memory: Memory::default(), actions: vec![] }
    }

    /// Makes the node, as after power-up.
    fn node(&self) -> Node<impl Can<Error = mcp2515_ordered::CanError> + use<>, Memory> {
        let world = self.world.clone();
        let configuration = Configuration {
            timing: const { BitTiming::new(CRYSTAL_HZ, BIT_RATE) },
            acceptance: Filters::ALL_EXTENDED,
            attempts: Attempts::UntilSent,
        };
        let can = SharedMcp2515::new(self.wires.clone(), self.wires.clone(), configuration)
            .with_clock(move || world.now_ms() as u16);
        Node::new(can, self.memory.clone(), *b"0123456789ABCDEF")
    }

    /// Runs the node, and returns the frames that it sent.
    fn run<C: Can<Error: std::fmt::Debug>>(
        &mut self,
        node: &mut Node<C, Memory>,
        ms: u64,
    ) -> Vec<golden::Frame> {
        let end = self.world.now() + ms * MS;
        while self.world.now() < end {
            self.actions.extend(node.turn(self.world.now_ms(), 300 * 32).unwrap());
            self.world.run(MS / 20);
        }
        let records = self.world.take_records();
        let frames = records.iter().filter_map(|record| match record.kind {
            RecordKind::Frame { frame, from, .. } if from == Some(self.chip_port) => {
                let BusId::Extended(id) = frame.id else { panic!("{frame:?}") };
                Some(golden::frame(id, frame.data()))
            }
            RecordKind::Frame { .. } => None,
            RecordKind::ErrorFrame { .. } => panic!("{record:?}"),
        });
        frames.collect()
    }

    fn send(&self, id: u32, signature: u64, payload: &[u8]) {
        for frame in golden::transfer(id, signature, 7, payload) {
            self.peer.borrow_mut().send(BusFrame::extended(frame.id, &frame.data));
        }
    }

    /// Sends a request to node 42, and returns the payload of the response.
    fn ask<C: Can<Error: std::fmt::Debug>>(
        &mut self,
        node: &mut Node<C, Memory>,
        service: u32,
        signature: u64,
        payload: &[u8],
    ) -> Vec<u8> {
        self.send(0x1E00_AA8A | service << 16, signature, payload);
        let mut frames = self.run(node, 20);
        frames.retain(|frame| frame.id == 0x1E00_0AAA | service << 16);
        let (payload, transfer_id) = golden::payload(signature, &frames);
        assert_eq!(transfer_id, 7);
        payload
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            let violations = self.wires.take_violations();
            assert!(violations.is_empty(), "driver mistakes: {violations:#?}");
        }
    }
}

/// A response of GetSet with a whole number.
fn parameter(value: i64, default: i64, max: i64, min: i64, name: &str) -> Vec<u8> {
    let numbers =
        [value, default, max, min].map(|number| [&[1], &number.to_le_bytes()[..]].concat());
    [&numbers.concat(), name.as_bytes()].concat()
}

/// A request of GetSet: a whole number or nothing, and a name.
fn set(value: i64, name: &str) -> Vec<u8> {
    [&[0, 1], &value.to_le_bytes()[..], name.as_bytes()].concat()
}

#[test]
fn a_node_status_and_a_temperature_are_sent_each_second() {
    let mut rig = Rig::new();
    let mut node = rig.node();
    let frames = rig.run(&mut node, 3000);
    let of = |id| frames.iter().filter(move |frame| frame.id == id).map(|frame| &frame.data[..]);
    let statuses: Vec<&[u8]> = of(0x1801_552A).collect();
    assert_eq!(statuses.len() + of(0x1804_562A).count(), frames.len());
    assert_eq!(statuses[2], [2, 0, 0, 0, 0, 0, 0, 0xC2]);
    // 300 K as float16: 1.171875 * 2^8.
    assert_eq!(of(0x1804_562A).nth(1), Some(&[0, 0, 0xB0, 0x5C, 0, 0xC1][..]));
}

#[test]
fn node_info_has_the_status_the_versions_the_unique_id_and_the_name() {
    let mut rig = Rig::new();
    let mut node = rig.node();
    rig.run(&mut node, 1100);
    let info = rig.ask(&mut node, 1, golden::GET_NODE_INFO, &[]);
    let versions = [&[1, 0][..], &[0; 13], &[1, 0]].concat();
    let expected =
        [&[1, 0, 0, 0, 0, 0, 0], &versions[..], b"0123456789ABCDEF", &[0], own_node::NAME].concat();
    assert_eq!(info, expected);
}

#[test]
fn the_entry_of_an_array_command_for_this_actuator_moves_it() {
    let mut rig = Rig::new();
    let mut node = rig.node();
    rig.run(&mut node, 20);
    // Actuator 3 to 1.0, and actuator 1 to -0.5.
    let payload = [3, 0, 0x00, 0x3C, 1, 0, 0x00, 0xB8];
    rig.send(0x1003_F20A, golden::ARRAY_COMMAND, &payload);
    rig.send(0x1003_F20A, golden::ARRAY_COMMAND, &payload[..4]);
    rig.run(&mut node, 5);
    assert_eq!(rig.actions, [Action::Move(-500)]);
}

#[test]
fn parameters_are_listed_set_within_their_limits_and_kept_once_stored() {
    let mut rig = Rig::new();
    let mut node = rig.node();
    rig.run(&mut node, 20);
    let mut get_set =
        |rig: &mut Rig, payload: &[u8]| rig.ask(&mut node, 11, golden::GET_SET, payload);
    assert_eq!(get_set(&mut rig, &[0, 0]), parameter(42, 42, 127, 1, "NODE_ID"));
    assert_eq!(get_set(&mut rig, &[1, 0]), parameter(1, 1, 255, 0, "ACTUATOR_ID"));
    assert_eq!(get_set(&mut rig, &[2, 0]), [0; 4]);
    assert_eq!(get_set(&mut rig, &[0, 0, b'X']), [0; 4]);
    let of_actuator = |value| parameter(value, 1, 255, 0, "ACTUATOR_ID");
    assert_eq!(get_set(&mut rig, &set(9, "ACTUATOR_ID")), of_actuator(9));
    assert_eq!(get_set(&mut rig, &set(256, "ACTUATOR_ID")), of_actuator(9));
    // More than 32 bits, of which the lower ones would be allowed.
    assert_eq!(get_set(&mut rig, &set(1 << 32 | 7, "ACTUATOR_ID")), of_actuator(9));

    // Not stored yet.
    let mut node = rig.node();
    rig.run(&mut node, 20);
    assert_eq!(rig.ask(&mut node, 11, golden::GET_SET, &[1, 0]), of_actuator(1));
    rig.ask(&mut node, 11, golden::GET_SET, &set(9, "ACTUATOR_ID"));
    let save = rig.ask(&mut node, 10, EXECUTE_OPCODE, &[0; 7]);
    assert_eq!(save, [0, 0, 0, 0, 0, 0, 0x80]);
    let mut node = rig.node();
    rig.run(&mut node, 20);
    assert_eq!(rig.ask(&mut node, 11, golden::GET_SET, &[1, 0]), of_actuator(9));
    let erase = rig.ask(&mut node, 10, EXECUTE_OPCODE, &[1, 0, 0, 0, 0, 0, 0]);
    assert_eq!(erase, [0, 0, 0, 0, 0, 0, 0x80]);
    assert_eq!(rig.ask(&mut node, 11, golden::GET_SET, &[1, 0]), of_actuator(1));
}

#[test]
fn a_restart_needs_the_magic_number() {
    let mut rig = Rig::new();
    let mut node = rig.node();
    rig.run(&mut node, 20);
    assert_eq!(rig.ask(&mut node, 5, RESTART_NODE, &[0x1E, 0x1B, 0x55, 0xCE, 0xAD]), [0]);
    assert_eq!(rig.actions, []);
    assert_eq!(rig.ask(&mut node, 5, RESTART_NODE, &[0x1E, 0x1B, 0x55, 0xCE, 0xAC]), [0x80]);
    assert_eq!(rig.actions, [Action::Restart]);
}

/// The frames in a driver that sends none, and returns the oldest for a new one if `returns`. It
/// accepts no frame if `is_full`. It always has a received frame if `is_busy`.
#[derive(Default)]
struct Mailboxes {
    waiting: VecDeque<BusFrame>,
    returns: bool,
    is_full: bool,
    is_busy: bool,
}

#[derive(Clone, Default)]
struct Blocked(Rc<RefCell<Mailboxes>>);

impl Can for Blocked {
    type Frame = BusFrame;
    type Error = embedded_can::ErrorKind;

    fn transmit(&mut self, frame: &BusFrame) -> nb::Result<Option<BusFrame>, Self::Error> {
        let mut mailboxes = self.0.borrow_mut();
        if mailboxes.is_full {
            return Err(nb::Error::WouldBlock);
        }
        let returned = if mailboxes.returns { mailboxes.waiting.pop_front() } else { None };
        mailboxes.waiting.push_back(*frame);
        Ok(returned)
    }

    fn receive(&mut self) -> nb::Result<BusFrame, Self::Error> {
        let of_another = BusFrame::extended(0x1F00_0014, &[0; 8]);
        self.0.borrow().is_busy.then_some(of_another).ok_or(nb::Error::WouldBlock)
    }
}

#[test]
fn a_frame_that_the_driver_returns_is_sent_again_before_the_next_one() {
    let driver = Blocked::default();
    let mut node = Node::new(driver.clone(), Memory::default(), [0; 16]);
    node.turn(0, 300 * 32).unwrap();
    let status = driver.0.borrow().waiting[0];
    driver.0.borrow_mut().returns = true;
    node.turn(500, 300 * 32).unwrap();
    let temperature = driver.0.borrow_mut().waiting.pop_front().unwrap();
    assert_ne!(temperature.id, status.id);
    driver.0.borrow_mut().returns = false;
    node.turn(1000, 300 * 32).unwrap();
    let sent = &driver.0.borrow().waiting;
    assert_eq!(sent[0], status);
    assert_eq!((sent[1].id, sent.len()), (status.id, 2));
}

#[test]
fn the_uptime_is_right_after_a_time_in_which_nothing_could_be_sent() {
    let driver = Blocked::default();
    let mut node = Node::new(driver.clone(), Memory::default(), [0; 16]);
    for now_ms in 0..80_000 {
        driver.0.borrow_mut().is_full = (5_000..70_000).contains(&now_ms);
        node.turn(now_ms, 300 * 32).unwrap();
    }
    let sent = driver.0.borrow();
    let status = sent.waiting.iter().rfind(|frame| frame.dlc == 8).unwrap();
    assert_eq!(status.data()[..4], [79, 0, 0, 0]);
}

#[test]
fn received_frames_go_first_but_the_node_sends_on_a_full_bus_too() {
    let driver = Blocked::default();
    driver.0.borrow_mut().is_busy = true;
    let mut node = Node::new(driver.clone(), Memory::default(), [0; 16]);
    for _ in 0..8 {
        node.turn(0, 300 * 32).unwrap();
        assert!(driver.0.borrow().waiting.is_empty());
    }
    node.turn(0, 300 * 32).unwrap();
    assert_eq!(driver.0.borrow().waiting.len(), 1);
}
