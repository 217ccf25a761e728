//! The push button, freed of its bouncing.

/// It counts as pressed or released once it has been that for so many milliseconds.
const STEADY_MS: u8 = 20;

/// A push button that counts its presses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Button {
    is_pressed: bool,
    /// Milliseconds that it has been otherwise.
    other_ms: u8,
    count: u16,
}

impl Button {
    /// Released, and never pressed.
    pub const fn new() -> Self {
        Self { is_pressed: false, other_ms: 0, count: 0 }
    }

    /// Takes the state of the pin, as it has been for so many milliseconds. Whether a press has begun.
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
