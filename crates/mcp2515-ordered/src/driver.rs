//! Driver of the MCP2515 (datasheet DS20001801J): never waits, keeps frames in order, and keeps an eye on the chip.
//!
//! # How it works
//!
//! [`Mcp2515::poll`] brings the chip up one short step at a time: reset, then each register written *and read back*, then
//! normal mode, which must show in CANSTAT. While it runs, `poll` looks every [`SUPERVISION_MS`] whether the chip still has
//! its configuration (a brown-out or a glitch resets it), whether INT says what the chip does, and at its errors. Whatever
//! goes wrong, it tells and starts over, for ever: at once if the chip was running, else after [`RETRY_MS`]. Filters and
//! masks are the exception: outside configuration mode they read as zero (4.5), so once the chip runs nobody can see whether
//! it keeps them.
//!
//! [`Mcp2515::calls`] goes by the level of the INT pin. Waiting for an edge loses the chip when a second frame arrives
//! before the first is read, because then the pin never rises.
//!
//! # Cost
//!
//! A frame is received in two chip selects and 8 bytes besides its data: READ STATUS, and READ RX BUFFER, which also clears
//! the flag. Only if the chip still calls after that, there is a look at once (see `rx_order.rs`), which the next frame
//! then does not need. A frame is sent in three chip selects and 19 bytes: READ STATUS, WRITE, and RTS.
//!
//! # Assumptions
//!
//! `receive` must be called for each frame within two frame times (one where the filters leave it one buffer), or the chip loses
//! frames. It counts as lost at least one each time that it says so. An interrupt may call it where the driver is not in use.
//!
//! An SPI or a pin that reports an error is not told apart from a chip that fails: what it reads is nonsense, and the chip is
//! started over.

use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal::spi::SpiBus;

use crate::bit_timing::BitTiming;
use crate::counters::{Counter, Counters};
use crate::frame::Frame;
use crate::registers::*;
use crate::rx_order::{Buffer, RxOrder};
use crate::tx_order::{Rank, TxOrder};

/// Between two looks at a running chip, in milliseconds.
pub const SUPERVISION_MS: u8 = 10;

/// From a failure to start to the next reset of the chip, in milliseconds.
pub const RETRY_MS: u8 = 100;

/// From RESET to the first access, in milliseconds: the oscillator takes 128 cycles to start (8.1), 8 us at 16 MHz. One
/// tick of the clock may be over at once, so two.
const START_UP_MS: u8 = 2;

/// How often to look for normal mode, once a millisecond. The chip waits for eleven recessive bits (10.5), which a busy bus
/// offers after every frame.
const NORMAL_MODE_LOOKS: u8 = 50;

/// Looks until frames that nobody acknowledges are given up (DroneCAN specification, chapter 4: one second).
const TX_TIMEOUT_LOOKS: u8 = (1000 / SUPERVISION_MS as u16) as u8;

/// The registers of a filter or a mask: SIDH, SIDL, EID8 and EID0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pattern([u8; 4]);

impl Pattern {
    /// A filter for an extended identifier, most significant byte first.
    pub const fn filter(id: [u8; 4]) -> Self {
        Self(registers(id))
    }

    /// A mask: a bit of 1 compares that bit of the identifier.
    pub const fn mask(id: [u8; 4]) -> Self {
        let [sidh, sidl, eid8, eid0] = registers(id);
        // A mask has no bit for the kind of frame.
        Self([sidh, sidl & !IDE, eid8, eid0])
    }

    /// SIDH, SIDL, EID8 and EID0.
    pub const fn registers(self) -> [u8; 4] {
        self.0
    }
}

/// What the chip is to accept: six filters and two masks (DS20001801J 4.5). Filters 0 and 1 go with mask 0 and buffer 0,
/// filters 2 to 5 with mask 1 and buffer 1. What finds buffer 0 full goes to buffer 1.
pub trait Acceptance {
    /// Of four registers each, those of filters 0 to 5, then those of masks 0 and 1: `n` is 0 to 31. See [`Pattern`].
    fn register(&self, n: u8) -> u8;
}

/// What [`Mcp2515::poll`] has to tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Notice {
    /// What happened.
    pub event: Event,
    /// What was read, see [`Event`].
    pub value: u8,
}

