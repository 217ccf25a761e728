//! Which transfers are received at the same time, and for how long.

use super::*;

#[test]
fn commands_and_requests_and_transfers_of_one_frame_may_interleave() {
    let mut rig = Rig::new();
    let command = two(10, 1, 1);
    let single = golden::frame(0x1E01_F8FE, &[0xC3]);
    assert_eq!(rig.rejects(&command[0]), None);
    assert!(rig.frame(&single).is_some(), "a transfer of one frame always comes through");
    let request = frames(SET);
    for first in &request[..2] {
        assert_eq!(rig.rejects(first), None);
        assert!(rig.frame(&single).is_some());
    }
    assert_eq!(entry(rig.frame(&command[1])), Some((0, 1)));
    assert_eq!(rig.frame(&request[2]).unwrap().len, 18);
}

#[test]
fn after_the_timeout_another_sender_gets_the_lane() {
    let mut rig = Rig::new();
    rig.frame(&two(10, 1, 1)[0]);
    assert_eq!(rig.receiver.expire(50), None);
    assert!(rig.receiver.expire(51).is_some_and(|lost| lost.kind == Kind::ArrayCommand));
    assert_eq!(rig.receiver.expire(51), None, "it is reported once");
    let theirs = two(100, 1, 2);
    assert_eq!(rig.rejects(&theirs[0]), None);
    assert_eq!(entry(rig.frame(&theirs[1])), Some((0, 2)));
}

/// Sends a transfer whose frames come with a pause after each. Returns true if it is received,
/// false if it expires, at most once.
fn is_received_with_pauses(frames: &[Frame], start_ms: u16, pause_ms: u16) -> bool {
    let mut rig = Rig::new();
    rig.now_ms = start_ms;
    let mut expired = 0;
    let mut is_received = false;
    for frame in frames {
        is_received = rig.frame(frame).is_some();
        rig.now_ms = rig.now_ms.wrapping_add(pause_ms);
        expired += u32::from(rig.receiver.expire(rig.now_ms).is_some());
    }
    assert_eq!(expired, u32::from(!is_received), "{pause_ms} ms");
    is_received
}

#[test]
fn the_next_frame_of_a_list_may_come_after_fifty_milliseconds_and_no_later() {
    let commands: Vec<(u8, u8, u16)> = (1..=15).map(|id| (id, 0, u16::from(id))).collect();
    let list = command(10, 1, &commands);
    assert_eq!(list.len(), 9);
    for start_ms in [0, 65_400, u16::MAX] {
        for (pause_ms, is_received) in
            [(0, true), (12, true), (50, true), (51, false), (30_000, false)]
        {
            assert_eq!(
                is_received_with_pauses(&list, start_ms, pause_ms),
                is_received,
                "{pause_ms} ms"
            );
        }
    }
}

#[test]
fn the_next_frame_of_a_request_may_come_after_two_seconds_and_no_later() {
    let request = frames(SET);
    assert_eq!(request.len(), 3);
    for start_ms in [0, 62_000, u16::MAX] {
        for (pause_ms, is_received) in [(51, true), (2000, true), (2001, false), (30_000, false)] {
            assert_eq!(
                is_received_with_pauses(&request, start_ms, pause_ms),
                is_received,
                "{pause_ms} ms"
            );
        }
    }
}
