//! Faults that a user can cause: of the bus, of the MCP2515, of the wiring, of the autopilot.
//! [`inject`](super::inject) causes them.

use std::fmt;
use std::str::FromStr;

/// A fault. A lasting fault ([`Fault::lasts`]) begins and ends; any other happens once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fault {
    BitError,
    ErrorRate,
    LoseFrame,
    NoAck,
    StuckDominant,
    Babble,
    ChipReset,
    SpiNoise,
    ChipPower,
    Cable,
    Silence,
    Disarm,
    Reset,
    ErrorStorm,
    AckDestroyed,
    DestroyFrames,
    WrongRate,
    SameId,
    ChipGarbage,
    ChipRegister,
    ChipSleep,
    ChipHeld,
    MisoLow,
    MisoHigh,
    IntLow,
    IntHigh,
    SensorNoise,
    SensorShort,
    BrownOut,
    OtherDialect,
}

/// All faults that `--inject`, scripts and the live view know. The first nine have the digits 1 to
/// 9 in its list of faults; some of the others have a key of their own.
pub const ALL: [Fault; 30] = [
    Fault::BitError,
    Fault::ErrorRate,
    Fault::LoseFrame,
    Fault::NoAck,
    Fault::StuckDominant,
    Fault::Babble,
    Fault::ChipReset,
    Fault::SpiNoise,
    Fault::ChipPower,
    Fault::Cable,
    Fault::Silence,
    Fault::Disarm,
    Fault::Reset,
    Fault::ErrorStorm,
    Fault::AckDestroyed,
    Fault::DestroyFrames,
    Fault::WrongRate,
    Fault::SameId,
    Fault::ChipGarbage,
    Fault::ChipRegister,
    Fault::ChipSleep,
    Fault::ChipHeld,
    Fault::MisoLow,
    Fault::MisoHigh,
    Fault::IntLow,
    Fault::IntHigh,
    Fault::SensorNoise,
    Fault::SensorShort,
    Fault::BrownOut,
    Fault::OtherDialect,
];

impl Fault {
    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Fault::BitError => "bit-error",
            Fault::ErrorRate => "error-rate",
            Fault::LoseFrame => "lose-frame",
            Fault::NoAck => "no-ack",
            Fault::StuckDominant => "stuck-dominant",
            Fault::Babble => "babble",
            Fault::ChipReset => "chip-reset",
            Fault::SpiNoise => "spi-noise",
            Fault::ChipPower => "chip-power",
            Fault::Cable => "cable",
            Fault::Silence => "silence",
            Fault::Disarm => "disarm",
            Fault::Reset => "reset",
            Fault::ErrorStorm => "error-storm",
            Fault::AckDestroyed => "ack-destroyed",
            Fault::DestroyFrames => "destroy-frames",
            Fault::WrongRate => "wrong-rate",
            Fault::SameId => "same-id",
            Fault::ChipGarbage => "chip-garbage",
            Fault::ChipRegister => "chip-register",
            Fault::ChipSleep => "chip-sleep",
            Fault::ChipHeld => "chip-held",
            Fault::MisoLow => "miso-low",
            Fault::MisoHigh => "miso-high",
            Fault::IntLow => "int-low",
            Fault::IntHigh => "int-high",
            Fault::SensorNoise => "sensor-noise",
            Fault::SensorShort => "sensor-short",
            Fault::BrownOut => "brown-out",
            Fault::OtherDialect => "other-dialect",
        }
    }

    /// One line of explanation.
    pub fn explanation(self) -> &'static str {
        match self {
            Fault::BitError => "one bit of the next frame is inverted",
            Fault::ErrorRate => "1 bit in 5,000 is inverted (on/off)",
            Fault::LoseFrame => "the node does not receive the next frame",
            Fault::NoAck => "no station acknowledges, as in listen-only mode (on/off)",
            Fault::StuckDominant => "the bus is shorted to dominant (on/off)",
            Fault::Babble => "another node floods the bus (on/off)",
            Fault::ChipReset => "the MCP2515 loses all its settings",
            Fault::SpiNoise => "1 bit in 10,000 on the SPI is inverted (on/off)",
            Fault::ChipPower => "the MCP2515 has no power (on/off)",
            Fault::Cable => "the node's bus cable is pulled (on/off)",
            Fault::Silence => "the autopilot sends nothing (on/off)",
            Fault::Disarm => {
                "the vehicle is disarmed or armed, if the autopilot sends ArmingStatus (on/off)"
            }
            Fault::Reset => "the board's reset button is pressed",
            Fault::ErrorStorm => "noise on the bus: 1 bit in 100 is inverted (on/off)",
            Fault::AckDestroyed => {
                "every ACK is destroyed, so that receivers destroy the frame (on/off)"
            }
            Fault::DestroyFrames => "every frame is destroyed, so that senders go bus-off (on/off)",
            Fault::WrongRate => "another node sends at half the bit rate (on/off)",
            Fault::SameId => "another node sends one NodeStatus with the node's ID",
            Fault::ChipGarbage => "the MCP2515's supply dips: all its registers get random values",
            Fault::ChipRegister => "one bit of CNF2 of the MCP2515 flips",
            Fault::ChipSleep => "the MCP2515 goes to sleep mode",
            Fault::ChipHeld => "the MCP2515 stays in configuration mode (on/off)",
            Fault::MisoLow => "the SPI reads all zeros (on/off)",
            Fault::MisoHigh => "the SPI reads all ones (on/off)",
            Fault::IntLow => "the INT line is shorted to ground (on/off)",
            Fault::IntHigh => "the INT line is shorted to the supply (on/off)",
            Fault::SensorNoise => "the sensor's voltage has noise of 100 mV (on/off)",
            Fault::SensorShort => "the sensor is shorted to ground (on/off)",
            Fault::BrownOut => "the processor's supply dips",
            Fault::OtherDialect => {
                "an autopilot of the other dialect, v0 or the draft of 2014, replaces the first one"
            }
        }
    }

    /// True if the fault changes the state of the MCP2515 behind the driver's back, or the data on
    /// the SPI. The driver can then send wrong commands without a mistake of its own.
    pub fn disturbs_chip(self) -> bool {
        matches!(
            self,
            Fault::SpiNoise
                | Fault::ChipGarbage
                | Fault::ChipRegister
                | Fault::ChipSleep
                | Fault::ChipHeld
                | Fault::MisoLow
                | Fault::MisoHigh
                | Fault::IntLow
                | Fault::IntHigh
        )
    }

    /// True if the fault lasts until it is ended. False if it happens once.
    pub fn lasts(self) -> bool {
        !matches!(
            self,
            Fault::BitError
                | Fault::LoseFrame
                | Fault::ChipReset
                | Fault::Reset
                | Fault::SameId
                | Fault::ChipGarbage
                | Fault::ChipRegister
                | Fault::ChipSleep
                | Fault::BrownOut
                | Fault::OtherDialect
        )
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Fault {
    type Err = String;

    fn from_str(text: &str) -> Result<Fault, String> {
        ALL.into_iter().find(|f| f.name() == text).ok_or_else(|| {
            let names: Vec<_> = ALL.iter().map(|f| f.name()).collect();
            format!("no fault is called \"{text}\": use {}", names.join(", "))
        })
    }
}

/// Names and explanations of all faults, for `--help`.
pub fn table() -> String {
    ALL.iter().map(|fault| format!("  {fault:15}{}\n", fault.explanation())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_can_be_parsed_from_its_name() {
        for fault in ALL {
            assert_eq!(fault.name().parse(), Ok(fault));
        }
    }
}