/// What happened to the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Event {
    /// The chip is configured and on the bus. The value is CANSTAT.
    Running,
    /// Not in configuration mode after a reset. The value is CANSTAT; 0x00 and 0xFF mean that nobody answers.
    NotAnswering,
    /// A register did not read back as written. The value is its address.
    NotKeeping,
    /// Normal mode was asked for and did not come: the bus is held dominant. The value is CANSTAT.
    NotStarting,
    /// The chip lost its configuration while running, or INT is stuck. The value is zero.
    Lost,
    /// Frames waited for a second without success and were given up. The value is zero.
    GaveUpSending,
    /// One of the error flags has changed or frames were lost. The value is EFLG, see [`ErrorFlags`].
    Flags,
}

/// What the driver knows of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct State {
    /// It is time to [`poll`](Mcp2515::poll).
    pub is_due: bool,
    /// The chip is on the bus.
    pub is_running: bool,
    /// When last looked at, the chip had nothing left to send.
    pub is_empty: bool,
    /// The chip has room for a frame.
    pub has_room: bool,
}

/// EFLG, as read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorFlags(pub u8);

impl ErrorFlags {
    /// A frame for us was lost because the receive buffers were full.
    pub fn frames_lost(self) -> bool {
        self.0 & (RX0OVR | RX1OVR) != 0
    }

    /// The chip is off the bus, and comes back by itself after 128 x 11 recessive bits.
    pub fn bus_off(self) -> bool {
        self.0 & TXBO != 0
    }

    /// 128 or more errors in either counter.
    pub fn error_passive(self) -> bool {
        self.0 & (TXEP | RXEP) != 0
    }
}

/// Steps on the way to the bus.
mod step {
    /// To be reset.
    pub const DOWN: u8 = 0;
    /// Reset; its oscillator starts.
    pub const STARTING: u8 = 1;
    /// The register at address 0 is to be configured. The others follow.
    pub const CONFIGURING: u8 = 2;
    /// Normal mode is asked for. The following steps look whether it is there.
    pub const ENTERING: u8 = CONFIGURING + super::CANINTE + 1;
    /// The last look.
    pub const LAST_LOOK: u8 = ENTERING + super::NORMAL_MODE_LOOKS;
    /// On the bus. From here on the chip runs.
    pub const RUNNING: u8 = 0x80;
    /// On the bus, with frames being given up.
    pub const ABORTING: u8 = RUNNING + 1;
}

/// The chip, on an SPI of mode 0,0 and at most 10 MHz, with its CS and INT pins.
pub struct Mcp2515<SPI, CS, INT, A> {
    spi: SPI,
    cs: CS,
    int: INT,
    counters: Counters,
    /// CNF3, CNF2, CNF1 and CANINTE.
    timing: [u8; 4],
    /// EFLG without the flags of loss.
    flags: u8,
    /// REC when last looked at.
    rec: u8,
    acceptance: A,
    tx: TxOrder,
    /// When polled last, modulo 256, and how long to wait from then.
    polled_ms: u8,
    wait_ms: u8,
    /// Buffers that waited to be sent when last looked at, as READ STATUS shows them, and for how many looks of supervision
    /// that has not changed.
    tx_waiting: u8,
    tx_looks: u8,
    /// Which part of a look at the running chip was last.
    look: u8,
    /// CANCTRL on the bus: normal mode, with OSM in one-shot mode.
    control: u8,
    /// Where the next frame is to go.
    room: Option<Rank>,
    rx: RxOrder,
    step: u8,
}

impl<SPI: SpiBus, CS: OutputPin, INT: InputPin, A: Acceptance> Mcp2515<SPI, CS, INT, A> {
    /// A chip that is reset at the first [`poll`](Self::poll). For `one_shot` see [`reconfigure`](Self::reconfigure).
    pub const fn new(spi: SPI, cs: CS, int: INT, acceptance: A) -> Self {
        Self {
            spi,
            cs,
            int,
            acceptance,
            timing: [0; 4],
            control: 0,
            step: step::DOWN,
            polled_ms: 0,
            wait_ms: 0,
            rx: RxOrder::new(),
            tx: TxOrder::new(),
            room: None,
            tx_waiting: 0,
            tx_looks: 0,
            look: 0,
            flags: 0,
            rec: 0,
            counters: Counters::new(),
        }
    }

    /// Takes over bit timing and filters; to be called before anything else.
    #[inline(always)]
    pub fn configure(&mut self, timing: BitTiming, acceptance: A, one_shot: bool) {
        self.timing = [timing.cnf3, timing.cnf2, timing.cnf1, RX0IE | RX1IE];
        self.reconfigure(acceptance, one_shot);
    }

