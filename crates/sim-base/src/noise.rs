//! Pseudo-random numbers for noise and for memory after power-on, from a seed, so that a run can be
//! repeated.

/// Generator after Marsaglia, "Xorshift RNGs" (2003), with a multiplied output.
#[derive(Debug, Clone)]
pub struct Noise(u64);

impl Noise {
    /// A generator with this seed, which may be any number.
    pub fn new(seed: u64) -> Noise {
        // The state must not be 0; an odd multiplier spreads small seeds over all bits.
        let mut noise = Noise(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
        noise.next_u64();
        noise
    }

    /// The next 64 bits.
    pub fn next_u64(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    /// A number from 0 to `limit - 1`. The bias is below `limit / 2^32`.
    pub fn below(&mut self, limit: u64) -> u64 {
        ((self.next_u64() >> 32) * limit) >> 32
    }

    /// True with a probability of `per_million` in a million.
    pub fn chance(&mut self, per_million: u32) -> bool {
        per_million > 0 && self.below(1_000_000) < u64::from(per_million)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_gives_the_same_numbers_and_another_seed_others() {
        let numbers = |seed| {
            let mut noise = Noise::new(seed);
            [noise.next_u64(), noise.next_u64()]
        };
        assert_eq!(numbers(3), numbers(3));
        assert_ne!(numbers(3), numbers(5));
    }

    #[test]
    fn a_chance_has_about_its_probability() {
        let mut noise = Noise::new(1);
        let hits = (0..100_000).filter(|_| noise.chance(10_000)).count();
        assert!((900..1100).contains(&hits), "{hits}");
        assert!(!noise.chance(0));
    }
}
