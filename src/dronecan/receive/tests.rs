use super::*;
use crate::golden::{self, frames};
use crate::progmem::InMemory;

const ME: u8 = 120;
const ACTUATOR: u8 = 1;
const LIGHT: u8 = 5;

/// The golden command of three entries: (1, unitless, 0.5), (2, unitless, -1), (3, PWM, 1500).
const THREE: &str = "1003F20A 12 F3 01 00 00 38 02 88 | 00 00 BC 03 04 DC 65 68";

/// The golden request to set CAN_NODE to 42.
const SET: &str = "1E0BF8FF C5 16 00 01 2A 00 00 81 | 00 00 00 00 00 43 41 21 | 4E 5F 4E 4F 44 45 41";

/// A receiver, and what became of the last frame.
/// Takes a frame. The transfer that it completes.
fn accept(
    receiver: &mut Receiver,
    frame: &Frame,
    me: u8,
    actuator_id: u8,
    light_id: u8,
    now_ms: u16,
) -> Option<Transfer> {
    let entry = |list| if list == Kind::LIGHTS_COMMAND { light_id } else { actuator_id };
    receiver.accept(frame, me, entry, now_ms, InMemory);
    receiver.recall();
    assert_eq!(receiver.has_transfer(), receiver.transfer().is_some());
    let transfer = receiver.transfer().copied();
    receiver.clear();
    transfer
}

struct Rig {
    receiver: Receiver,
    now_ms: u16,
    me: u8,
    refusal: Refusal,
}

impl Rig {
    fn new() -> Self {
        Self { receiver: Receiver::new(), now_ms: 0, me: ME, refusal: Refusal::None }
    }

    fn frame(&mut self, frame: &Frame) -> Option<Transfer> {
        let transfer = accept(&mut self.receiver, frame, self.me, ACTUATOR, LIGHT, self.now_ms);
        self.refusal = self.receiver.refusal;
        transfer
    }

    /// Takes frames of which none but the last may complete a transfer; what that one completes.
    fn all(&mut self, frames: &[Frame]) -> Option<Transfer> {
        let (last, rest) = frames.split_last().unwrap();
        for frame in rest {
            assert_eq!(self.frame(frame), None);
        }
        self.frame(last)
    }

    fn text(&mut self, text: &str) -> Option<Transfer> {
        self.all(&frames(text))
    }
}

/// Type and value of the command or light in it.
fn entry(transfer: Option<Transfer>) -> Option<(u8, u16)> {
    transfer.filter(|transfer| transfer.has_entry).map(|transfer| (transfer.bytes[1], transfer.word(2)))
}

fn command(source: u32, transfer_id: u8, entries: &[(u8, u8, u16)]) -> Vec<Frame> {
    let payload: Vec<u8> =
        entries.iter().flat_map(|&(id, kind, value)| [id, kind, value as u8, (value >> 8) as u8]).collect();
    golden::transfer(0x1003_F200 | source, golden::ARRAY_COMMAND, transfer_id, &payload)
}

#[test]
fn a_command_in_one_frame_is_taken_apart() {
    let transfer = Rig::new().text("1003F20A 01 00 00 38 C7").unwrap();
    assert_eq!((transfer.kind, transfer.source, transfer.priority), (Kind::ARRAY_COMMAND, 10, 16));
    assert_eq!((transfer.transfer_id(), transfer.len), (7, 0));
    assert_eq!(entry(Some(transfer)), Some((0, 0x3800)));
}

#[test]
fn a_command_in_several_frames_gives_the_entry_for_this_actuator_wherever_it_is() {
    let frames = frames(THREE);
    for (actuator, expected) in [(1, Some((0, 0x3800))), (2, Some((0, 0xBC00))), (3, Some((4, 0x65DC))), (4, None)] {
        let mut receiver = Receiver::new();
        let [first, second] = frames[..] else { panic!() };
        assert!(accept(&mut receiver, &first, ME, actuator, LIGHT, 0).is_none());
        let transfer = accept(&mut receiver, &second, ME, actuator, LIGHT, 0).unwrap();
        assert_eq!(entry(Some(transfer)), expected, "actuator {actuator}");
        assert_eq!((transfer.transfer_id(), transfer.len), (8, 0));
    }
}

