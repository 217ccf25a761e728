//! Converts parameter values between DroneCAN and MAVLink.
//!
//! PARAM_VALUE and PARAM_SET have four bytes for the value and one byte for its type. There are two
//! encodings of integers; a ground station chooses by the autopilot. [`IntegerEncoding::Bytewise`]
//! has the integer's bytes (PX4, and components that are not an autopilot; exact).
//! [`IntegerEncoding::Cast`] has a float of the same value (ArduPilot; exact up to 2^24). Reals are
//! the same in both.
//!
//! | DroneCAN | MAVLink |
//! | --- | --- |
//! | integer | INT32 if value and limits fit, else UINT32 if they fit, else REAL32, rounded |
//! | real | REAL32 |
//! | boolean | UINT8, 0 or 1 |
//! | text, empty | not shown |
//!
//! Setting a rounded value to the number that was read changes nothing. Any other number is set.

use dronecan_host::{ParameterResponse, Value};
use mavlink::dialects::common::MavParamType;

/// The encoding of integers in the four bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IntegerEncoding {
    Bytewise,
    Cast,
}

/// A value that MAVLink can represent, with its MAVLink type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Number {
    Int32(i32),
    Uint32(u32),
    Boolean(bool),
    Real(f32),
    /// An integer that does not fit, sent rounded.
    Wide(i64),
}

impl Number {
    /// `None` if MAVLink cannot represent the parameter.
    pub fn of(parameter: &ParameterResponse) -> Option<Number> {
        let value = match parameter.value {
            Value::Integer(value) => value,
            Value::Real(value) => return Some(Number::Real(value)),
            Value::Boolean(value) => return Some(Number::Boolean(value)),
            Value::Text(_) | Value::Empty => return None,
        };
        let limits = [&parameter.min, &parameter.max].into_iter().filter_map(|limit| match limit {
            Value::Integer(limit) => Some(*limit),
            _ => None,
        });
        let all: Vec<i64> = limits.chain([value]).collect();
        let signed = i32::try_from(value).ok().map(Number::Int32);
        let unsigned = u32::try_from(value).ok().map(Number::Uint32);
        let is_signed = all.iter().all(|n| i32::try_from(*n).is_ok());
        let is_unsigned = !is_signed && all.iter().all(|n| u32::try_from(*n).is_ok());
        let narrow = if is_unsigned { unsigned.or(signed) } else { signed.or(unsigned) };
        narrow.or(Some(Number::Wide(value)))
    }

    /// The MAVLink type.
    pub fn kind(self) -> MavParamType {
        match self {
            Number::Int32(_) => MavParamType::MAV_PARAM_TYPE_INT32,
            Number::Uint32(_) => MavParamType::MAV_PARAM_TYPE_UINT32,
            Number::Boolean(_) => MavParamType::MAV_PARAM_TYPE_UINT8,
            Number::Real(_) | Number::Wide(_) => MavParamType::MAV_PARAM_TYPE_REAL32,
        }
    }

    /// The four bytes, as the float that the crate expects.
    pub fn encode(self, encoding: IntegerEncoding) -> f32 {
        match (self, encoding) {
            (Number::Real(value), _) => value,
            (Number::Wide(value), _) => value as f32,
            (Number::Int32(value), IntegerEncoding::Cast) => value as f32,
            (Number::Uint32(value), IntegerEncoding::Cast) => value as f32,
            (Number::Boolean(value), IntegerEncoding::Cast) => f32::from(u8::from(value)),
            (Number::Int32(value), IntegerEncoding::Bytewise) => f32::from_bits(value as u32),
            (Number::Uint32(value), IntegerEncoding::Bytewise) => f32::from_bits(value),
            (Number::Boolean(value), IntegerEncoding::Bytewise) => f32::from_bits(u32::from(value)),
        }
    }
}

/// Why a PARAM_SET is rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unfit {
    /// The type does not fit in four bytes, or does not exist.
    Kind,
    /// Not a value of the parameter's type, such as 0.5 for an integer.
    Value,
}

/// The number that a ground station sent.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Sent {
    Integer(i64),
    Real(f32),
}

