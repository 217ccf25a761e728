//! The error counters over whole sequences: error-passive, suspended, bus-off and recovery.
//! ISO 11898-1:2003 13.1.4.

use super::script::{FromSof, run_all};
use super::*;

const SUSPEND: u64 = 8;

fn is_ack_error(event: Event) -> bool {
    event == Event::Error { kind: ErrorKind::Ack, transmitting: true }
}

#[test]
fn counters_of_sequences() {
    run_all::<FromSof>(
        "
a dominant bit during the passive flag of an ACK error adds 8. The SOF is 25 bits after the error
    nodes 1; send 0 123#; until 0 Passive; from now; see 28+ack 0 0; run 80; counters 0 136 0
a suspended node lets other nodes send first, even with a lower priority
    nodes 2; mode 1 Off; send 0 100#; until 0 Passive; mode 1 Normal; send 1 700#; settle
    sent 700# 100#; counters 0 127 0
each success decrements the counter by one
    nodes 2; send 0 555#AAAA; flip 20 all; settle; counters 0 7 0; counters 1 0 0
    send 0 555#AAAA; settle; counters 0 6 0; send 0 555#AAAA; settle; counters 0 5 0
a receiver of a valid frame counts one less, and a passive one, active again, 119
    each $before $state $rec: 127 Active 126, 128 Passive 119, 255 Passive 119
    nodes 2; rec 1 $before; state 1 $state; counters 1 0 $before; send 0 123#; settle
    counters 1 0 $rec; state 1 Active
REC stops at 255
    nodes 1; rec 0 255; rec 0 255; from now; see 0 0 0; run 14; counters 0 0 255
b), f): dominant bits after a receiver's flag count at the first and every eighth
    nodes 1; from now; hold 0 6 0; to 12; counters 0 0 1; hold 12 36 0; to 13; counters 0 0 9
    to 19; counters 0 0 9; to 20; counters 0 0 17; to 27; counters 0 0 17; to 28; counters 0 0 25
    to 35; counters 0 0 25; to 36; counters 0 0 33; settle; counters 0 0 33
f): dominant bits after a sender's flag count at every eighth
    nodes 1; send 0 123#; hold ack+7 ack+31 0; to ack+7; counters 0 8 0; to ack+14; counters 0 8 0
    to ack+15; counters 0 16 0; to ack+22; counters 0 16 0; to ack+23; counters 0 24 0
    to ack+30; counters 0 24 0; to ack+31; counters 0 32 0
f): dominant bits after an overload flag, of which the node is still the transmitter
    nodes 2; send 0 123#; see eof+1 all 0; hold eof+8 eof+24 0; to eof+15; counters 0 0 0
    counters 1 0 0; to eof+16; counters 0 8 0; counters 1 0 8; to eof+23; counters 0 8 0
    counters 1 0 8; to eof+24; counters 0 16 0; counters 1 0 16
listening only keeps the counters at zero
    nodes 2; rec 1 50; mode 1 ListenOnly; counters 1 0 0; run 11; from now; see 0 1 0; run 40
    errors 1 Stuff; counters 1 0 0
",
    );
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
    let end = start + 128 * 11;
    assert!(lab.drove(0, Level::Recessive, start..end));
    assert!(lab.drove(0, Level::Dominant, end..end + 1), "the node must send again");
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
