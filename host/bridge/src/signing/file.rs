//! The file with the timestamps of signatures, which a restart must not forget.
//!
//! Writing it for each message would be slow. So it is ahead: it says of each stream, and of the
//! newest timestamp, up to five seconds more than was accepted or sent, and is written when that is
//! used up. A bridge that ends by itself writes the exact timestamps; after a crash the stations
//! that it knew are heard again within five seconds.
//!
//! ```text
//! # Times of MAVLink signatures that this bridge has accepted; see docs/bridge.md.
//! newest 37545600000000
//! link 3 system 255 component 190 time 37545599999000
//! ```

use anyhow::{Context as _, Result, anyhow};
use rustix::fs::{FlockOperation, flock};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

/// Link ID, system and component.
pub type Stream = (u8, u8, u8);

/// Units of a timestamp in a second: it counts 10 us.
pub const UNITS_PER_S: u64 = 100_000;
/// How far the file is ahead.
const AHEAD: u64 = 5 * UNITS_PER_S;
const TITLE: &str =
    "# Times of MAVLink signatures that this bridge has accepted; see docs/bridge.md.";

/// The newest timestamp that was accepted or sent, and the last accepted of each stream.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Times {
    pub newest: u64,
    pub streams: BTreeMap<Stream, u64>,
}

impl Times {
    fn ahead(&self) -> Times {
        let streams = self.streams.iter().map(|(stream, last)| (*stream, last + AHEAD)).collect();
        Times { newest: self.newest + AHEAD, streams }
    }

    fn to_text(&self) -> String {
        let mut text = format!("{TITLE}\nnewest {}\n", self.newest);
        for ((link, system, component), last) in &self.streams {
            text += &format!("link {link} system {system} component {component} time {last}\n");
        }
        text
    }

    /// `None` unless all lines are valid and one is the newest timestamp.
    fn parse(text: &str) -> Option<Times> {
        let (mut newest, mut streams) = (None, BTreeMap::new());
        for line in text.lines().filter(|line| !line.starts_with('#')) {
            match *line.split(' ').collect::<Vec<_>>() {
                ["newest", time] => newest = Some(time.parse().ok()?),
                ["link", link, "system", system, "component", component, "time", time] => {
                    let stream =
                        (link.parse().ok()?, system.parse().ok()?, component.parse().ok()?);
                    streams.insert(stream, time.parse().ok()?);
                }
                _ => return None,
            }
        }
        Some(Times { newest: newest?, streams })
    }
}

/// The file, and what it says.
pub struct TimesFile {
    path: PathBuf,
    /// Locked as long as the bridge runs.
    _lock: File,
    /// What the file says.
    reserved: Times,
    /// What to write at the end.
    exact: Times,
    has_failed: bool,
    /// Lines for the user.
    pub log: Vec<String>,
}

impl TimesFile {
    /// Opens the file, or creates it, and reads it.
    ///
    /// # Errors
    /// If another bridge has it open, if it cannot be written, or if it has another content.
    pub fn open(path: &Path) -> Result<(TimesFile, Times)> {
        let named = || format!("cannot keep the times of signatures in {}", path.display());
        let lock = File::create(beside(path, "lock"))
            .with_context(|| named() + "; --signing-state FILE chooses another place")?;
        flock(&lock, FlockOperation::NonBlockingLockExclusive).map_err(|_| {
            anyhow!(
                "another bridge uses {}; give this one another --signing-state FILE",
                path.display()
            )
        })?;
        let times = match fs::read_to_string(path) {
            Ok(text) => Times::parse(&text).with_context(|| {
                format!("{} does not have the times of signatures: remove it", path.display())
            })?,
            Err(error) if error.kind() == ErrorKind::NotFound => Times::default(),
            Err(error) => return Err(error).with_context(named),
        };
        let mut file = TimesFile {
            path: path.to_owned(),
            _lock: lock,
            reserved: times.clone(),
            exact: times.clone(),
            has_failed: false,
            log: Vec::new(),
        };
        file.write(&times).with_context(named)?;
        Ok((file, times))
    }

