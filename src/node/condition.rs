//! How the node is: the conditions behind its health and its vendor-specific status code.

/// Why the program started: one of the constants here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ResetCause(pub u8);

impl ResetCause {
    /// Power came.
    pub const POWER_ON: Self = Self(0);
    /// The reset pin, which the serial port also pulls.
    pub const EXTERNAL: Self = Self(1);
    /// RestartNode.
    pub const ASKED_FOR: Self = Self(2);
    /// The program hung. This and those that follow are faults, each with its condition.
    pub const WATCHDOG: Self = Self(3);
    /// The supply dipped.
    pub const BROWN_OUT: Self = Self(4);
    /// The program met a condition that it was sure could not be.
    pub const PANIC: Self = Self(5);
    /// An interrupt without a handler.
    pub const STRAY_INTERRUPT: Self = Self(6);
    /// The stack ran into the variables.
    pub const STACK_COLLISION: Self = Self(7);
}

/// Bits of the vendor-specific status code (docs/status.md). WARN_MASK, ERROR_MASK and CRIT_MASK say how bad each is.
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
    /// The last reset came from an interrupt without a handler, or from the stack running into the variables.
    pub const RESET_STRAY: Self = Self(1 << 3);
    /// Transfers broke: frames missing, a wrong CRC, or two senders at once; or another node has this node's ID.
    pub const TRANSFER_ERRORS: Self = Self(1 << 4);
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

    /// Commands stopped, and the output is where OUT1_FS has it.
    pub const FAILSAFE: Self = Self(1 << 10);
    /// The temperature is below TEMP_MIN or above TEMP_MAX.
    pub const TEMPERATURE: Self = Self(1 << 11);
    /// The temperature sensor is open or shorted.
    pub const SENSOR: Self = Self(1 << 12);
    /// Neither copy of the parameters in the EEPROM was good; the defaults are in force.
    pub const PARAMETERS_LOST: Self = Self(1 << 13);
    /// ARM_REQ asks for an armed vehicle, and it is not.
    pub const DISARMED: Self = Self(1 << 14);
    /// The node speaks the draft. In the upper byte, where a status of the draft is taken for one of v0 without harm.
    pub const DRAFT: Self = Self(1 << 15);

    /// Those that pass [`HOLD_S`] after the last time that they occurred.
    const PASSING: Self = Self(
        Self::FRAMES_LOST.0
            | Self::BUS_OFF.0
            | Self::GAVE_UP_SENDING.0
            | Self::CONTROLLER_LOST.0
            | Self::TRANSFER_ERRORS.0,
    );

    /// What a reset leaves behind. Nothing where it was no fault.
    pub fn after(cause: ResetCause) -> Self {
        let mut code = 0;
        let mut of = ResetCause::ASKED_FOR.0;
        while of < cause.0 && of < ResetCause::STRAY_INTERRUPT.0 {
            code = if code == 0 { Self::RESET_WATCHDOG.0 } else { code << 1 };
            of += 1;
        }
        Self(code)
    }

    /// The vendor-specific status code.
    pub fn code(self) -> u16 {
        self.0
    }

    /// Whether all of these are set.
    pub fn has(self, condition: Self) -> bool {
        self.0 & condition.0 == condition.0
    }

    /// Sets or clears.
    #[inline(never)]
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
mod tests;
