use std::vec::Vec;

use super::*;
use crate::golden::{self, Frame, frames};
use crate::types;

const ME: u8 = 120;
const ACTUATOR: u8 = 1;
const LIGHT: u8 = 5;

/// The golden command of three entries: (1, unitless, 0.5), (2, unitless, -1), (3, PWM, 1500).
const THREE: &str = "1003F20A 12 F3 01 00 00 38 02 88 | 00 00 BC 03 04 DC 65 68";

/// The golden request to set CAN_NODE to 42.
const SET: &str =
    "1E0BF8FF C5 16 00 01 2A 00 00 81 | 00 00 00 00 00 43 41 21 | 4E 5F 4E 4F 44 45 41";

const KEPT: usize = 27;
const LIST_LANES: usize = 1;
const REQUEST_LANES: usize = 1;

type Transfer = super::Transfer<Kind, KEPT>;

/// The data types that the node of these tests receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Unknown,
    ArrayCommand,
    LightsCommand,
    NodeStatus,
    ArmingStatus,
    Allocation,
    GetNodeInfo,
    RestartNode,
    GetSet,
    ExecuteOpcode,
    BeginFirmwareUpdate,
}

impl Received for Kind {
    const UNKNOWN: Self = Self::Unknown;

    fn of_message(data_type: u16) -> Self {
        const TABLE: [(types::Message, Kind); 5] = [
            (types::ARRAY_COMMAND, Kind::ArrayCommand),
            (types::LIGHTS_COMMAND, Kind::LightsCommand),
            (types::NODE_STATUS, Kind::NodeStatus),
            (types::ARMING_STATUS, Kind::ArmingStatus),
            (types::ALLOCATION, Kind::Allocation),
        ];
        TABLE
            .iter()
            .find(|(message, _)| message.id == data_type)
            .map_or(Self::Unknown, |&(_, kind)| kind)
    }

    fn of_request(service: u8) -> Self {
        const TABLE: [(types::Service, Kind); 5] = [
            (types::GET_NODE_INFO, Kind::GetNodeInfo),
            (types::RESTART_NODE, Kind::RestartNode),
            (types::GET_SET, Kind::GetSet),
            (types::EXECUTE_OPCODE, Kind::ExecuteOpcode),
            (types::BEGIN_FIRMWARE_UPDATE, Kind::BeginFirmwareUpdate),
        ];
        TABLE
            .iter()
            .find(|(request, _)| request.id == service)
            .map_or(Self::Unknown, |&(_, kind)| kind)
    }

    fn of_anonymous(data_type: u8, node: u8) -> Self {
        if node == 0 && u16::from(data_type) == types::ALLOCATION.id {
            Self::Allocation
        } else {
            Self::Unknown
        }
    }

    fn is_request(self) -> bool {
        use Kind::{BeginFirmwareUpdate, ExecuteOpcode, GetNodeInfo, GetSet, RestartNode};
        matches!(self, GetNodeInfo | RestartNode | GetSet | ExecuteOpcode | BeginFirmwareUpdate)
    }

    fn is_multi_frame(self) -> bool {
        self.seed() != 0
    }

    fn entry_len(self) -> u8 {
        match self {
            Self::ArrayCommand => 4,
            Self::LightsCommand => 3,
            _ => 0,
        }
    }

    fn most_entries(self) -> u8 {
        if self == Self::LightsCommand { 20 } else { 15 }
    }

    fn seed(self) -> u16 {
        match self {
            Self::ArrayCommand => types::ARRAY_COMMAND.seed,
            Self::LightsCommand => types::LIGHTS_COMMAND.seed,
            Self::Allocation => types::ALLOCATION.seed,
            Self::GetSet => types::GET_SET.seed,
            Self::BeginFirmwareUpdate => types::BEGIN_FIRMWARE_UPDATE.seed,
            _ => 0,
        }
    }
}

fn read(frame: &Frame, node: u8) -> Result<Segment<'_, Kind>, Rejection> {
    Segment::read(Id::from_bytes(frame.id.to_be_bytes()), &frame.data, node)
}

/// A receiver, and the rejection that the last frame caused.
struct Rig {
    receiver: Receiver<Kind, LIST_LANES, REQUEST_LANES, KEPT>,
    now_ms: u16,
    me: u8,
    actuator: u8,
    light: u8,
    protected: u8,
    rejection: Option<Rejection>,
}

impl Rig {
    fn new() -> Self {
        Self {
            receiver: Receiver::new(),
            now_ms: 0,
            me: ME,
            actuator: ACTUATOR,
            light: LIGHT,
            protected: 0,
            rejection: None,
        }
    }

