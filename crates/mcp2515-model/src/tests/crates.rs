//! The byte sequences that two published drivers send on the SPI bus. A correct driver causes
//! no violation; an incorrect one gets the answers of the real chip.

use super::support::*;
use can_model::{Frame, Id};

/// `mcp2515` 0.3.0, `init`: RESET and 5 ms, single WRITEs, BIT MODIFY with a fifth byte.
fn init_like_mcp2515() -> Bench {
    let mut bench = Bench::new();
    bench.reset();
    bench.run_bits(5_000);
    let modify = |bench: &mut Bench, address, mask, data| {
        bench.spi(&[BIT_MODIFY, address, mask, data, 0]);
    };
    bench.assert_opmod(CONFIGURATION);
    modify(&mut bench, CANINTF, WAKIF, 0);
    modify(&mut bench, CANCTRL, 0xE0, CONFIGURATION);
    for (address, value) in [(CNF1, 0x00), (CNF2, 0xCA), (CNF3, 0x81)] {
        bench.write(address, &[value]);
    }
    modify(&mut bench, CANCTRL, 0x04, 0);
    for control in [0x30, 0x40, 0x50] {
        bench.write(control, &[0; 14]);
    }
    bench.write(RXB0CTRL, &[0]);
    bench.write(RXB1CTRL, &[0]);
    bench.write(CANINTE, &[0xA3]);
    modify(&mut bench, RXB0CTRL, 0x65, 0x04);
    modify(&mut bench, RXB1CTRL, 0x67, 0x01);
    for (n, address) in RXF.into_iter().enumerate() {
        let sidl = if n == 1 { EXIDE } else { 0 };
        for (offset, value) in [(3, 0), (2, 0), (1, sidl), (0, 0)] {
            bench.write(address + offset, &[value]);
        }
    }
    for address in [RXM0, RXM1] {
        for offset in [3, 2, 1, 0] {
            bench.write(address + offset, &[0]);
        }
    }
    modify(&mut bench, CANINTF, WAKIF, 0);
    modify(&mut bench, CANCTRL, 0xE0, NORMAL);
    // The crate reads CANSTAT at most 20 times.
    let reached = (0..20).any(|_| bench.read(CANSTAT) & 0xE0 == NORMAL);
    assert!(reached, "NewModeTimeout");
    bench
}

/// DS20001801J 12: `mcp2515` 0.3.0 initialises the chip and receives through READ and BIT MODIFY.
#[test]
fn the_mcp2515_crate_receives() {
    let mut bench = init_like_mcp2515();
    bench.peer_sends(&[Frame::extended(0x1003_F20A, &[1, 2, 3]), Frame::standard(0x123, &[])]);
    assert_eq!(bench.spi(&[READ_STATUS, 0])[1] & 0x03, 0x03);
    let header: Vec<u8> = (0..5).rev().map(|n| bench.read(RXB0SIDH + n)).collect();
    assert_eq!(header, [3, 0x0A, 0xF2, 0x0B, 0x80]);
    assert_eq!(bench.read_many(0x66, 3), [1, 2, 3]);
    bench.spi(&[BIT_MODIFY, CANINTF, RX0IF, 0, 0]);
    assert_eq!(bench.spi(&[READ_STATUS, 0])[1] & 0x03, 0x02);
    assert_eq!(bench.read_many(RXB1SIDH, 2), [0x24, 0x60]);
    bench.spi(&[BIT_MODIFY, CANINTF, RX1IF, 0, 0]);
    assert!(!bench.int_is_low());
}

/// DS20001801J 3.1: `mcp2515` 0.3.0 sends, also an empty frame (a WRITE without data).
#[test]
fn the_mcp2515_crate_sends() {
    let mut bench = init_like_mcp2515();
    for data in [&[][..], &[0xAB], &[1, 2, 3, 4, 5, 6, 7, 8]] {
        let free = [0x30, 0x40, 0x50].into_iter().find(|&control| bench.read(control) & TXREQ == 0);
        let control = free.expect("a free buffer");
        for (offset, value) in [(5, data.len() as u8), (4, 0x0A), (3, 0xF2), (2, 0x0B), (1, 0x80)] {
            bench.write(control + offset, &[value]);
        }
        bench.write(control + 6, data);
        bench.spi(&[BIT_MODIFY, control, TXREQ, TXREQ, 0]);
        assert_eq!(bench.read(control) & (ABTF | MLOA | TXERR), 0);
        bench.run_bits(FRAME_BITS);
        assert_eq!(bench.peer_received(), [Frame::extended(0x1003_F20A, data)]);
    }
}

