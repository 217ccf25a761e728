//! The driver: start-up, supervision, and received and sent frames.

use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal::spi::{SpiBus, SpiDevice};

use crate::any_frame::AnyFrame;
use crate::chip::{Exclusive, Instructions, Step};
use crate::configuration::{Attempts, Configuration};
use crate::counters::{Counter, Counters};
use crate::filters::Acceptance;
use crate::frame::Frame;
use crate::registers::*;
use crate::rx_order::{Buffer, RxOrder};
use crate::shared::Shared;
use crate::tx_order::{Rank, TxOrder};

/// Time between two supervisions of a running chip, in milliseconds.
pub const SUPERVISION_MS: u8 = 10;

/// Time in which a chip leaves the bus for configuration mode, in milliseconds: the longest frame
/// takes 1.3 ms at 125 kbit/s.
const LEAVE_MS: u8 = 3;

/// Time from a failed start-up to the next reset of the chip, in milliseconds.
pub const RETRY_MS: u8 = 100;

/// Timeout of frames that wait to be sent, in milliseconds. An older frame is of no use to most
/// receivers. Each node of DroneCAN sends once a second: a chip of another bit rate hears one of
/// the others before it tries its second frame.
pub const TX_TIMEOUT_MS: u16 = 1050;

/// Time from RESET to the first access, in milliseconds. The oscillator takes 128 cycles to start
/// (DS20001801J 8.1), 8 us at 16 MHz. The first tick of the clock may come at once, so two ticks
/// are necessary.
const START_UP_MS: u8 = 2;

/// Number of supervisions until the driver gives up the frames that wait. The first may come as
/// soon as they wait.
const TX_TIMEOUT_CHECKS: u8 = (TX_TIMEOUT_MS / SUPERVISION_MS as u16) as u8 + 1;

/// Number of supervisions without a received frame after which an error-passive chip holds back
/// what it sends. If it hears no error either, it is alone: the cable may be plugged in elsewhere
/// next.
const QUIET_CHECKS: u8 = 10;

/// Number of supervisions without a received frame after which an error-passive chip listens,
/// because the others have another bit rate or each of their frames is destroyed.
const DEAF_CHECKS: u8 = 150;

/// The first of the last four supervisions of each [`TX_TIMEOUT_MS`]: from it on a chip gets frames
/// although its first one failed and the bit rate of the bus is unknown.
const FIRST_TRIAL_CHECK: u8 = TX_TIMEOUT_CHECKS - 4;

/// The unit in which a chip that listens measures time, in milliseconds.
const LISTENING_MS: u8 = 85;

/// The time without an error after which a chip that listens is put on the bus again: 1 s. Each
/// node of DroneCAN sends once a second.
const QUIET: u8 = (1020 / LISTENING_MS as u16) as u8;

/// The proof that the bit rate is that of the bus: then no error of others takes the chip off the
/// bus. Each supervision on the bus adds 1: each node of DroneCAN sends once a second, and one of
/// another rate would have made the chip error-passive.
const PROOF: u8 = 120;

/// What each [`LISTENING_MS`] with both a valid frame and an error adds to the proof. Nodes of one
/// wrong rate do not prove it to each other: all of them listen soon after the first frames of the
/// others.
const PROOF_OF_FRAME: u8 = 20;

/// The number of [`LISTENING_MS`] with errors only after which a chip that listens reports that the
/// bus has another bit rate. They are counted in the proof, where they prove little.
const REPORT: u8 = 2;

/// What the driver knows of the bit rate of the bus. The value is that of CANCTRL.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
enum BusRate {
    /// It is that of the chip: a frame has passed.
    Same = MODE_NORMAL,
    /// No frame has passed since the start, since a bus-off, since the chip is error-passive and
    /// has received nothing for [`QUIET_CHECKS`], or since it gave up frames. The chip tries each
    /// frame once, and the driver looks at its errors in every second turn. After the first frame
    /// the next ones wait: see [`FIRST_TRIAL_CHECK`].
    Unknown = MODE_NORMAL | OSM,
    /// It may be another one. The chip only listens, until it has heard that it is not.
    Another = MODE_LISTEN_ONLY,
}

