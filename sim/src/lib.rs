//! The bench: an ATmega168 or ATmega328P in simavr, an MCP2515 modelled from its datasheet, and a CAN bus that is
//! simulated bit by bit on the AVR's clock.

pub mod avr;
pub mod bench;
pub mod board;
pub mod budget;
pub mod can;
pub mod mcp2515;
pub mod wiring;

/// The host-side codec: what the bench sends as an autopilot and shows as bus traffic.
pub use dronecan_host as dronecan;

/// Time, in cycles of the 16 MHz AVR clock since the simulation began. It never goes back, not even
/// when an AVR is reset.
pub type Cycles = u64;

/// AVR clock, in hertz: the crystal of the Arduinos. All simulated time is counted in its cycles.
pub const F_CPU_HZ: u64 = 16_000_000;

/// Time since the simulation began, to the microsecond below.
pub fn elapsed(cycles: Cycles) -> std::time::Duration {
    std::time::Duration::from_micros(cycles / (F_CPU_HZ / 1_000_000))
}

/// A number with a comma before each three digits.
pub(crate) fn thousands(number: usize) -> String {
    match number {
        0..1_000 => number.to_string(),
        _ => format!("{},{:03}", thousands(number / 1_000), number % 1_000),
    }
}

pub mod autopilot;
pub mod links;
pub mod ui;
pub mod utilisation;
