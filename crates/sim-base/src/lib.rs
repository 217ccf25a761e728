#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod duration;
mod noise;

pub use duration::parse_seconds;
pub use noise::Noise;

/// Time, in cycles of a 16 MHz clock since the simulation began. It never goes back, not even when a processor is reset.
pub type Cycles = u64;

/// The clock in whose cycles all simulated time is counted, in hertz: the crystal of the Arduinos.
pub const F_CPU_HZ: u64 = 16_000_000;

/// Time since the simulation began, to the microsecond below.
pub fn elapsed(cycles: Cycles) -> std::time::Duration {
    std::time::Duration::from_micros(cycles / (F_CPU_HZ / 1_000_000))
}

/// A number with a comma before each three digits.
pub fn thousands(number: usize) -> String {
    match number {
        0..1_000 => number.to_string(),
        _ => format!("{},{:03}", thousands(number / 1_000), number % 1_000),
    }
}