/// `mcp25xx` 0.4.0, `apply_config`: RESET, as soon as a slow processor gets there three CNFs in one
/// WRITE, the mode last.
fn init_like_mcp25xx() -> Bench {
    let mut bench = Bench::new();
    bench.reset();
    bench.write(CNF3, &[0x82, 0xD0, 0x00]);
    bench.write(RXB0CTRL, &[BUKT]);
    bench.write(RXB1CTRL, &[0x00]);
    for address in RXF {
        bench.write(address, &[0x00, EXIDE, 0x00, 0x00]);
    }
    bench.write(RXM0, &[0; 4]);
    bench.write(RXM1, &[0; 4]);
    bench.write(CANCTRL, &[0x07]);
    bench.run_bits(50);
    bench
}

/// DS20001801J 12: `mcp25xx` 0.4.0 without features receives 13 bytes by READ, and clears by BIT
/// MODIFY.
#[test]
fn the_mcp25xx_crate_receives() {
    let mut bench = init_like_mcp25xx();
    let frames = [Frame::extended(0x0ABC_DEF0, &[1; 8]), Frame::extended(0x1234_5678, &[2; 8])];
    bench.peer_sends(&frames);
    for (n, byte) in [(0u8, 1), (1, 2)] {
        assert_ne!(bench.spi(&[READ_STATUS, 0])[1] & 1 << n, 0);
        assert_eq!(bench.read_many(RXB0SIDH + 0x10 * n, 13)[5..], [byte; 8]);
        bench.modify(CANINTF, 1 << n, 0);
    }
    bench.assert_register(CANINTF, 0);
}

/// DS20001801J 12: `mcp25xx` 0.4.0 sends by WRITE and RTS.
#[test]
fn the_mcp25xx_crate_sends() {
    let mut bench = init_like_mcp25xx();
    for n in 0..3u8 {
        assert_eq!(bench.spi(&[READ_STATUS, 0])[1] & 0x54, 0);
        bench.write(0x31 + 0x10 * n, &[0x24, 0x60, 0, 0, 2, 0xCA, n]);
        bench.rts(1 << n);
        bench.run_bits(FRAME_BITS);
        assert_eq!(bench.peer_received(), [Frame::standard(0x123, &[0xCA, n])]);
    }
}

/// DS20001801J Figure 12-3: with its feature `mcp2515` the crate reads RXB1 with 92h, which is the
/// data field of RXB0. It gets wrong bytes and releases the wrong buffer, and RXB1 stays full.
#[test]
fn the_mcp25xx_crate_with_feature_mcp2515_reads_the_wrong_buffer() {
    let mut bench = init_like_mcp25xx();
    bench.peer_sends(&[
        Frame::extended(0x0ABC_DEF0, &[1, 2, 3, 4, 5, 6, 7, 8]),
        Frame::extended(0x1234_5678, &[9; 8]),
    ]);
    let mut read = |instruction| {
        let mut bytes = [0; 14];
        bytes[0] = instruction;
        bench.spi(&bytes)[1..].to_vec()
    };
    assert_eq!(read(0x90)[5..], [1, 2, 3, 4, 5, 6, 7, 8]);
    assert_eq!(read(0x92)[..8], [1, 2, 3, 4, 5, 6, 7, 8], "RXB0's data once more");
    bench.assert_register(CANINTF, RX1IF);
    bench.assert_violation(&["92h", "RX0IF"]);
}

/// DS20001801J 4.1: remote frames in both directions.
#[test]
fn a_remote_frame_passes_both_ways() {
    let mut bench = init_like_mcp25xx();
    let remote = Frame::remote(Id::Extended(0x0ABC_DEF0), 4);
    bench.peer_sends(&[remote]);
    let header = bench.read_many(RXB0SIDH, 5);
    bench.write(TXB0SIDH, &header);
    bench.rts(1);
    bench.run_bits(FRAME_BITS);
    assert_eq!(bench.peer_received(), [remote]);
}
