//! Error frames and overload frames bit by bit. ISO 11898-1:2003 10.4.4, 10.4.5.

use super::*;

/// A dominant CRC delimiter is an error for all nodes at once: one flag, delimiter, intermission,
/// SOF.
#[test]
fn an_error_frame_takes_fourteen_bits_when_all_see_the_error_at_once() {
    let sent = frame("555#AAAA");
    let mut lab = Lab::of(3);
    let bit = bits_of(&sent).crc_delimiter;
    lab.send(0, sent);
    lab.disturb(bit, None, Level::Dominant);
    let flag = lab.bit + bit + 1;
    lab.settle();
    let sof = flag + ACTIVE_FLAG + DELIMITER + INTERMISSION;
    for node in 0..3 {
        assert!(lab.drove_dominant(node, flag..flag + ACTIVE_FLAG));
        assert!(lab.drove_nothing(node, flag + ACTIVE_FLAG..sof));
    }
    assert!(lab.drove_dominant(0, sof..sof + 1), "the repetition");
    assert_eq!(lab.errors_of(0), [ErrorKind::Bit]);
    assert_eq!(lab.errors_of(1), [ErrorKind::Form]);
}

/// A receiver detects the sender's flag as an error, up to six bits later.
#[test]
fn flags_of_nodes_that_see_the_error_later_follow_and_overlap() {
    let sent = frame("555#AAAA");
    let mut lab = Lab::of(2);
    let start = lab.bit;
    lab.send(0, sent);
    lab.disturb(22, 0, !sent.wire_bits()[22]);
    lab.settle();
    let flag = start + 23;
    assert!(lab.drove_dominant(0, flag..flag + ACTIVE_FLAG));
    let is_stuff_error = |event| matches!(event, Event::Error { kind: ErrorKind::Stuff, .. });
    let seen = lab.bits_where(1, is_stuff_error)[0];
    assert!(flag < seen && seen < flag + ACTIVE_FLAG);
    let end = seen + 1 + ACTIVE_FLAG;
    assert!(lab.drove_dominant(1, seen + 1..end));
    let sof = end + DELIMITER + INTERMISSION;
    assert!(lab.drove_nothing(0, flag + ACTIVE_FLAG..sof));
    assert!(lab.drove_dominant(0, sof..sof + 1), "the repetition");
}

#[test]
fn a_passive_receiver_signals_with_recessive_bits_and_disturbs_no_node() {
    let sent = frame("555#AAAAAAAA");
    let mut lab = Lab::of(3);
    lab.raise_rec(1, 128);
    let start = lab.bit;
    lab.send(0, sent);
    lab.disturb(25, 1, !sent.wire_bits()[25]);
    lab.settle();
    assert_eq!(lab.errors_of(1), [ErrorKind::Crc]);
    assert!(lab.drove_nothing(1, start..lab.bit));
    assert_eq!(lab.received(1), []);
    assert_eq!(lab.received(2), [sent]);
    assert_eq!(lab.errors_of(0), []);
}

/// ISO 11898-1: a dominant bit in the first two bits of the intermission.
#[test]
fn a_dominant_bit_early_in_the_intermission_forces_an_overload_frame() {
    let sent = frame("123#00");
    for bit in [1, 2] {
        let mut lab = Lab::of(2);
        lab.send(0, sent);
        lab.send(0, sent);
        let at = bits_of(&sent).last_eof + bit;
        lab.disturb(at, None, Level::Dominant);
        let flag = lab.bit + at + 1;
        lab.settle();
        for node in [0, 1] {
            assert_eq!(lab.bits_where(node, |event| event == Event::Overload), [flag - 1]);
            assert!(lab.drove_dominant(node, flag..flag + ACTIVE_FLAG));
            assert_eq!(lab.counters(node), (0, 0));
        }
        let sof = flag + ACTIVE_FLAG + DELIMITER + INTERMISSION;
        assert!(lab.drove_nothing(0, flag + ACTIVE_FLAG..sof));
        assert!(lab.drove_dominant(0, sof..sof + 1));
        assert_eq!(lab.received(1), [sent; 2]);
    }
}

/// In the eighth bit of a delimiter a dominant bit starts an overload frame; earlier it is a form
/// error.
#[test]
fn a_dominant_bit_in_a_delimiter_is_an_error_except_in_its_last_bit() {
    for (bit, overload) in [(2, false), (7, false), (8, true)] {
        let mut lab = Lab::of(2);
        let start = lab.bit;
        lab.send(0, frame("123#"));
        let first_error = bits_of(&frame("123#")).last_eof - 3;
        lab.disturb(first_error, None, Level::Dominant);
        let at = first_error + ACTIVE_FLAG + bit;
        lab.disturb(at, None, Level::Dominant);
        lab.settle();
        for node in [0, 1] {
            let overloads = lab.bits_where(node, |event| event == Event::Overload);
            let errors = lab.bits_where(node, |event| matches!(event, Event::Error { .. }));
            assert_eq!(overloads.contains(&(start + at)), overload, "bit {bit}");
            assert_eq!(errors.contains(&(start + at)), !overload, "bit {bit}");
        }
        assert_eq!(lab.received(1), [frame("123#")]);
    }
}

/// The flag of the error that makes the node passive is still active (ISO 11898-1 13.1.4.2 i).
#[test]
fn the_error_that_makes_a_node_passive_is_signalled_actively() {
    let mut lab = Lab::of(1);
    lab.send(0, frame("123#"));
    while lab.engines[0].error_state() == ErrorState::Active {
        lab.step();
    }
    let flag = lab.bit;
    lab.run(ACTIVE_FLAG);
    assert!(lab.drove_dominant(0, flag..flag + ACTIVE_FLAG));
}

/// A passive flag ends after six equal bits, even if they are another node's active flag.
#[test]
fn a_passive_flag_ends_with_six_equal_bits_of_either_level() {
    let mut lab = Lab::of(1);
    lab.raise_rec(0, 128);
    let rec = lab.engines[0].rec();
    // A SOF and five more dominant bits: a stuff error. Then two recessive and six dominant bits.
    let bits = "000000".to_owned() + "11" + "000000" + "11111111" + "111";
    for bit in bits.chars() {
        lab.disturb(0, None, Level::from_bit(bit == '1'));
        lab.step();
    }
    assert!(lab.engines[0].is_idle());
    assert_eq!(lab.engines[0].rec(), (rec + 1).min(255), "no dominant bit after the flag");
}

#[test]
fn a_bit_error_in_an_active_flag_adds_eight_and_restarts_it() {
    let mut lab = Lab::of(1);
    for bit in "000000".chars() {
        lab.disturb(0, None, Level::from_bit(bit == '1'));
        lab.step();
    }
    let flag = lab.bit;
    lab.disturb(2, None, Level::Recessive);
    lab.run(3 + ACTIVE_FLAG);
    assert_eq!(lab.counters(0), (0, 9));
    assert!(lab.drove_dominant(0, flag..flag + 3 + ACTIVE_FLAG));
    lab.run(DELIMITER + INTERMISSION);
    assert!(lab.engines[0].is_idle());
}