    /// Makes sure that the file has no smaller timestamp than `times` has of this stream, and no
    /// smaller newest one. If it cannot be written, the user is told once.
    pub fn reserve(&mut self, times: &Times, stream: Option<Stream>) {
        self.exact.newest = times.newest;
        let last = |times: &Times| stream.and_then(|stream| times.streams.get(&stream).copied());
        if times.newest <= self.reserved.newest && last(times) <= last(&self.reserved) {
            if let Some((stream, last)) = stream.zip(last(times)) {
                self.exact.streams.insert(stream, last);
            }
            return;
        }
        self.exact = times.clone();
        let written = self.write(&times.ahead());
        match written {
            Ok(()) => self.has_failed = false,
            Err(error) if !std::mem::replace(&mut self.has_failed, true) => {
                self.log.push(format!(
                    "cannot write {}: {error}; after a restart old signed messages may be accepted",
                    self.path.display()
                ));
            }
            Err(_) => {}
        }
    }

    /// Replaces the file, so that a crash or a power failure leaves the old or the new one.
    fn write(&mut self, times: &Times) -> std::io::Result<()> {
        let new = beside(&self.path, "new");
        let mut file = File::create(&new)?;
        file.write_all(times.to_text().as_bytes())?;
        file.sync_data()?;
        fs::rename(&new, &self.path)?;
        self.reserved = times.clone();
        Ok(())
    }
}

impl Drop for TimesFile {
    fn drop(&mut self) {
        // Without this the file is ahead, which is safe.
        let _ = self.write(&self.exact.clone());
    }
}

/// A file beside `path`, with a longer name.
fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(ending);
    name.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times() -> Times {
        Times { newest: 9_000_000, streams: BTreeMap::from([((3, 255, 190), 8_999_999)]) }
    }

    #[test]
    fn the_text_survives_a_round_trip_and_other_texts_are_rejected() {
        assert_eq!(Times::parse(&times().to_text()), Some(times()));
        for wrong in ["", "newest", "newest x\n", "newest 1\nlink 256 system 1 component 1 time 1"]
        {
            assert_eq!(Times::parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_file_is_one_bridge_s_and_only_a_file_of_times_is_replaced() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("times");
        let error = |path: &Path| format!("{:#}", TimesFile::open(path).err().unwrap());
        let first = TimesFile::open(&path).unwrap();
        assert!(error(&path).contains("another bridge uses"));
        drop(first);
        assert!(TimesFile::open(&path).is_ok());
        fs::write(&path, "correct horse\n").unwrap();
        assert!(error(&path).ends_with("does not have the times of signatures: remove it"));
        assert_eq!(fs::read_to_string(&path).unwrap(), "correct horse\n");
        assert!(error(&directory.path().join("no/times")).contains("--signing-state FILE"));
    }

    #[test]
    fn the_file_is_written_once_in_five_seconds_and_exactly_at_the_end() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("times");
        let (mut file, mut times) = TimesFile::open(&path).unwrap();
        let text = || fs::read_to_string(&path).unwrap();
        let (mut last, mut writes) = (text(), 0);
        // 100 messages a second for a minute.
        for number in 1..=6000 {
            times.newest = 1_000_000 + number * UNITS_PER_S / 100;
            times.streams.insert((3, 255, 190), times.newest);
            file.reserve(&times, Some((3, 255, 190)));
            let now = text();
            let stored = Times::parse(&now).unwrap();
            assert!(stored.newest >= times.newest);
            assert!(stored.streams[&(3, 255, 190)] >= times.newest);
            writes += u32::from(std::mem::replace(&mut last, now.clone()) != now);
        }
        assert!((12..=14).contains(&writes), "{writes}");
        drop(file);
        assert_eq!(Times::parse(&text()), Some(times));
    }

    #[test]
    fn a_full_disk_is_logged_once() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("sub/times");
        fs::create_dir(path.parent().unwrap()).unwrap();
        let (mut file, _) = TimesFile::open(&path).unwrap();
        fs::remove_dir_all(path.parent().unwrap()).unwrap();
        for _ in 0..3 {
            file.reserve(&times(), Some((3, 255, 190)));
        }
        assert_eq!(file.log.len(), 1, "{:?}", file.log);
    }
}
