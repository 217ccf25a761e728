//! The driver: start-up, supervision, and received and sent frames.

use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal::spi::SpiBus;

use crate::chip::{Chip, Step};
use crate::configuration::{Attempts, Configuration};
use crate::counters::{Counter, Counters};
use crate::filters::Acceptance;
use crate::frame::Frame;
use crate::registers::*;
use crate::rx_order::{Buffer, RxOrder};
use crate::tx_order::{Rank, TxOrder};

/// Time between two supervisions of a running chip, in milliseconds.
pub const SUPERVISION_MS: u8 = 10;

/// Time in which a chip leaves the bus for configuration mode, in milliseconds: the longest frame
/// takes 1.3 ms at 125 kbit/s.
const LEAVE_MS: u8 = 3;

/// Time from a failed start-up to the next reset of the chip, in milliseconds.
pub const RETRY_MS: u8 = 100;

/// Timeout of frames that wait to be sent, in milliseconds. An older frame is of no use to most
/// receivers.
pub const TX_TIMEOUT_MS: u16 = 1000;

/// Time from RESET to the first access, in milliseconds. The oscillator takes 128 cycles to start
/// (DS20001801J 8.1), 8 us at 16 MHz. The first tick of the clock may come at once, so two ticks
/// are necessary.
const START_UP_MS: u8 = 2;

/// Number of supervisions until the driver gives up the frames that wait.
const TX_TIMEOUT_CHECKS: u8 = (TX_TIMEOUT_MS / SUPERVISION_MS as u16) as u8;

/// A report of [`Mcp2515::poll`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Notice {
    /// The event.
    pub event: Event,
    /// A value that the chip returned: see [`Event`].
    pub value: u8,
}

/// An event of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Event {
    /// The chip is configured and on the bus. The value is CANSTAT.
    Running,
    /// The chip was not in configuration mode after a reset. The value is CANSTAT; 0x00 and 0xFF
    /// mean that no chip answers.
    NotAnswering,
    /// A register did not read back as written. The value is its address.
    NotKeeping,
    /// The chip did not enter normal mode, because the bus is stuck dominant. The value is CANSTAT.
    NotStarting,
    /// The chip lost its configuration while running, or INT is stuck. The value is zero.
    Lost,
    /// The driver gave up frames that waited for [`TX_TIMEOUT_MS`]. The value is zero.
    GaveUpSending,
    /// An error flag changed, or frames were lost. The value is EFLG: see [`ErrorFlags`].
    Flags,
}

/// The state of the chip, as far as the driver knows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct State {
    /// [`poll`](Mcp2515::poll) is due.
    pub is_due: bool,
    /// The chip is on the bus.
    pub is_running: bool,
    /// At the last check the chip had no frame left to send.
    pub is_empty: bool,
    /// The chip has room for a frame: [`find_room`](Mcp2515::find_room) has found a buffer, and no
    /// frame has taken it since.
    pub has_room: bool,
}

/// The value of EFLG.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorFlags(pub u8);

impl ErrorFlags {
    /// True if an accepted frame was lost because the receive buffers were full.
    pub fn frames_lost(self) -> bool {
        self.0 & (RX0OVR | RX1OVR) != 0
    }

    /// True if the chip is bus-off. It recovers by itself after 128 x 11 recessive bits.
    pub fn bus_off(self) -> bool {
        self.0 & TXBO != 0
    }

    /// True if either error counter is 128 or more.
    pub fn error_passive(self) -> bool {
        self.0 & (TXEP | RXEP) != 0
    }
}

/// The driver of a chip on an SPI in mode 0,0 with at most 10 MHz, with its CS and INT pins.
///
/// Only the chip may be on the SPI ([`SpiBus`]): the driver keeps CS low during several calls of
/// the bus.
pub struct Mcp2515<SPI, CS, INT, A> {
    chip: Chip<SPI, CS>,
    int: INT,
    counters: Counters,
    configuration: Configuration<A>,
    /// EFLG at the last check, without RX0OVR and RX1OVR.
    flags: u8,
    /// REC at the last check.
    rec: u8,
    tx: TxOrder,
    /// Time of the last poll, modulo 256, and time from then to the next poll.
    polled_ms: u8,
    wait_ms: u8,
    /// Time of the last check of the error flags, modulo 256.
    looked_ms: u8,
    /// Buffers that waited to be sent at the last check, as bits of READ STATUS, and number of
    /// supervisions since that changed.
    tx_waiting: u8,
    tx_checks: u8,
    /// The last part of a supervision that was done.
    part: u8,
    /// The rank for the next frame, if there is room.
    room: Option<Rank>,
    rx: RxOrder,
    step: Step,
}

