//! Faults on the wire, and the times at which they take effect.
//!
//! The bits of a frame are counted on the wire from its SOF (0) through end of frame and
//! intermission, including stuff bits. "The next frame" is the next SOF after the injection.
//!
//! Limits: faults of one station have no effect on a station out of step with the bus, which
//! receives nothing anyway. With a station out of step, the faults of a bit are decided when the
//! bit begins.

use super::port::PortId;
use super::wire::Level;

/// A fault. See [`Bus::inject`](super::Bus::inject).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Fault {
    /// One bit of the next frame is inverted for all stations.
    FlipBit {
        /// Number of the bit; 0 is the SOF. Beyond the intermission the fault has no effect.
        bit: u32,
    },
    /// One bit of the next frame is inverted for this station only.
    FlipBitSeenBy {
        /// The station.
        port: PortId,
        /// Number of the bit; 0 is the SOF.
        bit: u32,
    },
    /// Noise: each bit, also of an idle bus, is inverted for all stations with this probability. 0
    /// ends the noise.
    BitErrorRate {
        /// Bit errors in a million bits.
        per_million: u32,
        /// Equal seeds give equal noise.
        seed: u64,
    },
    /// The station does not receive the next frame of another station: its time stops meanwhile.
    LoseNextFrame {
        /// The station.
        port: PortId,
    },
    /// No station acknowledges, as if only listeners were there: from the ACK slot on, the wire has
    /// the level that the sender drives. A sender becomes error-passive and repeats its frame;
    /// its TEC stays at 128.
    NoAck(bool),
    /// The wire is recessive in every ACK slot. The receivers detect that their acknowledgements
    /// are destroyed, and destroy the frame: the sender goes bus-off.
    AckDestroyed(bool),
    /// Every frame is destroyed: its bit 60 is inverted for all stations. In an extended frame that
    /// is after the control field.
    DestroyFrames(bool),
    /// The wire is shorted and always dominant.
    StuckDominant(bool),
    /// The two wires are shorted to each other: always recessive.
    StuckRecessive(bool),
}

/// See [`Fault::DestroyFrames`].
const DESTROYED_BIT: u32 = 60;

#[derive(Clone, Copy, Debug)]
struct Flip {
    port: Option<PortId>,
    bit: u32,
    /// True when its frame has begun.
    armed: bool,
}

/// What the faults need to know about the next bit.
#[derive(Clone, Copy, Debug)]
pub(super) struct BitContext {
    /// True if the bus is idle: a dominant bit would be a SOF.
    pub idle: bool,
    /// True if the bit is a SOF.
    pub start_of_frame: bool,
    pub ack_slot: bool,
}

/// All active faults.
#[derive(Default, Debug)]
pub(super) struct Faults {
    /// False if no fault is active, which makes the usual case fast.
    any: bool,
    flips: Vec<Flip>,
    noise: Option<Noise>,
    lose: Vec<PortId>,
    no_ack: bool,
    ack_destroyed: bool,
    destroy: bool,
    stuck: Option<Level>,
    /// Number of the next bit in its frame.
    frame_bit: Option<u32>,
}

/// The effect of the faults on one bit.
#[derive(Clone, Copy, Default, Debug)]
pub(super) struct Distortion {
    force: Option<Level>,
    invert: bool,
    /// The station that receives the opposite level.
    pub fooled: Option<PortId>,
}

impl Distortion {
    /// The wire's level with the faults.
    pub fn apply(&self, level: Level) -> Level {
        let level = self.force.unwrap_or(level);
        if self.invert { !level } else { level }
    }
}

impl Faults {
    pub fn inject(&mut self, fault: Fault) {
        match fault {
            Fault::FlipBit { bit } => self.flips.push(Flip { port: None, bit, armed: false }),
            Fault::FlipBitSeenBy { port, bit } => {
                self.flips.push(Flip { port: Some(port), bit, armed: false });
            }
            Fault::BitErrorRate { per_million, seed } => {
                self.noise = (per_million > 0).then(|| Noise::new(per_million, seed));
            }
            Fault::LoseNextFrame { port } => self.lose.push(port),
            Fault::NoAck(on) => self.no_ack = on,
            Fault::AckDestroyed(on) => self.ack_destroyed = on,
            Fault::DestroyFrames(on) => self.destroy = on,
            Fault::StuckDominant(on) => self.stuck = on.then_some(Level::Dominant),
            Fault::StuckRecessive(on) => self.stuck = on.then_some(Level::Recessive),
        }
        self.update_any();
    }

    pub fn clear(&mut self) {
        *self = Faults::default();
    }

    pub fn any(&self) -> bool {
        self.any
    }

    fn update_any(&mut self) {
        let lasting = self.no_ack || self.ack_destroyed || self.destroy || self.stuck.is_some();
        self.any =
            lasting || !self.flips.is_empty() || self.noise.is_some() || !self.lose.is_empty();
    }

    /// Number of idle bits that no fault affects.
    pub fn harmless_idle_bits(&self) -> u64 {
        match &self.noise {
            _ if self.stuck == Some(Level::Dominant) => 0,
            Some(noise) => noise.clean_bits,
            None => u64::MAX,
        }
    }

    /// Skips idle bits, at most [`Faults::harmless_idle_bits`].
    pub fn skip_idle(&mut self, bits: u64) {
        if let Some(noise) = &mut self.noise {
            noise.clean_bits -= bits;
        }
    }

