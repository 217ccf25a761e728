//! Receives frames that another implementation made, and their faults.

use std::vec;
use std::vec::Vec;

use super::*;
use crate::bits::Id;
use crate::golden::{self, Frame, frames};
use crate::types;

mod lanes;
mod payload;
mod policy;
mod rejected;
mod services;

const ME: u8 = 120;
const ACTUATOR: u8 = 1;

/// The golden command of three entries: (1, unitless, 0.5), (2, unitless, -1), (3, PWM, 1500).
const THREE: &str = "1003F20A 12 F3 01 00 00 38 02 88 | 00 00 BC 03 04 DC 65 68";

/// The golden request to set CAN_NODE to 42.
const SET: &str =
    "1E0BF8FF C5 16 00 01 2A 00 00 81 | 00 00 00 00 00 43 41 21 | 4E 5F 4E 4F 44 45 41";

const KEPT: usize = 27;

type Transfer = super::Transfer<Kind, KEPT>;

/// The data types that the node of these tests receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Unknown,
    ArrayCommand,
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
        const TABLE: [(types::Message, Kind); 4] = [
            (types::ARRAY_COMMAND, Kind::ArrayCommand),
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
        if self == Self::ArrayCommand { 4 } else { 0 }
    }

    fn most_entries(self) -> u8 {
        15
    }

    fn seed(self) -> u16 {
        match self {
            Self::ArrayCommand => types::ARRAY_COMMAND.seed,
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
    receiver: Receiver<Kind, 1, 1, KEPT>,
    now_ms: u16,
    me: u8,
    actuator: u8,
    rejection: Option<Rejection>,
}

impl Rig {
    fn new() -> Self {
        Self { receiver: Receiver::new(), now_ms: 0, me: ME, actuator: ACTUATOR, rejection: None }
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
        match self.receiver.accept(segment, self.actuator, self.now_ms) {
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

/// A command of two frames. `value` identifies it.
fn two(source: u32, transfer_id: u8, value: u16) -> [Frame; 2] {
    command(source, transfer_id, &[(1, 0, value), (2, 0, 2)]).try_into().unwrap()
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
