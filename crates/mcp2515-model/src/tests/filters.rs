//! Acceptance masks and filters.

use super::script::run_all;
use super::support::*;
use can_model::Frame;

#[test]
fn masks_and_filters() {
    run_all(
        "
Table 4-2: where the mask is 0 any bit of an extended ID matches, where it is 1 only the filter's
    set up; RXM0 <- 07 E3 FF 80 FF E3 FF FF; RXF0 <- FF EB FF FF; RXF1 <- 00 0B F2 00; enter NORMAL
    accepts 0003F200#01 1003F20A#01 1F03F27F#01 1103F20A#01
    rejects 1003F28A#01 1003F30A#01 1083F20A#01 1013F20A#01
Register 4-11: EXIDE selects the frame format of a filter, whatever the mask is
    set up; RXM1 <- FF E3 FF FF; RXF1 <- 0 0; enter NORMAL
    accepts 123# 123#R0; rejects 00000123# 00000123#R0
Register 4-11: ... for extended frames
    set up; RXM1 <- FF E3 FF FF; RXF0 <- 0 EXIDE; enter NORMAL
    accepts 00000123# 00000123#R0; rejects 123# 123#R0
4.5.1, Figure 4-4: EID8 and EID0 filter the first two data bytes of standard data frames
    set up; RXM0 <- FF E0 FF 0F FF E3 FF FF; RXF0 <- 24 60 C0 05; enter NORMAL
    accepts 123#C005 123#C0F599 123#C005000000000000 123#R2
    rejects 123#C105 123#C006 124#C005 122#R2
4.5.1: EID17 and EID16 have no data bits to be compared with
    set up; RXM0 <- FF E3 0 0 FF E3 FF FF; RXF0 <- 24 63 0 0; enter NORMAL; accepts 123#0000
4.2, 4.5: mask 0 and filters 0 and 1 are for RXB0, mask 1 and filters 2 to 5 for RXB1
    each $n $flag $ctrl $data: 0 RX0IF RXB0CTRL RXB0D0, 1 RX0IF RXB0CTRL RXB0D0, \
                               2 RX1IF RXB1CTRL RXB1D0, 3 RX1IF RXB1CTRL RXB1D0, \
                               4 RX1IF RXB1CTRL RXB1D0, 5 RX1IF RXB1CTRL RXB1D0
    set up; RXM0 <- FF E0 0 0 FF E0; RXF0 <- 20 00; RXF1 <- 20 20; RXF2 <- 20 40; RXF3 <- 20 60
    RXF4 <- 20 80; RXF5 <- 20 A0; enter NORMAL; peer 10$n#0$n; CANINTF = $flag; $ctrl = $n
    $data = $n; CANINTF <- 0; rejects 106#
4.5.4: of several matching filters the lowest is reported, and one buffer takes the frame
    each $0 $1 $2 $3 $4 $5 $flag $ctrl $hit: \
        F F F F 4 5 RX0IF RXB0CTRL 0, 0 F 2 3 F 5 RX0IF RXB0CTRL 1, 0 1 F 3 F 5 RX1IF \
        RXB1CTRL 2, 0 1 2 F 4 F RX1IF RXB1CTRL 3, 0 1 2 3 4 F RX1IF RXB1CTRL 5
    set up; RXM0 <- FF E0 0 0 FF E0; RXF0 <- $0 0; RXF1 <- $1 0; RXF2 <- $2 0; RXF3 <- $3 0
    RXF4 <- $4 0; RXF5 <- $5 0; enter NORMAL; peer 078#; CANINTF = $flag; $ctrl = $hit
4-1, 4-2: RXM = 11 turns masks and filters off
    each $ctrl $flag $frame: RXB0CTRL RX0IF 7AB#01, RXB0CTRL RX0IF 17654321#01, \
                             RXB1CTRL RX1IF 7AB#01, RXB1CTRL RX1IF 17654321#01
    set up; RXM0 <- FF E3 FF FF FF E3 FF FF; enter NORMAL; $ctrl <- 60; peer $frame; CANINTF = $flag
4-1, 4-2: RXM 01 and 10 are reserved; before revision H: only one format, without data filtering
    each $rxm $accepted $rejected: 20 123#AABB 01000000#, 40 01000000# 123#AABB
    set up; RXM0 <- 0 0 FF FF; enter NORMAL; RXB0CTRL <- $rxm; violation RXM; RXB1CTRL <- $rxm
    violation RXM; accepts $accepted; rejects $rejected
",
    );
}

/// DS20001801J Table 4-2, for each bit of an extended and of a standard identifier.
#[test]
fn each_bit_of_an_identifier_is_compared() {
    for (is_extended, id, bits, filter) in
        [(true, 0x0AAA_5555, 29, [0x55, 0x4A, 0x55, 0x55]), (false, 0x2AA, 11, [0x55, 0x40, 0, 0])]
    {
        let frame = |id: u32| match is_extended {
            true => Frame::extended(id, &[]),
            false => Frame::standard(id as u16, &[]),
        };
        let mut bench = Bench::new();
        bench.set_up();
        bench.write(RXM0, &[0xFF, 0xE3, 0xFF, 0xFF, 0xFF, 0xE3, 0xFF, 0xFF]);
        bench.write(RXF0, &filter);
        bench.enter(NORMAL);
        for (id, flags) in [(id, RX0IF)].into_iter().chain((0..bits).map(|bit| (id ^ 1 << bit, 0)))
        {
            bench.peer_sends(&[frame(id)]);
            assert_eq!(bench.read(CANINTF), flags, "{}", frame(id));
            bench.write(CANINTF, &[0]);
        }
    }
}
