//! A temporary directory for a test.

use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A temporary directory. Removed on drop.
pub struct Scratch(TempDir);

impl Scratch {
    /// Creates an empty directory that no other test uses.
    pub fn new() -> Scratch {
        Scratch(tempfile::tempdir().expect("a temporary directory"))
    }

    /// The path of `name` in the directory.
    pub fn path(&self, name: impl AsRef<Path>) -> PathBuf {
        self.0.path().join(name)
    }
}