/// A report of [`Driver::poll`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Notice {
    /// The event.
    pub event: Event,
    /// A value that the chip returned: see [`Event`].
    pub value: u8,
}

/// An event of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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
    /// The chip lost its configuration while running. The value is zero.
    Lost,
    /// INT does not follow the chip: it is stuck, or not wired. Until the chip is restarted the
    /// driver asks it for frames: see [`Driver::is_int_wrong`]. The value is zero.
    IntWrong,
    /// The bus has another bit rate, or each of its frames has been disturbed since the start. The
    /// chip only listens, has heard no valid frame, and comes back by itself:
    /// [`Running`](Self::Running) follows. The value is zero.
    AnotherRate,
    /// The driver gave up frames that waited for [`TX_TIMEOUT_MS`], or no frame has passed for that
    /// time. The chip tries each waiting frame once more. The value is zero.
    GaveUpSending,
    /// An error flag changed, or frames were lost. The value is EFLG: see [`ErrorFlags`].
    Flags,
}

/// The state of the chip, as far as the driver knows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct State {
    /// [`poll`](Driver::poll) is due.
    pub is_due: bool,
    /// The chip is on the bus.
    pub is_running: bool,
    /// At the last check the chip had no frame left to send.
    pub is_empty: bool,
    /// The chip has room for a frame: [`find_room`](Driver::find_room) has found a buffer, and no
    /// frame has taken it since.
    pub has_room: bool,
}

/// The value of EFLG.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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

/// The driver of a chip on an SPI in mode 0,0 with at most 10 MHz, with its INT pin. `C` is the way
/// to the chip: see [`SharedMcp2515`] and [`Mcp2515`].
pub struct Driver<C, INT, A> {
    chip: C,
    int: INT,
    counters: Counters,
    configuration: Configuration<A>,
    /// EFLG at the last check, without RX0OVR and RX1OVR.
    flags: u8,
    tx: TxOrder,
    /// Time of the last poll, modulo 256, and time from then to the next poll.
    polled_ms: u8,
    wait_ms: u8,
    /// Time of the last check of the error flags, modulo 256.
    looked_ms: u8,
    /// Buffers that waited to be sent at the last check, as bits of READ STATUS.
    tx_waiting: u8,
    /// Number of supervisions since that changed, or since no frame has passed.
    tx_checks: u8,
    bus_rate: BusRate,
    /// [`State::is_due`] was asked for since the last look at the errors.
    is_to_look: bool,
    /// The value of CANCTRL that was written last.
    canctrl: u8,
    /// See [`PROOF`].
    proof: u8,
    /// Number of supervisions since a frame was received. If the chip listens, the time since an
    /// error, in [`LISTENING_MS`].
    quiet: u8,
    /// The chip that listens has heard a valid frame in this [`LISTENING_MS`].
    has_heard: bool,
    /// There was room for a first frame.
    has_tried: bool,
    /// The last part of a supervision that was done.
    part: u8,
    /// INT did not follow the chip since its last start.
    is_int_wrong: bool,
    /// The rank for the next frame, if there is room.
    room: Option<Rank>,
    rx: RxOrder,
    step: Step,
}

/// The driver of a chip on an SPI bus with other devices: the ordinary way in.
pub type SharedMcp2515<D, INT, A> = Driver<Shared<D>, INT, A>;

/// The driver of a chip alone on its SPI bus, with its CS pin: the fast way in. The driver keeps CS
/// low during several calls of the bus.
pub type Mcp2515<SPI, CS, INT, A> = Driver<Exclusive<SPI, CS>, INT, A>;

impl<C: Instructions, INT: InputPin, A: Acceptance> Driver<C, INT, A> {
    const fn with_chip(chip: C, int: INT, configuration: Configuration<A>) -> Self {
        Self {
            chip,
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
            bus_rate: BusRate::Unknown,
            is_to_look: false,
            canctrl: 0,
            proof: 0,
            quiet: 0,
            has_heard: false,
            has_tried: false,
            part: 0,
            is_int_wrong: false,
            flags: 0,
            counters: Counters::new(),
        }
    }

    /// Restarts the chip with `configuration`, from the next [`poll`](Self::poll) on. Frames that
    /// the chip has not sent yet are lost. The chip is off the bus for about 5 ms.
    pub fn configure(&mut self, configuration: Configuration<A>) {
        self.configuration = configuration;
        self.proof = 0;
        self.rejoin();
    }

