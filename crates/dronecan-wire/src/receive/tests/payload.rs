//! Which bytes of a transfer are kept.

use super::*;

#[test]
fn a_command_in_several_frames_gives_the_entry_for_this_actuator_wherever_it_is() {
    for (actuator, expected) in
        [(1, Some((0, 0x3800))), (2, Some((0, 0xBC00))), (3, Some((4, 0x65DC))), (4, None)]
    {
        let transfer = Rig::for_actuator(actuator).text(THREE).unwrap();
        assert_eq!(entry(Some(transfer)), expected, "actuator {actuator}");
        assert_eq!(transfer.payload().first().copied(), expected.map(|_| actuator));
        assert_eq!(transfer.transfer_id(), 8);
    }
}

#[test]
fn an_empty_list_is_complete_and_has_no_entry() {
    let mut rig = Rig::new();
    rig.text("1003F20A 01 00 00 38 C7");
    let transfer = rig.text("1003F20A C9").unwrap();
    assert_eq!((transfer.slots(), transfer.payload()), (0, &[][..]));
}

#[test]
fn a_list_has_at_most_the_entries_of_its_type() {
    let entries: Vec<_> = (1..=16).map(|id| (id, 0, 0x3800)).collect();
    assert_eq!(entry(Rig::for_actuator(1).all(&command(10, 0, &entries[..15]))), Some((0, 0x3800)));
    let mut rig = Rig::for_actuator(1);
    assert_eq!(rig.all(&command(10, 0, &entries)), None);
    assert_eq!(rig.rejection, Some(Rejection::Length));
}

#[test]
fn a_transfer_for_this_node_that_cannot_be_used_is_a_loss() {
    use Rejection::{Broken, Busy, Interleaved, Length};
    for loss in [Broken, Interleaved, Length] {
        assert!(loss.is_loss(), "{loss:?}");
    }
    assert!(!Busy.is_loss());
}

#[test]
fn a_list_that_ends_within_an_entry_is_rejected() {
    let mut rig = Rig::new();
    for len in [1, 2, 3, 5, 6, 7] {
        let payload = &[1, 0, 0, 0x38, 1, 0, 0][..len];
        let list = golden::transfer(0x1003_F20A, golden::ARRAY_COMMAND, 0, payload);
        assert_eq!((rig.all(&list), rig.rejection), (None, Some(Rejection::Length)), "{len} bytes");
    }
}

#[test]
fn a_request_longer_than_what_is_kept_still_counts_its_bytes_and_checks_its_crc() {
    for len in [KEPT - 1, KEPT, KEPT + 1, 202, 224, 255, 256, 400] {
        let payload: Vec<u8> = (0..len).map(|n| (n * 7 + 1) as u8).collect();
        let good = golden::transfer(0x1E28_F8FF, golden::BEGIN_FIRMWARE_UPDATE, 5, &payload);
        let transfer = Rig::new().all(&good).unwrap();
        assert_eq!((transfer.kind, transfer.source), (Kind::BeginFirmwareUpdate, 127));
        assert_eq!((transfer.priority, transfer.transfer_id()), (30, 5));
        assert_eq!(usize::from(transfer.len()), len.min(255));
        assert!(transfer.bytes().starts_with(transfer.payload()));
        assert_eq!(transfer.payload(), &payload[..len.min(KEPT)]);
        let mut bad = good;
        let last = bad.len() - 1;
        bad[last].data[0] ^= 1;
        let mut rig = Rig::new();
        assert_eq!((rig.all(&bad), rig.rejection), (None, Some(Rejection::Broken)));
    }
}

type ListReceiver = Receiver<Kind, 1, 1, KEPT>;

/// Receives an ArrayCommand. `begin` comes before each frame, with its number; `slot_of` has that
/// and an ID.
fn receive_list(
    entries: &[[u8; 4]],
    begin: impl Fn(usize, &mut ListReceiver),
    slot_of: impl Fn(usize, u8) -> Option<Slot>,
) -> Transfer {
    let mut receiver = ListReceiver::new();
    let frames = golden::transfer(0x1003_F20A, golden::ARRAY_COMMAND, 3, entries.as_flattened());
    let mut complete = None;
    for (number, frame) in frames.iter().enumerate() {
        begin(number, &mut receiver);
        let segment =
            Segment::read(Id::from_bytes(frame.id.to_be_bytes()), &frame.data, 120).unwrap();
        let verdict = receiver.accept_entries(segment, |id| slot_of(number, id), 0);
        if let Verdict::Message(transfer) = verdict {
            complete = Some(*transfer);
        }
    }
    complete.expect("a whole transfer")
}

