//! The conditions behind the node's health and its vendor-specific status code.

/// The reset cause: one of the constants below.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ResetCause(pub u8);

impl ResetCause {
    /// Power-on.
    pub const POWER_ON: Self = Self(0);
    /// The reset pin, which the serial port also pulls.
    pub const EXTERNAL: Self = Self(1);
    /// A RestartNode request.
    pub const ASKED_FOR: Self = Self(2);
    /// The watchdog: the program hung. This cause and all below are faults, and set a condition.
    pub const WATCHDOG: Self = Self(3);
    /// Brown-out: the supply voltage dropped.
    pub const BROWN_OUT: Self = Self(4);
    /// A panic: the program detected an impossible state.
    pub const PANIC: Self = Self(5);
    /// An interrupt without a handler.
    pub const STRAY_INTERRUPT: Self = Self(6);
    /// A stack overflow into the variables.
    pub const STACK_COLLISION: Self = Self(7);
}

/// Bits of the vendor-specific status code (docs/status.md). WARN_MASK, ERROR_MASK and CRIT_MASK
/// set the health level of each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Conditions(u16);

impl Conditions {
    /// No condition.
    pub const NONE: Self = Self(0);
    /// Three bits: which fault caused the last reset, as a number. 0 is none, see
    /// [`after`](Self::after).
    pub const RESET: Self = Self(7);
    /// Transfers broke: missing frames, a wrong CRC, or interleaved senders.
    pub const TRANSFER_ERRORS: Self = Self(1 << 3);
    /// Another node uses this node's ID.
    pub const ID_CONFLICT: Self = Self(1 << 4);
    /// The controller lost received frames.
    pub const FRAMES_LOST: Self = Self(1 << 5);
    /// The controller is error-passive.
    pub const ERROR_PASSIVE: Self = Self(1 << 6);
    /// The controller went bus-off.
    pub const BUS_OFF: Self = Self(1 << 7);
    /// The controller was started again, or sending was given up: no node acknowledged the frames.
    pub const CONTROLLER: Self = Self(1 << 8);
    /// Two nodes command the output.
    pub const TWO_COMMANDERS: Self = Self(1 << 9);
    /// Commands stopped, and the output does what OUT1_FS says.
    pub const FAILSAFE: Self = Self(1 << 10);
    /// The temperature is below TEMP_MIN or above TEMP_MAX, or the sensor is open or shorted.
    pub const TEMPERATURE: Self = Self(1 << 11);
    /// The voltage or the current of the circuit is beyond its limits.
    pub const POWER: Self = Self(1 << 12);
    /// Parameters in the EEPROM were lost or out of range; their defaults are in force.
    pub const PARAMETERS_LOST: Self = Self(1 << 13);
    /// ARM_REQ requires an armed vehicle, and the vehicle is disarmed; or the safety switch is on.
    pub const DISARMED: Self = Self(1 << 14);
    /// The node sends in the draft. The bit is in the upper byte, so that a draft status does no
    /// harm if it is read as one of v0.
    pub const DRAFT: Self = Self(1 << 15);

    /// Temporary conditions, which are cleared some time after their last event.
    const PASSING: Self = Self(
        Self::RESET.0
            | Self::TRANSFER_ERRORS.0
            | Self::ID_CONFLICT.0
            | Self::FRAMES_LOST.0
            | Self::BUS_OFF.0
            | Self::CONTROLLER.0
            | Self::TWO_COMMANDERS.0,
    );

    /// The condition that a reset cause sets, if it is a fault: 1 for [`ResetCause::WATCHDOG`], 2
    /// for the next, and so on.
    pub fn after(cause: ResetCause) -> Self {
        Self(u16::from(cause.0.saturating_sub(ResetCause::ASKED_FOR.0)))
    }

    /// The vendor-specific status code.
    pub fn code(self) -> u16 {
        self.0
    }

    /// True if all bits of `condition` are set.
    pub fn has(self, condition: Self) -> bool {
        self.0 & condition.0 == condition.0
    }

    /// Sets or clears a condition.
    pub fn set(&mut self, condition: Self, on: bool) {
        if on {
            self.0 |= condition.0;
        } else {
            self.0 &= !condition.0;
        }
    }

    /// Clears the temporary conditions.
    pub fn pass(&mut self) {
        self.set(Self::PASSING, false);
    }
}

/// How long a temporary condition stays set, in seconds. It appears in ten statuses, so that no
/// receiver misses it.
pub const HOLD_S: u8 = 10;

/// How long the cause of a reset stays set, in seconds.
pub const RESET_HOLD_S: u8 = 60;

#[cfg(test)]
mod tests;
