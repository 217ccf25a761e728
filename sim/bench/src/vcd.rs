//! The signals of one board and of the bus as VCD (value change dump): the file's text, and how the
//! events of a probe are drawn.
//!
//! The models transfer whole bytes on SPI and UART, so the bits of a byte are drawn from its start
//! and its bit time. The edges of CAN, CS, INT, SERVO and OUT2 to OUT8 are those of the models.
//!
//! Limits: a byte on the SPI that a reset interrupts is not drawn. MISO floats while CS is high and
//! until the first bit, and keeps the last bit between bytes; the real chip shows its next bit
//! there. INT falls when the AVR samples it, one or two instructions after the bit on the bus. TXD
//! and RXD are high when idle, even if the pins are not.

mod writer;

use std::io::Write;

use crate::Cycles;
use crate::avr::{SerialCharacter, SpiByte};
use crate::board::WireEvent;
use crate::can;
use crate::wiring::Pin;

pub use vcd::Value;
pub use writer::{Levels, NAMES, PINS, WIRES, WIRES_OF_EVERY_BOARD, Wire, Writer};

/// Longest time from the start of a byte on the SPI to its event, which comes at its end: 8 bits of
/// 128 cycles.
pub const SPI_LAG: Cycles = 8 * 128;

/// The signal of this name, for the command line.
///
/// # Errors
/// If there is none.
pub fn signal(name: &str) -> Result<Wire, String> {
    let found = NAMES.iter().find(|(_, known)| known.eq_ignore_ascii_case(name));
    found.map(|(wire, _)| *wire).ok_or_else(|| {
        let names: Vec<&str> = NAMES.iter().map(|(_, name)| *name).collect();
        format!("no signal is called \"{name}\": use {}", names.join(", "))
    })
}

/// Levels of all wires: those of the bus and of the events with which a probe begins, else idle.
pub fn levels(bus: can::Level, probe: &[(Cycles, WireEvent)]) -> Levels {
    let mut levels = [Value::V1; WIRES];
    levels[Wire::Sck as usize] = Value::V0;
    levels[Wire::Mosi as usize] = Value::V0;
    levels[Wire::Miso as usize] = Value::Z;
    levels[Wire::Can as usize] = (!bus.is_dominant()).into();
    for (_, event) in probe {
        if let Some((wire, level)) = plain_level(*event) {
            levels[wire as usize] = level.into();
        }
    }
    levels
}

/// The wires of the file with their names: those of `signals` that the board has, or all of them,
/// and the watched pins. `outputs` is the number of outputs besides the servo's.
pub fn wires(signals: &[Wire], outputs: usize, pins: &[Pin]) -> Vec<(Wire, String)> {
    let all = NAMES.iter().take(WIRES_OF_EVERY_BOARD + outputs);
    let chosen = all.filter(|(wire, _)| signals.is_empty() || signals.contains(wire));
    let chosen = chosen.map(|(wire, name)| (*wire, (*name).to_owned()));
    chosen.chain(PINS.into_iter().zip(pins.iter().map(Pin::to_string))).collect()
}

/// The wire and its level after `event`; `None` for a byte, which has many edges.
fn plain_level(event: WireEvent) -> Option<(Wire, bool)> {
    match event {
        WireEvent::Cs(high) => Some((Wire::Cs, high)),
        WireEvent::Int(high) => Some((Wire::Int, high)),
        WireEvent::Servo(high) => Some((Wire::Servo, high)),
        WireEvent::Output { index, high } => {
            NAMES.get(WIRES_OF_EVERY_BOARD + index).map(|(wire, _)| (*wire, high))
        }
        WireEvent::Spi { .. } | WireEvent::Serial(_) => None,
    }
}

/// Draws the bits of a byte (datasheet section 19.4). With CPHA = 0 the data changes half a bit
/// before the first edge of SCK, with CPHA = 1 at the first edge.
fn draw_spi<W: Write>(writer: &mut Writer<W>, byte: &SpiByte, miso: u8) {
    let idle = byte.mode & 0b10 != 0;
    let late_phase = byte.mode & 0b01 != 0;
    let half = byte.cycles_per_bit / 2;
    for bit in 0..8_u8 {
        let begin = byte.start + u64::from(bit) * byte.cycles_per_bit;
        let mask = 0x80 >> bit;
        writer.change(begin, Wire::Mosi, byte.mosi & mask != 0);
        writer.change(begin, Wire::Miso, miso & mask != 0);
        writer.change(begin, Wire::Sck, idle ^ late_phase);
        writer.change(begin + half, Wire::Sck, idle ^ !late_phase);
    }
    writer.change(byte.end, Wire::Sck, idle);
}

/// Draws the events of a board's probe. A character is drawn as a whole when it begins.
pub struct Drawn {
    /// Time up to which TXD and RXD are drawn.
    txd_to: Cycles,
    rxd_to: Cycles,
}

impl Drawn {
    /// Nothing is drawn before `now`.
    pub fn new(now: Cycles) -> Drawn {
        Drawn { txd_to: now, rxd_to: now }
    }

    /// Draws an event of the probe.
    pub fn draw<W: Write>(&mut self, writer: &mut Writer<W>, at: Cycles, event: WireEvent) {
        match event {
            WireEvent::Cs(high) => {
                writer.change(at, Wire::Cs, high);
                if high {
                    writer.change(at, Wire::Miso, Value::Z);
                }
            }
            WireEvent::Spi { byte, miso } => draw_spi(writer, &byte, miso),
            WireEvent::Serial(character) => self.draw_serial(writer, &character),
            WireEvent::Int(_) | WireEvent::Servo(_) | WireEvent::Output { .. } => {
                if let Some((wire, level)) = plain_level(event) {
                    writer.change(at, wire, level);
                }
            }
        }
    }

