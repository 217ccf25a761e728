//! The node's configuration of [`dronecan_wire`]: the number of concurrent transfers, and how many
//! bytes of each are kept.

use dronecan_wire::CompleteFirst;

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

/// Reassembles received transfers. The node has a policy of its own: see
/// [`node::trust`](crate::node::trust).
pub type Receiver<P = CompleteFirst> =
    dronecan_wire::Receiver<Kind, LIST_LANES, REQUEST_LANES, KEPT, P>;

/// A received transfer.
pub type Transfer = dronecan_wire::Transfer<Kind, KEPT>;

/// A frame as a part of a transfer.
pub type Segment<'a> = dronecan_wire::Segment<'a, Kind>;
