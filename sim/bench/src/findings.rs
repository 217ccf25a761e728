//! Hints for the author of a program: bit rates that do not match, a chip select that is never low,
//! and a frame that waits in a mode of the controller that does not send. Each hint is given once.
//!
//! A finding is not a mistake of the program, which may fit another board. That the serial port has
//! one of the rates of serial monitors is no hint, but a note. [`crash`] says why a program cannot
//! go on.

use crate::avr::{Avr, State};
use crate::board::{Board, PinUse};
use crate::mcp2515::{LoggedFrame, Mcp2515, Mode};
use crate::wiring::Pin;
use crate::{Cycles, F_CPU_HZ};
use std::cell::Cell;
use std::rc::Rc;

/// Largest difference of two CAN bit rates that counts as equal: just above the 1.58 % that ISO
/// 11898-1 allows at most.
const CAN_TOLERANCE_PER_MILLE: u64 = 16;
/// Largest difference of two baud rates at which a UART still receives characters of 10 bits.
const UART_TOLERANCE_PER_MILLE: u64 = 40;
/// The rate of the Arduino IDE's serial monitor, of ravedude and of this project.
const SERIAL_MONITOR_RATE: u64 = 115_200;
/// The rates that serial monitors offer.
const SERIAL_RATES: [u64; 11] =
    [300, 1_200, 2_400, 4_800, 9_600, 19_200, 38_400, 57_600, 115_200, 250_000, 1_000_000];
/// Time after power-on by which a program has configured its SPI.
const SPI_SETTLED: Cycles = F_CPU_HZ / 2;
/// A frame that waits this long for normal mode: the program has not set that mode. The start of a
/// program takes less.
const MODE_SETTLED: Cycles = F_CPU_HZ / 2;

/// RXF0SIDH and RXF1SIDH.
const FILTERS_OF_RXB0: [u8; 2] = [0x00, 0x04];

/// Pins that can be a chip select: none of the SPI or of the serial port.
const SELECTS: [&str; 15] =
    ["D2", "D3", "D4", "D5", "D6", "D7", "D8", "D9", "D10", "A0", "A1", "A2", "A3", "A4", "A5"];

/// What the author of a program is told.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Said {
    /// Something is likely to be wrong.
    Hint(String),
    /// Nothing is wrong.
    Note(String),
}

/// The hints given so far.
#[derive(Debug, Default)]
pub struct Findings {
    bit_rate: Option<u64>,
    serial_rate: Option<u64>,
    is_cs_reported: bool,
    selects: Selects,
    /// Start of the time in which a frame has waited in a mode that does not send.
    stuck_since: Option<Cycles>,
}

impl Findings {
    /// Counts the edges of pins, so that a hint can name the chip select of a program whose wiring
    /// is not known.
    pub fn watch_selects(&mut self, board: &mut Board) {
        self.selects = Selects::attach(board);
    }

    /// Checks a board on a bus of `bus_rate` bits per second. Returns what is new.
    pub fn check(&mut self, board: &Board, bus_rate: u32) -> Vec<String> {
        let hints = [
            self.check_can_rate(board, bus_rate),
            self.check_chip_select(board),
            self.check_mode(board),
        ];
        hints.into_iter().flatten().collect()
    }

    /// Checks the bits per second of a serial port that sends.
    pub fn check_serial_rate(&mut self, rate: u64) -> Option<Said> {
        if self.serial_rate.replace(rate) == Some(rate)
            || is_near(rate, SERIAL_MONITOR_RATE, UART_TOLERANCE_PER_MILLE)
        {
            return None;
        }
        let usual =
            SERIAL_RATES.into_iter().find(|usual| is_near(rate, *usual, UART_TOLERANCE_PER_MILLE));
        Some(match usual {
            Some(usual) => Said::Note(format!(
                "the serial port has {usual} baud: set the serial monitor of a real board to that"
            )),
            None => Said::Hint(format!(
                "the UART is at {rate} baud, which no serial monitor has: is the program for \
                 another clock?"
            )),
        })
    }

    fn check_can_rate(&mut self, board: &Board, bus_rate: u32) -> Option<String> {
        let chip = board.chip();
        let chip = chip.borrow();
        if !matches!(chip.mode(), Mode::Normal | Mode::ListenOnly) {
            return None;
        }
        let rate = chip.bit_rate();
        if self.bit_rate.replace(rate) == Some(rate)
            || is_near(rate, bus_rate.into(), CAN_TOLERANCE_PER_MILLE)
        {
            return None;
        }
        let fastest = board.wiring().fastest_bit_rate();
        let cure = if bus_rate > fastest {
            format!(
                "A crystal of {} MHz does at most {} kbit/s: all nodes need that (--bit-rate)",
                board.wiring().crystal_mhz,
                kilo(fastest.into())
            )
        } else {
            String::from(
                "Set the program's bit rate, its crystal (--crystal), or the bus (--bit-rate)",
            )
        };
        Some(format!(
            "the node is at {} kbit/s, the bus at {} kbit/s: each gets only errors from the \
             other. {cure}",
            kilo(rate),
            kilo(bus_rate.into())
        ))
    }

