//! The writer of a VCD file, with the crate `vcd`: the changes in the order of their times.
//!
//! Callers add changes in any order. `advance` names a time before which no more changes come. The
//! writer sorts and writes the changes before that time, and keeps the others.

use crate::{Cycles, F_CPU_HZ};
use std::io::{self, Write};
use vcd::{IdCode, SimulationCommand, TimescaleUnit, Value};

/// Units of the time scale in a second: 100 ps, the coarsest power of ten that divides a cycle of
/// 62.5 ns.
const UNITS_PER_S: u64 = 10_000_000_000;
const UNITS_PER_CYCLE: u64 = UNITS_PER_S / F_CPU_HZ;
const _: () = assert!(UNITS_PER_S.is_multiple_of(F_CPU_HZ));
/// `advance` writes to the file when it has this many bytes. Always whole changes.
const WRITE_SIZE: usize = 64 * 1024;

/// Number of wires that every board has. The wires of outputs 2 to 8 come after them.
pub const WIRES_OF_EVERY_BOARD: usize = 9;

/// The wires, in the order of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    Can,
    Cs,
    Sck,
    Mosi,
    Miso,
    Int,
    Txd,
    Rxd,
    Servo,
    Out2,
    Out3,
    Out4,
    Out5,
    Out6,
    Out7,
    Out8,
    /// The pins of `--watch`.
    Pin1,
    Pin2,
    Pin3,
    Pin4,
    Pin5,
    Pin6,
    Pin7,
    Pin8,
}

/// The pins of `--watch`, in its order. In the file they have the names of the pins.
pub const PINS: [Wire; 8] = [
    Wire::Pin1,
    Wire::Pin2,
    Wire::Pin3,
    Wire::Pin4,
    Wire::Pin5,
    Wire::Pin6,
    Wire::Pin7,
    Wire::Pin8,
];

/// Number of wires.
pub const WIRES: usize = NAMES.len() + PINS.len();

/// The names of the wires in the file, without the pins.
pub const NAMES: [(Wire, &str); 16] = [
    (Wire::Can, "CAN"),
    (Wire::Cs, "CS"),
    (Wire::Sck, "SCK"),
    (Wire::Mosi, "MOSI"),
    (Wire::Miso, "MISO"),
    (Wire::Int, "INT"),
    (Wire::Txd, "TXD"),
    (Wire::Rxd, "RXD"),
    (Wire::Servo, "SERVO"),
    (Wire::Out2, "OUT2"),
    (Wire::Out3, "OUT3"),
    (Wire::Out4, "OUT4"),
    (Wire::Out5, "OUT5"),
    (Wire::Out6, "OUT6"),
    (Wire::Out7, "OUT7"),
    (Wire::Out8, "OUT8"),
];

/// Levels of all wires: V0, V1 or, not driven, Z.
pub type Levels = [Value; WIRES];

/// A writer of a VCD file.
pub struct Writer<W: Write> {
    out: W,
    /// What is not in the file yet.
    text: vcd::Writer<Vec<u8>>,
    bytes: u64,
    /// Changes that are not written yet. Of two changes of one wire at the same time the later in
    /// this list counts.
    pending: Vec<(Cycles, Wire, Value)>,
    /// The wires that are in the file, and their identifiers there.
    wires: Vec<(Wire, IdCode)>,
    levels: Levels,
    written_to: Cycles,
}

impl<W: Write> Writer<W> {
    /// Writes the header, and the levels at `start` of wires with their names.
    pub fn new(
        out: W,
        start: Cycles,
        named: &[(Wire, String)],
        levels: Levels,
    ) -> io::Result<Writer<W>> {
        let mut text = vcd::Writer::new(Vec::new());
        text.comment("Time 0 is power-on. One unit is 100 ps, one cycle of the AVR 625 units.")?;
        text.timescale(100, TimescaleUnit::PS)?;
        text.add_module("node")?;
        let mut wires = vec![];
        for (wire, name) in named {
            wires.push((*wire, text.add_wire(1, name)?));
        }
        text.upscope()?;
        text.enddefinitions()?;
        text.timestamp(start * UNITS_PER_CYCLE)?;
        text.begin(SimulationCommand::Dumpvars)?;
        for (wire, id) in &wires {
            text.change_scalar(*id, levels[*wire as usize])?;
        }
        text.end()?;
        let mut writer =
            Writer { out, text, bytes: 0, pending: vec![], wires, levels, written_to: start };
        writer.flush()?;
        Ok(writer)
    }

    /// Adds a change, if the wire is in the file.
    pub fn change(&mut self, at: Cycles, wire: Wire, level: impl Into<Value>) {
        if self.wires.iter().any(|(named, _)| *named == wire) {
            self.pending.push((at, wire, level.into()));
        }
    }

    /// Drops the changes of a wire from `at` on, which did not happen.
    pub fn cut(&mut self, at: Cycles, wire: Wire) {
        self.pending.retain(|&(time, other, _)| other != wire || time < at);
    }

    /// Writes the changes before `safe`. The caller must not add changes before `safe` any more.
    pub fn advance(&mut self, safe: Cycles) -> io::Result<()> {
        self.pending.sort_by_key(|&(at, _, _)| at);
        let count = self.pending.partition_point(|&(at, _, _)| at < safe);
        let due: Vec<_> = self.pending.drain(..count).collect();
        for moment in due.chunk_by(|a, b| a.0 == b.0) {
            self.write_moment(moment[0].0, moment)?;
        }
        if self.text.writer().len() >= WRITE_SIZE {
            self.flush()?;
        }
        Ok(())
    }

