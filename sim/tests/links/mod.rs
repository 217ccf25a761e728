//! Helpers for tests of links: clients that open a port without blocking, scratch directories, and
//! compiled programs.

#![allow(dead_code, reason = "each test file uses some of these")]

use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::avr::compile_to;
use bench::Bench;
use rustix::fs::OFlags;
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use sim::links::Link;

#[path = "../../src/links/scratch.rs"]
mod scratch;

pub use scratch::Scratch;

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

/// Runs `sim`. Returns its exit code, its output, and the text on the error output.
#[track_caller]
pub fn sim(arguments: &[&str]) -> (Option<i32>, String, String) {
    let output =
        Command::new(env!("CARGO_BIN_EXE_sim")).args(arguments).output().expect("sim starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
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
    compile_to(&elf, chip, name, defines, &[]);
    elf
}
