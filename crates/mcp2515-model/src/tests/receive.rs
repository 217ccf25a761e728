//! Receive buffers: contents, rollover, overflow, log.

use super::super::{Fate, Mode};
use super::script::run_all;
use super::support::*;
use can_model::{Frame, Id};

#[test]
fn contents() {
    run_all(
        "
Registers 4-4 to 4-9: an extended frame in RXB0. 1003F20Ah: SID 400h, EID 3F20Ah
    in NORMAL; peer 1003F20A#0102030405060708; RXB0CTRL = 01
    RXB0SIDH = 80 0B F2 0A 8 1 2 3 4 5 6 7 8
Registers 4-4 to 4-9: a standard frame
    in NORMAL; peer 5A5#EE; RXB0CTRL = 0 B4 A0 0 0 1 EE
Registers 4-1, 4-5, 4-8: remote frames have RXRTR, with SRR if standard and RTR if extended
    in NORMAL; peer 5A5#R3; RXB0CTRL = 8 B4 B0 0 0 3; CANINTF <- 0
    peer 1003F20A#R5; RXB0CTRL = 9 80 0B F2 0A 45; CANINTF <- 0; peer 001#; RXB0CTRL = 0
Register 4-9 does not specify bytes beyond the frame: old values, to detect a driver that uses them
    in NORMAL; peer 001#A5A5A5A5A5A5A5A5; CANINTF <- 0; peer 001#11
    RXB0D0 = 11 A5 A5 A5 A5 A5 A5 A5
2.0, 6.0: a frame with an error is not received. The peer repeats it
    in NORMAL; flip 25; queue 123#5555; bits 60; CANINTF & RX0IF|MERRF = MERRF; wait
    CANINTF & RX0IF|MERRF = RX0IF|MERRF
",
    );
}

#[test]
fn rollover_and_overflow() {
    run_all(
        "
4.1.3, 4.2, Figure 4-3: without BUKT a full RXB0 keeps its frame, and a second one is lost
    in NORMAL; peer 001#11 002#22; RXB0SIDH = 0 20 0 0 1 11; CANINTF = RX0IF|ERRIF; EFLG = RX0OVR
    overflows 1
4.2: with BUKT it goes to RXB1 whatever RXB1's filters are. FILHIT of both shows RXF1 (4-1, note 1)
    set up; RXM1 <- FF E3 FF FF; RXB0CTRL <- BUKT; enter NORMAL; peer 001#11 00000002#22
    CANINTF = RX0IF|RX1IF; RXB0D0 = 11; RXB1D0 = 22; EFLG = 0; RXB1CTRL = 01; RXB0CTRL = 07
Figure 4-3: with both buffers full a rollover overflows RXB1
    in NORMAL; RXB0CTRL <- BUKT; peer 001# 002# 003#; CANINTF = RX0IF|RX1IF|ERRIF; EFLG = RX1OVR
    overflows 1
4.2: RXB0 is used again as soon as it is free, so the order of frames can change
    in NORMAL; RXB0CTRL <- BUKT; peer 001# 002#; modify CANINTF RX0IF 0; CANINTF = RX1IF
    peer 003#; RXB0SIDH = 00 60; RXB1SIDH = 00 40
Register 4-1, note 1: only a rollover changes RXB0's FILHIT0. RXB0 takes 7FFh, RXF3 extended frames
    set up; RXM0 <- FF E0; RXF0 <- FF E0; RXF1 <- FF E0; RXB0CTRL <- BUKT; enter NORMAL
    peer 7FF# 00000001#; RXB1CTRL = 03; RXB0CTRL = 06
Figure 4-3: there is no rollover from RXB1 to RXB0
    set up; RXM0 <- FF E3 FF FF; RXB0CTRL <- BUKT; enter NORMAL; peer 001#11 002#22
    CANINTF = RX1IF|ERRIF; EFLG = RX1OVR; RXB1D0 = 11
7.6.1, 7.7: the MCU must clear RXnOVR before ERRIF
    in NORMAL; peer 001# 002#; modify CANINTF ERRIF 0; CANINTF = RX0IF|ERRIF
    modify EFLG RX0OVR 0; EFLG = 0; modify CANINTF ERRIF 0; CANINTF = RX0IF
",
    );
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

/// DS20001801J 7.3: the flag is set right after the end of frame.
#[test]
fn the_flag_is_set_at_the_end_of_the_frame() {
    let mut bench = Bench::normal();
    bench.peer.borrow_mut().send(Frame::standard(0x123, &[1, 2]));
    bench.run_to_flag();
    let set = bench.now;
    bench.run_bits(20);
    let record = bench.bus.take_records().pop().expect("a frame");
    let early = record.end.saturating_sub(set);
    assert!(early <= 2 * BIT && set <= record.end + BIT, "set at {set}, frame {record:?}");
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

/// A frame in its buffer is logged when it leaves, also by a reset, with the mode in which it came.
/// In listen-only mode it comes although nobody acknowledges it (10.3).
#[test]
fn a_frame_is_logged_when_it_leaves_with_the_mode_in_which_it_came() {
    for (mode, name) in [(NORMAL, Mode::Normal), (LISTEN_ONLY, Mode::ListenOnly)] {
        let mut bench = Bench::in_mode(mode);
        bench.peer.borrow_mut().send(Frame::standard(1, &[1]));
        bench.run_to_flag();
        let log = |bench: &Bench| bench.chip.borrow_mut().take_frame_log();
        assert!(log(&bench).is_empty(), "in {name:?}");
        bench.spi(&[RESET]);
        let modes: Vec<Mode> = log(&bench).iter().map(|entry| entry.mode).collect();
        assert_eq!(modes, [name]);
        assert!(log(&bench).is_empty(), "in {name:?}");
    }
}
