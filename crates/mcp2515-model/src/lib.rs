#![doc = include_str!("../README.md")]
//! # How it works
//!
//! The model has two sides. The SPI side (`select`, `begin_byte`, `end_byte`, `deselect`,
//! `int_pin`) is connected to a microcontroller; the bus side is [`Station`](can_model::Station),
//! stepped bit by bit with a protocol [`Engine`]. What the datasheet forbids is recorded as a
//! [`Violation`].
//!
//! The files: `registers` has the map, `spi` the instructions, `access` register accesses,
//! `modes` the operating modes and start-up, `timing` CNF1..3, `filters` acceptance, `receive` and
//! `transmit` the buffers, `station` the bus side, `upset` faults of the chip.
//!
//! Each file lists its own limits.
//!
//! Source: Microchip DS20001801J, "MCP2515 Stand-Alone CAN Controller with SPI Interface", cited by
//! section in every file.

#![forbid(unsafe_code)]

mod access;
mod filters;
mod modes;
mod receive;
mod registers;
mod spi;
mod station;
#[cfg(test)]
mod tests;
mod timing;
mod transmit;
mod upset;
mod violation;

pub use receive::{Fate, LoggedFrame};
pub use violation::Violation;

use std::cell::Cell;

use can_model::{Engine, ErrorState, Level};
use sim_base::Cycles;

/// Mode of operation, as in OPMOD.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Sends and receives.
    Normal,
    /// Off; waits for bus activity or the driver.
    Sleep,
    /// Receives its own frames, off the bus.
    Loopback,
    /// Receives, but never drives the bus.
    ListenOnly,
    /// Off the bus; the only mode in which bit timing, filters and masks can be written.
    Configuration,
}

/// The chip.
#[derive(Debug)]
pub struct Mcp2515 {
    osc_hz: u32,
    /// Deviation of the oscillator, in parts per million.
    osc_ppm: i32,
    /// Time that the oscillator needs to become stable.
    settling: Cycles,
    /// CNF1 to CNF3 at the last bit, and the length of a bit with them, which the bus asks for at
    /// each.
    bit_ps: Cell<([u8; 3], u64)>,
    /// Stored bits. CANSTAT, TEC, REC and the read-only bits of EFLG are computed when read.
    registers: [u8; registers::SIZE],
    spi: spi::Spi,
    can: Engine,
    leaving: Option<station::Leaving>,
    mode: Mode,
    request: Option<modes::Request>,
    /// The mode that begins when the engine has received 11 recessive bits.
    joining: Option<Mode>,
    /// End of the oscillator start-up after a wake-up in progress.
    waking_until: Option<Cycles>,
    /// SPI instructions before this time are ignored.
    deaf_until: Cycles,
    /// End of a start-up with an oscillator that needs time, of which no driver can know.
    settled_at: Cycles,
    /// True if a fault holds it in configuration mode.
    is_held: bool,
    /// True if the bit timing was checked since configuration mode was entered.
    is_timing_checked: bool,
    tx: [transmit::TxState; 3],
    /// The buffer whose frame is on the bus.
    in_flight: Option<usize>,
    /// Loopback: the level that the engine drives on its own wire.
    looped_level: Level,
    /// The filter of the frame in RXB0. FILHIT0 may be that of a frame that rolled over.
    rxb0_filter: u8,
    rx_overflows: u32,
    /// The registers that the driver has written, a bit each.
    written: u128,
    /// The read-only bits of EFLG at the last check.
    error_flags: u8,
    violations: violation::Violations,
    log: receive::FrameLog,
}

impl Mcp2515 {
    /// A chip that was powered up at cycle 0, with a crystal of `osc_hz`.
    pub fn new(osc_hz: u32) -> Mcp2515 {
        let mut chip = Mcp2515 {
            osc_hz,
            osc_ppm: 0,
            settling: 0,
            bit_ps: Cell::default(),
            registers: std::array::from_fn(|address| registers::power_up_noise(address as u8)),
            spi: spi::Spi::default(),
            can: Engine::new(),
            leaving: None,
            mode: Mode::Configuration,
            request: None,
            joining: None,
            waking_until: None,
            deaf_until: 0,
            settled_at: 0,
            is_held: false,
            is_timing_checked: false,
            tx: Default::default(),
            in_flight: None,
            looped_level: Level::Recessive,
            rxb0_filter: 0,
            rx_overflows: 0,
            written: 0,
            error_flags: 0,
            violations: violation::Violations::default(),
            log: receive::FrameLog::default(),
        };
        chip.hardware_reset(0);
        chip
    }

    /// Sets the deviation of a crystal in parts per million, and the time that it needs to become
    /// stable after power-up and sleep. For a chip that has just been made.
    pub fn set_oscillator(&mut self, ppm: i32, settling: Cycles) {
        self.osc_ppm = ppm;
        self.settling = settling;
        self.power_up(0);
    }

    /// Connects the power: a reset, once the oscillator is stable.
    pub fn power_up(&mut self, at: Cycles) {
        self.hardware_reset(at);
        if self.settling > 0 {
            self.deaf_until += self.settling;
            self.settled_at = self.deaf_until;
        }
    }

    /// Pulses the RESET pin low: registers get their reset values, and the start-up time begins.
    pub fn hardware_reset(&mut self, at: Cycles) {
        self.reset(at);
        // The rest of an instruction that the reset ended is none.
        self.spi = spi::Spi::default();
    }

    /// The mode in OPMOD.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// True if a transmit buffer has a frame to send (TXREQ).
    pub fn has_frame_to_send(&self) -> bool {
        self.has_tx_request()
    }

    /// Transmit error counter; above 255 in bus-off.
    pub fn tec(&self) -> u16 {
        self.can.tec()
    }

    /// Receive error counter.
    pub fn rec(&self) -> u16 {
        self.can.rec()
    }

    /// Fault confinement state.
    pub fn error_state(&self) -> ErrorState {
        self.can.error_state()
    }

    /// Number of frames since power-up that the filters accepted and that were lost because no
    /// buffer was free, except in listen-only mode, in which others acknowledge them.
    pub fn rx_overflows(&self) -> u32 {
        self.rx_overflows
    }

    /// Bit rate of CNF1 to CNF3, in bits per second.
    pub fn bit_rate(&self) -> u64 {
        let bit_ps = self.bit_timing().bit_time_ps(self.osc_hz);
        (1_000_000_000_000 + bit_ps / 2) / bit_ps
    }

    /// Sample point of CNF1 to CNF3, in thousandths of a bit.
    pub fn sample_point_permille(&self) -> u32 {
        self.bit_timing().sample_point_permille()
    }

    /// Takes the driver mistakes since the last call; of very many only the first ones.
    pub fn take_violations(&mut self) -> Vec<Violation> {
        self.violations.take()
    }

    /// Takes the accepted frames that left the chip (RXnIF cleared, or lost) since the last call,
    /// in that order. A frame that is still in its buffer comes in a later call.
    pub fn take_frame_log(&mut self) -> Vec<LoggedFrame> {
        self.log.take()
    }
}