    /// Starts the chip over with other filters, from the next [`poll`](Self::poll) on; what it has not sent yet is lost. It
    /// is off the bus for about 5 ms.
    ///
    /// With `one_shot` each frame is tried once only, whether it gets through or not (3.4), which DroneCAN demands of anonymous
    /// frames. The driver requests transmission by RTS in SPI mode 0,0; a request by WRITE could send a frame again if CS
    /// stayed low until it is over (DS80000179, 5).
    pub fn reconfigure(&mut self, acceptance: A, one_shot: bool) {
        self.acceptance = acceptance;
        self.control = if one_shot { OSM } else { 0 };
        self.step = step::DOWN;
        self.wait_ms = 0;
    }

    /// What it has seen.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Whether the chip is on the bus.
    pub fn is_running(&self) -> bool {
        self.step >= step::RUNNING
    }

    /// What the driver knows of the chip without asking it. `now_ms` wraps around; to be asked every 100 ms at least.
    #[inline(always)]
    pub fn state(&mut self, now_ms: u16) -> State {
        State {
            is_due: self.is_due(now_ms),
            is_running: self.is_running(),
            is_empty: self.tx_waiting == 0,
            has_room: self.room.is_some(),
        }
    }

    #[inline(always)]
    fn is_due(&mut self, now_ms: u16) -> bool {
        (now_ms as u8).wrapping_sub(self.polled_ms) >= self.wait_ms
            // On the bus already, with a frame: the next one may be there in 70 us.
            || (step::ENTERING..step::RUNNING).contains(&self.step) && self.is_int_low()
    }

    /// Does the next short step of start-up or supervision.
    #[inline(never)]
    pub fn poll(&mut self, now_ms: u16) -> Option<Notice> {
        self.polled_ms = now_ms as u8;
        let step = self.step;
        if step >= step::RUNNING {
            return self.supervise();
        }
        self.step = step + 1;
        self.wait_ms = 0;
        if step == step::DOWN {
            self.wait_ms = START_UP_MS;
            self.select();
            self.exchange(instruction::RESET);
            self.deselect();
            return None;
        }
        if (step::CONFIGURING..step::ENTERING).contains(&step) {
            let address = step - step::CONFIGURING;
            let value = self.configuration(address);
            self.access(instruction::WRITE, address, value);
            if self.access(instruction::READ, address, 0) != value {
                return self.fail(Event::NotKeeping, address);
            }
            // Behind the filters are registers that are not configured: 0x0C to 0x0F, 0x1C to 0x1F.
            if address == 0x0B || address == 0x1B {
                self.step = step + 5;
            }
            return None;
        }
        if step == step::ENTERING {
            self.access(instruction::WRITE, RXB0CTRL, BUKT);
            self.write_control(0);
        }
        let canstat = self.access(instruction::READ, CANSTAT, 0);
        let mode = canstat & OPMOD;
        if step == step::STARTING {
            if mode != MODE_CONFIGURATION {
                return self.fail(Event::NotAnswering, canstat);
            }
            return None;
        }
        self.wait_ms = 1;
        if mode == MODE_NORMAL {
            self.step = step::RUNNING;
            self.rx = RxOrder::new();
            self.room = None;
            self.tx_waiting = 0;
            self.look = 0;
            return Some(Notice { event: Event::Running, value: canstat });
        }
        if step == step::LAST_LOOK {
            return self.fail(Event::NotStarting, canstat);
        }
        None
    }

    /// Whether [`receive`](Self::receive) is worth calling. Costs a few cycles, where `receive` would cost 60 to say no.
    #[inline(always)]
    pub fn calls(&mut self) -> bool {
        (self.has_seen_one() || self.is_int_low()) && self.is_running()
    }

    /// Whether the last look at the chip showed one frame more than was received.
    #[inline(always)]
    pub fn has_seen_one(&self) -> bool {
        !self.rx.is_empty()
    }

    fn is_int_low(&mut self) -> bool {
        // A pin that cannot be read counts as low: a look too many costs 2 us, a look too few a frame.
        self.int.is_low().unwrap_or(true)
    }