impl<SPI: SpiBus, CS: OutputPin, INT: InputPin, A: Acceptance> Mcp2515<SPI, CS, INT, A> {
    /// Makes a driver. The first [`poll`](Self::poll) resets the chip.
    pub const fn new(spi: SPI, cs: CS, int: INT, configuration: Configuration<A>) -> Self {
        Self {
            chip: Chip::new(spi, cs),
            int,
            configuration,
            step: Step::DOWN,
            polled_ms: 0,
            wait_ms: 0,
            looked_ms: 0,
            rx: RxOrder::new(),
            tx: TxOrder::new(),
            room: None,
            tx_waiting: 0,
            tx_checks: 0,
            part: 0,
            flags: 0,
            rec: 0,
            counters: Counters::new(),
        }
    }

    /// Makes a driver that does not access the chip before [`configure`](Self::configure). The
    /// value is all zero bytes apart from the four arguments, so that the start-up code need
    /// not copy a `static` from flash.
    pub const fn unconfigured(spi: SPI, cs: CS, int: INT, acceptance: A) -> Self {
        let configuration = Configuration {
            timing: crate::BitTiming::UNSET,
            acceptance,
            attempts: Attempts::UntilSent,
        };
        Self::new(spi, cs, int, configuration)
    }

    /// Restarts the chip with `configuration`, from the next [`poll`](Self::poll) on. Frames that
    /// the chip has not sent yet are lost. The chip is off the bus for about 5 ms.
    #[inline(always)]
    pub fn configure(&mut self, configuration: Configuration<A>) {
        self.configuration = configuration;
        self.restart();
    }

    /// Changes the configuration of a chip on the bus, and configures it again without a reset. The
    /// chip leaves the bus for about 5 ms when the frame on the bus is over, so no frame that
    /// it has acknowledged is lost. Frames that it has not sent yet are aborted. A chip that is not
    /// on the bus is restarted as by [`configure`](Self::configure).
    #[inline(always)]
    pub fn reconfigure(&mut self, now_ms: u16, change: impl FnOnce(&mut Configuration<A>)) {
        change(&mut self.configuration);
        if !self.is_running() {
            return self.restart();
        }
        self.step = Step::STARTING;
        self.polled_ms = now_ms as u8;
        self.wait_ms = LEAVE_MS;
        self.chip.write_canctrl(MODE_CONFIGURATION | ABAT);
    }

    #[inline(always)]
    fn restart(&mut self) {
        self.step = Step::DOWN;
        self.wait_ms = 0;
    }

    /// The counters of the driver.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// True if the chip is on the bus.
    pub fn is_running(&self) -> bool {
        self.step.is_running()
    }

    /// Returns the state without an access to the chip. `now_ms` wraps around, so call this at
    /// least every 100 ms.
    #[inline(always)]
    pub fn state(&mut self, now_ms: u16) -> State {
        State {
            is_due: self.is_due(now_ms),
            is_running: self.is_running(),
            is_empty: self.is_empty(),
            has_room: self.room.is_some(),
        }
    }

    /// As [`State::is_empty`].
    #[inline(always)]
    pub fn is_empty(&self) -> bool {
        self.tx_waiting == 0
    }

    #[inline(always)]
    fn is_due(&mut self, now_ms: u16) -> bool {
        (now_ms as u8).wrapping_sub(self.polled_ms) >= self.wait_ms
            // Bus-off, into which only a chip that sends can come, lasts at least 1.4 ms.
            || self.tx_waiting != 0 && now_ms as u8 != self.looked_ms
            // The chip is on the bus already and has a frame. The next one may arrive within 70 us.
            || (Step::ENTERING..Step::RUNNING).contains(&self.step) && self.is_int_low()
    }

