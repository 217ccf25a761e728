//! The battery that feeds the circuit: the charge drawn since power-on, and what is left of
//! BATT_CAPACITY.
//!
//! The node takes the battery as full at power-on, as ArduPilot's own monitors do. It adds each
//! measured current times the milliseconds since the measurement before. Both are integers and no
//! rest is dropped, so the sum has the error of the measured current and no other.

use dronecan_wire::float16;

use super::power::{OVERCURRENT, Power};
use crate::math::scaled;
use crate::tables::parameters::{Parameter, Parameters};

/// The time is counted in ticks. Ticks of milliseconds would need five bytes for the charge.
const TICK_MS: u16 = 16;

/// The charge without its lower 15 bits, in tenths of a uAh: 10 mA x 16 ms x 32,768 / 3,600 s.
const UPPER_TENTHS_UAH: u16 = 14_564;

/// Status flag of a BatteryInfo: the battery is in use (DSDL 1092.BatteryInfo.uavcan).
const IN_USE: u8 = 1;
/// Place of TEMP_HOT and TEMP_COLD in the status flags: those of a Temperature, shifted.
const HOT_AND_COLD: u8 = 3;
/// Status flag of a BatteryInfo: beyond PWR1_AMP_MAX.
const OVERLOAD: u8 = 32;

/// A percentage that is not known.
const UNKNOWN: u8 = 127;

/// The battery.
pub struct Battery {
    /// The charge drawn since power-on, in units of 10 mA for a tick. Never negative.
    charge: i32,
    /// Tick of the last measurement.
    measured: u8,
}

impl Battery {
    /// A full battery.
    pub const fn new() -> Self {
        Self { charge: 0, measured: 0 }
    }

    /// Adds the charge since the last measurement, less than four seconds ago: the mean current
    /// since then is `centiamperes`, in 10 mA, and negative while charging.
    pub fn add(&mut self, centiamperes: i16, now_ms: u16) {
        let now = (now_ms / TICK_MS) as u8;
        let ticks = now.wrapping_sub(self.measured);
        self.measured = now;
        let charge = self.charge.wrapping_add(i32::from(centiamperes) * i32::from(ticks));
        if charge >= 0 {
            self.charge = charge;
        } else if centiamperes < 0 {
            // A battery that is full takes no more. (Nor does it give more than fits in 31 bits.)
            self.charge = 0;
        }
    }

    /// The charge drawn since power-on, in mAh.
    fn used_mah(&self) -> u16 {
        scaled((self.charge >> 15) as u16, UPPER_TENTHS_UAH, 10_000)
    }

    /// Puts a BatteryInfo up to the percentages. `heat` is the temperature of the sensor, if there
    /// is one: in 64ths of a kelvin, and the error flags of a Temperature.
    pub fn put(
        &self,
        power: &Power,
        heat: Option<(u16, u8)>,
        parameters: &Parameters,
        mut put: impl FnMut(u16),
    ) {
        let mut flags = IN_USE;
        if power.flags() & OVERCURRENT != 0 {
            flags |= OVERLOAD;
        }
        let mut kelvin = float16::NAN;
        if parameters.is_on(Parameter::BattTemp)
            && let Some((kelvin_64ths, heat_flags)) = heat
        {
            kelvin = float16::from_fixed(kelvin_64ths, 6);
            flags |= heat_flags << HOT_AND_COLD;
        }
        put(kelvin);
        put(power.voltage());
        put(power.current());
        // The average power is not measured.
        put(float16::NAN);
        let capacity = parameters.get(Parameter::BattCapacity);
        let remaining = capacity.saturating_sub(self.used_mah());
        let mut charge_percent = UNKNOWN;
        if capacity == 0 {
            put(float16::NAN);
            put(float16::NAN);
        } else {
            put(power.energy(remaining));
            put(power.energy(capacity));
            // Halved, because the divisor has 15 bits.
            charge_percent = scaled(remaining >> 1, 100, capacity >> 1) as u8;
        }
        // Hours to full charge: 0 while not charging.
        put(0);
        // 11 bits of flags, then three percentages of 7 bits: health, charge, and its deviation.
        put(u16::from_le_bytes([flags, UNKNOWN >> 2]));
        put(u16::from_le_bytes([
            UNKNOWN << 6 | charge_percent >> 1,
            charge_percent << 7 | UNKNOWN,
        ]));
    }
}

#[cfg(test)]
mod tests;
