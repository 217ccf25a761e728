//! Transmit buffers: requests, priority, abort, one-shot.

use super::support::*;
use can_model::{Frame, Id};

/// DS20001801J Registers 3-3 to 3-8: the frame has the contents of the buffer, and TXnIF is set.
#[test]
fn a_requested_frame_is_sent() {
    for n in 0..3u8 {
        let mut bench = Bench::normal();
        bench.spi(&[0x40 + 2 * n, 0x80, 0x0B, 0xF2, 0x0A, 3, 7, 8, 9]);
        bench.rts(1 << n);
        bench.assert_register(0x30 + 0x10 * n, TXREQ);
        bench.run_bits(FRAME_BITS);
        assert_eq!(bench.peer_received(), [Frame::extended(0x1003_F20A, &[7, 8, 9])]);
        bench.assert_register(0x30 + 0x10 * n, 0);
        bench.assert_register(CANINTF, TX0IF << n);
    }
}

/// DS20001801J Register 3-7: remote frames, empty frames, and a DLC above 8.
#[test]
fn every_kind_of_frame_can_be_sent() {
    let data = [1, 2, 3, 4, 5, 6, 7, 8];
    for (dlc, frame) in [
        (0x00, Frame::standard(0x123, &[])),
        (0x08, Frame::standard(0x123, &data)),
        (0x0F, Frame::with_dlc(Id::Standard(0x123), 15, data)),
        (0x42, Frame::remote(Id::Standard(0x123), 2)),
    ] {
        let mut bench = Bench::normal();
        let mut bytes = vec![0x40, 0x24, 0x60, 0, 0, dlc];
        bytes.extend(data);
        bench.spi(&bytes);
        bench.rts(1);
        bench.run_bits(FRAME_BITS);
        assert_eq!(bench.peer_received(), [frame]);
    }
}

/// DS20001801J 3.3: TXREQ can be set by WRITE, BIT MODIFY and RTS, with TXP in the same write.
#[test]
fn a_request_can_be_made_in_three_ways() {
    for bytes in [&[WRITE, TXB0CTRL, TXREQ | 3][..], &[BIT_MODIFY, TXB0CTRL, 0x0B, TXREQ], &[RTS0]]
    {
        let mut bench = Bench::normal();
        bench.load(0, 0x123, &[]);
        bench.spi(bytes);
        bench.run_bits(FRAME_BITS);
        assert_eq!(bench.peer_received().len(), 1, "{bytes:02X?}");
    }
}

/// DS20001801J 3.3, 12.7: the frame begins in the next bit after the end of the byte that requested
/// it, even if the bus is simulated later.
#[test]
fn a_frame_does_not_begin_before_its_request() {
    for ahead in [1, 15, 16, 17, 250, 500] {
        let mut bench = Bench::normal();
        bench.load(0, 0x123, &[]);
        bench.bus.take_records();
        let asked = bench.now + ahead;
        bench.chip.borrow_mut().select(asked);
        bench.chip.borrow_mut().end_byte(RTS0, asked);
        bench.chip.borrow_mut().deselect(asked);
        bench.run_to(asked + FRAME_BITS * BIT);
        let start = bench.bus.take_records()[0].start;
        assert!((asked..asked + BIT).contains(&start), "asked at {asked}, began at {start}");
    }
}

/// DS20001801J 3.2: the higher TXP goes first.
#[test]
fn buffers_go_in_the_order_of_their_priority() {
    for priorities in [[3, 2, 1], [1, 2, 3], [2, 3, 0], [0, 3, 1]] {
        let mut bench = Bench::normal();
        bench.occupy_bus();
        for (n, txp) in priorities.into_iter().enumerate() {
            bench.load(n as u8, 0x100 + u16::from(txp), &[]);
            bench.write(TXB0CTRL + 0x10 * n as u8, &[txp]);
        }
        bench.rts(0b111);
        bench.run_bits(3 * FRAME_BITS);
        let ids = bench.peer_ids();
        let mut sorted = priorities;
        sorted.sort_unstable_by(|a, b| b.cmp(a));
        assert_eq!(ids, sorted.map(|txp| Id::Standard(0x100 + u16::from(txp))));
    }
}

