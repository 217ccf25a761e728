//! The node does not send the thesis's measurement.

/// Nothing.
#[derive(Default)]
pub struct Measurement;

impl Measurement {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// False.
    pub fn note_status(&mut self) -> bool {
        false
    }
}
