//! Tests of the model with third-party drivers: firmwares with the crates `mcp2515` and `mcp25xx`,
//! which other authors wrote for the real chip. They work on the model, and what docs/decisions.md
//! says against them on the real chip shows on the model, too.
//!
//! `make third-party` builds the firmwares (`tests/third-party/` in the workspace) for both chips
//! and two CAN boards. Sections are those of Microchip DS20001801J.

mod stand;

use bench::can::{Frame, Id};
use bench::mcp2515::Fate;
use stand::{PLACES, Stand, ThirdParty, answer_to};

const FIRMWARES: [ThirdParty; 2] = [ThirdParty::Mcp2515, ThirdParty::Mcp25xx];

// Filters of `tests/third-party/job.rs`: RXF0 and RXF1 belong to RXB0, the others to RXB1.
const RXF0: u32 = 0x1234_5600;
const RXF1: u32 = 0x0ABC_DE00;
const RXF2: u32 = 0x1555_0000;
const RXF3: u16 = 0x321;
const RXF4: u32 = 0x0111_0000;
const RXF5: u16 = 0x0F0;

/// The firmwares on each chip with each CAN board.
fn on_every_board() -> impl Iterator<Item = (stand::Place, ThirdParty)> {
    PLACES.into_iter().flat_map(|place| FIRMWARES.map(|firmware| (place, firmware)))
}

/// A frame for each filter, and its buffer. The lengths are 0 to 8. Bits outside of the masks are
/// set.
fn one_for_each_filter() -> [(Frame, usize); 6] {
    [
        (Frame::extended(RXF0 | 0xA5, &[1, 2, 3, 4, 5, 6, 7, 8]), 0),
        (Frame::extended(RXF1 | 0xFE, &[]), 0),
        (Frame::extended(RXF2 | 0xBEE0, &[0x00, 0xFF, 0x55]), 1),
        (Frame::standard(RXF3, &[0xDE, 0xAD, 0xBE, 0xEF, 0x00]), 1),
        (Frame::extended(RXF4 | 0xFFFE, &[0x80]), 1),
        (Frame::standard(RXF5, &[0xFF; 7]), 1),
    ]
}

#[test]
fn frames_for_every_filter_arrive_in_their_buffer_and_get_the_right_answer() {
    for (place, firmware) in on_every_board() {
        let mut stand = Stand::at(place, firmware);
        for (frame, buffer) in one_for_each_filter() {
            stand.serve(frame);
            stand.assert_answered(&[frame]);
            let log = stand.take_frame_log();
            assert_eq!(log.len(), 1, "{firmware:?} {place:?}");
            assert_eq!((log[0].frame, log[0].buffer), (frame, buffer), "{firmware:?} {place:?}");
        }
    }
}

/// Sections 4.2 and 7.6.1: the chip has two receive buffers.
#[test]
fn a_third_frame_without_polling_is_lost_and_the_first_two_are_not() {
    let frames = [1, 2, 3, 4].map(|n| Frame::extended(RXF0 | n, &[n as u8]));
    for (place, firmware) in on_every_board() {
        let mut stand = Stand::at(place, firmware);
        stand.serve_while_busy(frames[0], &frames[1..]);
        stand.assert_reported(&frames[..3]);
        let log = stand.take_frame_log().into_iter();
        let lost: Vec<Frame> =
            log.filter(|entry| entry.fate == Fate::Lost).map(|entry| entry.frame).collect();
        assert_eq!(lost, [frames[3]], "{firmware:?} {place:?}");
    }
}

/// Both crates check RX0IF first, so they read an older frame in RXB1 second.
#[test]
fn of_frames_in_both_buffers_that_in_rxb0_is_read_first_even_if_it_is_newer() {
    let first = Frame::extended(RXF0, &[1]);
    let older = Frame::standard(RXF3, &[2, 2]);
    let newer = Frame::extended(RXF1, &[3, 3, 3]);
    for mut stand in FIRMWARES.map(Stand::new) {
        stand.serve_while_busy(first, &[older, newer]);
        stand.assert_reported(&[first, newer, older]);
    }
}

/// Section 3.2: of buffers with equal priority the chip sends the one with the highest number
/// first. Both crates fill the lowest free one.
#[test]
fn answers_that_wait_for_the_bus_are_sent_in_reverse_order() {
    // 5 ms of traffic that wins arbitration against every answer. Each request wins against the
    // answers to earlier ones.
    let noise = [Frame::standard(0, &[0x55; 8]); 40];
    let requests = [3, 2, 1].map(|n| Frame::extended(RXF0 | n << 4, &[n as u8]));
    for mut stand in FIRMWARES.map(Stand::new) {
        for frame in requests {
            stand.send(&[frame]);
            stand.send(&noise);
        }
        stand.run_ms(30);
        let reversed = [requests[2], requests[1], requests[0]];
        assert_eq!(stand.take_answers(), reversed.map(|frame| answer_to(&frame)));
    }
}

/// SRR (register 4-5) marks a standard remote frame, RTR (register 4-8) an extended one. `mcp2515`
/// checks only SRR, and `mcp25xx` only RTR. They take the other kind for a data frame, with the old
/// contents of the buffer.
#[test]
fn each_crate_knows_one_kind_of_remote_frame_and_takes_the_other_for_a_data_frame() {
    let data = [0xC0, 0xFF, 0xEE, 0x11];
    let standard = Frame::remote(Id::Standard(RXF3), 4);
    let extended = Frame::remote(Id::Extended(RXF2), 4);
    for (firmware, seen) in [
        (ThirdParty::Mcp2515, [standard, Frame::extended(RXF2, &data)]),
        (ThirdParty::Mcp25xx, [Frame::standard(RXF3, &data), extended]),
    ] {
        let mut stand = Stand::new(firmware);
        let before = Frame::extended(RXF4, &data);
        stand.serve(before);
        stand.serve(standard);
        stand.serve(extended);
        stand.assert_answered(&[before, seen[0], seen[1]]);
    }
}
