//! A pseudo-terminal that serves as a serial port: raw, non-blocking, and with a name that the user
//! chooses.
//!
//! The kernel chooses the number of a pseudo-terminal, so the port has a symbolic link at the
//! user's path. The port removes the link when it is dropped and when the program panics. It
//! replaces the link of a simulator that was killed, but not of one that is running: an abstract
//! Unix socket, which ends with its process, reserves each name.
//!
//! A pseudo-terminal has no modem lines, and only remembers the baud rate that a program sets. The
//! kernel buffers about 70 KiB in each direction. inotify counts how often programs open and close
//! the port. The port also opens its own slave end, because only there the kernel discards what
//! programs have not read. So bytes that are written while no program has the port open wait for
//! the next one.

use anyhow::{Context, Result, bail};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::inotify::{self, CreateFlags, ReadFlags, Reader, WatchFlags};
use rustix::fs::{Mode, OFlags, fcntl_setfl, open};
use rustix::io::{Errno, read, retry_on_intr, write};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{
    OptionalActions, QueueSelector, Termios, ioctl_tiocnxcl, tcflush, tcgetattr, tcsetattr,
};
use std::fs;
use std::io::ErrorKind;
use std::mem::MaybeUninit;
use std::os::fd::OwnedFd;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::fs::symlink;
use std::os::unix::net::{SocketAddr, UnixListener};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, Once};
use std::thread::{self, ThreadId};

/// The directory of pseudo-terminals. A link to another directory is not a port of sim and is not
/// replaced.
const DEVICES: &str = "/dev/pts/";
/// Baud rate of a port until a program sets one, as Linux has it for real ones.
pub const FIRST_BAUD: u32 = 9600;
/// Most bytes read from a client at once.
const READ_BYTES: usize = 4096;
/// Size of the buffer for inotify events, in bytes.
const EVENT_BYTES: usize = 4096;

/// How programs opened a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Openings {
    /// Number of openings while no other program had the port open. A real port raises DTR at
    /// these.
    pub count: u64,
    /// True if a program has the port open now.
    pub is_open: bool,
}

/// The master end of a pseudo-terminal and the link to its slave end.
#[derive(Debug)]
pub struct Pty {
    master: OwnedFd,
    slave: OwnedFd,
    watch: Watch,
    link: Link,
}

impl Pty {
    /// Creates a pseudo-terminal with a link at `path`.
    ///
    /// # Errors
    /// If `path` is in use or cannot be created; the message says what to do.
    pub fn open(path: &Path) -> Result<Pty> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)
            .context("the system cannot create a pseudo-terminal")?;
        grantpt(&master)?;
        unlockpt(&master)?;
        fcntl_setfl(&master, OFlags::NONBLOCK)?;
        let device =
            ptsname(&master, Vec::new())?.into_string().context("the pseudo-terminal's name")?;
        let slave = open_slave(Path::new(&device))?;
        // Sets raw mode before any program can open the port, so that no program gets an echo or a
        // translated line end.
        let mut settings = tcgetattr(&slave)?;
        settings.make_raw();
        settings.set_speed(FIRST_BAUD)?;
        tcsetattr(&slave, OptionalActions::Now, &settings)?;
        // Watches from here on: after the opening above, and before the link lets other programs
        // open the port.
        let watch = Watch::new(&device)?;
        let link = Link::publish(path, Path::new(&device))?;
        Ok(Pty { master, slave, watch, link })
    }

    /// The path of the link, which programs open.
    pub fn path(&self) -> &Path {
        &self.link.path
    }

    /// Reads bytes of the client, up to 4096. Empty if there are none.
    pub fn read(&self) -> Vec<u8> {
        let mut bytes = vec![0; READ_BYTES];
        // With an error there is nothing to read, either.
        let count = read(&self.master, &mut bytes).unwrap_or(0);
        bytes.truncate(count);
        bytes
    }

    /// Writes bytes for the client. Returns how many the kernel took.
    pub fn write(&self, bytes: &[u8]) -> usize {
        loop {
            match write(&self.master, bytes) {
                Ok(count) => return count,
                Err(Errno::INTR) => {}
                Err(_) => return 0,
            }
        }
    }

    /// The openings since the last call.
    pub fn take_openings(&mut self) -> Openings {
        let was_open = self.watch.openers > 0;
        let (mut count, complete) = self.watch.take();
        if !complete {
            // The kernel's queue overflowed: there was at least one opening.
            count = count.max(1);
            let _ = self.find_opener();
        }
        let is_open = self.watch.openers > 0;
        if !is_open && (was_open || count > 0) {
            // A program can lock a port for itself (TIOCEXCL). The kernel unlocks it when nobody
            // has it open any more, which the port itself always has.
            let _ = ioctl_tiocnxcl(&self.slave);
        }
        Openings { count, is_open }
    }

    /// Finds out whether a program has the port open, after events were lost.
    fn find_opener(&mut self) -> Result<()> {
        // The master shows it while the port's own slave end is closed.
        self.slave = self.master.try_clone()?;
        let is_open = !is_hung_up(&self.master);
        self.slave = open_slave(&self.link.device)?;
        // Drops the events of closing and opening it.
        self.watch.take();
        self.watch.openers = usize::from(is_open);
        Ok(())
    }

    /// The baud rate that a program has set last.
    pub fn baud(&self) -> Option<u32> {
        // On Linux the master's settings are those of the slave.
        tcgetattr(&self.master)
            .ok()
            .map(|settings| settings.output_speed())
            .filter(|baud| *baud > 0)
    }

    /// Discards written bytes that no program has read.
    pub fn discard_unread(&self) {
        // The kernel has two buffers for them: the output of the master, and the input of the
        // slave. tcflush leaves the settings alone, which a program may be changing.
        let _ = tcflush(&self.master, QueueSelector::OFlush);
        let _ = tcflush(&self.slave, QueueSelector::IFlush);
    }

    /// Prepares the port for the next program: empties both directions, and sets raw mode again.
    pub fn renew(&self) {
        // 20 reads are 80 KiB, which is more than the kernel buffers. More reads could take bytes
        // of the next program.
        for _ in 0..20 {
            self.read();
        }
        self.discard_unread();
        let Ok(found) = tcgetattr(&self.slave) else { return };
        let mut raw = found.clone();
        raw.make_raw();
        let modes = |s: &Termios| (s.input_modes, s.output_modes, s.control_modes, s.local_modes);
        // Most programs leave raw mode. Setting it again could undo the baud rate of the next
        // program, which may have opened the port already.
        if modes(&raw) != modes(&found) {
            let _ = tcsetattr(&self.slave, OptionalActions::Now, &raw);
        }
    }
}

