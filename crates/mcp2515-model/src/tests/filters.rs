//! Acceptance masks and filters.

use super::support::*;
use can_model::{Frame, Id};

/// SIDH, SIDL, EID8, EID0 of an extended identifier, without EXIDE.
fn extended(id: u32) -> [u8; 4] {
    let sid = id >> 18;
    [(sid >> 3) as u8, (sid << 5) as u8 | (id >> 16 & 3) as u8, (id >> 8) as u8, id as u8]
}

fn standard(id: u16, data: [u8; 2]) -> [u8; 4] {
    [(id >> 3) as u8, (id << 5) as u8, data[0], data[1]]
}

/// A chip in which only RXF0 can match; the other filters have an identifier that is never sent.
fn with_filter(mask: [u8; 4], mut filter: [u8; 4], exide: bool) -> Bench {
    let mut bench = Bench::new();
    bench.write(CNF3, &CNF_1M);
    bench.write(RXM0, &mask);
    bench.write(RXM1, &[0xFF, 0xE3, 0xFF, 0xFF]);
    if exide {
        filter[1] |= EXIDE;
    }
    for address in RXF {
        bench.write(address, &filter);
    }
    for address in &RXF[2..] {
        bench.write(*address, &[0xFF, 0xEB, 0xFF, 0xFF]);
    }
    bench.enter(NORMAL);
    bench
}

#[track_caller]
fn assert_accepts(bench: &mut Bench, frame: Frame, accepted: bool) {
    bench.peer_sends(&[frame]);
    let flag = bench.read(CANINTF);
    assert_eq!(flag == RX0IF, accepted, "{frame}: CANINTF {flag:02X}h");
    bench.write(CANINTF, &[0]);
}

/// DS20001801J Table 4-2: where the mask bit is 0 any bit matches, where it is 1 only the filter's.
#[test]
fn extended_identifiers_match_where_the_mask_is_set() {
    let mask = 0x00FF_FF80;
    let mut bench = with_filter(extended(mask), extended(0x0003_F200), true);
    for (id, accepted) in [
        (0x0003_F200, true),
        (0x1003_F20A, true),
        (0x1F03_F27F, true),
        (0x1003_F28A, false),
        (0x1003_F30A, false),
        (0x1103_F20A, true),
        (0x1083_F20A, false),
        (0x1013_F20A, false),
    ] {
        assert_accepts(&mut bench, Frame::extended(id, &[1]), accepted);
    }
}

/// DS20001801J Table 4-2, for each bit of the identifier.
#[test]
fn each_bit_of_an_extended_identifier_is_compared() {
    let id = 0x0AAA_5555;
    let mut bench = with_filter(extended(0x1FFF_FFFF), extended(id), true);
    assert_accepts(&mut bench, Frame::extended(id, &[]), true);
    for bit in 0..29 {
        assert_accepts(&mut bench, Frame::extended(id ^ 1 << bit, &[]), false);
    }
}

/// DS20001801J Table 4-2, for each bit of a standard identifier.
#[test]
fn each_bit_of_a_standard_identifier_is_compared() {
    let id = 0x2AA;
    let mut bench = with_filter(standard(0x7FF, [0; 2]), standard(id, [0; 2]), false);
    assert_accepts(&mut bench, Frame::standard(id, &[]), true);
    for bit in 0..11 {
        assert_accepts(&mut bench, Frame::standard(id ^ 1 << bit, &[]), false);
    }
}

/// DS20001801J Register 4-11: EXIDE selects the frame format of a filter, whatever the mask is.
#[test]
fn exide_selects_standard_or_extended_frames() {
    for exide in [false, true] {
        let mut bench = with_filter([0; 4], [0; 4], exide);
        assert_accepts(&mut bench, Frame::standard(0x123, &[]), !exide);
        assert_accepts(&mut bench, Frame::extended(0x123, &[]), exide);
        assert_accepts(&mut bench, Frame::remote(Id::Standard(0x123), 0), !exide);
        assert_accepts(&mut bench, Frame::remote(Id::Extended(0x123), 0), exide);
    }
}

/// DS20001801J 4.5.1, Figure 4-4: EID8 and EID0 filter the first two data bytes of standard frames.
#[test]
fn standard_frames_are_filtered_by_their_first_two_data_bytes() {
    let mut bench =
        with_filter(standard(0x7FF, [0xFF, 0x0F]), standard(0x123, [0xC0, 0x05]), false);
    for (data, accepted) in [
        (&[0xC0, 0x05][..], true),
        (&[0xC0, 0xF5, 0x99], true),
        (&[0xC1, 0x05], false),
        (&[0xC0, 0x06], false),
        (&[0xC0, 0x05, 0, 0, 0, 0, 0, 0], true),
    ] {
        assert_accepts(&mut bench, Frame::standard(0x123, data), accepted);
    }
    assert_accepts(&mut bench, Frame::standard(0x124, &[0xC0, 0x05]), false);
}

