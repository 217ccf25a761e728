//! The rig of the black-box tests: the shipped ELF on a simulated board, and one other node on the bus to talk to it.
//!
//! Numbers of the protocol are written out here and in the tests, never taken from the firmware.

#![allow(dead_code, reason = "each test file uses its own part of the rig")]

use std::cell::RefCell;
use std::rc::Rc;

use sim::Cycles;
use sim::avr::Pulse;
use sim::bench::{Bench, node_elf};
use sim::board::Board;
use sim::can::{Frame, Id, PortId, RecordKind, SoftNode};

/// CPU cycles in a millisecond and in a microsecond.
pub const MS: Cycles = 16_000;
pub const US: Cycles = 16;

/// The node under test.
pub const NODE: u32 = 120;

/// CAN identifiers of what the node sends.
pub const STATUS_OF_NODE: u32 = 0x1801_5500 | NODE;
pub const TEMPERATURE_OF_NODE: u32 = 0x1804_5600 | NODE;
pub const DEGREES_OF_NODE: u32 = 0x1804_5800 | NODE;

/// CAN identifiers, without a sender, of what it takes.
pub const NODE_STATUS: u32 = 0x1801_5500;
pub const ARRAY_COMMAND: u32 = 0x1003_F200;
pub const SERVO_COMMAND: u32 = 0x1004_5700;

/// The board, the bus, and a peer that acknowledges and talks.
pub struct Rig {
    pub bench: Bench,
    pub peer: Rc<RefCell<SoftNode>>,
    pub peer_port: PortId,
    /// What passed on the bus: end of frame, and the frame.
    pub traffic: Vec<(Cycles, Frame)>,
    pub error_frames: usize,
    pub pulses: Vec<Pulse>,
    pub serial: String,
    /// Driver mistakes and lost frames that the test means to happen.
    pub violations_expected: bool,
    pub overflows_expected: bool,
    status_transfer_id: u8,
    command_transfer_id: u8,
}

impl Rig {
    /// A board that gets its power now, on a bus of 1 Mbit/s with the peer.
    pub fn powered() -> Rig {
        let mut bench = Bench::new(1_000_000);
        let board = Board::load(&node_elf()).unwrap_or_else(|error| panic!("{error:#}"));
        bench.add_board(board, "node");
        let peer = Rc::new(RefCell::new(SoftNode::new(1_000_000)));
        let peer_port = bench.attach("peer", peer.clone());
        Rig {
            bench,
            peer,
            peer_port,
            traffic: Vec::new(),
            error_frames: 0,
            pulses: Vec::new(),
            serial: String::new(),
            violations_expected: false,
            overflows_expected: false,
            status_transfer_id: 0,
            command_transfer_id: 0,
        }
    }

    /// A board that is up: it has sent its first status, and that is forgotten again.
    #[track_caller]
    pub fn running() -> Rig {
        let mut rig = Rig::powered();
        rig.wait_for("the first NodeStatus", 100, |rig| !rig.statuses().is_empty());
        rig.run_ms(150);
        rig.forget();
        rig
    }

    pub fn board(&mut self) -> &mut Board {
        self.bench.board(0)
    }

    pub fn now(&self) -> Cycles {
        self.bench.now()
    }

    /// Forgets what was seen so far.
    pub fn forget(&mut self) {
        self.traffic.clear();
        self.pulses.clear();
        self.serial.clear();
        self.error_frames = 0;
    }

    pub fn run_ms(&mut self, ms: u64) {
        self.run_until(self.now() + ms * MS);
    }

    pub fn run_until(&mut self, t: Cycles) {
        while self.now() < t {
            // In small steps, so that nothing piles up.
            self.bench.run_until(t.min(self.now() + 10 * MS));
            self.collect();
        }
    }

    /// Runs until the condition holds, which it must within so many simulated milliseconds.
    #[track_caller]
    pub fn wait_for(&mut self, what: &str, timeout_ms: u64, mut condition: impl FnMut(&Rig) -> bool) {
        let end = self.now() + timeout_ms * MS;
        while !condition(self) {
            assert!(self.now() < end, "no {what} within {timeout_ms} ms\nserial monitor:\n{}", self.serial);
            self.bench.run_until(self.now() + MS / 10);
            self.collect();
        }
    }

