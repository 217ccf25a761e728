//! How the node is: the conditions behind its health and its vendor-specific status code.

use crate::dronecan::node_status::Health;

/// Why the program started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum ResetCause {
    /// Power came.
    PowerOn,
    /// The reset pin, which the serial port also pulls.
    External,
    /// The supply dipped.
    BrownOut,
    /// The program hung.
    Watchdog,
    /// The program met a condition that it was sure could not be.
    Panic,
    /// An interrupt without a handler.
    StrayInterrupt,
    /// The stack ran into the variables.
    StackCollision,
}

/// Bits of the vendor-specific status code (docs/status.md). Any of them makes the health WARNING.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Conditions(u16);

impl Conditions {
    /// All is well.
    pub const NONE: Self = Self(0);
    /// The last reset came from the watchdog.
    pub const RESET_WATCHDOG: Self = Self(1 << 0);
    /// The last reset came from a dip of the supply.
    pub const RESET_BROWN_OUT: Self = Self(1 << 1);
    /// The last reset came from a panic.
    pub const RESET_PANIC: Self = Self(1 << 2);
    /// The last reset came from an interrupt without a handler.
    pub const RESET_STRAY_INTERRUPT: Self = Self(1 << 3);
    /// The last reset came from the stack running into the variables.
    pub const RESET_STACK_COLLISION: Self = Self(1 << 4);
    /// Frames for the node were lost in the controller.
    pub const FRAMES_LOST: Self = Self(1 << 5);
    /// The controller is error-passive.
    pub const ERROR_PASSIVE: Self = Self(1 << 6);
    /// The controller went bus-off.
    pub const BUS_OFF: Self = Self(1 << 7);
    /// Frames were given up because nobody acknowledged them.
    pub const GAVE_UP_SENDING: Self = Self(1 << 8);
    /// The controller had to be started over.
    pub const CONTROLLER_LOST: Self = Self(1 << 9);

    /// Those that pass [`HOLD_S`] after the last time that they occurred.
    const PASSING: Self =
        Self(Self::FRAMES_LOST.0 | Self::BUS_OFF.0 | Self::GAVE_UP_SENDING.0 | Self::CONTROLLER_LOST.0);

    /// What a reset leaves behind. Nothing after a power-on or a pull at the reset pin, which are not faults.
    pub fn after(cause: ResetCause) -> Self {
        match cause {
            ResetCause::PowerOn | ResetCause::External => Self::NONE,
            ResetCause::BrownOut => Self::RESET_BROWN_OUT,
            ResetCause::Watchdog => Self::RESET_WATCHDOG,
            ResetCause::Panic => Self::RESET_PANIC,
            ResetCause::StrayInterrupt => Self::RESET_STRAY_INTERRUPT,
            ResetCause::StackCollision => Self::RESET_STACK_COLLISION,
        }
    }

    /// The vendor-specific status code.
    pub fn code(self) -> u16 {
        self.0
    }

    /// The health that they amount to.
    pub fn health(self) -> Health {
        if self.0 == 0 { Health::Ok } else { Health::Warning }
    }

    /// Whether all of these are set.
    pub fn has(self, condition: Self) -> bool {
        self.0 & condition.0 == condition.0
    }

    /// Sets or clears.
    pub fn set(&mut self, condition: Self, on: bool) {
        if on {
            self.0 |= condition.0;
        } else {
            self.0 &= !condition.0;
        }
    }

    /// Clears those that pass with time.
    pub fn pass(&mut self) {
        self.set(Self::PASSING, false);
    }
}

/// How long a passing condition is shown, in seconds: ten statuses, so that nobody misses it.
pub const HOLD_S: u8 = 10;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clean_start_is_healthy_and_a_fault_is_not() {
        assert_eq!(Conditions::after(ResetCause::PowerOn).health(), Health::Ok);
        assert_eq!(Conditions::after(ResetCause::External).code(), 0);
        let faults = [
            ResetCause::Watchdog,
            ResetCause::BrownOut,
            ResetCause::Panic,
            ResetCause::StrayInterrupt,
            ResetCause::StackCollision,
        ];
        for (bit, cause) in faults.into_iter().enumerate() {
            assert_eq!(Conditions::after(cause).code(), 1 << bit);
            assert_eq!(Conditions::after(cause).health(), Health::Warning);
        }
    }

    #[test]
    fn what_happened_passes_and_what_is_stays() {
        let mut conditions = Conditions::after(ResetCause::Watchdog);
        conditions.set(Conditions::FRAMES_LOST, true);
        conditions.set(Conditions::ERROR_PASSIVE, true);
        conditions.pass();
        assert_eq!(conditions.code(), 0b100_0001);
        conditions.set(Conditions::ERROR_PASSIVE, false);
        assert_eq!(conditions.code(), 1);
    }
}
