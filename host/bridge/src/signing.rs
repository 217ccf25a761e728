//! Signatures of MAVLink 2, and the protection from replays
//! (<https://mavlink.io/en/guide/message_signing.html>).
//!
//! Goal: a captured message is executed once, whatever channel it comes from, and not again after a
//! restart.
//!
//! A signature has a timestamp, a link ID and 48 bits of a hash. A stream is what one component
//! sends with one link ID. Invariants:
//!
//! * The timestamps that are accepted from a stream increase. All channels share the streams.
//! * The first message of a stream is at most a minute older than the newest timestamp. After a
//!   restart it is newer than all that were accepted or sent before: so a message of a stream that
//!   the bridge had not heard, or had forgotten, is not accepted from before.
//! * A message that the bridge has sent itself is not accepted.
//! * The [file](file) has no smaller timestamp than the one accepted or sent last.

mod file;

use mavlink::MAVLinkV2MessageRaw;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::Path;
use std::rc::Rc;
use std::time::{Duration, SystemTime};

use file::{Stream, Times, TimesFile, UNITS_PER_S};

/// Bit in the incompatibility flags of a signed message (MAVLINK_IFLAG_SIGNED).
const SIGNED: u8 = 0x01;
/// Length of the hash in a signature, and of its timestamp, in bytes.
const HASH_LEN: usize = 6;
const TIMESTAMP_LEN: usize = 6;
const TIMESTAMP_MAX: u64 = (1 << 48) - 1;
/// Seconds from 1970 to the origin of timestamps, 2015-01-01.
const ORIGIN_S: u64 = 1_420_070_400;
/// How much older than the newest timestamp the first message of a stream may be.
const NEW_WITHIN: u64 = 60 * UNITS_PER_S;
/// How far ahead of the clocks a timestamp may be: a day, for clocks with the time of another zone.
const AHEAD_AT_MOST: u64 = 24 * 60 * 60 * UNITS_PER_S;
/// The latest timestamp that is accepted while no clock is known: half of all, in 2059.
const LATEST_WITHOUT_CLOCK: u64 = TIMESTAMP_MAX / 2;
/// Streams that are kept. Only holders of the key make streams.
const STREAMS_MAX: usize = 1024;

/// Why the signature of a message is rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rejection {
    /// There is none.
    Unsigned,
    /// It was made with another key.
    OtherKey,
    /// The key is right, but the timestamp is more than a day ahead of the clocks. It would shut
    /// out all stations whose clock is right.
    Future,
    /// The key is right, but the timestamp is not newer than the ones that count: the message comes
    /// a second time, or the station's clock is late.
    Old,
}

/// The key and the streams of all channels.
pub struct Signing {
    key: [u8; 32],
    /// The present time as a timestamp.
    clock: fn() -> u64,
    times: Times,
    /// A stream that was not heard before must be newer.
    floor: u64,
    /// The last timestamps that the bridge sent.
    sent: BTreeMap<Stream, u64>,
    file: Option<TimesFile>,
}

impl Signing {
    /// Without a file: a restart forgets what was accepted.
    pub fn new(key: [u8; 32]) -> Signing {
        let (times, sent) = (Times::default(), BTreeMap::new());
        Signing { key, clock: now, times, floor: 0, sent, file: None }
    }

    /// Continues with the timestamps in the file at `path`, which it creates.
    ///
    /// # Errors
    /// If the file cannot be read or written, has another content, or is another bridge's.
    pub fn with_file(key: [u8; 32], path: &Path) -> anyhow::Result<Signing> {
        let (mut file, times) = TimesFile::open(path)?;
        let floor = times.newest;
        let clock = now();
        if clock > 0 && floor > clock.saturating_add(AHEAD_AT_MOST) {
            file.log.push(format!(
                "{} has a time that is {} days ahead of this computer's clock: until then no \
                 station is heard whose clock is right. Set the clock, or remove that file",
                path.display(),
                (floor - clock) / (24 * 60 * 60 * UNITS_PER_S)
            ));
        }
        Ok(Signing { times, floor, file: Some(file), ..Signing::new(key) })
    }

    /// Takes the log lines since the last call.
    pub fn take_log(&mut self) -> Vec<String> {
        self.file.as_mut().map(|file| std::mem::take(&mut file.log)).unwrap_or_default()
    }

