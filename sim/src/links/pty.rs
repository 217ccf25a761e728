//! A pseudo-terminal that passes for a serial port: raw at both ends, never blocking, under a name that stays.
//!
//! The kernel numbers pseudo-terminals as it likes, so each gets a symbolic link where the user wants it. The link is
//! removed when the port is dropped, and when the program panics. What a killed simulator left behind is replaced; what
//! another running one offers is not: each name is claimed by an abstract Unix socket, which dies with its process.
//!
//! A pseudo-terminal has no modem lines and no baud rate, and the kernel keeps some 70 KiB in each direction. Who opens and
//! closes it is counted by inotify, because the master itself only has the present state.

use anyhow::{Context, Result, bail};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::inotify::{self, CreateFlags, ReadFlags, Reader, WatchFlags};
use rustix::fs::{Mode, OFlags, fcntl_setfl, open};
use rustix::io::{Errno, read, write};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr};
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

/// Where the kernel puts pseudo-terminals: a link to elsewhere is not ours to replace.
const DEVICES: &str = "/dev/pts/";
/// Bytes taken from a client in one go.
const READ_BYTES: usize = 4096;
/// Notices of openings and closings taken from the kernel in one go.
const NOTICE_BYTES: usize = 4096;

/// Whether the port is to look open while no program has it open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hold {
    /// Yes: what is written waits for the next program, and it cannot be told whether there is one.
    Open,
    /// No: [`Pty::visits`] shows if a program has it open, or had it open.
    Released,
}

/// What programs did with a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Visits {
    /// How often it was opened while nobody else had it open: when a real port raises DTR.
    pub begun: u64,
    /// Whether a program has it open now.
    pub present: bool,
}

/// The master end of a pseudo-terminal and the link to its slave end.
#[derive(Debug)]
pub struct Pty {
    master: OwnedFd,
    /// The slave end, if it is held open.
    held: Option<OwnedFd>,
    /// Counts who has it open, if it is not held open.
    watch: Option<Watch>,
    link: Link,
}

impl Pty {
    /// Makes a pseudo-terminal, with a link at `path`.
    ///
    /// # Errors
    /// If `path` is in use or cannot be made; the message says what to do.
    pub fn open(path: &Path, hold: Hold) -> Result<Pty> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)
            .context("no pseudo-terminal to be had from this system")?;
        grantpt(&master)?;
        unlockpt(&master)?;
        fcntl_setfl(&master, OFlags::NONBLOCK)?;
        let device = ptsname(&master, Vec::new())?.into_string().context("the pseudo-terminal's name")?;
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC | OFlags::NONBLOCK;
        let slave = open(&device, flags, Mode::empty()).with_context(|| format!("cannot open {device}"))?;
        // Before anybody can see it: a program must never meet an echo or a translated line end. Closing it once also
        // makes the master report that nobody has it open.
        let mut settings = tcgetattr(&slave)?;
        settings.make_raw();
        tcsetattr(&slave, OptionalActions::Now, &settings)?;
        let held = (hold == Hold::Open).then_some(slave);
        // After our own opening, which is no visit, and before anybody else's.
        let watch = if held.is_none() { Some(Watch::new(&device)?) } else { None };
        let link = Link::publish(path, Path::new(&device))?;
        Ok(Pty { master, held, watch, link })
    }

    /// Where a program finds the port.
    pub fn path(&self) -> &Path {
        &self.link.path
    }

    /// Takes what has come in, as much as is there up to a few kilobytes. Empty when there is nothing.
    pub fn read(&self) -> Vec<u8> {
        let mut bytes = vec![0; READ_BYTES];
        // EIO: nobody has it open. Any other error ends like it: there is nothing to read.
        let count = read(&self.master, &mut bytes).unwrap_or(0);
        bytes.truncate(count);
        bytes
    }

    /// Gives bytes to the kernel and returns how many it took.
    pub fn write(&self, bytes: &[u8]) -> usize {
        loop {
            match write(&self.master, bytes) {
                Ok(count) => return count,
                Err(Errno::INTR) => {}
                Err(_) => return 0,
            }
        }
    }

    /// What programs did with it since the last call. Of a port that is held open nothing can be told.
    pub fn visits(&mut self) -> Visits {
        let Some(watch) = &mut self.watch else {
            return Visits { begun: 0, present: true };
        };
        let (begun, complete) = watch.take();
        if complete {
            return Visits { begun, present: watch.openers > 0 };
        }
        // More than the kernel keeps: that there were visits is sure, and what the port looks like now.
        let present = is_open(&self.master);
        watch.openers = usize::from(present);
        Visits { begun: begun.max(1), present }
    }

    /// Drops what the kernel holds for a program that has not read it.
    pub fn discard_unread(&self) {
        // It sits in two places: on its way out of the master, and at the slave's input.
        let _ = tcflush(&self.master, QueueSelector::OFlush);
        match &self.held {
            Some(slave) => drop(tcflush(slave, QueueSelector::IFlush)),
            // On Linux the master's settings are those of the slave, and setting them can flush its input.
            None => drop(tcgetattr(&self.master).map(|s| tcsetattr(&self.master, OptionalActions::Flush, &s))),
        }
    }

    /// Makes it as new for the next program: raw again, whatever the last one set, and nothing left in it.
    pub fn renew(&self) {
        // Not more than the kernel can hold: another program may write already.
        for _ in 0..20 {
            self.read();
        }
        self.discard_unread();
        if let Ok(mut settings) = tcgetattr(&self.master) {
            settings.make_raw();
            let _ = tcsetattr(&self.master, OptionalActions::Now, &settings);
        }
    }
}

