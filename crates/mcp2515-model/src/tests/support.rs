//! A chip with a 16 MHz crystal and a peer on a 1 Mbit/s bus, used through SPI bytes only, and the
//! datasheet's numbers, restated.

use std::cell::RefCell;
use std::rc::Rc;

use super::super::{Mcp2515, Mode};
use can_model::{Bus, Frame, PortId, SoftNode};
use sim_base::Cycles;

macro_rules! named {
    ($($name:ident = $value:literal)*) => {
        $(pub const $name: u8 = $value;)*
        /// The names that scripts can use.
        pub const NAMED: &[(&str, u8)] = &[$((stringify!($name), $name)),*];
    };
}

named! {
    RXF0 = 0x00 RXF1 = 0x04 RXF2 = 0x08 RXF3 = 0x10 RXF4 = 0x14 RXF5 = 0x18 RXM0 = 0x20 RXM1 = 0x24
    BFPCTRL = 0x0C TXRTSCTRL = 0x0D CANSTAT = 0x0E CANCTRL = 0x0F TEC = 0x1C REC = 0x1D
    CNF3 = 0x28 CNF2 = 0x29 CNF1 = 0x2A CANINTE = 0x2B CANINTF = 0x2C EFLG = 0x2D
    TXB0CTRL = 0x30 TXB0SIDH = 0x31 TXB0D0 = 0x36 TXB1CTRL = 0x40 TXB2CTRL = 0x50
    RXB0CTRL = 0x60 RXB0SIDH = 0x61 RXB0D0 = 0x66 RXB1CTRL = 0x70 RXB1SIDH = 0x71 RXB1D0 = 0x76
    // Instructions.
    RESET = 0xC0 READ = 0x03 WRITE = 0x02 BIT_MODIFY = 0x05 READ_STATUS = 0xA0 RX_STATUS = 0xB0
    // CANINTF.
    RX0IF = 0x01 RX1IF = 0x02 TX0IF = 0x04 TX1IF = 0x08 TX2IF = 0x10 ERRIF = 0x20 WAKIF = 0x40
    MERRF = 0x80
    // TXBnCTRL.
    ABTF = 0x40 MLOA = 0x20 TXERR = 0x10 TXREQ = 0x08
    // CANCTRL, RXBnCTRL and SIDL.
    ABAT = 0x10 OSM = 0x08 BUKT = 0x04 EXIDE = 0x08
    // EFLG.
    RX1OVR = 0x80 RX0OVR = 0x40 TXBO = 0x20 TXEP = 0x10 RXEP = 0x08 TXWAR = 0x04 RXWAR = 0x02
    EWARN = 0x01
    // REQOP and OPMOD.
    NORMAL = 0x00 SLEEP = 0x20 LOOPBACK = 0x40 LISTEN_ONLY = 0x60 CONFIGURATION = 0x80
}

/// RXF0SIDH to RXF5SIDH.
pub const RXF: [u8; 6] = [RXF0, RXF1, RXF2, RXF3, RXF4, RXF5];

/// AVR cycles of a bit at 1 Mbit/s, and of an SPI byte at 8 MHz.
pub const BIT: Cycles = 16;
pub const SPI_BYTE: Cycles = 16;
/// More bits than any frame with its stuff bits, error frame and intermission.
pub const FRAME_BITS: u64 = 200;
/// 1 Mbit/s from 16 MHz with the sample point at 75 %: CNF3, CNF2, CNF1.
pub const CNF_1M: [u8; 3] = [0x01, 0x91, 0x00];

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

    /// Runs cycle by cycle until CANINTF is not 0.
    #[track_caller]
    pub fn run_to_flag(&mut self) {
        let end = self.now + 10 * FRAME_BITS * BIT;
        while self.chip.borrow().register(CANINTF) == 0 {
            assert!(self.now < end, "no flag");
            self.run_to(self.now + 1);
        }
    }

    /// Sends one SPI instruction. Returns the answer to each byte.
    pub fn spi(&mut self, bytes: &[u8]) -> Vec<u8> {
        self.select();
        let answers = bytes.iter().map(|&byte| self.byte(byte)).collect();
        self.deselect();
        answers
    }

    /// Sends an instruction at a time to which the bus has not come yet.
    pub fn spi_at(&self, at: Cycles, bytes: &[u8]) {
        spi_at(&mut self.chip.borrow_mut(), at, bytes);
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

/// Sends an instruction to a chip, all bytes at the same time. Returns the answer to the last.
pub fn spi_at(chip: &mut Mcp2515, at: Cycles, bytes: &[u8]) -> u8 {
    chip.select(at);
    let mut answer = 0;
    for byte in bytes {
        chip.begin_byte(at);
        answer = chip.end_byte(*byte, at);
    }
    chip.deselect(at);
    answer
}

impl Drop for Bench {
    fn drop(&mut self) {
        if !std::thread::panicking() && !self.violations_read {
            let violations = self.violations();
            assert!(violations.is_empty(), "unexpected violations: {violations:#?}");
        }
    }
}