#[test]
fn the_longest_command_of_nine_frames_is_heard_for_each_of_its_fifteen_actuators() {
    // 1100, 1200, ... 2500 us.
    let frames = frames(
        "1003F20A 49 48 01 04 4C 64 02 8A | 04 B0 64 03 04 14 65 2A | 04 04 78 65 05 04 DC 0A | 65 06 04 40 66 07 04 2A | \
         A4 66 08 04 08 67 09 0A | 04 6C 67 0A 04 D0 67 2A | 0B 04 1A 68 0C 04 4C 0A | 68 0D 04 7E 68 0E 04 2A | B0 68 0F 04 E2 \
         68 4A",
    );
    assert_eq!(frames.len(), 9);
    for actuator in 1..=15 {
        let mut receiver = Receiver::new();
        let mut done = None;
        for frame in &frames {
            assert_eq!(done, None);
            done = accept(&mut receiver, frame, ME, actuator, LIGHT, 0);
        }
        let width = half::f16::from_f64(1000.0 + 100.0 * f64::from(actuator));
        assert_eq!(entry(done), Some((4, width.to_bits())));
    }
}

#[test]
fn the_last_of_several_entries_for_this_actuator_counts() {
    // (1, unitless, 0.5), (1, unitless, -0.5)
    let transfer = Rig::new().text("1003F20A CB 0C 01 00 00 38 01 8B | 00 00 B8 6B");
    assert_eq!(entry(transfer), Some((0, 0xB800)));
}

#[test]
fn an_empty_list_comes_whole_and_has_no_entry() {
    let mut rig = Rig::new();
    rig.text("1003F20A 01 00 00 38 C7");
    let transfer = rig.text("1003F20A C9").unwrap();
    assert_eq!((transfer.has_entry, transfer.len), (false, 0));
}

#[test]
fn a_list_that_ends_within_an_entry_shows_it() {
    let mut rig = Rig::new();
    for len in [1, 2, 3, 5, 6, 7] {
        let payload = &[1, 0, 0, 0x38, 1, 0, 0][..len];
        let transfer = rig.all(&golden::transfer(0x1003_F20A, golden::ARRAY_COMMAND, 0, payload)).unwrap();
        assert_ne!(transfer.len, 0, "{len} bytes");
    }
}

#[test]
fn a_light_is_found_among_others() {
    let mut rig = Rig::new();
    assert_eq!(entry(rig.text("1804390A 05 F8 00 C0")).map(|(high, low)| (high, low as u8)), Some((0xF8, 0)));
    // (7, blue), (0, half green), (8, white)
    let lights = frames("1804390A 68 6B 07 00 1F 00 05 82 | 40 08 FF FF 62");
    for (light, expected) in [(7, Some((0x00, 0x1F))), (0, Some((0x05, 0x40))), (8, Some((0xFF, 0xFF))), (5, None)] {
        let mut receiver = Receiver::new();
        assert!(accept(&mut receiver, &lights[0], ME, ACTUATOR, light, 0).is_none());
        let transfer = accept(&mut receiver, &lights[1], ME, ACTUATOR, light, 0);
        assert_eq!(entry(transfer).map(|(high, low)| (high, low as u8)), expected, "light {light}");
    }
}

#[test]
fn a_request_of_several_frames_is_kept_whole() {
    let transfer = Rig::new().text(SET).unwrap();
    assert_eq!((transfer.kind, transfer.source, transfer.priority), (Kind::GET_SET, 127, 30));
    assert_eq!((transfer.transfer_id(), transfer.len), (1, 18));
    assert_eq!(transfer.bytes[..18], golden::bytes("00 01 2A 00 00 00 00 00 00 00 43 41 4E 5F 4E 4F 44 45"));
    assert_eq!((transfer.word(2), transfer.word(10)), (42, 0x4143));
    assert_eq!(transfer.word(25), 0, "one byte only is left there");
}

