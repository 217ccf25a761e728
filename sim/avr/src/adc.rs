//! The voltages at the ADC's inputs (datasheet section 24).
//!
//! A result is `Vin * 1024 / Vref` with the first transition at half a step. Noise is uniform,
//! seeded, and added to each sample.

use super::regs::{MUX, REFS};
use super::silicon::Silicon;
use sim_base::Noise;

/// Number of input channels on pins.
const CHANNELS: usize = 8;
/// MUX3:0 of the internal reference.
const BAND_GAP: u8 = 0b1110;
/// Voltage at AVCC and AREF.
const SUPPLY_MV: u32 = 5000;

/// Voltages at the analogue inputs.
#[derive(Debug)]
pub(super) struct Adc {
    /// `None`: nothing is connected.
    inputs_uv: [Option<u32>; CHANNELS],
    /// The internal reference, the error of a result, and what an open input reads.
    silicon: Silicon,
    noise_uv: u32,
    noise: Noise,
}

impl Adc {
    /// All inputs open, no noise.
    pub fn new() -> Adc {
        Adc {
            inputs_uv: [None; CHANNELS],
            silicon: Silicon::default(),
            noise_uv: 0,
            noise: Noise::new(0),
        }
    }

    /// Sets the values of the chip.
    pub fn tune(&mut self, silicon: Silicon) {
        self.silicon = silicon;
    }

    /// Sets the voltage at ADCn.
    pub fn set_input_uv(&mut self, channel: u8, microvolts: u32) {
        self.inputs_uv[usize::from(channel)] = Some(microvolts);
    }

    /// Adds noise of up to plus or minus `amplitude_uv` to each sample.
    pub fn set_noise_uv(&mut self, amplitude_uv: u32, seed: u64) {
        self.noise_uv = amplitude_uv;
        self.noise = Noise::new(seed);
    }

    /// The result for an input and a nominal reference. What is no pin has 0 V.
    pub fn sample(&mut self, channel: u8, reference_mv: u32) -> u32 {
        let is_pin = usize::from(channel) < CHANNELS;
        let input_uv = if is_pin { self.input_with_noise_uv(channel) } else { 0 };
        self.code(input_uv, reference_mv)
    }

    /// The result for the input and the reference that a value of ADMUX selects.
    pub fn convert(&mut self, admux: u8) -> u16 {
        let reference_mv = if admux & REFS == REFS { 0 } else { SUPPLY_MV };
        let result = match admux & MUX {
            BAND_GAP => self.code(self.silicon.reference_mv * 1000, reference_mv),
            channel => self.sample(channel, reference_mv),
        };
        result as u16
    }

    fn input_with_noise_uv(&mut self, channel: u8) -> u32 {
        let Some(input) = self.inputs_uv[usize::from(channel)] else {
            let is_floating = self.silicon.is_floating;
            let highest = if is_floating { u64::from(SUPPLY_MV) * 1000 } else { 0 };
            return self.noise.below(highest + 1) as u32;
        };
        if self.noise_uv == 0 {
            return input;
        }
        let offset = self.noise.below(2 * u64::from(self.noise_uv) + 1) as u32;
        (input + offset).saturating_sub(self.noise_uv)
    }

    /// The datasheet's result of a conversion with the supply or, else, the internal reference.
    fn code(&self, input_uv: u32, reference_mv: u32) -> u32 {
        let is_supply = reference_mv == SUPPLY_MV;
        let reference_mv = if is_supply { SUPPLY_MV } else { self.silicon.reference_mv };
        let reference_uv = u64::from(reference_mv) * 1000;
        let exact = (u64::from(input_uv) * 1024 + reference_uv / 2) / reference_uv;
        (exact.min(1023) as i32 + self.silicon.adc_offset).clamp(0, 1023) as u32
    }
}
