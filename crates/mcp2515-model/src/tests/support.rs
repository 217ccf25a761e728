//! A chip with a 16 MHz crystal and a peer on a 1 Mbit/s bus, used through SPI bytes only, and the
//! datasheet's numbers, restated.

use std::cell::RefCell;
use std::rc::Rc;

use super::super::{Mcp2515, Mode};
use can_model::{Bus, Frame, Id, PortId, SoftNode};
use sim_base::Cycles;

pub const BFPCTRL: u8 = 0x0C;
pub const TXRTSCTRL: u8 = 0x0D;
pub const CANSTAT: u8 = 0x0E;
pub const CANCTRL: u8 = 0x0F;
pub const TEC: u8 = 0x1C;
pub const REC: u8 = 0x1D;
pub const CNF3: u8 = 0x28;
pub const CNF2: u8 = 0x29;
pub const CNF1: u8 = 0x2A;
pub const CANINTE: u8 = 0x2B;
pub const CANINTF: u8 = 0x2C;
pub const EFLG: u8 = 0x2D;
pub const TXB0CTRL: u8 = 0x30;
pub const TXB0SIDH: u8 = 0x31;
pub const RXB0CTRL: u8 = 0x60;
pub const RXB0SIDH: u8 = 0x61;
pub const RXB1CTRL: u8 = 0x70;
pub const RXB1SIDH: u8 = 0x71;
pub const RXM0: u8 = 0x20;
pub const RXM1: u8 = 0x24;
/// RXF0SIDH to RXF5SIDH.
pub const RXF: [u8; 6] = [0x00, 0x04, 0x08, 0x10, 0x14, 0x18];

pub const RESET: u8 = 0xC0;
pub const READ: u8 = 0x03;
pub const WRITE: u8 = 0x02;
pub const BIT_MODIFY: u8 = 0x05;
pub const READ_STATUS: u8 = 0xA0;
pub const RX_STATUS: u8 = 0xB0;
pub const RTS0: u8 = 0x81;

pub const RX0IF: u8 = 0x01;
pub const RX1IF: u8 = 0x02;
pub const TX0IF: u8 = 0x04;
pub const ERRIF: u8 = 0x20;
pub const WAKIF: u8 = 0x40;
pub const MERRF: u8 = 0x80;

pub const ABTF: u8 = 0x40;
pub const MLOA: u8 = 0x20;
pub const TXERR: u8 = 0x10;
pub const TXREQ: u8 = 0x08;

pub const ABAT: u8 = 0x10;
pub const OSM: u8 = 0x08;
pub const BUKT: u8 = 0x04;
pub const EXIDE: u8 = 0x08;

pub const RX1OVR: u8 = 0x80;
pub const RX0OVR: u8 = 0x40;

pub const NORMAL: u8 = 0x00;
pub const SLEEP: u8 = 0x20;
pub const LOOPBACK: u8 = 0x40;
pub const LISTEN_ONLY: u8 = 0x60;
pub const CONFIGURATION: u8 = 0x80;

/// AVR cycles of a bit at 1 Mbit/s, and of an SPI byte at 8 MHz.
pub const BIT: Cycles = 16;
pub const SPI_BYTE: Cycles = 16;
/// More bits than any frame with its stuff bits, error frame and intermission.
pub const FRAME_BITS: u64 = 200;
/// 1 Mbit/s from 16 MHz with the sample point at 75 %: CNF3, CNF2, CNF1.
pub const CNF_1M: [u8; 3] = [0x01, 0x91, 0x00];
/// 500 kbit/s.
pub const CNF_500K: [u8; 3] = [0x01, 0xBC, 0x00];

pub struct Bench {
    pub bus: Bus,
    pub chip: Rc<RefCell<Mcp2515>>,
    pub peer: Rc<RefCell<SoftNode>>,
    pub peer_port: PortId,
    pub now: Cycles,
    /// True if the test has read the violations, so that `drop` need not check them.
    violations_read: bool,
}

impl Bench {
    /// A chip some time after power-up, in configuration mode.
    pub fn new() -> Bench {
        let mut bus = Bus::new(1_000_000);
        let chip = Rc::new(RefCell::new(Mcp2515::new(16_000_000)));
        let peer = Rc::new(RefCell::new(SoftNode::new(1_000_000)));
        bus.attach("chip", chip.clone());
        let peer_port = bus.attach("peer", peer.clone());
        let mut bench = Bench { bus, chip, peer, peer_port, now: 0, violations_read: false };
        bench.run_bits(100);
        bench
    }

    /// A chip with 1 Mbit/s that accepts all frames, in `mode`.
    pub fn in_mode(mode: u8) -> Bench {
        let mut bench = Bench::new();
        bench.set_up();
        bench.enter(mode);
        bench
    }

    pub fn normal() -> Bench {
        Bench::in_mode(NORMAL)
    }

    /// Sets 1 Mbit/s and masks 0; RXF0 accepts all standard frames, RXF1 all extended ones.
    pub fn set_up(&mut self) {
        self.write(CNF3, &CNF_1M);
        self.write(RXM0, &[0; 8]);
        for (n, address) in RXF.into_iter().enumerate() {
            let exide = if n % 2 == 1 { EXIDE } else { 0 };
            self.write(address, &[0, exide, 0, 0]);
        }
    }

    pub fn run_to(&mut self, t: Cycles) {
        assert!(t >= self.now, "the bench cannot go back");
        self.now = t;
        self.bus.run_until(t);
    }

    pub fn run_bits(&mut self, bits: u64) {
        self.run_to(self.now + bits * BIT);
    }