/// Opens the slave end of a pseudo-terminal.
fn open_slave(device: &Path) -> Result<OwnedFd> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC | OFlags::NONBLOCK;
    open(device, flags, Mode::empty()).with_context(|| format!("cannot open {}", device.display()))
}

/// True if the other end of a terminal is closed.
pub fn is_hung_up(end: &OwnedFd) -> bool {
    let mut ends = [PollFd::new(end, PollFlags::IN)];
    let now = Timespec { tv_sec: 0, tv_nsec: 0 };
    retry_on_intr(|| poll(&mut ends, Some(&now))).is_ok()
        && ends[0].revents().contains(PollFlags::HUP)
}

/// Counts the programs that have a device open.
#[derive(Debug)]
struct Watch {
    inotify: OwnedFd,
    /// inotify's number of the device.
    device: i32,
    openers: usize,
}

impl Watch {
    fn new(device: &str) -> Result<Watch> {
        let watch = || {
            let inotify = inotify::init(CreateFlags::NONBLOCK | CreateFlags::CLOEXEC)?;
            let what = WatchFlags::OPEN | WatchFlags::CLOSE_WRITE | WatchFlags::CLOSE_NOWRITE;
            // inotify merges two equal events in a row. The events of the directory between them
            // keep them apart.
            inotify::add_watch(&inotify, DEVICES, what)?;
            let device = inotify::add_watch(&inotify, device, what)?;
            Ok::<_, Errno>(Watch { inotify, device, openers: 0 })
        };
        watch().with_context(|| {
            format!(
                "cannot watch {device} with inotify; do other programs use up \
                 fs.inotify.max_user_instances?"
            )
        })
    }

    /// Openings since the last call while no program had the device open; and false if inotify has
    /// lost events.
    fn take(&mut self) -> (u64, bool) {
        let mut buffer = [MaybeUninit::uninit(); EVENT_BYTES];
        let mut events = Reader::new(&self.inotify, &mut buffer);
        let (mut count, mut complete) = (0, true);
        // Ends with an error when there are no more events.
        while let Ok(event) = events.next() {
            let what = event.events();
            if what.contains(ReadFlags::QUEUE_OVERFLOW) {
                complete = false;
            } else if event.wd() != self.device {
            } else if what.contains(ReadFlags::OPEN) {
                count += u64::from(self.openers == 0);
                self.openers += 1;
            } else if what.intersects(ReadFlags::CLOSE_WRITE | ReadFlags::CLOSE_NOWRITE) {
                self.openers = self.openers.saturating_sub(1);
            }
        }
        (count, complete)
    }
}