    /// Does the next short step of start-up or supervision. Call it when [`State::is_due`] is true.
    #[inline(never)]
    pub fn poll(&mut self, now_ms: u16) -> Option<Notice> {
        let now_ms = now_ms as u8;
        let is_early = now_ms.wrapping_sub(self.polled_ms) < self.wait_ms;
        let step = self.step;
        if step.is_running() && is_early {
            self.looked_ms = now_ms;
            return self.check_errors();
        }
        self.polled_ms = now_ms;
        if step.is_running() {
            return self.supervise();
        }
        self.wait_ms = 0;
        if step == Step::DOWN && !self.configuration.timing.is_set() {
            return None;
        }
        self.step = step.next();
        if step == Step::DOWN {
            self.wait_ms = START_UP_MS;
            self.chip.reset();
            // The chip has lost its waiting frames. If they still counted, each next poll would be
            // due at once until the chip answers.
            self.tx_waiting = 0;
            return None;
        }
        if let Some(mut mode) = self.chip.configuration_mode(step) {
            if let Some(register) = mode.register() {
                let value = self.configuration.register(register);
                if !mode.write(register, value) {
                    return self.fail(Event::NotKeeping, register);
                }
                if let Some(step) = mode.step_over(register) {
                    self.step = step;
                }
                return None;
            }
            mode.leave(self.configuration.canctrl());
        }
        let canstat = self.chip.read(CANSTAT);
        let mode = canstat & OPMOD;
        if step == Step::STARTING {
            if mode != MODE_CONFIGURATION {
                return self.fail(Event::NotAnswering, canstat);
            }
            return None;
        }
        self.wait_ms = 1;
        if mode == MODE_NORMAL {
            self.step = Step::RUNNING;
            self.rx = RxOrder::new();
            self.room = None;
            self.part = 0;
            return Some(Notice { event: Event::Running, value: canstat });
        }
        if step == Step::LAST_CHECK {
            return self.fail(Event::NotStarting, canstat);
        }
        None
    }

    /// True if [`receive`](Self::receive) is likely to find a frame. Takes a few cycles; `receive`
    /// needs an SPI instruction to find that there is none.
    #[inline(always)]
    pub fn has_frame(&mut self) -> bool {
        // A chip that has left the bus still has the frames that it received.
        (!self.rx.is_empty() || self.is_int_low())
            && (self.is_running() || self.step == Step::STARTING)
    }

    fn is_int_low(&mut self) -> bool {
        // A pin that cannot be read counts as low: an unnecessary check costs 2 us, and a missing
        // check loses a frame.
        self.int.is_low().unwrap_or(true)
    }

    /// Reads the next frame from the chip. Returns false if there is none. It marks a standard or
    /// remote frame with [`Frame::FOREIGN`].
    #[inline(always)]
    pub fn receive(&mut self, frame: &mut Frame) -> bool {
        if self.rx.is_empty() {
            let status = self.chip.status();
            self.rx.seen_late(status);
        }
        let Some(buffer) = self.rx.take() else {
            return false;
        };
        let dlc = self.chip.read_frame(buffer, frame);

        self.counters.count_long(Counter::RxReceived);
        // Converts SIDH and SIDL: see `filters::registers`.
        let [sidh, sidl, ..] = frame.id;
        frame.id[0] = sidh >> 3;
        frame.id[1] = sidh << 5 | (sidl >> 3) & 0b1_1100 | sidl & 0b11;
        if sidl & IDE == 0 || dlc & RTR != 0 {
            frame.id[0] |= Frame::FOREIGN;
        }
        if buffer == Buffer::Rxb0 && self.rx.is_empty() && self.is_int_low() {
            let status = self.chip.status();
            self.rx.seen_at_once(status);
        }
        true
    }

    /// Checks if the chip has a buffer from which a frame is sent after all frames that wait. Then
    /// [`State::has_room`] is true.
    #[inline(never)]
    pub fn find_room(&mut self) {
        if self.step == Step::RUNNING {
            self.check_waiting();
            self.room = self.tx.next(self.tx_waiting);
        }
    }

    /// Passes a frame to the chip. Does nothing unless [`find_room`](Self::find_room) has found
    /// room.
    #[inline(never)]
    pub fn transmit(&mut self, frame: &Frame) {
        if let Some(rank) = self.take_room() {
            self.chip.send_frame(rank, frame);
        }
    }

    /// Passes the identifier and length of a frame to the chip, as the first half of
    /// [`transmit`](Self::transmit): between the halves an interrupt handler can receive a frame.
    #[inline(never)]
    pub fn begin_transmit(&mut self, frame: &Frame) {
        if let Some(rank) = self.room {
            self.chip.write_identifier(rank, frame);
        }
    }

    /// Passes the data of the same frame to the chip, and sends it.
    #[inline(never)]
    pub fn finish_transmit(&mut self, frame: &Frame) {
        if let Some(rank) = self.take_room() {
            self.chip.write_data_and_send(rank, frame);
        }
    }

    /// Takes the room for a frame that will wait in the chip.
    #[inline(always)]
    fn take_room(&mut self) -> Option<Rank> {
        let rank = self.room.take()?;
        self.tx_waiting |= rank.status();
        self.counters.count_long(Counter::TxRequests);
        Some(rank)
    }

