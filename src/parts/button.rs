//! Debounces the push button and counts its presses.

/// Time that the pin must be stable before the button counts as pressed or released, in
/// milliseconds.
const STEADY_MS: u8 = 20;

/// A push button that counts its presses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Button {
    is_pressed: bool,
    /// Milliseconds that the pin has differed from `is_pressed`.
    other_ms: u8,
    count: u16,
    /// Milliseconds since the last tenth of a second of this press.
    held_ms: u8,
    /// Tenths of a second of this press, at most 255.
    press_time_ds: u8,
}

impl Button {
    /// A button that is released and was never pressed.
    pub const fn new() -> Self {
        Self { is_pressed: false, other_ms: 0, count: 0, held_ms: 0, press_time_ds: 0 }
    }

    /// Takes the state of the pin during the last `passed_ms` milliseconds. Returns true if a press
    /// has begun.
    pub fn tick(&mut self, is_pressed: bool, passed_ms: u8) -> bool {
        if is_pressed == self.is_pressed {
            self.other_ms = 0;
            return false;
        }
        self.other_ms = self.other_ms.wrapping_add(passed_ms);
        if self.other_ms < STEADY_MS {
            return false;
        }
        self.other_ms = 0;
        self.is_pressed = is_pressed;
        self.held_ms = 0;
        self.press_time_ds = 0;
        if is_pressed {
            self.count = self.count.wrapping_add(1);
        }
        is_pressed
    }

    /// Counts the time of a press, after [`tick`](Self::tick). Returns true at each tenth of a
    /// second.
    pub fn counts_tenth(&mut self, passed_ms: u8) -> bool {
        if !self.is_pressed {
            return false;
        }
        self.held_ms = self.held_ms.wrapping_add(passed_ms);
        if self.held_ms < 100 {
            return false;
        }
        self.held_ms -= 100;
        self.press_time_ds = self.press_time_ds.saturating_add(1);
        true
    }

    /// Tenths of a second that the button has been pressed, at most 255.
    pub fn press_time_ds(&self) -> u8 {
        self.press_time_ds
    }

    /// Presses since the start, modulo 65,536.
    pub fn count(&self) -> u16 {
        self.count
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn a_press_is_timed_in_tenths_of_a_second() {
        let mut button = Button::new();
        let mut times = Vec::new();
        for (level, ms) in [(true, 1150), (false, 500), (true, 240), (false, 50)] {
            for _ in 0..ms / 2 {
                button.tick(level, 2);
                if button.counts_tenth(2) {
                    times.push(button.press_time_ds());
                }
            }
        }
        assert_eq!(times, [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 1, 2]);
        for _ in 0..30_000 {
            button.tick(true, 1);
            button.counts_tenth(1);
        }
        assert_eq!(button.press_time_ds(), 255);
    }
}