    fn draw_serial<W: Write>(&mut self, writer: &mut Writer<W>, character: &SerialCharacter) {
        let (wire, drawn_to) = if character.to_chip {
            (Wire::Rxd, &mut self.rxd_to)
        } else {
            (Wire::Txd, &mut self.txd_to)
        };
        if character.start < *drawn_to {
            writer.cut(character.start, wire);
        }
        for bit in 0..u64::from(character.bits) {
            let level = character.levels >> bit & 1 != 0;
            writer.change(character.start + bit * character.cycles_per_bit, wire, level);
        }
        // Stop bits and the idle line are high.
        let end = character.start + u64::from(character.bits) * character.cycles_per_bit;
        writer.change(end, wire, true);
        *drawn_to = end;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Draws with `draw`, and returns the changes of one wire as (cycle, level).
    fn drawn(wire: &str, draw: impl FnOnce(&mut Writer<&mut Vec<u8>>)) -> Vec<(Cycles, char)> {
        let mut out = Vec::new();
        let mut writer = Writer::new(&mut out, 0, &wires(&[], 0, &[]), [Value::Z; WIRES]).unwrap();
        draw(&mut writer);
        writer.finish(1_000_000).unwrap();
        drop(writer);
        let text = String::from_utf8(out).unwrap();
        let variable = text.lines().find(|line| line.contains(&format!(" {wire} "))).unwrap();
        let code = variable.split(' ').nth(3).unwrap();
        let (mut at, mut changes) = (0, Vec::new());
        for line in text.split_once("$dumpvars").unwrap().1.lines() {
            if let Some(time) = line.strip_prefix('#') {
                at = time.parse::<u64>().unwrap() / 625;
            } else if let Some(level) = line.strip_suffix(code).filter(|level| level.len() == 1) {
                changes.push((at, level.chars().next().unwrap()));
            }
        }
        changes.retain(|&(_, level)| level != 'z');
        changes
    }

    #[test]
    fn the_file_has_the_signals_that_were_asked_for() {
        assert_eq!(signal("can"), Ok(Wire::Can));
        assert!(signal("CAN2").unwrap_err().contains("use CAN, CS, SCK"));
        let pin = "D8".parse().unwrap();
        let chosen = wires(&[Wire::Out3, Wire::Can], 1, &[pin]);
        let expected = [(Wire::Can, "CAN".to_owned()), (Wire::Pin1, "D8".to_owned())];
        assert_eq!(chosen, expected, "the board has no third output");
        assert_eq!(wires(&[], 0, &[]).len(), WIRES_OF_EVERY_BOARD);
    }

    fn byte(mode: u8) -> SpiByte {
        SpiByte { mosi: 0b1010_0000, start: 100, end: 116, cycles_per_bit: 2, mode }
    }

    /// The wire for a byte on the SPI, and the times at which it has `level`.
    fn spi(wire: &str, mode: u8, miso: u8, level: char) -> (Vec<(Cycles, char)>, Vec<Cycles>) {
        let changes = drawn(wire, |writer| draw_spi(writer, &byte(mode), miso));
        let at = changes.iter().filter(|change| change.1 == level).map(|change| change.0).collect();
        (changes, at)
    }

    #[test]
    fn data_changes_at_the_falling_edge_in_mode_0_and_in_mode_3_whose_clock_idles_high() {
        let (clock, rising) = spi("SCK", 0, 0, '1');
        assert_eq!(rising, [101, 103, 105, 107, 109, 111, 113, 115]);
        assert_eq!((clock[0], clock.last()), ((100, '0'), Some(&(116, '0'))));
        let (data, _) = spi("MOSI", 0, 0, '1');
        assert_eq!(data, [(100, '1'), (102, '0'), (104, '1'), (106, '0')]);
        let (clock, falling) = spi("SCK", 3, 0, '0');
        assert_eq!(falling, [100, 102, 104, 106, 108, 110, 112, 114]);
        assert_eq!(clock.last(), Some(&(115, '1')));
        assert_eq!(spi("MISO", 3, 0x01, '1').0, [(100, '0'), (114, '1')]);
    }

    /// 'A' as 8N1: start bit, 0x41 from its lowest bit, stop bit.
    const CHARACTER: SerialCharacter = SerialCharacter {
        to_chip: false,
        start: 1000,
        cycles_per_bit: 136,
        levels: 0b10_1000_0010,
        bits: 10,
    };

    #[test]
    fn the_bits_of_a_character_are_one_bit_time_apart_and_a_reset_cuts_it_short() {
        let draw = |characters: &[SerialCharacter]| {
            let mut serial = Drawn { txd_to: 0, rxd_to: 0 };
            drawn("TXD", |writer| {
                characters.iter().for_each(|character| serial.draw_serial(writer, character));
            })
        };
        let expected = [(0, '0'), (1, '1'), (2, '0'), (7, '1'), (8, '0'), (9, '1')];
        let expected = expected.map(|(bit, level)| (1000 + 136 * bit, level));
        assert_eq!(draw(&[CHARACTER]), expected);
        let reset = SerialCharacter { start: 1300, levels: 0, bits: 0, ..CHARACTER };
        let expected = [(1000, '0'), (1136, '1'), (1272, '0'), (1300, '1')];
        assert_eq!(draw(&[CHARACTER, reset]), expected);
    }
}