/// Decodes the bytes of a PARAM_SET by its type.
fn read(kind: u8, value: f32) -> Result<Sent, Unfit> {
    let [b0, b1, b2, b3] = value.to_le_bytes();
    Ok(match kind {
        1 => Sent::Integer(b0.into()),
        2 => Sent::Integer((b0 as i8).into()),
        3 => Sent::Integer(u16::from_le_bytes([b0, b1]).into()),
        4 => Sent::Integer(i16::from_le_bytes([b0, b1]).into()),
        5 => Sent::Integer(u32::from_le_bytes([b0, b1, b2, b3]).into()),
        6 => Sent::Integer(i32::from_le_bytes([b0, b1, b2, b3]).into()),
        9 => Sent::Real(value),
        _ => return Err(Unfit::Kind),
    })
}

fn to_integer(value: f32) -> Option<i64> {
    // 2^63 itself does not fit.
    (value.fract() == 0.0 && (-(2f32.powi(63))..2f32.powi(63)).contains(&value))
        .then_some(value as i64)
}

/// The value for the node; `None` if the parameter must not change. `current` is the parameter in
/// the node's last answer.
///
/// # Errors
/// If the value or its type is invalid.
pub fn decode(
    kind: u8,
    value: f32,
    encoding: IntegerEncoding,
    current: &ParameterResponse,
) -> Result<Option<Value>, Unfit> {
    let sent = match (read(kind, value)?, encoding) {
        (Sent::Integer(_), IntegerEncoding::Cast) => Sent::Real(value),
        (sent, _) => sent,
    };
    match (&current.value, sent) {
        (Value::Integer(now), Sent::Real(value)) => {
            // A value that was rounded for the station must not be rounded in the node.
            if matches!(Number::of(current), Some(Number::Wide(_))) && value == *now as f32 {
                return Ok(None);
            }
            to_integer(value).map(|number| Some(Value::Integer(number))).ok_or(Unfit::Value)
        }
        (Value::Integer(_), Sent::Integer(number)) => {
            // Only a decoding with ArduPilot's encoding is within the limits.
            let cast = to_integer(value).filter(|cast| {
                !is_within_limits(current, number) && is_within_limits(current, *cast)
            });
            Ok(Some(Value::Integer(cast.unwrap_or(number))))
        }
        // NaN is no useful value, and some nodes would store it.
        (Value::Real(_), Sent::Real(value)) if value.is_nan() => Err(Unfit::Value),
        (Value::Real(_), Sent::Real(value)) => Ok(Some(Value::Real(value))),
        (Value::Real(_), Sent::Integer(number)) => {
            let real = number as f32;
            if real as i64 == number { Ok(Some(Value::Real(real))) } else { Err(Unfit::Value) }
        }
        (Value::Boolean(_), Sent::Integer(number @ (0 | 1))) => {
            Ok(Some(Value::Boolean(number == 1)))
        }
        (Value::Boolean(_), Sent::Real(value)) if value == 0.0 || value == 1.0 => {
            Ok(Some(Value::Boolean(value == 1.0)))
        }
        // A float 1.0 in the bytes of an integer.
        (Value::Boolean(_), Sent::Integer(_)) if value == 1.0 => Ok(Some(Value::Boolean(true))),
        (Value::Boolean(_), _) => Err(Unfit::Value),
        (Value::Text(_) | Value::Empty, _) => Err(Unfit::Kind),
    }
}