/// DS20001801J 3.2: with equal priorities, "the buffer with the highest buffer number will be sent
/// first".
#[test]
fn the_highest_buffer_number_breaks_a_tie() {
    let mut bench = Bench::normal();
    bench.occupy_bus();
    for n in 0..3 {
        bench.load(n, 0x100 + u16::from(n), &[]);
        bench.rts(1 << n);
    }
    bench.run_bits(3 * FRAME_BITS);
    assert_eq!(bench.peer_ids(), [0x102, 0x101, 0x100].map(Id::Standard));
}

/// DS20001801J 3.2: priorities are compared again before each start of frame.
#[test]
fn a_later_request_of_higher_priority_is_sent_first() {
    let mut bench = Bench::normal();
    bench.load(1, 0x101, &[0x55; 8]);
    bench.load(0, 0x100, &[]);
    bench.rts(0b011);
    bench.run_bits(30);
    bench.load(2, 0x102, &[]);
    bench.write(0x50, &[TXREQ | 1]);
    bench.run_bits(3 * FRAME_BITS);
    assert_eq!(bench.peer_ids(), [0x101, 0x102, 0x100].map(Id::Standard));
}

/// DS20001801J 3.2: TXP may be changed while the frame waits.
#[test]
fn the_priority_of_a_waiting_frame_can_be_changed() {
    let mut bench = Bench::normal();
    bench.occupy_bus();
    bench.load(0, 0x100, &[]);
    bench.load(1, 0x101, &[]);
    bench.rts(0b011);
    bench.modify(TXB0CTRL, 0x03, 0x03);
    bench.run_bits(3 * FRAME_BITS);
    assert_eq!(bench.peer_ids(), [0x100, 0x101].map(Id::Standard));
}

/// DS20001801J 3.1: TXREQ must be clear before the buffer is written.
#[test]
fn a_pending_buffer_rejects_writes() {
    for (instruction, name) in [(0x40, "TXB0SIDH"), (0x41, "TXB0D0")] {
        let mut bench = Bench::normal();
        bench.occupy_bus();
        bench.send(0x123, &[1, 2]);
        bench.spi(&[instruction, 0xAA, 0xAA]);
        bench.run_bits(2 * FRAME_BITS);
        assert_eq!(bench.peer_received(), [Frame::standard(0x123, &[1, 2])]);
        bench.assert_violation(&[name, "TXREQ", "3.1"]);
    }
}

/// DS20001801J 3.1: a buffer whose frame is on the bus cannot be written, even if the request is
/// withdrawn.
#[test]
fn a_buffer_on_the_bus_rejects_writes() {
    let mut bench = Bench::normal();
    bench.load(0, 0x123, &[0x55; 8]);
    bench.rts(1);
    bench.run_bits(20);
    bench.write(TXB0CTRL, &[0]);
    bench.write(0x36, &[0xAA]);
    bench.run_bits(FRAME_BITS);
    assert_eq!(bench.peer_received(), [Frame::standard(0x123, &[0x55; 8])]);
    bench.assert_violation(&["TXB0D0", "AAh", "3.1"]);
}

/// DS20001801J 3.1: other buffers can be written.
#[test]
fn a_free_buffer_can_be_loaded_while_another_is_sent() {
    let mut bench = Bench::normal();
    bench.load(0, 0x123, &[0x55; 8]);
    bench.rts(1);
    bench.load(1, 0x124, &[1]);
    bench.rts(2);
    bench.run_bits(2 * FRAME_BITS);
    assert_eq!(bench.peer_received().len(), 2);
}

/// DS20001801J 3.6: clearing TXREQ aborts a waiting frame without ABTF.
#[test]
fn clearing_txreq_aborts_a_waiting_frame() {
    let mut bench = Bench::normal();
    bench.occupy_bus();
    bench.send(0x123, &[]);
    bench.modify(TXB0CTRL, TXREQ, 0);
    bench.assert_register(TXB0CTRL, 0);
    bench.run_bits(2 * FRAME_BITS);
    assert!(bench.peer_received().is_empty());
    bench.assert_register(CANINTF, RX0IF);
}

