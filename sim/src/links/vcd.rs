//! The signals of one board and of the bus as a VCD file (value change dump), for sigrok and
//! GTKWave.
//!
//! Each signal has one bit: CAN (0 is dominant), CS, SCK, MOSI, MISO, INT, TXD, RXD, SERVO, and
//! OUT2 to OUT8 for the further outputs of a board. Times are exact to the cycle of 62.5 ns; the
//! unit is 100 ps. One sample per cycle keeps all edges:
//!
//! ```text
//! sigrok-cli -i run.vcd -I vcd:downsample=625 -P can:can_rx=CAN:nominal_bitrate=1000000 -A can
//! ```
//!
//! The models transfer whole bytes on SPI and UART, so this link draws the bits of a byte from its
//! start and its bit time. The edges of CAN, CS, INT, SERVO and OUT2 to OUT8 are those of the
//! models.
//!
//! Limits: a byte on the SPI that a reset interrupts is not drawn. MISO floats while CS is high and
//! until the first bit, and keeps the last bit between bytes; the real chip shows its next bit
//! there. INT falls when the AVR samples it, one or two instructions after the bit on the bus. TXD
//! and RXD are high when idle, even if the pins are not.

mod writer;

use super::Link;
use anyhow::{Context, Result};
use bench::Bench;
use bench::avr::{SerialCharacter, SpiByte};
use bench::board::WireEvent;
use bench::can;
use bench::{Cycles, F_CPU_HZ};
use std::cell::RefCell;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use writer::{Level, NAMES, WIRES_OF_EVERY_BOARD, Writer};

pub use writer::Wire;

/// Longest time from the start of a byte on the SPI to its event, which comes at its end: 8 bits of
/// 128 cycles.
const SPI_LAG: Cycles = 8 * 128;
/// Simulated time between two writes to the file. A run that is killed loses at most this time.
const FLUSH_PERIOD: Cycles = F_CPU_HZ / 100;

/// A VCD file of one board and the bus.
pub struct Vcd {
    path: PathBuf,
    node: usize,
    writer: Writer<File>,
    /// Changes of the bus since the last call of `serve`.
    bus: Rc<RefCell<Vec<(Cycles, bool)>>>,
    drawn: Drawn,
    /// Simulated time up to which the events are collected.
    seen_to: Cycles,
    next_flush: Cycles,
    finished: bool,
}

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

impl Vcd {
    /// Creates the file, and attaches probes to the bus and to the board with number `node`. The
    /// bus has one tap only: of two VCD files, the later one gets the signal CAN. The file has
    /// `signals` only, or all of them if there is none.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn create(path: &Path, signals: &[Wire], bench: &mut Bench, node: usize) -> Result<Vcd> {
        let now = bench.now();
        let mut levels = [Level::High; NAMES.len()];
        levels[Wire::Sck as usize] = Level::Low;
        levels[Wire::Mosi as usize] = Level::Low;
        levels[Wire::Miso as usize] = Level::Floating;
        levels[Wire::Can as usize] = (!bench.bus().level().is_dominant()).into();
        for (_, event) in bench.board(node).attach_probe() {
            if let Some((wire, level)) = plain_level(event) {
                levels[wire as usize] = level.into();
            }
        }
        let bus = Rc::new(RefCell::new(Vec::new()));
        let tap = Rc::clone(&bus);
        bench.bus().set_wire_tap(Some(Box::new(move |at, level: can::Level| {
            tap.borrow_mut().push((at, !level.is_dominant()));
        })));
        let outputs = bench.board(node).wiring().outputs.len();
        let writer = File::create(path)
            .and_then(|file| Writer::new(file, now, &wires(signals, outputs), levels))
            .with_context(|| format!("--vcd: cannot write {}", path.display()))?;
        let drawn = Drawn { txd_to: now, rxd_to: now };
        let path = path.to_owned();
        Ok(Vcd { path, node, writer, bus, drawn, seen_to: now, next_flush: now, finished: false })
    }

    /// Writes the last changes and the time of the end, unless that was done or a write has failed
    /// before.
    fn write_end(&mut self) -> Result<()> {
        if std::mem::replace(&mut self.finished, true) {
            return Ok(());
        }
        self.writer
            .finish(self.seen_to)
            .with_context(|| format!("cannot write {}", self.path.display()))
    }

    fn collect(&mut self, bench: &mut Bench) {
        for (at, level) in self.bus.take() {
            self.writer.change(at, Wire::Can, level);
        }
        for (at, event) in bench.board(self.node).take_wire_events() {
            match event {
                WireEvent::Cs(high) => {
                    self.writer.change(at, Wire::Cs, high);
                    if high {
                        self.writer.change(at, Wire::Miso, Level::Floating);
                    }
                }
                WireEvent::Spi { byte, miso } => draw_spi(&mut self.writer, &byte, miso),
                WireEvent::Serial(character) => {
                    self.drawn.draw_serial(&mut self.writer, &character)
                }
                WireEvent::Int(_) | WireEvent::Servo(_) | WireEvent::Output { .. } => {
                    if let Some((wire, level)) = plain_level(event) {
                        self.writer.change(at, wire, level);
                    }
                }
            }
        }
        self.seen_to = bench.now();
    }
}

