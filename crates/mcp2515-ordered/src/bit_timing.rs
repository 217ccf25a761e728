//! Bit timing of the MCP2515, derived from its crystal and the bit rate at compile time.
//!
//! A bit is 1 (sync) + PROP + PS1 + PS2 time quanta of 2 x (BRP + 1) / F_OSC each (DS20001801J
//! section 5). CAN in Automation recommends a sample point of 87.5 %. A 16 MHz crystal gives eight
//! quanta at 1 Mbit/s. PS2 must have at least two quanta, so the sample point is then at 75 %.

/// Contents of CNF1, CNF2 and CNF3.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BitTiming(
    /// CNF3, CNF2 and CNF1, in the order of their addresses.
    pub(crate) [u8; 3],
);

/// CNF2: CNF3 sets PS2. Otherwise PS2 is the greater of PS1 and 2 TQ.
const BTLMODE: u8 = 1 << 7;

impl BitTiming {
    /// The value in a driver without a configuration.
    pub(crate) const UNSET: Self = Self([0; 3]);

    /// Computes the timing for `bit_rate` with a crystal of `f_osc_hz`. The sample point is between
    /// 75 and 90 %, as near to 87.5 % as possible.
    ///
    /// ```
    /// # use mcp2515_ordered::BitTiming;
    /// const TIMING: BitTiming = BitTiming::new(16_000_000, 500_000);
    /// assert_eq!((TIMING.cnf1(), TIMING.cnf2(), TIMING.cnf3()), (0x00, 0xBC, 0x01));
    /// assert_eq!(TIMING.sample_point_permille(), 875);
    /// ```
    ///
    /// # Panics
    ///
    /// If the crystal does not divide to the bit rate, or gives less than eight quanta in a bit. In
    /// a `const` this is a compile error. An 8 MHz crystal gives eight quanta at 500 kbit/s, so
    /// 1 Mbit/s is not possible.
    pub const fn new(f_osc_hz: u32, bit_rate: u32) -> Self {
        // The smallest prescaler gives the most quanta, and more quanta place the sample point more
        // exactly. But with more than 20 quanta, PROP and PS1, which have eight quanta at
        // most, end too early.
        let mut brp = 0;
        let mut quanta = f_osc_hz / (2 * bit_rate);
        while quanta > 20 || quanta * 2 * (brp + 1) * bit_rate != f_osc_hz {
            brp += 1;
            assert!(brp < 64, "crystal does not divide to the bit rate");
            quanta = f_osc_hz / (2 * (brp + 1) * bit_rate);
        }
        assert!(quanta >= 8, "bit rate too high for this crystal");

        // PS2 is about an eighth of the bit.
        let ps2 = if quanta < 20 { 2 } else { 3 };
        let before = quanta - 1 - ps2;
        // PS1 gets three fifths of the rest, and its maximum of 8 from 16 quanta on. PS1 must not
        // be less than PS2.
        let ps1 = if before > 12 { 8 } else { (3 * before).div_ceil(5) };
        let prop = before - ps1;
        assert!(prop >= 1 && prop <= 8 && ps1 >= ps2);

        // The jump width is one quantum. PS2 must be larger than the jump width (DS20001801J 5.5).
        let timing = Self::from_registers(
            brp as u8,
            ((ps1 - 1) as u8) << 3 | (prop - 1) as u8,
            (ps2 - 1) as u8,
        );
        assert!(timing.sample_point_permille() >= 750 && timing.sample_point_permille() <= 900);
        timing
    }

    /// Makes a timing of register values from elsewhere. Always sets BTLMODE, so that `cnf3` sets
    /// PS2.
    pub const fn from_registers(cnf1: u8, cnf2: u8, cnf3: u8) -> Self {
        Self([cnf3, BTLMODE | cnf2, cnf1])
    }

    /// CNF1: synchronisation jump width and baud rate prescaler.
    pub const fn cnf1(self) -> u8 {
        self.0[2]
    }

    /// CNF2: propagation and phase 1 segments.
    pub const fn cnf2(self) -> u8 {
        self.0[1]
    }

    /// CNF3: phase 2 segment.
    pub const fn cnf3(self) -> u8 {
        self.0[0]
    }

    /// The sample point, in thousandths of a bit.
    pub const fn sample_point_permille(self) -> u16 {
        const fn width(bits: u8) -> u16 {
            (bits & 7) as u16 + 1
        }
        let before = 1 + width(self.cnf2()) + width(self.cnf2() >> 3);
        1000 * before / (before + width(self.cnf3()))
    }

    /// True unless this is [`UNSET`](Self::UNSET).
    pub(crate) const fn is_set(self) -> bool {
        self.0[1] & BTLMODE != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CRYSTAL_HZ: u32 = 16_000_000;

    #[test]
    fn registers_for_a_16_mhz_crystal_match_the_calculation_by_hand() {
        let cnf = |bit_rate| {
            let timing = BitTiming::new(CRYSTAL_HZ, bit_rate);
            (timing.cnf1(), timing.cnf2(), timing.cnf3())
        };
        assert_eq!(cnf(1_000_000), (0x00, 0x91, 0x01));
        assert_eq!(cnf(500_000), (0x00, 0xBC, 0x01));
        assert_eq!(cnf(250_000), (0x01, 0xBC, 0x01));
        assert_eq!(cnf(125_000), (0x03, 0xBC, 0x01));
    }

    /// Decodes the registers by DS20001801J section 5, for all crystals and rates that divide.
    #[test]
    fn each_timing_has_the_requested_bit_rate_and_legal_segments() {
        let mut pairs = 0;
        for f_osc_hz in (1..=40).map(|mhz| mhz * 1_000_000) {
            for bit_rate in
                [10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000]
            {
                let divides = |quanta| {
                    f_osc_hz % (2 * bit_rate * quanta) == 0
                        && f_osc_hz / (2 * bit_rate * quanta) <= 64
                };
                if !(8..=20).any(divides) {
                    continue;
                }
                pairs += 1;
                let timing = BitTiming::new(f_osc_hz, bit_rate);
                let (cnf1, cnf2, cnf3) = (timing.cnf1(), timing.cnf2(), timing.cnf3());
                let [prop, ps1, ps2] =
                    [cnf2 & 7, cnf2 >> 3 & 7, cnf3 & 7].map(|bits| u32::from(bits) + 1);
                let quanta = 1 + prop + ps1 + ps2;
                assert_eq!(
                    f_osc_hz,
                    bit_rate * quanta * 2 * (u32::from(cnf1 & 0x3F) + 1),
                    "{f_osc_hz} {bit_rate}"
                );
                assert!(
                    prop + ps1 >= ps2
                        && ps2 >= 2
                        && cnf1 >> 6 == 0
                        && cnf2 & 0xC0 == 0x80
                        && cnf3 & 0xF8 == 0
                );
                let permille = 1000 * (quanta - ps2) / quanta;
                assert_eq!(u32::from(timing.sample_point_permille()), permille);
                assert!((750..=900).contains(&permille));
            }
        }
        assert!(pairs > 150, "{pairs}");
    }

    #[test]
    #[should_panic = "bit rate too high"]
    fn an_8_mhz_crystal_is_rejected_at_1_mbit_s() {
        BitTiming::new(8_000_000, 1_000_000);
    }

    #[test]
    #[should_panic = "does not divide"]
    fn a_rate_that_the_crystal_does_not_divide_to_is_rejected() {
        BitTiming::new(CRYSTAL_HZ, 300_000);
    }
}
