//! The faults of the bus, and the recovery of the stations.

use super::*;

const COMMAND: &str = "1003F20A#01000038C7";

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

/// Each wire bit, including the SOF and the intermission.
#[test]
fn a_flip_of_any_bit_loses_no_frame() {
    for bit in 0..frame(COMMAND).bit_count() {
        let mut rig = Rig::of(3);
        rig.bus.inject(Fault::FlipBit { bit });
        rig.send(0, frame(COMMAND));
        rig.send(0, frame("123#"));
        rig.run_bits(1_000);
        for receiver in [1, 2] {
            let mut received = rig.received(receiver);
            received.dedup();
            assert_eq!(received, [frame(COMMAND), frame("123#")], "bit {bit}");
        }
    }
}

#[test]
fn a_bit_flipped_for_one_station_destroys_the_frame_and_it_is_repeated() {
    let mut rig = Rig::of(3);
    let port = rig.ports[2];
    rig.bus.inject(Fault::FlipBitSeenBy { port, bit: 50 });
    rig.send(0, frame(COMMAND));
    rig.run_bits(500);
    assert_eq!(rig.received(1), [frame(COMMAND)]);
    assert_eq!(rig.received(2), [frame(COMMAND)]);
    assert_eq!(rig.bus.stats().error_frames, 1);
    // The station that detects the error first counts 8 more (rule b): 1 + 8, 1 less for the
    // repetition.
    assert_eq!(rig.counters(1), (0, 0));
    assert_eq!(rig.counters(2), (0, 8));
    assert_eq!(rig.counters(0), (7, 0));
}

/// A known weakness of CAN: a receiver that rejects a frame in the last but one bit makes the
/// sender repeat it for those that have accepted it.
#[test]
fn an_error_of_one_receiver_in_the_last_but_one_bit_doubles_the_frame_for_the_others() {
    let mut rig = Rig::of(3);
    let bit = bits_of(&frame(COMMAND)).last_eof as u32 - 1;
    let port = rig.ports[2];
    rig.bus.inject(Fault::FlipBitSeenBy { port, bit });
    rig.send(0, frame(COMMAND));
    rig.run_bits(500);
    assert_eq!(rig.received(1), [frame(COMMAND); 2]);
    assert_eq!(rig.received(2), [frame(COMMAND)]);
}

#[test]
fn a_lost_frame_is_missed_by_one_station_only() {
    let mut rig = Rig::of(3);
    let port = rig.ports[2];
    rig.bus.inject(Fault::LoseNextFrame { port });
    rig.send(0, frame("123#01"));
    rig.send(0, frame("123#02"));
    rig.run_bits(500);
    assert_eq!(rig.received(1), ["123#01", "123#02"].map(frame));
    assert_eq!(rig.received(2), [frame("123#02")]);
    assert_eq!(rig.counters(2), (0, 0));
    assert_eq!(rig.bus.stats().error_frames, 0);
}

/// The station must not take the missed frame for an idle bus.
#[test]
fn a_station_that_misses_a_frame_does_not_send_into_it() {
    let mut rig = Rig::of(3);
    let port = rig.ports[2];
    rig.bus.inject(Fault::LoseNextFrame { port });
    rig.send(0, frame("123#01"));
    rig.run_bits(20);
    rig.send(2, frame("100#"));
    rig.run_bits(500);
    assert_eq!(rig.received(1), ["123#01", "100#"].map(frame));
    assert_eq!(rig.bus.stats().error_frames, 0);
}

