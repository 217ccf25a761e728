//! The lanes of a receiver, and which of them a frame belongs to.

use super::transfer::Transfer;
use super::{
    FRAME_TIMEOUT_MS, LIST_FRAME_TIMEOUT_MS, NoLane, Policy, Received, Rejection, Segment,
};
use crate::length::Length;

/// A place for each transfer that can be received at the same time.
#[derive(Clone)]
pub(super) struct Lanes<K, const LISTS: usize, const OTHERS: usize, const KEPT: usize, L> {
    pub(super) lists: [Transfer<K, KEPT, L>; LISTS],
    pub(super) others: [Transfer<K, KEPT, L>; OTHERS],
    /// The last single-frame transfer.
    pub(super) single: Transfer<K, KEPT, L>,
}

impl<K: Received, const LISTS: usize, const OTHERS: usize, const KEPT: usize, L: Length>
    Lanes<K, LISTS, OTHERS, KEPT, L>
{
    pub(super) const EMPTY: Self = Self {
        lists: [Transfer::NONE; LISTS],
        others: [Transfer::NONE; OTHERS],
        single: Transfer::NONE,
    };

    /// Ends one transfer whose timeout has passed, and returns it.
    pub(super) fn expire(&mut self, now_ms: u16) -> Option<&Transfer<K, KEPT, L>> {
        let mut lanes = self.lists.iter_mut().chain(&mut self.others);
        let lane =
            lanes.find(|lane| lane.is_open && (lane.expires_ms.wrapping_sub(now_ms) as i16) < 0)?;
        lane.is_open = false;
        Some(lane)
    }

    /// Returns the lane for a frame, and when its transfer expires after it.
    #[inline(always)]
    pub(super) fn find(
        &mut self,
        segment: &Segment<'_, K>,
        policy: &impl Policy,
        now_ms: u16,
    ) -> Result<(&mut Transfer<K, KEPT, L>, u16), NoLane> {
        if segment.tail.is_single() {
            // The transfer is complete at once.
            return Ok((&mut self.single, now_ms));
        }
        if !segment.kind.is_multi_frame() || segment.source == 0 {
            return Err(NoLane::Rejected(Rejection::Malformed));
        }
        let (lanes, timeout_ms): (&mut [Transfer<K, KEPT, L>], u16) =
            if segment.kind.has_own_lanes() {
                (&mut self.lists, LIST_FRAME_TIMEOUT_MS)
            } else {
                (&mut self.others, FRAME_TIMEOUT_MS)
            };
        let expires_ms = now_ms.wrapping_add(timeout_ms);
        // A frame that continues no transfer came twice, or its transfer was lost and reported
        // before.
        let lane = choose(lanes, segment, policy, expires_ms, now_ms).ok_or(NoLane::Ignored)?;
        Ok((lane, expires_ms))
    }
}

/// Returns the lane of the transfer that a frame continues or begins again; else, for a first
/// frame, the lane that is free or is given up most readily.
pub(super) fn choose<'a, K: Received, const KEPT: usize, L: Length>(
    lanes: &'a mut [Transfer<K, KEPT, L>],
    segment: &Segment<'_, K>,
    policy: &impl Policy,
    expires_ms: u16,
    now_ms: u16,
) -> Option<&'a mut Transfer<K, KEPT, L>> {
    let &Segment { kind, source, tail, .. } = segment;
    // There is no choice, and the compiler does not see it below.
    if lanes.len() == 1 {
        let [lane] = lanes else { return None };
        return (tail.is_start() || lane.is_open && lane.source == source).then_some(lane);
    }
    let mut chosen = None;
    let mut least = u16::MAX;
    for lane in lanes {
        if lane.is_open && lane.is_of(source, kind) {
            return Some(lane);
        }
        if tail.is_start() {
            let hold = lane.hold(policy, expires_ms, now_ms);
            if hold < least {
                least = hold;
                chosen = Some(lane);
            }
        }
    }
    chosen
}
