//! No output is a motor: there is no doubt.

/// Nothing.
pub struct Doubts;

impl Doubts {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// Does nothing.
    pub fn begin(&mut self, _bit: u8) {}

    /// None.
    #[inline(always)]
    pub fn outputs(&self) -> u8 {
        0
    }

    /// None.
    #[inline(always)]
    pub fn end(&mut self, _outputs: u8) -> u8 {
        0
    }
}