/// True if a number is within the parameter's limits, or there are no limits.
fn is_within_limits(parameter: &ParameterResponse, number: i64) -> bool {
    match (&parameter.min, &parameter.max) {
        (Value::Integer(min), Value::Integer(max)) => (*min..=*max).contains(&number),
        _ => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const INT32: u8 = 6;
    const REAL32: u8 = 9;

    fn parameter(value: Value, limits: Option<(i64, i64)>) -> ParameterResponse {
        let limit = |at: fn((i64, i64)) -> i64| {
            limits.map_or(Value::Empty, |limits| Value::Integer(at(limits)))
        };
        ParameterResponse {
            value,
            min: limit(|l| l.0),
            max: limit(|l| l.1),
            ..ParameterResponse::default()
        }
    }

    fn integer(value: i64) -> ParameterResponse {
        parameter(Value::Integer(value), None)
    }

    #[test]
    fn types_follow_value_and_limits() {
        let limited = |value, min, max| {
            Number::of(&parameter(Value::Integer(value), Some((min, max)))).unwrap()
        };
        assert_eq!(limited(5, 0, 10), Number::Int32(5));
        assert_eq!(limited(5, 0, 0xFFFF_FFFF), Number::Uint32(5));
        assert_eq!(limited(5, i64::MIN, i64::MAX), Number::Int32(5));
        assert_eq!(limited(1 << 40, 0, i64::MAX), Number::Wide(1 << 40));
        assert_eq!(Number::of(&parameter(Value::Boolean(true), None)), Some(Number::Boolean(true)));
        assert_eq!(Number::of(&parameter(Value::Real(0.5), None)), Some(Number::Real(0.5)));
        assert_eq!(Number::of(&parameter(Value::Text(b"x".to_vec()), None)), None);
    }

    #[test]
    fn writing_a_rounded_integer_back_does_not_change_it() {
        let wide = integer((1 << 40) + 1);
        let shown = Number::of(&wide).unwrap().encode(IntegerEncoding::Bytewise);
        assert_eq!(decode(REAL32, shown, IntegerEncoding::Bytewise, &wide), Ok(None));
        assert_eq!(
            decode(REAL32, 7.0, IntegerEncoding::Bytewise, &wide),
            Ok(Some(Value::Integer(7)))
        );
    }

    /// A station uses ArduPilot's encoding and the bridge the other. The parameter's limits show
    /// which encoding is meant.
    #[test]
    fn values_of_other_types_and_encodings_are_converted() {
        use IntegerEncoding::{Bytewise, Cast};
        let limited = parameter(Value::Integer(1000), Some((500, 2500)));
        let real = parameter(Value::Real(1.0), None);
        let boolean = parameter(Value::Boolean(false), None);
        let set = |value| Ok(Some(Value::Integer(value)));
        for (name, kind, value, encoding, current, expected) in [
            ("a real of an integer", REAL32, 1900.0, Bytewise, &limited, set(1900)),
            ("no integer", REAL32, 1900.5, Bytewise, &limited, Err(Unfit::Value)),
            ("NaN", REAL32, f32::NAN, Bytewise, &limited, Err(Unfit::Value)),
            ("infinity", REAL32, f32::INFINITY, Bytewise, &limited, Err(Unfit::Value)),
            ("INT16", 4, f32::from_bits(1900), Bytewise, &limited, set(1900)),
            ("REAL64", 10, 1900.0, Bytewise, &limited, Err(Unfit::Kind)),
            ("type 0", 0, 1900.0, Bytewise, &limited, Err(Unfit::Kind)),
            ("an integer", INT32, f32::from_bits(3), Bytewise, &real, Ok(Some(Value::Real(3.0)))),
            ("1 is true", REAL32, 1.0, Bytewise, &boolean, Ok(Some(Value::Boolean(true)))),
            ("2 is no boolean", INT32, f32::from_bits(2), Bytewise, &boolean, Err(Unfit::Value)),
            ("only cast in the limits", INT32, 1900.0, Bytewise, &limited, set(1900)),
            ("neither", INT32, f32::from_bits(3000), Bytewise, &limited, set(3000)),
            ("cast", INT32, 1900.0, Cast, &integer(0), set(1900)),
        ] {
            assert_eq!(decode(kind, value, encoding, current), expected, "{name}");
        }
    }

    proptest! {
        #[test]
        fn every_integer_of_32_bits_survives_a_round_trip(value: i32) {
            let current = integer(value.into());
            let sent = Number::of(&current).unwrap();
            prop_assert_eq!(sent.kind() as u8, INT32);
            let bytewise = IntegerEncoding::Bytewise;
            let back = decode(INT32, sent.encode(bytewise), bytewise, &current);
            prop_assert_eq!(back, Ok(Some(Value::Integer(value.into()))));
        }

        #[test]
        fn every_real_survives_a_round_trip(bits: u32) {
            let current = parameter(Value::Real(f32::from_bits(bits)), None);
            for encoding in [IntegerEncoding::Bytewise, IntegerEncoding::Cast] {
                let sent = Number::of(&current).unwrap().encode(encoding);
                if sent.is_nan() {
                    prop_assert_eq!(decode(REAL32, sent, encoding, &current), Err(Unfit::Value));
                    continue;
                }
                let decoded = decode(REAL32, sent, encoding, &current);
                let Ok(Some(Value::Real(back))) = decoded else { panic!("no real") };
                prop_assert_eq!(back.to_bits(), bits);
            }
        }

        #[test]
        fn a_cast_integer_up_to_2_to_24_survives_a_round_trip(value in -(1i64 << 24)..=1 << 24) {
            let current = integer(value);
            let sent = Number::of(&current).unwrap().encode(IntegerEncoding::Cast);
            let back = decode(INT32, sent, IntegerEncoding::Cast, &current);
            prop_assert_eq!(back, Ok(Some(Value::Integer(value))));
        }
    }
}
