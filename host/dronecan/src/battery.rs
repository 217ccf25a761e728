//! Payload of a BatteryInfo.

use crate::text::flags;
use half::f16;
use std::fmt;

/// Bytes before the name of the model.
const FIXED_LEN: usize = 23;
/// A percentage that is not known.
pub const PERCENT_UNKNOWN: u8 = 127;
/// Kelvins at 0 degrees Celsius.
const ZERO_CELSIUS_K: f32 = 273.15;

/// equipment.power.BatteryInfo: kelvins f16 | volts f16 | amperes f16 | average watts f16 |
/// remaining watt-hours f16 | watt-hours of the full battery f16 | hours to full charge f16 | flags
/// u11, health u7, charge u7 and its deviation u7, in percent | battery u8 | model instance u32 |
/// name of the model.
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
    pub flags: u16,
    /// The percentages; [`PERCENT_UNKNOWN`] is one.
    pub health: u8,
    pub charge: u8,
    pub charge_deviation: u8,
    pub battery: u8,
    pub model_instance: u32,
    pub model: Vec<u8>,
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
    /// `None` unless the payload has the fixed fields and a name of at most 31 bytes.
    pub fn decode(payload: &[u8]) -> Option<BatteryInfo> {
        let (fixed, model) = payload.split_at_checked(FIXED_LEN)?;
        if model.len() > 31 {
            return None;
        }
        let number = |n: usize| f16::from_le_bytes([fixed[2 * n], fixed[2 * n + 1]]);
        // From the most significant bit on: the lower byte of the flags, their upper three bits,
        // and three times seven.
        let bits = u32::from_be_bytes([fixed[14], fixed[15], fixed[16], fixed[17]]);
        let percent = |shift: u32| (bits >> shift & 0x7F) as u8;
        Some(BatteryInfo {
            temperature: number(0),
            voltage: number(1),
            current: number(2),
            average_power: number(3),
            remaining_wh: number(4),
            full_wh: number(5),
            hours_to_full: number(6),
            flags: u16::from(fixed[14]) | ((bits >> 21 & 7) as u16) << 8,
            health: percent(14),
            charge: percent(7),
            charge_deviation: percent(0),
            battery: fixed[18],
            model_instance: u32::from_le_bytes([fixed[19], fixed[20], fixed[21], fixed[22]]),
            model: model.to_vec(),
        })
    }

    /// The payload.
    pub fn encode(&self) -> Vec<u8> {
        let numbers = [
            self.temperature,
            self.voltage,
            self.current,
            self.average_power,
            self.remaining_wh,
            self.full_wh,
            self.hours_to_full,
        ];
        let mut payload: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        let [low, high] = self.flags.to_le_bytes().map(u32::from);
        let percent = |percent: u8, shift: u32| u32::from(percent & 0x7F) << shift;
        let bits = low << 24
            | (high & 7) << 21
            | percent(self.health, 14)
            | percent(self.charge, 7)
            | percent(self.charge_deviation, 0);
        payload.extend(bits.to_be_bytes());
        payload.push(self.battery);
        payload.extend(self.model_instance.to_le_bytes());
        payload.extend(&self.model);
        payload
    }

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