    fn check(&mut self, message: &MAVLinkV2MessageRaw) -> Result<(), Rejection> {
        if message.incompatibility_flags() & SIGNED == 0 {
            return Err(Rejection::Unsigned);
        }
        self.times.newest = self.times.newest.max((self.clock)());
        // System IDs above 255 have no place in DroneCAN's world, nor in the bridge's addresses.
        let system = message.system_id().min(255) as u8;
        let stream = (message.signature_link_id(), system, message.component_id());
        let timestamp = message.signature_timestamp();
        let last = match self.times.streams.get(&stream) {
            Some(last) => *last,
            None => self.floor.max(self.times.newest.saturating_sub(NEW_WITHIN + 1)),
        };
        let own = self.sent.get(&stream).copied().unwrap_or(0);
        let mut hash = [0; HASH_LEN];
        message.calculate_signature(&self.key, &mut hash);
        if hash != message.signature_value() {
            return Err(Rejection::OtherKey);
        }
        if timestamp > self.latest() {
            return Err(Rejection::Future);
        }
        if timestamp <= last.max(own) {
            return Err(Rejection::Old);
        }
        self.times.streams.insert(stream, timestamp);
        self.times.newest = self.times.newest.max(timestamp);
        self.forget_old();
        if let Some(file) = &mut self.file {
            file.reserve(&self.times, Some(stream));
        }
        Ok(())
    }

    /// The latest timestamp that is accepted: a day after the later of this computer's clock and
    /// the signatures so far. Without either nobody knows the day.
    fn latest(&self) -> u64 {
        match self.times.newest {
            0 => LATEST_WITHOUT_CLOCK,
            newest => newest.saturating_add(AHEAD_AT_MOST),
        }
    }

    /// Forgets the streams that have to be newer than their last message anyway.
    fn forget_old(&mut self) {
        if self.times.streams.len() > STREAMS_MAX {
            let oldest = self.times.newest.saturating_sub(NEW_WITHIN);
            self.times.streams.retain(|_, last| *last >= oldest);
        }
    }

    fn sign(&mut self, message: &mut MAVLinkV2MessageRaw, link_id: u8) {
        // One more than the last: two messages of a stream differ in their timestamps.
        let timestamp = (self.times.newest + 1).max((self.clock)()).min(TIMESTAMP_MAX);
        self.times.newest = timestamp;
        if let Some(file) = &mut self.file {
            file.reserve(&self.times, None);
        }
        let bytes = timestamp.to_le_bytes();
        message.signature_timestamp_bytes_mut().copy_from_slice(&bytes[..TIMESTAMP_LEN]);
        *message.signature_link_id_mut() = link_id;
        let mut hash = [0; HASH_LEN];
        message.calculate_signature(&self.key, &mut hash);
        message.signature_value_mut().copy_from_slice(&hash);
        let system = message.system_id().min(255) as u8;
        self.sent.insert((link_id, system, message.component_id()), timestamp);
    }
}

/// The present time as a timestamp. A clock for whose time there is no timestamp, after 2104, is
/// taken for one that is not set.
fn now() -> u64 {
    let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let since_origin = since_1970.saturating_sub(Duration::from_secs(ORIGIN_S));
    let time = since_origin.as_secs() * UNITS_PER_S + u64::from(since_origin.subsec_micros() / 10);
    if time > TIMESTAMP_MAX { 0 } else { time }
}

/// Signs and checks the messages of one channel.
#[derive(Clone)]
pub struct Signer {
    signing: Rc<RefCell<Signing>>,
    link_id: u8,
}

impl Signer {
    /// `link_id` is the channel's, for the messages that it sends.
    pub fn new(signing: Rc<RefCell<Signing>>, link_id: u8) -> Signer {
        Signer { signing, link_id }
    }

    /// Checks that the message is signed with the key, and was neither accepted before nor sent by
    /// the bridge.
    ///
    /// # Errors
    /// If it is not, or was.
    pub fn check(&self, message: &MAVLinkV2MessageRaw) -> Result<(), Rejection> {
        self.signing.borrow_mut().check(message)
    }