/// Takes frames and acts on nothing; why the last one went no further.
fn take_only(receiver: &mut Receiver, frames: &[Frame]) -> Refusal {
    for frame in frames {
        receiver.accept(frame, ME, |_| ACTUATOR, 0, InMemory);
    }
    receiver.refusal
}

#[test]
fn a_request_of_several_frames_waits_while_messages_pass_it() {
    let mut receiver = Receiver::new();
    take_only(&mut receiver, &frames(SET));
    assert!(receiver.holds_request() && !receiver.has_transfer());
    for text in [THREE, "1003F20A 01 00 00 38 C7", "1804390A 05 F8 00 C0"] {
        assert_eq!(take_only(&mut receiver, &frames(text)), Refusal::None);
        let message = *receiver.transfer().expect(text);
        assert!(entry(Some(message)).is_some() || message.kind == Kind::LIGHTS_COMMAND, "{text}");
        receiver.clear();
    }
    assert!(receiver.recall() && receiver.has_transfer() && !receiver.holds_request());
    let request = receiver.transfer().copied();
    assert_eq!(request, Rig::new().text(SET), "as if nothing had come after it");
    receiver.clear();
    assert!(!receiver.recall(), "once");
}

#[test]
fn a_request_about_which_more_is_to_be_done_can_wait_again() {
    let mut receiver = Receiver::new();
    take_only(&mut receiver, &frames(SET));
    receiver.recall();
    receiver.hold();
    assert!(receiver.holds_request() && !receiver.has_transfer());
    take_only(&mut receiver, &frames("1003F20A 01 00 00 38 C7"));
    receiver.clear();
    assert!(receiver.recall());
    assert_eq!(receiver.transfer().map(|transfer| transfer.kind), Some(Kind::GET_SET));
    // A single frame shares its lane with the next one, so it is done with first.
    receiver.clear();
    take_only(&mut receiver, &frames("1E01F8FF C3"));
    receiver.hold();
    assert!(receiver.has_transfer() && !receiver.holds_request());
}

#[test]
fn no_other_request_of_several_frames_takes_the_place_of_one_that_waits() {
    let mut receiver = Receiver::new();
    take_only(&mut receiver, &frames(SET));
    let other = golden::transfer(0x1E0B_F8FE, golden::GET_SET, 5, &[7; 12]);
    assert_eq!(take_only(&mut receiver, &other), Refusal::Busy);
    receiver.recall();
    assert_eq!(receiver.transfer().map(|transfer| transfer.source), Some(127));
    receiver.clear();
    take_only(&mut receiver, &other);
    receiver.recall();
    assert_eq!(receiver.transfer().map(|transfer| transfer.source), Some(126));
}

#[test]
fn an_allocation_of_several_frames_does_not_wait() {
    let mut receiver = Receiver::new();
    take_only(&mut receiver, &frames("1E00017F 58 5D 00 00 01 02 03 81 | 04 05 06 07 08 09 0A 21 | 0B 41"));
    assert!(receiver.has_transfer() && !receiver.holds_request());
}

#[test]
fn a_request_longer_than_what_is_kept_still_counts_its_bytes_and_checks_its_crc() {
    for len in [26, 27, 202, 224, 255, 256, 400] {
        let payload: Vec<u8> = (0..len).map(|n| (n * 7 + 1) as u8).collect();
        let good = golden::transfer(0x1E28_F8FF, golden::BEGIN_FIRMWARE_UPDATE, 0, &payload);
        let transfer = Rig::new().all(&good).unwrap();
        assert_eq!(usize::from(transfer.len), len.min(255));
        assert_eq!(transfer.bytes[..], payload[..KEPT]);
        let mut bad = good;
        let last = bad.len() - 1;
        bad[last].data[0] ^= 1;
        let mut rig = Rig::new();
        assert_eq!((rig.all(&bad), rig.refusal), (None, Refusal::Broken));
    }
}

