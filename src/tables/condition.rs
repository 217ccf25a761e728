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

/// A table of conditions. A row is `n NAME = bits, level, time, told => text, if cfg;`: the number
/// of its lowest bit, its bits, the level by default, how long it is set, if the serial monitor and
/// LogMessages tell it, and its text, with the fields of `monitor::Event`. One that `lasts` is set
/// as long as its cause, one that `passes` until some time after the last event.
macro_rules! conditions {
    ($($(#[doc = $doc:literal])*
        $n:literal $name:ident = $bits:expr, $level:ident, $time:ident, $told:ident
            => $text:expr, if $if:meta;)*) => {
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

            /// The conditions that are told.
            const TOLD: Self = Self(0 $(| conditions!(@$told $bits))*);
        }

        /// The text of each condition, by the number of its lowest bit.
        pub const TEXTS: [&str; 16] = {
            let mut texts = [""; 16];
            $(texts[$n] = if cfg!($if) { $text } else { "" };)*
            texts
        };

        const _: () = assert!(0 $(+ Conditions::$name.0 as u32)* == 0xFFFF, "each bit has a row");
        $(const _: () = assert!(Conditions::$name.0.trailing_zeros() == $n);)*
    };
    (@passes $bits:expr) => { $bits };
    (@lasts $bits:expr) => { 0 };
    (@told $bits:expr) => { $bits };
    (@untold $bits:expr) => { 0 };
}

conditions! {
    /// Three bits: which fault caused the last reset, as a number. 0 is none, see
    /// [`after`](Self::after).
    0 RESET = 7, Warning, passes, untold => "", if all();
    /// Transfers broke: missing frames, a wrong CRC, or interleaved senders.
    3 TRANSFER_ERRORS = 1 << 3, Ok, passes, untold => "", if all();
    /// Another node uses this node's ID.
    4 ID_CONFLICT = 1 << 4, Warning, passes, told => "own ID from another node", if all();
    /// The controller lost received frames.
    5 FRAMES_LOST = 1 << 5, Warning, passes, told => "CAN: frames lost (%a x)", if all();
    /// The controller is error-passive.
    6 ERROR_PASSIVE = 1 << 6, Warning, lasts, told => "CAN H/L: error-passive", if all();
    /// The controller went bus-off.
    7 BUS_OFF = 1 << 7, Warning, passes, told => "CAN H/L: bus-off", if all();
    /// The controller was started again, or sending was given up: no node acknowledged the frames.
    /// Each event has a line of its own.
    8 CONTROLLER = 1 << 8, Warning, passes, told => "", if all();
    /// Two nodes command the output.
    9 TWO_COMMANDERS = 1 << 9, Warning, passes, told => "TWO COMMANDERS", if all();
    /// Commands stopped, and the output does what OUT1_FS says.
    10 FAILSAFE = 1 << 10, Error, lasts, told => "FAILSAFE: no commands", if all();
    /// The temperature is below TEMP_MIN or above TEMP_MAX, or the sensor is open or shorted.
    11 TEMPERATURE = 1 << 11, Warning, lasts, told => "temperature out of range", if all();
    /// The voltage or the current of the circuit is beyond its limits.
    12 POWER = 1 << 12, Warning, lasts, told => "circuit out of range", if feature = "power";
    /// Parameters in the EEPROM were lost or out of range; their defaults are in force.
    13 PARAMETERS_LOST = 1 << 13, Critical, lasts, told => "parameters lost", if all();
    /// ARM_REQ requires an armed vehicle, and the vehicle is disarmed; or the safety switch is on;
    /// or commands for a motor are refused because their sender has not armed.
    14 DISARMED = 1 << 14, Ok, lasts, told => "disarmed", if feature = "standard";
    /// The node sends in the draft. The bit is in the upper byte, so that a draft status does no
    /// harm if it is read as one of v0.
    15 DRAFT = 1 << 15, Ok, lasts, untold => "", if all();
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

    /// All bits, which are never set at the same time.
    pub const EVERY: Self = Self(!0);

    /// Other nodes do not receive what the node sends, or did not a moment ago.
    pub const CUT_OFF: Self = Self(Self::ERROR_PASSIVE.0 | Self::BUS_OFF.0 | Self::CONTROLLER.0);

    /// The number of the highest bit of the set, which is not empty, and the bit.
    pub const fn first(self) -> (u8, Self) {
        let (mut left, mut number, mut bit) = (self.0, 15u8, 1u16 << 15);
        while (left as i16) >= 0 {
            left <<= 1;
            bit >>= 1;
            number = number.wrapping_sub(1);
        }
        (number, Self(bit))
    }

    /// The number of a condition.
    pub const fn number(self) -> u8 {
        self.first().0
    }

    /// The conditions that are in one of the two sets only.
    pub const fn xor(self, other: Self) -> Self {
        Self(self.0 ^ other.0)
    }

    /// The conditions of this set that are not in the other one.
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// The conditions that are in one of the sets, or in both.
    pub const fn or(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// The conditions of this set that are told.
    pub const fn told(self) -> Self {
        Self(self.0 & Self::TOLD.0)
    }

    /// The condition that a reset cause sets, if it is a fault: 1 for [`ResetCause::WATCHDOG`], 2
    /// for the next, and so on.
    pub fn after(cause: ResetCause) -> Option<Self> {
        const NO_FAULT: u8 = ResetCause::ASKED_FOR.0;
        (cause.0 > NO_FAULT).then(|| Self(u16::from(cause.0.wrapping_sub(NO_FAULT))))
    }

    /// The vendor-specific status code.
    pub fn code(self) -> u16 {
        self.0
    }

    /// True if the set is empty.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// True if one of `conditions` is set.
    #[inline(always)]
    pub fn has(self, conditions: Self) -> bool {
        self.0 & conditions.0 != 0
    }

    /// Sets or clears a condition.
    pub fn set(&mut self, condition: Self, on: bool) {
        self.0 |= condition.0;
        if !on {
            self.0 ^= condition.0;
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