    fn check_chip_select(&mut self, board: &Board) -> Option<String> {
        let passed = board.spi_use();
        let is_silent = passed.selects == 0 && passed.bytes_elsewhere > 0;
        if self.is_cs_reported || !is_silent || board.now() < SPI_SETTLED {
            return None;
        }
        self.is_cs_reported = true;
        let cs = board.wiring().cs;
        let bytes = passed.bytes_elsewhere;
        Some(match self.selects.driven() {
            Some(pin) => format!(
                "{bytes} bytes on the SPI, but CS of the MCP2515 ({cs}) has never been low: the \
                 program drives {pin}, CS is wired to {cs} (--cs {pin})"
            ),
            None => format!(
                "{bytes} bytes on the SPI, but CS of the MCP2515 ({cs}) has never been low: is it \
                 another pin in the program (--cs)?"
            ),
        })
    }

    /// True if the program uses the pin as a chip select.
    pub fn is_chip_select(&self, pin: Pin) -> bool {
        self.selects.pins.iter().any(|(other, used)| *other == pin && used.get().is_select())
    }

    fn check_mode(&mut self, board: &Board) -> Option<String> {
        let chip = board.chip();
        let chip = chip.borrow();
        let name = match chip.mode() {
            Mode::Configuration => "configuration",
            Mode::ListenOnly => "listen-only",
            _ => "",
        };
        if name.is_empty() || !chip.has_frame_to_send() {
            self.stuck_since = None;
            return None;
        }
        let since = *self.stuck_since.get_or_insert(board.now());
        (board.now() - since >= MODE_SETTLED).then(|| {
            format!(
                "a frame waits to be sent, but the MCP2515 is in {name} mode: it sends in normal \
                 mode only (CANCTRL)"
            )
        })
    }
}

/// Why a frame was lost beside an empty RXB0: the program has left its filters as they are after
/// power-on.
pub fn unwritten_filters(chip: &Mcp2515, lost: &LoggedFrame) -> Option<String> {
    let is_left = lost.buffer == 1
        && !lost.other_is_full
        && FILTERS_OF_RXB0.into_iter().all(|register| !chip.is_written(register));
    is_left.then(|| {
        String::from(
            "the program has never written the filters of RXB0 (RXF0, RXF1), which have any value \
             after power-on: here they pass only extended frames, or none, so that all go to RXB1",
        )
    })
}

/// The pins that may be the chip select of a program.
#[derive(Debug, Default)]
struct Selects {
    pins: Vec<(Pin, Rc<Cell<PinUse>>)>,
}

impl Selects {
    /// Begins to count.
    fn attach(board: &mut Board) -> Selects {
        let cs = board.wiring().cs;
        let pins = SELECTS.iter().filter_map(|name| name.parse().ok()).filter(|pin| *pin != cs);
        Selects { pins: pins.map(|pin| (pin, board.watch_use(pin))).collect() }
    }

    /// The pin that the program drives as a chip select: it falls far more often than all others,
    /// once for each instruction on the SPI.
    fn driven(&self) -> Option<Pin> {
        let mut falls: Vec<_> =
            self.pins.iter().map(|(pin, used)| (used.get().falls, *pin)).collect();
        falls.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
        match falls.as_slice() {
            [(most, pin), (second, _), ..] if *most > 1 && *most >= 2 * second => Some(*pin),
            _ => None,
        }
    }
}

fn is_near(rate: u64, other: u64, per_mille: u64) -> bool {
    rate.abs_diff(other) * 1000 <= other * per_mille
}

/// `rate` in thousands, with one decimal unless it is 0: "500", "83.3".
fn kilo(rate: u64) -> String {
    if rate.is_multiple_of(1000) {
        format!("{}", rate / 1000)
    } else {
        format!("{:.1}", rate as f64 / 1000.0)
    }
}

/// What is added to a consequence of a stack that has run into variables.
pub fn after_overrun(avr: &Avr) -> &'static str {
    if avr.has_stack_overrun() { ", after its stack had run into variables" } else { "" }
}

/// Why the program cannot go on; `None` if it can.
pub fn crash(avr: &Avr) -> Option<String> {
    match avr.state() {
        State::Crashed(pc) => Some(format!(
            "the program counter left the flash that can be read, at {pc:#06x}{}",
            after_overrun(avr)
        )),
        State::Done => Some(String::from("asleep for ever, with interrupts off")),
        State::Running | State::Sleeping => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_driven_chip_select_is_the_pin_that_falls_most() {
        let driven = |falls: [(&str, u32); 3]| {
            let pins = falls.map(|(name, falls)| {
                let used = PinUse { falls, ..PinUse::default() };
                (name.parse().unwrap(), Rc::new(Cell::new(used)))
            });
            Selects { pins: pins.to_vec() }.driven().map(|pin| pin.to_string())
        };
        // A servo has 50 pulses a second.
        assert_eq!(driven([("D9", 25), ("D10", 900), ("D8", 0)]), Some("D10".to_owned()));
        assert_eq!(driven([("D9", 500), ("D10", 900), ("D8", 0)]), None);
        assert_eq!(driven([("D9", 1), ("D10", 0), ("D8", 0)]), None);
    }

    #[test]
    fn rates_within_the_tolerance_of_a_receiver_are_equal() {
        assert!(
            is_near(117_647, SERIAL_MONITOR_RATE, UART_TOLERANCE_PER_MILLE),
            "16 MHz / 8 / 17, as Arduinos have it"
        );
        assert!(!is_near(9_615, SERIAL_MONITOR_RATE, UART_TOLERANCE_PER_MILLE));
        assert!(is_near(9_615, 9_600, UART_TOLERANCE_PER_MILLE));
        assert!(!is_near(500_000, 1_000_000, CAN_TOLERANCE_PER_MILLE));
        assert_eq!((kilo(500_000), kilo(83_333)), (String::from("500"), String::from("83.3")));
    }
}
