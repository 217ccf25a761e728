//! The error counters over whole sequences: error-passive, suspended, bus-off and recovery.
//! ISO 11898-1:2003 13.1.4.

use super::*;

const SUSPEND: u64 = 8;

fn is_ack_error(event: Event) -> bool {
    event == Event::Error { kind: ErrorKind::Ack, transmitting: true }
}

/// ISO 11898-1 13.1.4.2 c) exception 1 keeps the TEC of a lone node from running into bus-off.
#[test]
fn a_lone_sender_becomes_passive_at_128_and_stays_there() {
    let mut lab = Lab::of(1);
    lab.send(0, frame("123#"));
    for attempt in 1..=100 {
        let errors = lab.events.len();
        while lab.events.len() == errors {
            lab.step();
        }
        assert!(is_ack_error(lab.events[errors].2));
        assert_eq!(lab.engines[0].tec(), (attempt * 8).min(128));
    }
    assert_eq!(lab.engines[0].error_state(), ErrorState::Passive);
}

/// Bits from one SOF to the next: up to the ACK slot, flag, delimiter, intermission, and 8 bits of
/// suspend transmission for a passive node.
#[test]
fn a_passive_sender_waits_eight_bits_more_before_it_repeats() {
    let sent = frame("123#");
    let mut lab = Lab::of(1);
    lab.send(0, sent);
    lab.run(3_000);
    let to_ack = bits_of(&sent).ack_slot + 1;
    let active = to_ack + ACTIVE_FLAG + DELIMITER + INTERMISSION;
    let errors = lab.bits_where(0, is_ack_error);
    let gaps: Vec<u64> = errors.windows(2).map(|pair| pair[1] - pair[0]).collect();
    // The 16th error makes the node passive; it waits already after that frame's intermission.
    assert!(gaps[..15].iter().all(|&gap| gap == active), "{gaps:?}");
    assert!(gaps[15..].iter().all(|&gap| gap == active + SUSPEND), "{gaps:?}");
    assert!(gaps.len() > 20);
}

#[test]
fn a_dominant_bit_during_the_passive_flag_of_an_ack_error_adds_eight() {
    let sent = frame("123#");
    let mut lab = Lab::of(1);
    lab.send(0, sent);
    while lab.engines[0].tec() < 128 || !lab.engines[0].transmitting() {
        lab.step();
    }
    // One dominant bit in the flag, which starts two bits after the ACK slot.
    lab.disturb(bits_of(&sent).ack_slot + 2, None, Level::Dominant);
    lab.run(u64::from(sent.bit_count()));
    assert_eq!(lab.engines[0].tec(), 136);
}

/// A suspended node lets other nodes send first, even with a lower priority.
#[test]
fn a_passive_sender_lets_other_nodes_send_first() {
    let mut lab = Lab::of(2);
    lab.engines[1].set_mode(EngineMode::Off);
    lab.send(0, frame("100#"));
    while lab.engines[0].tec() < 128 {
        lab.step();
    }
    lab.engines[1].set_mode(EngineMode::Normal);
    lab.send(1, frame("700#"));
    lab.settle();
    let sent = lab.events.iter().filter_map(|&(_, _, event)| match event {
        Event::Transmitted(frame) => Some(frame),
        _ => None,
    });
    assert_eq!(sent.collect::<Vec<_>>(), [frame("700#"), frame("100#")]);
    assert_eq!(lab.engines[0].tec(), 127);
}

#[test]
fn each_success_decrements_the_counters_by_one() {
    let sent = frame("555#AAAA");
    let mut lab = Lab::of(2);
    lab.send(0, sent);
    lab.disturb(20, None, !sent.wire_bits()[20]);
    lab.settle();
    let (tec, rec) = (lab.engines[0].tec(), lab.engines[1].rec());
    assert_eq!((tec, rec), (7, 0));
    for left in (0..7).rev() {
        lab.send(0, sent);
        lab.settle();
        assert_eq!(lab.engines[0].tec(), left);
    }
}

#[test]
fn a_passive_receiver_is_active_again_with_119_after_a_success() {
    let mut lab = Lab::of(2);
    lab.raise_rec(1, 128);
    assert_eq!(lab.engines[1].error_state(), ErrorState::Passive);
    lab.send(0, frame("123#"));
    lab.settle();
    assert_eq!(lab.engines[1].rec(), 119);
    assert_eq!(lab.engines[1].error_state(), ErrorState::Active);
}

/// Feeds an engine a stuff error as a receiver (SOF and five dominant bits), and then its own flag.
fn after_a_flag() -> Lab {
    let mut lab = Lab::of(1);
    for _ in 0..6 {
        lab.disturb(0, None, Level::Dominant);
        lab.step();
    }
    assert_eq!(lab.counters(0), (0, 1));
    lab.run(ACTIVE_FLAG);
    lab
}

/// Rule b) counts the first dominant bit after the flag, rule f) the eighth, the sixteenth and so
/// on.
#[test]
fn dominant_bits_after_a_receiver_s_flag_count_at_the_first_and_every_eighth() {
    let mut lab = after_a_flag();
    let mut rec = Vec::new();
    for _ in 0..24 {
        lab.disturb(0, None, Level::Dominant);
        lab.step();
        rec.push(lab.engines[0].rec());
    }
    let expected: Vec<u16> = (1..=24).map(|bit| 9 + bit / 8 * 8).collect();
    assert_eq!(rec, expected);
    lab.settle();
    assert_eq!(lab.counters(0), (0, 33), "the delimiter has no error");
}