impl Link for Vcd {
    fn serve(&mut self, bench: &mut Bench) -> Result<()> {
        self.collect(bench);
        let is_flush_due = self.seen_to >= self.next_flush;
        if is_flush_due {
            self.next_flush = self.seen_to + FLUSH_PERIOD;
        }
        let safe = bench.bus().now().min(self.seen_to.saturating_sub(SPI_LAG));
        let written = self
            .writer
            .advance(safe)
            .and_then(|()| if is_flush_due { self.writer.flush() } else { Ok(()) });
        if written.is_err() {
            // Prevents a second write at the end, which would fail, too.
            self.finished = true;
        }
        written.with_context(|| format!("cannot write {}", self.path.display()))
    }

    fn finish(&mut self, bench: &mut Bench) -> Result<()> {
        self.collect(bench);
        self.write_end()
    }

    fn status(&self) -> String {
        format!("wires to {}, {:.1} MB", self.path.display(), self.writer.bytes() as f64 / 1e6)
    }
}

impl Drop for Vcd {
    fn drop(&mut self) {
        // A drop cannot report an error. sigrok and GTKWave can read a file without its end, too.
        let _ = self.write_end();
    }
}

/// The wires of the file: those of `signals` that the board has, or all of them. `outputs` is the
/// number of outputs besides the servo's.
fn wires(signals: &[Wire], outputs: usize) -> Vec<Wire> {
    let all = NAMES.iter().map(|(wire, _)| *wire).take(WIRES_OF_EVERY_BOARD + outputs);
    all.filter(|wire| signals.is_empty() || signals.contains(wire)).collect()
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
fn draw_spi<W: std::io::Write>(writer: &mut Writer<W>, byte: &SpiByte, miso: u8) {
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

/// Time up to which TXD and RXD are drawn. A character is drawn as a whole when it begins.
struct Drawn {
    txd_to: Cycles,
    rxd_to: Cycles,
}

impl Drawn {
    fn draw_serial<W: std::io::Write>(
        &mut self,
        writer: &mut Writer<W>,
        character: &SerialCharacter,
    ) {
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
        let mut writer =
            Writer::new(&mut out, 0, &wires(&[], 0), [Level::Floating; NAMES.len()]).unwrap();
        draw(&mut writer);
        writer.finish(1_000_000).unwrap();
        drop(writer);
        let text = String::from_utf8(out).unwrap();
        let code = text
            .lines()
            .find(|line| line.contains(&format!(" {wire} ")))
            .unwrap()
            .split(' ')
            .nth(3)
            .unwrap();
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
        let chosen = wires(&[Wire::Out3, Wire::Can], 1);
        assert_eq!(chosen, [Wire::Can], "the board has no third output");
        assert_eq!(wires(&[], 0).len(), WIRES_OF_EVERY_BOARD);
        let mut out = Vec::new();
        let levels = [Level::High; NAMES.len()];
        let mut writer = Writer::new(&mut out, 0, &[Wire::Cs], levels).unwrap();
        writer.change(5, Wire::Sck, true);
        writer.change(6, Wire::Cs, false);
        writer.finish(10).unwrap();
        drop(writer);
        let text = String::from_utf8(out).unwrap();
        assert!(text.contains(" CS ") && !text.contains(" SCK "), "{text}");
        assert_eq!(text.matches("#").count(), 3, "start, edge and end: {text}");
    }

    fn byte(mode: u8) -> SpiByte {
        SpiByte { mosi: 0b1010_0000, start: 100, end: 116, cycles_per_bit: 2, mode }
    }

    #[test]
    fn in_mode_0_data_changes_at_the_falling_edge_and_is_stable_at_the_rising_one() {
        let clock = drawn("SCK", |writer| draw_spi(writer, &byte(0), 0));
        let rising: Vec<_> =
            clock.iter().filter(|(_, level)| *level == '1').map(|(at, _)| *at).collect();
        assert_eq!(rising, [101, 103, 105, 107, 109, 111, 113, 115]);
        assert_eq!((clock[0], clock.last()), ((100, '0'), Some(&(116, '0'))));
        let data = drawn("MOSI", |writer| draw_spi(writer, &byte(0), 0));
        assert_eq!(data, [(100, '1'), (102, '0'), (104, '1'), (106, '0')]);
    }

    #[test]
    fn in_mode_3_the_clock_idles_high_and_data_changes_at_the_falling_edge() {
        let clock = drawn("SCK", |writer| draw_spi(writer, &byte(3), 0));
        let falling: Vec<_> =
            clock.iter().filter(|(_, level)| *level == '0').map(|(at, _)| *at).collect();
        assert_eq!(falling, [100, 102, 104, 106, 108, 110, 112, 114]);
        assert_eq!(clock.last(), Some(&(115, '1')));
        let data = drawn("MISO", |writer| draw_spi(writer, &byte(3), 0x01));
        assert_eq!(data, [(100, '0'), (114, '1')]);
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
    fn the_bits_of_a_character_are_one_bit_time_apart() {
        let mut serial = Drawn { txd_to: 0, rxd_to: 0 };
        let line = drawn("TXD", |writer| serial.draw_serial(writer, &CHARACTER));
        let expected = [(0, '0'), (1, '1'), (2, '0'), (7, '1'), (8, '0'), (9, '1')];
        assert_eq!(line, expected.map(|(bit, level)| (1000 + 136 * bit, level)));
    }

    #[test]
    fn a_reset_cuts_a_character_short() {
        let mut serial = Drawn { txd_to: 0, rxd_to: 0 };
        let line = drawn("TXD", |writer| {
            serial.draw_serial(writer, &CHARACTER);
            serial.draw_serial(
                writer,
                &SerialCharacter { start: 1300, levels: 0, bits: 0, ..CHARACTER },
            );
        });
        assert_eq!(line, [(1000, '0'), (1136, '1'), (1272, '0'), (1300, '1')]);
    }
}
