//! Which transfers are received at the same time, and for how long.

use super::*;

#[test]
fn each_lane_serves_one_sender_and_one_more_sender_displaces_one() {
    let mut rig = Rig::new();
    let first: Vec<[Frame; 2]> =
        (0..LIST_LANES as u32).map(|n| two(10 + n, 1, 100 + n as u16)).collect();
    for frames in &first {
        assert_eq!(rig.rejects(&frames[0]), None);
    }
    let newcomer = two(100, 1, 1);
    assert_eq!(
        rig.rejects(&newcomer[0]),
        Some(Rejection::Interleaved),
        "another sender's transfer is lost"
    );
    assert_eq!(entry(rig.frame(&newcomer[1])), Some((0, 1)));
    let mut came = 0;
    for frames in &first {
        came += usize::from(rig.frame(&frames[1]).is_some());
        assert_eq!(rig.rejection, None, "that was counted already");
    }
    assert_eq!(came, LIST_LANES - 1);
}

#[test]
fn the_list_of_the_protected_sender_is_never_displaced() {
    let mut rig = Rig { protected: 10, ..Rig::new() };
    let ours = command(10, 1, &[(1, 0, 1); 8]);
    let mut completed = 0;
    for (n, frame) in ours.iter().enumerate() {
        let transfer = rig.frame(frame);
        assert_eq!(rig.rejection, None, "frame {n}");
        completed += usize::from(transfer.is_some());
        // After each frame as many other senders as there are lanes begin a list.
        if n + 1 < ours.len() {
            for source in 0..LIST_LANES as u32 {
                rig.frame(&two(20 + source, n as u8, 7)[0]);
            }
        }
    }
    assert_eq!(completed, 1);
}

#[test]
fn a_transfer_without_a_lane_is_rejected_once_and_the_next_one_is_received() {
    let mut lanes = [Transfer::NONE; 1];
    lane(&mut lanes, Kind::ArrayCommand, 10, true, 10).unwrap().begin(Kind::ArrayCommand, 10, 16);
    assert!(lane(&mut lanes, Kind::ArrayCommand, 11, true, 10).is_none());
    if LIST_LANES > 1 {
        return;
    }
    let mut rig = Rig { protected: 10, ..Rig::new() };
    let (ours, theirs) = (two(10, 1, 1), two(11, 1, 2));
    assert_eq!(rig.rejects(&ours[0]), None);
    assert_eq!(rig.rejects(&theirs[0]), Some(Rejection::Interleaved));
    assert_eq!(rig.rejects(&theirs[1]), None, "counted once");
    assert_eq!(entry(rig.frame(&ours[1])), Some((0, 1)));
    assert_eq!(entry(rig.all(&two(11, 2, 3))), Some((0, 3)));
}

#[test]
fn a_sender_that_begins_again_takes_only_its_own_lane() {
    let mut rig = Rig::new();
    let others: Vec<[Frame; 2]> = (1..LIST_LANES as u32).map(|n| two(20 + n, 1, 9)).collect();
    for frames in &others {
        assert_eq!(rig.rejects(&frames[0]), None);
    }
    assert_eq!(rig.rejects(&two(10, 1, 1)[0]), None);
    for transfer_id in 2..20 {
        assert_eq!(rig.rejects(&two(10, transfer_id, 1)[0]), Some(Rejection::Broken));
    }
    for frames in &others {
        assert_eq!(entry(rig.frame(&frames[1])), Some((0, 9)));
    }
}

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
fn a_request_of_the_protected_sender_may_be_displaced() {
    let mut rig = Rig { protected: 127, ..Rig::new() };
    for n in 0..REQUEST_LANES as u32 {
        assert_eq!(
            rig.rejects(&golden::transfer(0x1E0B_F8FF - n, golden::GET_SET, 0, &[0; 12])[0]),
            None
        );
    }
    let newcomer = golden::transfer(0x1E0B_F881, golden::GET_SET, 5, &[7; 12]);
    assert_eq!(rig.rejects(&newcomer[0]), Some(Rejection::Interleaved));
    assert_eq!(rig.frame(&newcomer[1]).unwrap().source, 1);
}

