//! Transmit buffers: requests, priority, abort, one-shot.

use super::script::run_all;
use super::support::*;

#[test]
fn requests() {
    run_all(
        "
Registers 3-3 to 3-8: a frame has the contents of its buffer, and sets TXnIF
    each $load $n $ctrl $flag: 40 1 TXB0CTRL TX0IF, 42 2 TXB1CTRL TX1IF, 44 4 TXB2CTRL TX2IF
    in NORMAL; spi $load 80 0B F2 0A 3 7 8 9; rts $n; $ctrl = TXREQ; wait
    got 1003F20A#070809; $ctrl = 0; CANINTF = $flag
Register 3-7: remote frames, empty frames, and a DLC above 8
    each $dlc $frame: 00 123#, 08 123#0102030405060708, 0F 123#0102030405060708_F, 42 123#R2
    in NORMAL; spi 40 24 60 0 0 $dlc 1 2 3 4 5 6 7 8; rts 1; wait; got $frame
3.3: WRITE with TXP, BIT MODIFY and RTS request a frame
    each $spi: WRITE+TXB0CTRL+TXREQ|3, BIT_MODIFY+TXB0CTRL+0B+TXREQ, 81
    in NORMAL; load 0 123#; spi $spi; wait; got 123#
3.3: a new request clears ABTF, MLOA and TXERR
    in NORMAL; unplug; modify CANCTRL OSM OSM; send 123#5555555555555555; wait
    TXB0CTRL = TXERR|ABTF; rts 1; TXB0CTRL = TXREQ
3.1: a pending buffer rejects writes
    each $load $name: 40 TXB0SIDH, 41 TXB0D0
    in NORMAL; busy; send 123#0102; spi $load AA AA; wait; wait; got 123#0102
    violation $name TXREQ 3.1
3.1: a buffer whose frame is on the bus cannot be written, even if the request is withdrawn
    in NORMAL; send 123#5555555555555555; bits 20; TXB0CTRL <- 0; TXB0D0 <- AA; wait
    got 123#5555555555555555; violation TXB0D0 AAh 3.1
3.1: a free buffer can be loaded while another is sent
    in NORMAL; send 123#5555555555555555; load 1 124#01; rts 2; wait; wait
    got 123#5555555555555555 124#01
3.3: an unacknowledged frame sets TXERR and MERRF, and is repeated
    in NORMAL; unplug; send 123#; bits 100; TXB0CTRL = TXREQ|TXERR; CANINTF & TX0IF|MERRF = MERRF
    plug; wait; wait; TXB0CTRL = TXERR; got 123#
4.1: a frame that wins arbitration is received
    in NORMAL; RXB0CTRL <- BUKT; busy; send 400#; peer 001#01
    CANINTF & RX0IF|RX1IF = RX0IF|RX1IF; RXB1SIDH = 00 20
",
    );
}

#[test]
fn priorities() {
    run_all(
        "
3.2: the higher TXP goes first
    each $0 $1 $2 $sent: 3 2 1 100#+101#+102#, 1 2 3 102#+101#+100#, 2 3 0 101#+100#+102#, 0 3 1 \
                         101#+102#+100#
    in NORMAL; busy; load 0 100#; load 1 101#; load 2 102#; TXB0CTRL <- $0; TXB1CTRL <- $1
    TXB2CTRL <- $2; rts 7; wait; wait; wait; got $sent
3.2: of equal priorities \"the buffer with the highest buffer number will be sent first\"
    in NORMAL; busy; send 100#; load 1 101#; rts 2; load 2 102#; rts 4; wait; wait; wait
    got 102# 101# 100#
3.2: priorities are compared again before each start of frame
    in NORMAL; load 1 101#5555555555555555; load 0 100#; rts 3; bits 30; load 2 102#
    TXB2CTRL <- TXREQ|1; wait; wait; wait; got 101#5555555555555555 102# 100#
3.2: TXP may be changed while the frame waits
    in NORMAL; busy; load 0 100#; load 1 101#; rts 3; modify TXB0CTRL 3 3; wait; wait; wait
    got 100# 101#
",
    );
}

