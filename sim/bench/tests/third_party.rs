//! Tests of the model with third-party drivers: firmwares with the crates `mcp2515` and `mcp25xx`,
//! which other authors wrote for the real chip. The firmwares work on the model, and the errors of
//! these crates on the real chip show on the model, too.
//!
//! `make third-party` builds the firmwares (`tests/third-party/` in the workspace) for both chips
//! and two CAN boards. Every test runs on the default board, and some tests run on all boards. With
//! `--nocapture` the test of the costs prints the numbers for the documents. Sections are those of
//! Microchip DS20001801J.

mod stand;

use bench::can::{Frame, Id};
use bench::mcp2515::Fate;
use stand::{Instruction, PLACES, Report, SERVED_MS, Stand, ThirdParty, answer_to, milliseconds};

/// The firmwares that use their crate correctly.
const CORRECT: [ThirdParty; 2] = [ThirdParty::Mcp2515, ThirdParty::Mcp25xx];

// Masks and filters of `tests/third-party/job.rs`: RXF0 and RXF1 belong to RXB0, the others to
// RXB1.
const MASK_0: u32 = 0x1FFF_FF00;
const MASK_1: u32 = 0x1FFF_0000;
const RXF0: u32 = 0x1234_5600;
const RXF1: u32 = 0x0ABC_DE00;
const RXF2: u32 = 0x1555_0000;
const RXF3: u16 = 0x321;
const RXF4: u32 = 0x0111_0000;
const RXF5: u16 = 0x0F0;

const CANINTF: u8 = 0x2C;
const RX0IF: u8 = 1 << 0;
const RX1IF: u8 = 1 << 1;