    fn write_moment(&mut self, at: Cycles, changes: &[(Cycles, Wire, Value)]) -> io::Result<()> {
        let before = self.levels;
        for &(_, wire, level) in changes {
            self.levels[wire as usize] = level;
        }
        if self.levels == before {
            return Ok(());
        }
        // Times in the file must not decrease, so a late change gets the time of the last one.
        debug_assert!(at >= self.written_to, "a change at {at} after {}", self.written_to);
        self.written_to = self.written_to.max(at);
        self.text.timestamp(self.written_to * UNITS_PER_CYCLE)?;
        for (wire, id) in &self.wires {
            let level = self.levels[*wire as usize];
            if level != before[*wire as usize] {
                self.text.change_scalar(*id, level)?;
            }
        }
        Ok(())
    }

    /// Writes the collected text to the file.
    pub fn flush(&mut self) -> io::Result<()> {
        let text = std::mem::take(self.text.writer());
        self.bytes += text.len() as u64;
        self.out.write_all(&text)?;
        self.out.flush()
    }

    /// Writes the changes until `end`, drops later ones, and writes the time `end`.
    pub fn finish(&mut self, end: Cycles) -> io::Result<()> {
        self.advance(end + 1)?;
        self.pending.clear();
        if end > self.written_to {
            self.written_to = end;
            self.text.timestamp(end * UNITS_PER_CYCLE)?;
        }
        self.flush()
    }

    /// The file.
    pub fn into_inner(self) -> W {
        self.out
    }

    /// Bytes written to the file.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDLE: Levels = [Value::V1; WIRES];

    /// The wires of a board with `outputs` outputs besides the servo's.
    fn wires(outputs: usize) -> Vec<(Wire, String)> {
        let names = NAMES.iter().take(WIRES_OF_EVERY_BOARD + outputs);
        names.map(|(wire, name)| (*wire, (*name).to_owned())).collect()
    }

    /// The file that `write` writes for a board with `outputs` outputs besides the servo's: its
    /// header, and the text after it.
    fn file(
        outputs: usize,
        write: impl FnOnce(&mut Writer<&mut Vec<u8>>) -> io::Result<()>,
    ) -> (String, String) {
        let mut out = Vec::new();
        let mut writer = Writer::new(&mut out, 16, &wires(outputs), IDLE).unwrap();
        write(&mut writer).unwrap();
        drop(writer);
        let text = String::from_utf8(out).unwrap();
        let (header, rest) = text.split_once("$dumpvars\n").unwrap();
        let (levels, body) = rest.split_once("$end\n").unwrap();
        (format!("{header}{levels}"), body.to_owned())
    }

    #[test]
    fn the_header_names_each_wire_and_its_first_level() {
        let (header, _) = file(0, |_| Ok(()));
        for part in [
            "$timescale 100 ps $end\n",
            "$var wire 1 ! CAN $end\n$var wire 1 \" CS $end\n",
            "#10000\n1!\n1\"\n",
            " SERVO $end\n$upscope",
        ] {
            assert!(header.contains(part), "{part}: {header}");
        }
        for (outputs, last) in [(1, "OUT2"), (7, "OUT8"), (9, "OUT8")] {
            let (header, _) = file(outputs, |_| Ok(()));
            assert!(header.contains(&format!(" {last} $end\n$upscope")), "{header}");
        }
    }

    #[test]
    fn changes_are_written_in_the_order_of_their_times_once_and_up_to_the_safe_time() {
        type Write = fn(&mut Writer<&mut Vec<u8>>) -> io::Result<()>;
        let cases: [(&str, Write, &str); 5] = [
            (
                "a change at the end is in the file and a later one is not",
                |writer| {
                    writer.change(100, Wire::Cs, false);
                    writer.change(101, Wire::Cs, true);
                    writer.finish(100)
                },
                "#62500\n0\"\n",
            ),
            (
                "the last output",
                |writer| {
                    writer.change(20, Wire::Out8, false);
                    writer.finish(30)
                },
                "#12500\n00\n#18750\n",
            ),
            (
                "in the order of the times up to the safe time",
                |writer| {
                    writer.change(30, Wire::Can, false);
                    writer.change(20, Wire::Cs, false);
                    writer.advance(25)?;
                    writer.change(28, Wire::Sck, false);
                    writer.advance(30)?;
                    writer.flush()
                },
                "#12500\n0\"\n#17500\n0#\n",
            ),
            (
                "at one time together, and an equal level not at all",
                |writer| {
                    writer.change(20, Wire::Miso, false);
                    writer.change(20, Wire::Can, false);
                    writer.change(20, Wire::Miso, Value::Z);
                    writer.change(30, Wire::Can, false);
                    writer.finish(40)
                },
                "#12500\n0!\nz%\n#25000\n",
            ),
            (
                "cut changes are not written",
                |writer| {
                    writer.change(20, Wire::Txd, false);
                    writer.change(40, Wire::Txd, true);
                    writer.change(50, Wire::Rxd, false);
                    writer.cut(30, Wire::Txd);
                    writer.finish(100)
                },
                "#12500\n0'\n#31250\n0(\n#62500\n",
            ),
        ];
        for (what, write, expected) in cases {
            assert_eq!(file(7, write).1, expected, "{what}");
        }
    }
}
