//! Reassembles received transfers, frame by frame (specification, chapter 4).
//!
//! Goals:
//!
//! * The receiver returns a transfer only after its last frame, and only if its CRC is right.
//! * A program can decide which sender is received if there are more transfers than lanes: see
//!   [`Policy`].
//! * The receiver stores only bytes that the program uses: of a list the entry for this node, of
//!   any other payload the first `KEPT` bytes.
//!
//! The receiver reassembles multi-frame transfers in lanes: `LISTS` lanes for lists, `OTHERS` lanes
//! for all other transfers. A lane belongs to the sender of its transfer; with
//! [`Received::LANE_FOR_EACH_TYPE`] to the sender and the type.
//!
//! Invariants:
//!
//! * Only the first frame of a transfer opens a lane. The transfer takes the sender's own lane,
//!   else a free lane, else the lane of another sender, whose transfer is then lost and reported.
//! * A transfer keeps its lane for [`Policy::HOLD_MS`] after each frame, unless another sender has
//!   the higher [claim](Policy::claim). The receiver itself knows no sender.
//! * A frame continues a transfer of the same sender and type if its tail
//!   [follows](crate::Tail::follows) the last one. The receiver ignores any other frame that is not
//!   a first frame: either it came twice, or its transfer was lost and reported before.
//! * A transfer whose next frame does not come within [`LIST_FRAME_TIMEOUT_MS`] or
//!   [`FRAME_TIMEOUT_MS`] is lost: see [`Receiver::expire`].
//! * A single-frame transfer needs no lane, so it is always received.
//!
//! A first frame begins a transfer whatever its transfer ID, as in libcanard. So the receiver
//! accepts a sender that restarts at once.

mod lanes;
mod policy;
mod segment;
mod transfer;

use lanes::Lanes;
pub use policy::{CompleteFirst, Policy};
pub use segment::{Rejection, Segment};
pub use transfer::{Slot, Transfer, Verdict};

use crate::length::Length;

/// The longest time between two frames of a list (a transfer in a [list
/// lane](Received::has_own_lanes)), in milliseconds. A list commands something, so a late frame
/// must not complete an old list. Slow buses and adapters need 5 to 12 ms for a frame.
pub const LIST_FRAME_TIMEOUT_MS: u16 = 50;

/// The longest time between two frames of any other transfer, in milliseconds: the transfer timeout
/// of the specification (chapter 4). A client behind a slow radio link can take that long.
/// Meanwhile the transfer of another sender may take the lane.
pub const FRAME_TIMEOUT_MS: u16 = 2000;

/// The data types that a node receives. Each value of the implementing type stands for one data
/// type.
///
/// ```
/// use dronecan_wire::{Received, types};
///
/// #[derive(Clone, Copy, Debug, PartialEq, Eq)]
/// enum Kind {
///     Unknown,
///     NodeStatus,
///     ArrayCommand,
///     GetNodeInfo,
/// }
///
/// impl Received for Kind {
///     const UNKNOWN: Self = Self::Unknown;
///
///     fn of_message(data_type: u16) -> Self {
///         match data_type {
///             id if id == types::NODE_STATUS.id => Self::NodeStatus,
///             id if id == types::ARRAY_COMMAND.id => Self::ArrayCommand,
///             _ => Self::Unknown,
///         }
///     }
///
///     fn of_request(service: u8) -> Self {
///         if service == types::GET_NODE_INFO.id { Self::GetNodeInfo } else { Self::Unknown }
///     }
///
///     fn is_request(self) -> bool {
///         self == Self::GetNodeInfo
///     }
///
///     fn is_multi_frame(self) -> bool {
///         self == Self::ArrayCommand
///     }
///
///     fn entry_len(self) -> u8 {
///         if self == Self::ArrayCommand { 4 } else { 0 }
///     }
///
///     fn seed(self) -> u16 {
///         if self == Self::ArrayCommand { types::ARRAY_COMMAND.seed } else { 0 }
///     }
/// }
/// ```
pub trait Received: Copy + PartialEq {
    /// Stands for every data type that the node does not receive.
    const UNKNOWN: Self;

    /// True if transfers of different types from one sender have different lanes. A sender
    /// interleaves them if it puts the frames that wait in order of their identifiers. False
    /// saves code in a node that receives only one type of list of several frames from a sender.
    const LANE_FOR_EACH_TYPE: bool = false;

    /// True if the receiver takes payloads entry by entry, which needs less time and some 200 bytes
    /// of flash more: a single-frame list of one entry takes 75 cycles of an AVR less. False takes
    /// them byte by byte.
    const TAKES_ENTRIES: bool = false;

    /// True if the node receives responses: it implements [`of_response`](Self::of_response).
    const TAKES_RESPONSES: bool = false;