#[test]
fn every_single_bit_that_is_wrong_makes_the_crc_wrong_or_the_transfer_another() {
    let good = frames(SET);
    for n in 0..good.len() {
        let payload_bits = 8 * (usize::from(good[n].len) - 1);
        for bit in 0..payload_bits {
            let mut frames = good.clone();
            frames[n].data[bit / 8] ^= 1 << (bit % 8);
            let mut rig = Rig::new();
            assert_eq!((rig.all(&frames), rig.refusal), (None, Refusal::Broken), "frame {n} bit {bit}");
            // The lane is free for anyone.
            assert!(rig.all(&golden::transfer(0x1E0B_F8FE, golden::GET_SET, 0, &[0; 10])).is_some());
        }
    }
}

#[test]
fn a_missing_frame_loses_the_transfer_and_no_other() {
    let long = command(10, 1, &[(1, 0, 0x3800); 6]);
    for missing in 0..long.len() {
        let mut rig = Rig::new();
        for (n, frame) in long.iter().enumerate() {
            if n != missing {
                assert_eq!(rig.frame(frame), None, "{n} without {missing}");
            }
        }
        assert_eq!(entry(rig.all(&command(10, 2, &[(1, 0, 1), (2, 0, 2)]))), Some((0, 1)), "without {missing}");
    }
}

#[test]
fn a_transfer_that_ends_in_another_is_counted_as_broken_once() {
    let mut rig = Rig::new();
    let first = command(10, 1, &[(1, 0, 1); 4]);
    assert_eq!((rig.frame(&first[0]), rig.refusal), (None, Refusal::None));
    assert_eq!((rig.frame(&first[1]), rig.refusal), (None, Refusal::None));
    let second = command(10, 2, &[(1, 0, 2); 4]);
    assert_eq!((rig.frame(&second[0]), rig.refusal), (None, Refusal::Broken));
    assert_eq!(entry(rig.all(&second[1..])), Some((0, 2)));
    assert_eq!(rig.refusal, Refusal::None);
}

#[test]
fn a_frame_that_comes_twice_changes_nothing() {
    let frames = command(10, 1, &[(1, 0, 1), (2, 0, 2), (3, 0, 3), (4, 0, 4), (5, 0, 5)]);
    assert_eq!(frames.len(), 4);
    let mut rig = Rig::new();
    for frame in &frames[..3] {
        assert_eq!(rig.frame(frame), None);
        assert_eq!(rig.frame(frame), None, "again");
    }
    assert_eq!(entry(rig.frame(&frames[3])), Some((0, 1)));
    assert_eq!((rig.frame(&frames[3]), rig.refusal), (None, Refusal::None), "the last one again");
}

#[test]
fn a_sender_that_begins_again_is_heard_at_once_whatever_its_transfer_id() {
    let mut rig = Rig::new();
    for transfer_id in [3, 3, 2, 31, 0, 17] {
        assert!(rig.all(&command(10, transfer_id, &[(1, 0, 1), (2, 0, 2)])).is_some(), "{transfer_id}");
        assert!(rig.all(&command(10, transfer_id, &[(1, 0, 1)])).is_some(), "{transfer_id} in one frame");
    }
    rig.frame(&command(10, 5, &[(1, 0, 1), (2, 0, 2)])[0]);
    assert!(rig.all(&command(10, 0, &[(1, 0, 1), (2, 0, 2)])).is_some(), "in the middle of a transfer");
}

#[test]
fn a_frame_with_another_transfer_id_or_toggle_is_no_part_of_the_transfer() {
    let frames = command(10, 1, &[(1, 0, 1); 4]);
    for (n, changed_bits) in [(1, 1), (1, 16), (1, 0x20), (2, 2), (2, 0x20)] {
        let mut rig = Rig::new();
        for frame in &frames[..n] {
            assert_eq!(rig.frame(frame), None);
        }
        let mut stray = frames[n];
        stray.data[usize::from(stray.len) - 1] ^= changed_bits;
        assert_eq!((rig.frame(&stray), rig.refusal), (None, Refusal::None));
        assert_eq!(entry(rig.all(&frames[n..])), Some((0, 1)), "frame {n} changed by {changed_bits:02X}");
    }
}