    fn collect(&mut self) {
        for record in self.bench.bus().take_records() {
            match record.kind {
                RecordKind::Frame { frame, .. } => self.traffic.push((record.end, frame)),
                RecordKind::ErrorFrame { .. } => self.error_frames += 1,
            }
        }
        let board = self.bench.board(0);
        self.pulses.extend(board.take_servo_pulses());
        self.serial.extend(board.avr_mut().serial_take().into_iter().map(|(_, byte)| char::from(byte)));
        let violations = board.take_violations();
        assert!(self.violations_expected || violations.is_empty(), "driver mistakes: {violations:#?}");
        self.peer.borrow_mut().take_received();
    }

    /// The peer sends a frame.
    pub fn send(&mut self, id: u32, data: &[u8]) {
        self.peer.borrow_mut().send(Frame::extended(id, data));
    }

    pub fn send_frame(&mut self, frame: Frame) {
        self.peer.borrow_mut().send(frame);
    }

    /// The peer sends a NodeStatus as node `source`.
    pub fn send_status_from(&mut self, source: u8) {
        let transfer_id = Self::count(&mut self.status_transfer_id);
        self.send(NODE_STATUS | u32::from(source), &[10, 0, 0, 0, 0, 0, 0, 0xC0 | transfer_id]);
    }

    /// The peer sends one command of an ArrayCommand, as node 10.
    pub fn send_command(&mut self, actuator_id: u8, command_type: u8, value: f32) {
        let transfer_id = Self::count(&mut self.command_transfer_id);
        let [low, high] = half::f16::from_f32(value).to_le_bytes();
        self.send(ARRAY_COMMAND | 10, &[actuator_id, command_type, low, high, 0xC0 | transfer_id]);
    }

    /// The peer sends the thesis's command, as node 1.
    pub fn send_servo_command(&mut self, position: u8) {
        let transfer_id = Self::count(&mut self.command_transfer_id);
        self.send(SERVO_COMMAND | 1, &[position, 0xC0 | transfer_id]);
    }

    fn count(transfer_id: &mut u8) -> u8 {
        let current = *transfer_id;
        *transfer_id = (current + 1) % 32;
        current
    }

    /// The frames with this identifier, oldest first.
    pub fn frames(&self, id: u32) -> Vec<(Cycles, Vec<u8>)> {
        let same = |frame: &Frame| matches!(frame.id, Id::Extended(other) if other == id);
        self.traffic.iter().filter(|(_, frame)| same(frame)).map(|(at, frame)| (*at, frame.data().to_vec())).collect()
    }

    pub fn statuses(&self) -> Vec<(Cycles, Vec<u8>)> {
        self.frames(STATUS_OF_NODE)
    }

    /// The width of the last pulse, in half microseconds.
    pub fn last_pulse(&self) -> Option<u64> {
        self.pulses.last().map(|pulse| pulse.width_cycles / 8)
    }

    /// Runs for two periods of the servo, and tells the width of the last pulse in microseconds.
    #[track_caller]
    pub fn settled_pulse_us(&mut self) -> f64 {
        self.run_ms(45);
        self.pulses.last().expect("a pulse").width_us()
    }

    /// Runs until the serial monitor has said this.
    #[track_caller]
    pub fn wait_for_line(&mut self, text: &str, timeout_ms: u64) {
        self.wait_for(&format!("line {text:?}"), timeout_ms, |rig| {
            rig.serial.lines().any(|line| line.contains(text)) && rig.serial.ends_with('\n')
        });
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        if std::thread::panicking() {
            return;
        }
        self.collect();
        let lost = self.board().chip().borrow().rx_overflows();
        assert!(self.overflows_expected || lost == 0, "{lost} frames were lost in the controller");
    }
}

/// The uptime, health, mode and vendor code in a NodeStatus.
pub fn status_fields(data: &[u8]) -> (u32, u8, u8, u16) {
    assert_eq!(data.len(), 8, "a NodeStatus and its tail byte");
    let uptime = u32::from_le_bytes(data[..4].try_into().unwrap());
    (uptime, data[4] >> 6, data[4] >> 3 & 7, u16::from_le_bytes(data[5..7].try_into().unwrap()))
}
