//! What a user applies to the pins of a circuit: levels and voltages.

use crate::board::Board;
use crate::wiring::{Pin, Wiring};
use std::str::FromStr;

/// Supply of the AVR in millivolts. Half of it reads as high at a digital input.
const SUPPLY_MV: u32 = 5000;

/// What is applied to a pin from outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Applied {
    Low,
    High,
    /// Nothing: the pin has the level of its pull-up, or low.
    Open,
    Millivolts(u32),
}

/// A pin and what is applied to it, such as "D7=low" or "A1=2.5V".
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setting {
    pub pin: Pin,
    pub applied: Applied,
}

impl FromStr for Setting {
    type Err = String;

    fn from_str(text: &str) -> Result<Setting, String> {
        let (pin, level) = text
            .split_once('=')
            .ok_or_else(|| format!("\"{text}\": write for example D7=low or A1=2.5V"))?;
        Setting::parse(pin, level)
    }
}

impl Setting {
    /// Reads the two words of a setting.
    ///
    /// # Errors
    /// If there is no such pin or level; the text says which there are.
    pub fn parse(pin: &str, level: &str) -> Result<Setting, String> {
        let pin: Pin = pin.parse()?;
        let applied = match level {
            "low" => Applied::Low,
            "high" => Applied::High,
            "open" => Applied::Open,
            _ => Applied::Millivolts(millivolts(level)?),
        };
        if matches!(applied, Applied::Millivolts(_)) && pin.adc_channel().is_none() {
            return Err(format!("{pin} is digital: use low, high or open, or a pin A0 to A5"));
        }
        Ok(Setting { pin, applied })
    }

    /// Checks that the bench itself does not drive the pin.
    ///
    /// # Errors
    /// If it does; the text says for what.
    pub fn check(self, wiring: &Wiring) -> anyhow::Result<()> {
        let spi = ["D11", "D12", "D13"].iter().any(|name| name.parse() == Ok(self.pin));
        let user = match self.pin {
            pin if pin == wiring.int => Some("INT of the MCP2515"),
            pin if pin == wiring.cs => Some("CS of the MCP2515"),
            _ if spi => Some("the SPI of the MCP2515"),
            _ => None,
        };
        match user {
            Some(user) => anyhow::bail!("--set: {} is {user}", self.pin),
            None => Ok(()),
        }
    }

    /// Applies it to the pin of a board.
    pub fn apply(self, board: &mut Board) {
        let (port, bit) = (self.pin.port(), self.pin.bit());
        let mv = match self.applied {
            Applied::Low => 0,
            Applied::High => SUPPLY_MV,
            Applied::Open => return board.avr_mut().release_pin(port, bit),
            Applied::Millivolts(mv) => mv,
        };
        board.avr_mut().drive_pin(port, bit, mv >= SUPPLY_MV / 2);
        if let Some(channel) = self.pin.adc_channel() {
            board.avr_mut().set_analog_uv(channel, mv * 1000);
        }
    }
}

/// Reads a voltage: 2.5V or 2500mV.
fn millivolts(text: &str) -> Result<u32, String> {
    let volts = match (text.strip_suffix("mV"), text.strip_suffix('V')) {
        (Some(number), _) => number.parse::<f64>().map(|mv| mv / 1000.0).ok(),
        (None, Some(number)) => number.parse::<f64>().ok(),
        (None, None) => None,
    };
    volts
        .filter(|volts| (0.0..=f64::from(SUPPLY_MV) / 1000.0).contains(volts))
        .map(|volts| (volts * 1000.0).round() as u32)
        .ok_or_else(|| format!("\"{text}\": use low, high, open, or a voltage from 0V to 5V"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_setting_is_a_pin_and_a_level_or_a_voltage() {
        let applied = |text: &str| text.parse::<Setting>().map(|setting| setting.applied);
        assert_eq!(applied("D7=low"), Ok(Applied::Low));
        assert_eq!(applied("A0=high"), Ok(Applied::High));
        assert_eq!(applied("D13=open"), Ok(Applied::Open));
        assert_eq!(applied("A1=2.5V"), Ok(Applied::Millivolts(2500)));
        assert_eq!(applied("A1=330mV"), Ok(Applied::Millivolts(330)));
        for (wrong, advice) in [
            ("D7", "write for example D7=low"),
            ("D14=low", "use D0 to D13 or A0 to A5"),
            ("A1=2.5", "a voltage from 0V to 5V"),
            ("A1=6V", "a voltage from 0V to 5V"),
            ("D7=2.5V", "D7 is digital"),
        ] {
            let error = wrong.parse::<Setting>().unwrap_err();
            assert!(error.contains(advice), "{error}");
        }
        let wiring = Wiring::default();
        let of_the_chip = Setting { pin: wiring.int, applied: Applied::Low };
        assert!(of_the_chip.check(&wiring).unwrap_err().to_string().contains("INT of the MCP2515"));
    }
}
