//! Revolutions of a shaft, from its pulses: sensors.rpm.RPM.
//!
//! A window begins with a pulse, and ends with the first pulse after [`WINDOW_MS`]. The speed is
//! the number of pulses in it, divided by the time between these two pulses, so no part of a pulse
//! is lost at the ends. If the next pulse is late, the speed falls with the time since the last
//! one; after [`STOP_MS`] it is 0.
//!
//! The board counts one pulse in a slot at most. An input with a pulse in each slot is noisy: its
//! speed is not known.

use crate::hardware::ShaftPulses;
use crate::monitor::{Line, Monitor};
use crate::tables::parameters::{Parameter, Parameters};

/// The shortest window with fewer pulses than [`WINDOW_PULSES`].
const WINDOW_MS: u16 = 50;

/// Pulses that end a window, too, after 28 ms or more. A tick of the time and the delay of an
/// interrupt, together below 40 us, are less than 0.2 % of it. [`quotient`] takes 143 of them: 32
/// more, which come in 8 ms, and the main loop asks for them in half of that.
const WINDOW_PULSES: u8 = 112;

/// Time without a pulse until the speed is 0.
const STOP_MS: u16 = 2000;

/// Ticks of a pulse: with less the input is noisy. A regular input has at most 3,968 pulses a
/// second.
const NOISY_TICKS: u16 = ShaftPulses::SLOT_TICKS as u16 + 1;

/// Flag of an RPM: the speed is not known (DSDL 1045.RPM.uavcan, FLAGS_UNHEALTHY).
const UNHEALTHY: u16 = 1;

/// Ticks in a minute.
const TICKS_PER_MIN: u32 = TICKS_PER_MS as u32 * 60_000;
const TICKS_PER_MS: u16 = ShaftPulses::TICKS_PER_MS as u16;

/// The shaft.
pub struct Shaft {
    /// The pulse that began the window: its time in milliseconds, and the ticks after that.
    first_ms: u16,
    first_ticks: u8,
    /// Time of the last pulse, in milliseconds.
    last_ms: u16,
    /// True if a window has begun.
    has_first: bool,
    /// Pulses since the first one of the window.
    count: u8,
    /// The last complete window: its pulses, 0 for none, and their time: milliseconds, and the
    /// ticks to add.
    pulses: u8,
    passed_ms: u16,
    passed_ticks: i16,
    /// Windows until the input is no longer noisy: the next one begins in the noise.
    noisy: u8,
}

/// [`Shaft::noisy`] after a window with too many pulses.
const NOISY_WINDOWS: u8 = 2;

impl Shaft {
    /// A shaft that stands still.
    pub const fn new() -> Self {
        Self {
            first_ms: 0,
            first_ticks: 0,
            last_ms: 0,
            has_first: false,
            count: 0,
            pulses: 0,
            passed_ms: 0,
            passed_ticks: 0,
            noisy: 0,
        }
    }

    /// Takes the pulses since the last call, and those since RPM_RATE is not 0. Call it each
    /// millisecond.
    #[inline(never)]
    pub fn tick(
        &mut self,
        pulses: ShaftPulses,
        now_ms: u16,
        parameters: &Parameters,
        monitor: &mut Monitor,
    ) {
        let was_noisy = self.noisy != 0;
        if !parameters.is_on(Parameter::RpmRate)
            || pulses.count == 0 && now_ms.wrapping_sub(self.last_ms) > STOP_MS
        {
            self.has_first = false;
            self.pulses = 0;
            self.noisy = 0;
        } else if pulses.count != 0 && self.add(pulses, now_ms) {
            self.noisy =
                if self.has_too_many() { NOISY_WINDOWS } else { self.noisy.saturating_sub(1) };
        }
        let is_noisy = self.noisy != 0;
        if is_noisy != was_noisy {
            monitor.log_line(if is_noisy { Line::TooManyPulses } else { Line::TooManyPulsesEnd });
        }
    }

    /// Adds pulses, at least one. Returns true if a window is complete.
    fn add(&mut self, pulses: ShaftPulses, now_ms: u16) -> bool {
        // The last pulse can be after the millisecond that the main loop has come to.
        let ahead_ms = pulses.ms.wrapping_sub(now_ms as u8) as i8;
        self.last_ms = now_ms.wrapping_add(ahead_ms as u16);
        self.count = self.count.wrapping_add(pulses.count);
        let passed_ms = self.last_ms.wrapping_sub(self.first_ms);
        let is_complete = self.has_first;
        if is_complete {
            if passed_ms < WINDOW_MS && self.count < WINDOW_PULSES {
                return false;
            }
            self.pulses = self.count;
            self.passed_ms = passed_ms;
            self.passed_ticks = i16::from(pulses.ticks) - i16::from(self.first_ticks);
        }
        self.has_first = true;
        self.first_ms = self.last_ms;
        self.first_ticks = pulses.ticks;
        self.count = 0;
        is_complete
    }