#[test]
fn a_frame_of_another_sender_or_another_service_is_no_part_of_the_transfer() {
    let request = frames(SET);
    for id in [0x1E0B_F8FE, 0x1E28_F8FF] {
        let mut rig = Rig::new();
        assert_eq!(rig.frame(&request[0]), None);
        assert_eq!(rig.frame(&golden::frame(id, request[1].data())), None);
        assert_eq!(rig.frame(&request[1]), None);
        assert_eq!(rig.frame(&golden::frame(id, request[2].data())), None);
        assert!(rig.frame(&request[2]).is_some(), "{id:08X}");
    }
}

#[test]
fn a_first_frame_with_its_toggle_set_is_none() {
    let mut rig = Rig::new();
    for tail in [0xE0, 0xA0] {
        let frame = golden::frame(0x1003_F20A, &[1, 0, 0, 0x38, tail]);
        assert_eq!((rig.frame(&frame), rig.refusal), (None, Refusal::Form), "{tail:02X}");
    }
}

#[test]
fn another_sender_is_refused_while_a_transfer_is_under_way_and_does_not_disturb_it() {
    let mut rig = Rig::new();
    let (ours, theirs) = (command(10, 1, &[(1, 0, 1); 8]), command(11, 1, &[(1, 0, 2); 8]));
    rig.frame(&ours[0]);
    for n in 0..3 {
        assert_eq!(rig.frame(&theirs[n]), None);
        assert_eq!(rig.refusal, if n == 0 { Refusal::Interleaved } else { Refusal::None }, "counted once");
        assert_eq!(rig.frame(&ours[n + 1]), None, "{n}");
    }
}

#[test]
fn of_two_interleaved_senders_the_first_gets_through_and_the_second_afterwards() {
    let mut rig = Rig::new();
    let (ours, theirs) = (command(10, 1, &[(1, 0, 1); 2]), command(11, 1, &[(1, 0, 2); 2]));
    assert_eq!(rig.frame(&ours[0]), None);
    assert_eq!((rig.frame(&theirs[0]), rig.refusal), (None, Refusal::Interleaved));
    let transfer = rig.frame(&ours[1]);
    assert_eq!((entry(transfer), transfer.unwrap().source), (Some((0, 1)), 10));
    assert_eq!(rig.frame(&theirs[1]), None);
    assert_eq!(entry(rig.all(&command(11, 2, &[(1, 0, 2); 2]))), Some((0, 2)));
}

#[test]
fn commands_lights_and_requests_may_interleave() {
    let mut rig = Rig::new();
    let command = command(10, 1, &[(1, 0, 1), (2, 0, 2)]);
    let lights = golden::transfer(0x1804_390A, golden::LIGHTS_COMMAND, 1, &[7, 0, 0, 5, 0xF8, 0, 8, 0, 0]);
    let request = frames(SET);
    let single = golden::frame(0x1E01_F8FE, &[0xC3]);
    for first in [&command[0], &lights[0], &request[0], &request[1]] {
        assert_eq!((rig.frame(first), rig.refusal), (None, Refusal::None));
        assert!(rig.frame(&single).is_some(), "a transfer of one frame always comes through");
    }
    assert_eq!(entry(rig.frame(&command[1])), Some((0, 1)));
    assert_eq!(rig.frame(&lights[1]).unwrap().kind, Kind::LIGHTS_COMMAND);
    assert_eq!(rig.frame(&request[2]).unwrap().len, 18);
}

#[test]
fn a_command_in_one_frame_comes_through_while_a_longer_one_is_under_way() {
    let mut rig = Rig::new();
    let long = command(10, 1, &[(1, 0, 1), (2, 0, 2)]);
    rig.frame(&long[0]);
    assert_eq!(entry(rig.all(&command(11, 9, &[(1, 0, 9)]))), Some((0, 9)));
    assert_eq!(entry(rig.frame(&long[1])), Some((0, 1)));
}

#[test]
fn a_transfer_may_take_two_seconds_and_no_longer() {
    let frames = command(10, 1, &[(1, 0, 1), (2, 0, 2)]);
    for start in [0, 60_000, u16::MAX] {
        for (took_ms, comes) in [(0, true), (1999, true), (2000, true), (2001, false), (30_000, false)] {
            let mut rig = Rig::new();
            rig.now_ms = start;
            rig.frame(&frames[0]);
            rig.now_ms = start.wrapping_add(took_ms);
            assert_eq!(rig.frame(&frames[1]).is_some(), comes, "{took_ms} ms");
        }
    }
}

