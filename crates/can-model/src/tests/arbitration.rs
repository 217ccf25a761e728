//! Arbitration, the bit at which a frame counts as received, and the levels meanwhile.
//! ISO 11898-1:2003 10.4, 10.8, 10.9.

use super::*;

#[test]
fn a_node_that_starts_needs_eleven_recessive_bits_before_it_sends() {
    let mut lab = Lab::cold(1);
    lab.send(0, frame("123#"));
    lab.run(12);
    assert!(lab.drove_nothing(0, 0..11));
    assert!(lab.drove_dominant(0, 11..12));
}

#[test]
fn a_dominant_bit_makes_a_starting_node_wait_again() {
    let mut lab = Lab::cold(1);
    lab.send(0, frame("123#"));
    lab.disturb(10, 0, Level::Dominant);
    lab.run(23);
    assert!(lab.drove_nothing(0, 0..22));
    assert!(lab.drove_dominant(0, 22..23));
}

/// ISO 11898-1 10.9: the frame is valid in the last but one bit of end of frame for receivers, in
/// the last bit for the transmitter.
#[test]
fn a_frame_is_received_one_bit_before_it_is_transmitted() {
    for text in ["123#", "7FF#R8", "1003F20A#01000038C7", "00000000#0000000000000000"] {
        let sent = frame(text);
        let mut lab = Lab::of(2);
        let start = lab.bit;
        lab.send(0, sent);
        lab.settle();
        let last = start + bits_of(&sent).last_eof;
        assert_eq!(lab.bits_where(1, |event| event == Event::Received(sent)), [last - 1]);
        assert_eq!(lab.bits_where(0, |event| event == Event::Transmitted(sent)), [last]);
        assert_eq!(lab.events.len(), 2, "{text}: {:?}", lab.events);
    }
}

#[test]
fn the_wire_carries_the_frames_own_bits_with_the_ack_slot_dominant() {
    let sent = frame("1003F20A#01000038C7");
    let mut lab = Lab::of(2);
    let start = lab.bit as usize;
    lab.send(0, sent);
    lab.settle();
    let mut bits = sent.wire_bits();
    bits[bits_of(&sent).ack_slot as usize] = Level::Dominant;
    assert_eq!(lab.wire[start..start + bits.len()], bits);
}

#[test]
fn frames_in_a_row_are_three_bits_apart() {
    let sent = frame("123#00");
    let mut lab = Lab::of(2);
    let start = lab.bit;
    lab.send(0, sent);
    lab.send(0, sent);
    lab.settle();
    let ends = lab.bits_where(0, |event| matches!(event, Event::Transmitted(_)));
    assert_eq!(ends[1] - ends[0], u64::from(sent.bit_count()));
    assert_eq!(ends[0], start + bits_of(&sent).last_eof);
}

/// `transmitting` and `is_idle` show the engine's progress to an owner.
#[test]
fn a_node_is_transmitting_from_its_sof_to_its_last_bit() {
    let sent = frame("123#00");
    let mut lab = Lab::of(2);
    lab.send(0, sent);
    for _ in 0..=bits_of(&sent).last_eof {
        lab.step();
        let last = lab.events.contains(&(lab.bit - 1, 0, Event::Transmitted(sent)));
        assert_eq!(lab.engines[0].transmitting(), !last);
        assert!(!lab.engines[1].transmitting() && !lab.engines[1].is_idle());
    }
    lab.run(INTERMISSION - 1);
    assert!(!lab.engines[0].is_idle());
    lab.run(1);
    assert!(lab.engines[0].is_idle());
}

/// Sends all frames at once, each from its own node. Returns the order in which a listener receives
/// them.
fn order_of(frames: &[&str]) -> Vec<String> {
    let mut lab = Lab::of(frames.len() + 1);
    for (node, text) in frames.iter().enumerate() {
        lab.send(node, frame(text));
    }
    lab.settle();
    for node in 0..=frames.len() {
        assert_eq!(lab.counters(node), (0, 0), "a lost arbitration is no error");
    }
    lab.received(frames.len()).iter().map(Frame::to_string).collect()
}

#[test]
fn the_lowest_identifier_goes_first_and_nothing_is_lost() {
    let sent = ["00000003#03", "00000001#01", "1FFFFFFF#FF", "00000002#02"];
    assert_eq!(order_of(&sent), ["00000001#01", "00000002#02", "00000003#03", "1FFFFFFF#FF"]);
}

#[test]
fn a_data_frame_beats_the_remote_frame_of_its_identifier() {
    assert_eq!(order_of(&["123#R2", "123#AAAA"]), ["123#AAAA", "123#R2"]);
    assert_eq!(order_of(&["00000123#R2", "00000123#AAAA"]), ["00000123#AAAA", "00000123#R2"]);
}

/// The base identifier of 048C0000 is 123: SRR and IDE decide.
#[test]
fn a_standard_frame_beats_the_extended_frame_of_its_base_identifier() {
    assert_eq!(order_of(&["048C0000#01", "123#02"]), ["123#02", "048C0000#01"]);
    assert_eq!(order_of(&["048C0000#01", "123#R2"]), ["123#R2", "048C0000#01"]);
}

