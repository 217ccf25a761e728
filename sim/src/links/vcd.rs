//! The signals of one board and of the bus as a VCD file (value change dump), for sigrok and
//! GTKWave.
//!
//! Each signal has one bit: CAN (0 is dominant), CS, SCK, MOSI, MISO, INT, TXD, RXD, SERVO, and
//! OUT2 to OUT8 for the further outputs of a board, and the pins of `--watch`. Times are exact to
//! the cycle of 62.5 ns; the unit is 100 ps. One sample per cycle keeps all edges:
//!
//! ```text
//! sigrok-cli -i run.vcd -I vcd:downsample=625 -P can:can_rx=CAN:nominal_bitrate=1000000 -A can
//! ```
//!
//! [`bench::vcd`] says what is drawn, and its limits.

mod save_file;

use super::Link;
use anyhow::{Context, Result, ensure};
use bench::Bench;
use bench::can;
use bench::vcd::{Drawn, PINS, SPI_LAG, Writer, levels, wires};
use bench::wiring::Pin;
use bench::{Cycles, F_CPU_HZ};
use std::cell::RefCell;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::rc::Rc;

pub use bench::vcd::{Wire, signal};

/// Simulated time between two writes to the file. A run that is killed loses at most this time.
const FLUSH_PERIOD: Cycles = F_CPU_HZ / 100;

/// A VCD file of one board and the bus.
pub struct Vcd {
    path: PathBuf,
    node: usize,
    writer: Writer<File>,
    /// Changes of the bus since the last call of `serve`.
    bus: Rc<RefCell<Vec<(Cycles, bool)>>>,
    /// Changes of the watched pins since then.
    pins: Rc<RefCell<Vec<(Cycles, Wire, bool)>>>,
    drawn: Drawn,
    /// Simulated time up to which the events are collected.
    seen_to: Cycles,
    next_flush: Cycles,
    finished: bool,
}

impl Vcd {
    /// Creates the file, and attaches probes to the bus and to the board with number `node`. The
    /// bus has one tap only: of two VCD files, the later one gets the signal CAN. The file has
    /// `signals` only, or all of them if there is none, and the levels of `pins`. A save file for
    /// GTKWave is written beside it.
    ///
    /// # Errors
    /// If a file cannot be written, or if there are more than eight pins.
    pub fn create(
        path: &Path,
        signals: &[Wire],
        pins: &[Pin],
        bench: &mut Bench,
        node: usize,
    ) -> Result<Vcd> {
        ensure!(pins.len() <= PINS.len(), "--vcd records up to {} pins of --watch", PINS.len());
        let now = bench.now();
        let probe = bench.board(node).attach_probe();
        let mut levels = levels(bench.bus().level(), &probe);
        let bus = Rc::new(RefCell::new(Vec::new()));
        let tap = Rc::clone(&bus);
        bench.bus().set_wire_tap(Some(Box::new(move |at, level: can::Level| {
            tap.borrow_mut().push((at, !level.is_dominant()));
        })));
        let changes = Rc::new(RefCell::new(Vec::new()));
        for (wire, pin) in PINS.into_iter().zip(pins) {
            let board = bench.board(node);
            levels[wire as usize] = board.pin(*pin).into();
            let changes = Rc::clone(&changes);
            board.avr_mut().watch_pin(
                pin.port(),
                pin.bit(),
                Box::new(move |level, at| changes.borrow_mut().push((at, wire, level))),
            );
        }
        let outputs = bench.board(node).wiring().outputs.len();
        let named = wires(signals, outputs, pins);
        let writer = File::create(path)
            .and_then(|file| {
                save_file::write(path, named.iter().map(|(_, name)| &**name))?;
                Writer::new(file, now, &named, levels)
            })
            .with_context(|| format!("--vcd: cannot write {}", path.display()))?;
        let drawn = Drawn::new(now);
        let path = path.to_owned();
        Ok(Vcd {
            path,
            node,
            writer,
            bus,
            pins: changes,
            drawn,
            seen_to: now,
            next_flush: now,
            finished: false,
        })
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
        for (at, wire, level) in self.pins.take() {
            self.writer.change(at, wire, level);
        }
        for (at, event) in bench.board(self.node).take_wire_events() {
            self.drawn.draw(&mut self.writer, at, event);
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