    /// Removes the stations that miss the frame that begins now: those for which `hears` says that
    /// they could receive it.
    pub fn losers(&mut self, mut hears: impl FnMut(PortId) -> bool) {
        self.lose.retain(|&port| !hears(port));
        self.update_any();
    }

    pub fn loses_frames(&self) -> bool {
        !self.lose.is_empty()
    }

    /// True if receivers must not acknowledge.
    pub fn mutes_receivers(&self) -> bool {
        self.no_ack
    }

    /// The effect of the faults on the next bit.
    pub fn next_bit(&mut self, context: BitContext) -> Distortion {
        let mut distortion = Distortion::default();
        if !self.any {
            return distortion;
        }
        self.count_frame_bit(context);
        if let Some(frame_bit) = self.frame_bit {
            self.flips.retain(|flip| {
                let now = flip.armed && flip.bit == frame_bit;
                match flip.port {
                    None => distortion.invert ^= now,
                    Some(_) if now => distortion.fooled = flip.port,
                    Some(_) => {}
                }
                !now
            });
            distortion.invert ^= self.destroy && frame_bit == DESTROYED_BIT;
        }
        if let Some(noise) = &mut self.noise {
            distortion.invert ^= noise.hits();
        }
        if self.ack_destroyed && context.ack_slot {
            distortion.force = Some(Level::Recessive);
        }
        if self.stuck.is_some() {
            distortion = Distortion { force: self.stuck, ..Distortion::default() };
        }
        self.update_any();
        distortion
    }

    fn count_frame_bit(&mut self, context: BitContext) {
        if context.start_of_frame {
            self.flips.retain(|flip| !flip.armed);
            self.flips.iter_mut().for_each(|flip| flip.armed = true);
            self.frame_bit = Some(0);
        } else if context.idle {
            self.flips.retain(|flip| !flip.armed);
            self.frame_bit = None;
        } else {
            self.frame_bit = self.frame_bit.map(|bit| bit + 1);
        }
    }
}

const MILLION: u64 = 1_000_000;

/// Bit errors by the gaps between them, so that idle bits up to the next error can be skipped.
#[derive(Debug)]
struct Noise {
    per_million: u64,
    random: Random,
    /// Number of bits before the next error.
    clean_bits: u64,
}

impl Noise {
    fn new(per_million: u32, seed: u64) -> Noise {
        let per_million = u64::from(per_million).min(MILLION);
        let mut noise = Noise { per_million, random: Random(seed), clean_bits: 0 };
        noise.draw_gap();
        noise
    }

    fn draw_gap(&mut self) {
        while self.random.below(MILLION) >= self.per_million {
            self.clean_bits += 1;
        }
    }

    fn hits(&mut self) -> bool {
        if self.clean_bits > 0 {
            self.clean_bits -= 1;
            return false;
        }
        self.draw_gap();
        true
    }
}

/// SplitMix64 (Steele, Lea, Flood 2014): random enough for noise, and the same on every host.
#[derive(Clone, Debug)]
pub(super) struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A number below `limit`. `limit` is far below 2^64, so the modulo's bias is negligible.
    pub fn below(&mut self, limit: u64) -> u64 {
        self.next() % limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDLE: BitContext = BitContext { idle: true, start_of_frame: false, ack_slot: false };
    const SOF: BitContext = BitContext { idle: true, start_of_frame: true, ack_slot: false };
    const BUSY: BitContext = BitContext { idle: false, start_of_frame: false, ack_slot: false };

    /// Indices of the inverted bits among an idle bit, a SOF and nine bits of a frame, twice.
    fn inverted(faults: &mut Faults) -> Vec<usize> {
        let frame = [IDLE, SOF].into_iter().chain([BUSY; 9]);
        let bits: Vec<_> = frame.clone().chain(frame).collect();
        let hit = |context| faults.next_bit(context).apply(Level::Recessive).is_dominant();
        let hits: Vec<bool> = bits.into_iter().map(hit).collect();
        (0..hits.len()).filter(|&at| hits[at]).collect()
    }

    #[test]
    fn a_flip_hits_its_bit_of_the_next_frame_once() {
        let mut faults = Faults::default();
        faults.inject(Fault::FlipBit { bit: 0 });
        faults.inject(Fault::FlipBit { bit: 3 });
        assert_eq!(inverted(&mut faults), [1, 4]);
        assert!(!faults.any());
    }

    #[test]
    fn a_flip_beyond_the_frame_expires_with_it() {
        let mut faults = Faults::default();
        faults.inject(Fault::FlipBit { bit: 10 });
        assert_eq!(inverted(&mut faults), []);
        assert!(!faults.any());
    }

    #[test]
    fn noise_has_its_rate_and_repeats_with_its_seed() {
        let count = |seed| {
            let mut faults = Faults::default();
            faults.inject(Fault::BitErrorRate { per_million: 1000, seed });
            let hits: Vec<u32> = (0..1_000_000)
                .filter(|_| faults.next_bit(BUSY).apply(Level::Recessive).is_dominant())
                .collect();
            hits
        };
        let hits = count(1);
        assert!((900..1100).contains(&hits.len()), "{}", hits.len());
        assert_eq!(hits, count(1));
        assert_ne!(hits, count(2));
    }
}