/// The symbolic link to a port. Removed on drop.
#[derive(Debug)]
struct Link {
    path: PathBuf,
    device: PathBuf,
    /// Reserves the name while this process runs.
    _claim: UnixListener,
}

/// Links that the panic hook removes if their thread panics. A program that aborts at a panic drops
/// nothing.
static PUBLISHED: Mutex<Vec<(ThreadId, PathBuf, PathBuf)>> = Mutex::new(Vec::new());
static PANIC_HOOK: Once = Once::new();

impl Link {
    fn publish(path: &Path, device: &Path) -> Result<Link> {
        let name = path
            .file_name()
            .with_context(|| format!("{} cannot be the name of a port", path.display()))?;
        let directory = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let directory = fs::canonicalize(directory)
            .with_context(|| format!("there is no directory {} for a port", directory.display()))?;
        let path = directory.join(name);
        let claim = claim(&path)?;
        match fs::symlink_metadata(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => {
                return Err(error).with_context(|| format!("cannot read {}", path.display()));
            }
            Ok(found) if found.is_symlink() && fs::read_link(&path)?.starts_with(DEVICES) => {
                fs::remove_file(&path)
                    .with_context(|| format!("cannot replace the old link {}", path.display()))?;
            }
            Ok(_) => {
                bail!(
                    "{} exists and is not a port of sim: choose another path, or remove it",
                    path.display()
                )
            }
        }
        symlink(device, &path)
            .with_context(|| format!("cannot create the link {}", path.display()))?;
        PANIC_HOOK.call_once(remove_links_on_panic);
        published().push((thread::current().id(), path.clone(), device.to_owned()));
        Ok(Link { path, device: device.to_owned(), _claim: claim })
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        published().retain(|(_, path, _)| *path != self.path);
        remove(&self.path, &self.device);
    }
}

fn published() -> std::sync::MutexGuard<'static, Vec<(ThreadId, PathBuf, PathBuf)>> {
    PUBLISHED.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// Removes the link if it still leads to `device`.
fn remove(path: &Path, device: &Path) {
    if fs::read_link(path).is_ok_and(|target| target == device) {
        let _ = fs::remove_file(path);
    }
}

fn remove_links_on_panic() {
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let here = thread::current().id();
        for (_, path, device) in published().iter().filter(|(thread, ..)| *thread == here) {
            remove(path, device);
        }
        before(panic);
    }));
}

