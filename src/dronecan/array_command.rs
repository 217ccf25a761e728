//! uavcan.equipment.actuator.ArrayCommand (DSDL 1010.ArrayCommand.uavcan): commands for up to 15 actuators.
//!
//! ```text
//! commands: n x { actuator_id[0]; command_type[1]; command_value[2..4] float16 LE }, no length prefix
//! ```
//!
//! One command fits in one frame.

use super::{Malformed, float16};

/// Data type ID.
pub const DATA_TYPE_ID: u16 = 1010;

/// Bytes of a command.
const COMMAND_LEN: usize = 4;

const COMMAND_TYPE_UNITLESS: u8 = 0;
const COMMAND_TYPE_POSITION: u8 = 1;
const COMMAND_TYPE_PWM: u8 = 4;

/// What an actuator is to do, in the sender's unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Value {
    /// -1 to 1, with 14 binary places.
    Unitless(i32),
    /// Radians, with 12 binary places.
    Position(i32),
    /// Width of the pulse, in half microseconds.
    Pwm(i32),
}

/// Why a command cannot be followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unusable {
    /// A force, a speed or a type that nobody has defined.
    Type,
    /// Infinite or not a number.
    NotFinite,
}

/// A command for one actuator, as it came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Command {
    /// Which actuator.
    pub actuator_id: u8,
    command_type: u8,
    command_value: u16,
}

impl Command {
    /// What the actuator is to do.
    ///
    /// # Errors
    ///
    /// If it cannot be followed.
    pub fn value(&self) -> Result<Value, Unusable> {
        let (value, fraction_bits): (fn(i32) -> Value, u8) = match self.command_type {
            COMMAND_TYPE_UNITLESS => (Value::Unitless, 14),
            COMMAND_TYPE_POSITION => (Value::Position, 12),
            COMMAND_TYPE_PWM => (Value::Pwm, 1),
            _ => return Err(Unusable::Type),
        };
        float16::to_fixed(self.command_value, fraction_bits).map(value).ok_or(Unusable::NotFinite)
    }
}

/// The commands in the payload of a transfer.
///
/// # Errors
///
/// If it does not consist of whole commands.
pub fn commands(payload: &[u8]) -> Result<impl Iterator<Item = Command> + '_, Malformed> {
    let (commands, []) = payload.as_chunks::<COMMAND_LEN>() else {
        return Err(Malformed);
    };
    Ok(commands.iter().map(|&[actuator_id, command_type, low, high]| Command {
        actuator_id,
        command_type,
        command_value: u16::from_le_bytes([low, high]),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(payload: &[u8]) -> Vec<(u8, Result<Value, Unusable>)> {
        commands(payload).unwrap().map(|command| (command.actuator_id, command.value())).collect()
    }

    #[test]
    fn golden_commands_are_read() {
        let half = (1, Ok(Value::Unitless(1 << 13)));
        let back = (2, Ok(Value::Unitless(-(1 << 14))));
        let pulse = (3, Ok(Value::Pwm(3000)));
        assert_eq!(parse(&[1, 0, 0x00, 0x38]), [half]);
        // The payload of the golden transfer of two frames, without its CRC.
        assert_eq!(parse(&[1, 0, 0x00, 0x38, 2, 0, 0x00, 0xBC, 3, 4, 0xDC, 0x65]), [half, back, pulse]);
    }

    #[test]
    fn no_command_at_all_is_a_message_like_any_other() {
        assert_eq!(parse(&[]), []);
    }

    #[test]
    fn force_speed_and_unknown_types_are_unusable() {
        for command_type in [2, 3, 5, 255] {
            assert_eq!(parse(&[1, command_type, 0, 0])[0].1, Err(Unusable::Type));
        }
    }

    #[test]
    fn infinities_and_nan_are_unusable() {
        for high in [0x7C, 0xFC, 0x7E, 0xFE] {
            for command_type in [0, 1, 4] {
                assert_eq!(parse(&[1, command_type, 0, high])[0].1, Err(Unusable::NotFinite));
            }
        }
    }

    #[test]
    fn a_broken_command_makes_the_message_malformed() {
        for len in [1, 2, 3, 5, 6, 7] {
            assert!(commands(&[0; 7][..len]).is_err(), "{len} bytes");
        }
    }
}
