//! The board that this program is built for: what `build.rs` found in avr-specs/boards.toml.

use mcp2515_ordered::Counters;

/// Name of the node in GetNodeInfo, at most 80 characters of a-z, 0-9, `.`, `-` and `_`.
pub const NODE_NAME: &str = env!("NODE_NAME");

/// Major hardware version in GetNodeInfo: the chip.
pub const HARDWARE_MAJOR: u8 = decimal(env!("NODE_HARDWARE_MAJOR"));
/// Minor hardware version in GetNodeInfo: the wiring of the CAN board; 255 is wiring that is not in
/// the table.
pub const HARDWARE_MINOR: u8 = decimal(env!("NODE_HARDWARE_MINOR"));

/// Transfers of several frames that can be received at the same time: so many commands, and so many
/// requests.
pub const LANES: usize = decimal(env!("NODE_LANES")) as usize;

/// Crystal of the MCP2515, in hertz.
pub const CAN_CRYSTAL_HZ: u32 = decimal(env!("NODE_CRYSTAL_MHZ")) as u32 * 1_000_000;

/// MCP2515 CS.
pub const CAN_SELECT: Pin = Pin::named(env!("NODE_CS"));
/// MCP2515 INT.
pub const CAN_INTERRUPT: Pin = Pin::named(env!("NODE_INT"));
/// The servo's signal: D9 (OC1A) or D10 (OC1B).
pub const SERVO: Pin = Pin::named(env!("NODE_SERVO"));
/// Outputs that the node can have.
pub const OUTPUTS: usize = if cfg!(feature = "outputs") { 8 } else { 1 };
/// True if motors can have other pulses than servos.
pub const HAS_ESCS: bool = cfg!(feature = "escs");
/// Time from the beginning of an output's pulse to the beginning of the next output's pulse, in
/// microseconds.
pub const SLOT_US: u32 = 2500;
/// The pins of the outputs: the servo's, and those that interrupts switch.
pub const OUTPUT_PINS: [Pin; OUTPUTS] = {
    let mut pins = [SERVO; OUTPUTS];
    let mut rest = env!("NODE_OUTPUTS");
    let mut n = 1;
    while n < OUTPUTS {
        let mut len = 0;
        while len < rest.len() && rest.as_bytes()[len] != b',' {
            len += 1;
        }
        let (name, behind) = rest.split_at(len);
        pins[n] = Pin::named(name);
        rest = if behind.is_empty() { behind } else { behind.split_at(1).1 };
        n += 1;
    }
    pins
};
/// The table of [`OUTPUT_PINS`] in flash: the port and the mask of each. A single output needs
/// none.
pub struct OutputPins;
/// Bytes of the table.
const PACKED_LEN: usize = if OUTPUTS == 1 { 0 } else { 2 * OUTPUTS };
/// The table.
pub const PACKED_OUTPUT_PINS: [u8; PACKED_LEN] = {
    let mut packed = [0; PACKED_LEN];
    let mut at = 0;
    while at != PACKED_LEN {
        let pin = OUTPUT_PINS[at / 2];
        packed[at] = pin.port;
        packed[at + 1] = pin.mask();
        at += 2;
    }
    packed
};
/// The light (OC2B). `None` if INT or the shaft's pulses are on its pin.
pub const LIGHT: Option<Pin> = optional(env!("NODE_LIGHT"));
/// The pulses of the shaft: D3 (INT1), or D2 (INT0) if the CAN controller's INT is on D3. `None`
/// without the feature `rpm`.
pub const SHAFT: Option<Pin> = optional(env!("NODE_RPM"));
/// The temperature sensor.
const SENSOR: Pin = Pin::named(env!("NODE_SENSOR"));
/// The pins for voltage and current of the circuit.
const POWER: [Pin; 2] = {
    let (voltage, rest) = env!("NODE_POWER").split_at(2);
    [Pin::named(voltage), Pin::named(rest.split_at(1).1)]
};
/// The button.
pub const BUTTON: Pin = Pin::named(env!("NODE_BUTTON"));

