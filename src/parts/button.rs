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
}

impl Button {
    /// A button that is released and was never pressed.
    pub const fn new() -> Self {
        Self { is_pressed: false, other_ms: 0, count: 0 }
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
        if is_pressed {
            self.count = self.count.wrapping_add(1);
        }
        is_pressed
    }

    /// Presses since the start, modulo 65,536.
    pub fn count(&self) -> u16 {
        self.count
    }
}

impl Default for Button {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_press_that_bounces_counts_once() {
        let mut button = Button::new();
        let mut presses = 0;
        let mut hold = |level: bool, ms: u32| (0..ms).filter(|_| button.tick(level, 1)).count();
        for _ in 0..3 {
            for _ in 0..5 {
                presses += hold(true, 3) + hold(false, 2);
            }
            presses += hold(true, 50);
            for _ in 0..5 {
                presses += hold(false, 3) + hold(true, 2);
            }
            presses += hold(false, 50);
        }
        assert_eq!((presses, button.count()), (3, 3));
    }
}
