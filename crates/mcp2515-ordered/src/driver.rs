//! The driver: start-up, supervision, and frames both ways.

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

/// Between two checks of a running chip, in milliseconds.
pub const SUPERVISION_MS: u8 = 10;

/// From a failure to start to the next reset of the chip, in milliseconds.
pub const RETRY_MS: u8 = 100;

/// Frames that wait for longer without success are given up, in milliseconds: a frame that is older is of no use to most receivers.
pub const TX_TIMEOUT_MS: u16 = 1000;

/// From RESET to the first access, in milliseconds: the oscillator takes 128 cycles to start (DS20001801J 8.1), 8 us at 16 MHz. One tick
/// of the clock may be over at once, so two.
const START_UP_MS: u8 = 2;

/// Supervisions until waiting frames are given up.
const TX_TIMEOUT_CHECKS: u8 = (TX_TIMEOUT_MS / SUPERVISION_MS as u16) as u8;

/// What [`Mcp2515::poll`] reports.
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
    /// Not in configuration mode after a reset. The value is CANSTAT; 0x00 and 0xFF mean that no chip answers.
    NotAnswering,
    /// A register did not read back as written. The value is its address.
    NotKeeping,
    /// The chip did not enter normal mode: the bus is held dominant. The value is CANSTAT.
    NotStarting,
    /// The chip lost its configuration while running, or INT is stuck. The value is zero.
    Lost,
    /// Frames waited for [`TX_TIMEOUT_MS`] without success and were given up. The value is zero.
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
    /// When last checked, the chip had nothing left to send.
    pub is_empty: bool,
    /// The chip has room for a frame: [`find_room`](Mcp2515::find_room) has found a buffer that no frame has taken since.
    pub has_room: bool,
}

/// EFLG, as read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorFlags(pub u8);

impl ErrorFlags {
    /// An accepted frame was lost because the receive buffers were full.
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

/// The chip, on an SPI of mode 0,0 and at most 10 MHz, with its CS and INT pins.
///
/// The SPI is the chip's alone ([`SpiBus`]): the driver holds CS low over several calls of it.
pub struct Mcp2515<SPI, CS, INT, A> {
    chip: Chip<SPI, CS>,
    int: INT,
    counters: Counters,
    configuration: Configuration<A>,
    /// EFLG without the flags of loss.
    flags: u8,
    /// REC when last checked.
    rec: u8,
    tx: TxOrder,
    /// When polled last, modulo 256, and how long to wait from then.
    polled_ms: u8,
    wait_ms: u8,
    /// Buffers that waited to be sent when last checked, as READ STATUS shows them, and for how many supervisions that has not changed.
    tx_waiting: u8,
    tx_checks: u8,
    /// Which part of a supervision was last.
    part: u8,
    /// Where the next frame is to go.
    room: Option<Rank>,
    rx: RxOrder,
    step: Step,
}

impl<SPI: SpiBus, CS: OutputPin, INT: InputPin, A: Acceptance> Mcp2515<SPI, CS, INT, A> {
    /// A chip that the first [`poll`](Self::poll) resets.
    pub const fn new(spi: SPI, cs: CS, int: INT, configuration: Configuration<A>) -> Self {
        Self {
            chip: Chip::new(spi, cs),
            int,
            configuration,
            step: Step::DOWN,
            polled_ms: 0,
            wait_ms: 0,
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

    /// A chip that [`poll`](Self::poll) leaves alone until [`configure`](Self::configure) is called. All zero bytes but for the four
    /// arguments: in a `static` it takes no flash.
    pub const fn unconfigured(spi: SPI, cs: CS, int: INT, acceptance: A) -> Self {
        let configuration =
            Configuration { timing: crate::BitTiming::UNSET, acceptance, attempts: Attempts::UntilSent };
        Self::new(spi, cs, int, configuration)
    }

    /// Starts the chip over with `configuration`, from the next [`poll`](Self::poll) on. Frames that it has not sent yet are lost. It is
    /// off the bus for about 5 ms.
    #[inline(always)]
    pub fn configure(&mut self, configuration: Configuration<A>) {
        self.configuration = configuration;
        self.restart();
    }

    /// Changes the configuration, and starts the chip over as [`configure`](Self::configure) does.
    #[inline(always)]
    pub fn reconfigure(&mut self, change: impl FnOnce(&mut Configuration<A>)) {
        change(&mut self.configuration);
        self.restart();
    }

    #[inline(always)]
    fn restart(&mut self) {
        self.step = Step::DOWN;
        self.wait_ms = 0;
    }

    /// What the driver has counted.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// True if the chip is on the bus.
    pub fn is_running(&self) -> bool {
        self.step.is_running()
    }

    /// What the driver knows of the chip without asking it. `now_ms` wraps around; call this every 100 ms at least.
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
            || (Step::ENTERING..Step::RUNNING).contains(&self.step) && self.is_int_low()
    }

    /// Does the next short step of start-up or supervision. Call it when [`State::is_due`].
    #[inline(never)]
    pub fn poll(&mut self, now_ms: u16) -> Option<Notice> {
        self.polled_ms = now_ms as u8;
        let step = self.step;
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
            self.tx_waiting = 0;
            self.part = 0;
            return Some(Notice { event: Event::Running, value: canstat });
        }
        if step == Step::LAST_CHECK {
            return self.fail(Event::NotStarting, canstat);
        }
        None
    }

