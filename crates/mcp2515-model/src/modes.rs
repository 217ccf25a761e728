//! The five modes of operation, requests by REQOP and their result in OPMOD, sleep and wake-up, and
//! the oscillator start-up timer.
//!
//! A request waits
//! - in normal and loopback mode for all pending transmissions (10.0) and for the end of the frame
//!   in progress, also a received one. Sleep waits for an idle bus.
//! - for normal and listen-only mode for 11 recessive bits, which the protocol engine counts.
//! - from configuration mode to loopback or sleep for nothing.
//!
//! Writing REQOP makes a request. After a wake-up the chip is in listen-only mode, although REQOP
//! still has sleep. It changes its mode when REQOP is written again (10.2.1).
//!
//! Oscillator start-up (8.1): for 128 oscillator periods after power-up, the RESET pin, the RESET
//! instruction, or a wake-up the chip is held in reset. The driver must not use the SPI in this
//! time: instructions are ignored, and a violation is recorded. After a wake-up by the bus
//! registers can be read as in sleep, because the driver cannot know of the wake-up.
//!
//! Source: DS20001801J sections 8.1, 9 and 10. WAKFIL has no effect: any dominant bit wakes the
//! chip.

use super::registers::{self, canctrl, int};
use super::timing::BitTiming;
use super::{Mcp2515, Mode};
use can_model::{EngineMode, ErrorState};
use sim_base::{Cycles, F_CPU_HZ};

/// Length of the oscillator start-up timer.
const START_UP_OSC_PERIODS: u64 = 128;

/// A mode requested by REQOP.
#[derive(Clone, Copy, Debug)]
pub(super) struct Request {
    mode: Mode,
    /// End of the SPI byte.
    at: Cycles,
}

impl Mode {
    /// The mode for a value of REQOP or OPMOD. Three values are invalid.
    fn decode(reqop: u8) -> Option<Mode> {
        Some(match reqop {
            0b000 => Mode::Normal,
            0b001 => Mode::Sleep,
            0b010 => Mode::Loopback,
            0b011 => Mode::ListenOnly,
            0b100 => Mode::Configuration,
            _ => return None,
        })
    }

    pub(super) fn code(self) -> u8 {
        match self {
            Mode::Normal => 0b000,
            Mode::Sleep => 0b001,
            Mode::Loopback => 0b010,
            Mode::ListenOnly => 0b011,
            Mode::Configuration => 0b100,
        }
    }

    pub(super) fn is_on_the_bus(self) -> bool {
        matches!(self, Mode::Normal | Mode::ListenOnly)
    }
}

impl Mcp2515 {
    fn start_up_cycles(&self) -> Cycles {
        (START_UP_OSC_PERIODS * F_CPU_HZ).div_ceil(u64::from(self.osc_hz))
    }

    pub(super) fn bit_timing(&self) -> BitTiming {
        let [cnf1, cnf2, cnf3] = self.cnf();
        BitTiming::decode(cnf1, cnf2, cnf3)
    }

    /// CNF1, CNF2 and CNF3.
    pub(super) fn cnf(&self) -> [u8; 3] {
        [registers::CNF1, registers::CNF2, registers::CNF3]
            .map(|address| self.registers[usize::from(address)])
    }

    /// A write to CANCTRL; `mask` has the bits that it may change.
    pub(super) fn write_canctrl(&mut self, value: u8, mask: u8, at: Cycles) {
        let index = usize::from(registers::CANCTRL);
        let old = self.registers[index];
        let new = old & !mask | value & mask;
        self.registers[index] = new;
        if new & canctrl::ABAT != 0 && old & canctrl::ABAT == 0 {
            self.abort_all();
        }
        if mask & canctrl::REQOP != 0 {
            match Mode::decode(new >> 5) {
                Some(mode) => self.request_mode(mode, at),
                None => self.violation(
                    at,
                    format!(
                        "CANCTRL = {new:02X}h: REQOP = {:03b} is invalid (DS20001801J Register \
                         10-1)",
                        new >> 5
                    ),
                ),
            }
        } else if new & canctrl::ABAT != 0 {
            // The abort may complete a waiting request.
            self.try_mode_change(at, false);
        }
    }

    fn request_mode(&mut self, mode: Mode, at: Cycles) {
        if self.joining.take().is_some() {
            self.start_engine(self.mode);
        }
        self.request = None;
        if mode == self.mode || self.is_held {
            return;
        }
        if self.mode == Mode::Sleep && self.waking_until.is_none() {
            self.violation(
                at,
                format!(
                    "REQOP = {:03b} while asleep: only bus activity, or WAKIF with WAKIE, wakes \
                     the chip (DS20001801J 10.2)",
                    mode.code()
                ),
            );
            return;
        }
        self.request = Some(Request { mode, at });
        self.try_mode_change(at, false);
    }

    /// True if a request was made by `at` and not executed yet.
    pub(super) fn is_mode_change_due(&self, at: Cycles) -> bool {
        self.request.is_some_and(|request| request.at <= at)
    }

