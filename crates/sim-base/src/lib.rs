#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod device;
mod duration;
mod file;
mod noise;
mod number;

pub use device::{DEVICE_NOTE, device_of_note};
pub use duration::parse_seconds;
pub use file::{PROGRAM_BYTES, read_file, read_text};
pub use noise::Noise;
pub use number::parse_number;

/// Time in cycles of a 16 MHz clock since the start of the simulation. It never decreases, also
/// when a processor is reset.
pub type Cycles = u64;

/// Frequency of the clock that counts simulated time, in hertz: the crystal of the Arduinos.
pub const F_CPU_HZ: u64 = 16_000_000;

/// Time since the start of the simulation, rounded down to a microsecond.
pub fn elapsed(cycles: Cycles) -> std::time::Duration {
    std::time::Duration::from_micros(cycles / (F_CPU_HZ / 1_000_000))
}

/// A number with a comma before each group of three digits.
pub fn thousands(number: usize) -> String {
    match number {
        0..1_000 => number.to_string(),
        _ => format!("{},{:03}", thousands(number / 1_000), number % 1_000),
    }
}
