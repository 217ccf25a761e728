//! Converts IEEE 754 half-precision numbers to and from fixed point, without floating point.
//!
//! ```text
//! sign[15] exponent[14:10] fraction[9:0];
//! value = (1024 + fraction) * 2^(exponent - 25), subnormal below exponent 1
//! ```

/// The sign bit.
pub const SIGN: u16 = 0x8000;

/// A quiet NaN. In a message it means that the value is not known.
pub const NAN: u16 = 0x7E00;

/// False if the number is infinite or a NaN.
pub fn is_finite(bits: u16) -> bool {
    (bits >> 8) as u8 & 0x7C != 0x7C
}

/// Converts a finite number to fixed point with `fraction_bits` binary places (at most 14). Rounds
/// to nearest, halves away from zero, and limits the result to +-32,767.
#[inline(never)]
pub fn to_fixed(bits: u16, fraction_bits: u8) -> i16 {
    let mut exponent = (bits >> 8) as u8 >> 2 & 31;
    let mut magnitude = bits & 0x3FF;
    if exponent != 0 {
        magnitude |= 0x400;
    } else {
        exponent = 1;
    }
    // 25 plus the left shift from the integer mantissa to the fixed point.
    let up = exponent.wrapping_add(fraction_bits);
    if up > 25 + 4 {
        magnitude = i16::MAX as u16;
    } else if up >= 25 {
        magnitude = magnitude.wrapping_shl(u32::from(up.wrapping_sub(25)));
    } else {
        // The magnitude has 11 bits, so a shift by 11 or more leaves nothing.
        magnitude = magnitude.wrapping_shr(u32::from(24u8.wrapping_sub(up).min(11)));
        magnitude = magnitude.wrapping_add(1) >> 1;
    }
    let magnitude = magnitude as i16;
    if bits & SIGN != 0 { -magnitude } else { magnitude }
}

/// Converts `value`, fixed point with `fraction_bits` binary places (at most 14), to the nearest
/// half-precision number, ties to even.
#[inline(never)]
pub fn from_fixed(value: u16, fraction_bits: u8) -> u16 {
    if value == 0 {
        return 0;
    }
    // Normalises the mantissa so that its leading one is bit 15, which has the value 2^(15 -
    // fraction_bits).
    let mut mantissa = value;
    let mut exponent = 15 + 15 - fraction_bits;
    while mantissa & 0x8000 == 0 {
        mantissa <<= 1;
        exponent -= 1;
    }
    let rounding = mantissa & 0x1F;
    let mut bits = u16::from(exponent) << 10 | (mantissa >> 5 & 0x3FF);
    // Rounding up may carry into the exponent. The result is then right, too.
    if rounding > 0x10 || rounding == 0x10 && bits & 1 == 1 {
        bits += 1;
    }
    bits
}

/// Converts a whole number to an IEEE 754 single. Returns its upper and its lower half.
pub fn to_float32(number: u16) -> [u16; 2] {
    if number == 0 {
        return [0; 2];
    }
    let mut mantissa = number;
    let mut exponent = 127 + 15u8;
    while mantissa & 0x8000 == 0 {
        mantissa <<= 1;
        exponent -= 1;
    }
    // The format does not store the leading one.
    let [low, high] = mantissa.to_le_bytes();
    [u16::from(exponent) << 7 | u16::from(high & 0x7F), u16::from(low) << 8]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn to_float32_is_exact_for_every_number() {
        for number in 0..=u16::MAX {
            let bits = f32::from(number).to_bits();
            assert_eq!(to_float32(number), [(bits >> 16) as u16, bits as u16], "{number}");
        }
    }

    /// The value of the number, by the definition of the format.
    fn value_of(bits: u16) -> f64 {
        let magnitude = match (bits >> 10 & 31, f64::from(bits & 0x3FF)) {
            (0, fraction) => fraction * 2f64.powi(-24),
            (exponent, fraction) => (1024.0 + fraction) * 2f64.powi(i32::from(exponent) - 25),
        };
        if bits & SIGN != 0 { -magnitude } else { magnitude }
    }

    #[test]
    fn every_number_is_converted_to_the_nearest_fixed_point() {
        for fraction_bits in [0, 1, 12, 14] {
            for bits in 0..=u16::MAX {
                assert_eq!(is_finite(bits), bits >> 10 & 31 != 31);
                if !is_finite(bits) {
                    continue;
                }
                let exact = value_of(bits) * f64::from(1u32 << fraction_bits);
                let expected = exact.round().clamp(-32_767.0, 32_767.0) as i16;
                assert_eq!(
                    to_fixed(bits, fraction_bits),
                    expected,
                    "{bits:04X} with {fraction_bits} places"
                );
            }
        }
    }

    #[test]
    fn every_fixed_point_is_converted_to_the_nearest_number() {
        for fraction_bits in [0, 6, 14] {
            for value in 0..=u16::MAX {
                let bits = from_fixed(value, fraction_bits);
                if bits >= 0x7C00 {
                    assert!(fraction_bits == 0 && value >= 65520, "{value} overflows");
                    continue;
                }
                let exact = f64::from(value) / f64::from(1u32 << fraction_bits);
                let error = (value_of(bits) - exact).abs();
                for neighbour in [bits.saturating_sub(1), bits + 1] {
                    if neighbour < 0x7C00 {
                        assert!(
                            error <= (value_of(neighbour) - exact).abs(),
                            "{value} with {fraction_bits} places"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn a_number_half_way_between_two_becomes_the_even_one() {
        // From 32768 on, half-precision numbers are 32 apart.
        for (value, bits) in [
            (32_768 + 15, 0x7800),
            (32_768 + 16, 0x7800),
            (32_768 + 17, 0x7801),
            (32_768 + 48, 0x7802),
        ] {
            assert_eq!(from_fixed(value, 0), bits, "{value}");
        }
    }

    #[test]
    fn golden_temperature_is_encoded_as_pydronecan_does() {
        // 298.15 K
        assert_eq!(from_fixed((298.15 * 64.0) as u16, 6), 0x5CA9);
    }
}
