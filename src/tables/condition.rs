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

/// The health field of NodeStatus (DSDL 341.NodeStatus.uavcan).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Level {
    /// The node works without a fault.
    Ok = 0,
    /// The node works, with a minor fault.
    Warning = 1,
    /// A function of the node has failed.
    Error = 2,
    /// The node does not work.
    Critical = 3,
}

/// A table of conditions. A row is `NAME = bits, level, time;`: the level by default, and how long
/// it is set. One that `lasts` is set as long as its cause, one that `passes` until some time after
/// the last event.
macro_rules! conditions {
    ($($(#[doc = $doc:literal])* $name:ident = $bits:expr, $level:ident, $time:ident;)*) => {
        /// Bits of the vendor-specific status code (docs/status.md). WARN_MASK, ERROR_MASK and
        /// CRIT_MASK set the health level of each.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub struct Conditions(u16);

        impl Conditions {
            $($(#[doc = $doc])* pub const $name: Self = Self($bits);)*

            /// The conditions with this level by default.
            const fn of_level(level: Level) -> u16 {
                0 $(| if level as u8 == Level::$level as u8 { Self::$name.0 } else { 0 })*
            }

            /// Conditions of events, which are cleared some time after the last one.
            const PASSING: Self = Self(0 $(| conditions!(@$time $bits))*);
        }

        const _: () = assert!(0 $(+ Conditions::$name.0 as u32)* == 0xFFFF, "each bit has a row");
    };
    (@passes $bits:expr) => { $bits };
    (@lasts $bits:expr) => { 0 };
}

conditions! {
    /// Three bits: which fault caused the last reset, as a number. 0 is none, see
    /// [`after`](Self::after).
    RESET = 7, Warning, passes;
    /// Transfers broke: missing frames, a wrong CRC, or interleaved senders.
    TRANSFER_ERRORS = 1 << 3, Ok, passes;
    /// Another node uses this node's ID.
    ID_CONFLICT = 1 << 4, Warning, passes;
    /// The controller lost received frames.
    FRAMES_LOST = 1 << 5, Warning, passes;
    /// The controller is error-passive.
    ERROR_PASSIVE = 1 << 6, Warning, lasts;
    /// The controller went bus-off.
    BUS_OFF = 1 << 7, Warning, passes;
    /// The controller was started again, or sending was given up: no node acknowledged the frames.
    CONTROLLER = 1 << 8, Warning, passes;
    /// Two nodes command the output.
    TWO_COMMANDERS = 1 << 9, Warning, passes;
    /// Commands stopped, and the output does what OUT1_FS says.
    FAILSAFE = 1 << 10, Error, lasts;
    /// The temperature is below TEMP_MIN or above TEMP_MAX, or the sensor is open or shorted.
    TEMPERATURE = 1 << 11, Warning, lasts;
    /// The voltage or the current of the circuit is beyond its limits.
    POWER = 1 << 12, Warning, lasts;
    /// Parameters in the EEPROM were lost or out of range; their defaults are in force.
    PARAMETERS_LOST = 1 << 13, Critical, lasts;
    /// ARM_REQ requires an armed vehicle, and the vehicle is disarmed; or the safety switch is on.
    DISARMED = 1 << 14, Ok, lasts;
    /// The node sends in the draft. The bit is in the upper byte, so that a draft status does no
    /// harm if it is read as one of v0.
    DRAFT = 1 << 15, Ok, lasts;
}

/// The default of WARN_MASK; without the feature `masks` its value.
pub const WARN_MASK: u16 = Conditions::of_level(Level::Warning);
/// The same of ERROR_MASK.
pub const ERROR_MASK: u16 = Conditions::of_level(Level::Error);
/// The same of CRIT_MASK.
pub const CRIT_MASK: u16 = Conditions::of_level(Level::Critical);

impl Conditions {
    /// No condition.
    pub const NONE: Self = Self(0);

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

/// How long a temporary condition stays set, in seconds, or up to a second longer. It appears in
/// ten statuses, so that no receiver misses it.
pub const HOLD_S: u8 = 10;

/// How long the cause of a reset stays set, in seconds.
pub const RESET_HOLD_S: u8 = 60;

#[cfg(test)]
mod tests;