/// DS20001801J 3.6: ABAT aborts all waiting frames and sets ABTF.
#[test]
fn abat_aborts_all_waiting_frames() {
    let mut bench = Bench::normal();
    bench.occupy_bus();
    for n in 0..3 {
        bench.load(n, 0x123, &[]);
    }
    bench.rts(0b101);
    bench.modify(CANCTRL, ABAT, ABAT);
    bench.assert_register(0x30, ABTF);
    bench.assert_register(0x40, 0);
    bench.assert_register(0x50, ABTF);
    bench.run_bits(2 * FRAME_BITS);
    assert!(bench.peer_received().is_empty());
    bench.modify(CANCTRL, ABAT, 0);
    bench.rts(0b100);
    bench.assert_register(0x50, TXREQ);
    bench.run_bits(FRAME_BITS);
    assert_eq!(bench.peer_received().len(), 1);
    bench.assert_register(0x50, 0);
}

/// DS20001801J 3.6, note 1: a frame on the bus continues; if it succeeds it was not aborted.
#[test]
fn an_abort_lets_the_frame_on_the_bus_finish() {
    for by_abat in [false, true] {
        let mut bench = Bench::normal();
        bench.load(0, 0x123, &[0x55; 8]);
        bench.rts(1);
        bench.run_bits(20);
        bench.abort(by_abat);
        bench.assert_register(TXB0CTRL, TXREQ);
        bench.run_bits(FRAME_BITS);
        assert_eq!(bench.peer_received().len(), 1);
        bench.assert_register(TXB0CTRL, 0);
        bench.assert_register(CANINTF, TX0IF);
    }
}

/// DS20001801J 3.6, note 1: if the attempt fails it is not repeated. Only ABAT sets ABTF.
#[test]
fn an_abort_prevents_the_next_attempt() {
    for (by_abat, flags) in [(false, TXERR), (true, TXERR | ABTF)] {
        let mut bench = Bench::normal();
        bench.unplug_peer();
        bench.load(0, 0x123, &[0x55; 8]);
        bench.rts(1);
        bench.run_bits(20);
        bench.abort(by_abat);
        bench.run_bits(FRAME_BITS);
        bench.assert_register(TXB0CTRL, flags);
        bench.assert_register(TEC, 8);
    }
}

/// DS20001801J 3.3, 3.6: a new request cancels a pending abort.
#[test]
fn a_new_request_cancels_a_pending_abort() {
    let mut bench = Bench::normal();
    bench.unplug_peer();
    bench.load(0, 0x123, &[0x55; 8]);
    bench.rts(1);
    bench.run_bits(20);
    bench.modify(TXB0CTRL, TXREQ, 0);
    bench.rts(1);
    bench.run_bits(FRAME_BITS);
    bench.assert_register(TXB0CTRL, TXREQ | TXERR);
}

/// DS20001801J 3.6: ABAT must be cleared before a frame can be sent.
#[test]
fn a_request_under_abat_is_aborted_and_a_violation() {
    let mut bench = Bench::normal();
    bench.modify(CANCTRL, ABAT, ABAT);
    bench.send(0x123, &[]);
    bench.assert_register(TXB0CTRL, ABTF);
    bench.assert_violation(&["TXB0CTRL", "ABAT", "3.6"]);
}

/// The chip sends 400h and the peer 001h at the same bit. Returns when the chip has lost
/// arbitration.
fn lose_arbitration(canctrl: u8) -> Bench {
    let mut bench = Bench::normal();
    bench.modify(CANCTRL, OSM, canctrl);
    bench.occupy_bus();
    bench.send(0x400, &[]);
    bench.peer.borrow_mut().send(Frame::standard(0x001, &[1]));
    for _ in 0..FRAME_BITS {
        bench.run_bits(1);
        if bench.chip.borrow().register(TXB0CTRL) & MLOA != 0 {
            return bench;
        }
    }
    panic!("arbitration was not lost");
}

/// DS20001801J 3.3: MLOA shows a lost arbitration. The frame is sent again, and the flag stays.
#[test]
fn lost_arbitration_is_flagged_and_the_frame_repeated() {
    let mut bench = lose_arbitration(0);
    bench.assert_register(TXB0CTRL, TXREQ | MLOA);
    bench.run_bits(2 * FRAME_BITS);
    bench.assert_register(TXB0CTRL, MLOA);
    assert_eq!(bench.peer_received(), [Frame::standard(0x400, &[])]);
    assert_eq!(bench.read(CANINTF) & (TX0IF | MERRF), TX0IF);
    bench.assert_register(TEC, 0);
}

