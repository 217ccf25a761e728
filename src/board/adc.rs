//! The analogue inputs: the temperature sensor, and with the feature `power` voltage and current.
//! The ADC measures them against AVCC or the bandgap of 1.1 V.
//!
//! A conversion takes 104 us. The main loop starts it, collects the result later, and never waits.

use super::chip::ADC;
use firmware::hardware::Input;

/// DIDR0: these pins need no digital input.
const ANALOGUE: u8 = {
    let (mut mask, mut n) = (0, 0);
    while n < Input::ALL.len() {
        mask |= Input::ALL[n].pin().mask();
        n += 1;
    }
    mask
};

/// The ADC.
pub struct Adc {
    adc: ADC,
}

impl Adc {
    pub(super) fn new(adc: ADC) -> Self {
        // Safety: every value of DIDR0 is valid.
        adc.didr0.write(|w| unsafe { w.bits(ANALOGUE) });
        let mut this = Self { adc };
        this.start(false, Input::Sensor);
        this
    }

    /// Starts a conversion.
    fn start(&mut self, against_bandgap: bool, input: Input) {
        self.adc.admux.write(|w| {
            // Safety: the number of a pin of port C is the number of a channel.
            let w = unsafe { w.mux().bits(input.pin().bit) };
            if against_bandgap { w.refs().internal() } else { w.refs().avcc() }
        });
        // The ADC clock is 125 kHz. The resolution of ten bits holds up to 200 kHz.
        self.adc.adcsra.write(|w| w.aden().set_bit().adsc().set_bit().adps().prescaler_128());
    }

    /// Returns the result, 0 to 1023, if the conversion is complete, and then starts one of the
    /// input `next`, against the bandgap or AVCC.
    pub fn reading(&mut self, against_bandgap: bool, next: Input) -> Option<u16> {
        if self.adc.adcsra.read().adsc().bit_is_set() {
            return None;
        }
        let reading = self.adc.adc.read().bits();
        self.start(against_bandgap, next);
        Some(reading)
    }
}
