//! The texts of the serial monitor, packed for flash.
//!
//! The start-up code of the AVR copies a string literal to RAM. So the texts are packed at compile
//! time into a table that stays in flash. In a text a `%` and a letter stand for a value: see
//! [`Event`](super::Event).

use crate::tables::condition::TEXTS;
use crate::tables::numbered;

/// The table: [`PACKED`].
pub struct Texts;

/// A table of groups: `logs if condition { rows }`. Lines of a group `rejects` log that something
/// was rejected. A group `words(NAME = first)` has words to insert in a line, and a number selects
/// one. After the lines of the table come those of the conditions.
macro_rules! lines {
    ($($what:ident $(($list:ident = $first:ident))? if $if:meta {
        $($(#[doc = $doc:literal])* $name:ident = $text:expr,)*
    })*) => {
        /// A line of text. The constants here are the only values; those of a part that the build
        /// leaves out are [`Line::NONE`].
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct Line(u8);

        numbered! {
            Line, Self::NONE;
            $(if $if { $($(#[doc = $doc])* $name | lines!(@$what);)* })*
        }

        impl Words {
            $($(
                /// The words of this list.
                pub const $list: Self = Self(Line::$first.0);
            )?)*
        }

        /// The texts of the table.
        const OTHERS: &[&str] = &[$($(#[cfg($if)] $text,)*)*];
    };
    (@rejects) => { Line::REJECTS };
    (@logs) => { 0 };
    (@words) => { 0 };
}

/// The text of each [`Line`], by its number.
pub const LINES: &[&str] = &{
    let (mut lines, mut n) = ([""; OTHERS.len() + TEXTS.len()], 0);
    while n < lines.len() {
        lines[n] = if n < OTHERS.len() { OTHERS[n] } else { TEXTS[n - OTHERS.len()] };
        n += 1;
    }
    lines
};

/// A list of words to insert in a line.
pub struct Words(u8);

impl Words {
    /// The number of the `n`th word, counted from 0, for a field `%w`.
    pub const fn number(self, n: u8) -> u8 {
        self.0.wrapping_add(n)
    }
}

impl Line {
    /// Set in the number of a line that logs a rejection.
    const REJECTS: u8 = 0x80;

    /// No line.
    pub const NONE: Self = Self(0x7F);

    /// The index of the line in [`LINES`].
    pub const fn number(self) -> u8 {
        self.0 & !Self::REJECTS
    }

    /// The number of a line that logs no rejection, for a field `%w`.
    pub const fn word(self) -> u8 {
        self.0
    }

    /// True if the build has the line.
    pub const fn is_built(self) -> bool {
        self.0 != Self::NONE.0
    }

    /// The line with this number, for tests.
    #[cfg(test)]
    pub fn with_number(number: u8) -> Self {
        Self(number)
    }

    /// The line of the condition with this number, when it begins.
    pub const fn of_condition(n: u8) -> Self {
        Self(OTHERS.len() as u8 + n)
    }

    /// True if the line logs that something was rejected.
    pub const fn is_refusal(self) -> bool {
        self.0 & Self::REJECTS != 0
    }
}

const _: () = assert!(LINES.len() <= Line::NONE.number() as usize);

lines! {
    logs if all() {
        /// Received a NodeStatus.
        Status = "rx NodeStatus from %s tid %t: up %a s, %w",
        /// Received and followed a command of the thesis.
        CommandThesis = "rx thesis.ServoCommand from %s tid %t: %a, pulse %p us",
        /// The temperature, logged once a second.
        Temperature = "temperature %+%1 C",
    }
    // In the order of `dronecan_wire::Rejection`: so the compiler computes the number of the line,
    // and does not compare for each, which takes 70 bytes more.
    rejects if all() {
        /// Rejected: a frame of an anonymous sender, or with this node's own ID; or an ArmingStatus
        /// of another node than the autopilot.
        RefusedSource = "refused: type %a from %s, wrong sender",
        /// Rejected: a frame of a type that the node does not receive, or a standard or remote
        /// frame.
        RefusedKind = "refused: unknown type",
        /// Rejected: a malformed frame.
        RefusedTransfer = "refused: type %a from %s, malformed",
        /// Rejected: a request while the queue of requests is full.
        RefusedBusy = "refused: request from %s, busy",
        /// Rejected: a transfer of a wrong length.
        RefusedLength = "refused: type %a from %s tid %t, wrong length",
        /// Rejected: a transfer with a wrong CRC, or one that did not complete.
        RefusedBroken = "refused: type %a from %s, broken",
        /// Rejected: a transfer, because the transfer of another sender has the lane.
        RefusedInterleaved = "refused: type %a from %s, interleaved",
        /// Rejected: a command of an unknown type, or a command or NodeStatus in a dialect that the
        /// node does not follow.
        RefusedType = "refused: command from %s tid %t, unknown type",
        /// Rejected: a command that gives no valid pulse.
        RefusedValue = "refused: command from %s tid %t, no pulse",
    }
    rejects if feature = "standard" {
        /// Rejected: a command while the vehicle is disarmed.
        RefusedDisarmed = if crate::tables::parameters::Parameter::SafeMode.is_built() {
            "refused: command from %s tid %t, disarmed (ArmingStatus)"
        } else {
            "refused: command from %s tid %t, disarmed"
        },
    }
    rejects if feature = "safety" {
        /// Rejected: a command while the safety switch is on.
        RefusedSafe = "refused: command from %s tid %t, safety switch on (SafetyState)",
    }
    logs if feature = "values" {
        /// Received and followed a unitless command.
        CommandUnitless = "rx ArrayCommand from %s tid %t: id %c unitless %+%3, pulse %p us",
        /// Received and followed a position command.
        CommandPosition = "rx ArrayCommand from %s tid %t: id %c position %+%3 rad, pulse %p us",
        /// Received and followed a PWM command.
        CommandPwm = "rx ArrayCommand from %s tid %t: id %c PWM %a us, pulse %p us",
    }
    logs if not(any(feature = "draft", feature = "values")) {
        /// Received and followed a command of any type.
        Command = "rx ArrayCommand from %s tid %t: id %c, pulse %p us",
    }
    logs if not(feature = "draft") {
        /// Received a request.
        Request = "rx request %a from %s tid %t",
    }
    logs if feature = "outputs" {
        /// Received an esc.RawCommand, and followed the command for a motor.
        RawCommand = "rx RawCommand from %s tid %t: motor %c %+%0, pulse %p us",
        /// Commands that replaced another before it was followed: after the first, and on request.
        Superseded = "commands superseded %a",
        /// A parameter was not set: so many outputs have no room at such a rate.
        ParameterNoRoom = "rx GetSet from %s tid %t: OUT_COUNT pulses do not fit at OUT_RATE, %n",
    }
    logs if feature = "escs" {
        /// A parameter was not set: a servo is in use, and ESC_RATE or ESC_PWM_TYPE is not the
        /// default.
        ParameterOfMotors =
            "rx GetSet from %s tid %t: ESC_RATE and ESC_PWM_TYPE need OUTn_TYPE 1, %n",
    }
    logs if feature = "standard" {
        /// A parameter was set.
        ParameterSet = "rx GetSet from %s tid %t: set %n = %w",
        /// A parameter was not set: the value is out of range.
        ParameterRejected = "rx GetSet from %s tid %t: out of range for %n",
        /// The parameters are saved in EEPROM.
        Saved = "parameters saved",
        /// Saving the parameters in EEPROM failed.
        NotSaved = "parameters not saved",
        /// Received an ArmingStatus.
        Arming = "rx ArmingStatus from %s tid %t: %c",
    }
    logs if feature = "update" {
        /// An accepted update does not begin: the outputs are in use again.
        UpdateCalledOff = "update called off: armed, or a command in the last 2 s",
    }
    logs if feature = "safety" {
        /// Received a SafetyState.
        SafetyState = "rx SafetyState from %s tid %t: %c",
    }
    logs if feature = "relay" {
        /// Received a hardpoint.Command for a relay.
        Hardpoint = "rx hardpoint.Command from %s tid %t: %a for ID %c",
    }
    logs if feature = "lights" {
        /// Received a LightsCommand.
        Light = "rx LightsCommand from %s tid %t: light %c",
    }
    logs if feature = "button" {
        /// The button was pressed.
        Button = "button pressed %a times",
    }
    logs if feature = "power" {
        /// Voltage and current of the circuit, logged once a second.
        Circuit = "circuit %b mV, %+%2 A",
    }
    logs if feature = "tunnel" {
        /// Received a tunnel.Targetted.
        Targetted = "rx Targetted from %s tid %t",
    }
    logs if feature = "allocation" {
        /// Received an Allocation that gives this node no ID.
        AllocationElsewhere = "rx Allocation from %s",
        /// An allocator gave this node its ID.
        Allocated = "node ID %c allocated by %s",
    }
    logs if all() {
        /// The monitor dropped lines because its queue was full.
        Lost = "%c lines dropped",
        /// The first line after a reset.
        Banner =
            concat!("DroneCAN servo node ", env!("CARGO_PKG_VERSION"), ", node ID %s, reset: %w"),
        /// On request: counts of commands followed and frames rejected.
        CountsIn = "commands followed %a, frames refused %b",
        /// On request: counts of overruns and of frames given up.
        CountsOut = "overruns %a, given up %b",
        // From here to `GaveUp` in the order of `mcp2515_ordered::Event`, as above.
        /// The CAN controller is on the bus.
        Running = "CAN: running",
        /// No chip answers on the SPI: the wires that it can be, and CANSTAT.
        NotAnswering = concat!("CS ", env!("NODE_CS"), " SI SO SCK 5V? (%a)"),
        /// A register did not read back as written: its address.
        NotKeeping = "SI SO SCK? register %a",
        /// The CAN controller did not enter normal mode: CANSTAT.
        NotStarting = "CAN H/L: never idle (%a)",
        /// The CAN controller lost its configuration.
        ControllerLost = "5V? MCP2515 settings lost",
        /// INT does not follow the CAN controller.
        IntWrong = "INT open or shorted",
        /// The bus has another bit rate than the controller, which listens only.
        AnotherRate = "another bit rate or crystal",
        /// No node acknowledges, or the bus is never idle: nothing was sent for a second.
        GaveUp = "CAN H/L: not sent (%a)",
        /// The temperature is out of range because the sensor is open or shorted.
        SensorFault = "temperature sensor fault",
        /// The end of a condition: its line when it begins, which has no code.
        Over = "over: %w",
    }
    logs if feature = "safety" {
        /// The safety switch is on.
        Safe = "safety switch on",
    }
    logs if feature = "outputs" {
        /// Commands above idle for a motor are refused, because their sender has not armed.
        CommandsRefused = "commands refused: disarmed",
    }
    logs if feature = "rpm" {
        /// There are more pulses of the shaft than the node counts.
        TooManyPulses = "rpm: too many pulses",
        /// The pulses of the shaft can be counted again.
        TooManyPulsesEnd = "rpm: pulses counted again",
    }
    logs if feature = "outputs" {
        /// The outputs in failsafe, after a change: a digit for each.
        FailsafeOf = "FAILSAFE of output %o",
    }
    words(RESET = PowerOn) if all() {
        /// Reset cause.
        PowerOn = "power-on",
        /// Reset cause.
        External = "reset pin",
        /// Reset cause.
        AskedFor = "on request",
        /// Reset cause.
        Watchdog = "WATCHDOG",
        /// Reset cause.
        BrownOut = "BROWN-OUT",
        /// Reset cause.
        Panic = "PANIC",
        /// Reset cause.
        StrayInterrupt = "STRAY INTERRUPT",
        /// Reset cause.
        StackCollision = "STACK COLLISION",
    }
    words(HEALTH = Health) if all() {
        /// NodeStatus health 0.
        Health = "OK",
        /// NodeStatus health 1.
        HealthWarning = "WARNING",
        /// NodeStatus health 2.
        HealthError = "ERROR",
        /// NodeStatus health 3.
        HealthCritical = "CRITICAL",
    }
    words(NUMBER = Number) if all() {
        /// A number that is not negative.
        Number = "%a",
        /// A negative number.
        NumberNegative = "-%0",
        /// A number of thousands.
        NumberThousands = "%a000",
    }
}
