//! The texts of the serial monitor, packed for flash.
//!
//! On the AVR a string literal is copied to RAM at start. So the lines are packed into one table at compile time, which the
//! board places in flash and reads byte by byte: a 16-bit offset for each line, then the lines, each with a zero at its end.
//! A `%` and a letter stand for a value; see [`Event`](super::Event).

/// The packed texts, where the program runs.
pub trait FlashText {
    /// A byte of [`PACKED`].
    fn byte(&self, index: u16) -> u8;
}

/// After the last character of a line.
pub const END: u8 = 0;

macro_rules! lines {
    ($($(#[doc = $doc:literal])* $name:ident = $text:expr,)*) => {
        /// A line of text, or a word to insert in one.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Line {
            $($(#[doc = $doc])* $name,)*
        }

        /// The text of each [`Line`].
        pub const LINES: &[&str] = &[$($text,)*];
    };
}

lines! {
    /// Events were dropped.
    Lost = "serial monitor: %a lines did not fit and were dropped",
    /// After a reset.
    Banner = concat!("DroneCAN servo and temperature node ", env!("CARGO_PKG_VERSION"), ", node ID %s, reset: %w"),
    /// Reset cause.
    PowerOn = "power-on",
    /// Reset cause.
    External = "reset pin",
    /// Reset cause.
    BrownOut = "BROWN-OUT",
    /// Reset cause.
    Watchdog = "WATCHDOG",
    /// Reset cause.
    Panic = "PANIC",
    /// Reset cause.
    StrayInterrupt = "STRAY INTERRUPT",
    /// Reset cause.
    StackCollision = "STACK COLLISION",
    /// NodeStatus health 0.
    Health = "OK",
    /// NodeStatus health 1.
    HealthWarning = "WARNING",
    /// NodeStatus health 2.
    HealthError = "ERROR",
    /// NodeStatus health 3.
    HealthCritical = "CRITICAL",
    /// NodeStatus mode 0.
    Mode = "OPERATIONAL",
    /// NodeStatus mode 1.
    ModeInitialization = "INITIALIZATION",
    /// NodeStatus mode 2.
    ModeMaintenance = "MAINTENANCE",
    /// NodeStatus mode 3.
    ModeSoftwareUpdate = "SOFTWARE_UPDATE",
    /// NodeStatus mode 4.
    Mode4 = "mode 4",
    /// NodeStatus mode 5.
    Mode5 = "mode 5",
    /// NodeStatus mode 6.
    Mode6 = "mode 6",
    /// NodeStatus mode 7.
    ModeOffline = "OFFLINE",
    /// Received a NodeStatus.
    Status = "rx NodeStatus from %s tid %t: up %u s, %h, %m",
    /// Received a command that was followed.
    CommandUnitless = "rx ArrayCommand from %s tid %t: id %c unitless %3, pulse %p us",
    /// Received a command that was followed.
    CommandPosition = "rx ArrayCommand from %s tid %t: id %c position %3 rad, pulse %p us",
    /// Received a command that was followed.
    CommandPwm = "rx ArrayCommand from %s tid %t: id %c PWM %a us, pulse %p us",
    /// Received a command that was followed.
    CommandThesis = "rx thesis.ServoCommand from %s tid %t: %c, pulse %p us",
    /// Received a command for others only.
    CommandElsewhere = "rx ArrayCommand from %s tid %t: not for actuator %c",
    /// Sent a temperature.
    Temperature = "temperature %1 C",
    /// Refused a frame.
    RefusedKind = "refused: a standard or remote frame",
    /// Refused a frame.
    RefusedSource = "refused: type %a from node ID %s, which is anonymous or mine",
    /// Refused a frame.
    RefusedTransfer = "refused: type %a from %s, not a transfer of one frame",
    /// Refused a frame.
    RefusedLength = "refused: type %a from %s tid %t, wrong length",
    /// Refused a command.
    RefusedType = "refused: command from %s tid %t, type not unitless, position or PWM",
    /// Refused a command.
    RefusedValue = "refused: command from %s tid %t, value not finite or no pulse",
    /// The CAN controller is up.
    Running = "CAN: running",
    /// Nobody at the SPI.
    NotAnswering = "CAN: MCP2515 does not answer (CANSTAT %x), trying again",
    /// A register did not read back.
    NotKeeping = "CAN: MCP2515 register %x does not keep its value, trying again",
    /// No normal mode.
    NotStarting = "CAN: bus never idle, MCP2515 not on it (CANSTAT %x), trying again",
    /// Configuration gone.
    ControllerLost = "CAN: MCP2515 lost its configuration (CANSTAT %x), starting it over",
    /// Overrun.
    FramesLost = "CAN: frames lost, receive buffers were full (%a times)",
    /// Error state.
    BusOff = "CAN: bus-off",
    /// Error state.
    ErrorPassive = "CAN: error-passive",
    /// Error state.
    ErrorActive = "CAN: error-active again",
    /// Nobody acknowledges, or the bus is never free.
    GaveUp = "CAN: nothing could be sent for 1 s, frames given up (%a times)",
    /// Counters on request.
    CountsIn = "commands followed %a, frames refused %b",
    /// Counters on request.
    CountsOut = "receive overruns %a, sends given up %b",
}

const fn packed_len() -> usize {
    let mut len = 2 * LINES.len();
    let mut line = 0;
    while line < LINES.len() {
        len += LINES[line].len() + 1;
        line += 1;
    }
    len
}

/// All texts.
pub const PACKED: [u8; packed_len()] = {
    let mut packed = [END; packed_len()];
    let mut at = 2 * LINES.len();
    let mut line = 0;
    while line < LINES.len() {
        [packed[2 * line], packed[2 * line + 1]] = (at as u16).to_le_bytes();
        let text = LINES[line].as_bytes();
        let mut n = 0;
        while n < text.len() {
            packed[at] = text[n];
            at += 1;
            n += 1;
        }
        at += 1;
        line += 1;
    }
    packed
};

/// Where the text of a line begins.
pub fn start(text: &impl FlashText, line: u8) -> u16 {
    let entry = u16::from(line) << 1;
    u16::from_le_bytes([text.byte(entry), text.byte(entry + 1)])
}