    /// Returns the message with this data type ID, or [`UNKNOWN`](Self::UNKNOWN).
    fn of_message(data_type: u16) -> Self;

    /// Returns the request with this service ID, or [`UNKNOWN`](Self::UNKNOWN).
    fn of_request(service: u8) -> Self;

    /// Returns the anonymous message with these lower two bits of its data type ID, or
    /// [`UNKNOWN`](Self::UNKNOWN). Most nodes always return [`UNKNOWN`](Self::UNKNOWN). `node`
    /// is this node's own ID, or 0: a node without an ID may evaluate how other nodes request an
    /// ID.
    fn of_anonymous(_data_type: u8, _node: u8) -> Self {
        Self::UNKNOWN
    }

    /// Returns the response with this service ID, or [`UNKNOWN`](Self::UNKNOWN). It needs a value
    /// of its own if the node also receives the requests of the service. A node that also
    /// receives other transfers of several frames from the server sets
    /// [`LANE_FOR_EACH_TYPE`](Self::LANE_FOR_EACH_TYPE).
    fn of_response(_service: u8) -> Self {
        Self::UNKNOWN
    }

    /// True for a request, false for a message or a response.
    fn is_request(self) -> bool;

    /// True if a transfer may have several frames. The receiver rejects multi-frame transfers of
    /// all other types.
    fn is_multi_frame(self) -> bool;

    /// The length of an entry of a list in bytes. The first byte of an entry is the ID that the
    /// entry is for; the receiver keeps the last entry with the ID of this node. 0 for a type
    /// that is not a list: the receiver keeps its payload from the beginning.
    fn entry_len(self) -> u8 {
        0
    }

    /// True for a type whose transfers have the lanes of lists, for which the timeout is shorter.
    /// All lists, unless the program says otherwise: another type of command may need these lanes,
    /// too.
    fn has_own_lanes(self) -> bool {
        self.entry_len() != 0
    }

    /// The largest number of entries of a list.
    fn most_entries(self) -> u8 {
        u8::MAX
    }

    /// For a request, if [`TAKES_ENTRIES`](Self::TAKES_ENTRIES): the number of payload bytes that
    /// the receiver leaves out after the first three, with which `head` begins. So a text that is
    /// of no use to the node does not take the place of what follows it.
    fn left_out(self, _head: &[u8]) -> u8 {
        0
    }

    /// The initial value of the CRC of a multi-frame transfer: see [`crc`](crate::crc).
    fn seed(self) -> u16;
}

/// Reassembles transfers: `LISTS` multi-frame lists and `OTHERS` other multi-frame transfers at the
/// same time. It keeps `KEPT` bytes of each, which must be enough for the longest entry of a list.
/// `P` decides which sender has a lane, and `L` counts the bytes of a payload: for payloads of more
/// than 255 bytes there is [`LongReceiver`]. See the [module](self).
#[derive(Clone)]
pub struct Receiver<
    K,
    const LISTS: usize,
    const OTHERS: usize,
    const KEPT: usize,
    P = CompleteFirst,
    L = u8,
> {
    lanes: Lanes<K, LISTS, OTHERS, KEPT, L>,
    policy: P,
}

/// Why there is no lane for a frame.
enum NoLane {
    /// The frame is ignored.
    Ignored,
    /// The frame is dropped.
    Rejected(Rejection),
}

impl<K: Received, const LISTS: usize, const OTHERS: usize, const KEPT: usize>
    Receiver<K, LISTS, OTHERS, KEPT>
{
    /// A receiver without transfers, with the policy [`CompleteFirst`].
    pub const fn new() -> Self {
        Self::with_policy(CompleteFirst::NEW)
    }
}

impl<K: Received, const LISTS: usize, const OTHERS: usize, const KEPT: usize, P: Policy>
    Receiver<K, LISTS, OTHERS, KEPT, P>
{
    /// A receiver without transfers, with a policy of your own.
    pub const fn with_policy(policy: P) -> Self {
        Self { lanes: Lanes::EMPTY, policy }
    }
}

/// A receiver of payloads of up to 65,535 bytes, of which it can keep 32,767.
pub type LongReceiver<
    K,
    const LISTS: usize,
    const OTHERS: usize,
    const KEPT: usize,
    P = CompleteFirst,
> = Receiver<K, LISTS, OTHERS, KEPT, P, u16>;

impl<K: Received, const LISTS: usize, const OTHERS: usize, const KEPT: usize, P: Policy>
    LongReceiver<K, LISTS, OTHERS, KEPT, P>
{
    /// A long receiver without transfers, with a policy such as [`CompleteFirst::NEW`].
    pub const fn long(policy: P) -> Self {
        Self { lanes: Lanes::EMPTY, policy }
    }
}

