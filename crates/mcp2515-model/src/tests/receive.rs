//! Receive buffers: contents, rollover, overflow, log.

use super::super::Fate;
use super::support::*;
use can_model::{Frame, Id};

/// DS20001801J Registers 4-4 to 4-9: an extended frame in RXB0.
#[test]
fn an_extended_frame_fills_the_buffer() {
    let mut bench = Bench::normal();
    bench.peer_sends(&[Frame::extended(0x1003_F20A, &[1, 2, 3, 4, 5, 6, 7, 8])]);
    // 1003F20Ah: SID 400h, EID 3F20Ah.
    let expected = [0x80, 0x0B, 0xF2, 0x0A, 8, 1, 2, 3, 4, 5, 6, 7, 8];
    assert_eq!(bench.read_many(RXB0SIDH, 13), expected);
    bench.assert_register(RXB0CTRL, 0x01);
}

/// DS20001801J Registers 4-4 to 4-9: a standard frame.
#[test]
fn a_standard_frame_fills_the_buffer() {
    let mut bench = Bench::normal();
    bench.peer_sends(&[Frame::standard(0x5A5, &[0xEE])]);
    assert_eq!(bench.read_many(RXB0SIDH, 6), [0xB4, 0xA0, 0, 0, 1, 0xEE]);
    bench.assert_register(RXB0CTRL, 0x00);
}

/// DS20001801J Registers 4-1, 4-5, 4-8: RXRTR for both kinds, SRR for standard, RTR for extended
/// ones.
#[test]
fn remote_frames_are_marked() {
    let mut bench = Bench::normal();
    bench.peer_sends(&[Frame::remote(Id::Standard(0x5A5), 3)]);
    assert_eq!(bench.read_many(RXB0CTRL, 6), [0x08, 0xB4, 0xB0, 0, 0, 3]);
    bench.write(CANINTF, &[0]);
    bench.peer_sends(&[Frame::remote(Id::Extended(0x1003_F20A), 5)]);
    assert_eq!(bench.read_many(RXB0CTRL, 6), [0x09, 0x80, 0x0B, 0xF2, 0x0A, 0x45]);
    bench.write(CANINTF, &[0]);
    bench.peer_sends(&[Frame::standard(1, &[])]);
    bench.assert_register(RXB0CTRL, 0x00);
}

/// DS20001801J Register 4-8: the DLC is stored as received; above 8 it means 8 bytes.
#[test]
fn every_dlc_is_stored_as_received() {
    let mut bench = Bench::normal();
    let data = [1, 2, 3, 4, 5, 6, 7, 8];
    for code in 0..=15u8 {
        bench.peer_sends(&[Frame::with_dlc(Id::Standard(0x100), code, data)]);
        bench.assert_register(0x65, code);
        let length = usize::from(code.min(8));
        assert_eq!(bench.read_many(0x66, length), data[..length]);
        bench.write(CANINTF, &[0]);
    }
}

/// Register 4-9 does not specify the bytes beyond the frame. The model keeps the old ones, so that
/// a driver that uses them can be detected.
#[test]
fn bytes_beyond_the_frame_keep_their_old_values() {
    let mut bench = Bench::normal();
    bench.peer_sends(&[Frame::standard(1, &[0xA5; 8])]);
    bench.write(CANINTF, &[0]);
    bench.peer_sends(&[Frame::standard(1, &[0x11])]);
    assert_eq!(bench.read_many(0x66, 8), [0x11, 0xA5, 0xA5, 0xA5, 0xA5, 0xA5, 0xA5, 0xA5]);
}

/// DS20001801J 4.1.3: while RXnIF is set the buffer keeps its frame.
#[test]
fn a_full_buffer_is_not_overwritten() {
    let mut bench = Bench::normal();
    bench.peer_sends(&[Frame::standard(1, &[0x11]), Frame::standard(2, &[0x22])]);
    assert_eq!(bench.read_many(RXB0SIDH, 6), [0x00, 0x20, 0, 0, 1, 0x11]);
}