    /// Does the next of the four parts of a supervision, each of which takes less time than to pass
    /// a frame to the chip.
    fn supervise(&mut self) -> Option<Notice> {
        self.wait_ms = 0;
        self.part = self.part.wrapping_add(1);
        if self.part == 1 {
            return self.check_configuration();
        }
        if self.part == 2 {
            return self.check_errors();
        }
        if self.part == 3 {
            let rec = self.chip.read(REC);
            self.counters.add(Counter::RxErrors, rec.saturating_sub(self.rec));
            self.rec = rec;
            if self.chip.read(RXB0CTRL) & (RXM | BUKT) != BUKT || self.is_int_stuck() {
                return self.fail(Event::Lost, 0);
            }
            return None;
        }
        self.part = 0;
        self.wait_ms = SUPERVISION_MS;
        self.check_waiting();
        if self.step == Step::ABORTING {
            self.step = Step::RUNNING;
            self.write_canctrl(0);
        }
        // This cannot overflow: at TX_TIMEOUT_CHECKS the driver aborts all buffers, and the next
        // check sets the count to 0.
        self.tx_checks = self.tx_checks.wrapping_add(1);
        if self.tx_checks == TX_TIMEOUT_CHECKS {
            self.step = Step::ABORTING;
            self.write_canctrl(ABAT);
            return Some(Notice { event: Event::GaveUpSending, value: 0 });
        }
        None
    }

    fn check_configuration(&mut self) -> Option<Notice> {
        self.chip.begin_read(CNF3);
        let mut wrong = 0;
        let mut address = CNF3;
        while address <= CANINTE {
            wrong |= self.chip.next() ^ self.configuration.register(address);
            address += 1;
        }
        let _canintf = self.chip.next();
        let _eflg = self.chip.next();
        let canstat = self.chip.next();
        let canctrl = self.chip.next();
        self.chip.deselect();
        wrong |= (canstat & OPMOD) ^ MODE_NORMAL;
        wrong |= (canctrl ^ self.configuration.canctrl()) & !ABAT;
        if wrong != 0 {
            return self.fail(Event::Lost, 0);
        }
        None
    }

    /// Reports error flags that have changed. Counts each bus-off: one that begins between two
    /// checks sets ERRIF again (DS20001801J 7.6).
    #[inline(never)]
    fn check_errors(&mut self) -> Option<Notice> {
        self.chip.begin_read(CANINTF);
        let has_error = self.chip.next() & ERRIF != 0;
        let eflg = self.chip.next();
        self.chip.deselect();
        let before = core::mem::replace(&mut self.flags, eflg & !(RX0OVR | RX1OVR));
        if eflg & (RX0OVR | RX1OVR) != 0 {
            self.counters.add(Counter::RxOverflow, 1);
            self.chip.clear_overflow();
        }
        if has_error {
            self.chip.clear_error_interrupt();
        } else if eflg == before {
            return None;
        }
        if eflg & TXBO != 0 && (has_error || before & TXBO == 0) {
            self.counters.add(Counter::BusOffs, 1);
        }
        Some(Notice { event: Event::Flags, value: eflg })
    }

    /// True if INT does not agree with the flags of the chip: it must be low while a frame waits.
    /// Between the two checks a frame may arrive, but none can leave.
    #[inline(always)]
    fn is_int_stuck(&mut self) -> bool {
        if self.is_int_low() {
            return self.chip.status() & status::RXIF == 0;
        }
        self.chip.status() & status::RXIF != 0 && !self.is_int_low()
    }

    #[inline(never)]
    fn write_canctrl(&mut self, abort: u8) {
        self.chip.write_canctrl(self.configuration.canctrl() | abort);
    }

    #[inline(never)]
    fn fail(&mut self, event: Event, value: u8) -> Option<Notice> {
        // Resets a chip that was running at once: with a wrong bit timing it would disturb the bus.
        self.wait_ms = if self.is_running() { 0 } else { RETRY_MS };
        self.step = Step::DOWN;
        Some(Notice { event, value })
    }

    /// Notes the buffers that wait to be sent, and counts those that no longer wait.
    #[inline(never)]
    fn check_waiting(&mut self) {
        let waiting = self.chip.status() & status::TXREQ;
        let mut gone = self.tx_waiting & !waiting;
        if waiting == 0 || waiting != self.tx_waiting {
            self.tx_waiting = waiting;
            self.tx_checks = 0;
        }
        while gone != 0 {
            gone &= gone - 1;
            if self.step == Step::ABORTING {
                self.counters.add(Counter::TxTimedOut, 1);
            } else if self.configuration.attempts == Attempts::UntilSent {
                self.counters.add(Counter::TxSuccess, 1);
            }
        }
    }
}
