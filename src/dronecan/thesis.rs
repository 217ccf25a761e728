//! The messages of the 2015 thesis, one byte each (dsdl/thesis).

use super::Malformed;

/// Data type ID of `thesis.ServoCommand`: 0 to 255 over the full travel of the servo.
pub const SERVO_COMMAND_ID: u16 = 1111;

/// Data type ID of `thesis.DegreesCelsius`: 0 to 255, limited at both ends.
pub const DEGREES_CELSIUS_ID: u16 = 1112;

/// The position in a ServoCommand.
///
/// # Errors
///
/// If the payload is not one byte.
pub fn servo_command(payload: &[u8]) -> Result<u8, Malformed> {
    match payload {
        &[position] => Ok(position),
        _ => Err(Malformed),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_exactly_one_byte() {
        assert_eq!(servo_command(&[90]), Ok(90));
        assert_eq!(servo_command(&[]), Err(Malformed));
        assert_eq!(servo_command(&[90, 90]), Err(Malformed));
    }
}