/// DS20001801J 4.2, Figure 4-3, BUKT clear: the second frame for RXB0 is lost, although RXB1 is
/// empty.
#[test]
fn without_rollover_rxb0_overflows() {
    let mut bench = Bench::normal();
    bench.peer_sends(&[Frame::standard(1, &[0x11]), Frame::standard(2, &[0x22])]);
    bench.assert_register(CANINTF, RX0IF | ERRIF);
    bench.assert_register(EFLG, RX0OVR);
    assert_eq!(bench.chip.borrow().rx_overflows(), 1);
}

/// DS20001801J 4.2: with BUKT the second frame rolls over into RXB1, whatever RXB1's filters are.
#[test]
fn with_rollover_the_second_frame_goes_to_rxb1() {
    let mut bench = Bench::new();
    bench.set_up();
    bench.write(RXM1, &[0xFF, 0xE3, 0xFF, 0xFF]);
    bench.write(RXB0CTRL, &[BUKT]);
    bench.enter(NORMAL);
    bench.peer_sends(&[Frame::standard(1, &[0x11]), Frame::extended(2, &[0x22])]);
    bench.assert_register(CANINTF, RX0IF | RX1IF);
    bench.assert_register(0x66, 0x11);
    bench.assert_register(0x76, 0x22);
    bench.assert_register(EFLG, 0);
    // RXF1 accepted the second frame: FILHIT of RXB1 and FILHIT0 show it (Register 4-1, note 1).
    bench.assert_register(RXB1CTRL, 0x01);
    bench.assert_register(RXB0CTRL, 0x07);
}

/// DS20001801J Figure 4-3: with both buffers full a rollover overflows RXB1.
#[test]
fn with_rollover_the_third_frame_overflows_rxb1() {
    let mut bench = Bench::normal();
    bench.write(RXB0CTRL, &[BUKT]);
    bench.peer_sends(&[Frame::standard(1, &[]), Frame::standard(2, &[]), Frame::standard(3, &[])]);
    bench.assert_register(CANINTF, RX0IF | RX1IF | ERRIF);
    bench.assert_register(EFLG, RX1OVR);
    assert_eq!(bench.chip.borrow().rx_overflows(), 1);
}

/// DS20001801J 4.2: RXB0 is used again as soon as it is free, so the order of frames can change.
#[test]
fn after_a_rollover_rxb0_is_filled_again_first() {
    let mut bench = Bench::normal();
    bench.write(RXB0CTRL, &[BUKT]);
    bench.peer_sends(&[Frame::standard(1, &[]), Frame::standard(2, &[])]);
    bench.modify(CANINTF, RX0IF, 0);
    bench.peer_sends(&[Frame::standard(3, &[])]);
    assert_eq!(bench.read_many(RXB0SIDH, 2), [0x00, 0x60]);
    assert_eq!(bench.read_many(RXB1SIDH, 2), [0x00, 0x40]);
}

/// DS20001801J Register 4-1, note 1: only a rollover changes RXB0's FILHIT0.
#[test]
fn a_frame_for_rxb1_does_not_change_rxb0ctrl() {
    let mut bench = Bench::new();
    bench.set_up();
    // RXB0 takes standard identifier 7FFh only; RXF3 takes all extended frames for RXB1.
    bench.write(RXM0, &[0xFF, 0xE0]);
    bench.write(RXF[0], &[0xFF, 0xE0]);
    bench.write(RXF[1], &[0xFF, 0xE0]);
    bench.write(RXB0CTRL, &[BUKT]);
    bench.enter(NORMAL);
    bench.peer_sends(&[Frame::standard(0x7FF, &[]), Frame::extended(1, &[])]);
    bench.assert_register(RXB1CTRL, 0x03);
    bench.assert_register(RXB0CTRL, 0x06);
}

/// DS20001801J Figure 4-3: there is no rollover from RXB1 to RXB0.
#[test]
fn rxb1_does_not_roll_over() {
    let mut bench = Bench::new();
    bench.set_up();
    bench.write(RXM0, &[0xFF, 0xE3, 0xFF, 0xFF]);
    bench.write(RXB0CTRL, &[BUKT]);
    bench.enter(NORMAL);
    bench.peer_sends(&[Frame::standard(1, &[0x11]), Frame::standard(2, &[0x22])]);
    bench.assert_register(CANINTF, RX1IF | ERRIF);
    bench.assert_register(EFLG, RX1OVR);
    bench.assert_register(0x76, 0x11);
}