#[test]
fn only_a_frame_of_another_station_can_be_lost() {
    let mut rig = Rig::of(3);
    let port = rig.ports[0];
    rig.bus.inject(Fault::LoseNextFrame { port });
    rig.send(0, frame("123#01"));
    rig.run_bits(200);
    assert_eq!(rig.received(1), [frame("123#01")]);
    rig.send(1, frame("123#02"));
    rig.send(1, frame("123#03"));
    rig.run_bits(500);
    assert_eq!(rig.received(0), [frame("123#03")]);
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
fn without_acknowledgement_the_sender_repeats_its_frame_as_error_passive() {
    let mut rig = Rig::of(3);
    rig.bus.inject(Fault::NoAck(true));
    rig.send(0, frame(COMMAND));
    rig.run_bits(20_000);
    assert_eq!(rig.counters(0), (128, 0));
    assert_eq!(rig.nodes[0].borrow().error_state(), ErrorState::Passive);
    assert_eq!(rig.nodes[0].borrow().queued(), 1);
    rig.bus.inject(Fault::NoAck(false));
    rig.run_bits(1_000);
    assert_eq!(rig.nodes[0].borrow().queued(), 0);
    assert_eq!(rig.counters(0).0, 127);
    assert_eq!(rig.received(1).last(), Some(&frame(COMMAND)));
}

#[test]
fn a_sender_whose_acknowledgements_are_destroyed_goes_bus_off() {
    let mut rig = Rig::of(2);
    rig.bus.inject(Fault::AckDestroyed(true));
    rig.send(0, frame(COMMAND));
    rig.run_bits(5_000);
    assert!(rig.events(0).contains(&Event::BusOff));
}

#[test]
fn with_destroyed_acknowledgements_no_frame_completes() {
    let mut rig = Rig::of(2);
    rig.bus.inject(Fault::AckDestroyed(true));
    rig.send(0, frame(COMMAND));
    rig.run_bits(1_000);
    assert_eq!(rig.nodes[0].borrow().queued(), 1);
    assert!(rig.events(0).contains(&Event::Error { kind: ErrorKind::Ack, transmitting: true }));
    rig.bus.inject(Fault::AckDestroyed(false));
    rig.run_bits(1_000);
    assert_eq!(rig.nodes[0].borrow().queued(), 0);
    assert_eq!(rig.received(1), [frame(COMMAND)]);
}

#[test]
fn on_a_wire_stuck_dominant_no_frame_passes_until_it_is_released() {
    let mut rig = Rig::of(2);
    rig.send(0, frame(COMMAND));
    rig.run_bits(30);
    rig.bus.inject(Fault::StuckDominant(true));
    rig.run_bits(200);
    assert_eq!(rig.bus.level(), Level::Dominant);
    // 1 error, then 8 more for every 8 bits: the sender is bus-off after 31 x 8 of them.
    rig.run_bits(300);
    assert_eq!(rig.nodes[0].borrow().error_state(), ErrorState::BusOff);
    assert_eq!(rig.nodes[1].borrow().error_state(), ErrorState::Passive);
    assert_eq!(rig.received(1), []);
    rig.bus.clear_faults();
    rig.run_bits(128 * 11);
    assert!(rig.events(0).contains(&Event::Recovered));
    rig.run_bits(200);
    assert_eq!(rig.received(1), [frame(COMMAND)], "the queue must survive bus-off");
    assert_eq!(rig.nodes[0].borrow().error_state(), ErrorState::Active);
}

#[test]
fn on_a_bus_that_is_always_recessive_a_sender_goes_bus_off_and_the_others_see_nothing() {
    let mut rig = Rig::of(2);
    rig.bus.inject(Fault::StuckRecessive(true));
    rig.send(0, frame(COMMAND));
    rig.run_bits(1000);
    assert_eq!(rig.nodes[0].borrow().error_state(), ErrorState::BusOff);
    assert_eq!((rig.counters(1), rig.received(1)), ((0, 0), vec![]));
    rig.bus.clear_faults();
    rig.run_bits(128 * 11 + 200);
    assert_eq!(rig.received(1), [frame(COMMAND)]);
}

#[test]
fn a_glitch_on_an_idle_bus_is_an_error_frame_without_a_sender() {
    let mut rig = Rig::of(2);
    rig.bus.inject(Fault::StuckDominant(true));
    rig.run_bits(1);
    rig.bus.clear_faults();
    rig.run_bits(100);
    let records = rig.bus.take_records();
    let kind = RecordKind::ErrorFrame { kind: Some(ErrorKind::Stuff), from: None };
    assert_eq!(records.iter().map(|record| record.kind).collect::<Vec<_>>(), [kind]);
    assert_eq!(rig.counters(0), (0, 1));
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

/// Transmit errors of 8 each, until the sender is bus-off (ISO 11898-1, fault confinement).
#[test]
fn a_sender_of_destroyed_frames_goes_bus_off_and_recovers() {
    let mut rig = Rig::of(3);
    rig.bus.inject(Fault::DestroyFrames(true));
    rig.send(0, frame(COMMAND));
    rig.run_bits(32 * 200);
    let ends = rig.bus.take_records();
    assert!(
        ends.len() >= 32
            && ends.iter().all(|record| matches!(record.kind, RecordKind::ErrorFrame { .. }))
    );
    assert_eq!(rig.received(1), []);
    rig.bus.inject(Fault::DestroyFrames(false));
    rig.run_bits(128 * 11 + 500);
    assert_eq!(rig.received(1), [frame(COMMAND)]);
}
