//! Arbitration, the bit at which a frame counts as received, and the levels meanwhile.
//! ISO 11898-1:2003 10.4, 10.8, 10.9.

use super::script::{FromSof, run_all};
use super::*;

#[test]
fn start_and_end_of_a_frame() {
    run_all::<FromSof>(
        "
a node that starts needs eleven recessive bits before it sends
    cold 1; send 0 123#; run 12; recessive 0 0 11; dominant 0 11 12
a dominant bit makes a starting node wait again
    cold 1; send 0 123#; see 10 0 0; run 23; recessive 0 0 22; dominant 0 22 23
10.9: a frame is valid in the last but one bit of EOF for receivers, and in the last for the sender
    each $frame: 123#, 7FF#R8, 1003F20A#01000038C7, 00000000#0000000000000000, 15555555#R3, \
                 1FFFFFFF#FFFFFFFFFFFFFFFF, 000#0011223344556677_F, 123#R0, 00000000#, 555#AA55AA55
    nodes 2; send 0 $frame; settle; at eof-1 1 Received; at eof 0 Transmitted; got 1 $frame; got 0
    errors 0; errors 1; counters 0 0 0; counters 1 0 0
a stuff bit after the last bit of the CRC, as this frame has, is not taken for the delimiter
    nodes 2; send 0 009#; settle; got 1 009#; at eof 0 Transmitted; errors 0; errors 1
a node is transmitting from its SOF to its last bit, and the bus is idle three bits later
    nodes 2; send 0 123#00; send 0 123#00; run 1; is 0 sending; is 1 quiet busy; run 53
    is 0 sending; is 1 quiet busy; run 1; is 0 quiet; run 2; is 0 busy; run 1; is 0 idle
10.4.6: a node joins a SOF in the third intermission bit. It continues with its identifier
    nodes 2; send 0 123#00; send 1 200#; see eof+3 all 0; settle; at eof+50 1 Transmitted
    got 0 200#; counters 0 0 0; counters 1 0 0
",
    );
}

#[test]
fn arbitration() {
    run_all::<FromSof>(
        "
the lowest identifier goes first, and nothing is lost
    nodes 5; send 0 00000003#03; send 1 00000001#01; send 2 1FFFFFFF#FF; send 3 00000002#02; settle
    got 4 00000001#01 00000002#02 00000003#03 1FFFFFFF#FF; counters 0 0 0; counters 4 0 0
data beats remote, standard beats extended of its base identifier (123 in 048C0000), lower base wins
    each $second $first: 123#R2 123#AAAA, 00000123#R2 00000123#AAAA, 048C0000#01 123#02, \
                         048C0000#01 123#R2, 123#02 0487FFFF#01
    nodes 3; send 0 $second; send 1 $first; settle; got 2 $first $second; counters 0 0 0
    counters 1 0 0; counters 2 0 0
the loser reports it once and receives the winner
    nodes 2; send 0 101#; send 1 100#; run 13; at 12 0 ArbitrationLost; is 0 quiet; is 1 sending
    settle; got 0 100#; got 1 101#
two nodes must not use the same identifier: the protocol answers with a bit error
    nodes 2; send 0 100#FF; send 1 100#00; run 30; errors 0 Bit
identical frames are sent as one
    nodes 3; send 0 100#AB; send 1 100#AB; settle; got 2 100#AB; at eof 0 Transmitted
    at eof 1 Transmitted; got 0; got 1
",
    );
}

#[test]
fn modes() {
    run_all::<FromSof>(
        "
a listen-only node receives frames, and drives nothing
    nodes 3; mode 2 ListenOnly; run 11; send 0 123#AB; send 2 001#; run 100; got 2 123#AB
    recessive 2 0 100
without another node the frame is not acknowledged
    nodes 2; mode 1 ListenOnly; run 11; send 0 123#AB; run 60; errors 0 Ack
an engine that is off neither drives nor receives
    nodes 2; mode 1 Off; send 0 123#AB; send 1 001#; run 60; recessive 1 0 60; errors 1; got 1
    is 1 busy
loopback: a self-acknowledging engine on its own wire sends to itself
    nodes 1; loopback 0; send 0 123#AB; send 0 12345678#R3; settle; got 0 123#AB 12345678#R3
    errors 0; counters 0 0 0
",
    );
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
