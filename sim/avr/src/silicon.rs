//! Values in which chips of one type differ, and the two counts of time.
//!
//! Inside the chip all models count cycles of the main clock. The board outside counts
//! [`Cycles`] of 62.5 ns. [`Silicon`] converts one into the other. With a main clock of exactly
//! 16 MHz both are equal.

use std::cell::Cell;
use std::rc::Rc;

use super::processor::{SerialCharacter, SpiByte, SpiDevice, TwiBus};
use sim_base::{Cycles, F_CPU_HZ};

const MILLION: u64 = 1_000_000;

/// The values of one chip. The default is a typical one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Silicon {
    /// Deviation of the main clock from 16 MHz, in parts per million.
    pub clock_ppm: i32,
    /// Time from a reset to the first instruction, in microseconds.
    pub start_up_us: u32,
    /// Time in which a byte of EEPROM is erased and written, in microseconds.
    pub eeprom_us: u32,
    /// Time in which a page of flash is erased, or written, in microseconds.
    pub flash_us: u32,
    /// Deviation of the watchdog's time-outs, in parts per million; `None`: by the seed.
    pub watchdog_ppm: Option<i32>,
    /// The internal voltage reference, in millivolts.
    pub reference_mv: u32,
    /// Error of the ADC's results, in steps.
    pub adc_offset: i32,
    /// Deviation of the clock at the other end of the serial port, in parts per million.
    pub line_ppm: i32,
    /// True if inputs that nothing drives read as noise; else they keep their last level.
    pub is_floating: bool,
}

impl Default for Silicon {
    fn default() -> Silicon {
        Silicon {
            clock_ppm: 0,
            start_up_us: 0,
            eeprom_us: 3_400,
            flash_us: 4_500,
            watchdog_ppm: None,
            reference_mv: 1_100,
            adc_offset: 0,
            line_ppm: 0,
            is_floating: false,
        }
    }
}

impl Silicon {
    /// Cycles of the chip in a million of cycles outside.
    pub(super) fn rate(&self) -> u64 {
        MILLION.saturating_add_signed(self.clock_ppm.into())
    }

    /// The first cycle of the chip that begins at `time` or later.
    pub(super) fn cycle_at(&self, time: Cycles) -> Cycles {
        match self.clock_ppm {
            0 => time,
            _ => (u128::from(time) * u128::from(self.rate())).div_ceil(MILLION.into()) as Cycles,
        }
    }

    /// The time outside at which a cycle of the chip begins, rounded down.
    pub(super) fn time_of(&self, cycle: Cycles) -> Cycles {
        match self.clock_ppm {
            0 => cycle,
            _ => (u128::from(cycle) * u128::from(MILLION) / u128::from(self.rate())) as Cycles,
        }
    }

    /// Cycles of the chip in a number of microseconds.
    pub(super) fn cycles_in_us(&self, microseconds: u32) -> Cycles {
        self.cycle_at(u64::from(microseconds) * F_CPU_HZ / MILLION)
    }

    /// Frequency of the main clock in hertz.
    pub(super) fn clock_hz(&self) -> u64 {
        F_CPU_HZ * self.rate() / MILLION
    }

    /// Bits per second of this length, by the clock of the other end of the serial port; or the
    /// other way round, the length of a bit in cycles.
    pub(super) fn rate_on_line(&self, cycles_per_bit: u64) -> u64 {
        let line = MILLION.saturating_add_signed(self.line_ppm.into());
        F_CPU_HZ * self.rate() / (cycles_per_bit * line)
    }

    /// A character in the time outside.
    pub(super) fn character_outside(&self, character: SerialCharacter) -> SerialCharacter {
        SerialCharacter {
            start: self.time_of(character.start),
            cycles_per_bit: self.time_of(character.cycles_per_bit),
            ..character
        }
    }
}

/// What is outside of a chip, with the time outside.
pub(super) struct Outside<T> {
    pub device: T,
    pub silicon: Rc<Cell<Silicon>>,
}

impl SpiDevice for Outside<Box<dyn SpiDevice>> {
    fn begin_byte(&mut self, at: Cycles) {
        self.device.begin_byte(self.silicon.get().time_of(at));
    }

    fn end_byte(&mut self, byte: &SpiByte) -> u8 {
        let silicon = self.silicon.get();
        let [start, end] = [byte.start, byte.end].map(|at| silicon.time_of(at));
        self.device.end_byte(&SpiByte { start, end, ..*byte })
    }
}

impl TwiBus for Outside<Box<dyn TwiBus>> {
    fn address(&mut self, now: Cycles, address: u8, is_read: bool) -> bool {
        self.device.address(self.silicon.get().time_of(now), address, is_read)
    }

    fn write(&mut self, byte: u8) -> bool {
        self.device.write(byte)
    }

    fn read(&mut self) -> u8 {
        self.device.read()
    }

    fn stop(&mut self) {
        self.device.stop();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fast_clock_has_more_cycles_in_the_same_time_and_a_slow_one_fewer() {
        let cycles = |clock_ppm| {
            let silicon = Silicon { clock_ppm, ..Silicon::default() };
            (silicon.cycle_at(F_CPU_HZ), silicon.cycles_in_us(3_400), silicon.clock_hz())
        };
        assert_eq!(cycles(0), (16_000_000, 54_400, 16_000_000));
        assert_eq!(cycles(5_000), (16_080_000, 54_672, 16_080_000));
        assert_eq!(cycles(-5_000), (15_920_000, 54_128, 15_920_000));
    }

    #[test]
    fn a_run_up_to_a_time_ends_at_that_time_or_less_than_a_cycle_later() {
        for clock_ppm in [-20_000, -5_000, -1, 0, 3, 4_000, 20_000] {
            let silicon = Silicon { clock_ppm, ..Silicon::default() };
            for time in (0..5_000).chain([F_CPU_HZ * 86_400 * 365, u64::MAX / 2]) {
                let end = silicon.time_of(silicon.cycle_at(time));
                assert!((time..=time + 1).contains(&end), "{clock_ppm}: {time} {end}");
            }
        }
    }
}