impl<K: Received, const LISTS: usize, const OTHERS: usize, const KEPT: usize, P: Policy, L: Length>
    Receiver<K, LISTS, OTHERS, KEPT, P, L>
{
    /// Drops one transfer whose timeout has passed, and returns it. Call it each millisecond or so,
    /// and at least every 30 s, because the clock wraps.
    pub fn expire(&mut self, now_ms: u16) -> Option<&Transfer<K, KEPT, L>> {
        let lost = self.lanes.expire(now_ms)?;
        self.policy.lost(lost.source);
        Some(lost)
    }

    /// The node has no use for a list of this sender, although it has an entry for the node. So its
    /// next ones should take no lane from a sender whose lists the node uses: see
    /// [`Policy::refused`].
    pub fn refused(&mut self, source: u8) {
        self.policy.refused(source);
    }

    /// The policy.
    pub fn policy(&self) -> &P {
        &self.policy
    }

    /// The policy, to change its state.
    pub fn policy_mut(&mut self) -> &mut P {
        &mut self.policy
    }

    /// The lanes of lists. A lane is free if its transfer [is not open](Transfer::is_open).
    pub fn lists(&self) -> &[Transfer<K, KEPT, L>; LISTS] {
        &self.lanes.lists
    }

    /// These slots, their [bits](Slot::bits), have got another ID or place: what open lists have
    /// for them so far is no entry.
    pub fn forget_entries(&mut self, slots: u8) {
        for list in &mut self.lanes.lists {
            list.slots &= !slots;
        }
    }

    /// Takes a frame. The entries of a list that begin with `own_id` are for this node. `now_ms` is
    /// a clock that wraps.
    pub fn accept(
        &mut self,
        segment: Segment<'_, K>,
        own_id: u8,
        now_ms: u16,
    ) -> Verdict<'_, K, KEPT, L> {
        self.accept_entries(segment, |id| (id == own_id).then_some(Slot::new(0)), now_ms)
    }

    /// Like [`accept`](Self::accept) for a node that uses several entries of a list. `slot_of`
    /// returns the slot for an entry with this ID. `KEPT` must be enough for all slots.
    #[inline(always)]
    pub fn accept_entries(
        &mut self,
        mut segment: Segment<'_, K>,
        slot_of: impl Fn(u8) -> Option<Slot>,
        now_ms: u16,
    ) -> Verdict<'_, K, KEPT, L> {
        let Segment { kind, source, tail, .. } = segment;
        let entry_len = kind.entry_len();
        let Self { lanes, policy } = self;
        let (lane, expires_ms) = match lanes.find(&segment, policy, now_ms) {
            Ok(found) => found,
            Err(NoLane::Ignored) => return Verdict::More,
            Err(NoLane::Rejected(rejection)) => return Verdict::Rejected(rejection),
        };
        let mut verdict = Verdict::More;
        if tail.is_start() {
            if tail.toggle() {
                return Verdict::Rejected(Rejection::Malformed);
            }
            if !tail.is_end() {
                let Some((crc, rest)) = segment.payload.split_first_chunk() else {
                    return Verdict::Rejected(Rejection::Malformed);
                };
                segment.payload = rest;
                if lane.is_open {
                    let is_same = lane.is_of(source, kind);
                    verdict = Verdict::Rejected(if is_same {
                        Rejection::Broken
                    } else {
                        Rejection::Interleaved
                    });
                    if is_same || !lane.is_held(P::HOLD_MS, expires_ms) {
                        policy.lost(lane.source);
                    } else if policy.claim(lane.source, now_ms) >= policy.claim(source, now_ms) {
                        return verdict;
                    }
                }
                lane.crc = *crc;
                lane.sum = kind.seed();
            }
            lane.begin(&segment);
        } else if !lane.is_continued_by(&segment) {
            return Verdict::More;
        }
        lane.add(&segment, entry_len, slot_of, expires_ms);
        if !tail.is_end() {
            return verdict;
        }
        lane.is_open = false;
        if !tail.is_single() {
            if !lane.is_intact() {
                policy.lost(source);
                return Verdict::Rejected(Rejection::Broken);
            }
            if entry_len == 0 || lane.slots != 0 {
                policy.completed(source, now_ms);
            }
        }
        lane.complete(kind, entry_len)
    }
}

impl<K: Received, const LISTS: usize, const OTHERS: usize, const KEPT: usize, P> Default
    for Receiver<K, LISTS, OTHERS, KEPT, P>
where
    P: Policy + Default,
{
    fn default() -> Self {
        Self::with_policy(P::default())
    }
}

#[cfg(test)]
mod tests;
