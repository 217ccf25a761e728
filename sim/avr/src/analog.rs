//! What is not digital: the watchdog's oscillator, the contents of the RAM at power-on, and the
//! brightness of a light on OC2B. The first two follow from seeds, so that a run can be repeated.
//!
//! The watchdog has an RC oscillator of "128 kHz", which is independent of the crystal (datasheet
//! section 11.8). Here its frequency differs from chip to chip by up to 10 %, and each time-out has
//! jitter. The datasheet has no value for the jitter. The model's 0.01 % of a time-out of 16 ms is
//! less than the jitter that published random number generators use.

use super::chip::Chip;
use super::regs::{DDRD, OCR2A, OCR2B, RAMSTART, TCCR2A, TCCR2B};
use super::silicon::Silicon;
use sim_base::{Cycles, Noise};

/// > 2K (2048) cycles (table 11-2), of 125 CPU cycles each.
const SHORTEST_TIME_OUT: Cycles = 2048 * 125;
/// Largest deviation of a chip's frequency.
const TOLERANCE_PER_MILLION: u64 = 100_000;
/// Largest deviation of the shortest time-out from its mean. It grows with the square root of the
/// time, like a random walk.
const JITTER_CYCLES: u64 = 25;

/// The watchdog's oscillator of one chip.
#[derive(Debug)]
pub struct WatchdogOscillator {
    noise: Noise,
    /// Length of a time-out in CPU cycles, in millionths of the nominal one.
    per_million: u64,
    /// The same by the seed alone.
    by_seed: u64,
}

impl WatchdogOscillator {
    /// The oscillator of a chip with this seed.
    pub fn new(seed: u64) -> WatchdogOscillator {
        let mut noise = Noise::new(seed);
        let by_seed =
            1_000_000 - TOLERANCE_PER_MILLION + noise.below(2 * TOLERANCE_PER_MILLION + 1);
        WatchdogOscillator { noise, per_million: by_seed, by_seed }
    }

    /// Sets the values of the chip.
    pub fn tune(&mut self, silicon: &Silicon) {
        let chosen =
            silicon.watchdog_ppm.map(|ppm| 1_000_000_u64.saturating_add_signed(ppm.into()));
        self.per_million = silicon.cycle_at(chosen.unwrap_or(self.by_seed));
    }

    /// Length of the next time-out in CPU cycles, with `control` in WDTCSR.
    pub fn time_out(&mut self, control: u8) -> Cycles {
        let prescaler = control & 0b111 | (control & 1 << 5) >> 2;
        let jitter = JITTER_CYCLES << (prescaler / 2);
        let mean = (SHORTEST_TIME_OUT << prescaler) * self.per_million / 1_000_000;
        mean - jitter + self.noise.below(2 * jitter + 1)
    }
}

/// The random contents of R0 to R31 and the RAM after a power-on: addresses and bytes.
pub fn power_on_ram(chip: Chip, noise: &mut Noise) -> Vec<(u16, u8)> {
    let addresses = (0..0x20).chain(RAMSTART..=chip.ram_end());
    addresses.map(|address| (address, noise.next_u64() as u8)).collect()
}

/// Duty cycle of OC2B (D3), 0 to 1, if Timer2 drives it in a PWM mode (datasheet section 18.7).
/// `get` reads a register without side effects.
pub fn oc2b_duty(get: impl Fn(u16) -> u8) -> Option<f64> {
    let (control_a, control_b) = (get(TCCR2A), get(TCCR2B));
    let com2b = (control_a >> 4) & 0b11;
    let drives = get(DDRD) & 1 << 3 != 0 && control_b & 0b111 != 0 && com2b & 0b10 != 0;
    let (ocr, ocra) = (f64::from(get(OCR2B)), f64::from(get(OCR2A)));
    let duty = match (control_b & 0b1000) >> 1 | control_a & 0b11 {
        1 => ocr / 255.0,
        3 => (ocr + 1.0) / 256.0,
        5 => ocr / ocra.max(1.0),
        7 => (ocr + 1.0) / (ocra + 1.0),
        _ => return None,
    };
    let duty = duty.min(1.0);
    drives.then_some(if com2b == 0b11 { 1.0 - duty } else { duty })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time_outs(seed: u64) -> Vec<Cycles> {
        let mut watchdog = WatchdogOscillator::new(seed);
        (0..100).map(|_| watchdog.time_out(0)).collect()
    }

    #[test]
    fn the_time_outs_of_a_chip_deviate_from_16_ms_by_at_most_10_percent_and_have_jitter() {
        for seed in 0..200 {
            let time_outs = time_outs(seed);
            let (min, max) = (time_outs.iter().min().unwrap(), time_outs.iter().max().unwrap());
            assert!(
                (230_000..=282_000).contains(min) && max - min <= 2 * JITTER_CYCLES,
                "{seed}: {min} to {max}"
            );
            assert!(max - min > JITTER_CYCLES, "no jitter");
        }
    }

    #[test]
    fn the_prescaler_doubles_the_time_out() {
        let mut watchdog = WatchdogOscillator::new(1);
        let mean = watchdog.time_out(0) as f64;
        for (control, factor) in
            [(0b001, 2.0), (0b100, 16.0), (0b10_0000, 256.0), (0b10_0001, 512.0)]
        {
            let time_out = watchdog.time_out(control | 1 << 3) as f64;
            assert!((time_out / mean / factor - 1.0).abs() < 0.001, "{control:#b}");
        }
    }
}
