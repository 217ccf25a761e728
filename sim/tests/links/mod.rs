//! Helpers for tests of links: clients that open a port without blocking, scratch directories, and
//! compiled programs.

#![allow(dead_code, reason = "each test file uses some of these")]

use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use bench::Bench;
use bench::F_CPU_HZ;
use rustix::fs::OFlags;
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use sim::links::Link;

/// CPU cycles of a millisecond.
pub const MS: u64 = F_CPU_HZ / 1000;

/// A temporary directory. Removed on drop.
pub struct Scratch(PathBuf);

impl Scratch {
    pub fn new() -> Scratch {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let name =
            format!("sim-test-{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        let directory = std::env::temp_dir().join(name);
        fs::create_dir_all(&directory).expect("a temporary directory");
        Scratch(directory)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// A program that has a port open.
pub struct Client(File);

impl Client {
    #[track_caller]
    pub fn open(path: &Path) -> Client {
        let flags = (OFlags::NONBLOCK | OFlags::NOCTTY).bits() as i32;
        Client(
            File::options()
                .read(true)
                .write(true)
                .custom_flags(flags)
                .open(path)
                .expect("the port opens"),
        )
    }

    /// Sets the baud rate of the port.
    #[track_caller]
    pub fn set_baud(&self, baud: u32) {
        let mut settings = tcgetattr(&self.0).expect("a terminal");
        settings.set_speed(baud).expect("a baud rate");
        tcsetattr(&self.0, OptionalActions::Now, &settings).expect("a terminal");
    }

    /// Writes all bytes. For short texts.
    #[track_caller]
    pub fn write(&mut self, bytes: &[u8]) {
        self.0.write_all(bytes).expect("room in the port");
    }

    /// Writes as much as the port accepts at once. Returns the number of bytes.
    pub fn write_some(&mut self, bytes: &[u8]) -> usize {
        self.0.write(bytes).unwrap_or(0)
    }

    /// Reads all bytes that are available.
    pub fn read(&mut self) -> Vec<u8> {
        let mut all = Vec::new();
        let mut piece = [0; 4096];
        while let Ok(count @ 1..) = self.0.read(&mut piece) {
            all.extend(&piece[..count]);
        }
        all
    }
}

/// Runs the bench, and serves the links each millisecond.
pub fn run_ms(bench: &mut Bench, links: &mut [&mut dyn Link], milliseconds: u64) {
    for _ in 0..milliseconds {
        bench.run_for_ms(1);
        for link in links.iter_mut() {
            link.serve(bench).expect("the link is served");
        }
    }
}

/// Compiles `tests/avr/<name>.c` for the default board.
#[track_caller]
pub fn elf(scratch: &Scratch, name: &str) -> PathBuf {
    elf_for(scratch, name, "atmega168")
}

/// Compiles `tests/avr/<name>.c` for a chip.
#[track_caller]
pub fn elf_for(scratch: &Scratch, name: &str, chip: &str) -> PathBuf {
    elf_with(scratch, name, chip, &[])
}

/// Compiles `tests/avr/<name>.c` for a chip with macros defined, such as "SD_CARD".
#[track_caller]
pub fn elf_with(scratch: &Scratch, name: &str, chip: &str, defines: &[&str]) -> PathBuf {
    let elf = scratch.path("program.elf");
    let source = bench::root().join(format!("sim/bench/tests/avr/{name}.c"));
    let compiled = Command::new("avr-gcc")
        .arg(format!("-mmcu={chip}"))
        .args(["-DF_CPU=16000000UL", "-Os", "-Wall", "-Wextra", "-Werror", "-std=gnu11"])
        .args(defines.iter().map(|define| format!("-D{define}")))
        .arg(&source)
        .arg("-o")
        .arg(&elf)
        .status()
        .expect("avr-gcc, which the Makefile installs");
    assert!(compiled.success(), "{} does not compile", source.display());
    elf
}