/// The correct firmwares on each chip with each CAN board.
fn on_every_board() -> impl Iterator<Item = (stand::Place, ThirdParty)> {
    PLACES.into_iter().flat_map(|place| CORRECT.map(|firmware| (place, firmware)))
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

/// Frames that differ from a filter in one bit, and frames with the bits of a filter in the other
/// kind of identifier.
fn near_misses() -> Vec<Frame> {
    let extended = [(RXF0, MASK_0), (RXF1, MASK_0), (RXF2, MASK_1), (RXF4, MASK_1)];
    let mut frames = Vec::new();
    for (filter, mask) in extended {
        let bits = (0..29).map(|bit| 1 << bit).filter(|bit| mask & bit != 0);
        frames.extend(bits.map(|bit| Frame::extended(filter ^ bit, &[1])));
        frames.push(Frame::standard((filter >> 18) as u16, &[(filter >> 8) as u8, filter as u8]));
    }
    for filter in [RXF3, RXF5] {
        frames.extend((0..11).map(|bit| Frame::standard(filter ^ 1 << bit, &[1])));
        frames.push(Frame::extended(u32::from(filter) << 18, &[1]));
    }
    frames
}

#[test]
fn frames_for_every_filter_arrive_in_their_buffer_and_get_the_right_answer() {
    for (place, firmware) in on_every_board() {
        let mut stand = Stand::at(place, firmware);
        for (frame, buffer) in one_for_each_filter() {
            stand.serve(frame);
            stand.assert_answered(&[frame], "");
            let log = stand.take_frame_log();
            assert_eq!(log.len(), 1, "{firmware:?} {place:?}");
            assert_eq!((log[0].frame, log[0].buffer), (frame, buffer), "{firmware:?} {place:?}");
        }
    }
}

#[test]
fn two_hundred_frames_are_answered_one_by_one() {
    for mut stand in CORRECT.map(Stand::new) {
        let kinds = one_for_each_filter();
        let frames = (0..200_u8).map(|n| {
            let data = std::array::from_fn(|at| n.wrapping_mul(37).wrapping_add(at as u8));
            Frame::with_dlc(kinds[usize::from(n) % 6].0.id, n % 9, data)
        });
        let frames: Vec<Frame> = frames.collect();
        for &frame in &frames {
            stand.send(&[frame]);
            stand.run_ms(4);
        }
        stand.run_ms(SERVED_MS);
        stand.assert_answered(&frames, "");
    }
}

#[test]
fn frames_that_differ_from_a_filter_in_one_bit_are_rejected() {
    for mut stand in CORRECT.map(Stand::new) {
        stand.send(&near_misses());
        stand.run_ms(30);
        stand.assert_answered(&[], "near misses");
        assert!(stand.take_frame_log().is_empty());
        // Checks that the node still receives frames.
        let (frame, _) = one_for_each_filter()[0];
        stand.serve(frame);
        stand.assert_reported(&[frame], "afterwards");
    }
}

/// Section 4.2: with BUKT set, a frame for a full RXB0 goes to RXB1.
#[test]
fn a_second_frame_for_rxb0_rolls_over_and_both_are_read_in_order() {
    let first = Frame::extended(RXF0, &[1]);
    let second = Frame::extended(RXF0 | 1, &[2, 2]);
    let third = Frame::extended(RXF1 | 2, &[3, 3, 3]);
    for (place, firmware) in on_every_board() {
        let mut stand = Stand::at(place, firmware);
        stand.serve_while_busy(first, &[second, third]);
        stand.assert_answered(&[first, second, third], "");
        let buffers: Vec<usize> = stand.take_frame_log().iter().map(|entry| entry.buffer).collect();
        assert_eq!((&buffers[..], stand.frames_lost()), (&[0, 0, 1][..], 0), "{firmware:?}");
    }
}

/// Both crates check RX0IF first, so they read an older frame in RXB1 second.
#[test]
fn of_frames_in_both_buffers_that_in_rxb0_is_read_first_even_if_it_is_newer() {
    let first = Frame::extended(RXF0, &[1]);
    let older = Frame::standard(RXF3, &[2, 2]);
    let newer = Frame::extended(RXF1, &[3, 3, 3]);
    for mut stand in CORRECT.map(Stand::new) {
        stand.serve_while_busy(first, &[older, newer]);
        stand.assert_reported(&[first, newer, older], "");
    }
}

/// Sections 4.2 and 7.6.1: the chip has two receive buffers.
#[test]
fn a_third_frame_without_polling_is_lost_and_the_first_two_are_not() {
    let frames = [1, 2, 3, 4].map(|n| Frame::extended(RXF0 | n, &[n as u8]));
    for (place, firmware) in on_every_board() {
        let mut stand = Stand::at(place, firmware);
        stand.serve_while_busy(frames[0], &frames[1..]);
        stand.assert_reported(&frames[..3], "");
        let log = stand.take_frame_log().into_iter();
        let lost: Vec<Frame> =
            log.filter(|entry| entry.fate == Fate::Lost).map(|entry| entry.frame).collect();
        assert_eq!((&lost[..], stand.frames_lost()), (&[frames[3]][..], 1), "{firmware:?}");
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
    for mut stand in CORRECT.map(Stand::new) {
        for frame in requests {
            stand.send(&[frame]);
            stand.send(&noise);
        }
        stand.run_ms(30);
        let reversed = [requests[2], requests[1], requests[0]];
        assert_eq!(stand.take_answers(), reversed.map(|frame| answer_to(&frame)));
    }
}

/// The sender repeats a frame with a bit error, and the chip an answer.
#[test]
fn a_frame_or_an_answer_with_a_bit_error_is_repeated_and_arrives_once() {
    let data = [1, 2, 3, 4, 5, 6, 7, 8];
    let (frame, other) = (Frame::extended(RXF2, &data), Frame::standard(RXF3, &data));
    for mut stand in CORRECT.map(Stand::new) {
        for bit in (15..125).step_by(11) {
            stand.flip_bit(bit);
            stand.serve(frame);
            stand.assert_answered(&[frame], &format!("bit {bit} of the frame"));
        }
        for bit in (60..100).step_by(7) {
            stand.serve_with_error_in_answer(other, bit);
            stand.assert_answered(&[other], &format!("bit {bit} of the answer"));
        }
    }
}

/// The crate checks TXERR and MLOA right after it sets TXREQ. But the chip repeats the frame in
/// both cases (section 3.4). A program that sends the frame again after the crate's error sends it
/// twice.
#[test]
fn mcp2515_returns_an_error_for_an_answer_that_the_chip_still_sends() {
    let frame = Frame::standard(RXF3, &[1, 2, 3, 4, 5, 6, 7, 8]);
    let mut stand = Stand::new(ThirdParty::Mcp2515);
    // The number of bits on the bus when the crate checks the flags depends on the speed of its
    // code.
    let mut errors = 0;
    for bit in 1..=12 {
        stand.serve_with_error_in_answer(frame, bit);
        match stand.take_reports()[..] {
            [Report::NotSent, Report::Received(received, _)] if received == frame => errors += 1,
            [Report::Received(received, _)] if received == frame => {}
            ref reports => panic!("bit {bit}: {reports:?}"),
        }
        assert_eq!(stand.take_answers(), [answer_to(&frame)], "bit {bit}");
    }
    assert!(errors > 0);
}

#[test]
fn the_firmware_sends_its_counter_frames_periodically() {
    for firmware in CORRECT {
        let mut stand = Stand::new(firmware);
        stand.run_ms(450);
        let counters = stand.take_counters();
        assert!(counters.len() >= 4, "{firmware:?}: {counters:?}");
        for (count, (_, frame)) in (1_u16..).zip(&counters) {
            assert_eq!(frame.data(), count.to_be_bytes(), "{firmware:?}");
        }
        for pair in counters.windows(2) {
            let period_ms = milliseconds(pair[1].0 - pair[0].0);
            assert!((102..=103).contains(&period_ms), "{firmware:?}: {period_ms} ms");
        }
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
        stand.assert_answered(&[before, seen[0], seen[1]], "");
    }
}

/// ISO 11898-1: a DLC of 9 to 15 means eight bytes.
#[test]
fn mcp25xx_takes_a_dlc_above_eight_as_eight_bytes() {
    let data = [1, 2, 3, 4, 5, 6, 7, 8];
    let mut stand = Stand::new(ThirdParty::Mcp25xx);
    for dlc in 9..=15 {
        stand.serve(Frame::with_dlc(Id::Extended(RXF0), dlc, data));
        stand.assert_reported(&[Frame::extended(RXF0, &data)], &format!("DLC {dlc}"));
    }
}

/// The crate returns an error before it clears RX0IF, and always checks RX0IF first. So one such
/// frame on the bus ends all reception, also from RXB1.
#[test]
fn mcp2515_receives_nothing_after_a_frame_with_a_dlc_above_eight_in_rxb0() {
    for dlc in 9..=15 {
        let mut stand = Stand::new(ThirdParty::Mcp2515);
        stand.serve(Frame::with_dlc(Id::Extended(RXF0), dlc, [7; 8]));
        for (frame, _) in one_for_each_filter() {
            stand.serve(frame);
        }
        stand.run_ms(100);
        let reports = stand.take_reports();
        assert!(reports.len() > 100, "DLC {dlc}");
        assert!(reports.iter().all(|report| *report == Report::Rejected), "DLC {dlc}");
        assert_eq!(stand.register(CANINTF) & (RX0IF | RX1IF), RX0IF | RX1IF, "DLC {dlc}");
        assert_eq!(stand.frames_lost(), 5, "DLC {dlc}");
        assert!(!stand.take_counters().is_empty(), "DLC {dlc}: the node still sends");
    }
}

#[test]
fn mcp2515_never_releases_a_frame_with_a_dlc_above_eight_in_rxb1_and_receives_only_from_rxb0() {
    let mut stand = Stand::new(ThirdParty::Mcp2515);
    stand.serve(Frame::with_dlc(Id::Standard(RXF3), 9, [7; 8]));
    let [(for_rxb0, _), _, (for_rxb1, _), ..] = one_for_each_filter();
    stand.serve(for_rxb1);
    stand.serve(for_rxb0);
    let reports = stand.take_reports();
    let frames: Vec<&Report> =
        reports.iter().filter(|report| **report != Report::Rejected).collect();
    assert!(matches!(frames[..], [Report::Received(frame, _)] if *frame == for_rxb0), "{frames:?}");
    assert_eq!(stand.take_answers(), [answer_to(&for_rxb0)]);
    assert_eq!(stand.register(CANINTF) & (RX0IF | RX1IF), RX1IF);
}

/// Figure 12-3: 94h reads RXB1 from SIDH on, 92h reads RXB0 from D0 on. With its feature `mcp2515`
/// the crate sends 92h for RXB1. It takes D0 to D3 of the old frame in RXB0 for the identifier, and
/// D4 for the length. It clears RX0IF instead of RX1IF, so it repeats this for ever.
#[test]
fn mcp25xx_with_its_feature_mcp2515_reads_the_old_contents_of_rxb0_for_rxb1_for_ever() {
    let mut stand = Stand::new(ThirdParty::Mcp25xxWrongRxb1);
    // D0 and D1 as SIDH and SIDL: standard identifier 008h. D4 as DLC: 3.
    let in_rxb0 = Frame::extended(RXF0, &[0x01, 0x02, 0xEE, 0xEE, 0x03, 0x77, 0x88, 0x99]);
    stand.serve(in_rxb0);
    stand.assert_answered(&[in_rxb0], "");
    assert_eq!(stand.take_violations(), Vec::<String>::new());

    stand.take_instructions();
    stand.serve(Frame::extended(RXF2, &[0xAA; 8]));
    stand.run_ms(50);
    let garbage = Frame::standard(0x008, &[0x77, 0x88, 0x99]);
    let frames = stand.take_frames_reported();
    assert!(frames.len() > 20 && frames.iter().all(|frame| *frame == garbage), "{frames:?}");
    let answers = stand.take_answers();
    let expected = answer_to(&garbage);
    assert!(answers.len() > 20 && answers.iter().all(|frame| *frame == expected), "{answers:?}");
    assert_eq!(stand.register(CANINTF) & (RX0IF | RX1IF), RX1IF);
    let instructions = stand.take_instructions();
    assert!(instructions.iter().any(|instruction| instruction.mosi[0] == 0x92));
    assert!(instructions.iter().all(|instruction| instruction.mosi[0] != 0x94));
    let violations = stand.take_violations();
    let text = "READ RX BUFFER 92h while RX0IF is clear";
    assert!(
        !violations.is_empty() && violations.iter().all(|v| v.contains(text)),
        "{violations:?}"
    );
}

/// Section 5. DroneCAN demands a sample point between 75 and 90 %.
#[test]
fn the_bit_timings_of_the_crates_give_these_registers_and_sample_points() {
    for (place, firmware) in on_every_board() {
        // CNF1, CNF2, CNF3 at 16 MHz and 1 Mbit/s, or 8 MHz and 500 kbit/s: SyncSeg + PropSeg + PS1
        // | PS2 in TQ.
        let (cnf, permille) = match (firmware, place.1) {
            // 1 + 3 + 2 | 2, and 1 + 2 + 3 | 2.
            (ThirdParty::Mcp2515, "seeed") => ([0x00, 0xCA, 0x81], 750),
            (ThirdParty::Mcp2515, _) => ([0x00, 0xD1, 0x81], 750),
            // 1 + 1 + 3 | 3.
            (_, "seeed") => ([0x00, 0xD0, 0x82], 625),
            _ => ([0x00, 0x90, 0x82], 625),
        };
        let stand = Stand::at(place, firmware);
        let found = [0x2A, 0x29, 0x28].map(|address| stand.register(address));
        let found = (found, stand.sample_point_permille());
        assert_eq!(found, (cnf, permille), "{firmware:?} {place:?}");
    }
}

/// Costs to fetch one frame, including READ STATUS: data bytes of the frame, bytes on the SPI, chip
/// selects, and cycles, which the firmware measures, built by nightly-2026-05-20 with opt-level z
/// and overflow checks.
const COSTS: [(ThirdParty, usize, usize, usize, u64); 9] = [
    (ThirdParty::Mcp2515, 0, 24, 8, 3222),
    (ThirdParty::Mcp2515, 1, 25, 8, 3263),
    (ThirdParty::Mcp2515, 8, 32, 8, 3546),
    (ThirdParty::Mcp25xx, 0, 21, 3, 1593),
    (ThirdParty::Mcp25xx, 1, 21, 3, 1593),
    (ThirdParty::Mcp25xx, 8, 21, 3, 1593),
    (ThirdParty::Mcp25xxWrongRxb1, 0, 16, 2, 1202),
    (ThirdParty::Mcp25xxWrongRxb1, 1, 16, 2, 1202),
    (ThirdParty::Mcp25xxWrongRxb1, 8, 16, 2, 1202),
];

/// The instructions from the READ STATUS that shows RX0IF to the one that clears RX0IF.
fn fetch(instructions: &[Instruction], cleared_at: u64) -> &[Instruction] {
    let shows_rx0if =
        |instruction: &Instruction| instruction.mosi[0] == 0xA0 && instruction.miso[1] & RX0IF != 0;
    let first = instructions.iter().position(shows_rx0if).expect("a READ STATUS");
    let last = instructions
        .iter()
        .position(|instruction| instruction.end >= cleared_at)
        .expect("the instruction that clears RX0IF");
    &instructions[first..=last]
}

/// The documents name these costs as a reason for this project's driver. The cycles can vary by a
/// few per cent with the compiler.
#[test]
fn the_costs_of_a_frame_are_those_in_the_documents() {
    for (firmware, data_bytes, spi_bytes, chip_selects, cycles) in COSTS {
        let mut stand = Stand::new(firmware);
        stand.take_instructions();
        stand.serve(Frame::extended(RXF0, &[0x5A; 8][..data_bytes]));
        let reports = stand.take_reports();
        let [Report::Received(_, measured)] = reports[..] else {
            panic!("{firmware:?}: {reports:?}")
        };
        let log = stand.take_frame_log();
        let Fate::Cleared(cleared_at) = log[0].fate else { panic!("{firmware:?}: {log:?}") };
        let instructions = stand.take_instructions();
        let fetch = fetch(&instructions, cleared_at);
        let bytes: usize = fetch.iter().map(|instruction| instruction.mosi.len()).sum();
        let case = format!("{firmware:?}, {data_bytes} data bytes");
        println!("{case}: {measured} cycles / {bytes} SPI bytes / {} CS", fetch.len());
        assert_eq!((bytes, fetch.len()), (spi_bytes, chip_selects), "{case}");
        assert!(measured.abs_diff(cycles) <= cycles / 10, "{case}: {measured} cycles");
    }
}
