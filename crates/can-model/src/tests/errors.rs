//! Each kind of error: the node that detects it, and the bit. ISO 11898-1:2003 10.11.

use super::*;

/// No stuff bits up to the data, and alternating bits in it, so that `data_bit(n)` is simple.
const PLAIN: &str = "555#AAAAAAAA";

/// Number of the wire bit of the `n`th data bit of [`PLAIN`], if nothing before it is stuffed.
fn data_bit(n: u64) -> u64 {
    1 + 11 + 3 + 4 + n
}

fn error(kind: ErrorKind, transmitting: bool) -> Event {
    Event::Error { kind, transmitting }
}

/// One frame from node 0 to 1 and 2 with one disturbed bit.
fn disturbed(bit: u64, victim: impl Into<Option<usize>>, level: Level) -> (Lab, u64) {
    let mut lab = Lab::of(3);
    let start = lab.bit;
    lab.send(0, frame(PLAIN));
    lab.disturb(bit, victim, level);
    lab.settle();
    (lab, start)
}

#[test]
fn a_sender_that_reads_back_another_level_has_a_bit_error() {
    // Data bit 1 of AA is 0, bit 0 is 1.
    for (bit, level) in [(data_bit(1), Level::Recessive), (data_bit(0), Level::Dominant)] {
        let (lab, start) = disturbed(bit, 0, level);
        assert_eq!(lab.errors_of(0), [ErrorKind::Bit]);
        assert_eq!(lab.bits_where(0, |event| event == error(ErrorKind::Bit, true)), [start + bit]);
        let flag = start + bit + 1;
        assert!(lab.drove_dominant(0, flag..flag + ACTIVE_FLAG));
        assert_eq!(lab.received(1), [frame(PLAIN)], "the frame must be sent again");
    }
}

/// A dominant identifier bit that appears recessive is no lost arbitration.
#[test]
fn a_dominant_identifier_bit_that_vanishes_is_a_bit_error() {
    let (lab, start) = disturbed(2, 0, Level::Recessive);
    let bits = lab.bits_where(0, |event| event == error(ErrorKind::Bit, true));
    assert_eq!(bits, [start + 2]);
    let (lab, start) = disturbed(0, 0, Level::Recessive);
    let bits = lab.bits_where(0, |event| event == error(ErrorKind::Bit, true));
    assert_eq!(bits, [start], "the SOF");
}

#[test]
fn six_equal_bits_are_a_stuff_error_for_a_receiver() {
    let mut lab = Lab::of(2);
    let start = lab.bit;
    let sent = frame("00F#");
    lab.send(0, sent);
    // SOF and the first four identifier bits are dominant; bit 5 is the stuff bit.
    assert_eq!(sent.wire_bits()[5], Level::Recessive);
    lab.disturb(5, 1, Level::Dominant);
    lab.settle();
    assert_eq!(lab.bits_where(1, |event| event == error(ErrorKind::Stuff, false)), [start + 5]);
    assert!(lab.drove_dominant(1, start + 6..start + 6 + ACTIVE_FLAG));
    assert_eq!(lab.received(1), [sent]);
}

/// ISO 11898-1 13.1.4.2 c) exception 2.
#[test]
fn a_stuff_bit_overruled_during_arbitration_does_not_count() {
    let mut lab = Lab::of(2);
    let start = lab.bit;
    lab.send(0, frame("00F#"));
    lab.disturb(5, None, Level::Dominant);
    lab.run(6);
    assert_eq!(lab.bits_where(0, |event| event == error(ErrorKind::Stuff, true)), [start + 5]);
    assert_eq!(lab.counters(0), (0, 0));
    assert_eq!(lab.counters(1), (0, 1));
}

/// The stuff bit after RTR does not belong to the arbitration field.
#[test]
fn a_stuff_bit_overruled_after_arbitration_counts() {
    let sent = frame("010#");
    let mut lab = Lab::of(2);
    lab.send(0, sent);
    // 0 00000 1 0000 [0 RTR -> five dominant] 1: SOF and 5 bits hold one stuff bit of their own.
    let bits = sent.wire_bits();
    let stuff_bit = 14;
    assert!(bits[stuff_bit - 5..stuff_bit].iter().all(|level| level.is_dominant()));
    lab.disturb(stuff_bit as u64, None, Level::Dominant);
    lab.run(stuff_bit as u64 + 1);
    assert_eq!(lab.errors_of(0), [ErrorKind::Bit]);
    assert_eq!(lab.counters(0), (8, 0));
}

