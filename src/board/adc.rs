//! The temperature sensor on A0, against AVCC or the bandgap of 1.1 V. A conversion takes 104 us; it is started and collected, never waited for.

use avr_device::atmega168::ADC;

/// The converter.
pub struct Adc {
    adc: ADC,
}

impl Adc {
    pub(super) fn new(adc: ADC) -> Self {
        adc.admux().write(|w| w.refs().avcc().mux().adc0());
        adc.didr0().write(|w| w.adc0d().set_bit());
        // 125 kHz: the ADC is good for ten bits up to 200 kHz.
        adc.adcsra().write(|w| w.aden().set_bit().adsc().set_bit().adps().prescaler_128());
        Self { adc }
    }

    /// The result of a conversion, 0 to 1023, if it is done; the next one is then started, against the bandgap if so wished.
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
