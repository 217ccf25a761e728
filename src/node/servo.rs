//! From commands to the width of the servo pulse.

use crate::dronecan::array_command::Value;

/// Width of a pulse in ticks of half a microsecond: the unit of the timer that makes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Ticks(pub u16);

impl Ticks {
    const fn from_us(us: u16) -> Self {
        Self(2 * us)
    }
}

/// Travel of the servo. The limits are those between which ArduPilot maps its unitless commands.
const MIN: Ticks = Ticks::from_us(1000);
const TRIM: Ticks = Ticks::from_us(1500);
const MAX: Ticks = Ticks::from_us(2000);

/// One, as a unitless value with 14 binary places.
const UNITLESS_ONE: i32 = 1 << 14;

/// Half the travel of a common servo, 45 degrees, in radians with 12 binary places.
const HALF_TRAVEL: i32 = 3217;

/// Ticks a unit of a position, with 16 binary places, rounded.
const fn scale(side: i32, one: i32) -> i32 {
    ((side << 16) + one / 2) / one
}

/// The position limited and scaled from `-one..=one` to the travel around the trim.
fn from_trim<const ONE: i32>(value: i32) -> Ticks {
    let value = value.clamp(-ONE, ONE);
    let scale = if value < 0 {
        const { scale((TRIM.0 - MIN.0) as i32, ONE) }
    } else {
        const { scale((MAX.0 - TRIM.0) as i32, ONE) }
    };
    // A position of one times its scale is the side with 16 binary places: 26 bits, so the product cannot overflow.
    let offset = (value.wrapping_mul(scale) + (1 << 15)) >> 16;
    Ticks((i32::from(TRIM.0) + offset) as u16)
}

/// The pulse for a command; `None` if it asks for none, with a width of zero or less.
///
/// Whatever asks for more than the travel gets the end of it.
pub fn pulse(value: Value) -> Option<Ticks> {
    match value {
        Value::Unitless(value) => Some(from_trim::<UNITLESS_ONE>(value)),
        Value::Position(value) => Some(from_trim::<HALF_TRAVEL>(value)),
        Value::Pwm(half_us) => (half_us > 0).then(|| Ticks(half_us.clamp(i32::from(MIN.0), i32::from(MAX.0)) as u16)),
    }
}

/// The pulse for a position of the thesis's command: 0 to 255 over the full travel.
pub fn pulse_of_byte(position: u8) -> Ticks {
    const TRAVEL: u32 = (MAX.0 - MIN.0) as u32;
    // TRAVEL / 255 with 16 binary places, rounded; exact to a tick for all 256 positions (see the test).
    const FACTOR: u32 = ((TRAVEL << 16) + 127) / 255;
    // At most 255 x FACTOR, 28 bits.
    Ticks(MIN.0 + ((u32::from(position).wrapping_mul(FACTOR) + (1 << 15)) >> 16) as u16)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn us(us: f64) -> Option<Ticks> {
        Some(Ticks((us * 2.0).round() as u16))
    }

    #[test]
    fn unitless_goes_from_end_to_end_through_the_trim() {
        for value in -UNITLESS_ONE..=UNITLESS_ONE {
            let exact = 1500.0 + 500.0 * f64::from(value) / f64::from(UNITLESS_ONE);
            let pulse = pulse(Value::Unitless(value)).unwrap();
            assert!((f64::from(pulse.0) / 2.0 - exact).abs() <= 0.26, "{value}: {pulse:?}, exactly {exact} us");
        }
        assert_eq!(pulse(Value::Unitless(-UNITLESS_ONE)), us(1000.0));
        assert_eq!(pulse(Value::Unitless(0)), us(1500.0));
        assert_eq!(pulse(Value::Unitless(UNITLESS_ONE)), us(2000.0));
    }

    #[test]
    fn a_position_of_45_degrees_is_the_end_of_the_travel() {
        assert_eq!(pulse(Value::Position(HALF_TRAVEL)), us(2000.0));
        assert_eq!(pulse(Value::Position(-HALF_TRAVEL)), us(1000.0));
        assert_eq!(pulse(Value::Position(0)), us(1500.0));
        let eighth = (core::f64::consts::FRAC_PI_8 * 4096.0).round() as i32;
        assert!(pulse(Value::Position(eighth)).unwrap().0.abs_diff(3500) <= 1);
    }

    #[test]
    fn a_pulse_width_is_taken_as_it_is_to_half_a_microsecond() {
        for half_us in i32::from(MIN.0)..=i32::from(MAX.0) {
            assert_eq!(pulse(Value::Pwm(half_us)), Some(Ticks(half_us as u16)));
        }
    }

    #[test]
    fn nothing_goes_beyond_the_travel() {
        for (low, high) in [
            (Value::Unitless(-UNITLESS_ONE - 1), Value::Unitless(UNITLESS_ONE + 1)),
            (Value::Unitless(i32::MIN), Value::Unitless(i32::MAX)),
            (Value::Position(i32::MIN), Value::Position(i32::MAX)),
            (Value::Pwm(1), Value::Pwm(i32::MAX)),
        ] {
            assert_eq!((pulse(low), pulse(high)), (Some(MIN), Some(MAX)));
        }
    }

    #[test]
    fn a_pulse_of_no_width_is_no_position() {
        assert_eq!(pulse(Value::Pwm(0)), None);
        assert_eq!(pulse(Value::Pwm(-3000)), None);
    }

    #[test]
    fn the_byte_of_the_thesis_covers_the_travel_exactly() {
        for position in 0..=255 {
            let exact = 1000.0 + 1000.0 * f64::from(position) / 255.0;
            assert_eq!(Some(pulse_of_byte(position)), us(exact), "{position}");
        }
    }
}
