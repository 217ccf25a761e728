//! Transfers of several frames in the making, in either dialect.

use std::collections::HashMap;
use std::hash::Hash;
use std::time::Duration;

/// Transfers that can be in the making at once: 32 of each node.
pub const SESSIONS_MAX: usize = 4096;

/// A transfer in the making.
pub struct Session<S> {
    /// Sessions opened before it.
    number: u64,
    started_at: Duration,
    /// What there is of it.
    pub so_far: S,
}

/// All of a bus, by what the frames of one transfer have in common. Of those that never end only the newest are kept.
pub struct Sessions<K, S> {
    open: HashMap<K, Session<S>>,
    opened: u64,
    /// Those that are not complete so long after their start are given up.
    timeout: Duration,
}

impl<K: Copy + Eq + Hash, S> Sessions<K, S> {
    /// None yet.
    pub fn new(timeout: Duration) -> Sessions<K, S> {
        Sessions { open: HashMap::new(), opened: 0, timeout }
    }

    /// One begins, in the place of what was there.
    pub fn open(&mut self, key: K, at: Duration, so_far: S) {
        self.make_room(key, at);
        self.open.insert(key, Session { number: self.opened, started_at: at, so_far });
        self.opened += 1;
    }

    /// Takes one out.
    pub fn take(&mut self, key: &K) -> Option<Session<S>> {
        self.open.remove(key)
    }

    /// Puts one back that is still to go on.
    pub fn put_back(&mut self, key: K, session: Session<S>) {
        self.open.insert(key, session);
    }

    /// Whether it began too long ago.
    pub fn is_late(&self, session: &Session<S>, at: Duration) -> bool {
        at.saturating_sub(session.started_at) > self.timeout
    }

    #[cfg(test)]
    pub fn len(&self) -> usize {
        self.open.len()
    }

    /// Forgets those that are too old if there are very many, or else the oldest one.
    fn make_room(&mut self, key: K, at: Duration) {
        if self.open.len() < SESSIONS_MAX || self.open.contains_key(&key) {
            return;
        }
        let timeout = self.timeout;
        self.open.retain(|_, session| at.saturating_sub(session.started_at) <= timeout);
        if self.open.len() == SESSIONS_MAX
            && let Some(oldest) = self.open.iter().min_by_key(|(_, session)| session.number).map(|(key, _)| *key)
        {
            self.open.remove(&oldest);
        }
    }
}