    /// Signs a message that was serialised for signing.
    pub fn sign(&self, message: &mut MAVLinkV2MessageRaw) {
        self.signing.borrow_mut().sign(message, self.link_id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink::MavHeader;
    use mavlink::dialects::common::{HEARTBEAT_DATA, MavMessage};
    use std::cell::Cell;

    const KEY: [u8; 32] = [7; 32];
    const S: u64 = UNITS_PER_S;

    thread_local! {
        static NOW: Cell<u64> = const { Cell::new(0) };
    }

    impl Signing {
        fn accepts(&mut self, message: &MAVLinkV2MessageRaw) -> bool {
            self.check(message).is_ok()
        }
    }

    impl Signer {
        fn accepts(&self, message: &MAVLinkV2MessageRaw) -> bool {
            self.check(message).is_ok()
        }
    }

    /// State without a file, whose clock is at `now_s` seconds.
    fn signing(now_s: u64) -> Signing {
        NOW.set(now_s * S);
        Signing { clock: || NOW.get(), ..Signing::new(KEY) }
    }

    fn stored(path: &Path) -> Signing {
        Signing { clock: || NOW.get(), ..Signing::with_file(KEY, path).unwrap() }
    }

    fn unsigned(component: u8) -> MAVLinkV2MessageRaw {
        let mut raw = MAVLinkV2MessageRaw::new();
        let header = MavHeader { system_id: 255, component_id: component, sequence: 0 };
        let message = MavMessage::HEARTBEAT(HEARTBEAT_DATA::default());
        raw.serialize_message_for_signing(header, &message);
        raw
    }

    /// A message that a station signed at `at` with this link ID.
    fn message(key: [u8; 32], at: u64, link_id: u8) -> MAVLinkV2MessageRaw {
        let mut raw = unsigned(190);
        let mut station = Signing::new(key);
        station.clock = || 0;
        station.times.newest = at - 1;
        station.sign(&mut raw, link_id);
        assert_eq!(raw.signature_timestamp(), at);
        raw
    }

    fn signed(at: u64) -> MAVLinkV2MessageRaw {
        message(KEY, at, 3)
    }

    #[test]
    fn a_message_is_accepted_once_on_all_channels_now_and_later() {
        let shared = Rc::new(RefCell::new(signing(1000)));
        let [first, second] = [0, 1].map(|link| Signer::new(shared.clone(), link));
        assert!(first.accepts(&signed(1000 * S)));
        assert!(!second.accepts(&signed(1000 * S)));
        for later in [1001, 1045, 1100, 9000] {
            NOW.set(later * S);
            assert!(!first.accepts(&signed(1000 * S)) && !second.accepts(&signed(1000 * S)));
        }
        assert!(second.accepts(&signed(1000 * S + 1)), "a newer one");
        assert!(!second.accepts(&signed(1000 * S - 1)), "an older one");
    }

    #[test]
    fn a_rejection_says_why() {
        let mut state = signing(1000);
        let mut unsigned = MAVLinkV2MessageRaw::new();
        let heartbeat = MavMessage::HEARTBEAT(HEARTBEAT_DATA::default());
        unsigned.serialize_message(MavHeader::default(), &heartbeat);
        for (name, message, expected) in [
            ("no signature", unsigned, Err(Rejection::Unsigned)),
            ("another key", message([8; 32], 1000 * S, 3), Err(Rejection::OtherKey)),
            ("another key, and old", message([8; 32], 1, 3), Err(Rejection::OtherKey)),
            ("a minute and 10 us old", message(KEY, 940 * S - 1, 4), Err(Rejection::Old)),
            ("a minute old", message(KEY, 940 * S, 4), Ok(())),
            // Each link ID is a stream of its own: a station's second link may be late.
            ("another link", message(KEY, 999 * S, 5), Ok(())),
        ] {
            assert_eq!(state.check(&message), expected, "{name}");
        }
    }

    #[test]
    fn what_the_bridge_sent_is_not_accepted_from_another_channel() {
        let mut state = signing(1000);
        let mut raw = unsigned(126);
        state.sign(&mut raw, 1);
        assert_eq!(raw.signature_timestamp(), 1000 * S);
        assert!(!state.accepts(&raw));
        let mut next = unsigned(126);
        state.sign(&mut next, 1);
        assert_eq!(next.signature_timestamp(), 1000 * S + 1);
        // The clock was set back: what is sent must not repeat.
        NOW.set(0);
        state.sign(&mut next, 1);
        assert_eq!(next.signature_timestamp(), 1000 * S + 2);
    }

    /// It would shut out all others, also after a restart.
    #[test]
    fn a_signature_of_the_far_future_is_rejected_and_changes_nothing() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("times");
        NOW.set(1000 * S);
        let mut state = stored(&path);
        let day = 24 * 60 * 60 * S;
        for at in [TIMESTAMP_MAX, 1001 * S + day] {
            assert_eq!(state.check(&signed(at)), Err(Rejection::Future), "{at}");
        }
        assert!(state.accepts(&message(KEY, 999 * S, 4)), "others are heard");
        drop(state);
        assert!(stored(&path).accepts(&message(KEY, 1001 * S, 5)), "after a restart, too");
        assert!(stored(&path).accepts(&signed(1000 * S + day)), "a day may be another zone");
        // This computer has no clock: whoever is heard first may have the right time.
        let mut state = signing(0);
        assert_eq!(state.check(&signed(TIMESTAMP_MAX)), Err(Rejection::Future));
        assert!(state.accepts(&signed(1000 * day)));
        assert_eq!(state.check(&message(KEY, 1002 * day, 4)), Err(Rejection::Future));
    }

    #[test]
    fn a_file_with_a_time_of_the_far_future_is_named() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("times");
        std::fs::write(&path, format!("newest {TIMESTAMP_MAX}\n")).unwrap();
        let log = Signing::with_file(KEY, &path).unwrap().take_log();
        let expected = "days ahead of this computer's clock";
        assert!(log.len() == 1 && log[0].contains(expected), "{log:?}");
        assert!(log[0].contains("times") && log[0].ends_with("remove that file"), "{log:?}");
        std::fs::write(&path, format!("newest {}\n", now())).unwrap();
        assert!(Signing::with_file(KEY, &path).unwrap().take_log().is_empty());
    }

