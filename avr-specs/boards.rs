//! The table of boards, `avr-specs/boards.toml`, and the pins that follow from the choice of a
//! board and a CAN board. The build scripts of the firmware and of the bootloader have this module,
//! and the simulator's bench. `scripts/boards.py` is compared with it by a test.
//!
//! Pins have the names of the Arduino: "D10", "A0". The table is compiled in, so no file is read.
//! A table that has a mistake panics with a text that names the place: whoever changed it sees it
//! when the firmware is built.

use std::sync::LazyLock;
use toml::{Table, Value};

const TEXT: &str = include_str!("boards.toml");

/// Minor hardware version of wiring that no entry of the table has.
pub const OWN_WIRING: u8 = 255;
/// Bit rates of nodes, the highest first.
pub const BIT_RATES: [u32; 4] = [1_000_000, 500_000, 250_000, 125_000];
/// Oscillator periods of the shortest bit: 5 time quanta of 2 periods (DS20001801J sections 5.1 and
/// 5.2).
const SHORTEST_BIT_PERIODS: u32 = 10;
/// Outputs of the feature `outputs` besides the servo's.
const MORE_OUTPUTS: usize = 7;

/// A board, a CAN board, and how it is wired.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Name of the board in the table.
    pub board: String,
    /// Name of the CAN board in the table.
    pub shield: String,
    /// Pin of the MCP2515's CS.
    pub cs: String,
    /// Pin of its INT.
    pub int: String,
    pub crystal_mhz: u32,
}

/// Environment variables that choose a board, in the order of the fields of [`Choice`].
pub const VARIABLES: [&str; 5] =
    ["NODE_BOARD", "NODE_SHIELD", "NODE_CS", "NODE_INT", "NODE_CRYSTAL_MHZ"];

impl Choice {
    /// The choice of the environment: [`VARIABLES`] as `variable` returns them. One that is absent
    /// or empty stands for the default.
    pub fn of_environment(variable: impl Fn(&str) -> Option<String>) -> Choice {
        let [board, shield, cs, int, crystal_mhz] =
            VARIABLES.map(|name| variable(name).filter(|value| !value.is_empty()));
        let shield = shield.unwrap_or_else(|| default_shield().to_owned());
        let wiring = Choice::of(&board.unwrap_or_else(|| default_board().to_owned()), &shield);
        Choice {
            cs: cs.unwrap_or(wiring.cs),
            int: int.unwrap_or(wiring.int),
            crystal_mhz: crystal_mhz.map_or(wiring.crystal_mhz, |text| {
                text.parse().unwrap_or_else(|_| panic!("NODE_CRYSTAL_MHZ={text} is no number"))
            }),
            ..wiring
        }
    }

    /// A board with a CAN board as the table wires it.
    pub fn of(board: &str, shield: &str) -> Choice {
        let entry = entry("shields", shield);
        Choice {
            board: board.to_owned(),
            shield: shield.to_owned(),
            cs: text(entry, "cs").to_owned(),
            int: text(entry, "int").to_owned(),
            crystal_mhz: number(entry, "crystal_mhz"),
        }
    }

    /// The entry of the board.
    pub fn board(&self) -> &'static Value {
        entry("boards", &self.board)
    }

    /// Name of the chip.
    pub fn chip(&self) -> &'static str {
        text(self.board(), "chip")
    }

    /// The servo's pin.
    pub fn servo(&self) -> &'static str {
        servo(&self.cs)
    }

    /// Inputs of the feature `power`: voltage and current.
    pub fn power(&self) -> [&'static str; 2] {
        power(&[&self.cs, &self.int])
    }

    /// Outputs 2 to 8 of the feature `outputs`.
    pub fn outputs(&self) -> Vec<&'static str> {
        let [voltage, current] = self.power();
        let taken = [self.cs.as_str(), self.servo(), voltage, current];
        let outputs: Vec<&str> = free("outputs", &taken).take(MORE_OUTPUTS).collect();
        assert_eq!(outputs.len(), MORE_OUTPUTS, "avr-specs/boards.toml: outputs has too few pins");
        outputs
    }

    /// The input of the feature `rpm`.
    pub fn rpm(&self) -> Option<&'static str> {
        free("rpm", &[&self.int]).next()
    }

    /// The light's pin; `None` if INT or a pin of `taken` has it.
    pub fn light(&self, taken: Option<&str>) -> Option<&'static str> {
        Some(pin("light")).filter(|light| *light != self.int && Some(*light) != taken)
    }

    /// Minor hardware version: that of the CAN boards with this wiring, or [`OWN_WIRING`].
    pub fn hardware_minor(&self) -> u8 {
        let has_this_wiring = |shield: &&str| {
            let Choice { cs, int, crystal_mhz, .. } = Choice::of(&self.board, shield);
            (cs, int, crystal_mhz) == (self.cs.clone(), self.int.clone(), self.crystal_mhz)
        };
        let found = names("shields").find(has_this_wiring).map(|name| entry("shields", name));
        found.map_or(OWN_WIRING, |shield| {
            number(shield, "hardware_minor").try_into().expect("a minor hardware version")
        })
    }
}

