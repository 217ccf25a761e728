//! No button.

/// Nothing.
#[derive(Default)]
pub struct Button;

impl Button {
    /// Nothing.
    pub const fn new() -> Self {
        Self
    }

    /// False.
    pub fn tick(&mut self, _is_pressed: bool, _passed_ms: u8) -> bool {
        false
    }

    /// False.
    pub fn counts_tenth(&mut self, _passed_ms: u8) -> bool {
        false
    }

    /// 0.
    pub fn press_time_ds(&self) -> u8 {
        0
    }

    /// 0.
    pub fn count(&self) -> u16 {
        0
    }
}