    /// Sends one SPI instruction. Returns the answer to each byte.
    pub fn spi(&mut self, bytes: &[u8]) -> Vec<u8> {
        self.select();
        let answers = bytes.iter().map(|&byte| self.byte(byte)).collect();
        self.deselect();
        answers
    }

    pub fn select(&mut self) {
        self.run_to(self.now + 4);
        self.chip.borrow_mut().select(self.now);
    }

    pub fn byte(&mut self, byte: u8) -> u8 {
        self.chip.borrow_mut().begin_byte(self.now);
        self.run_to(self.now + SPI_BYTE);
        self.chip.borrow_mut().end_byte(byte, self.now)
    }

    pub fn deselect(&mut self) {
        self.run_to(self.now + 4);
        self.chip.borrow_mut().deselect(self.now);
    }

    pub fn read(&mut self, address: u8) -> u8 {
        self.spi(&[READ, address, 0])[2]
    }

    pub fn read_many(&mut self, address: u8, count: usize) -> Vec<u8> {
        let mut bytes = vec![0xA5; count + 2];
        bytes[..2].copy_from_slice(&[READ, address]);
        self.spi(&bytes).split_off(2)
    }

    pub fn write(&mut self, address: u8, values: &[u8]) {
        let mut bytes = vec![WRITE, address];
        bytes.extend_from_slice(values);
        self.spi(&bytes);
    }

    pub fn modify(&mut self, address: u8, mask: u8, value: u8) {
        self.spi(&[BIT_MODIFY, address, mask, value]);
    }

    /// Requests a mode and waits for the time of a frame.
    #[track_caller]
    pub fn enter(&mut self, mode: u8) {
        self.request(mode);
        self.run_bits(FRAME_BITS);
        self.assert_opmod(mode);
    }

    pub fn request(&mut self, mode: u8) {
        self.modify(CANCTRL, 0xE0, mode);
    }

    #[track_caller]
    pub fn assert_opmod(&mut self, mode: u8) {
        let canstat = self.read(CANSTAT);
        assert_eq!(canstat & 0xE0, mode, "CANSTAT is {canstat:02X}h");
    }

    #[track_caller]
    pub fn assert_register(&mut self, address: u8, expected: u8) {
        let value = self.read(address);
        assert_eq!(value, expected, "register {address:02X}h is {value:02X}h, not {expected:02X}h");
    }

    /// The peer sends these frames back to back; waits until they have ended.
    pub fn peer_sends(&mut self, frames: &[Frame]) {
        for &frame in frames {
            self.peer.borrow_mut().send(frame);
        }
        self.run_bits(FRAME_BITS * frames.len() as u64);
    }

    /// Takes the frames that the peer has received.
    pub fn peer_received(&mut self) -> Vec<Frame> {
        let received = self.peer.borrow_mut().take_received();
        received.into_iter().map(|(_, frame)| frame).collect()
    }

    /// The identifiers of these.
    pub fn peer_ids(&mut self) -> Vec<Id> {
        self.peer_received().into_iter().map(|frame| frame.id).collect()
    }

    /// Fills transmit buffer `n` with a standard data frame, without sending it.
    pub fn load(&mut self, n: u8, id: u16, data: &[u8]) {
        let mut bytes =
            vec![0x40 + 2 * n, (id >> 3) as u8, (id << 5) as u8, 0, 0, data.len() as u8];
        bytes.extend_from_slice(data);
        self.spi(&bytes);
    }

    /// Sends RESET and waits until the oscillator has started.
    pub fn reset(&mut self) {
        self.spi(&[RESET]);
        self.run_bits(8);
    }

    /// Sends RTS for the buffers of the mask.
    pub fn rts(&mut self, mask: u8) {
        self.spi(&[0x80 | mask]);
    }

    /// Requests a standard data frame from buffer 0.
    pub fn send(&mut self, id: u16, data: &[u8]) {
        self.load(0, id, data);
        self.rts(1);
    }

    /// Aborts all frames, or the one of buffer 0 by its TXREQ.
    pub fn abort(&mut self, by_abat: bool) {
        let (register, mask, value) =
            if by_abat { (CANCTRL, ABAT, ABAT) } else { (TXB0CTRL, TXREQ, 0) };
        self.modify(register, mask, value);
    }

    /// The peer begins a frame; returns after its first few bits.
    pub fn occupy_bus(&mut self) {
        self.peer.borrow_mut().send(Frame::standard(0, &[0x55; 8]));
        self.run_bits(20);
    }

    /// Disconnects the peer, so that no node acknowledges.
    pub fn unplug_peer(&mut self) {
        self.bus.connect(self.peer_port, false);
    }

    pub fn mode(&self) -> Mode {
        self.chip.borrow().mode()
    }

    pub fn int_is_low(&self) -> bool {
        !self.chip.borrow().int_pin()
    }

    /// Takes the violations so far, for tests that expect some.
    pub fn violations(&mut self) -> Vec<String> {
        self.violations_read = true;
        let violations = self.chip.borrow_mut().take_violations();
        violations.into_iter().map(|violation| violation.text).collect()
    }

    /// Checks that there is exactly one violation and that its text contains all of `parts`.
    #[track_caller]
    pub fn assert_violation(&mut self, parts: &[&str]) {
        let violations = self.violations();
        assert_eq!(violations.len(), 1, "{violations:#?}");
        for part in parts {
            assert!(violations[0].contains(part), "{part:?} is not in {:?}", violations[0]);
        }
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        if !std::thread::panicking() && !self.violations_read {
            let violations = self.violations();
            assert!(violations.is_empty(), "unexpected violations: {violations:#?}");
        }
    }
}