    /// Gets the next frame out of the chip, if there is one; whether there was. A standard or remote frame is marked
    /// [`Frame::FOREIGN`].
    #[inline(always)]
    pub fn receive(&mut self, frame: &mut Frame) -> bool {
        if self.rx.is_empty() {
            let status = self.status();
            self.rx.seen_late(status);
        }
        let Some(buffer) = self.rx.take() else {
            return false;
        };
        self.select();
        // RXB0 is read by 0x90, RXB1 by 0x94.
        self.exchange(instruction::READ_RX_BUFFER | (buffer as u8 & Buffer::Rxb1 as u8) << 1);
        _ = self.spi.read(&mut frame.id);
        let dlc = self.exchange(0);
        frame.len = (dlc & DLC).min(Frame::MAX_LEN as u8);
        if let Some(data) = frame.data.get_mut(..usize::from(frame.len)) {
            _ = self.spi.read(data);
        }
        self.deselect();

        self.counters.count_long(Counter::RxReceived);
        // From SIDH and SIDL; see `registers`.
        let [sidh, sidl, ..] = frame.id;
        frame.id[0] = sidh >> 3;
        frame.id[1] = sidh << 5 | (sidl >> 3) & 0b1_1100 | sidl & 0b11;
        if sidl & IDE == 0 || dlc & RTR != 0 {
            frame.id[0] |= Frame::FOREIGN;
        }
        if buffer == Buffer::Rxb0 && self.rx.is_empty() && self.is_int_low() {
            let status = self.status();
            self.rx.seen_at_once(status);
        }
        true
    }

    /// Looks whether the chip has room for a frame that is to be sent after all that it has already.
    #[inline(never)]
    pub fn find_room(&mut self) {
        if self.step == step::RUNNING {
            self.look_at_waiting();
            self.room = self.tx.next(self.tx_waiting);
        }
    }

    /// Hands a frame to the chip. Nothing happens unless [`find_room`](Self::find_room) has found room.
    #[inline(never)]
    pub fn transmit(&mut self, frame: &Frame) {
        let Some(rank) = self.room.take() else { return };
        self.tx_waiting |= rank.status();
        self.counters.count_long(Counter::TxRequests);
        // TXB0, TXB1, TXB2: addresses 0x30, 0x40, 0x50. The priority is in the register before the identifier.
        self.begin(instruction::WRITE, TXB0CTRL + ((rank.buffer() & 6) << 3));
        self.exchange(rank.priority());
        let [b3, b2, ..] = frame.id;
        self.exchange(sidh(b3, b2));
        self.exchange(sidl(b2));
        self.exchange(frame.id[2]);
        self.exchange(frame.id[3]);
        self.exchange(frame.len);
        // What follows the last byte that counts goes to the chip, too, which does not send it.
        _ = self.spi.write(&frame.data);
        self.deselect();
        self.select();
        self.exchange(instruction::RTS | rank.buffer());
        self.deselect();
    }

    /// A look at a running chip, in three steps.
    fn supervise(&mut self) -> Option<Notice> {
        self.wait_ms = 0;
        self.look = self.look.wrapping_add(1);
        if self.look == 1 {
            return self.look_at_configuration();
        }
        if self.look == 2 {
            let rec = self.access(instruction::READ, REC, 0);
            self.counters.add(Counter::RxErrors, rec.saturating_sub(self.rec));
            self.rec = rec;
            if self.access(instruction::READ, RXB0CTRL, 0) & (RXM | BUKT) != BUKT || self.is_int_stuck() {
                return self.fail(Event::Lost, 0);
            }
            return None;
        }
        self.look = 0;
        self.wait_ms = SUPERVISION_MS;
        self.look_at_waiting();
        if self.step == step::ABORTING {
            self.step = step::RUNNING;
            self.write_control(0);
        }
        // It cannot overflow: it is set back at TX_TIMEOUT_LOOKS, when all buffers are emptied.
        self.tx_looks = self.tx_looks.wrapping_add(1);
        if self.tx_looks == TX_TIMEOUT_LOOKS {
            self.step = step::ABORTING;
            self.write_control(ABAT);
            return Some(Notice { event: Event::GaveUpSending, value: 0 });
        }
        None
    }

    fn look_at_configuration(&mut self) -> Option<Notice> {
        self.begin(instruction::READ, CNF3);
        let mut wrong = 0;
        let mut address = CNF3;
        while address <= CANINTE {
            wrong |= self.next() ^ self.configuration(address);
            address += 1;
        }
        let _canintf = self.next();
        let eflg = self.next();
        let canstat = self.next();
        let canctrl = self.next();
        self.deselect();
        wrong |= (canstat & OPMOD) ^ MODE_NORMAL;
        wrong |= (canctrl ^ self.control) & !ABAT;
        if wrong != 0 {
            return self.fail(Event::Lost, 0);
        }
        let before = core::mem::replace(&mut self.flags, eflg & !(RX0OVR | RX1OVR));
        if eflg == before {
            return None;
        }
        if eflg & (RX0OVR | RX1OVR) != 0 {
            self.counters.add(Counter::RxOverflow, 1);
            // The flags of loss stay until they are cleared; the others are read-only.
            self.access(instruction::WRITE, EFLG, 0);
        }
        if eflg & !before & TXBO != 0 {
            self.counters.add(Counter::BusOffs, 1);
        }
        Some(Notice { event: Event::Flags, value: eflg })
    }