    #[test]
    fn a_restart_opens_nothing() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("times");
        NOW.set(1000 * S);
        let mut state = stored(&path);
        assert!(state.accepts(&signed(1000 * S)));
        let mut own = unsigned(126);
        state.sign(&mut own, 1);
        let newest = own.signature_timestamp();
        drop(state);
        let mut state = stored(&path);
        assert!(!state.accepts(&signed(1000 * S)), "the same message again");
        assert!(!state.accepts(&own), "a message of the bridge");
        assert!(!state.accepts(&message(KEY, newest, 9)), "a link that was not heard before");
        assert!(state.accepts(&message(KEY, newest + 1, 9)));
        assert!(state.accepts(&signed(1000 * S + 1)), "the station goes on");
    }

    /// What is in the file while the bridge runs is what a crash leaves.
    #[test]
    fn a_crash_opens_nothing_and_stations_are_heard_again_within_seconds() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("times");
        NOW.set(1000 * S);
        let mut state = stored(&path);
        for at in (1000 * S..1020 * S).step_by(12_345) {
            NOW.set(at);
            assert!(state.accepts(&signed(at)));
            let left = directory.path().join(format!("left-{at}"));
            std::fs::copy(&path, &left).unwrap();
            let mut restarted = stored(&left);
            assert!(!restarted.accepts(&signed(at)));
            assert!(restarted.accepts(&signed(at + 5 * S + 1)), "5 s later");
        }
    }

    #[test]
    fn the_number_of_streams_is_bounded_and_what_is_forgotten_stays_closed() {
        let mut state = signing(1000);
        for number in 0..3000_u32 {
            let at = (1000 + u64::from(number)) * S;
            NOW.set(at);
            let mut raw = unsigned((number / 256) as u8);
            let mut station = Signing { clock: || NOW.get(), ..Signing::new(KEY) };
            station.sign(&mut raw, number as u8);
            assert!(state.accepts(&raw) && !state.accepts(&raw));
            if number == 0 {
                NOW.set(at);
            }
        }
        assert!(state.times.streams.len() <= STREAMS_MAX);
        let mut first = unsigned(0);
        let mut station = Signing { clock: || 1000 * S, ..Signing::new(KEY) };
        station.sign(&mut first, 0);
        assert!(!state.accepts(&first));
    }
}
