#![doc = include_str!("../README.md")]
//! # How it works
//!
//! It has two sides. The SPI side (`select`, `begin_byte`, `end_byte`, `deselect`, `int_pin`) is what a
//! microcontroller sees; the bus side is [`Station`](can_model::Station), stepped bit by bit around a
//! protocol [`Engine`]. What the datasheet forbids is recorded as a [`Violation`].
//!
//! One job per file: `registers` the map, `spi` the instructions, `access` what a register access does,
//! `modes` the operating modes and start-up, `timing` CNF1..3, `filters` acceptance, `receive` and
//! `transmit` the buffers, `station` the bus side, `upset` what nobody asked for.
//!
//! Each file names its own limits.
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

use can_model::{Engine, ErrorState, Level};
use sim_base::Cycles;

/// Mode of operation, as OPMOD shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Takes part in the traffic.
    Normal,
    /// Off, waits for bus activity or the driver.
    Sleep,
    /// Sends to itself, off the bus.
    Loopback,
    /// Hears, but never drives the bus.
    ListenOnly,
    /// Off the bus; the only mode in which bit timing, filters and masks can be written.
    Configuration,
}

/// The chip.
#[derive(Debug)]
pub struct Mcp2515 {
    osc_hz: u32,
    /// Stored bits; CANSTAT, TEC, REC and the read-only bits of EFLG are computed when read.
    registers: [u8; registers::SIZE],
    spi: spi::Spi,
    can: Engine,
    mode: Mode,
    request: Option<modes::Request>,
    /// The mode that begins when the engine has seen 11 recessive bits.
    joining: Option<Mode>,
    /// End of the oscillator start-up after a wake-up under way.
    waking_until: Option<Cycles>,
    /// SPI instructions before this time are ignored.
    deaf_until: Cycles,
    /// It stays in configuration mode.
    is_held: bool,
    /// Bit timing was checked since configuration mode was entered.
    timing_checked: bool,
    tx: [transmit::TxState; 3],
    /// The buffer whose frame is on the bus.
    in_flight: Option<usize>,
    /// Loopback: the level the engine put on its own wire.
    looped_level: Level,
    /// The filter of the frame in RXB0; FILHIT0 may speak of one that rolled over.
    rxb0_filter: u8,
    rx_overflows: u32,
    /// The read-only bits of EFLG when last looked at.
    error_flags: u8,
    violations: violation::Violations,
    log: receive::FrameLog,
}

impl Mcp2515 {
    /// A chip that was powered up at cycle 0, with a crystal of `osc_hz`.
    pub fn new(osc_hz: u32) -> Mcp2515 {
        let mut chip = Mcp2515 {
            osc_hz,
            registers: std::array::from_fn(|address| registers::power_up_noise(address as u8)),
            spi: spi::Spi::default(),
            can: Engine::new(),
            mode: Mode::Configuration,
            request: None,
            joining: None,
            waking_until: None,
            deaf_until: 0,
            is_held: false,
            timing_checked: false,
            tx: Default::default(),
            in_flight: None,
            looped_level: Level::Recessive,
            rxb0_filter: 0,
            rx_overflows: 0,
            error_flags: 0,
            violations: violation::Violations::default(),
            log: receive::FrameLog::default(),
        };
        chip.hardware_reset(0);
        chip
    }

    /// The RESET pin is pulsed low: registers to their reset values, start-up time begins.
    pub fn hardware_reset(&mut self, at: Cycles) {
        self.reset(at);
    }

    /// The mode that OPMOD shows.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// True if a transmit buffer has a frame to be sent (TXREQ).
    pub fn has_frame_to_send(&self) -> bool {
        self.any_tx_requested()
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

    /// Frames that passed the filters and were lost because no buffer was free, since power-up.
    pub fn rx_overflows(&self) -> u32 {
        self.rx_overflows
    }

    /// Bits per second that CNF1..3 give.
    pub fn bit_rate(&self) -> u64 {
        let bit_ps = self.bit_timing().bit_time_ps(self.osc_hz);
        (1_000_000_000_000 + bit_ps / 2) / bit_ps
    }

    /// Sample point that CNF1..3 give, in thousandths of a bit.
    pub fn sample_point_permille(&self) -> u32 {
        self.bit_timing().sample_point_permille()
    }

    /// The driver mistakes since the last call; of a flood only the first ones.
    pub fn take_violations(&mut self) -> Vec<Violation> {
        self.violations.take()
    }

    /// The frames that passed the filters and left the chip (RXnIF cleared, or lost) since the last call,
    /// in that order. A frame still in its buffer comes in a later call.
    pub fn take_frame_log(&mut self) -> Vec<LoggedFrame> {
        self.log.take()
    }
}