    /// INT is low as long as a frame waits. One may come between the looks at the pin and at the chip, but none goes.
    #[inline(always)]
    fn is_int_stuck(&mut self) -> bool {
        if self.is_int_low() {
            return self.status() & status::RXIF == 0;
        }
        self.status() & status::RXIF != 0 && !self.is_int_low()
    }

    #[inline(never)]
    fn write_control(&mut self, abort: u8) {
        self.access(instruction::WRITE, CANCTRL, self.control | abort);
    }

    /// What a register is to hold; `address` is that of a filter, a mask, CNF1 to CNF3 or CANINTE.
    #[inline(never)]
    fn configuration(&self, address: u8) -> u8 {
        // RXF0 to RXF2 begin at address 0, RXF3 to RXF5 at 0x10, the masks at 0x20, CNF3 at 0x28.
        let n = address.wrapping_sub((address & 0x30) >> 2);
        if n < 32 { self.acceptance.register(n) } else { self.timing[usize::from(n & 3)] }
    }

    #[inline(never)]
    fn fail(&mut self, event: Event, value: u8) -> Option<Notice> {
        // One that was running is reset at once: with another bit timing it would disturb the bus meanwhile.
        self.wait_ms = if self.is_running() { 0 } else { RETRY_MS };
        self.step = step::DOWN;
        Some(Notice { event, value })
    }

    /// Notes which buffers wait to be sent, and counts those that no longer do.
    #[inline(never)]
    fn look_at_waiting(&mut self) {
        let waiting = self.status() & status::TXREQ;
        let mut gone = self.tx_waiting & !waiting;
        if waiting == 0 || waiting != self.tx_waiting {
            self.tx_waiting = waiting;
            self.tx_looks = 0;
        }
        while gone != 0 {
            gone &= gone - 1;
            if self.step == step::ABORTING {
                self.counters.add(Counter::TxTimedOut, 1);
            } else if self.control == MODE_NORMAL {
                self.counters.add(Counter::TxSuccess, 1);
            }
        }
    }

    /// READ STATUS.
    #[inline(never)]
    fn status(&mut self) -> u8 {
        self.select();
        self.exchange(instruction::READ_STATUS);
        let status = self.exchange(0);
        self.deselect();
        status
    }

    /// READ or WRITE of one register.
    #[inline(never)]
    fn access(&mut self, instruction: u8, address: u8, value: u8) -> u8 {
        self.begin(instruction, address);
        let answer = self.exchange(value);
        self.deselect();
        answer
    }

    /// The beginning of a READ or WRITE.
    #[inline(never)]
    fn begin(&mut self, instruction: u8, address: u8) {
        self.select();
        self.exchange(instruction);
        self.exchange(address);
    }

    /// The next register of a READ.
    #[inline(never)]
    fn next(&mut self) -> u8 {
        self.exchange(0)
    }

    #[inline(always)]
    fn select(&mut self) {
        _ = self.cs.set_low();
    }

    #[inline(always)]
    fn deselect(&mut self) {
        _ = self.cs.set_high();
    }

    #[inline(never)]
    fn exchange(&mut self, byte: u8) -> u8 {
        let mut bytes = [byte];
        _ = self.spi.transfer_in_place(&mut bytes);
        bytes[0]
    }
}

/// SIDH, SIDL, EID8 and EID0 for an extended identifier: bits 28..21; 20..18, IDE and 17..16; 15..8; 7..0.
const fn registers([b3, b2, b1, b0]: [u8; 4]) -> [u8; 4] {
    [sidh(b3, b2), sidl(b2), b1, b0]
}

const fn sidh(b3: u8, b2: u8) -> u8 {
    b3 << 3 | b2 >> 5
}

const fn sidl(b2: u8) -> u8 {
    (b2 << 3) & 0b1110_0000 | IDE | b2 & 0b11
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identifiers_are_laid_out_as_the_datasheet_draws_them() {
        // Registers 5-4 to 5-7: one bit at a time.
        for bit in 0..29 {
            let id = (1u32 << bit).to_be_bytes();
            let expected = match bit {
                0..8 => [0, 0x08, 0, 1 << bit],
                8..16 => [0, 0x08, 1 << (bit - 8), 0],
                16 | 17 => [0, 0x08 | 1 << (bit - 16), 0, 0],
                18..21 => [0, 0x08 | 1 << (bit - 18 + 5), 0, 0],
                _ => [1 << (bit - 21), 0x08, 0, 0],
            };
            assert_eq!(registers(id), expected, "bit {bit}");
        }
    }
}