/// An input of the ADC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Input {
    /// The temperature sensor.
    Sensor,
    /// The voltage of the circuit.
    Voltage,
    /// The current of the circuit.
    Current,
}

impl Input {
    /// The inputs that the program measures.
    pub const ALL: &[Self] = if cfg!(feature = "power") {
        &[Self::Sensor, Self::Voltage, Self::Current]
    } else {
        &[Self::Sensor]
    };

    /// The pin, which has the number of its channel in port C.
    pub const fn pin(self) -> Pin {
        match self {
            Self::Sensor => SENSOR,
            Self::Voltage => POWER[0],
            Self::Current => POWER[1],
        }
    }
}

/// The pulses of the shaft since the board was asked before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShaftPulses {
    /// How many there were.
    pub count: u8,
    /// Time of the last one, in milliseconds modulo 256.
    pub ms: u8,
    /// The same time, in ticks since that millisecond began: 0 to
    /// [`TICKS_PER_MS`](Self::TICKS_PER_MS) - 1.
    pub ticks: u8,
}

impl ShaftPulses {
    /// Ticks in a millisecond.
    pub const TICKS_PER_MS: u8 = 250;

    /// Ticks of a slot, 248 us: the board counts one pulse in each slot at most.
    pub const SLOT_TICKS: u8 = 62;

    /// No pulses.
    pub const NONE: Self = Self { count: 0, ms: 0, ticks: 0 };
}

/// Access to the counters of the CAN controller's driver.
pub trait CanCounters {
    /// Word `n` of the 16-bit words of [`Counters`].
    fn word(&self, n: u8) -> u16;
}

impl CanCounters for Counters {
    fn word(&self, n: u8) -> u16 {
        Counters::word(self, n)
    }
}

/// A pin of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pin {
    /// `B`, `C` or `D`.
    pub port: u8,
    /// 0 to 7.
    pub bit: u8,
}

impl Pin {
    /// The pin with a name of the Arduino: D0 to D13, A0 to A5. Panics if there is none.
    pub const fn named(name: &str) -> Self {
        let (kind, number) = name.split_at(1);
        let number = decimal(number);
        match (kind.as_bytes()[0], number) {
            (b'D', 0..=7) => Self { port: b'D', bit: number },
            (b'D', 8..=13) => Self { port: b'B', bit: number - 8 },
            (b'A', 0..=5) => Self { port: b'C', bit: number },
            _ => panic!("no pin of the Arduino has this name"),
        }
    }

    /// The bit mask of the pin in its port.
    pub const fn mask(self) -> u8 {
        1 << self.bit
    }
}

/// The pin with this name, if there is a name.
const fn optional(name: &str) -> Option<Pin> {
    if name.is_empty() { None } else { Some(Pin::named(name)) }
}

const fn decimal(digits: &str) -> u8 {
    match u8::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => panic!("a number of avr-specs/boards.toml is not from 0 to 255"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pins_have_the_places_that_the_arduino_gives_them() {
        for (name, port, bit) in [
            ("D0", b'D', 0),
            ("D7", b'D', 7),
            ("D8", b'B', 0),
            ("D10", b'B', 2),
            ("D13", b'B', 5),
            ("A5", b'C', 5),
        ] {
            assert_eq!(Pin::named(name), Pin { port, bit }, "{name}");
        }
    }

    #[test]
    fn no_two_signals_share_a_pin() {
        let mut pins = vec![
            CAN_SELECT,
            CAN_INTERRUPT,
            SERVO,
            BUTTON,
            SENSOR,
            Pin::named("D0"),
            Pin::named("D1"),
        ];
        pins.extend(&OUTPUT_PINS[1..]);
        pins.extend(POWER);
        pins.extend(["D11", "D12", "D13"].map(Pin::named));
        pins.extend(LIGHT);
        pins.extend(SHAFT);
        for (n, pin) in pins.iter().enumerate() {
            assert!(!pins[..n].contains(pin), "{pin:?}");
        }
    }
}