#[test]
fn after_two_seconds_another_sender_takes_over() {
    let mut rig = Rig::new();
    rig.frame(&command(10, 1, &[(1, 0, 1); 2])[0]);
    rig.now_ms = 2000;
    let theirs = command(11, 1, &[(1, 0, 2); 2]);
    assert_eq!((rig.frame(&theirs[0]), rig.refusal), (None, Refusal::Interleaved));
    rig.now_ms = 2001;
    assert_eq!((rig.frame(&theirs[0]), rig.refusal), (None, Refusal::Broken), "the old one did not end");
    assert_eq!(entry(rig.frame(&theirs[1])), Some((0, 2)));
}

#[test]
fn frames_without_a_beginning_are_passed_over() {
    let mut rig = Rig::new();
    for frame in &frames(SET)[1..] {
        assert_eq!((rig.frame(frame), rig.refusal), (None, Refusal::None));
    }
    let end = golden::frame(0x1003_F20A, &[1, 0, 0, 0x38, 0x41]);
    assert_eq!(rig.frame(&end), None);
}

#[test]
fn a_frame_without_a_tail_byte_is_refused() {
    let mut rig = Rig::new();
    assert_eq!((rig.frame(&golden::frame(0x1003_F20A, &[])), rig.refusal), (None, Refusal::Form));
}

#[test]
fn several_frames_where_one_is_enough_are_refused() {
    let mut rig = Rig::new();
    for id in [0x1801_550A, 0x1804_4C0A, 0x1804_570A, 0x1E01_F8FF, 0x1E0A_F8FF, 0x1E05_F8FF, 0x1E04_F8FF] {
        for frame in golden::transfer(id, 0, 1, &[0; 14]) {
            assert_eq!((rig.frame(&frame), rig.refusal), (None, Refusal::Form), "{id:08X}");
        }
    }
}

#[test]
fn foreign_frames_and_unknown_types_are_refused() {
    let mut rig = Rig::new();
    for id in [0x9003_F20A, 0x8000_0000, 0x1803_F30A, 0x1002_F20A, 0x1E30_F8FF, 0x1E02_F8FF] {
        assert_eq!(
            (rig.frame(&golden::frame(id, &[1, 0, 0, 0x38, 0xC7])), rig.refusal),
            (None, Refusal::Kind),
            "{id:08X}"
        );
    }
}

#[test]
fn requests_to_others_and_responses_are_refused() {
    let mut rig = Rig::new();
    // To 42 and to 0; a response to us and one to another.
    for id in [0x1E01_AAFF, 0x1E01_80FF, 0x1E01_78FF, 0x1E01_7FAA] {
        assert_eq!((rig.frame(&golden::frame(id, &[0xC3])), rig.refusal), (None, Refusal::Kind), "{id:08X}");
    }
    assert!(rig.frame(&golden::frame(0x1E01_F8FF, &[0xC3])).is_some());
}

#[test]
fn what_has_this_nodes_own_id_as_sender_is_refused() {
    let mut rig = Rig::new();
    for id in [0x1003_F278, 0x1801_5578, 0x1E01_F8F8, 0x1E00_0178] {
        assert_eq!(
            (rig.frame(&golden::frame(id, &[1, 0, 0, 0x38, 0xC7])), rig.refusal),
            (None, Refusal::Source),
            "{id:08X}"
        );
    }
}

#[test]
fn commands_from_nobody_are_refused() {
    let mut rig = Rig::new();
    for id in [0x1003_F200, 0x1801_5500, 0x1804_4C00, 0x1E01_F880] {
        assert_eq!(
            (rig.frame(&golden::frame(id, &[1, 0, 0, 0x38, 0xC7])), rig.refusal),
            (None, Refusal::Source),
            "{id:08X}"
        );
    }
}

