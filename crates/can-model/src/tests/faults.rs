//! The faults of the bus, and the recovery of the stations.

use super::script::run_all;
use super::*;

const COMMAND: &str = "1003F20A#01000038C7";

#[test]
fn faults_and_recovery() {
    run_all::<Rig>(
        "
a bit flipped for one station: it detects the error first, so it counts 8 more (rule b)
    nodes 3; flip 50 for 2; send 0 1003F20A#01000038C7; bits 500; got 1 1003F20A#01000038C7
    got 2 1003F20A#01000038C7; error frames 1; counters 0 7 0; counters 1 0 0; counters 2 0 8
a lost frame is missed by one station only
    nodes 3; lose 2; send 0 123#01; send 0 123#02; bits 500; got 1 123#01 123#02; got 2 123#02
    counters 2 0 0; error frames 0
a known weakness of CAN: one that rejects a frame in its last but one bit doubles it for the others
    nodes 3; flip 43 for 2; send 0 123#; bits 500; got 1 123# 123#; got 2 123#
a glitch on an idle bus is an error frame
    nodes 2; inject StuckDominant on; bits 1; clear; bits 100; error frames 1; counters 0 0 1
a station that misses a frame does not take it for an idle bus
    nodes 3; lose 2; send 0 123#01; bits 20; send 2 100#; bits 500; got 1 123#01 100#
    error frames 0
only a frame of another station can be lost
    nodes 3; lose 0; send 0 123#01; bits 200; got 1 123#01; send 1 123#02; send 1 123#03; bits 500
    got 0 123#03
without acknowledgement a sender repeats its frame as error-passive
    nodes 3; inject NoAck on; send 0 123#01; bits 20000; counters 0 128 0; state 0 Passive
    queued 0 1; inject NoAck off; bits 1000; queued 0 0; counters 0 127 0
with destroyed acknowledgements no frame completes, and the sender goes bus-off
    nodes 2; inject AckDestroyed on; send 0 123#01; bits 1000; queued 0 1; happened 0 Ack; bits 4000
    happened 0 BusOff; got 1; inject AckDestroyed off; bits 2000; queued 0 0; got 1 123#01
on a wire stuck dominant no frame passes, and a sender is bus-off after 31 x 8 bits. Its queue stays
    nodes 2; send 0 123#5555555555555555; bits 30; inject StuckDominant on; bits 200; wire 0
    bits 300; state 0 BusOff; state 1 Passive; got 1; clear; bits 1408; happened 0 Recovered
    bits 200; got 1 123#5555555555555555; state 0 Active
on a bus that is always recessive a sender goes bus-off, and the others receive nothing
    nodes 2; inject StuckRecessive on; send 0 123#01; bits 1000; state 0 BusOff; counters 1 0 0
    got 1; clear; bits 1608; got 1 123#01
a sender of destroyed frames goes bus-off and recovers (ISO 11898-1, fault confinement)
    nodes 3; inject DestroyFrames on; send 0 1003F20A#01000038C7; bits 60; error frames 0; bits 30
    error frames 1; bits 6310; frames 0; got 1; happened 0 BusOff; inject DestroyFrames off
    bits 1908; got 1 1003F20A#01000038C7
a disconnected station receives only itself, and no station acknowledges it
    nodes 3; connect 0 off; send 0 001#AA; send 1 123#01; bits 3000; got 2 123#01; got 0
    counters 0 128 0; frames 1; connect 0 on; bits 2000; got 2 001#AA; counters 0 127 0
",
    );
}

#[test]
fn a_flipped_bit_destroys_one_frame_which_is_repeated() {
    let mut rig = Rig::of(3);
    rig.bus.inject(Fault::FlipBit { bit: 50 });
    rig.send(0, frame(COMMAND));
    rig.run_bits(500);
    let records = rig.bus.take_records();
    assert_eq!(records.len(), 2);
    let RecordKind::ErrorFrame { kind: Some(_), from } = records[0].kind else {
        panic!("{records:?}");
    };
    assert_eq!(from, Some(rig.ports[0]));
    assert_eq!((records[0].end - records[0].start) / BIT, u64::from(records[0].bits));
    assert!((51 + 6 + 8..=51 + 12 + 8).contains(&records[0].bits), "{}", records[0].bits);
    // Three bits of intermission, then the repetition.
    assert_eq!(records[1].start, records[0].end + 3 * BIT);
    assert_eq!(rig.received(1), [frame(COMMAND)]);
    assert_eq!(rig.bus.stats().error_frames, 1);
}

#[test]
fn without_acknowledgement_a_sender_repeats_for_ever_and_stays_on_the_bus() {
    let mut rig = Rig::of(1);
    rig.send(0, frame(COMMAND));
    rig.run_bits(20_000);
    assert_eq!(rig.counters(0), (128, 0));
    assert_eq!(rig.nodes[0].borrow().error_state(), ErrorState::Passive);
    let records = rig.bus.take_records();
    let errors = records.iter().take_while(|record| {
        let kind = Some(ErrorKind::Ack);
        record.kind == RecordKind::ErrorFrame { kind, from: Some(rig.ports[0]) }
    });
    assert_eq!(errors.count(), 16, "active flags destroy the frame and passive ones do not");
    let whole = RecordKind::Frame { frame: frame(COMMAND), from: Some(rig.ports[0]), acked: false };
    assert!(records.len() > 100 && records[16..].iter().all(|record| record.kind == whole));
}

#[test]
fn noise_also_inverts_idle_bits() {
    let mut rig = Rig::of(2);
    rig.bus.inject(Fault::BitErrorRate { per_million: 100, seed: 3 });
    rig.run_bits(1_000_000);
    let errors = rig.bus.stats().error_frames;
    assert!((70..130).contains(&errors), "{errors}");
    rig.bus.inject(Fault::BitErrorRate { per_million: 0, seed: 0 });
    rig.run_bits(1_000_000);
    assert_eq!(rig.bus.stats().error_frames, errors);
}
