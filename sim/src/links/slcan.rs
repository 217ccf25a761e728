//! The SLCAN adapter of the bench on a pseudo-terminal.

pub use super::Link;
use super::pty::Pty;
use anyhow::{Context, Result};
use bench::Bench;
use bench::slcan::Port;
use std::path::Path;

/// An SLCAN adapter on a pseudo-terminal.
pub type Slcan = bench::slcan::Slcan<Pty>;

impl Port for Pty {
    fn name(&self) -> String {
        self.path().display().to_string()
    }

    fn read(&mut self) -> Vec<u8> {
        // An adapter does not ask who has its port open. But this unlocks the port when a program
        // that has locked it closes it.
        let _ = self.take_openings();
        Pty::read(self)
    }

    fn write(&mut self, bytes: &[u8]) -> usize {
        Pty::write(self, bytes)
    }

    fn discard_unread(&mut self) {
        Pty::discard_unread(self);
    }
}

/// Adds an adapter to the bus, with its port at `path` and its channel closed.
///
/// # Errors
/// If `path` is in use or cannot be created; the message says what to do.
pub fn open(path: &Path, bench: &mut Bench) -> Result<Slcan> {
    let pty = Pty::open(path).context("--slcan")?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    Ok(Slcan::attach(pty, &name, bench))
}

impl Link for Slcan {
    fn serve(&mut self, bench: &mut Bench) -> Result<()> {
        Slcan::serve(self, bench);
        Ok(())
    }

    fn status(&self) -> String {
        Slcan::status(self)
    }

    fn take_hint(&mut self) -> Option<String> {
        Slcan::take_hint(self)
    }

    fn needs_real_time(&self) -> bool {
        true
    }
}
