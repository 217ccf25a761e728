//! The bit timing for CAN_BAUDRATE.

#[cfg_attr(not(feature = "any-rate"), path = "bit_rate/absent/search.rs")]
mod search;

use mcp2515_ordered::BitTiming;

use crate::hardware::CAN_CRYSTAL_HZ;
pub use search::{LOWEST, Search};

/// The highest bit rate, 125 kbit/s doubled so many times: 1 Mbit/s, or 500 kbit/s with a crystal
/// of 8 MHz. A time quantum is at least two periods of the crystal, so 8 MHz gives 4 quanta in a
/// bit of 1 Mbit/s, and the MCP2515 needs 5 (DS20001801J, section 5).
pub const HIGHEST_RATE: i32 = if CAN_CRYSTAL_HZ >= 10_000_000 { 3 } else { 2 };

/// The bit rate in bit/s for a value of CAN_BAUDRATE. 0 is 125,000, and each next value twice the
/// rate. With the feature `any-rate` there is -1: the result is 0, and the node finds the rate.
#[inline(never)]
pub fn in_bits_per_second(baudrate: u8) -> u32 {
    if LOWEST < 0 && baudrate == LOWEST as u8 {
        return 0;
    }
    let mut rate = 125_000;
    for _ in 0..baudrate {
        rate <<= 1;
    }
    rate
}

/// The timing for a value of CAN_BAUDRATE, and the crystal of the board. A node that finds the rate
/// begins with the highest.
pub fn timing(baudrate: u8) -> BitTiming {
    timing_of::<CAN_CRYSTAL_HZ>(baudrate)
}

/// The timing for a crystal of `F_OSC_HZ`. Rates above the highest one give that. The code does not
/// compile if a sample point is outside the range of DroneCAN's specification, chapter 8, with one
/// exception: 500 kbit/s of an 8 MHz crystal has 8 quanta a bit, of which the MCP2515
/// needs two after the sample point. So the bit is sampled at 75 % instead of 85 % to 90 %.
fn timing_of<const F_OSC_HZ: u32>(doublings: u8) -> BitTiming {
    // The compiler would put a lookup table into RAM. Comparing with ranges, one register at a
    // time, avoids that.
    let select = |[of_8, of_4, of_2, of_1]: [u8; 4]| match doublings {
        3.. => of_8,
        2 => of_4,
        1 => of_2,
        _ => of_1,
    };
    let [a, b, c, d] = const {
        [
            if F_OSC_HZ >= 10_000_000 {
                checked(F_OSC_HZ, 1_000_000, 750)
            } else {
                checked(F_OSC_HZ, 500_000, 750)
            },
            checked(F_OSC_HZ, 500_000, if F_OSC_HZ >= 10_000_000 { 850 } else { 750 }),
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
    assert!(
        timing.sample_point_permille() >= earliest_permille
            && timing.sample_point_permille() <= 900
    );
    timing
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_number_is_twice_the_rate_of_the_one_before_up_to_the_highest() {
        for (doublings, bit_rate) in
            [(0, 125), (1, 250), (2, 500), (3, 1000), (4, 1000), (255, 1000)]
        {
            assert_eq!(
                timing_of::<16_000_000>(doublings),
                BitTiming::new(16_000_000, bit_rate * 1000),
                "{doublings}"
            );
            let at_8_mhz = BitTiming::new(8_000_000, bit_rate.min(500) * 1000);
            assert_eq!(timing_of::<8_000_000>(doublings), at_8_mhz, "{doublings}");
        }
    }

    #[test]
    fn the_timing_is_that_of_the_board_s_crystal() {
        assert_eq!(timing(2), BitTiming::new(CAN_CRYSTAL_HZ, 500_000));
        assert_eq!(timing(LOWEST as u8), timing(if LOWEST < 0 { 3 } else { 0 }));
    }

    #[test]
    fn only_a_node_without_a_rate_searches_and_it_tries_each_rate_in_turn() {
        for value in 0..=HIGHEST_RATE as u8 {
            assert_eq!(Search::new(value).take_next(), None, "{value}");
        }
        let mut search = Search::new(LOWEST as u8);
        for _ in 0..100 {
            let rates = [2, 1, 0, 3].map(|rate| (LOWEST < 0).then_some(rate));
            assert_eq!([(); 4].map(|()| search.take_next()), rates);
        }
    }
}
