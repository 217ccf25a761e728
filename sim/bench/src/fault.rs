//! Faults that a user can cause: of the bus, of the MCP2515, of the wiring, of the autopilot.
//! [`inject`](super::inject) causes them.

use std::fmt;
use std::str::FromStr;

/// The faults: whether it lasts, its name on the command line, and one line of explanation.
macro_rules! faults {
    (@lasts once) => { false };
    (@lasts lasting) => { true };
    ($($fault:ident $kind:ident $name:literal $explanation:literal;)*) => {
        /// A fault. A lasting fault ([`Fault::lasts`]) begins and ends; any other happens once.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub enum Fault {
            $($fault),*
        }

        /// All faults that `--inject`, scripts and the live view know. The first nine have the
        /// digits 1 to 9 in its list of faults; some of the others have a key of their own.
        pub const ALL: [Fault; [$($name),*].len()] = [$(Fault::$fault),*];

        impl Fault {
            /// Name on the command line.
            pub fn name(self) -> &'static str {
                match self {
                    $(Fault::$fault => $name),*
                }
            }

            /// One line of explanation.
            pub fn explanation(self) -> &'static str {
                match self {
                    $(Fault::$fault => $explanation),*
                }
            }

            /// True if the fault lasts until it is ended. False if it happens once.
            pub fn lasts(self) -> bool {
                match self {
                    $(Fault::$fault => faults!(@lasts $kind)),*
                }
            }
        }
    };
}

faults! {
    BitError once "bit-error" "one bit of the next frame is inverted";
    ErrorRate lasting "error-rate" "1 bit in 5,000 is inverted (on/off)";
    LoseFrame once "lose-frame" "the node does not receive the next frame";
    NoAck lasting "no-ack" "no station acknowledges, as in listen-only mode (on/off)";
    StuckDominant lasting "stuck-dominant" "the bus is shorted to dominant (on/off)";
    Babble lasting "babble" "another node floods the bus (on/off)";
    ChipReset once "chip-reset" "the MCP2515 loses all its settings";
    SpiNoise lasting "spi-noise" "1 bit in 10,000 on the SPI is inverted (on/off)";
    ChipPower lasting "chip-power" "the MCP2515 has no power (on/off)";
    Cable lasting "cable" "the node's bus cable is pulled (on/off)";
    Silence lasting "silence" "the autopilot sends nothing (on/off)";
    Disarm lasting "disarm"
        "the vehicle is disarmed or armed, if the autopilot sends ArmingStatus (on/off)";
    Reset once "reset" "the board's reset button is pressed";
    ErrorStorm lasting "error-storm" "noise on the bus: 1 bit in 100 is inverted (on/off)";
    AckDestroyed lasting "ack-destroyed"
        "every ACK is destroyed, so that receivers destroy the frame (on/off)";
    DestroyFrames lasting "destroy-frames"
        "every frame is destroyed, so that senders go bus-off (on/off)";
    WrongRate lasting "wrong-rate" "another node sends at half the bit rate (on/off)";
    SameId once "same-id" "another node sends one NodeStatus with the node's ID";
    ChipGarbage once "chip-garbage"
        "the MCP2515's supply dips: all its registers get random values";
    ChipRegister once "chip-register" "one bit of CNF2 of the MCP2515 flips";
    ChipSleep once "chip-sleep" "the MCP2515 goes to sleep mode";
    ChipHeld lasting "chip-held" "the MCP2515 stays in configuration mode (on/off)";
    MisoLow lasting "miso-low" "the SPI reads all zeros (on/off)";
    MisoHigh lasting "miso-high" "the SPI reads all ones (on/off)";
    IntLow lasting "int-low" "the INT line is shorted to ground (on/off)";
    IntHigh lasting "int-high" "the INT line is shorted to the supply (on/off)";
    SensorNoise lasting "sensor-noise" "the sensor's voltage has noise of 100 mV (on/off)";
    SensorShort lasting "sensor-short" "the sensor is shorted to ground (on/off)";
    BrownOut once "brown-out" "the processor's supply dips";
    OtherDialect once "other-dialect"
        "an autopilot of the other dialect, v0 or the draft of 2014, replaces the first one";
}

impl Fault {
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
