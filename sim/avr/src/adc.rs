//! The voltages at the ADC's inputs (datasheet section 24).
//!
//! A result is `Vin * 1024 / Vref` with the first transition at half a step. Noise is uniform,
//! seeded, and added to each sample.

use super::regs::{MUX, REFS};
use sim_base::Noise;

/// Number of input channels on pins.
const CHANNELS: usize = 8;
/// MUX3:0 of the internal reference.
const BAND_GAP: u8 = 0b1110;
const BAND_GAP_MV: u32 = 1100;
/// Voltage at AVCC and AREF.
const SUPPLY_MV: u32 = 5000;

/// Voltages at the analogue inputs.
#[derive(Debug)]
pub(super) struct Adc {
    inputs_uv: [u32; CHANNELS],
    noise_uv: u32,
    noise: Noise,
}

impl Adc {
    /// All inputs at 0 V, no noise.
    pub fn new() -> Adc {
        Adc { inputs_uv: [0; CHANNELS], noise_uv: 0, noise: Noise::new(0) }
    }

    /// Sets the voltage at ADCn.
    pub fn set_input_uv(&mut self, channel: u8, microvolts: u32) {
        self.inputs_uv[usize::from(channel)] = microvolts;
    }

    /// Adds noise of up to plus or minus `amplitude_uv` to each sample.
    pub fn set_noise_uv(&mut self, amplitude_uv: u32, seed: u64) {
        self.noise_uv = amplitude_uv;
        self.noise = Noise::new(seed);
    }

    /// The result for an input and a reference. What is no pin has 0 V.
    pub fn sample(&mut self, channel: u8, reference_mv: u32) -> u32 {
        let is_pin = usize::from(channel) < CHANNELS;
        let input_uv = if is_pin { self.input_with_noise_uv(channel) } else { 0 };
        code(input_uv, reference_mv)
    }

    /// The result for the input and the reference that a value of ADMUX selects.
    pub fn convert(&mut self, admux: u8) -> u16 {
        let reference_mv = if admux & REFS == REFS { BAND_GAP_MV } else { SUPPLY_MV };
        let result = match admux & MUX {
            BAND_GAP => code(BAND_GAP_MV * 1000, reference_mv),
            channel => self.sample(channel, reference_mv),
        };
        result as u16
    }

    fn input_with_noise_uv(&mut self, channel: u8) -> u32 {
        let input = self.inputs_uv[usize::from(channel)];
        if self.noise_uv == 0 {
            return input;
        }
        let offset = self.noise.below(2 * u64::from(self.noise_uv) + 1) as u32;
        (input + offset).saturating_sub(self.noise_uv)
    }
}

/// The datasheet's result of a conversion.
fn code(input_uv: u32, reference_mv: u32) -> u32 {
    let reference_uv = u64::from(reference_mv) * 1000;
    ((u64::from(input_uv) * 1024 + reference_uv / 2) / reference_uv).min(1023) as u32
}
