//! A pseudo-terminal in place of a serial port. A symbolic link to it has the path that the user
//! chose; any terminal program can open it.

use anyhow::{Context as _, Result, bail};
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, Termios, tcgetattr, tcsetattr};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::ffi::OsStrExt as _;
use std::path::{Path, PathBuf};

/// Baud rate until a program sets another.
const BAUD_RATE_AT_FIRST: u32 = 115_200;
/// Maximum number of bytes that wait to be read from the terminal. If no program reads, the bridge
/// drops the newest.
const UNREAD_MAX: usize = 64 * 1024;

pub struct Pty {
    master: OwnedFd,
    /// Stays open so that programs can open and close the terminal.
    slave: OwnedFd,
    link: PathBuf,
    unread: Vec<u8>,
    /// Bytes dropped because no program read them.
    pub dropped: u64,
}

impl Pty {
    /// Opens a pseudo-terminal and makes `link` a symbolic link to it.
    ///
    /// # Errors
    /// If that path exists already.
    pub fn open(link: &Path) -> Result<Pty> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)
            .context("cannot open a pseudo-terminal")?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let name = ptsname(&master, Vec::new())?;
        let slave = rustix::fs::open(
            &name,
            OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC,
            Mode::empty(),
        )?;
        let mut settings: Termios = tcgetattr(&slave)?;
        settings.make_raw();
        settings.set_speed(BAUD_RATE_AT_FIRST)?;
        tcsetattr(&slave, OptionalActions::Now, &settings)?;
        rustix::fs::fcntl_setfl(&master, OFlags::NONBLOCK)?;
        match link.symlink_metadata() {
            // The link of a bridge that was killed.
            Ok(found) if found.is_symlink() && !link.exists() => std::fs::remove_file(link)?,
            Ok(_) => bail!("{} exists already", link.display()),
            Err(_) => {}
        }
        let target = Path::new(std::ffi::OsStr::from_bytes(name.to_bytes()));
        std::os::unix::fs::symlink(target, link)
            .with_context(|| format!("cannot make {}", link.display()))?;
        Ok(Pty { master, slave, link: link.to_owned(), unread: Vec::new(), dropped: 0 })
    }

    /// The baud rate that the program has set.
    pub fn baud_rate(&self) -> u32 {
        tcgetattr(&self.slave).map_or(BAUD_RATE_AT_FIRST, |settings| settings.output_speed())
    }

    /// Bytes that the program has written.
    pub fn read(&mut self) -> Vec<u8> {
        let mut buffer = [0; 1024];
        rustix::io::read(&self.master, &mut buffer)
            .map_or_else(|_| Vec::new(), |length| buffer[..length].to_vec())
    }

    /// Writes bytes for the program to read.
    pub fn write(&mut self, bytes: &[u8]) {
        let room = UNREAD_MAX - self.unread.len().min(UNREAD_MAX);
        self.unread.extend(&bytes[..bytes.len().min(room)]);
        self.dropped += bytes.len().saturating_sub(room) as u64;
        self.flush();
    }

    /// Writes the bytes that the terminal did not accept before.
    pub fn flush(&mut self) {
        while !self.unread.is_empty() {
            match rustix::io::write(&self.master, &self.unread) {
                Ok(written) => drop(self.unread.drain(..written)),
                Err(Errno::INTR) => {}
                Err(_) => return,
            }
        }
    }

    /// The file descriptor to poll; `true` if also for room to write.
    pub fn poll_fd(&self) -> (BorrowedFd<'_>, bool) {
        (self.master.as_fd(), !self.unread.is_empty())
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        // The link may be removed already.
        let _ = std::fs::remove_file(&self.link);
    }
}