    fn for_actuator(actuator: u8) -> Self {
        Self { actuator, ..Self::new() }
    }

    /// Takes a frame. Returns the transfer that the frame completes.
    fn frame(&mut self, frame: &Frame) -> Option<Transfer> {
        self.rejection = None;
        let segment = match read(frame, self.me) {
            Ok(segment) => segment,
            Err(rejection) => {
                self.rejection = Some(rejection);
                return None;
            }
        };
        let own_id = match segment.kind {
            Kind::LightsCommand => self.light,
            _ => self.actuator,
        };
        match self.receiver.accept(segment, own_id, self.protected, self.now_ms) {
            Verdict::More => None,
            Verdict::Message(transfer) => {
                assert!(!transfer.kind.is_request());
                Some(*transfer)
            }
            Verdict::Request(transfer) => {
                assert!(transfer.kind.is_request());
                Some(*transfer)
            }
            Verdict::Rejected(rejection) => {
                self.rejection = Some(rejection);
                None
            }
        }
    }

    /// Takes a frame that completes no transfer. Returns the rejection that it causes.
    fn rejects(&mut self, frame: &Frame) -> Option<Rejection> {
        assert_eq!(self.frame(frame), None);
        self.rejection
    }

    /// Takes frames. Only the last may complete a transfer, which is returned.
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

/// Type and value of the command, or colour of the light, in the transfer.
fn entry(transfer: Option<Transfer>) -> Option<(u8, u16)> {
    transfer
        .filter(|transfer| transfer.len != 0)
        .map(|Transfer { bytes: [_, b1, b2, b3, ..], .. }| (b1, u16::from_le_bytes([b2, b3])))
}

fn command(source: u32, transfer_id: u8, entries: &[(u8, u8, u16)]) -> Vec<Frame> {
    let payload: Vec<u8> = entries
        .iter()
        .flat_map(|&(id, kind, value)| [id, kind, value as u8, (value >> 8) as u8])
        .collect();
    golden::transfer(0x1003_F200 | source, golden::ARRAY_COMMAND, transfer_id, &payload)
}

#[test]
fn a_command_in_one_frame_is_decoded() {
    let transfer = Rig::new().text("1003F20A 01 00 00 38 C7").unwrap();
    assert_eq!((transfer.kind, transfer.source, transfer.priority), (Kind::ArrayCommand, 10, 16));
    assert_eq!((transfer.transfer_id(), transfer.payload()), (7, &[1, 0, 0, 0x38][..]));
    assert_eq!(entry(Some(transfer)), Some((0, 0x3800)));
}

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
fn the_longest_command_has_an_entry_for_each_of_fifteen_actuators() {
    // 1100, 1200, ... 2500 us.
    let frames = frames(
        "1003F20A 49 48 01 04 4C 64 02 8A | 04 B0 64 03 04 14 65 2A | 04 04 78 65 05 04 DC 0A | 65 06 04 40 66 07 04 2A | \
         A4 66 08 04 08 67 09 0A | 04 6C 67 0A 04 D0 67 2A | 0B 04 1A 68 0C 04 4C 0A | 68 0D 04 7E 68 0E 04 2A | B0 68 0F 04 E2 \
         68 4A",
    );
    assert_eq!(frames.len(), 9);
    for actuator in 1..=15 {
        let done = Rig::for_actuator(actuator).all(&frames);
        let width = crate::float16::from_fixed(1000 + 100 * u16::from(actuator), 0);
        assert_eq!(entry(done), Some((4, width)));
    }
}

#[test]
fn the_last_of_several_entries_for_this_actuator_is_used() {
    // (1, unitless, 0.5), (1, unitless, -0.5)
    let transfer = Rig::new().text("1003F20A CB 0C 01 00 00 38 01 8B | 00 00 B8 6B");
    assert_eq!(entry(transfer), Some((0, 0xB800)));
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
fn by_default_a_type_is_no_list() {
    #[derive(Clone, Copy, PartialEq, Eq)]
    struct Plain;

    impl Received for Plain {
        const UNKNOWN: Self = Self;
        fn of_message(_: u16) -> Self {
            Self
        }
        fn of_request(_: u8) -> Self {
            Self
        }
        fn of_anonymous(_: u8, _: u8) -> Self {
            Self
        }
        fn is_request(self) -> bool {
            false
        }
        fn is_multi_frame(self) -> bool {
            false
        }
        fn seed(self) -> u16 {
            0
        }
    }

    assert_eq!((Plain.entry_len(), Plain.most_entries()), (0, 255));
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
fn a_light_is_found_among_others() {
    let mut rig = Rig::new();
    assert_eq!(
        entry(rig.text("1804390A 05 F8 00 C0")).map(|(high, low)| (high, low as u8)),
        Some((0xF8, 0))
    );
    // (7, blue), (0, half green), (8, white)
    let lights = frames("1804390A 68 6B 07 00 1F 00 05 82 | 40 08 FF FF 62");
    for (light, expected) in
        [(7, Some((0x00, 0x1F))), (0, Some((0x05, 0x40))), (8, Some((0xFF, 0xFF))), (5, None)]
    {
        let mut rig = Rig { light, ..Rig::new() };
        assert!(rig.frame(&lights[0]).is_none());
        let transfer = rig.frame(&lights[1]);
        assert_eq!(entry(transfer).map(|(high, low)| (high, low as u8)), expected, "light {light}");
    }
}

#[test]
fn a_request_of_several_frames_is_kept_in_full() {
    let transfer = Rig::new().text(SET).unwrap();
    assert_eq!((transfer.kind, transfer.source, transfer.priority), (Kind::GetSet, 127, 30));
    assert_eq!((transfer.transfer_id(), transfer.len), (1, 18));
    assert_eq!(
        transfer.payload(),
        golden::bytes("00 01 2A 00 00 00 00 00 00 00 43 41 4E 5F 4E 4F 44 45")
    );
}

#[test]
fn an_allocation_of_several_frames_is_a_message() {
    let transfer = Rig::new()
        .text("1E00017F 58 5D 00 00 01 02 03 81 | 04 05 06 07 08 09 0A 21 | 0B 41")
        .unwrap();
    assert_eq!((transfer.kind, transfer.len), (Kind::Allocation, 13));
}

#[test]
fn a_request_longer_than_what_is_kept_still_counts_its_bytes_and_checks_its_crc() {
    for len in [KEPT - 1, KEPT, KEPT + 1, 202, 224, 255, 256, 400] {
        let payload: Vec<u8> = (0..len).map(|n| (n * 7 + 1) as u8).collect();
        let good = golden::transfer(0x1E28_F8FF, golden::BEGIN_FIRMWARE_UPDATE, 0, &payload);
        let transfer = Rig::new().all(&good).unwrap();
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

#[test]
fn each_single_wrong_bit_breaks_the_transfer() {
    let good = frames(SET);
    for n in 0..good.len() {
        let payload_bits = 8 * (good[n].data.len() - 1);
        for bit in 0..payload_bits {
            let mut frames = good.clone();
            frames[n].data[bit / 8] ^= 1 << (bit % 8);
            let mut rig = Rig::new();
            assert_eq!(
                (rig.all(&frames), rig.rejection),
                (None, Some(Rejection::Broken)),
                "frame {n} bit {bit}"
            );
            // The lane is free for every sender.
            assert!(
                rig.all(&golden::transfer(0x1E0B_F8FE, golden::GET_SET, 0, &[0; 10])).is_some()
            );
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
        assert_eq!(
            entry(rig.all(&command(10, 2, &[(1, 0, 1), (2, 0, 2)]))),
            Some((0, 1)),
            "without {missing}"
        );
    }
}

#[test]
fn a_transfer_that_ends_in_another_is_counted_as_broken_once() {
    let mut rig = Rig::new();
    let first = command(10, 1, &[(1, 0, 1); 4]);
    assert_eq!((rig.frame(&first[0]), rig.rejection), (None, None));
    assert_eq!((rig.frame(&first[1]), rig.rejection), (None, None));
    let second = command(10, 2, &[(1, 0, 2); 4]);
    assert_eq!((rig.frame(&second[0]), rig.rejection), (None, Some(Rejection::Broken)));
    assert_eq!(entry(rig.all(&second[1..])), Some((0, 2)));
    assert_eq!(rig.rejection, None);
}

#[test]
fn a_repeated_frame_changes_nothing() {
    let frames = command(10, 1, &[(1, 0, 1), (2, 0, 2), (3, 0, 3), (4, 0, 4), (5, 0, 5)]);
    assert_eq!(frames.len(), 4);
    let mut rig = Rig::new();
    for frame in &frames[..3] {
        assert_eq!(rig.frame(frame), None);
        assert_eq!(rig.frame(frame), None, "again");
    }
    assert_eq!(entry(rig.frame(&frames[3])), Some((0, 1)));
    assert_eq!((rig.frame(&frames[3]), rig.rejection), (None, None), "the last one again");
}

#[test]
fn a_sender_that_restarts_is_accepted_with_any_transfer_id() {
    let mut rig = Rig::new();
    for transfer_id in [3, 3, 2, 31, 0, 17] {
        assert!(
            rig.all(&command(10, transfer_id, &[(1, 0, 1), (2, 0, 2)])).is_some(),
            "{transfer_id}"
        );
        assert!(
            rig.all(&command(10, transfer_id, &[(1, 0, 1)])).is_some(),
            "{transfer_id} in one frame"
        );
    }
    rig.frame(&command(10, 5, &[(1, 0, 1), (2, 0, 2)])[0]);
    assert!(
        rig.all(&command(10, 0, &[(1, 0, 1), (2, 0, 2)])).is_some(),
        "in the middle of a transfer"
    );
}

#[test]
fn a_frame_with_another_transfer_id_or_toggle_is_ignored() {
    let frames = command(10, 1, &[(1, 0, 1); 4]);
    for (n, changed_bits) in [(1, 1), (1, 16), (1, 0x20), (2, 2), (2, 0x20)] {
        let mut rig = Rig::new();
        for frame in &frames[..n] {
            assert_eq!(rig.frame(frame), None);
        }
        let mut stray = frames[n].clone();
        *stray.data.last_mut().unwrap() ^= changed_bits;
        assert_eq!((rig.frame(&stray), rig.rejection), (None, None));
        assert_eq!(
            entry(rig.all(&frames[n..])),
            Some((0, 1)),
            "frame {n} changed by {changed_bits:02X}"
        );
    }
}

#[test]
fn a_frame_of_another_sender_or_another_service_is_not_part_of_the_transfer() {
    let request = frames(SET);
    for id in [0x1E0B_F8FE, 0x1E28_F8FF] {
        let mut rig = Rig::new();
        assert_eq!(rig.frame(&request[0]), None);
        assert_eq!(rig.frame(&golden::frame(id, &request[1].data)), None);
        assert_eq!(rig.frame(&request[1]), None);
        assert_eq!(rig.frame(&golden::frame(id, &request[2].data)), None);
        assert!(rig.frame(&request[2]).is_some(), "{id:08X}");
    }
}

#[test]
fn a_first_frame_with_its_toggle_set_is_rejected() {
    let mut rig = Rig::new();
    for tail in [0xE0, 0xA0] {
        let frame = golden::frame(0x1003_F20A, &[1, 0, 0, 0x38, tail]);
        assert_eq!(
            (rig.frame(&frame), rig.rejection),
            (None, Some(Rejection::Malformed)),
            "{tail:02X}"
        );
    }
}

// Lanes

/// A command of two frames. `value` identifies it.
fn two(source: u32, transfer_id: u8, value: u16) -> [Frame; 2] {
    command(source, transfer_id, &[(1, 0, value), (2, 0, 2)]).try_into().unwrap()
}

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

#[test]
fn frames_without_a_first_frame_are_ignored() {
    let mut rig = Rig::new();
    for frame in &frames(THREE)[1..] {
        assert_eq!((rig.frame(frame), rig.rejection), (None, None));
    }
    let end = golden::frame(0x1003_F20A, &[1, 0, 0, 0x38, 0x41]);
    assert_eq!(rig.frame(&end), None);
}

#[test]
fn a_frame_without_a_tail_byte_is_rejected() {
    let mut rig = Rig::new();
    assert_eq!(
        (rig.frame(&golden::frame(0x1003_F20A, &[])), rig.rejection),
        (None, Some(Rejection::Malformed))
    );
}

#[test]
fn several_frames_of_a_single_frame_type_are_rejected() {
    let mut rig = Rig::new();
    let ids = [0x1801_550A, 0x1E01_F8FF, 0x1E05_F8FF, 0x1804_4C0A, 0x1E0A_F8FF];
    for id in ids {
        for frame in golden::transfer(id, 0, 1, &[0; 14]) {
            assert_eq!(
                (rig.frame(&frame), rig.rejection),
                (None, Some(Rejection::Malformed)),
                "{id:08X}"
            );
        }
    }
}

#[test]
fn unknown_types_are_rejected() {
    let mut rig = Rig::new();
    for id in [0x1803_F30A, 0x1002_F20A, 0x1E30_F8FF, 0x1E02_F8FF] {
        assert_eq!(
            (rig.frame(&golden::frame(id, &[1, 0, 0, 0x38, 0xC7])), rig.rejection),
            (None, Some(Rejection::Unknown)),
            "{id:08X}"
        );
    }
}

#[test]
fn requests_to_other_nodes_and_responses_are_rejected() {
    let mut rig = Rig::new();
    // Requests to 42 and to 0, a response to this node, and a response to another node.
    for id in [0x1E01_AAFF, 0x1E01_80FF, 0x1E01_78FF, 0x1E01_7FAA] {
        assert_eq!(
            (rig.frame(&golden::frame(id, &[0xC3])), rig.rejection),
            (None, Some(Rejection::Unknown)),
            "{id:08X}"
        );
    }
    assert!(rig.frame(&golden::frame(0x1E01_F8FF, &[0xC3])).is_some());
}

#[test]
fn frames_with_this_nodes_own_id_are_rejected() {
    let mut rig = Rig::new();
    for id in [0x1003_F278, 0x1801_5578, 0x1E01_F8F8, 0x1E00_0178] {
        assert_eq!(
            (rig.frame(&golden::frame(id, &[1, 0, 0, 0x38, 0xC7])), rig.rejection),
            (None, Some(Rejection::OwnId)),
            "{id:08X}"
        );
    }
}

#[test]
fn anonymous_frames_are_rejected() {
    let mut rig = Rig::new();
    for id in [0x1003_F200, 0x1801_5500, 0x1804_4C00, 0x1E01_F880] {
        assert_eq!(
            (rig.frame(&golden::frame(id, &[1, 0, 0, 0x38, 0xC7])), rig.rejection),
            (None, Some(Rejection::Anonymous)),
            "{id:08X}"
        );
    }
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
fn without_an_id_the_anonymous_requests_of_other_nodes_are_received() {
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
fn a_message_whose_type_looks_like_a_service_is_not_a_request() {
    // Type 0xFF01 is not allowed, but a frame with it may come.
    assert_eq!(Rig::new().frame(&golden::frame(0x18FF_010A, &[0xC3])), None);
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

#[test]
fn random_frames_cause_no_panic() {
    let mut rig = Rig::new();
    let ids: &[u32] = &[
        0x1003_F20A,
        0x1003_F20B,
        0x1804_390A,
        0x1E0B_F8FF,
        0x1E28_F8FF,
        0x1E00_017F,
        0x1E97_4D00,
    ];
    let mut random = 1u32;
    let mut next = || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 16) as u16
    };
    let mut came = 0;
    for _ in 0..200_000 {
        let mut frame = golden::frame(ids[usize::from(next()) % ids.len()], &[]);
        frame.data = (0..next() % 9).map(|_| next() as u8).collect();
        if let Some(tail) = frame.data.last_mut() {
            // Only two transfer IDs, so that some frames continue a transfer.
            *tail &= 0xE1;
        }
        rig.now_ms = rig.now_ms.wrapping_add(next() % 8);
        came += usize::from(rig.frame(&frame).is_some());
    }
    // Most lists end within an entry and are rejected.
    assert!(came > 10_000, "{came}");
}

/// A node with several outputs: actuators 7 and 3 have slots 0 and 2.
#[test]
fn a_list_keeps_the_last_entry_of_each_slot_and_says_which_slots_have_one() {
    let slot_of = |id| match id {
        7 => Some(Slot::new(0)),
        3 => Some(Slot::new(2)),
        _ => None,
    };
    let entries = [[3, 0, 1, 1], [9, 0, 2, 2], [7, 4, 3, 3], [3, 4, 4, 4], [1, 0, 5, 5]];
    for (entries, slots) in [(&entries[..], 0b101), (&entries[..2], 0b100), (&entries[4..], 0)] {
        let mut receiver = Receiver::<Kind, 1, 1, 27>::new();
        let frames =
            golden::transfer(0x1003_F20A, golden::ARRAY_COMMAND, 3, entries.as_flattened());
        let mut complete = None;
        for frame in &frames {
            let segment =
                Segment::read(Id::from_bytes(frame.id.to_be_bytes()), &frame.data, 120).unwrap();
            if let Verdict::Message(transfer) = receiver.accept_entries(segment, slot_of, 0, 0) {
                complete = Some(*transfer);
            }
        }
        let transfer = complete.expect("a whole transfer");
        assert_eq!(transfer.slots(), slots);
        if slots == 0b101 {
            assert_eq!(
                (&transfer.bytes()[..4], &transfer.bytes()[8..12]),
                (&[7, 4, 3, 3][..], &[3, 4, 4, 4][..])
            );
        }
    }
}
