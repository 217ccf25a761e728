//! The texts of the serial monitor, packed for flash.
//!
//! On the AVR a string literal is copied to RAM at start. So the texts are packed at compile time into a
//! table that stays in flash. A `%` and a letter in them stand for a value; see [`Event`](super::Event).

/// The table: [`PACKED`].
pub struct Texts;

macro_rules! lines {
    ($($(#[doc = $doc:literal])* $(#[cfg($if:meta)])? $name:ident = $text:expr,)*) => {
        #[repr(u8)]
        enum Place {
            $($(#[cfg($if)])? $name,)*
        }

        /// A line of text, or a word to insert in one: one of the constants here.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub struct Line(u8);

        #[allow(non_upper_case_globals, reason = "they read as the variants of an enumeration, which they are")]
        impl Line {
            $($(#[doc = $doc])* $(#[cfg($if)])? pub const $name: Self = Self(Place::$name as u8);)*

            /// The line so many after this one.
            pub const fn plus(self, n: u8) -> Self {
                Self(self.0.wrapping_add(n))
            }

            /// Its number.
            pub const fn number(self) -> u8 {
                self.0
            }
        }

        /// The text of each [`Line`].
        pub const LINES: &[&str] = &[$($(#[cfg($if)])? $text,)*];
    };
}

lines! {
    /// Refused a frame.
    RefusedKind = "refused: standard or remote frame",
    /// Refused a frame.
    RefusedSource = "refused: type %a from %s, anonymous or mine",
    /// Refused a frame.
    RefusedTransfer = "refused: type %a from %s, not a whole frame",
    /// Refused a request.
    RefusedBusy = "refused: request from %s, busy",
    /// Refused a frame.
    RefusedBroken = "refused: type %a from %s, broken",
    /// Refused a frame.
    RefusedInterleaved = "refused: type %a from %s, interleaved",
    /// Refused a frame.
    RefusedLength = "refused: type %a from %s tid %t, wrong length",
    /// Refused a command.
    RefusedType = "refused: command from %s tid %t, unknown type",
    /// Refused a command.
    #[cfg(feature = "standard")]
    RefusedDisarmed = "refused: command from %s tid %t, disarmed",
    /// Refused a command.
    RefusedValue = "refused: command from %s tid %t, no such pulse",
    /// Received a NodeStatus.
    Status = "rx NodeStatus from %s tid %t: up %a s, %w, %v",
    /// Received a command that was followed.
    CommandUnitless = "rx ArrayCommand from %s tid %t: id %c unitless %+%3, pulse %p us",
    /// Received a command that was followed.
    CommandPosition = "rx ArrayCommand from %s tid %t: id %c position %+%3 rad, pulse %p us",
    /// Received a command that was followed.
    CommandPwm = "rx ArrayCommand from %s tid %t: id %c PWM %a us, pulse %p us",
    /// Received a command that was followed.
    CommandThesis = "rx thesis.ServoCommand from %s tid %t: %c, pulse %p us",
    /// Received a command for others only.
    CommandElsewhere = "rx ArrayCommand from %s tid %t: not for actuator %c",
    /// Sent a temperature.
    Temperature = "temperature %+%1 C",
    /// A request.
    Request = "rx request %a from %s tid %t",
    /// A parameter was set.
    #[cfg(feature = "standard")]
    ParameterSet = "rx GetSet from %s tid %t: set %n = %a",
    /// Allocation.
    #[cfg(feature = "allocation")]
    AllocationElsewhere = "rx Allocation from %s",
    /// Lights.
    #[cfg(feature = "lights")]
    Light = "rx LightsCommand from %s tid %t: light %c",
    /// Arming.
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
    /// NodeStatus mode 7, and those between that mean nothing yet.
    ModeOffline = "OFFLINE",
    /// Events were dropped.
    Lost = "%c lines dropped",
    /// After a reset.
    Banner = concat!("DroneCAN servo node ", env!("CARGO_PKG_VERSION"), ", node ID %s, reset: %w"),
    /// The CAN controller is up.
    Running = "CAN: running",
    /// Nobody at the SPI.
    NotAnswering = "CAN: MCP2515 silent (CANSTAT %x), trying again",
    /// A register did not read back.
    NotKeeping = "CAN: MCP2515 forgets register %x, trying again",
    /// No normal mode.
    NotStarting = "CAN: bus never idle (CANSTAT %x), trying again",
    /// Configuration gone.
    ControllerLost = "CAN: MCP2515 lost its settings",
    /// Nobody acknowledges, or the bus is never free.
    GaveUp = "CAN: nothing sent for 1 s (%a times)",
    /// Overrun.
    FramesLost = "CAN: frames lost (%a times)",
    /// Error state.
    BusOff = "CAN: bus-off",
    /// Error state.
    ErrorPassive = "CAN: error-passive",
    /// It ended.
    ErrorActive = "CAN: error-active",
    /// EEPROM.
    #[cfg(feature = "standard")]
    Saved = "parameters saved",
    /// EEPROM.
    #[cfg(feature = "standard")]
    NotSaved = "parameters not saved",
    /// EEPROM.
    ParametersLost = "parameters lost, defaults",
    /// Allocation.
    #[cfg(feature = "allocation")]
    Allocated = "node ID %c allocated by %s",
    /// Begins.
    Failsafe = "FAILSAFE: no commands",
    /// Ends.
    FailsafeEnd = "commands again",
    /// Begins.
    #[cfg(feature = "standard")]
    Disarmed = "disarmed",
    /// Ends.
    #[cfg(feature = "standard")]
    DisarmedEnd = "armed",
    /// Begins.
    OutOfRange = "temperature out of range",
    /// Ends.
    OutOfRangeEnd = "temperature in range",
    /// Begins.
    SensorFault = "temperature sensor open or short",
    /// Ends.
    SensorFaultEnd = "temperature sensor OK",
    /// Begins.
    #[cfg(feature = "draft")]
    Draft = "draft of 2014",
    /// Ends.
    #[cfg(feature = "draft")]
    DraftEnd = "DroneCAN v0",
    /// Button.
    #[cfg(feature = "button")]
    Button = "button pressed %a times",
    /// Counters on request.
    CountsIn = "commands followed %a, frames refused %b",
    /// Counters on request.
    CountsOut = "overruns %a, given up %b",
}

/// What a byte of a packed text is.
///
/// | codes | |
/// | --- | --- |
/// | 0x20 to [`LAST_CHARACTER`], carriage return, line feed | characters |
/// | from [`FIRST_FIELD`] to 0x1F | fields |
/// | the others, from the one after [`LAST_CHARACTER`] | pairs |
pub enum Code {
    /// This character.
    Character(u8),
    /// The two codes that are here in the image.
    Pair(u16),
    /// The value that this field stands for.
    Field(u8),
}

const FIRST_CHARACTER: u8 = b' ';
const LAST_CHARACTER: u8 = b'z';
const FIRST_FIELD: u8 = b'\r' + 1;
const FIELDS: u8 = FIRST_CHARACTER - FIRST_FIELD;
const FIRST_PAIR: u8 = LAST_CHARACTER + 1;
const _: () = assert!(Field::LETTERS.len() <= FIELDS as usize);
/// How many pairs there can be.
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

/// What [`Code::Field`] has, and the letter that stands for it in a text. See [`Event`](super::Event).
pub struct Field;

impl Field {
    /// `s`. The first three are places in the bytes of an event.
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
    /// `0`. Those that follow have one decimal place, two and three.
    pub const NO_PLACES: u8 = 11;

    /// In the order of the numbers above.
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

/// After a line, while it is packed. No code.
const END: u16 = 0x100;

/// The lines while they are being packed.
struct Packing {
    text: [u16; plain_len()],
    len: usize,
    pairs: [[u8; 2]; PAIRS as usize],
    used: usize,
}

impl Packing {
    /// The lines with a code for each character and each field.
    const fn new() -> Self {
        let mut packing = Self { text: [END; plain_len()], len: 0, pairs: [[0; 2]; PAIRS as usize], used: 0 };
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

    /// Replaces a pair of codes by one code wherever it is, and counts the pairs that are there afterwards: the most frequent one, and how often it
    /// is there. One pass for both, because the compiler does this slowly, and for each crate that needs the result.
    const fn replace(&mut self, old: [u16; 2], new: u16) -> ([u16; 2], u8) {
        // A quarter of all pairs each: the AVR, whose sizes hold here, has no array of 65,536.
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

/// Replaces the most frequent pair of codes by a new code, until that saves nothing (byte-pair encoding).
const PACKING: Packing = {
    let mut packing = Packing::new();
    // What ends a line is a pair, too.
    packing.pairs[0] = *b"\r\n";
    packing.used = 1;
    // No two ends are side by side, so this only counts.
    let (mut pair, mut count) = packing.replace([END; 2], END);
    // What a pair costs in the table.
    while count > 2 && packing.used < PAIRS as usize {
        packing.pairs[packing.used] = [pair[0] as u8, pair[1] as u8];
        let code = FIRST_PAIR.wrapping_add(packing.used as u8);
        packing.used += 1;
        (pair, count) = packing.replace(pair, code as u16);
    }
    packing
};

/// First halves of the pairs, then the second ones.
const PAIRS_AT: usize = 0;
/// From a first half to the second one.
pub const SECOND: u16 = PACKING.used as u16;
const LINES_AT: usize = PAIRS_AT + 2 * PACKING.used;

/// All texts: the pairs, then the lines, each with its length before it.
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

/// Where the length of the first line is, before its text.
pub const FIRST_LINE: u16 = LINES_AT as u16;