/// DS20001801J 4.5.1: the two lowest bits of SIDL have no data bits to be compared with.
#[test]
fn eid17_and_eid16_do_not_matter_for_standard_frames() {
    let mut bench = with_filter([0xFF, 0xE3, 0, 0], [0x24, 0x63, 0, 0], false);
    assert_accepts(&mut bench, Frame::standard(0x123, &[0, 0]), true);
}

/// DS20001801J 4.5.1: data bytes are filtered in data frames only.
#[test]
fn remote_frames_are_filtered_by_identifier_alone() {
    let mut bench = with_filter(standard(0x7FF, [0xFF; 2]), standard(0x123, [0xC0, 0x05]), false);
    assert_accepts(&mut bench, Frame::remote(Id::Standard(0x123), 2), true);
    assert_accepts(&mut bench, Frame::remote(Id::Standard(0x122), 2), false);
}

/// A chip in which filter n has standard identifier 100h + n, for both buffers.
fn with_six_filters(same: &[usize]) -> Bench {
    let mut bench = Bench::new();
    bench.write(CNF3, &CNF_1M);
    bench.write(RXM0, &[0xFF, 0xE0, 0, 0, 0xFF, 0xE0, 0, 0]);
    for (n, address) in RXF.into_iter().enumerate() {
        let id = if same.contains(&n) { 0x1FF } else { 0x100 + n as u16 };
        bench.write(address, &standard(id, [0; 2]));
    }
    bench.enter(NORMAL);
    bench
}

/// DS20001801J 4.2, 4.5: mask 0 with filters 0 and 1 is for RXB0, mask 1 with filters 2 to 5 for
/// RXB1. FILHIT has the filter.
#[test]
fn each_filter_leads_to_its_buffer() {
    let mut bench = with_six_filters(&[]);
    for n in 0..6u8 {
        bench.peer_sends(&[Frame::standard(0x100 + u16::from(n), &[n])]);
        if n < 2 {
            bench.assert_register(CANINTF, RX0IF);
            bench.assert_register(RXB0CTRL, n);
            bench.assert_register(0x66, n);
        } else {
            bench.assert_register(CANINTF, RX1IF);
            bench.assert_register(RXB1CTRL, n);
            bench.assert_register(0x76, n);
        }
        bench.write(CANINTF, &[0]);
    }
    bench.peer_sends(&[Frame::standard(0x106, &[])]);
    bench.assert_register(CANINTF, 0);
}

/// DS20001801J 4.5.4: of several matching filters the lowest is reported, and one buffer takes the
/// frame.
#[test]
fn the_lowest_matching_filter_is_reported() {
    for (same, buffer, filhit) in
        [(&[0, 1, 2, 3][..], 0, 0), (&[1, 4], 0, 1), (&[2, 4], 1, 2), (&[3, 5], 1, 3), (&[5], 1, 5)]
    {
        let mut bench = with_six_filters(same);
        bench.peer_sends(&[Frame::standard(0x1FF, &[])]);
        bench.assert_register(CANINTF, RX0IF << buffer);
        bench.assert_register(RXB0CTRL + 0x10 * buffer, filhit);
    }
}

/// DS20001801J Registers 4-1, 4-2: RXM = 11 turns masks and filters off.
#[test]
fn rxm_11_receives_any_message() {
    for buffer in 0..2u8 {
        for frame in [Frame::standard(0x7AB, &[1]), Frame::extended(0x1765_4321, &[1])] {
            let mut bench = with_six_filters(&[]);
            bench.write(RXB0CTRL + 0x10 * buffer, &[0x60]);
            bench.peer_sends(&[frame]);
            bench.assert_register(CANINTF, RX0IF << buffer);
        }
    }
}

/// DS20001801J Registers 4-1, 4-2: RXM 01 and 10 are reserved (before revision H: standard or
/// extended frames only, without data byte filtering).
#[test]
fn a_reserved_rxm_is_a_violation_and_has_its_former_meaning() {
    for (rxm, standard_passes, extended_passes) in [(0x20, true, false), (0x40, false, true)] {
        let mut bench = Bench::new();
        bench.set_up();
        bench.write(RXM0 + 2, &[0xFF, 0xFF]);
        bench.enter(NORMAL);
        bench.write(RXB0CTRL, &[rxm]);
        bench.write(RXB1CTRL, &[rxm]);
        assert_eq!(bench.violations().len(), 2);
        for (frame, passes) in [
            (Frame::standard(0x123, &[0xAA, 0xBB]), standard_passes),
            (Frame::extended(0x0100_0000, &[]), extended_passes),
        ] {
            bench.peer_sends(&[frame]);
            assert_eq!(bench.read(CANINTF) != 0, passes, "{frame} with RXM {rxm:02X}h");
            bench.write(CANINTF, &[0]);
        }
    }
}
