//! Error frames and overload frames bit by bit: a flag of 6 bits, a delimiter of 8, an intermission
//! of 3. ISO 11898-1:2003 10.4.4, 10.4.5.

use super::script::{FromSof, run_all};

#[test]
fn error_and_overload_frames() {
    run_all::<FromSof>(
        "
a dominant CRC delimiter is an error for all nodes at once: flag, delimiter, intermission, SOF
    nodes 3; send 0 555#AAAA; see crc all 0; settle; errors 0 Bit; errors 1 Form
    dominant 0 crc+1 crc+7; recessive 0 crc+7 crc+18; dominant 0 crc+18 crc+19
    dominant 1 crc+1 crc+7; recessive 1 crc+7 crc+18
    dominant 2 crc+1 crc+7; recessive 2 crc+7 crc+18
a receiver detects the sender's flag as an error, up to six bits later, and its flag follows
    nodes 2; send 0 555#AAAA; flip 22 0; settle; dominant 0 23 29; at 28 1 Stuff; dominant 1 29 35
    recessive 0 29 46; dominant 0 46 47
a passive receiver signals with recessive bits, and disturbs no node
    nodes 3; rec 1 128; from now; send 0 555#AAAAAAAA; flip 25 1; settle; errors 1 Crc; errors 0
    recessive 1 0 eof; got 1; got 2 555#AAAAAAAA
a dominant bit in the first two bits of the intermission forces an overload frame
    each $bit $sof: eof+1 eof+19, eof+2 eof+20
    nodes 2; send 0 123#00; send 0 123#00; see $bit all 0; settle; got 1 123#00 123#00
    at $bit 0 Overload; dominant 0 $bit+1 $bit+7; recessive 0 $bit+7 $bit+18; counters 0 0 0
    at $bit 1 Overload; dominant 1 $bit+1 $bit+7; counters 1 0 0; dominant 0 $bit+18 $bit+19
a dominant bit in a delimiter is an error, and in its last bit an overload
    each $bit $event: eof+5 Error, eof+10 Error, eof+11 Overload
    nodes 2; send 0 123#; see eof-3 all 0; see $bit all 0; settle; has $bit 0 $event
    has $bit 1 $event; got 1 123#
13.1.4.2 i): the flag of the error that makes a node passive is still active
    nodes 1; send 0 123#; until 0 Passive; from now; run 6; dominant 0 0 6
a passive flag ends after six equal bits, even if they are another node's active flag
    nodes 1; rec 0 128; from now; see 0 all 0; see 1 all 0; see 2 all 0; see 3 all 0; see 4 all 0
    see 5 all 0; see 8 all 0; see 9 all 0; see 10 all 0; see 11 all 0; see 12 all 0; see 13 all 0
    run 25; is 0 idle; counters 0 0 129
a bit error in an active flag adds 8 and restarts it
    nodes 1; from now; see 0 all 0; see 1 all 0; see 2 all 0; see 3 all 0; see 4 all 0; see 5 all 0
    see 8 all 1; run 15; counters 0 0 9; dominant 0 6 15; run 11; is 0 idle
",
    );
}
