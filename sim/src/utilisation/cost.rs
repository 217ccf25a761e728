//! The number of bits that a transfer takes on the bus.
//!
//! A frame with a 29-bit identifier and n data bytes, including the tail byte, has 67 + 8n bits
//! from its SOF to the end of the intermission, plus stuff bits: at most one after the first five
//! of the 54 + 8n bits that are stuffed and one after every further four. The exact number depends
//! on every bit, so it is counted in whole frames with their identifier, transfer CRC and CRC-15.
//!
//! Limits: `least` and `most` are bounds that a given identifier need not reach. Error frames and
//! retransmissions are not counted.

use super::stream::Stream;
use bench::can;
use bench::can::{Frame, OnWire as _};
use bench::dronecan::{NodeId, TransferId, split};

/// Number of transfer IDs.
const TRANSFER_IDS: u8 = 32;
/// Seed of the random payloads: any constant, so that a plan always gives the same result.
const SEED: u64 = 0x1D_5EED;

/// Bits of one transfer: all frames with their intermissions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bits {
    /// Without any stuff bit.
    pub least: f64,
    /// Mean of 32 transfers of each sending node, with the given payload or else random ones.
    pub typical: f64,
    /// With the maximum number of stuff bits.
    pub most: f64,
}

impl Bits {
    /// Applies `change` to each of the three.
    pub fn map(self, change: impl Fn(f64) -> f64) -> Bits {
        Bits { least: change(self.least), typical: change(self.typical), most: change(self.most) }
    }

    /// Adds each of the three.
    pub fn plus(self, other: Bits) -> Bits {
        Bits {
            least: self.least + other.least,
            typical: self.typical + other.typical,
            most: self.most + other.most,
        }
    }
}

/// The cost of one transfer of a stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    pub frames: usize,
    pub bits: Bits,
}

impl Cost {
    /// Counts the bits of a transfer of this stream.
    pub fn of(stream: &Stream) -> Cost {
        let template = split(&vec![0; stream.payload_bytes], TransferId::default(), stream.seed);
        let total = |bits: fn(bool, u8) -> u32| -> f64 {
            template.iter().map(|data| f64::from(bits(true, data.len() as u8))).sum()
        };
        let bits = Bits {
            least: total(can::min_bits),
            typical: mean_bits(stream),
            most: total(can::max_bits),
        };
        Cost { frames: template.len(), bits }
    }
}

fn mean_bits(stream: &Stream) -> f64 {
    let mut random = SplitMix(SEED);
    let mut bits = 0;
    for node in 1..=stream.nodes {
        let id = stream.id(NodeId::new(node).expect("1 to 127 nodes")).build();
        for transfer in 0..TRANSFER_IDS {
            let payload =
                stream.payload.clone().unwrap_or_else(|| random.bytes(stream.payload_bytes));
            let frames = split(&payload, TransferId::new(transfer), stream.seed);
            bits += frames
                .iter()
                .map(|data| u64::from(Frame::extended(id, data).bit_count()))
                .sum::<u64>();
        }
    }
    bits as f64 / (f64::from(stream.nodes) * f64::from(TRANSFER_IDS))
}

/// The generator SplitMix64 (Steele, Lea, Flood 2014).
struct SplitMix(u64);

impl SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ self.0 >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ mixed >> 31
    }

    fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.next() as u8).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::stream::Entry;
    use super::*;

    #[track_caller]
    fn cost(text: &str) -> Cost {
        Cost::of(&text.parse::<Entry>().unwrap().0[0])
    }

    #[test]
    fn a_transfer_has_frames_of_seven_bytes_each_with_a_tail_byte_and_a_long_one_a_crc() {
        for (text, frames, least) in [
            ("NodeStatus@1", 1, 131.0),
            // 2 bytes of CRC and 14 of payload: frames of 7, 7 and 2 bytes.
            ("esc.Status@1", 3, 131.0 + 131.0 + 91.0),
            ("ArrayCommand[0]@1", 1, 75.0),
            ("20100:7@1", 1, 131.0),
            ("20100:8@1", 2, 131.0 + 67.0 + 8.0 * 4.0),
        ] {
            let cost = cost(text);
            assert_eq!((cost.frames, cost.bits.least), (frames, least), "{text}");
        }
        let full = cost("NodeStatus@1").bits;
        assert!((132.0..150.0).contains(&full.typical) && full.most == 160.0, "{full:?}");
    }

    #[test]
    fn a_given_payload_is_counted_bit_by_bit() {
        let zeros = cost("NodeStatus=00000000000000@1");
        let mixed = cost("NodeStatus=55AA55AA55AA55@1");
        assert!(zeros.bits.typical > mixed.bits.typical + 5.0, "{zeros:?} {mixed:?}");
        let frame = |transfer: u8| {
            Frame::extended(0x1001_5501, &[0, 0, 0, 0, 0, 0, 0, 0xC0 | transfer]).bit_count()
        };
        let mean = (0..32).map(frame).sum::<u32>() as f64 / 32.0;
        assert_eq!(zeros.bits.typical, mean);
    }

    #[test]
    fn typical_lies_between_the_bounds_for_every_length() {
        for bytes in 0..=64 {
            let Bits { least, typical, most } = cost(&format!("3x20100:{bytes}@1")).bits;
            assert!(least < typical && typical < most, "{bytes} bytes: {least} {typical} {most}");
        }
    }
}