/// A node with several outputs: actuators 7 and 3 have slots 0 and 2.
#[test]
fn a_list_keeps_the_last_entry_of_each_slot_and_says_which_slots_have_one() {
    let slot_of = |_, id| match id {
        7 => Some(Slot::new(0)),
        3 => Some(Slot::new(2)),
        _ => None,
    };
    let entries = [[3, 0, 1, 1], [9, 0, 2, 2], [7, 4, 3, 3], [3, 4, 4, 4], [1, 0, 5, 5]];
    for (entries, slots) in [(&entries[..], 0b101), (&entries[..2], 0b100), (&entries[4..], 0)] {
        let transfer = receive_list(entries, |_, _| (), slot_of);
        assert_eq!(transfer.slots(), slots);
        if slots == 0b101 {
            assert_eq!(
                (&transfer.bytes()[..4], &transfer.bytes()[8..12]),
                (&[7, 4, 3, 3][..], &[3, 4, 4, 4][..])
            );
        }
    }
}

/// What an earlier list left in the new place of a slot is no entry.
#[test]
fn a_list_has_no_entry_of_the_frames_before_its_slots_got_other_ids() {
    let entries = [[7, 0, 1, 1], [3, 4, 2, 2], [9, 0, 3, 3], [8, 0, 4, 4], [1, 0, 5, 5]];
    // The first two frames have the entry for 7, the last ones that for 8.
    for (before, after, slots) in [(7, 3, 0), (7, 8, 1), (8, 7, 0)] {
        let forget = |number, receiver: &mut ListReceiver| {
            if number == 2 {
                receiver.forget_entries(1);
            }
        };
        let transfer = receive_list(&entries, forget, |number, entry| {
            (entry == if number < 2 { before } else { after }).then_some(Slot::new(0))
        });
        assert_eq!(transfer.slots(), slots, "{before} becomes {after}");
    }
}

/// A node that takes entries whole and leaves the text of a GetSet out.
#[derive(Clone, Copy, PartialEq, Eq)]
struct IsGetSet(bool);

impl Received for IsGetSet {
    const UNKNOWN: Self = Self(false);
    const TAKES_ENTRIES: bool = true;
    fn of_message(_: u16) -> Self {
        Self(false)
    }
    fn of_request(_: u8) -> Self {
        Self(true)
    }
    fn is_request(self) -> bool {
        true
    }
    fn is_multi_frame(self) -> bool {
        true
    }
    fn left_out(self, head: &[u8]) -> u8 {
        if head[1] & 7 == 4 { head[2] } else { 0 }
    }
    fn seed(self) -> u16 {
        types::GET_SET.seed
    }
}

#[test]
fn by_default_a_type_is_no_list_and_nothing_is_left_out() {
    let kind = IsGetSet(true);
    assert_eq!((kind.entry_len(), kind.most_entries()), (0, 255), "the length of no entry");
    assert_eq!(Kind::GetSet.left_out(&[4; KEPT]), 0);
}

#[test]
fn what_is_left_out_takes_no_place() {
    for len in 0..=128 {
        let text = std::vec![b'x'; usize::from(len)];
        for name in ["", "N", "TWELVE_CHARS"] {
            let whole = [&[1, 4, len], text.as_slice(), name.as_bytes()].concat();
            for end in [whole.len(), whole.len() - name.len(), 2 + usize::from(len)] {
                let payload = &whole[..end];
                let mut receiver = Receiver::<IsGetSet, 1, 1, KEPT>::new();
                let mut found = None;
                for frame in golden::transfer(0x1E0B_F8FF, golden::GET_SET, 0, payload) {
                    let id = Id::from_bytes(frame.id.to_be_bytes());
                    let segment = Segment::read(id, &frame.data, ME).unwrap();
                    if let Verdict::Request(transfer) = receiver.accept(segment, ACTUATOR, 0) {
                        found = Some((transfer.payload().to_vec(), transfer.is_too_short()));
                    }
                }
                let is_too_short = end == 2 + usize::from(len) && len != 0;
                let kept: Vec<u8> = match end.checked_sub(3 + usize::from(len)) {
                    Some(_) => [&payload[..3], &payload[3 + usize::from(len)..]].concat(),
                    None => payload[..end.min(3)].to_vec(),
                };
                assert_eq!(found, Some((kept, is_too_short)), "{len} {name} {end}");
            }
        }
    }
}
