//! Noise on the SPI lines: no input may stop the model, and RESET restores it.

use super::support::*;
use can_model::Frame;

/// Bits between two bursts of noise: long enough to send or receive a frame.
const PAUSE_BITS: u64 = 150;
const BURSTS: usize = 1_000;

/// A linear congruential generator (Knuth's MMIX constants), seeded so that a failure can be
/// repeated.
struct Noise(u64);

impl Noise {
    fn byte(&mut self) -> u8 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 56) as u8
    }
}

/// Valid instructions, so that not all noise is an unknown instruction.
const INSTRUCTIONS: [u8; 16] = [
    0x02, 0x02, 0x02, 0x03, 0x05, 0x05, 0x05, 0x40, 0x43, 0x45, 0x81, 0x87, 0x90, 0x96, 0xA0, 0xB0,
];

/// DS20001801J 12.2, 9.0: after any input, RESET and a new set-up make the chip work.
#[test]
fn after_any_noise_a_reset_restores_the_chip() {
    for seed in 0..4 {
        let mut noise = Noise(seed);
        let mut bench = Bench::normal();
        for _ in 0..BURSTS {
            let first = match noise.byte() {
                random @ 0..32 => random.wrapping_mul(8),
                choice => INSTRUCTIONS[usize::from(choice % 16)],
            };
            let mut burst = vec![first];
            for _ in 0..noise.byte() % 16 {
                burst.push(noise.byte());
            }
            bench.spi(&burst);
            bench.run_bits(u64::from(noise.byte()) % PAUSE_BITS);
            if noise.byte() < 32 && bench.peer.borrow().queued() == 0 {
                bench.peer.borrow_mut().send(Frame::extended(0x0123_4567, &[0x5A; 8]));
            }
        }
        bench.spi(&[RESET]);
        bench.run_bits(8);
        bench.violations();
        bench.assert_opmod(CONFIGURATION);
        // The noise may have driven the peer into bus-off.
        bench.run_bits(128 * 11 + 10 * FRAME_BITS);
        bench.set_up();
        bench.enter(NORMAL);
        bench.peer_received();
        bench.run_bits(128 * 11 + 10 * FRAME_BITS);
        bench.write(CANINTF, &[0]);
        bench.send(0x123, &[1]);
        bench.peer_sends(&[Frame::standard(0x321, &[2])]);
        bench.run_bits(FRAME_BITS);
        assert_eq!(bench.peer_received(), [Frame::standard(0x123, &[1])]);
        bench.assert_register(CANINTF, RX0IF | TX0IF);
        assert!(bench.violations().is_empty());
    }
}
