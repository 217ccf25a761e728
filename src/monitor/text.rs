//! The texts of the serial monitor, packed for flash.
//!
//! The start-up code of the AVR copies a string literal to RAM. So the texts are packed at compile
//! time into a table that stays in flash. In a text a `%` and a letter stand for a value: see
//! [`Event`](super::Event).

/// The table: [`PACKED`].
pub struct Texts;

macro_rules! lines {
    ($($(#[doc = $doc:literal])* $(#[cfg($if:meta)])? $name:ident = $text:expr,)*) => {
        #[repr(u8)]
        enum Place {
            $($(#[cfg($if)])? $name,)*
        }

        /// A line of text, or a word to insert in a line. The constants here are the only values.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub struct Line(u8);

        #[allow(non_upper_case_globals, reason = "they read as the variants of an enumeration, which they are")]
        impl Line {
            $($(#[doc = $doc])* $(#[cfg($if)])? pub const $name: Self = Self(Place::$name as u8);)*

            /// The line that is `n` lines after this one.
            pub const fn plus(self, n: u8) -> Self {
                Self(self.0.wrapping_add(n))
            }

            /// The number of the line: its index in [`LINES`].
            pub const fn number(self) -> u8 {
                self.0
            }
        }

        /// The text of each [`Line`].
        pub const LINES: &[&str] = &[$($(#[cfg($if)])? $text,)*];
    };
}

lines! {
    /// Rejected: a frame of a type that the node does not receive, or a standard or remote frame.
    RefusedKind = "refused: not a type of this node",
    /// Rejected: a frame of an anonymous sender, or with this node's own ID; or an ArmingStatus of another node than the autopilot.
    RefusedSource = "refused: type %a from %s, wrong sender",
    /// Rejected: a malformed frame.
    RefusedTransfer = "refused: type %a from %s, not a whole frame",
    /// Rejected: a request while the queue of requests is full.
    RefusedBusy = "refused: request from %s, busy",
    /// Rejected: a transfer with a wrong CRC, or one that did not complete.
    RefusedBroken = "refused: type %a from %s, broken",
    /// Rejected: a transfer, because the transfer of another sender has the lane.
    RefusedInterleaved = "refused: type %a from %s, interleaved",
    /// Rejected: a transfer of a wrong length.
    RefusedLength = "refused: type %a from %s tid %t, wrong length",
    /// Rejected: a command of an unknown type, or a command or NodeStatus in a dialect that the node does not follow.
    RefusedType = "refused: command from %s tid %t, unknown type",
    /// Rejected: a command while the vehicle is disarmed.
    #[cfg(feature = "standard")]
    RefusedDisarmed = "refused: command from %s tid %t, disarmed",
    /// Rejected: a command while the safety switch is on.
    #[cfg(feature = "safety")]
    RefusedSafe = "refused: command from %s tid %t, safety switch on",
    /// Rejected: a command that gives no valid pulse.
    RefusedValue = "refused: command from %s tid %t, no such pulse",
    /// Received a NodeStatus.
    Status = "rx NodeStatus from %s tid %t: up %a s, %w, %v",
    /// Received and followed a unitless command.
    CommandUnitless = "rx ArrayCommand from %s tid %t: id %c unitless %+%3, pulse %p us",
    /// Received and followed a position command.
    CommandPosition = "rx ArrayCommand from %s tid %t: id %c position %+%3 rad, pulse %p us",
    /// Received and followed a PWM command.
    CommandPwm = "rx ArrayCommand from %s tid %t: id %c PWM %a us, pulse %p us",
    /// Received and followed a command of the thesis.
    CommandThesis = "rx thesis.ServoCommand from %s tid %t: %c, pulse %p us",
    /// Received a command without an entry for this node.
    CommandElsewhere = "rx ArrayCommand from %s tid %t: not for actuator %c",
    /// Received a command, and followed several entries of it.
    #[cfg(feature = "outputs")]
    CommandMany = "rx ArrayCommand from %s tid %t: id %c and others",
    /// Received a command. It is not logged: it is when it is followed.
    #[cfg(feature = "outputs")]
    CommandWaits = "waits",
    /// Received an esc.RawCommand, and followed the command for a motor.
    #[cfg(feature = "outputs")]
    RawCommand = "rx RawCommand from %s tid %t: motor %c %+%0, pulse %p us",
    /// Received an esc.RawCommand, and followed the commands for several motors.
    #[cfg(feature = "outputs")]
    RawCommandMany = "rx RawCommand from %s tid %t: motor %c and others",
    /// Received an esc.RawCommand without a command for this node.
    #[cfg(feature = "outputs")]
    RawCommandElsewhere = "rx RawCommand from %s tid %t: not for this node",
    /// The temperature, logged once a second.
    Temperature = "temperature %+%1 C",
    /// Voltage and current of the circuit, logged once a second.
    #[cfg(feature = "power")]
    Circuit = "circuit %b mV, %+%2 A",
    /// Two nodes command the output.
    TwoCommanders = "TWO COMMANDERS",
    /// Received a request.
    Request = "rx request %a from %s tid %t",
    /// A parameter was set.
    #[cfg(feature = "standard")]
    ParameterSet = "rx GetSet from %s tid %t: set %n = %a",
    /// A parameter was not set: the value is out of range.
    #[cfg(feature = "standard")]
    ParameterRejected = "rx GetSet from %s tid %t: out of range for %n",
    /// A parameter was not set: so many outputs have no room at such a rate.
    #[cfg(feature = "outputs")]
    ParameterNoRoom = "rx GetSet from %s tid %t: OUT_COUNT pulses do not fit at OUT_RATE, %n",
    /// Received an Allocation that gives this node no ID.
    #[cfg(feature = "allocation")]
    AllocationElsewhere = "rx Allocation from %s",
    /// Received a LightsCommand.
    #[cfg(feature = "lights")]
    Light = "rx LightsCommand from %s tid %t: light %c",
    /// Received a tunnel.Targetted.
    #[cfg(feature = "tunnel")]
    Targetted = "rx Targetted from %s tid %t",
    /// Received an ArmingStatus.
    #[cfg(feature = "standard")]
    Arming = "rx ArmingStatus from %s tid %t: %c",
    /// Reset cause.
    PowerOn = "power-on",
    /// Reset cause.
    External = "reset pin",
    /// Reset cause.
    AskedFor = "RestartNode",
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
    /// NodeStatus mode 7. Also the unassigned modes 4 to 6.
    ModeOffline = "OFFLINE",
    /// The monitor dropped lines because its queue was full.
    Lost = "%c lines dropped",
    /// The first line after a reset.
    Banner = concat!("DroneCAN servo node ", env!("CARGO_PKG_VERSION"), ", node ID %s, reset: %w"),
    /// The CAN controller is on the bus.
    Running = "CAN: running",
    /// No chip answers on the SPI.
    NotAnswering = "CAN: MCP2515 silent (CANSTAT %x)",
    /// A register did not read back as written.
    NotKeeping = "CAN: MCP2515 forgets register %x",
    /// The CAN controller did not enter normal mode.
    NotStarting = "CAN: bus never idle (CANSTAT %x)",
    /// The CAN controller lost its configuration.
    ControllerLost = "CAN: MCP2515 lost its settings",
    /// No node acknowledges, or the bus is never idle.
    GaveUp = "CAN: nothing sent for 1 s (%a times)",
    /// The CAN controller lost received frames.
    FramesLost = "CAN: frames lost (%a times)",
    /// The CAN controller is bus-off.
    BusOff = "CAN: bus-off",
    /// The CAN controller is error-passive.
    ErrorPassive = "CAN: error-passive",
    /// The CAN controller is error-active again.
    ErrorActive = "CAN: error-active",
    /// The parameters are saved in EEPROM.
    #[cfg(feature = "standard")]
    Saved = "parameters saved",
    /// Saving the parameters in EEPROM failed.
    #[cfg(feature = "standard")]
    NotSaved = "parameters not saved",
    /// Values in the EEPROM were lost or out of range. The defaults apply to them.
    ParametersLost = "parameters lost, defaults",
    /// An allocator gave this node its ID.
    #[cfg(feature = "allocation")]
    Allocated = "node ID %c allocated by %s",
    /// The failsafe begins.
    Failsafe = "FAILSAFE: no commands",
    /// The failsafe ends.
    FailsafeEnd = "commands again",
    /// The failsafe of an output begins.
    #[cfg(feature = "outputs")]
    FailsafeOf = "FAILSAFE of output %c",
    /// The failsafe of an output ends.
    #[cfg(feature = "outputs")]
    FailsafeOfEnd = "commands again for output %c",
    /// The vehicle is disarmed.
    #[cfg(feature = "standard")]
    Disarmed = "disarmed",
    /// The safety switch is on.
    #[cfg(feature = "safety")]
    Safe = "safety switch on",
    /// Received a SafetyState.
    #[cfg(feature = "safety")]
    SafetyState = "rx SafetyState from %s tid %t: %c",
    /// The vehicle is armed again.
    #[cfg(feature = "standard")]
    DisarmedEnd = "armed",
    /// The voltage or the current leaves its range.
    #[cfg(feature = "power")]
    PowerOutOfRange = "voltage or current out of range",
    /// The voltage and the current are in their ranges again.
    #[cfg(feature = "power")]
    PowerOutOfRangeEnd = "voltage and current in range",
    /// The temperature leaves its range.
    OutOfRange = "temperature out of range",
    /// The temperature is in its range again.
    OutOfRangeEnd = "temperature in range",
    /// The temperature is out of range because the sensor is open or shorted.
    SensorFault = "temperature sensor open or short",
    /// The node changes to the draft of 2014.
    #[cfg(feature = "draft")]
    Draft = "draft of 2014",
    /// The node changes back to DroneCAN v0.
    #[cfg(feature = "draft")]
    DraftEnd = "DroneCAN v0",
    /// The button was pressed.
    #[cfg(feature = "button")]
    Button = "button pressed %a times",
    /// On request: counts of commands followed and frames rejected.
    CountsIn = "commands followed %a, frames refused %b",
    /// On request: counts of overruns and of frames given up.
    CountsOut = "overruns %a, given up %b",
}

/// A byte of a packed text, decoded.
///
/// | codes | |
/// | --- | --- |
/// | 0x20 to [`LAST_CHARACTER`], carriage return, line feed | characters |
/// | from [`FIRST_FIELD`] to 0x1F | fields |
/// | the others, from the one after [`LAST_CHARACTER`] | pairs |
pub enum Code {
    /// This character.
    Character(u8),
    /// A pair of codes. The first is at this index of [`PACKED`], the other [`SECOND`] bytes after
    /// it.
    Pair(u16),
    /// The value of this field.
    Field(u8),
}

const FIRST_CHARACTER: u8 = b' ';
const LAST_CHARACTER: u8 = b'z';
const FIRST_FIELD: u8 = b'\r' + 1;
const FIELDS: u8 = FIRST_CHARACTER - FIRST_FIELD;
const FIRST_PAIR: u8 = LAST_CHARACTER + 1;
const _: () = assert!(Field::LETTERS.len() <= FIELDS as usize);
/// Number of codes that can stand for a pair.
const PAIRS: u8 = b'\n'.wrapping_sub(FIRST_PAIR);

impl From<u8> for Code {
    #[inline(always)]
    fn from(code: u8) -> Self {
        let index = code.wrapping_sub(FIRST_PAIR);
        if index < PAIRS {
            return Self::Pair((PAIRS_AT as u16).wrapping_add(u16::from(index)));
        }
        let index = code.wrapping_sub(FIRST_FIELD);
        if index < FIELDS { Self::Field(index) } else { Self::Character(code) }
    }
}

/// Ends a line: the pair of carriage return and line feed.
pub const LINE_END: u8 = FIRST_PAIR;

/// The numbers of the fields in [`Code::Field`], and their letters in a text. See
/// [`Event`](super::Event).
pub struct Field;

impl Field {
    /// `s`. This number and the next two are also indices in the bytes of an event.
    pub const SOURCE: u8 = 0;
    /// `t`
    pub const TRANSFER: u8 = 1;
    /// `c`
    pub const CODE: u8 = 2;
    /// `x`
    pub const HEX: u8 = 3;
    /// `w`
    pub const WORD: u8 = 4;
    /// `v`
    pub const OTHER_WORD: u8 = 5;
    /// `n`
    pub const NAME: u8 = 6;
    /// `b`
    pub const B: u8 = 7;
    /// `p`
    pub const HALVES: u8 = 8;
    /// `a`
    pub const A: u8 = 9;
    /// `+`
    pub const SIGN: u8 = 10;
    /// `0`. The next three numbers stand for one, two and three decimal places.
    pub const NO_PLACES: u8 = 11;

    /// The letters in the order of the numbers.
    const LETTERS: &[u8; 15] = b"stcxwvnbpa+0123";
}

const fn field(letter: u8) -> u16 {
    let mut n = 0;
    while Field::LETTERS[n] != letter {
        n += 1;
    }
    FIRST_FIELD as u16 + n as u16
}

const fn plain_len() -> usize {
    let mut len = 0;
    let mut line = 0;
    while line < LINES.len() {
        len += LINES[line].len() + 1;
        line += 1;
    }
    len
}

/// Marks the end of a line during packing. Larger than every code.
const END: u16 = 0x100;

/// The lines during packing.
struct Packing {
    text: [u16; plain_len()],
    len: usize,
    pairs: [[u8; 2]; PAIRS as usize],
    used: usize,
}

impl Packing {
    /// The lines unpacked: one code for each character and each field.
    const fn new() -> Self {
        let mut packing =
            Self { text: [END; plain_len()], len: 0, pairs: [[0; 2]; PAIRS as usize], used: 0 };
        let mut line = 0;
        while line < LINES.len() {
            let text = LINES[line].as_bytes();
            let mut n = 0;
            while n < text.len() {
                packing.text[packing.len] = if text[n] == b'%' {
                    n += 1;
                    field(text[n])
                } else {
                    assert!(FIRST_CHARACTER <= text[n] && text[n] <= LAST_CHARACTER);
                    text[n] as u16
                };
                packing.len += 1;
                n += 1;
            }
            packing.text[packing.len] = END;
            packing.len += 1;
            line += 1;
        }
        packing
    }

    /// Replaces each occurrence of the pair `old` by the code `new`, and counts the pairs of the
    /// result. Returns the most frequent pair and its count. One pass does both, because the
    /// compiler evaluates this slowly, once for each crate that needs the result.
    const fn replace(&mut self, old: [u16; 2], new: u16) -> ([u16; 2], u8) {
        // Each array counts a quarter of all pairs: on the AVR, whose sizes apply here, an array of
        // 65,536 bytes is too large.
        const QUARTER: usize = 1 << 14;
        let mut q0 = [0u8; QUARTER];
        let mut q1 = [0u8; QUARTER];
        let mut q2 = [0u8; QUARTER];
        let mut q3 = [0u8; QUARTER];
        let (mut best, mut best_count) = ([END; 2], 0);
        let (mut from, mut to, mut first) = (0, 0, END);
        while from < self.len {
            let mut second = self.text[from];
            from += 1;
            if second == old[0] && from < self.len && self.text[from] == old[1] {
                second = new;
                from += 1;
            }
            self.text[to] = second;
            to += 1;
            if first != END && second != END {
                let counts = match first >> 6 {
                    0 => &mut q0,
                    1 => &mut q1,
                    2 => &mut q2,
                    _ => &mut q3,
                };
                let count = &mut counts[((first & 63) << 8 | second) as usize];
                *count = count.saturating_add(1);
                if *count > best_count {
                    (best, best_count) = ([first, second], *count);
                }
            }
            first = second;
        }
        self.len = to;
        (best, best_count)
    }
}

/// Byte-pair encoding: replaces the most frequent pair of codes by a new code, as long as that
/// makes the table shorter.
const PACKING: Packing = {
    let mut packing = Packing::new();
    // The first pair is the end of a line.
    packing.pairs[0] = *b"\r\n";
    packing.used = 1;
    // No two `END`s are side by side, so this call only counts.
    let (mut pair, mut count) = packing.replace([END; 2], END);
    // A pair takes two bytes of the table, so a count of two saves nothing.
    while count > 2 && packing.used < PAIRS as usize {
        packing.pairs[packing.used] = [pair[0] as u8, pair[1] as u8];
        let code = FIRST_PAIR.wrapping_add(packing.used as u8);
        packing.used += 1;
        (pair, count) = packing.replace(pair, code as u16);
    }
    packing
};

/// Index of the first halves of the pairs. The second halves follow.
const PAIRS_AT: usize = 0;
/// Distance from the first half of a pair to its second half.
pub const SECOND: u16 = PACKING.used as u16;
const LINES_AT: usize = PAIRS_AT + 2 * PACKING.used;

/// All texts: the pairs, then the lines. The length of each line is stored before it.
pub const PACKED: [u8; LINES_AT + PACKING.len] = {
    let mut packed = [0; LINES_AT + PACKING.len];
    let mut n = 0;
    while n < PACKING.used {
        [packed[PAIRS_AT + n], packed[PAIRS_AT + PACKING.used + n]] = PACKING.pairs[n];
        n += 1;
    }
    let mut length_at = LINES_AT;
    n = 0;
    while n < PACKING.len {
        let at = LINES_AT + n + 1;
        if PACKING.text[n] == END {
            length_at = at;
        } else {
            packed[at] = PACKING.text[n] as u8;
            packed[length_at] += 1;
        }
        n += 1;
    }
    packed
};

/// Index of the length of the first line.
pub const FIRST_LINE: u16 = LINES_AT as u16;
