//! The voltages at the ADC's inputs (datasheet section 24).
//!
//! simavr scales by 1023 instead of 1024 and, at a prescaler of 128, converts in 256 cycles instead
//! of 1664. This model gives simavr the input for which simavr's formula has the datasheet's
//! result, `Vin * 1024 / Vref` with the first transition at half a step, and the duration of 13 ADC
//! clocks (25 for the first conversion). Noise is uniform, seeded, and added to each sample.

use super::core::Core;
use super::regs::{ADCSRA, ADPS};
use sim_base::Noise;

/// Number of input channels on pins.
const CHANNELS: usize = 8;
/// `avr_adc_mux_t.kind` of a single-ended channel.
const ADC_MUX_SINGLE: u32 = simavr_ffi::ADC_MUX_SINGLE;

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

    /// Samples the input that `mux` (simavr's avr_adc_mux_t) selects, for a conversion.
    pub fn sample(&mut self, core: &Core, mux: u32) {
        let prescaler = 1u8 << (core.get(ADCSRA) & ADPS).max(1);
        let channel = (mux >> 19) as u8;
        let single_ended = mux & 0b111 == ADC_MUX_SINGLE && usize::from(channel) < CHANNELS;
        let reference_mv = u64::from(core.adc_reference_millivolts());
        let input_uv = if single_ended { self.input_with_noise_uv(channel) } else { 0 };
        let reference_uv = reference_mv * 1000;
        let code = ((u64::from(input_uv) * 1024 + reference_uv / 2) / reference_uv).min(1023);
        let millivolts = (code * reference_mv).div_ceil(1023);
        core.set_adc_input(channel, millivolts as u16, prescaler);
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
