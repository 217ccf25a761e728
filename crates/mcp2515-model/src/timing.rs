//! Bit timing from CNF1, CNF2 and CNF3.
//!
//! A bit is SyncSeg (1 TQ) + PropSeg + PS1 + PS2, and a TQ is 2 (BRP + 1) oscillator periods.
//! The model steps whole bits, so only the length of the bit affects the bus. The sample point is
//! computed for checks and displays.
//!
//! Source: DS20001801J section 5.

/// Shortest PS2: the chip needs 2 TQ to process the sample (5.2.5).
const INFORMATION_PROCESSING_TQ: u32 = 2;
const PICOSECONDS_PER_SECOND: u64 = 1_000_000_000_000;
/// Length of a bit at the highest bit rate of CAN 2.0, 1 Mbit/s.
const SHORTEST_BIT_PS: u64 = 1_000_000;

const BTLMODE: u8 = 1 << 7;

/// The decoded contents of the three registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitTiming {
    brp: u32,
    sjw_tq: u32,
    prop_tq: u32,
    ps1_tq: u32,
    ps2_tq: u32,
}

impl BitTiming {
    /// Decodes the registers (Registers 5-1 to 5-3).
    pub fn decode(cnf1: u8, cnf2: u8, cnf3: u8) -> BitTiming {
        let ps1_tq = u32::from(cnf2 >> 3 & 0b111) + 1;
        BitTiming {
            brp: u32::from(cnf1 & 0x3F),
            sjw_tq: u32::from(cnf1 >> 6) + 1,
            prop_tq: u32::from(cnf2 & 0b111) + 1,
            ps1_tq,
            // Without BTLMODE, PS2 is the greater of PS1 and the processing time.
            ps2_tq: if cnf2 & BTLMODE != 0 {
                u32::from(cnf3 & 0b111) + 1
            } else {
                ps1_tq.max(INFORMATION_PROCESSING_TQ)
            },
        }
    }

    fn quanta(self) -> u32 {
        1 + self.prop_tq + self.ps1_tq + self.ps2_tq
    }

    /// Length of a bit in picoseconds, rounded down.
    pub fn bit_time_ps(self, osc_hz: u32) -> u64 {
        let periods = u64::from(2 * (self.brp + 1) * self.quanta());
        periods * PICOSECONDS_PER_SECOND / u64::from(osc_hz)
    }

    /// Position of the sample point in the bit, in thousandths.
    pub fn sample_point_permille(self) -> u32 {
        (self.quanta() - self.ps2_tq) * 1000 / self.quanta()
    }

    /// The rule of the datasheet that this setting breaks (5.5, and the sums of the segments in
    /// 5.2); `None` if it is legal. Off the bus (loopback) any bit rate is legal.
    pub fn fault(self, osc_hz: u32, is_on_the_bus: bool) -> Option<&'static str> {
        if self.ps2_tq < INFORMATION_PROCESSING_TQ {
            Some("PS2 is shorter than 2 TQ")
        } else if self.prop_tq + self.ps1_tq < self.ps2_tq {
            Some("PropSeg + PS1 is shorter than PS2")
        } else if self.ps2_tq <= self.sjw_tq {
            Some("PS2 is not longer than SJW")
        } else if !(5..=25).contains(&self.quanta()) {
            Some("the bit is not 5 to 25 TQ long")
        } else if is_on_the_bus && self.bit_time_ps(osc_hz) < SHORTEST_BIT_PS {
            Some("the bit rate is above 1 Mbit/s")
        } else {
            None
        }
    }
}
