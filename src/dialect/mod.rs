//! The dialect that the node speaks: how an identifier is composed and a frame is read, and what a
//! status contains.
//!
//! A build has one dialect, and both have the same names here: [DroneCAN v0](v0), or the
//! [draft of 2014](draft) in the preset `thesis`. docs/dialects.md compares them.

#[cfg(feature = "draft")]
mod draft;
#[cfg(feature = "draft")]
pub use draft::*;

#[cfg(not(feature = "draft"))]
mod v0;
#[cfg(not(feature = "draft"))]
pub use v0::*;

/// The NodeStatus of another node.
pub struct Heard {
    /// Uptime in seconds, little-endian.
    pub uptime: [u8; 4],
    /// The health: 0 OK, 1 warning, 2 error, 3 critical.
    pub level: u8,
}
