//! Bit timing of the MCP2515, derived from its crystal and the bit rate at compile time.
//!
//! A bit is 1 (sync) + PROP + PS1 + PS2 time quanta of 2 x (BRP + 1) / F_OSC each (DS20001801J section 5). DroneCAN asks for
//! a sample point of 87.5 %, and at 1 Mbit/s for 75 to 90 % (specification, chapter 8). PS2 cannot be less than two quanta,
//! and a 16 MHz crystal gives eight quanta at 1 Mbit/s, so 75 % is the latest point that this chip can sample at there.

/// Contents of CNF1, CNF2 and CNF3.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitTiming {
    /// Synchronisation jump width and baud rate prescaler.
    pub cnf1: u8,
    /// Propagation and phase 1 segments.
    pub cnf2: u8,
    /// Phase 2 segment.
    pub cnf3: u8,
}

/// CNF2: PS2 is what CNF3 says, not the greater of PS1 and 2 TQ.
const BTLMODE: u8 = 1 << 7;

impl BitTiming {
    /// Timing for `bit_rate` from a crystal of `f_osc_hz`.
    ///
    /// # Panics
    ///
    /// In a `const` this is a compile error: when the crystal does not divide to the bit rate, or when DroneCAN's range for
    /// the sample point cannot be met.
    pub const fn new(f_osc_hz: u32, bit_rate: u32) -> Self {
        // The smallest prescaler gives the most quanta, and the most quanta place the sample point best.
        let mut brp = 0;
        let mut quanta = f_osc_hz / (2 * bit_rate);
        while quanta > 25 || quanta * 2 * (brp + 1) * bit_rate != f_osc_hz {
            brp += 1;
            assert!(brp < 64, "crystal does not divide to the bit rate");
            quanta = f_osc_hz / (2 * (brp + 1) * bit_rate);
        }
        assert!(quanta >= 8, "bit rate too high for this crystal");

        let ps2 = if quanta < 16 { 2 } else { quanta / 8 };
        let before = quanta - 1 - ps2;
        // Three fifths to PS1, which is as wide as it goes (8) from 16 quanta on; PS1 must not be less than PS2.
        let ps1 = if before > 12 { 8 } else { (3 * before).div_ceil(5) };
        let prop = before - ps1;
        assert!(prop >= 1 && prop <= 8 && ps1 >= ps2 && ps2 <= 8);

        let sample_point_permille = 1000 * (quanta - ps2) / quanta;
        let earliest_permille = if bit_rate == 1_000_000 { 750 } else { 850 };
        assert!(sample_point_permille >= earliest_permille && sample_point_permille <= 900);
        Self {
            // A jump width of one quantum: PS2 must stay larger than it (DS20001801J 5.3).
            cnf1: brp as u8,
            cnf2: BTLMODE | ((ps1 - 1) as u8) << 3 | (prop - 1) as u8,
            cnf3: (ps2 - 1) as u8,
        }
    }

    /// Timing for `rate` units of 125 kbit/s from a crystal of `F_OSC_HZ`: that for 8, 4, 2 or 1, the highest that is not above.
    pub fn at_rate<const F_OSC_HZ: u32>(rate: u8) -> Self {
        // Comparing one register at a time and with `>=` keeps the compiler from making tables, which are in RAM.
        let select = |[of_8, of_4, of_2, of_1]: [u8; 4]| match rate {
            8.. => of_8,
            4.. => of_4,
            2.. => of_2,
            _ => of_1,
        };
        const fn all(f_osc_hz: u32) -> [BitTiming; 4] {
            [
                BitTiming::new(f_osc_hz, 1_000_000),
                BitTiming::new(f_osc_hz, 500_000),
                BitTiming::new(f_osc_hz, 250_000),
                BitTiming::new(f_osc_hz, 125_000),
            ]
        }
        let [a, b, c, d] = const { all(F_OSC_HZ) };
        Self {
            cnf1: select([a.cnf1, b.cnf1, c.cnf1, d.cnf1]),
            cnf2: select([a.cnf2, b.cnf2, c.cnf2, d.cnf2]),
            cnf3: select([a.cnf3, b.cnf3, c.cnf3, d.cnf3]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CRYSTAL_HZ: u32 = 16_000_000;

    #[test]
    fn registers_are_those_worked_out_by_hand_for_a_16_mhz_crystal() {
        let cnf = |bit_rate| {
            let timing = BitTiming::new(CRYSTAL_HZ, bit_rate);
            (timing.cnf1, timing.cnf2, timing.cnf3)
        };
        assert_eq!(cnf(1_000_000), (0x00, 0x91, 0x01));
        assert_eq!(cnf(500_000), (0x00, 0xBC, 0x01));
        assert_eq!(cnf(250_000), (0x01, 0xBC, 0x01));
        assert_eq!(cnf(125_000), (0x03, 0xBC, 0x01));
    }

    #[test]
    #[should_panic = "bit rate too high"]
    fn an_8_mhz_crystal_is_refused_at_1_mbit_s() {
        BitTiming::new(8_000_000, 1_000_000);
    }

    #[test]
    #[should_panic = "does not divide"]
    fn a_rate_that_the_crystal_does_not_divide_to_is_refused() {
        BitTiming::new(CRYSTAL_HZ, 300_000);
    }
}