#[test]
fn after_the_timeout_another_sender_takes_even_the_protected_lane() {
    let mut rig = Rig { protected: 10, ..Rig::new() };
    for n in 0..LIST_LANES as u32 {
        rig.frame(&two(10 + n, 1, 1)[0]);
    }
    for _ in 0..LIST_LANES {
        assert_eq!(rig.receiver.expire(50), None);
        assert!(rig.receiver.expire(51).is_some_and(|lost| lost.kind == Kind::ArrayCommand));
    }
    assert_eq!(rig.receiver.expire(51), None, "all are reported");
    let theirs = two(100, 1, 2);
    assert_eq!(rig.rejects(&theirs[0]), None);
    assert_eq!(entry(rig.frame(&theirs[1])), Some((0, 2)));
}

#[test]
fn a_list_is_being_received_from_its_first_frame_to_its_last_or_until_it_expires() {
    let mut rig = Rig::new();
    assert!(!rig.receiver.is_receiving_list());
    rig.text("1003F20A 01 00 00 38 C7");
    assert!(!rig.receiver.is_receiving_list(), "of one frame");
    let frames = two(10, 1, 1);
    rig.frame(&frames[0]);
    assert!(rig.receiver.is_receiving_list());
    rig.frame(&frames[1]);
    assert!(!rig.receiver.is_receiving_list());
    rig.frame(&frames[0]);
    assert_eq!(rig.receiver.expire(51).map(|lost| lost.source), Some(10));
    assert!(!rig.receiver.is_receiving_list());
    rig.frame(&golden::frames(SET)[0]);
    assert!(!rig.receiver.is_receiving_list(), "a request");
    assert!(rig.receiver.expire(2001).is_some_and(|lost| lost.kind == Kind::GetSet));
}

/// Two lanes with open transfers of these senders.
fn two_lanes(open: [Option<u8>; 2]) -> [Transfer; 2] {
    open.map(|open| {
        let mut lane = Transfer::NONE;
        if let Some(source) = open {
            lane.begin(Kind::ArrayCommand, source, 16);
        }
        lane
    })
}

/// Returns the index of the lane that a sender gets of two lanes.
fn chosen(open: [Option<u8>; 2], source: u8, is_start: bool, protected: u8) -> Option<usize> {
    let mut lanes = two_lanes(open);
    let first = &raw const lanes[0];
    let lane = lane(&mut lanes, Kind::ArrayCommand, source, is_start, protected)?;
    Some(usize::from(!std::ptr::eq(lane, first)))
}

#[test]
fn of_two_lanes_a_sender_gets_its_own() {
    for is_start in [false, true] {
        assert_eq!(chosen([Some(10), Some(11)], 10, is_start, 11), Some(0));
        assert_eq!(chosen([Some(10), Some(11)], 11, is_start, 10), Some(1));
        assert_eq!(chosen([None, Some(11)], 11, is_start, 11), Some(1), "though another is free");
    }
}

#[test]
fn of_two_lanes_a_new_sender_gets_a_free_one_or_else_one_that_is_not_protected() {
    assert_eq!(chosen([None, None], 12, true, 0), Some(0));
    assert_eq!(chosen([Some(10), None], 12, true, 0), Some(1));
    assert_eq!(chosen([None, Some(11)], 12, true, 0), Some(0));
    assert_eq!(chosen([Some(10), Some(11)], 12, true, 10), Some(1));
    assert_eq!(chosen([Some(10), Some(11)], 12, true, 11), Some(0));
    assert!(chosen([Some(10), Some(11)], 12, true, 0).is_some());
}

#[test]
fn a_later_frame_gets_no_lane_but_that_of_its_sender() {
    for open in [[None, None], [Some(10), None], [Some(10), Some(11)]] {
        assert_eq!(chosen(open, 12, false, 0), None, "{open:?}");
    }
}

#[test]
fn a_command_in_one_frame_is_received_during_a_longer_one() {
    let mut rig = Rig::new();
    let long = command(10, 1, &[(1, 0, 1), (2, 0, 2)]);
    rig.frame(&long[0]);
    assert_eq!(entry(rig.all(&command(11, 9, &[(1, 0, 9)]))), Some((0, 9)));
    assert_eq!(entry(rig.frame(&long[1])), Some((0, 1)));
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
