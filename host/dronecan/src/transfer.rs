//! Transfers: the tail byte, splitting a payload into frames, and reassembling frames.
//!
//! Tail byte, last in every frame: `start[7] end[6] toggle[5] transfer_id[4:0]`. A payload of up to
//! 7 bytes is one frame. A longer one follows its CRC, little endian, and is split into frames of 7
//! bytes with the toggle bit alternating from 0 (DroneCAN specification, "CAN bus transport
//! layer").
//!
//! Assembly invariants: only a start frame opens or replaces a session. A frame that does not
//! continue its session closes it. Repeated transfer IDs are not filtered, because an observer
//! shows every frame.

use super::{
    Frame, crc,
    id::CanId,
    sessions::{self, Part, Sessions},
    types::DataType,
};
use std::time::Duration;

const START: u8 = 1 << 7;
const END: u8 = 1 << 6;
const TOGGLE: u8 = 1 << 5;
/// Payload bytes of a frame: eight minus the tail byte.
const FRAME_PAYLOAD: usize = 7;
/// A transfer that is not complete this long after its start times out (specification, transfer-ID
/// timeout).
const TIMEOUT: Duration = Duration::from_secs(2);
/// Longest payload of an unknown type: more than that of file.Read, the longest in use.
const PAYLOAD_MAX: usize = 512;

/// Transfer ID of `BITS` bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct TransferNumber<const BITS: u32>(u8);

/// Transfer ID, modulo 32.
pub type TransferId = TransferNumber<5>;

impl<const BITS: u32> TransferNumber<BITS> {
    const MASK: u8 = (1 << BITS) - 1;

    /// The low bits of `id`.
    pub const fn new(id: u8) -> TransferNumber<BITS> {
        TransferNumber(id & Self::MASK)
    }

    /// The ID as a number.
    pub const fn get(self) -> u8 {
        self.0
    }

    /// Returns the current ID and advances to the next.
    pub fn advance(&mut self) -> TransferNumber<BITS> {
        let current = *self;
        *self = TransferNumber::new(self.0.wrapping_add(1));
        current
    }
}

/// A complete transfer on the bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Transfer {
    pub id: CanId,
    pub transfer_id: TransferId,
    pub payload: Vec<u8>,
    /// Number of frames that carried it.
    pub frames: usize,
}

/// The result of a frame.
pub type Outcome = sessions::Outcome<Transfer>;

/// Data of the frames that carry `payload`, in order. `seed` is that of the data type; a
/// single frame does not need it.
pub fn split(payload: &[u8], transfer_id: TransferId, seed: u16) -> Vec<Vec<u8>> {
    if payload.len() <= FRAME_PAYLOAD {
        let mut data = payload.to_vec();
        data.push(START | END | transfer_id.0);
        return vec![data];
    }
    let mut stream = crc::feed(seed, payload).to_le_bytes().to_vec();
    stream.extend_from_slice(payload);
    let last = stream.len().div_ceil(FRAME_PAYLOAD) - 1;
    stream
        .chunks(FRAME_PAYLOAD)
        .enumerate()
        .map(|(index, chunk)| {
            let start = if index == 0 { START } else { 0 };
            let end = if index == last { END } else { 0 };
            let toggle = if index % 2 == 1 { TOGGLE } else { 0 };
            let mut data = chunk.to_vec();
            data.push(start | end | toggle | transfer_id.0);
            data
        })
        .collect()
}

/// The frames that carry `payload` under this identifier, in order. A type that is not in
/// [`types`](super::types) has no known seed, so its payload must fit in one frame.
pub fn frames(id: CanId, payload: &[u8], transfer_id: TransferId) -> Vec<Frame> {
    let seed = DataType::of(id).and_then(|data_type| data_type.seed).unwrap_or(0);
    split(payload, transfer_id, seed).iter().map(|data| Frame::extended(id.build(), data)).collect()
}

/// Reassembles the transfers of all nodes on a bus. One session per identifier, because the frames
/// of a transfer share it. Of incomplete transfers only the newest are kept.
pub struct Assembler {
    sessions: Sessions<CanId>,
}

impl Default for Assembler {
    fn default() -> Assembler {
        Assembler::new()
    }
}

impl Assembler {
    /// An assembler without a session.
    pub fn new() -> Assembler {
        Assembler { sessions: Sessions::new(TIMEOUT, PAYLOAD_MAX) }
    }

    /// Handles an extended data frame that ended at `at`. All times count from the same moment.
    pub fn push(&mut self, id: u32, data: &[u8], at: Duration) -> Outcome {
        let Some(id) = CanId::parse(id) else {
            return Outcome::Invalid("service frame of node 0");
        };
        let Some((&tail, bytes)) = data.split_last() else {
            return Outcome::Invalid("no tail byte");
        };
        let transfer_id = TransferId::new(tail);
        let part = Part {
            id: transfer_id.get(),
            place: u8::from(tail & TOGGLE != 0),
            is_full: bytes.len() == FRAME_PAYLOAD,
            is_last: tail & END != 0,
            bytes,
            at,
        };
        match (tail & START != 0, part.is_last) {
            (true, _) if part.place != 0 => Outcome::Invalid("start frame with the toggle bit set"),
            (true, true) => {
                self.sessions.close(&id);
                Outcome::Complete(Transfer { id, transfer_id, payload: bytes.to_vec(), frames: 1 })
            }
            (true, false) if matches!(id, CanId::Anonymous { .. }) => {
                Outcome::Invalid("anonymous transfer of several frames")
            }
            (true, false) if !part.is_full => Outcome::Invalid("start frame that is not full"),
            (true, false) => {
                self.sessions.open(id, &part, 1);
                Outcome::Partial
            }
            (false, _) => {
                let seed = || DataType::of(id).and_then(|data_type| data_type.seed);
                let outcome = self.sessions.go_on(id, &part, 1 - part.place, seed);
                outcome.map(|(payload, frames)| Transfer { id, transfer_id, payload, frames })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sessions::SESSIONS_MAX;

    const FIRST: [u8; 8] = [1, 2, 3, 4, 5, 6, 7, START];

    /// Pushes the first frames of `count` transfers with different identifiers.
    fn begin(assembler: &mut Assembler, count: u32, at: Duration) {
        for n in 0..count {
            assert_eq!(assembler.push(0x1000_0001 + (n << 8), &FIRST, at), Outcome::Partial);
        }
    }

    #[test]
    fn incomplete_transfers_use_limited_memory_and_do_not_stop_others() {
        let mut assembler = Assembler::new();
        begin(&mut assembler, SESSIONS_MAX as u32 + 5_000, Duration::ZERO);
        assert_eq!(assembler.sessions.len(), SESSIONS_MAX);
        // An unknown type, whose CRC cannot be checked.
        assert_eq!(assembler.push(0x1FFF_F002, &FIRST, Duration::ZERO), Outcome::Partial);
        let end = assembler.push(0x1FFF_F002, &[8, END | TOGGLE], Duration::ZERO);
        assert!(matches!(
            end,
            Outcome::Complete(Transfer { payload, .. }) if payload == [3, 4, 5, 6, 7, 8]
        ));
    }

    #[test]
    fn of_too_many_transfers_those_that_timed_out_are_removed_first() {
        let mut assembler = Assembler::new();
        begin(&mut assembler, SESSIONS_MAX as u32, Duration::ZERO);
        let later = TIMEOUT + Duration::from_millis(1);
        assert_eq!(assembler.push(0x1FFF_F002, &FIRST, later), Outcome::Partial);
        assert_eq!(assembler.sessions.len(), 1);
    }
}