#[test]
fn a_receiver_with_a_wrong_crc_withholds_its_ack_and_flags_after_the_ack_delimiter() {
    let (lab, start) = disturbed(data_bit(6), 1, Level::Dominant);
    let ack_slot = start + bits_of(&frame(PLAIN)).ack_slot;
    assert!(lab.drove_nothing(1, ack_slot..ack_slot + 2));
    assert!(lab.drove_dominant(2, ack_slot..ack_slot + 1), "the other receiver must acknowledge");
    assert_eq!(lab.bits_where(1, |event| event == error(ErrorKind::Crc, false)), [ack_slot + 1]);
    assert!(lab.drove_dominant(1, ack_slot + 2..ack_slot + 2 + ACTIVE_FLAG));
    // The others detect its flag in the end of frame.
    assert_eq!(lab.bits_where(2, |event| event == error(ErrorKind::Form, false)), [ack_slot + 2]);
    assert_eq!(lab.bits_where(0, |event| event == error(ErrorKind::Bit, true)), [ack_slot + 2]);
    for receiver in [1, 2] {
        assert_eq!(
            lab.received(receiver),
            [frame(PLAIN)],
            "a receiver must receive only the repetition"
        );
    }
}

#[test]
fn a_dominant_fixed_bit_is_a_form_error() {
    let bits = bits_of(&frame(PLAIN));
    let fixed = [bits.crc_delimiter, bits.ack_slot + 1, bits.ack_slot + 2, bits.last_eof - 1];
    for bit in fixed {
        let (lab, start) = disturbed(bit, 1, Level::Dominant);
        let at = lab.bits_where(1, |event| event == error(ErrorKind::Form, false));
        assert_eq!(at, [start + bit]);
        assert_eq!(lab.received(1), [frame(PLAIN)]);
    }
}

#[test]
fn a_frame_that_nobody_acknowledges_is_an_ack_error() {
    let mut lab = Lab::of(1);
    let start = lab.bit;
    lab.send(0, frame(PLAIN));
    let ack_slot = start + bits_of(&frame(PLAIN)).ack_slot;
    lab.run(100);
    assert_eq!(lab.bits_where(0, |event| event == error(ErrorKind::Ack, true)), [ack_slot]);
    assert!(lab.drove_dominant(0, ack_slot + 1..ack_slot + 1 + ACTIVE_FLAG));
}

#[test]
fn a_receiver_whose_ack_does_not_show_has_a_bit_error() {
    let bits = bits_of(&frame(PLAIN));
    let (lab, start) = disturbed(bits.ack_slot, 1, Level::Recessive);
    let at = lab.bits_where(1, |event| event == error(ErrorKind::Bit, false));
    assert_eq!(at, [start + bits.ack_slot]);
}

/// ISO 11898-1 10.9: the frame is valid for receivers, which answer with an overload frame, but not
/// for the sender, which repeats it. This is the only case in which CAN delivers a frame twice.
#[test]
fn a_dominant_last_bit_is_accepted_by_receivers_and_repeated_by_the_sender() {
    let bits = bits_of(&frame(PLAIN));
    let (lab, start) = disturbed(bits.last_eof, None, Level::Dominant);
    let last = start + bits.last_eof;
    for receiver in [1, 2] {
        assert_eq!(lab.received(receiver), [frame(PLAIN); 2]);
        assert_eq!(lab.bits_where(receiver, |event| event == Event::Overload), [last]);
        assert_eq!(lab.errors_of(receiver), []);
        assert_eq!(lab.counters(receiver), (0, 0));
    }
    assert_eq!(lab.bits_where(0, |event| event == error(ErrorKind::Bit, true)), [last]);
    assert_eq!(lab.counters(0), (7, 0), "8 for the error, 1 less for the repetition");
}

/// Inverts every bit of a frame for all stations. After each inversion the frame must be repeated,
/// and no corrupted frame may be received.
#[test]
fn any_single_bit_error_is_detected_and_the_frame_repeated() {
    for text in [PLAIN, "1003F20A#01000038C7", "000#", "00000000#R4"] {
        let sent = frame(text);
        let bits = sent.wire_bits();
        for bit in 0..bits.len() {
            let mut lab = Lab::of(3);
            lab.send(0, sent);
            let ack_slot = bits_of(&sent).ack_slot == bit as u64;
            let level = if ack_slot { Level::Recessive } else { !bits[bit] };
            lab.disturb(bit as u64, None, level);
            lab.settle();
            let copies = if bit == bits.len() - 1 { 2 } else { 1 };
            for receiver in [1, 2] {
                assert_eq!(lab.received(receiver), vec![sent; copies], "{text} bit {bit}");
            }
            let sent_ok = lab.bits_where(0, |event| event == Event::Transmitted(sent));
            assert_eq!(sent_ok.len(), 1, "{text} bit {bit}");
        }
    }
}