/// Whether any program has the slave end open.
fn is_open(master: &OwnedFd) -> bool {
    let mut ends = [PollFd::new(master, PollFlags::IN)];
    let now = Timespec { tv_sec: 0, tv_nsec: 0 };
    match poll(&mut ends, Some(&now)) {
        Ok(_) => !ends[0].revents().contains(PollFlags::HUP),
        Err(_) => false,
    }
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
            // inotify makes one of two equal notices in a row. With those of the directory in between none are equal.
            inotify::add_watch(&inotify, DEVICES, what)?;
            let device = inotify::add_watch(&inotify, device, what)?;
            Ok::<_, Errno>(Watch { inotify, device, openers: 0 })
        };
        watch().with_context(|| {
            format!("cannot watch who opens {device}; do other programs use up fs.inotify.max_user_instances?")
        })
    }

    /// How often the device was opened by a first program since the last call, and whether all notices of it were there.
    fn take(&mut self) -> (u64, bool) {
        let mut buffer = [MaybeUninit::uninit(); NOTICE_BYTES];
        let mut notices = Reader::new(&self.inotify, &mut buffer);
        let (mut begun, mut complete) = (0, true);
        // The error at the end: there are no more.
        while let Ok(notice) = notices.next() {
            let what = notice.events();
            if what.contains(ReadFlags::QUEUE_OVERFLOW) {
                complete = false;
            } else if notice.wd() != self.device {
            } else if what.contains(ReadFlags::OPEN) {
                begun += u64::from(self.openers == 0);
                self.openers += 1;
            } else if what.intersects(ReadFlags::CLOSE_WRITE | ReadFlags::CLOSE_NOWRITE) {
                self.openers = self.openers.saturating_sub(1);
            }
        }
        (begun, complete)
    }
}

/// A published link. Removed on drop.
#[derive(Debug)]
struct Link {
    path: PathBuf,
    device: PathBuf,
    /// Claims the name as long as this process lives.
    _claim: UnixListener,
}

/// Links to be removed should their thread panic: a program that aborts drops nothing.
static PUBLISHED: Mutex<Vec<(ThreadId, PathBuf, PathBuf)>> = Mutex::new(Vec::new());
static PANIC_HOOK: Once = Once::new();

