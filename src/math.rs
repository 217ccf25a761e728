//! Integer arithmetic that several modules need.

/// `value` x `factor` / `divisor`, rounded, and limited to 16 bits; 0 for a divisor of 0. The
/// divisor is at most 32,767.
///
/// Divides bit by bit. Divisor and quotient have only 16 bits, so it takes half as long as a
/// division of 32 bits.
#[inline(never)]
pub fn scaled(value: u16, factor: u16, divisor: u16) -> u16 {
    if divisor == 0 {
        return 0;
    }
    let dividend = u32::from(value) * u32::from(factor) + u32::from(divisor >> 1);
    if (dividend >> 16) as u16 >= divisor {
        return u16::MAX;
    }
    divided(dividend, divisor) as u16
}

/// `dividend` / `divisor`, rounded down, and above it in the upper 16 bits the rest. The divisor is
/// at most 32,767, and more than the upper half of the dividend.
#[inline(never)]
pub fn divided(dividend: u32, divisor: u16) -> u32 {
    // The upper half is the rest. The lower half shifts the dividend out and the quotient in.
    let mut rest_and_quotient = dividend;
    for _ in 0..16u8 {
        rest_and_quotient <<= 1;
        if (rest_and_quotient >> 16) as u16 >= divisor {
            rest_and_quotient -= u32::from(divisor) << 16;
            rest_and_quotient |= 1;
        }
    }
    rest_and_quotient
}