#[test]
fn aborts() {
    run_all(
        "
3.6: clearing TXREQ aborts a waiting frame without ABTF
    in NORMAL; busy; send 123#; modify TXB0CTRL TXREQ 0; TXB0CTRL = 0; wait; wait; got
    CANINTF = RX0IF
3.6: ABAT aborts all waiting frames, and sets ABTF
    in NORMAL; busy; load 0 123#; load 1 123#; load 2 123#; rts 5; modify CANCTRL ABAT ABAT
    TXB0CTRL = ABTF; TXB1CTRL = 0; TXB2CTRL = ABTF; wait; wait; got
    modify CANCTRL ABAT 0; rts 4; TXB2CTRL = TXREQ; wait; got 123#; TXB2CTRL = 0
3.6, note 1: a frame on the bus continues; if it succeeds it was not aborted
    each $abort: TXB0CTRL+TXREQ+0, CANCTRL+ABAT+ABAT
    in NORMAL; send 123#5555555555555555; bits 20; modify $abort; TXB0CTRL = TXREQ; wait
    got 123#5555555555555555; TXB0CTRL = 0; CANINTF = TX0IF
3.6, note 1: if the attempt fails it is not repeated. Only ABAT sets ABTF
    each $abort $flags: TXB0CTRL+TXREQ+0 TXERR, CANCTRL+ABAT+ABAT TXERR|ABTF
    in NORMAL; unplug; send 123#5555555555555555; bits 20; modify $abort; wait; TXB0CTRL = $flags
    TEC = 8
3.3, 3.6: a new request cancels a pending abort
    in NORMAL; unplug; send 123#5555555555555555; bits 20; modify TXB0CTRL TXREQ 0; rts 1; wait
    TXB0CTRL = TXREQ|TXERR
3.6: ABAT must be cleared before a frame can be sent
    in NORMAL; modify CANCTRL ABAT ABAT; send 123#; TXB0CTRL = ABTF
    violation TXB0CTRL ABAT 3.6
",
    );
}

/// The chip sends 400h and the peer 001h at the same bit: 60 bits after `send` the chip has lost
/// arbitration.
#[test]
fn one_shot_and_lost_arbitration() {
    run_all(
        "
3.3: MLOA shows a lost arbitration. The frame is sent again, and the flag stays
    in NORMAL; busy; send 400#; queue 001#01; bits 130; TXB0CTRL = TXREQ|MLOA; wait; wait
    TXB0CTRL = MLOA; got 400#; CANINTF & TX0IF|MERRF = TX0IF; TEC = 0
3.4, 3.6 note 2: in one-shot mode a frame that lost arbitration is not repeated, and sets ABTF
    in NORMAL; modify CANCTRL OSM OSM; busy; send 400#; queue 001#01; bits 130; wait; wait
    TXB0CTRL = MLOA|ABTF; got
3.4, 3.6 note 2: in one-shot mode a destroyed frame is not repeated, and sets ABTF
    each $abat: 0, ABAT
    in NORMAL; unplug; modify CANCTRL OSM OSM; send 123#5555555555555555; bits 20
    modify CANCTRL ABAT $abat; wait; wait; wait; TXB0CTRL = TXERR|ABTF; TEC = 8
3.4: one-shot mode does not affect a successful frame
    in NORMAL; modify CANCTRL OSM OSM; send 123#; wait; TXB0CTRL = 0; CANINTF = TX0IF
",
    );
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
        bench.spi_at(asked, &[0x81]);
        bench.run_to(asked + FRAME_BITS * BIT);
        let start = bench.bus.take_records()[0].start;
        assert!((asked..asked + BIT).contains(&start), "asked at {asked}, began at {start}");
    }
}

/// DS20001801J 3.3: back-to-back frames from three buffers leave no gap beyond the intermission.
#[test]
fn queued_frames_go_back_to_back() {
    let mut bench = Bench::normal();
    (0..3).for_each(|n| bench.load(n, 0x123, &[]));
    bench.bus.take_records();
    bench.rts(0b111);
    bench.run_bits(3 * FRAME_BITS);
    let records = bench.bus.take_records();
    assert_eq!(records.len(), 3);
    assert!(records.windows(2).all(|pair| pair[1].start - pair[0].end == 3 * BIT), "{records:?}");
}
