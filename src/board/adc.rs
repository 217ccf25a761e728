//! The temperature sensor on A0. The ADC measures it against AVCC or the bandgap of 1.1 V.
//!
//! A conversion takes 104 us. The main loop starts it, collects the result later, and never waits.

use super::chip::ADC;

/// The ADC.
pub struct Adc {
    adc: ADC,
}

impl Adc {
    pub(super) fn new(adc: ADC) -> Self {
        adc.admux().write(|w| w.refs().avcc().mux().adc0());
        adc.didr0().write(|w| w.adc0d().set_bit());
        // The ADC clock is 125 kHz. The resolution of ten bits holds up to 200 kHz.
        adc.adcsra().write(|w| w.aden().set_bit().adsc().set_bit().adps().prescaler_128());
        Self { adc }
    }

    /// Returns the result, 0 to 1023, if the conversion is complete, and then starts the next one, against the bandgap or AVCC.
    pub fn take(&mut self, against_bandgap: bool) -> Option<u16> {
        if self.adc.adcsra().read().adsc().bit_is_set() {
            return None;
        }
        let reading = self.adc.adc().read().bits();
        self.adc.admux().write(|w| {
            let w = w.mux().adc0();
            if against_bandgap { w.refs().internal() } else { w.refs().avcc() }
        });
        self.adc.adcsra().write(|w| w.aden().set_bit().adsc().set_bit().adps().prescaler_128());
        Some(reading)
    }
}
