//! Frames that are rejected.

use super::*;

#[test]
fn several_frames_of_a_single_frame_type_are_rejected() {
    let mut rig = Rig::new();
    let ids = [0x1801_550A, 0x1E01_F8FF, 0x1E05_F8FF, 0x1804_4C0A, 0x1E0A_F8FF];
    for id in ids {
        for frame in golden::transfer(id, 0, 1, &[0; 14]) {
            assert_eq!(rig.rejects(&frame), Some(Rejection::Malformed), "{id:08X}");
        }
    }
}

#[test]
fn single_frames_are_rejected_for_these_reasons() {
    use Rejection::{Anonymous, Malformed, OwnId, Unknown};
    let data = [1, 0, 0, 0x38, 0xC7];
    // Unknown types, of which one that is not allowed looks like a service; requests to 42 and to
    // 0, a response to this node, and one to another.
    for (ids, data, reason) in [
        (
            &[0x1803_F30A, 0x1002_F20A, 0x1E30_F8FF, 0x1E02_F8FF, 0x18FF_010A][..],
            &data[..],
            Unknown,
        ),
        (&[0x1E01_AAFF, 0x1E01_80FF, 0x1E01_78FF, 0x1E01_7FAA], &[0xC3], Unknown),
        (&[0x1003_F278, 0x1801_5578, 0x1E01_F8F8, 0x1E00_0178], &data, OwnId),
        (&[0x1003_F200, 0x1801_5500, 0x1804_4C00, 0x1E01_F880], &data, Anonymous),
        // Without a tail byte, and with the toggle of a second frame.
        (&[0x1003_F20A, 0x1801_550A, 0x1804_4C0A, 0x1E01_F8FF], &[], Malformed),
        (&[0x1003_F20A], &[1, 0, 0, 0x38, 0xE0], Malformed),
        (&[0x1003_F20A], &[1, 0, 0, 0x38, 0xA0], Malformed),
    ] {
        for &id in ids {
            let mut rig = Rig::new();
            assert_eq!(rig.rejects(&golden::frame(id, data)), Some(reason), "{id:08X}");
        }
    }
    assert!(Rig::new().frame(&golden::frame(0x1E01_F8FF, &[0xC3])).is_some());
}

#[test]
fn without_an_id_the_golden_replies_of_an_allocator_are_received() {
    let mut rig = Rig::new();
    rig.me = 0;
    let id: Vec<u8> = (0..16).collect();
    for (text, node_id, len) in [
        ("1E00017F 00 00 01 02 03 04 05 C0", 0, 6),
        ("1E00017F 58 5D 00 00 01 02 03 81 | 04 05 06 07 08 09 0A 21 | 0B 41", 0, 12),
        ("1E00017F 8A 68 FA 00 01 02 03 82 | 04 05 06 07 08 09 0A 22 | 0B 0C 0D 0E 0F 42", 125, 16),
    ] {
        let transfer = rig.text(text).unwrap();
        assert_eq!((transfer.kind, transfer.source), (Kind::Allocation, 127));
        assert_eq!(usize::from(transfer.len), 1 + len);
        assert_eq!((transfer.bytes[0] >> 1, &transfer.bytes[1..=len]), (node_id, &id[..len]));
    }
}

#[test]
fn without_an_id_only_the_anonymous_requests_of_other_nodes_are_received() {
    let mut rig = Rig::new();
    rig.me = 0;
    for text in [
        "1E974D00 01 00 01 02 03 04 05 C0",
        "1EBC1100 00 06 07 08 09 0A 0B C1",
        "1EEE8100 01 44 C0 8B 63 5E 05 C0",
    ] {
        let transfer = rig.text(text).unwrap_or_else(|| panic!("{text}"));
        assert_eq!((transfer.kind, transfer.source, transfer.len), (Kind::Allocation, 0, 7));
    }
    for id in [0x1E01_80FF, 0x1E01_F8FF] {
        assert_eq!(rig.frame(&golden::frame(id, &[0xC3])), None, "{id:08X}, a request");
    }
}

#[test]
fn anonymous_multi_frame_transfers_are_dropped() {
    let mut rig = Rig::new();
    for me in [0, ME] {
        rig.me = me;
        for frame in golden::transfer(0x1E00_0100, golden::ALLOCATION, 0, &[0; 17]) {
            assert_eq!(rig.frame(&frame), None);
        }
        // They do not occupy a lane.
        let answer = "1E00017F 58 5D 00 00 01 02 03 81 | 04 05 06 07 08 09 0A 21 | 0B 41";
        assert!(rig.text(answer).is_some(), "node {me}");
    }
}

#[test]
fn a_first_frame_too_short_for_a_crc_is_rejected_and_changes_nothing() {
    for data in [&[0x81][..], &[0x00, 0x81]] {
        let mut rig = Rig::new();
        assert_eq!(rig.frame(&golden::frame(0x1003_F20A, data)), None);
        assert_eq!(
            entry(rig.all(&command(11, 1, &[(1, 0, 1), (2, 0, 2)]))),
            Some((0, 1)),
            "{data:02X?}"
        );
        // It does not end an open transfer of any sender.
        for source in [10, 11] {
            let frames = two(source, 2, 3);
            assert_eq!(rig.rejects(&frames[0]), None);
            assert_eq!(
                rig.rejects(&golden::frame(0x1003_F20A, data)),
                Some(Rejection::Malformed),
                "{data:02X?}"
            );
            assert_eq!(entry(rig.frame(&frames[1])), Some((0, 3)), "{data:02X?}");
        }
    }
}