/// DS20001801J 4.1: the winning frame is received.
#[test]
fn the_frame_that_won_is_received() {
    let mut bench = Bench::normal();
    bench.write(RXB0CTRL, &[BUKT]);
    bench.occupy_bus();
    bench.send(0x400, &[]);
    bench.peer_sends(&[Frame::standard(0x001, &[1])]);
    assert_eq!(bench.read(CANINTF) & (RX0IF | RX1IF), RX0IF | RX1IF);
    assert_eq!(bench.read_many(RXB1SIDH, 2), [0x00, 0x20]);
}

/// DS20001801J 3.4: in one-shot mode a frame that lost arbitration is not repeated, and ABTF is set
/// (3.6, note 2).
#[test]
fn one_shot_does_not_repeat_after_lost_arbitration() {
    let mut bench = lose_arbitration(OSM);
    bench.run_bits(2 * FRAME_BITS);
    bench.assert_register(TXB0CTRL, MLOA | ABTF);
    assert!(bench.peer_received().is_empty());
}

/// DS20001801J 3.3: an unacknowledged frame sets TXERR and MERRF and is repeated.
#[test]
fn a_bus_error_is_flagged_and_the_frame_repeated() {
    let mut bench = Bench::normal();
    bench.unplug_peer();
    bench.send(0x123, &[]);
    bench.run_bits(100);
    bench.assert_register(TXB0CTRL, TXREQ | TXERR);
    assert_eq!(bench.read(CANINTF) & (TX0IF | MERRF), MERRF);
    bench.bus.connect(bench.peer_port, true);
    bench.run_bits(2 * FRAME_BITS);
    bench.assert_register(TXB0CTRL, TXERR);
    assert_eq!(bench.peer_received().len(), 1);
}

/// DS20001801J 3.3: a new request clears ABTF, MLOA and TXERR.
#[test]
fn a_new_request_clears_the_flags() {
    let mut bench = Bench::normal();
    bench.unplug_peer();
    bench.modify(CANCTRL, OSM, OSM);
    bench.load(0, 0x123, &[0x55; 8]);
    bench.rts(1);
    bench.run_bits(FRAME_BITS);
    bench.assert_register(TXB0CTRL, TXERR | ABTF);
    bench.rts(1);
    bench.assert_register(TXB0CTRL, TXREQ);
}

/// DS20001801J 3.4: in one-shot mode a destroyed frame is not repeated; ABTF is set, with ABAT or
/// without (3.6, note 2).
#[test]
fn one_shot_does_not_repeat_after_an_error() {
    for abat in [0, ABAT] {
        let mut bench = Bench::normal();
        bench.unplug_peer();
        bench.modify(CANCTRL, OSM, OSM);
        bench.load(0, 0x123, &[0x55; 8]);
        bench.rts(1);
        bench.run_bits(20);
        bench.modify(CANCTRL, ABAT, abat);
        bench.run_bits(3 * FRAME_BITS);
        bench.assert_register(TXB0CTRL, TXERR | ABTF);
        bench.assert_register(TEC, 8);
        assert_eq!(bench.bus.stats().error_frames, 1);
    }
}

/// DS20001801J 3.4: one-shot mode does not affect a successful frame.
#[test]
fn one_shot_sends_as_usual() {
    let mut bench = Bench::normal();
    bench.modify(CANCTRL, OSM, OSM);
    bench.send(0x123, &[]);
    bench.run_bits(FRAME_BITS);
    bench.assert_register(TXB0CTRL, 0);
    bench.assert_register(CANINTF, TX0IF);
}

/// DS20001801J 3.3: back-to-back frames from three buffers leave no gap beyond the intermission.
#[test]
fn queued_frames_go_back_to_back() {
    let mut bench = Bench::normal();
    for n in 0..3 {
        bench.load(n, 0x123, &[]);
    }
    bench.bus.take_records();
    bench.rts(0b111);
    bench.run_bits(3 * FRAME_BITS);
    let records = bench.bus.take_records();
    assert_eq!(records.len(), 3);
    for pair in records.windows(2) {
        assert_eq!(pair[1].start - pair[0].end, 3 * BIT);
    }
}
