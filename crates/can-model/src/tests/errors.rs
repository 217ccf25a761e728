//! Each kind of error: the node that detects it, and the bit. ISO 11898-1:2003 10.11.

use super::script::{FromSof, run_all};
use super::*;

/// 555#AAAAAAAA has no stuff bits up to the data, which begins at bit 19, and alternating bits in
/// it. A receiver receives only the repetition of a frame with an error.
#[test]
fn each_kind_of_error() {
    run_all::<FromSof>(
        "
a sender that reads back another level than that of its data has a bit error, and signals it
    each $bit: 19, 20
    nodes 3; send 0 555#AAAAAAAA; flip $bit 0; settle; errors 0 Bit; at $bit 0 Bit
    dominant 0 $bit+1 $bit+7; got 1 555#AAAAAAAA
a SOF or a dominant identifier bit that appears recessive is a bit error, no lost arbitration
    each $bit: 0, 2
    nodes 3; send 0 555#AAAAAAAA; see $bit 0 1; settle; at $bit 0 Bit
six equal bits are a stuff error for a receiver. Bit 5 is the stuff bit
    nodes 2; send 0 00F#; see 5 1 0; settle; at 5 1 Stuff; dominant 1 6 12; got 1 00F#
13.1.4.2 c) exception 2: a stuff bit that is overruled during arbitration does not count
    nodes 2; send 0 00F#; see 5 all 0; run 6; at 5 0 Stuff; counters 0 0 0; counters 1 0 1
the stuff bit after RTR, bit 14, does not belong to the arbitration field
    nodes 2; send 0 010#; see 14 all 0; run 15; errors 0 Bit; counters 0 8 0
a receiver with a wrong CRC withholds its ACK and flags after the ACK delimiter, in the others' EOF
    nodes 3; send 0 555#AAAAAAAA; see 25 1 0; settle; recessive 1 ack ack+2; dominant 2 ack ack+1
    at ack+1 1 Crc; dominant 1 ack+2 ack+8; at ack+2 2 Form; at ack+2 0 Bit
    got 1 555#AAAAAAAA; got 2 555#AAAAAAAA
a dominant bit where the format requires a recessive one is a form error
    each $bit: crc, ack+1, ack+2, eof-1
    nodes 3; send 0 555#AAAAAAAA; see $bit 1 0; settle; at $bit 1 Form; got 1 555#AAAAAAAA
a frame that nobody acknowledges is an ACK error
    nodes 1; send 0 555#AAAAAAAA; run 100; at ack 0 Ack; dominant 0 ack+1 ack+7
a receiver whose ACK does not show has a bit error
    nodes 3; send 0 555#AAAAAAAA; see ack 1 1; settle; at ack 1 Bit
10.9: a dominant last bit: receivers accept the frame and overload, and the sender repeats it
    nodes 3; send 0 555#AAAAAAAA; see eof all 0; settle; at eof 0 Bit; counters 0 7 0
    got 1 555#AAAAAAAA 555#AAAAAAAA; at eof 1 Overload; errors 1; counters 1 0 0
    got 2 555#AAAAAAAA 555#AAAAAAAA; at eof 2 Overload; errors 2; counters 2 0 0
",
    );
}

/// Inverts every bit of a frame for all stations. After each inversion the frame must be repeated,
/// and no corrupted frame may be received.
#[test]
fn any_single_bit_error_is_detected_and_the_frame_repeated() {
    for text in ["555#AAAAAAAA", "1003F20A#01000038C7", "000#", "00000000#R4"] {
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
