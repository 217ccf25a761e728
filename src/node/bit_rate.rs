//! The bit timing for CAN_BAUDRATE.

use mcp2515_ordered::BitTiming;

/// The timing for `rate` units of 125 kbit/s and a crystal of `F_OSC_HZ`. A rate other than 8, 4, 2 or 1 gives the next lower one; 0 gives 1. The
/// code does not compile if a sample point is outside the range of DroneCAN's specification, chapter 8.
pub fn timing<const F_OSC_HZ: u32>(rate: u8) -> BitTiming {
    // The compiler would put a lookup table into RAM. Comparing with ranges, one register at a time, avoids that.
    let select = |[of_8, of_4, of_2, of_1]: [u8; 4]| match rate {
        8.. => of_8,
        4.. => of_4,
        2.. => of_2,
        _ => of_1,
    };
    let [a, b, c, d] = const {
        [
            checked(F_OSC_HZ, 1_000_000, 750),
            checked(F_OSC_HZ, 500_000, 850),
            checked(F_OSC_HZ, 250_000, 850),
            checked(F_OSC_HZ, 125_000, 850),
        ]
    };
    BitTiming::from_registers(
        select([a.cnf1(), b.cnf1(), c.cnf1(), d.cnf1()]),
        select([a.cnf2(), b.cnf2(), c.cnf2(), d.cnf2()]),
        select([a.cnf3(), b.cnf3(), c.cnf3(), d.cnf3()]),
    )
}

/// A timing. Panics if its sample point is before `earliest_permille` or after 90 %.
const fn checked(f_osc_hz: u32, bit_rate: u32, earliest_permille: u16) -> BitTiming {
    let timing = BitTiming::new(f_osc_hz, bit_rate);
    assert!(timing.sample_point_permille() >= earliest_permille && timing.sample_point_permille() <= 900);
    timing
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_between_two_is_the_lower_one() {
        for (rate, bit_rate) in
            [(0, 125), (1, 125), (2, 250), (3, 250), (4, 500), (7, 500), (8, 1000), (9, 1000), (255, 1000)]
        {
            assert_eq!(timing::<16_000_000>(rate), BitTiming::new(16_000_000, bit_rate * 1000), "{rate}");
        }
    }
}