/// Reserves the name of a port: binds a socket to it. Only one process can do so, and its end
/// releases the name.
fn claim(path: &Path) -> Result<UnixListener> {
    let mut name = b"sim port ".to_vec();
    name.extend(path.as_os_str().as_encoded_bytes());
    // The name of a Unix socket has at most 107 bytes. The end of a long path differs more often
    // than its start.
    let start = name.len().saturating_sub(100);
    let address = SocketAddr::from_abstract_name(&name[start..])?;
    match UnixListener::bind_addr(&address) {
        Ok(claim) => Ok(claim),
        Err(error) if error.kind() == ErrorKind::AddrInUse => {
            bail!(
                "{} is a port of another sim that runs: choose another path, or end the other sim",
                path.display()
            )
        }
        Err(error) => {
            Err(error).with_context(|| format!("cannot reserve the name {}", path.display()))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::links::scratch::Scratch;
    use std::fs::File;
    use std::io::{Read, Write};

    fn client(path: &Path) -> File {
        File::options().read(true).write(true).open(path).unwrap()
    }

    fn port() -> (Scratch, Pty) {
        let scratch = Scratch::new();
        let pty = Pty::open(&scratch.path("port")).unwrap();
        (scratch, pty)
    }

    fn openings(pty: &mut Pty) -> (u64, bool) {
        let Openings { count, is_open } = pty.take_openings();
        (count, is_open)
    }

    #[test]
    fn a_stale_link_is_replaced_and_anything_else_is_not() {
        let scratch = Scratch::new();
        let path = scratch.path("port");
        symlink("/dev/pts/99999", &path).unwrap();
        drop(Pty::open(&path).unwrap());
        assert!(fs::symlink_metadata(&path).is_err(), "the link is there after the port's end");
        fs::write(&path, "a thesis").unwrap();
        let error = Pty::open(&path).unwrap_err().to_string();
        assert!(error.contains("choose another path"), "{error}");
        assert_eq!(fs::read(&path).unwrap(), b"a thesis");
        let elsewhere = scratch.path("by-id");
        symlink("/dev/ttyUSB0", &elsewhere).unwrap();
        assert!(Pty::open(&elsewhere).is_err());
        assert!(Pty::open(&scratch.path("no/such/directory")).is_err());
    }

    #[test]
    fn a_port_counts_its_openings_and_is_open_until_the_last_program_closes_it() {
        let (_scratch, mut pty) = port();
        assert_eq!(openings(&mut pty), (0, false), "its own opening");
        let first = client(pty.path());
        assert_eq!(openings(&mut pty), (1, true));
        drop(first);
        assert_eq!(openings(&mut pty), (0, false));
        drop(client(pty.path()));
        let clients: Vec<_> = (0..3).map(|_| client(pty.path())).collect();
        assert_eq!(openings(&mut pty), (2, true));
        let last = File::open(pty.path()).unwrap();
        drop(clients);
        drop(client(pty.path()));
        assert_eq!(openings(&mut pty), (0, true));
        drop(last);
        assert_eq!(openings(&mut pty), (0, false));
    }

    #[test]
    fn the_state_is_right_after_more_openings_than_the_kernel_can_queue() {
        let (_scratch, mut pty) = port();
        let limit = fs::read_to_string("/proc/sys/fs/inotify/max_queued_events").unwrap();
        let limit: usize = limit.trim().parse().unwrap();
        // Each event comes twice. These clients open the port before the queue is full, and close
        // it after.
        let crowd: Vec<_> = (0..100).map(|_| client(pty.path())).collect();
        for _ in 0..limit / 4 {
            client(pty.path());
        }
        drop(crowd);
        let (count, is_open) = openings(&mut pty);
        assert!(count >= 1 && !is_open, "{count} {is_open}");
        let _client = client(pty.path());
        assert_eq!(openings(&mut pty), (1, true));
    }

    #[test]
    fn a_renewed_port_is_empty() {
        let (_scratch, pty) = port();
        client(pty.path()).write_all(b"unread").unwrap();
        assert_eq!(pty.write(b"unread"), 6);
        pty.renew();
        assert_eq!(pty.read(), b"");
        let mut client = client(pty.path());
        assert_eq!(pty.write(b"new"), 3);
        let mut received = [0; 9];
        assert_eq!(client.read(&mut received).unwrap(), 3);
        assert_eq!(&received[..3], b"new");
    }

    #[test]
    fn a_program_that_opens_the_port_while_it_is_emptied_keeps_its_settings() {
        let (_scratch, pty) = port();
        let client = client(pty.path());
        thread::scope(|scope| {
            let program = scope.spawn(|| {
                for baud in [9600, 115_200].into_iter().cycle().take(20_000) {
                    let mut settings = tcgetattr(&client).unwrap();
                    settings.set_speed(baud).unwrap();
                    tcsetattr(&client, OptionalActions::Now, &settings).unwrap();
                    let kept = tcgetattr(&client).unwrap().output_speed();
                    assert_eq!(kept, baud, "baud that the program set just before");
                }
            });
            while !program.is_finished() {
                pty.renew();
            }
        });
    }

    #[test]
    fn a_client_that_never_reads_does_not_block() {
        let (_scratch, pty) = port();
        let taken: usize = (0..100).map(|_| pty.write(&[b'x'; 1024])).sum();
        assert!((1024..100 * 1024).contains(&taken), "{taken}");
        let mut client = client(pty.path());
        pty.discard_unread();
        assert_eq!(pty.write(b"y"), 1);
        let mut received = [0; 2];
        assert_eq!(client.read(&mut received).unwrap(), 1);
        assert_eq!(received[0], b'y');
    }

    #[test]
    fn a_panic_removes_the_links_of_its_thread_only() {
        let scratch = Scratch::new();
        let (mine, doomed) = (scratch.path("mine"), scratch.path("doomed"));
        let _port = Pty::open(&mine).unwrap();
        let other = doomed.clone();
        let ended = thread::spawn(move || {
            let port = Pty::open(&other).unwrap();
            // Not dropped, as in a program that aborts at a panic.
            std::mem::forget(port);
            panic!("on purpose");
        });
        assert!(ended.join().is_err());
        assert!(fs::symlink_metadata(&doomed).is_err());
        assert!(fs::symlink_metadata(&mine).is_ok());
    }
}