    /// True if [`receive`](Self::receive) is likely to find a frame. Costs a few cycles, where `receive` takes an SPI instruction to
    /// find none.
    #[inline(always)]
    pub fn has_frame(&mut self) -> bool {
        (!self.rx.is_empty() || self.is_int_low()) && self.is_running()
    }

    fn is_int_low(&mut self) -> bool {
        // A pin that cannot be read counts as low: a check too many costs 2 us, a check too few a frame.
        self.int.is_low().unwrap_or(true)
    }

    /// Reads the next frame from the chip. Returns false if there is none. Marks a standard or remote frame with [`Frame::FOREIGN`].
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
        // From SIDH and SIDL; see `filters::registers`.
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

    /// Checks whether the chip has a buffer for a frame that is to be sent after all that it has already: then [`State::has_room`].
    #[inline(never)]
    pub fn find_room(&mut self) {
        if self.step == Step::RUNNING {
            self.check_waiting();
            self.room = self.tx.next(self.tx_waiting);
        }
    }

    /// Hands a frame to the chip. Nothing happens unless [`find_room`](Self::find_room) has found room.
    #[inline(never)]
    pub fn transmit(&mut self, frame: &Frame) {
        let Some(rank) = self.room.take() else { return };
        self.tx_waiting |= rank.status();
        self.counters.count_long(Counter::TxRequests);
        self.chip.send_frame(rank, frame);
    }

    /// Checks a running chip, in three parts.
    fn supervise(&mut self) -> Option<Notice> {
        self.wait_ms = 0;
        self.part = self.part.wrapping_add(1);
        if self.part == 1 {
            return self.check_configuration();
        }
        if self.part == 2 {
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
        // It cannot overflow: it is set back at TX_TIMEOUT_CHECKS, when all buffers are emptied.
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
        let eflg = self.chip.next();
        let canstat = self.chip.next();
        let canctrl = self.chip.next();
        self.chip.deselect();
        wrong |= (canstat & OPMOD) ^ MODE_NORMAL;
        wrong |= (canctrl ^ self.configuration.canctrl()) & !ABAT;
        if wrong != 0 {
            return self.fail(Event::Lost, 0);
        }
        let before = core::mem::replace(&mut self.flags, eflg & !(RX0OVR | RX1OVR));
        if eflg == before {
            return None;
        }
        if eflg & (RX0OVR | RX1OVR) != 0 {
            self.counters.add(Counter::RxOverflow, 1);
            self.chip.clear_overflow();
        }
        if eflg & !before & TXBO != 0 {
            self.counters.add(Counter::BusOffs, 1);
        }
        Some(Notice { event: Event::Flags, value: eflg })
    }

    /// INT is low as long as a frame waits. One may come between the checks of the pin and of the chip, but none goes.
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
        // A chip that was running is reset at once: with another bit timing it would disturb the bus meanwhile.
        self.wait_ms = if self.is_running() { 0 } else { RETRY_MS };
        self.step = Step::DOWN;
        Some(Notice { event, value })
    }

    /// Notes which buffers wait to be sent, and counts those that no longer do.
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
