//! Voltage and current of a circuit, from two analogue inputs, and their limits.
//!
//! The voltage comes from a divider, the current from a sensor whose voltage follows it, such as an
//! ACS712 or an INA180 with its shunt. The ADC has ten bits, so a step is 4.9 mV at the pin against
//! 5 V. The node adds up 16 readings of each input, one of all inputs each millisecond.

use dronecan_wire::float16;

use crate::hardware::Input;
use crate::math::scaled;
use crate::monitor::{Line, Monitor};
use crate::tables::parameters::{Parameter, Parameters};

/// Error flag of a CircuitStatus: above PWR1_VOLT_MAX (DSDL 1091.CircuitStatus.uavcan).
const OVERVOLTAGE: u8 = 1;
/// Error flag of a CircuitStatus: below PWR1_VOLT_MIN.
const UNDERVOLTAGE: u8 = 2;
/// Error flag of a CircuitStatus: above PWR1_AMP_MAX.
pub const OVERCURRENT: u8 = 4;

/// Readings in a sum.
const READINGS: u8 = 16;
/// The sum of readings for the reference voltage: a reading is 1024 x voltage / reference
/// (ATmega48/88/168 datasheet 2545, section 23.7).
const FULL_SCALE: u16 = READINGS as u16 * 1024;
/// The reference voltage in millivolts, for TEMP_REF 0 and 1.
const AVCC_MV: u16 = 5000;
const BANDGAP_MV: u16 = 1100;

/// actuator.Status.power_rating_pct: unknown.
pub const RATING_UNKNOWN: u8 = 127;

/// The circuit.
pub struct Power {
    /// The input that the ADC measures now.
    input: Input,
    sums: [u16; 2],
    count: u8,
    /// The sums that were complete last.
    latest: [u16; 2],
    has_measured: bool,
    millivolts: u16,
    /// The current in 10 mA.
    centiamperes: i16,
    flags: u8,
}

impl Power {
    /// A circuit that is not measured yet.
    pub const fn new() -> Self {
        Self {
            input: Input::Sensor,
            sums: [0; 2],
            count: 0,
            latest: [0; 2],
            has_measured: false,
            millivolts: 0,
            centiamperes: 0,
            flags: 0,
        }
    }

    /// The input for the next reading. Without PWR_RATE and BATT_RATE it is always the temperature
    /// sensor.
    pub fn next_input(&self, parameters: &Parameters) -> Input {
        match self.input {
            Input::Sensor if is_wanted(parameters) => Input::Voltage,
            Input::Voltage => Input::Current,
            _ => Input::Sensor,
        }
    }

    /// Adds a reading of the ADC, which measures the next input now. Returns the input of the
    /// reading, and true if it completes a sum.
    pub fn add(&mut self, reading: u16, next: Input) -> (Input, bool) {
        let input = core::mem::replace(&mut self.input, next);
        match input {
            Input::Sensor => return (input, false),
            Input::Voltage => self.sums[0] += reading,
            Input::Current => {
                self.sums[1] += reading;
                self.count += 1;
            }
        }
        let is_complete = self.count == READINGS;
        if is_complete {
            self.latest = core::mem::take(&mut self.sums);
            self.count = 0;
        }
        (input, is_complete)
    }

    /// True if voltage and current are known.
    pub fn is_known(&self) -> bool {
        self.has_measured
    }

    /// The voltage in volts as a float16.
    #[inline(never)]
    pub fn voltage(&self) -> u16 {
        float16::from_fixed(scaled(self.millivolts, 256, 1000), 8)
    }

    /// The current in amperes as a float16.
    #[inline(never)]
    pub fn current(&self) -> u16 {
        let amperes = float16::from_fixed(scaled(self.centiamperes.unsigned_abs(), 64, 100), 6);
        if self.centiamperes < 0 { amperes | float16::SIGN } else { amperes }
    }

    /// The current in 10 mA.
    pub fn centiamperes(&self) -> i16 {
        self.centiamperes
    }