    /// True if the last complete window has a pulse in each slot.
    fn has_too_many(&self) -> bool {
        // Such a window ends with its pulses, so it is short.
        const { assert!(NOISY_TICKS < (WINDOW_MS * TICKS_PER_MS) / WINDOW_PULSES as u16) };
        let ticks = self.passed_ms.wrapping_mul(TICKS_PER_MS);
        self.passed_ms < WINDOW_MS
            && ticks.wrapping_add_signed(self.passed_ticks) < u16::from(self.pulses) * NOISY_TICKS
    }

    /// Ticks of the last complete window.
    fn ticks(&self) -> u32 {
        (u32::from(self.passed_ms) * u32::from(TICKS_PER_MS)).wrapping_add(self.passed_ticks as u32)
    }

    /// Puts the flags and the speed of a shaft with this number of pulses in a turn.
    pub fn put(&self, pulses_in_turn: u8, now_ms: u16, mut put: impl FnMut(u16)) {
        let is_noisy = self.noisy != 0;
        put(if is_noisy { UNHEALTHY } else { 0 });
        if self.pulses == 0 || is_noisy {
            put(0);
            put(0);
            return;
        }
        let (mut pulses, mut ticks) = (self.pulses, self.ticks());
        // For this time at least there was no pulse, so there is at most one in it.
        let pause_ms = now_ms.wrapping_sub(self.last_ms).saturating_sub(1);
        if pause_ms > self.passed_ms {
            (pulses, ticks) = (1, u32::from(pause_ms) * u32::from(TICKS_PER_MS));
        }
        let [high, low] =
            quotient(u32::from(pulses) * TICKS_PER_MIN, ticks * u32::from(pulses_in_turn));
        put(low);
        put(high);
    }
}

/// `dividend` / `divisor` as an IEEE 754 single: its upper and its lower half. It has 16
/// significant bits, and what is beyond them is cut, so it is too small by 1/32,768 at most. Both
/// are above 0 and below 2^31.
fn quotient(dividend: u32, mut divisor: u32) -> [u16; 2] {
    // Shifts both until the quotient is at least 1 and below 2.
    let mut rest = dividend;
    let mut exponent = 127u8;
    let mut shifts = 31u8;
    while divisor < 1 << 30 && shifts != 0 {
        divisor <<= 1;
        exponent += 1;
        shifts -= 1;
    }
    shifts = 31;
    while rest < divisor && shifts != 0 {
        rest <<= 1;
        exponent -= 1;
        shifts -= 1;
    }
    let mut mantissa = 0u16;
    for _ in 0..16u8 {
        mantissa <<= 1;
        if rest >= divisor {
            rest -= divisor;
            mantissa |= 1;
        }
        rest <<= 1;
    }
    // The format does not store the leading one.
    let [low, high] = mantissa.to_le_bytes();
    [u16::from(exponent) << 7 | u16::from(high & 0x7F), u16::from(low) << 8]
}

#[cfg(test)]
mod tests {
    #[test]
    fn quotients_are_cut_to_16_bits() {
        let quotient = |dividend, divisor| {
            let [high, low] = super::quotient(dividend, divisor);
            f64::from(f32::from_bits(u32::from(high) << 16 | u32::from(low)))
        };
        for (dividend, divisor, expected) in [
            (1, 1, 1.0),
            (15_000_000, 250_000, 60.0),
            (15_000_000, 250, 60_000.0),
            (143 * 15_000_000, 1, 2_144_993_280.0),
            (1, 0x7FFF_FFFF, 4.656_612_873_077_393e-10),
        ] {
            assert_eq!(quotient(dividend, divisor), expected);
        }
        let mut seed = 1u32;
        for _ in 0..100_000 {
            let [dividend, divisor] = [(); 2].map(|()| {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                // Numbers of all lengths.
                (seed >> 1 >> (seed % 24)).max(1)
            });
            let exact = f64::from(dividend) / f64::from(divisor);
            let error = 1.0 - quotient(dividend, divisor) / exact;
            assert!((0.0..=1.0 / 32_768.0).contains(&error), "{dividend} / {divisor}: {error}");
        }
    }
}
