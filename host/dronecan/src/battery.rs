//! Payload of a BatteryInfo.

use crate::fields::payload;
use crate::text::flags;
use half::f16;
use std::fmt;

/// A percentage that is not known.
pub const PERCENT_UNKNOWN: u8 = 127;
/// Kelvins at 0 degrees Celsius.
const ZERO_CELSIUS_K: f32 = 273.15;

payload! {
    /// equipment.power.BatteryInfo, in kelvins, volts, amperes, watts, hours and percent.
    #[derive(Clone, Debug, PartialEq)]
    pub struct BatteryInfo {
        pub temperature: f16,
        pub voltage: f16,
        pub current: f16,
        pub average_power: f16,
        pub remaining_wh: f16,
        pub full_wh: f16,
        pub hours_to_full: f16,
        /// Status flags, including unknown ones.
        pub flags: u16 as 11,
        /// The percentages; [`PERCENT_UNKNOWN`] is one.
        pub health: u8 as 7,
        pub charge: u8 as 7,
        pub charge_deviation: u8 as 7,
        pub battery: u8,
        pub model_instance: u32,
        pub model: Vec<u8> as 31,
    }
}

/// Names of the status flags, from bit 0 on. IN_USE, the first, is the usual state.
const FLAGS: [&str; 9] = [
    "IN_USE",
    "CHARGING",
    "CHARGED",
    "TEMP_HOT",
    "TEMP_COLD",
    "OVERLOAD",
    "BAD_BATTERY",
    "NEED_SERVICE",
    "BMS_ERROR",
];

impl BatteryInfo {
    /// The flags besides IN_USE as text, with a space before each. Unknown flags are a number.
    pub fn flags_text(&self) -> String {
        flags(self.flags & !1, &FLAGS, 5)
    }

    /// Charge, energy and temperature as text, each with a space before it. What is not known is
    /// left out.
    pub fn charge_text(&self) -> String {
        let mut text = String::new();
        if self.charge != PERCENT_UNKNOWN {
            text += &format!(" {} %", self.charge);
        }
        if !self.remaining_wh.is_nan() {
            text += &format!(" {:.1} Wh", self.remaining_wh.to_f32());
        }
        if !self.temperature.is_nan() {
            text += &format!(" {:.1} C", self.temperature.to_f32() - ZERO_CELSIUS_K);
        }
        text
    }
}

impl fmt::Display for BatteryInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "battery {}", self.battery)?;
        for (value, unit) in [(self.voltage, "V"), (self.current, "A")] {
            if !value.is_nan() {
                write!(f, " {:.2} {unit}", value.to_f32())?;
            }
        }
        write!(f, "{}{}", self.charge_text(), self.flags_text())
    }
}