/// DS20001801J 7.6.1, 7.7: the MCU must clear RXnOVR before ERRIF.
#[test]
fn errif_cannot_be_cleared_before_the_overflow_flag() {
    let mut bench = Bench::normal();
    bench.peer_sends(&[Frame::standard(1, &[]), Frame::standard(2, &[])]);
    bench.modify(CANINTF, ERRIF, 0);
    bench.assert_register(CANINTF, RX0IF | ERRIF);
    bench.modify(EFLG, RX0OVR, 0);
    bench.assert_register(EFLG, 0);
    bench.modify(CANINTF, ERRIF, 0);
    bench.assert_register(CANINTF, RX0IF);
}

/// DS20001801J 7.3: the flag is set right after the end of frame.
#[test]
fn the_flag_is_set_at_the_end_of_the_frame() {
    let mut bench = Bench::normal();
    bench.peer.borrow_mut().send(Frame::standard(0x123, &[1, 2]));
    while bench.chip.borrow().register(CANINTF) == 0 {
        bench.run_bits(1);
    }
    let set = bench.now;
    bench.run_bits(20);
    let record = bench.bus.take_records().pop().expect("a frame");
    let early = record.end.saturating_sub(set);
    assert!(early <= 2 * BIT && set <= record.end + BIT, "set at {set}, frame {record:?}");
}

/// DS20001801J 2.0, 6.0: a frame with an error is not received.
#[test]
fn a_frame_with_an_error_is_not_received() {
    let mut bench = Bench::normal();
    bench.bus.inject(can_model::Fault::FlipBit { bit: 25 });
    bench.peer.borrow_mut().send(Frame::standard(0x123, &[0x55, 0x55]));
    bench.run_bits(60);
    assert_eq!(bench.read(CANINTF) & (RX0IF | MERRF), MERRF);
    bench.run_bits(FRAME_BITS);
    assert_eq!(bench.read(CANINTF) & (RX0IF | MERRF), MERRF | RX0IF, "the peer repeats it");
}

/// The log has the time of reception and the time at which the flag was cleared.
#[test]
fn the_frame_log_has_the_times_of_rxnif() {
    let mut bench = Bench::normal();
    bench.write(RXB0CTRL, &[BUKT]);
    let frames = [Frame::standard(1, &[1]), Frame::standard(2, &[2]), Frame::standard(3, &[3])];
    let before = bench.now;
    bench.peer_sends(&frames);
    let between = bench.now;
    bench.spi(&[0x94, 0, 0, 0, 0, 0, 0]);
    let cleared = bench.now;
    bench.modify(CANINTF, RX0IF, 0);

    let log = bench.chip.borrow_mut().take_frame_log();
    let summary: Vec<_> = log.iter().map(|entry| (entry.frame, entry.buffer)).collect();
    assert_eq!(summary, [(frames[2], 1), (frames[1], 1), (frames[0], 0)]);
    assert_eq!(log[0].fate, Fate::Lost);
    assert_eq!(log[1].fate, Fate::Cleared(cleared));
    assert!(matches!(log[2].fate, Fate::Cleared(at) if at > cleared && at < bench.now));
    for entry in &log {
        assert!((before..between).contains(&entry.received_at), "{entry:?}");
    }
    assert!(log[2].received_at < log[1].received_at && log[1].received_at < log[0].received_at);
}

/// A frame in its buffer is logged when it leaves, also by a reset.
#[test]
fn a_frame_is_logged_when_it_leaves() {
    let mut bench = Bench::normal();
    bench.peer_sends(&[Frame::standard(1, &[1])]);
    assert!(bench.chip.borrow_mut().take_frame_log().is_empty());
    bench.spi(&[RESET]);
    assert_eq!(bench.chip.borrow_mut().take_frame_log().len(), 1);
    assert!(bench.chip.borrow_mut().take_frame_log().is_empty());
}