#[test]
fn without_an_id_the_golden_answers_of_an_allocator_come_through() {
    let mut rig = Rig::new();
    rig.me = 0;
    let id: Vec<u8> = (0..16).collect();
    for (text, node_id, len) in [
        ("1E00017F 00 00 01 02 03 04 05 C0", 0, 6),
        ("1E00017F 58 5D 00 00 01 02 03 81 | 04 05 06 07 08 09 0A 21 | 0B 41", 0, 12),
        ("1E00017F 8A 68 FA 00 01 02 03 82 | 04 05 06 07 08 09 0A 22 | 0B 0C 0D 0E 0F 42", 125, 16),
    ] {
        let transfer = rig.text(text).unwrap();
        assert_eq!((transfer.kind, transfer.source), (Kind::ALLOCATION, 127));
        assert_eq!(usize::from(transfer.len), 1 + len);
        assert_eq!((transfer.bytes[0] >> 1, &transfer.bytes[1..=len]), (node_id, &id[..len]));
    }
}

#[test]
fn without_an_id_the_anonymous_requests_of_other_nodes_come_through() {
    let mut rig = Rig::new();
    rig.me = 0;
    for text in
        ["1E974D00 01 00 01 02 03 04 05 C0", "1EBC1100 00 06 07 08 09 0A 0B C1", "1EEE8100 01 44 C0 8B 63 5E 05 C0"]
    {
        let transfer = rig.text(text).unwrap_or_else(|| panic!("{text}"));
        assert_eq!((transfer.kind, transfer.source, transfer.len), (Kind::ALLOCATION, 0, 7));
    }
}

#[test]
fn without_an_id_no_request_is_for_this_node() {
    let mut rig = Rig::new();
    rig.me = 0;
    for id in [0x1E01_80FF, 0x1E01_F8FF] {
        assert_eq!(rig.frame(&golden::frame(id, &[0xC3])), None, "{id:08X}");
    }
}

#[test]
fn a_message_of_a_type_that_looks_like_a_service_is_no_request() {
    // Type 0xFF01: no such type is allowed, but such a frame may come.
    assert_eq!(Rig::new().frame(&golden::frame(0x18FF_010A, &[0xC3])), None);
}

#[test]
fn anonymous_transfers_of_several_frames_are_no_transfers() {
    let mut rig = Rig::new();
    for me in [0, ME] {
        rig.me = me;
        for frame in golden::transfer(0x1E00_0100, golden::ALLOCATION, 0, &[0; 17]) {
            assert_eq!(rig.frame(&frame), None);
        }
        // And they do not keep the lane from anyone.
        let answer = "1E00017F 58 5D 00 00 01 02 03 81 | 04 05 06 07 08 09 0A 21 | 0B 41";
        assert!(rig.text(answer).is_some(), "node {me}");
    }
}

#[test]
fn a_first_frame_too_short_for_a_crc_begins_nothing() {
    for data in [&[0x81][..], &[0x00, 0x81]] {
        let mut rig = Rig::new();
        assert_eq!(rig.frame(&golden::frame(0x1003_F20A, data)), None);
        assert_eq!(entry(rig.all(&command(11, 1, &[(1, 0, 1), (2, 0, 2)]))), Some((0, 1)), "{data:02X?}");
    }
}

#[test]
fn no_bytes_whatever_make_it_panic() {
    let mut rig = Rig::new();
    let ids = [0x1003_F20Au32, 0x1003_F20B, 0x1804_390A, 0x1E0B_F8FF, 0x1E28_F8FF, 0x1E00_017F, 0x1E97_4D00];
    let mut random = 1u32;
    let mut next = || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 16) as u16
    };
    let mut came = 0;
    for _ in 0..200_000 {
        let mut frame = Frame { id: ids[usize::from(next()) % ids.len()].to_be_bytes(), ..Frame::EMPTY };
        frame.len = (next() % 9) as u8;
        frame.data = std::array::from_fn(|_| next() as u8);
        if frame.len > 0 {
            // Few transfer IDs, so that frames do go together.
            frame.data[usize::from(frame.len) - 1] &= 0xE1;
        }
        rig.now_ms = rig.now_ms.wrapping_add(next() % 8);
        came += usize::from(rig.frame(&frame).is_some());
    }
    assert!(came > 10_000, "{came}");
}
