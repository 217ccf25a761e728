//! The ADC's registers and the time of a conversion (section 24). `crate::adc` has the voltages.
//!
//! > A normal conversion takes 13 ADC clock cycles. The first conversion after the ADC is switched
//! > on [...] takes 25 ADC clock cycles [...]. (section 24.4)
//!
//! The input is sampled 11 ADC clocks before the end.

use std::cell::Cell;

use super::Own;
use crate::engine::{Timer, Vector};
use crate::regs::{ADATE, ADCH, ADCL, ADCSRA, ADCSRB, ADEN, ADIF, ADLAR, ADMUX, ADPS, ADSC, ADTS};
use sim_base::Cycles;

/// ADC clocks from the sample to the end of a conversion.
const CLOCKS_AFTER_SAMPLE: Cycles = 11;
/// ADC clocks before the sample.
const CLOCKS_TO_SAMPLE: Cycles = 2;
/// The same of the first conversion.
const CLOCKS_TO_FIRST_SAMPLE: Cycles = 14;

/// The conversion in progress.
#[derive(Debug, Default)]
pub(super) struct Conversion {
    /// True if the next conversion is the first since ADEN was set.
    is_first: Cell<bool>,
    /// ADMUX at its start.
    admux: Cell<u8>,
    /// CPU cycles of an ADC clock.
    clock: Cell<Cycles>,
    /// The result, once the input is sampled.
    result: Cell<Option<u16>>,
    /// > When ADCL is read, the ADC Data Register is not updated until ADCH is read. (section
    /// > 24.9.3)
    is_locked: Cell<bool>,
}

impl Conversion {
    /// Ends the conversion.
    pub fn reset(&self) {
        self.result.set(None);
        self.is_locked.set(false);
    }
}

impl Own {
    /// Notes that the program reads ADCL or ADCH.
    #[inline]
    pub(super) fn note_read_of_result(&self, address: u16) {
        if matches!(address, ADCL | ADCH) {
            self.conversion.is_locked.set(address == ADCL);
        }
    }

    /// Writes ADCSRA. A one clears ADIF. ADSC cannot be cleared, except with ADEN.
    pub(super) fn write_adc_control(&self, value: u8) {
        let before = self.get(ADCSRA);
        if value & ADIF != 0 {
            self.clear(Vector::Adc);
        }
        let flag = before & !value & ADIF;
        if value & ADEN == 0 {
            self.unschedule(Timer::Adc);
            self.conversion.result.set(None);
            self.set(ADCSRA, value & !(ADIF | ADSC) | flag);
            return;
        }
        if before & ADEN == 0 {
            self.conversion.is_first.set(true);
        }
        self.set(ADCSRA, value & !ADIF | flag | before & ADSC);
        if value & ADSC != 0 && before & ADSC == 0 {
            self.start_conversion(self.cycle());
        }
    }

    fn start_conversion(&self, at: Cycles) {
        let Conversion { is_first, admux, clock, .. } = &self.conversion;
        admux.set(self.get(ADMUX));
        clock.set(1 << (self.get(ADCSRA) & ADPS).max(1));
        let clocks = if is_first.take() { CLOCKS_TO_FIRST_SAMPLE } else { CLOCKS_TO_SAMPLE };
        self.schedule(Timer::Adc, at + clocks * clock.get());
    }

    /// Handles the moment of the sample, or the end of a conversion. `sample` converts the input
    /// that a value of ADMUX selects.
    pub fn expire_adc(&self, at: Cycles, sample: impl FnOnce(u8) -> u16) {
        let Conversion { admux, clock, result, is_locked, .. } = &self.conversion;
        let Some(code) = result.take() else {
            result.set(Some(sample(admux.get())));
            self.schedule(Timer::Adc, at + CLOCKS_AFTER_SAMPLE * clock.get());
            return;
        };
        if !is_locked.get() {
            let code = if admux.get() & ADLAR != 0 { code << 6 } else { code };
            let [low, high] = code.to_le_bytes();
            self.set(ADCL, low);
            self.set(ADCH, high);
        }
        self.raise(Vector::Adc);
        if self.get(ADCSRA) & ADATE != 0 && self.get(ADCSRB) & ADTS == 0 {
            self.start_conversion(at);
        } else {
            self.set(ADCSRA, self.get(ADCSRA) & !ADSC);
        }
    }
}