    /// The energy of a charge at the circuit's voltage, in watt-hours as a float16.
    #[inline(never)]
    pub fn energy(&self, charge_mah: u16) -> u16 {
        // In sixteenths: mAh x mV / (1,000,000 / 16), halved, because the divisor has 15 bits.
        float16::from_fixed(scaled(charge_mah, self.millivolts >> 1, 31_250), 4)
    }

    /// The error flags of a CircuitStatus.
    pub fn flags(&self) -> u8 {
        self.flags
    }

    /// The current in percent of PWR1_AMP_MAX, for actuator.Status of the output that PWR1_OUT
    /// names. [`RATING_UNKNOWN`] for others.
    pub fn rating_percent(&self, output: usize, parameters: &Parameters) -> u8 {
        let most = parameters.get(Parameter::Pwr1AmpMax);
        if !self.has_measured
            || most == 0
            || usize::from(parameters.get(Parameter::Pwr1Out)) != output + 1
        {
            return RATING_UNKNOWN;
        }
        scaled(self.centiamperes.unsigned_abs(), 100, most).min(u16::from(RATING_UNKNOWN) - 1) as u8
    }

    /// Computes voltage and current from the last sums, and compares them with their limits.
    #[inline(never)]
    pub fn measure(&mut self, parameters: &Parameters) {
        let [voltage, current] = self.latest;
        let voltage_mv = above(voltage, Parameter::Pwr1VoltOfs, parameters);
        self.millivolts = 0;
        if voltage_mv >= 0 {
            let multiplier = parameters.get(Parameter::Pwr1VoltMult);
            self.millivolts = scaled(voltage_mv as u16, multiplier, 1000);
        }
        let current_mv = above(current, Parameter::Pwr1AmpOffset, parameters);
        let centiamperes =
            scaled(current_mv.unsigned_abs(), parameters.get(Parameter::Pwr1AmpPervlt), 1000);
        let centiamperes = centiamperes.min(i16::MAX as u16) as i16;
        self.centiamperes = if current_mv < 0 { -centiamperes } else { centiamperes };
        self.has_measured = true;

        self.flags = 0;
        if is_above(self.millivolts, parameters.get(Parameter::Pwr1VoltMax)) {
            self.flags |= OVERVOLTAGE;
        }
        // Nothing is below 0, which is no limit.
        if self.millivolts < parameters.get(Parameter::Pwr1VoltMin) {
            self.flags |= UNDERVOLTAGE;
        }
        let magnitude = self.centiamperes.unsigned_abs();
        if is_above(magnitude, parameters.get(Parameter::Pwr1AmpMax)) {
            self.flags |= OVERCURRENT;
        }
    }

    /// Logs voltage and current. Returns true if one of them is beyond its limits. Call once a
    /// second.
    pub fn second(&mut self, parameters: &Parameters, monitor: &mut Monitor) -> bool {
        if !is_wanted(parameters) {
            self.has_measured = false;
            self.flags = 0;
        }
        if self.has_measured {
            let event = monitor.log_line(Line::Circuit);
            event.set_a(self.centiamperes as u16);
            event.set_b(self.millivolts);
        }
        self.flags != 0
    }
}

/// The voltage of an input above the offset that a parameter has, in millivolts.
#[inline(never)]
fn above(sum: u16, offset: Parameter, parameters: &Parameters) -> i16 {
    let reference_mv = if parameters.is_on(Parameter::TempRef) { BANDGAP_MV } else { AVCC_MV };
    scaled(sum, reference_mv, FULL_SCALE) as i16 - parameters.get(offset) as i16
}

/// True if a value is above its limit. 0 is no limit.
#[inline(never)]
fn is_above(value: u16, limit: u16) -> bool {
    limit != 0 && value > limit
}

/// True if a message needs the circuit.
fn is_wanted(parameters: &Parameters) -> bool {
    parameters.is_on(Parameter::PwrRate) || parameters.is_on(Parameter::BattRate)
}

#[cfg(test)]
impl Power {
    /// A circuit that was measured: its voltage in mV and its current in 10 mA.
    pub fn at(millivolts: u16, centiamperes: i16) -> Self {
        Self { millivolts, centiamperes, has_measured: true, ..Self::new() }
    }
}

#[cfg(test)]
mod tests;