impl Link {
    fn publish(path: &Path, device: &Path) -> Result<Link> {
        let name = path.file_name().with_context(|| format!("{} is no name for a port", path.display()))?;
        let directory = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let directory =
            fs::canonicalize(directory).with_context(|| format!("no directory {} for a port", directory.display()))?;
        let path = directory.join(name);
        let claim = claim(&path)?;
        match fs::symlink_metadata(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(error).with_context(|| format!("cannot look at {}", path.display())),
            Ok(found) if found.is_symlink() && fs::read_link(&path)?.starts_with(DEVICES) => {
                fs::remove_file(&path).with_context(|| format!("cannot replace the old link {}", path.display()))?;
            }
            Ok(_) => {
                bail!("{} is there already and is not a port of sim: choose another path, or remove it", path.display())
            }
        }
        symlink(device, &path).with_context(|| format!("cannot make the link {}", path.display()))?;
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

/// Removes the link if it is still the one that was made.
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

/// A socket that nobody talks to: its name can be had once, and goes with the process.
fn claim(path: &Path) -> Result<UnixListener> {
    let mut name = b"sim port ".to_vec();
    name.extend(path.as_os_str().as_encoded_bytes());
    // A Unix socket's name has room for 107 bytes; of a longer path the end is more useful.
    let start = name.len().saturating_sub(100);
    let address = SocketAddr::from_abstract_name(&name[start..])?;
    match UnixListener::bind_addr(&address) {
        Ok(claim) => Ok(claim),
        Err(error) if error.kind() == ErrorKind::AddrInUse => {
            bail!("{} is a port of another sim that is running: choose another path, or end that one", path.display())
        }
        Err(error) => Err(error).with_context(|| format!("cannot claim the name {}", path.display())),
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

    #[test]
    fn bytes_pass_unchanged_both_ways() {
        let scratch = Scratch::new();
        let pty = Pty::open(&scratch.path("port"), Hold::Open).unwrap();
        let mut client = client(pty.path());
        let every_byte: Vec<u8> = (0..=255).collect();
        client.write_all(&every_byte).unwrap();
        assert_eq!(pty.read(), every_byte);
        assert_eq!(pty.write(&every_byte), 256);
        let mut heard = [0; 256];
        client.read_exact(&mut heard).unwrap();
        assert_eq!(heard.as_slice(), every_byte);
        assert_eq!(pty.read(), b"", "an echo");
    }

    #[test]
    fn the_link_goes_with_the_port() {
        let scratch = Scratch::new();
        let path = scratch.path("port");
        let pty = Pty::open(&path, Hold::Open).unwrap();
        assert!(fs::symlink_metadata(&path).unwrap().is_symlink());
        drop(pty);
        assert!(fs::symlink_metadata(&path).is_err());
    }

    #[test]
    fn a_stale_link_is_replaced_and_anything_else_is_not() {
        let scratch = Scratch::new();
        let path = scratch.path("port");
        symlink("/dev/pts/99999", &path).unwrap();
        drop(Pty::open(&path, Hold::Open).unwrap());
        fs::write(&path, "a thesis").unwrap();
        let error = Pty::open(&path, Hold::Open).unwrap_err().to_string();
        assert!(error.contains("choose another path"), "{error}");
        assert_eq!(fs::read(&path).unwrap(), b"a thesis");
        let elsewhere = scratch.path("by-id");
        symlink("/dev/ttyUSB0", &elsewhere).unwrap();
        assert!(Pty::open(&elsewhere, Hold::Open).is_err());
        assert!(Pty::open(&scratch.path("no/such/directory"), Hold::Open).is_err());
    }

    #[test]
    fn a_name_in_use_is_refused_and_free_afterwards() {
        let scratch = Scratch::new();
        let path = scratch.path("port");
        let first = Pty::open(&path, Hold::Open).unwrap();
        let error = Pty::open(&path, Hold::Open).unwrap_err().to_string();
        assert!(error.contains("another sim"), "{error}");
        assert!(fs::symlink_metadata(&path).is_ok());
        drop(first);
        Pty::open(&path, Hold::Open).unwrap();
    }

    #[test]
    fn a_released_port_counts_its_visits() {
        let scratch = Scratch::new();
        let mut pty = Pty::open(&scratch.path("port"), Hold::Released).unwrap();
        assert_eq!(pty.visits(), Visits { begun: 0, present: false }, "its own opening");
        let first = client(pty.path());
        assert_eq!(pty.visits(), Visits { begun: 1, present: true });
        drop(first);
        assert_eq!(pty.visits(), Visits { begun: 0, present: false });
        drop(client(pty.path()));
        let _third = client(pty.path());
        assert_eq!(pty.visits(), Visits { begun: 2, present: true });
        assert_eq!(pty.visits(), Visits { begun: 0, present: true });
    }

    #[test]
    fn a_port_that_several_have_open_is_free_when_the_last_has_closed_it() {
        let scratch = Scratch::new();
        let mut pty = Pty::open(&scratch.path("port"), Hold::Released).unwrap();
        let clients: Vec<_> = (0..3).map(|_| client(pty.path())).collect();
        let last = File::open(pty.path()).unwrap();
        drop(clients);
        drop(client(pty.path()));
        assert_eq!(pty.visits(), Visits { begun: 1, present: true });
        drop(last);
        assert_eq!(pty.visits(), Visits { begun: 0, present: false });
    }

    #[test]
    fn more_visits_than_the_kernel_counts_do_not_confuse_it() {
        let scratch = Scratch::new();
        let mut pty = Pty::open(&scratch.path("port"), Hold::Released).unwrap();
        let limit: usize =
            fs::read_to_string("/proc/sys/fs/inotify/max_queued_events").unwrap().trim().parse().unwrap();
        // Each notice comes twice. What was open when the queue was full, and is closed later, is not missed.
        let crowd: Vec<_> = (0..100).map(|_| client(pty.path())).collect();
        for _ in 0..limit / 4 {
            client(pty.path());
        }
        drop(crowd);
        let visits = pty.visits();
        assert!(visits.begun >= 1 && !visits.present, "{visits:?}");
        let _client = client(pty.path());
        assert_eq!(pty.visits(), Visits { begun: 1, present: true });
    }

    #[test]
    fn a_renewed_port_has_nothing_left_of_its_last_program() {
        let scratch = Scratch::new();
        let pty = Pty::open(&scratch.path("port"), Hold::Released).unwrap();
        client(pty.path()).write_all(b"unread").unwrap();
        assert_eq!(pty.write(b"unread"), 6);
        pty.renew();
        assert_eq!(pty.read(), b"");
        let mut client = client(pty.path());
        assert_eq!(pty.write(b"new"), 3);
        let mut heard = [0; 9];
        assert_eq!(client.read(&mut heard).unwrap(), 3);
        assert_eq!(&heard[..3], b"new");
    }

    #[test]
    fn a_held_port_survives_its_clients() {
        let scratch = Scratch::new();
        let mut pty = Pty::open(&scratch.path("port"), Hold::Open).unwrap();
        client(pty.path()).write_all(b"first").unwrap();
        assert_eq!(pty.read(), b"first");
        assert_eq!(pty.visits(), Visits { begun: 0, present: true });
        client(pty.path()).write_all(b"second").unwrap();
        assert_eq!(pty.read(), b"second");
    }

    #[test]
    fn a_client_that_never_reads_does_not_block() {
        let scratch = Scratch::new();
        let pty = Pty::open(&scratch.path("port"), Hold::Open).unwrap();
        let mut taken = 0;
        for _ in 0..100 {
            taken += pty.write(&[b'x'; 1024]);
        }
        assert!((1024..100 * 1024).contains(&taken), "{taken}");
        let mut client = client(pty.path());
        pty.discard_unread();
        assert_eq!(pty.write(b"y"), 1);
        let mut heard = [0; 2];
        assert_eq!(client.read(&mut heard).unwrap(), 1);
        assert_eq!(heard[0], b'y');
    }

    #[test]
    fn a_panic_removes_the_links_of_its_thread_only() {
        let scratch = Scratch::new();
        let (mine, doomed) = (scratch.path("mine"), scratch.path("doomed"));
        let _port = Pty::open(&mine, Hold::Open).unwrap();
        let other = doomed.clone();
        let ended = thread::spawn(move || {
            let port = Pty::open(&other, Hold::Open).unwrap();
            // Not dropped, as in a program that aborts at a panic.
            std::mem::forget(port);
            panic!("on purpose");
        });
        assert!(ended.join().is_err());
        assert!(fs::symlink_metadata(&doomed).is_err());
        assert!(fs::symlink_metadata(&mine).is_ok());
    }
}
