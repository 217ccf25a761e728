//! The receiver with the node's policy.

use std::vec::Vec;

use dronecan_wire::golden::{self, Frame};
use dronecan_wire::{Id, Received, Receiver, Rejection, Segment, Verdict, types};

use super::*;

mod order;
mod search;
mod trusted;

const ME: u8 = 120;
const ACTUATOR: u8 = 1;
const KEPT: usize = 27;

/// The lists that the node of these tests receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum List {
    Unknown,
    ArrayCommand,
    LightsCommand,
}

/// The type of a list. With `EACH` a node has a lane for each type and sender, and takes entries
/// whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Kind<const EACH: bool>(List);

type Shared = Kind<false>;
type Each = Kind<true>;

impl<const EACH: bool> Received for Kind<EACH> {
    const UNKNOWN: Self = Self(List::Unknown);
    const LANE_FOR_EACH_TYPE: bool = EACH;
    const TAKES_ENTRIES: bool = EACH;

    fn of_message(data_type: u16) -> Self {
        Self(match data_type {
            id if id == types::ARRAY_COMMAND.id => List::ArrayCommand,
            id if id == types::LIGHTS_COMMAND.id => List::LightsCommand,
            _ => List::Unknown,
        })
    }

    fn of_request(_: u8) -> Self {
        Self::UNKNOWN
    }

    fn is_request(self) -> bool {
        false
    }

    fn is_multi_frame(self) -> bool {
        self != Self::UNKNOWN
    }

    fn entry_len(self) -> u8 {
        if self.0 == List::LightsCommand { 3 } else { 4 }
    }

    fn seed(self) -> u16 {
        match self.0 {
            List::LightsCommand => types::LIGHTS_COMMAND.seed,
            _ => types::ARRAY_COMMAND.seed,
        }
    }
}

type Many<K, const LANES: usize> = Receiver<K, LANES, LANES, KEPT, Trust>;
type Transfer = dronecan_wire::Transfer<Shared, KEPT>;

fn receiver<K: Received, const LANES: usize>() -> Many<K, LANES> {
    Receiver::with_policy(Trust::NONE)
}

fn read<K: Received>(frame: &Frame) -> Segment<'_, K> {
    Segment::read(Id::from_bytes(frame.id.to_be_bytes()), &frame.data, ME).unwrap_or_else(|_| {
        panic!("{frame:?}");
    })
}

/// A receiver with one lane, and the rejection that the last frame caused.
struct Rig {
    receiver: Many<Shared, 1>,
    now_ms: u16,
    rejection: Option<Rejection>,
}

impl Rig {
    fn new() -> Self {
        Self { receiver: receiver(), now_ms: 0, rejection: None }
    }

    /// Takes a frame. Returns the transfer that the frame completes.
    fn frame(&mut self, frame: &Frame) -> Option<Transfer> {
        self.rejection = None;
        match self.receiver.accept(read(frame), ACTUATOR, self.now_ms) {
            Verdict::More => None,
            Verdict::Message(transfer) => Some(*transfer),
            Verdict::Request(_) => panic!("a request"),
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
