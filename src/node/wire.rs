//! The node's configuration of [`dronecan_wire`]: the number of concurrent transfers, and how to
//! read a frame of the driver.

use dronecan_wire::{Id, Rejection};
use mcp2515_ordered::Frame;

use super::kind::Kind;
use crate::hardware::LANES;

/// Bytes kept of a request: a GetSet with an integer and a name of 16 characters, and one more
/// byte, so that a longer name does not match by its first 16 characters.
#[cfg(not(feature = "outputs"))]
pub const KEPT: usize = 27;
/// Bytes kept of a transfer: entries of an ArrayCommand for eight outputs, or a request as above.
#[cfg(feature = "outputs")]
pub const KEPT: usize = 8 * 4;

/// Lists that can be received at the same time, each from another sender.
pub const LIST_LANES: usize = LANES;

/// Requests of several frames that can be received at the same time.
pub const REQUEST_LANES: usize = LANES;

/// Reassembles received transfers.
pub type Receiver = dronecan_wire::Receiver<Kind, LIST_LANES, REQUEST_LANES, KEPT>;

/// A received transfer.
pub type Transfer = dronecan_wire::Transfer<Kind, KEPT>;

/// A frame as a part of a transfer.
pub type Segment<'a> = dronecan_wire::Segment<'a, Kind>;

/// Reads a frame of DroneCAN v0 for the node with this ID (0 if it has none).
#[inline(always)]
pub fn segment(frame: &Frame, node: u8) -> Result<Segment<'_>, Rejection> {
    if frame.is_foreign() {
        return Err(Rejection::Unknown);
    }
    Segment::read(Id::from_bytes(frame.id), frame.data(), node)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::golden;

    #[test]
    fn standard_and_remote_frames_are_unknown() {
        for id in [0x9003_F20A, 0x8000_0000] {
            let frame = golden::frame(id, &[1, 0, 0, 0x38, 0xC7]);
            assert_eq!(segment(&frame, 120), Err(Rejection::Unknown), "{id:08X}");
        }
    }

    #[test]
    fn frames_of_the_thesis_are_one_frame_long() {
        let mut receiver = Receiver::new();
        for frame in golden::transfer(0x1804_570A, 0, 1, &[0; 14]) {
            let verdict = receiver.accept(segment(&frame, 120).unwrap(), 1, 0);
            assert_eq!(verdict, dronecan_wire::Verdict::Rejected(Rejection::Malformed));
        }
    }

    /// All anonymous messages look the same to a node without an ID, whatever their type.
    #[test]
    fn an_anonymous_message_is_an_allocation_while_the_node_has_no_id() {
        let frame = golden::frame(0x1E97_4D00, &[1, 0, 1, 2, 3, 4, 5, 0xC0]);
        assert_eq!(segment(&frame, 120), Err(Rejection::Anonymous));
        #[cfg(feature = "allocation")]
        assert_eq!(segment(&frame, 0).unwrap().kind, Kind::Allocation);
        #[cfg(not(feature = "allocation"))]
        assert_eq!(segment(&frame, 0), Err(Rejection::Anonymous));
    }
}
