//! The bit timing for CAN_BAUDRATE.

use mcp2515_ordered::BitTiming;

/// Timing for `rate` units of 125 kbit/s from a crystal of `F_OSC_HZ`: that for 8, 4, 2 or 1, the highest that is not above. The sample
/// point is in the range of DroneCAN's specification, chapter 8, or this does not compile.
pub fn timing<const F_OSC_HZ: u32>(rate: u8) -> BitTiming {
    // Comparing one register at a time and with `>=` keeps the compiler from making tables, which are in RAM.
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

/// A timing whose sample point is not before `earliest_permille`, nor after 90 %.
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