    /// Changes the configuration of a chip on the bus, and configures it again without a reset. The
    /// chip leaves the bus for about 5 ms when the frame on the bus is over, so no frame that
    /// it has acknowledged is lost. Frames that it has not sent yet are aborted. A chip that is not
    /// on the bus is restarted as by [`configure`](Self::configure).
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

    fn restart(&mut self) {
        self.step = Step::DOWN;
        self.wait_ms = 0;
    }

    /// The configuration.
    pub fn configuration(&self) -> &Configuration<A> {
        &self.configuration
    }

    /// The INT pin, for example to wait until it is low.
    pub fn int(&mut self) -> &mut INT {
        &mut self.int
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
    pub fn state(&mut self, now_ms: u16) -> State {
        State {
            is_due: self.is_due(now_ms),
            is_running: self.is_running(),
            is_empty: self.is_empty(),
            has_room: self.has_room(),
        }
    }

    /// As [`State::is_empty`].
    pub fn is_empty(&self) -> bool {
        self.tx_waiting == 0
    }

    /// As [`State::has_room`].
    pub fn has_room(&self) -> bool {
        self.room.is_some()
    }

    fn is_due(&mut self, now_ms: u16) -> bool {
        (now_ms as u8).wrapping_sub(self.polled_ms) >= self.wait_ms
            // Bus-off, into which only a chip that sends can come, lasts at least 1.4 ms.
            || self.tx_waiting != 0 && now_ms as u8 != self.looked_ms
            // A chip with the wrong bit rate can disturb a frame each 30 us, and without INT a
            // frame may wait. The second call after a look, so that other work comes in between.
            || (self.bus_rate != BusRate::Same || self.is_int_wrong)
                && self.step >= Step::LISTENING
                && core::mem::replace(&mut self.is_to_look, true)
            // The chip is on the bus already and has a frame. The next one may arrive within 70 us.
            || (Step::ENTERING..Step::LISTENING).contains(&self.step) && self.is_int_low()
    }

    /// Does the next short step of start-up or supervision. Call it when [`State::is_due`] is true.
    #[inline(never)]
    pub fn poll(&mut self, now_ms: u16) -> Option<Notice> {
        let now_ms = now_ms as u8;
        let is_early = now_ms.wrapping_sub(self.polled_ms) < self.wait_ms;
        let step = self.step;
        self.is_to_look = false;
        if step >= Step::LISTENING && is_early {
            self.looked_ms = now_ms;
            if step == Step::LISTENING {
                self.hear();
                return None;
            }
            return self.check_errors();
        }
        self.polled_ms = now_ms;
        if step.is_running() {
            return self.supervise();
        }
        if step == Step::LISTENING {
            return self.judge();
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
            mode.finish();
            self.write_canctrl();
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
        if mode == self.canctrl & OPMOD {
            if self.bus_rate == BusRate::Another {
                self.step = Step::LISTENING;
                self.wait_ms = LISTENING_MS;
                self.quiet = 1;
                return None;
            }
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
    pub fn has_frame(&mut self) -> bool {
        // A chip that has left the bus still has the frames that it received.
        (!self.rx.is_empty() || self.is_int_low() || self.is_int_wrong)
            && (self.is_running() || self.step == Step::STARTING)
    }

    fn is_int_low(&mut self) -> bool {
        // A pin that cannot be read counts as low: an unnecessary check costs 2 us, and a missing
        // check loses a frame.
        self.int.is_low().unwrap_or(true)
    }

    /// True if INT does not follow the chip: see [`Event::IntWrong`]. Then
    /// [`has_frame`](Self::has_frame) is always true, [`receive`](Self::receive) finds out if there
    /// is a frame, and [`poll`](Self::poll) is due in every second turn, after which the caller can
    /// look.
    pub fn is_int_wrong(&self) -> bool {
        self.is_int_wrong
    }

    /// Reads the next frame from the chip. Returns false if there is none. It marks a standard or
    /// remote frame with [`Frame::FOREIGN`].
    pub fn receive(&mut self, frame: &mut Frame) -> bool {
        self.read_next(frame, |frame, dlc| {
            // Converts SIDH and SIDL: see `filters::registers`.
            let [sidh, sidl, ..] = frame.id;
            frame.id[0] = sidh >> 3;
            frame.id[1] = sidh << 5 | (sidl >> 3) & 0b1_1100 | sidl & 0b11;
            if sidl & IDE == 0 || dlc & RTR != 0 {
                frame.id[0] |= Frame::FOREIGN;
            }
        })
    }

    /// Reads the next frame from the chip, also a standard or a remote frame. The
    /// [filters](Acceptance) decide which of them the chip accepts.
    pub fn receive_any(&mut self) -> Option<AnyFrame> {
        let mut registers = Frame::EMPTY;
        let mut received = None;
        self.read_next(&mut registers, |registers, dlc| {
            received = Some(AnyFrame::from_registers(registers, dlc));
        });
        received
    }

    /// Reads the next frame from the chip, with SIDH, SIDL, EID8 and EID0 in place of the
    /// identifier. Passes it and RXBnDLC to `convert`. Returns false if there is none.
    fn read_next(&mut self, frame: &mut Frame, convert: impl FnOnce(&mut Frame, u8)) -> bool {
        if self.rx.is_empty() {
            let status = self.chip.status();
            self.rx.seen_late(status);
        }
        let Some(buffer) = self.rx.take() else {
            return false;
        };
        let dlc = self.chip.read_frame(buffer, frame);

        self.bus_rate = BusRate::Same;
        self.quiet = 0;
        self.counters.count_long(Counter::RxReceived);
        convert(frame, dlc);
        if buffer == Buffer::Rxb0 && self.rx.is_empty() && self.is_int_low() {
            let status = self.chip.status();
            self.rx.seen_at_once(status);
        }
        true
    }

    /// Checks if the chip has a buffer from which a frame is sent after all frames that wait. Then
    /// [`State::has_room`] is true.
    ///
    /// While the bit rate of the bus is unknown, each frame that the chip sends may destroy one of
    /// the others, and nobody tells it so: a sparse bus is silent most of the time, and to lose
    /// against an error frame looks like a lost arbitration. So until a frame has passed there is
    /// room for one, and then in the last 40 ms of each [`TX_TIMEOUT_MS`].
    #[inline(never)]
    pub fn find_room(&mut self) {
        if self.step != Step::RUNNING {
            return;
        }
        self.check_waiting();
        if self.bus_rate == BusRate::Same || !self.has_tried || self.tx_checks >= FIRST_TRIAL_CHECK
        {
            self.has_tried = true;
            self.room = self.tx.next(self.tx_waiting);
        }
    }

    /// Passes a frame to the chip. Does nothing unless [`find_room`](Self::find_room) has found
    /// room.
    #[inline(never)]
    pub fn transmit(&mut self, frame: &Frame) {
        if let Some(rank) = self.take_room() {
            self.counters.count_long(Counter::TxRequests);
            self.chip.send_frame(rank, frame);
        }
    }

    /// Passes a frame of any kind to the chip, as [`transmit`](Self::transmit).
    pub fn transmit_any(&mut self, frame: &AnyFrame) {
        if let Some(rank) = self.take_room() {
            let (registers, dlc) = frame.to_registers();
            self.chip.send_raw(rank, &registers, dlc);
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
            // Half a frame leaves time for the call.
            self.counters.add(Counter::TxRequests, 1);
            self.chip.write_data_and_send(rank, frame);
        }
    }

    /// Takes the room for a frame that will wait in the chip.
    fn take_room(&mut self) -> Option<Rank> {
        let rank = self.room.take()?;
        self.tx_waiting |= rank.status();
        Some(rank)
    }

    /// Does the next of the four parts of a supervision, each of which takes less time than to pass
    /// a frame to the chip.
    #[inline(never)]
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
            self.counters.note_rec(rec);
            if self.flags & RXEP != 0 && self.quiet >= DEAF_CHECKS {
                // The rate was the right one for a second. So there is nothing to report.
                self.listen(REPORT);
                return None;
            }
            if self.flags & (TXEP | RXEP) != 0 && self.quiet >= QUIET_CHECKS {
                self.bus_rate = BusRate::Unknown;
                if rec == 0 || self.proof < PROOF {
                    self.proof = 0;
                }
            }
            if self.chip.read(RXB0CTRL) & (RXM | BUKT) != BUKT {
                return self.fail(Event::Lost, 0);
            }
            return self.check_int();
        }
        self.part = 0;
        self.wait_ms = SUPERVISION_MS;
        self.check_waiting();
        self.quiet = self.quiet.wrapping_add(1);
        if self.bus_rate == BusRate::Same && self.proof < PROOF {
            self.proof += 1;
        }
        self.tx_checks += 1;
        if self.tx_checks != TX_TIMEOUT_CHECKS {
            if self.bus_rate == BusRate::Unknown
                && self.chip.read(TXB2CTRL) & (MLOA | TXERR) == MLOA
            {
                // It lost against a frame, of which the chip has noticed no error.
                self.bus_rate = BusRate::Same;
            }
            self.write_canctrl();
            return None;
        }
        self.tx_checks = 0;
        // Tries each frame that waits once more.
        self.bus_rate = BusRate::Unknown;
        self.chip.clear_interrupts();
        self.write_canctrl();
        Some(Notice { event: Event::GaveUpSending, value: 0 })
    }

    /// Takes the chip off the bus until [`judge`](Self::judge) puts it back. `proof` is 0, or
    /// [`REPORT`] if nothing is to be reported.
    #[inline(never)]
    fn listen(&mut self, proof: u8) {
        self.bus_rate = BusRate::Another;
        self.proof = proof;
        // A request for listen-only mode would wait for an idle bus, so a reset follows.
        self.restart();
    }

    /// Notes what a chip that listens has heard since the last look. In this mode the chip stores
    /// frames with errors, too (DS20001801J 10.3). So none of them is received, and the reset
    /// discards them.
    #[inline(never)]
    fn hear(&mut self) {
        let heard = self.chip.take_interrupts() & (MERRF | RX1IF | RX0IF);
        if heard >= MERRF {
            self.quiet = 0;
        } else if heard != 0 {
            self.has_heard = true;
        }
    }

    /// Puts a chip that listens on the bus again if it has heard a valid frame and no error in the
    /// last [`LISTENING_MS`], no error for a second, or valid frames and errors in six of these
    /// times. If it has heard errors only, it listens with the next timing, if there is one.
    #[inline(never)]
    fn judge(&mut self) -> Option<Notice> {
        let is_disturbed = self.quiet == 0;
        self.quiet += 1;
        let has_heard = core::mem::take(&mut self.has_heard);
        if !is_disturbed {
            if has_heard || self.quiet > QUIET {
                self.proof = 0;
                self.rejoin();
            }
        } else if has_heard {
            self.proof += PROOF_OF_FRAME;
            if self.proof >= PROOF {
                self.rejoin();
            }
        } else if self.proof < PROOF_OF_FRAME {
            if let Some(timing) = self.configuration.acceptance.next_timing() {
                self.configuration.timing = timing;
                self.restart();
            }
            if self.proof < REPORT {
                self.proof += 1;
                if self.proof == REPORT {
                    return Some(Notice { event: Event::AnotherRate, value: 0 });
                }
            }
        }
        None
    }

    /// Lets the chip find out if its bit rate is that of the bus.
    #[inline(never)]
    fn rejoin(&mut self) {
        self.bus_rate = BusRate::Unknown;
        self.has_tried = false;
        self.restart();
    }

    fn check_configuration(&mut self) -> Option<Notice> {
        self.chip.begin_read(CNF3);
        let mut wrong = 0;
        let mut address = CNF3;
        while address <= CANINTE {
            wrong |= self.chip.read_next() ^ self.configuration.register(address);
            address += 1;
        }
        let _canintf = self.chip.read_next();
        let _eflg = self.chip.read_next();
        let canstat = self.chip.read_next();
        let canctrl = self.chip.read_next();
        self.chip.end_read();
        wrong |= (canstat ^ self.canctrl) & OPMOD;
        wrong |= canctrl ^ self.canctrl;
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
        let canintf = self.chip.read_next();
        let eflg = self.chip.read_next();
        self.chip.end_read();
        if eflg & (RX0OVR | RX1OVR) != 0 {
            self.counters.add(Counter::RxOverflow, 1);
            self.chip.clear_overflow();
        } else if self.proof < PROOF
            && (eflg & RXEP != 0 || self.bus_rate == BusRate::Unknown && self.chip.read(REC) != 0)
        {
            // A disturbed frame before one has passed, or many before the rate is proven. A chip
            // that has lost frames has had some.
            // `flags` stay those that were reported: what the reset changes is reported after it.
            self.listen(0);
            return None;
        }
        let before = core::mem::replace(&mut self.flags, eflg & !(RX0OVR | RX1OVR));
        // ERRIF may have been set between the two registers.
        let risen = eflg & !before;
        let has_error = canintf & ERRIF != 0 || risen != 0;
        // TXnIF are cleared below, or were when TXEP was set.
        if risen & TXBO != 0 {
            self.bus_rate = BusRate::Unknown;
        }
        if has_error {
            self.chip.clear_interrupts();
            if eflg & TXBO != 0 {
                self.counters.add(Counter::BusOffs, 1);
            }
        } else if eflg == before {
            return None;
        }
        Some(Notice { event: Event::Flags, value: eflg })
    }

    /// Reports that INT does not agree with the flags of the chip: it must be low while a frame
    /// waits. Between the two looks at INT a frame may arrive, but none can leave.
    fn check_int(&mut self) -> Option<Notice> {
        let was_low = self.is_int_low();
        if self.chip.status() & status::RXIF == 0 {
            if !was_low {
                return None;
            }
        } else if self.is_int_low() {
            return None;
        }
        if self.is_int_wrong {
            return None;
        }
        self.is_int_wrong = true;
        Some(Notice { event: Event::IntWrong, value: 0 })
    }

    /// Writes CANCTRL. The mode of the bus's rate may have one-shot mode in addition, also where
    /// that has no effect.
    #[inline(never)]
    fn write_canctrl(&mut self) {
        self.canctrl = self.bus_rate as u8 | self.configuration.attempts as u8;
        self.chip.write_canctrl(self.canctrl);
    }

    #[inline(never)]
    fn fail(&mut self, event: Event, value: u8) -> Option<Notice> {
        // Resets a chip that was running at once: with a wrong bit timing it would disturb the bus.
        self.wait_ms = if self.is_running() { 0 } else { RETRY_MS };
        self.step = Step::DOWN;
        self.is_int_wrong = false;
        Some(Notice { event, value })
    }

    /// Notes the buffers that wait to be sent, and counts those that no longer wait.
    #[inline(never)]
    fn check_waiting(&mut self) {
        let status = self.chip.status();
        if status & status::TXIF != 0 {
            self.bus_rate = BusRate::Same;
        }
        let waiting = status & status::TXREQ;
        let gone = self.tx_waiting & !waiting;
        if waiting == 0 || waiting != self.tx_waiting {
            self.tx_waiting = waiting;
            // A frame that was tried once need not have been sent.
            if self.bus_rate == BusRate::Same {
                self.tx_checks = 0;
            }
        }
        if self.bus_rate != BusRate::Same {
            self.counters.add_each(Counter::TxTimedOut, gone);
        } else if self.configuration.attempts == Attempts::UntilSent {
            self.counters.add_each(Counter::TxSuccess, gone);
        }
    }
}

impl<D: SpiDevice, INT: InputPin, A: Acceptance> SharedMcp2515<D, INT, A> {
    /// Makes a driver. The first [`poll`](Self::poll) resets the chip.
    pub const fn new(device: D, int: INT, configuration: Configuration<A>) -> Self {
        Self::with_chip(Shared::new(device), int, configuration)
    }
}

impl<SPI: SpiBus, CS: OutputPin, INT: InputPin, A: Acceptance> Mcp2515<SPI, CS, INT, A> {
    /// Makes a driver. The first [`poll`](Self::poll) resets the chip.
    pub const fn new(spi: SPI, cs: CS, int: INT, configuration: Configuration<A>) -> Self {
        Self::with_chip(Exclusive::new(spi, cs), int, configuration)
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
        let mut driver = Self::new(spi, cs, int, configuration);
        driver.bus_rate = BusRate::Same;
        driver
    }
}