#[test]
fn dominant_bits_after_a_sender_s_flag_count_at_every_eighth() {
    let mut lab = Lab::of(1);
    lab.send(0, frame("123#"));
    lab.run(bits_of(&frame("123#")).ack_slot + 1 + ACTIVE_FLAG);
    assert_eq!(lab.counters(0), (8, 0));
    for bit in 1..=24 {
        lab.disturb(0, None, Level::Dominant);
        lab.step();
        assert_eq!(lab.counters(0), (8 + bit / 8 * 8, 0));
    }
}

#[test]
fn dominant_bits_after_an_overload_flag_count_at_every_eighth() {
    let sent = frame("123#");
    let mut lab = Lab::of(2);
    lab.send(0, sent);
    lab.disturb(bits_of(&sent).last_eof + 1, None, Level::Dominant);
    lab.run(bits_of(&sent).last_eof + 2 + ACTIVE_FLAG);
    for bit in 1..=16 {
        lab.disturb(0, None, Level::Dominant);
        lab.step();
        assert_eq!(lab.counters(0), (bit / 8 * 8, 0), "the node must still be the transmitter");
        assert_eq!(lab.counters(1), (0, bit / 8 * 8));
    }
}

/// A sender that has a bit error in every frame: 32 x 8 = 256.
fn driven_to_bus_off() -> Lab {
    let sent = frame("555#AAAA");
    let mut lab = Lab::of(2);
    lab.send(0, sent);
    while lab.engines[0].error_state() != ErrorState::BusOff {
        lab.step();
        if lab.engines[0].transmitting() && lab.driven[0].last() == Some(&Level::Dominant) {
            // The second dominant bit of the frame appears recessive to its sender.
            lab.disturb(1, 0, Level::Recessive);
            lab.run(2);
        }
    }
    lab
}

#[test]
fn thirty_two_bit_errors_are_bus_off() {
    let lab = driven_to_bus_off();
    assert_eq!(lab.errors_of(0), [ErrorKind::Bit; 32]);
    assert_eq!(lab.engines[0].tec(), 256);
    let last_two = &lab.events_of(0)[31..];
    let error = Event::Error { kind: ErrorKind::Bit, transmitting: true };
    assert_eq!(last_two, [error, Event::BusOff]);
    assert!(!lab.engines[0].transmitting() && !lab.engines[0].is_idle());
}

#[test]
fn bus_off_ends_after_exactly_128_times_11_recessive_bits() {
    let mut lab = driven_to_bus_off();
    lab.engines.truncate(1);
    lab.pending.truncate(1);
    lab.driven.truncate(1);
    let start = lab.bit;
    lab.run(128 * 11 + 1);
    let recovered = lab.bits_where(0, |event| event == Event::Recovered);
    assert_eq!(recovered, [start + 128 * 11 - 1]);
    assert_eq!(lab.counters(0), (0, 0));
    assert!(lab.drove_nothing(0, start..start + 128 * 11));
    assert!(
        lab.drove_dominant(0, start + 128 * 11..start + 128 * 11 + 1),
        "the node must send again"
    );
}

/// A dominant bit invalidates its own sequence of eleven, not the earlier ones.
#[test]
fn a_dominant_bit_during_recovery_restarts_only_its_sequence() {
    let mut lab = driven_to_bus_off();
    lab.engines.truncate(1);
    lab.pending = vec![VecDeque::new()];
    lab.driven.truncate(1);
    let start = lab.bit;
    lab.disturb(11 * 100 + 10, None, Level::Dominant);
    lab.settle();
    let recovered = lab.bits_where(0, |event| event == Event::Recovered);
    assert_eq!(recovered, [start + 128 * 11 + 11 - 1]);
}

/// Switching off and on does not end the recovery; a reset does.
#[test]
fn switching_a_bus_off_engine_off_and_on_restarts_its_recovery() {
    let mut lab = driven_to_bus_off();
    let mut engine = lab.engines.remove(0);
    engine.set_mode(EngineMode::Off);
    assert_eq!(engine.tec(), 256);
    engine.set_mode(EngineMode::Normal);
    for bit in 1..=128 * 11 {
        let recovered = engine.sample(Level::Recessive).next() == Some(Event::Recovered);
        assert_eq!(recovered, bit == 128 * 11);
    }
    engine.reset();
    assert_eq!((engine.tec(), engine.mode()), (0, EngineMode::Off));
}

#[test]
fn listening_only_keeps_the_counters_at_zero() {
    let mut lab = Lab::of(2);
    lab.raise_rec(1, 50);
    lab.engines[1].set_mode(EngineMode::ListenOnly);
    assert_eq!(lab.counters(1), (0, 0));
    lab.run(11);
    lab.disturb(0, 1, Level::Dominant);
    lab.run(40);
    assert_eq!(lab.errors_of(1), [ErrorKind::Stuff]);
    assert_eq!(lab.counters(1), (0, 0));
}
