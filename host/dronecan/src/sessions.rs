//! Incomplete transfers of several frames, in either dialect.

use crate::crc;
use std::collections::HashMap;
use std::hash::Hash;
use std::time::Duration;

/// Maximum number of incomplete transfers: 32 for each node.
pub const SESSIONS_MAX: usize = 4096;

/// Bytes of the CRC before the payload of several frames.
const CRC_LEN: usize = 2;

/// A frame of a transfer of several frames.
pub struct Part<'a> {
    /// Transfer ID.
    pub id: u8,
    /// Its place: a number that the dialect counts, from the first frame on.
    pub place: u8,
    pub is_full: bool,
    pub is_last: bool,
    pub bytes: &'a [u8],
    /// When it ended.
    pub at: Duration,
}

/// An incomplete transfer.
struct Session {
    /// Number of sessions opened before it.
    number: u64,
    started_at: Duration,
    /// Transfer ID.
    id: u8,
    /// Place that the next frame must have.
    next: u8,
    frames: usize,
    stream: Vec<u8>,
}

/// The result of a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome<T> {
    /// The transfer is complete, and its CRC is valid if it has one.
    Complete(T),
    /// The frame is part of a transfer that is not complete.
    Partial,
    /// The frame is not valid in its dialect; the text has the reason.
    Invalid(&'static str),
}

impl<T> Outcome<T> {
    /// The same with another form of the transfer.
    pub fn map<U>(self, to: impl FnOnce(T) -> U) -> Outcome<U> {
        match self {
            Outcome::Complete(transfer) => Outcome::Complete(to(transfer)),
            Outcome::Partial => Outcome::Partial,
            Outcome::Invalid(why) => Outcome::Invalid(why),
        }
    }
}

/// All sessions of a bus, by what the frames of a transfer have in common. Of transfers that never
/// end only the newest are kept.
pub struct Sessions<K> {
    open: HashMap<K, Session>,
    opened: u64,
    /// Sessions that are not complete this long after their start time out.
    timeout: Duration,
    /// Longest payload.
    longest: usize,
}

impl<K: Copy + Eq + Hash> Sessions<K> {
    /// No sessions.
    pub fn new(timeout: Duration, longest: usize) -> Sessions<K> {
        Sessions { open: HashMap::new(), opened: 0, timeout, longest }
    }

    /// Opens a session with its first frame. Replaces the one with the same key. `next` is the
    /// place of the second frame.
    pub fn open(&mut self, key: K, part: &Part, next: u8) {
        self.make_room(key, part.at);
        let session = Session {
            number: self.opened,
            started_at: part.at,
            id: part.id,
            next,
            frames: 1,
            stream: part.bytes.to_vec(),
        };
        self.open.insert(key, session);
        self.opened += 1;
    }

    /// Closes a session.
    pub fn close(&mut self, key: &K) {
        self.open.remove(key);
    }

    /// Adds a frame to its session; `next` is the place of the one behind it. Returns the payload
    /// and the number of frames of a transfer that is complete. A frame that does not continue its
    /// session closes it. Without a known seed the CRC cannot be checked; an observer shows the
    /// transfer nevertheless.
    pub fn go_on(
        &mut self,
        key: K,
        part: &Part,
        next: u8,
        seed: impl FnOnce() -> Option<u16>,
    ) -> Outcome<(Vec<u8>, usize)> {
        let Some(mut session) = self.open.remove(&key) else {
            return Outcome::Invalid("continues a transfer that did not start");
        };
        if (session.id, session.next) != (part.id, part.place) {
            return Outcome::Invalid("a frame of the transfer is missing");
        }
        if part.at.saturating_sub(session.started_at) > self.timeout {
            return Outcome::Invalid("transfer timed out");
        }
        session.stream.extend_from_slice(part.bytes);
        session.frames += 1;
        session.next = next;
        if !part.is_last && !part.is_full {
            return Outcome::Invalid("middle frame that is not full");
        }
        if session.stream.len() > self.longest + CRC_LEN {
            return Outcome::Invalid("transfer too long");
        }
        if !part.is_last {
            self.open.insert(key, session);
            return Outcome::Partial;
        }
        let payload = session.stream.split_off(CRC_LEN);
        let sent = u16::from_le_bytes([session.stream[0], session.stream[1]]);
        if seed().is_some_and(|seed| crc::feed(seed, &payload) != sent) {
            return Outcome::Invalid("wrong transfer CRC");
        }
        Outcome::Complete((payload, session.frames))
    }

    #[cfg(test)]
    pub fn len(&self) -> usize {
        self.open.len()
    }

    /// If there are too many sessions, removes those that have timed out, or else the oldest.
    fn make_room(&mut self, key: K, at: Duration) {
        if self.open.len() < SESSIONS_MAX || self.open.contains_key(&key) {
            return;
        }
        let timeout = self.timeout;
        self.open.retain(|_, session| at.saturating_sub(session.started_at) <= timeout);
        if self.open.len() == SESSIONS_MAX
            && let Some(oldest) =
                self.open.iter().min_by_key(|(_, session)| session.number).map(|(key, _)| *key)
        {
            self.open.remove(&oldest);
        }
    }
}