/// The highest bit rate of [`BIT_RATES`] that an MCP2515 reaches with this crystal: the default of
/// a node.
pub fn fastest_bit_rate(crystal_mhz: u32) -> u32 {
    let can = |rate: &u32| rate * SHORTEST_BIT_PERIODS <= crystal_mhz * 1_000_000;
    let [.., slowest] = BIT_RATES;
    BIT_RATES.into_iter().find(can).unwrap_or(slowest)
}

/// The servo's pin: the first output of Timer1 that CS leaves free.
pub fn servo(cs: &str) -> &'static str {
    free("servo", &[cs]).next().expect("avr-specs/boards.toml: servo has a pin besides CS")
}

/// The inputs for the voltage and the current of a circuit: the first two that are not taken.
pub fn power(taken: &[&str]) -> [&'static str; 2] {
    let mut free = free("power", taken);
    let mut next = || free.next().expect("avr-specs/boards.toml: power has too few pins");
    [next(), next()]
}

/// The pin of a signal that is on the same pin of every board: "light", "button" or "sensor".
pub fn pin(signal: &str) -> &'static str {
    text(&table()["pins"], signal)
}

/// The pins of a list of the table that are not taken, in order.
fn free(signal: &str, taken: &[&str]) -> impl Iterator<Item = &'static str> {
    let pins = field(&table()["pins"], signal).as_array();
    let pins = pins.unwrap_or_else(|| panic!("avr-specs/boards.toml: {signal} is not a list"));
    let name = |pin: &'static Value| pin.as_str().expect("avr-specs/boards.toml: pins are texts");
    pins.iter().map(name).filter(|pin| !taken.contains(pin))
}

/// Name of the board that is used if none is chosen.
pub fn default_board() -> &'static str {
    table()["default_board"].as_str().expect("avr-specs/boards.toml: default_board is a text")
}

/// Name of the CAN board that is used if none is chosen.
pub fn default_shield() -> &'static str {
    table()["default_shield"].as_str().expect("avr-specs/boards.toml: default_shield is a text")
}

/// The names of the entries of a kind: "boards", "shields" or "chips".
pub fn names(kind: &str) -> impl Iterator<Item = &'static str> {
    entries(kind).keys().map(String::as_str)
}

/// An entry, if there is one of this name.
pub fn find(kind: &str, name: &str) -> Option<&'static Value> {
    entries(kind).get(name)
}

/// An entry that the table must have.
pub fn entry(kind: &str, name: &str) -> &'static Value {
    find(kind, name).unwrap_or_else(|| panic!("avr-specs/boards.toml has no {kind}.{name}"))
}

/// A text of an entry.
pub fn text<'a>(entry: &'a Value, key: &str) -> &'a str {
    let text = field(entry, key).as_str();
    text.unwrap_or_else(|| panic!("avr-specs/boards.toml: {key} is not a text"))
}

/// A number of an entry.
pub fn number(entry: &Value, key: &str) -> u32 {
    let number = field(entry, key).as_integer().and_then(|number| number.try_into().ok());
    number.unwrap_or_else(|| panic!("avr-specs/boards.toml: {key} is not a number"))
}

fn field<'a>(entry: &'a Value, key: &str) -> &'a Value {
    entry.get(key).unwrap_or_else(|| panic!("avr-specs/boards.toml: {key} is missing"))
}

fn entries(kind: &str) -> &'static Table {
    let entries = table().get(kind).and_then(Value::as_table);
    entries.unwrap_or_else(|| panic!("avr-specs/boards.toml: {kind} is not a table"))
}

fn table() -> &'static Table {
    static PARSED: LazyLock<Table> = LazyLock::new(|| {
        TEXT.parse().unwrap_or_else(|error| panic!("avr-specs/boards.toml: {error}"))
    });
    &PARSED
}