    /// Executes a request if it need not wait. `frame_over`: a frame ended with this bit.
    pub(super) fn try_mode_change(&mut self, at: Cycles, frame_over: bool) {
        let Some(Request { mode, at: since }) = self.request else {
            return;
        };
        if at < since || self.joining.is_some() || self.waking_until.is_some() {
            return;
        }
        if mode.is_on_the_bus() {
            // `join_bus` starts the engine, at the beginning of a bit.
            if self.mode == Mode::Configuration {
                self.check_timing(mode, since);
            }
            return;
        }
        let off_air = self.can.is_idle() || self.can.error_state() == ErrorState::BusOff;
        let free = match self.mode {
            Mode::Configuration => true,
            Mode::Normal | Mode::Loopback if self.has_tx_request() => false,
            Mode::Normal | Mode::Loopback | Mode::ListenOnly => match mode {
                Mode::Sleep => self.can.is_idle(),
                _ => frame_over || off_air,
            },
            Mode::Sleep => false,
        };
        if !free {
            return;
        }
        if self.mode == Mode::Configuration {
            self.check_timing(mode, since);
        }
        self.start_engine(mode);
        self.enter(mode);
    }

    fn check_timing(&mut self, mode: Mode, at: Cycles) {
        if mode == Mode::Sleep || std::mem::replace(&mut self.is_timing_checked, true) {
            return;
        }
        if let Some(fault) = self.bit_timing().fault(self.osc_hz, mode.is_on_the_bus()) {
            let at_cnf = |address: u8| self.registers[usize::from(address)];
            let text = format!(
                "CNF1 = {:02X}h, CNF2 = {:02X}h, CNF3 = {:02X}h on leaving configuration mode: \
                 {fault} (DS20001801J 5.5)",
                at_cnf(registers::CNF1),
                at_cnf(registers::CNF2),
                at_cnf(registers::CNF3)
            );
            self.violation(at, text);
        }
    }

    /// At the start of a bit: if normal or listen-only mode is requested and need not wait, the
    /// engine starts to count 11 recessive bits.
    pub(super) fn join_bus(&mut self, at: Cycles) {
        let Some(Request { mode, at: since }) = self.request else {
            return;
        };
        if at < since || self.joining.is_some() || !mode.is_on_the_bus() {
            return;
        }
        let ready = match self.mode {
            Mode::Configuration => true,
            Mode::Normal | Mode::Loopback => !self.has_tx_request() && self.can.is_idle(),
            Mode::ListenOnly => self.can.is_idle(),
            Mode::Sleep => false,
        };
        if !ready {
            return;
        }
        self.start_engine(mode);
        self.joining = Some(mode);
    }

    /// Sets the engine to the mode for `mode`. Configuration and listen-only mode clear the error
    /// counters (10.1, 10.3); the other modes keep them.
    pub(super) fn start_engine(&mut self, mode: Mode) {
        match mode {
            Mode::Configuration | Mode::ListenOnly => self.can.reset(),
            Mode::Normal | Mode::Loopback | Mode::Sleep => self.can.restart(),
        }
        match mode {
            Mode::Normal => self.can.set_mode(EngineMode::Normal),
            Mode::ListenOnly => self.can.set_mode(EngineMode::ListenOnly),
            Mode::Loopback => {
                self.can.set_mode(EngineMode::Normal);
                self.can.set_self_ack(true);
            }
            Mode::Configuration | Mode::Sleep => {}
        }
    }

    /// At the end of a bit: OPMOD changes when the engine has found the bus idle.
    pub(super) fn finish_joining(&mut self) {
        if let Some(mode) = self.joining
            && self.can.is_idle()
        {
            self.joining = None;
            self.enter(mode);
        }
    }

    pub(super) fn enter(&mut self, mode: Mode) {
        self.request = None;
        self.mode = mode;
        self.is_timing_checked &= mode != Mode::Configuration;
        self.in_flight = None;
        self.error_flags = self.current_error_flags();
    }

    /// Handles a dominant bit in sleep (7.5, 10.2.1).
    pub(super) fn bus_activity(&mut self, at: Cycles) {
        let enabled = self.registers[usize::from(registers::CANINTE)] & int::WAK != 0;
        if enabled && self.waking_until.is_none() {
            self.raise(int::WAK);
            self.waking_until = Some(at + self.settling + self.start_up_cycles());
        }
    }

    /// Handles that the driver sets WAKIF: wakes the chip if WAKIE is set (10.2).
    pub(super) fn wake_by_driver(&mut self, at: Cycles) {
        let enabled = self.registers[usize::from(registers::CANINTE)] & int::WAK != 0;
        if self.mode == Mode::Sleep && enabled && self.waking_until.is_none() {
            let until = at + self.settling + self.start_up_cycles();
            self.waking_until = Some(until);
            self.deaf_until = until;
        }
    }

    /// Advances the oscillator start-up timer to `at`.
    pub(super) fn catch_up(&mut self, at: Cycles) {
        if self.waking_until.is_some_and(|until| at >= until) {
            self.waking_until = None;
            self.start_engine(Mode::ListenOnly);
            self.mode = Mode::ListenOnly;
            self.error_flags = self.current_error_flags();
            if self.request.is_some_and(|request| request.mode == Mode::ListenOnly) {
                self.request = None;
            }
            self.try_mode_change(at, false);
        }
    }

    /// A reset by pin or by instruction (9.0).
    pub(super) fn reset(&mut self, at: Cycles) {
        self.leave_bus(at);
        for n in 0..2 {
            self.rx_flag_cleared(n, at);
        }
        for address in 0..registers::SIZE as u8 {
            if let Some(value) = registers::reset_value(address) {
                self.registers[usize::from(address)] = value;
            }
        }
        self.reset_transmit();
        self.can.reset();
        self.mode = Mode::Configuration;
        self.request = None;
        self.joining = None;
        self.waking_until = None;
        self.is_timing_checked = false;
        self.error_flags = 0;
        self.rxb0_filter = 0;
        self.deaf_until = at + self.start_up_cycles();
    }
}
