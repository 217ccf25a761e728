//! Incomplete transfers of several frames, in either dialect.

use std::collections::HashMap;
use std::hash::Hash;
use std::time::Duration;

/// Maximum number of incomplete transfers: 32 for each node.
pub const SESSIONS_MAX: usize = 4096;

/// An incomplete transfer.
pub struct Session<S> {
    /// Number of sessions opened before it.
    number: u64,
    started_at: Duration,
    /// The received part.
    pub so_far: S,
}

/// All sessions of a bus, by what the frames of a transfer have in common. Of transfers that never
/// end only the newest are kept.
pub struct Sessions<K, S> {
    open: HashMap<K, Session<S>>,
    opened: u64,
    /// Sessions that are not complete this long after their start time out.
    timeout: Duration,
}

impl<K: Copy + Eq + Hash, S> Sessions<K, S> {
    /// No sessions.
    pub fn new(timeout: Duration) -> Sessions<K, S> {
        Sessions { open: HashMap::new(), opened: 0, timeout }
    }

    /// Opens a session. Replaces the one with the same key.
    pub fn open(&mut self, key: K, at: Duration, so_far: S) {
        self.make_room(key, at);
        self.open.insert(key, Session { number: self.opened, started_at: at, so_far });
        self.opened += 1;
    }

    /// Removes and returns a session.
    pub fn take(&mut self, key: &K) -> Option<Session<S>> {
        self.open.remove(key)
    }

    /// Puts a session back that is to continue.
    pub fn put_back(&mut self, key: K, session: Session<S>) {
        self.open.insert(key, session);
    }

    /// True if the session has timed out.
    pub fn is_late(&self, session: &Session<S>, at: Duration) -> bool {
        at.saturating_sub(session.started_at) > self.timeout
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