#[test]
fn a_lower_base_identifier_beats_a_standard_frame() {
    assert_eq!(order_of(&["0487FFFF#01", "123#02"]), ["0487FFFF#01", "123#02"]);
}

#[test]
fn the_loser_reports_it_once_and_receives_the_winner() {
    let mut lab = Lab::of(2);
    lab.send(0, frame("101#"));
    lab.send(1, frame("100#"));
    // SOF, identifier and one stuff bit.
    lab.run(13);
    assert_eq!(lab.events_of(0), [Event::ArbitrationLost]);
    assert!(!lab.engines[0].transmitting() && lab.engines[1].transmitting());
    lab.settle();
    assert_eq!(lab.received(0), [frame("100#")]);
    assert_eq!(lab.received(1), [frame("101#")]);
}

/// Two nodes must not use the same identifier: the protocol answers with a bit error.
#[test]
fn equal_identifiers_with_different_data_collide() {
    let mut lab = Lab::of(2);
    lab.send(0, frame("100#FF"));
    lab.send(1, frame("100#00"));
    lab.run(30);
    assert_eq!(lab.errors_of(0), [ErrorKind::Bit]);
}

#[test]
fn identical_frames_are_sent_as_one() {
    let mut lab = Lab::of(3);
    lab.send(0, frame("100#AB"));
    lab.send(1, frame("100#AB"));
    lab.settle();
    assert_eq!(lab.received(2), [frame("100#AB")]);
    assert_eq!(lab.events_of(0), [Event::Transmitted(frame("100#AB"))]);
    assert_eq!(lab.events_of(1), [Event::Transmitted(frame("100#AB"))]);
}

/// ISO 11898-1 10.4.6: a dominant third bit of the intermission is a SOF, and a node with a frame
/// to send continues with the first bit of its identifier.
#[test]
fn a_node_joins_a_sof_in_the_third_intermission_bit() {
    let first = frame("123#00");
    let mut lab = Lab::of(2);
    let start = lab.bit;
    lab.send(0, first);
    lab.send(1, frame("200#"));
    let third = u64::from(first.bit_count()) - 1;
    lab.disturb(third, None, Level::Dominant);
    lab.settle();
    let end = start + third + bits_of(&frame("200#")).last_eof;
    assert_eq!(lab.bits_where(1, |event| event == Event::Transmitted(frame("200#"))), [end]);
    assert_eq!(lab.received(0), [frame("200#")]);
    assert_eq!((lab.counters(0), lab.counters(1)), ((0, 0), (0, 0)));
}

#[test]
fn a_listen_only_node_receives_frames_and_drives_nothing() {
    let mut lab = Lab::of(3);
    lab.engines[2].set_mode(EngineMode::ListenOnly);
    lab.run(11);
    lab.send(0, frame("123#AB"));
    lab.send(2, frame("001#"));
    lab.run(100);
    assert_eq!(lab.received(2), [frame("123#AB")]);
    assert!(lab.drove_nothing(2, 0..lab.bit));
}

/// With only the listener on the bus the frame is not acknowledged.
#[test]
fn a_listen_only_node_does_not_acknowledge() {
    let mut lab = Lab::of(2);
    lab.engines[1].set_mode(EngineMode::ListenOnly);
    lab.run(11);
    lab.send(0, frame("123#AB"));
    lab.run(60);
    assert_eq!(lab.errors_of(0), [ErrorKind::Ack]);
}

/// After a missing acknowledgement the sender's error flag must not make the listener miss the next
/// frame.
#[test]
fn a_listen_only_node_receives_the_first_frame_after_an_error() {
    let sent = frame("123#AB");
    for bit in 1..=bits_of(&sent).ack_slot {
        let mut lab = Lab::of(3);
        lab.engines[2].set_mode(EngineMode::ListenOnly);
        lab.run(11);
        lab.send(0, sent);
        let level = !sent.wire_bits()[bit as usize];
        lab.disturb(bit, 0, level);
        lab.disturb(bit, 1, level);
        lab.settle();
        assert_eq!(lab.received(2), [sent], "bit {bit}");
        assert_eq!(lab.counters(2), (0, 0));
    }
}

#[test]
fn an_engine_that_is_off_neither_drives_nor_receives() {
    let mut lab = Lab::of(2);
    lab.engines[1].set_mode(EngineMode::Off);
    lab.send(0, frame("123#AB"));
    lab.send(1, frame("001#"));
    lab.run(60);
    assert!(lab.drove_nothing(1, 0..lab.bit));
    assert_eq!(lab.events_of(1), []);
    assert!(!lab.engines[1].is_idle());
}

/// Loopback: one engine on its own wire.
#[test]
fn a_self_acknowledging_engine_sends_to_itself() {
    let mut lab = Lab::of(1);
    lab.engines[0].set_self_ack(true);
    lab.send(0, frame("123#AB"));
    lab.send(0, frame("12345678#R3"));
    lab.settle();
    assert_eq!(lab.received(0), [frame("123#AB"), frame("12345678#R3")]);
    assert_eq!(lab.errors_of(0), []);
    assert_eq!(lab.counters(0), (0, 0));
}
