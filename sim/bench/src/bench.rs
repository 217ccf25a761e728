//! The bench: boards and other stations on one CAN bus, run in lock step.
//!
//! The bus says how far the AVRs may run before it must be stepped (one bit while something goes
//! on, more while it is idle); each board runs there, then the bus follows, then the boards see
//! what became of their INT pins. A board is never ahead of the bus by more than that, and
//! overshoots it by one instruction at most.

use crate::board::Board;
use crate::can::{Bus, PortId, StationRef};
use crate::{Cycles, F_CPU_HZ};

/// Boards and other stations on one bus.
pub struct Bench {
    boards: Vec<Board>,
    ports: Vec<PortId>,
    bus: Bus,
    now: Cycles,
}

impl Bench {
    /// An empty bus at that many bits per second.
    pub fn new(bit_rate: u32) -> Bench {
        Bench { boards: Vec::new(), ports: Vec::new(), bus: Bus::new(bit_rate), now: 0 }
    }

    /// Puts a board on the bus. Returns its number.
    pub fn add_board(&mut self, board: Board, name: &str) -> usize {
        self.ports.push(self.bus.attach(name, board.chip()));
        self.boards.push(board);
        self.boards.len() - 1
    }

    /// Puts another station on the bus.
    pub fn attach(&mut self, name: &str, station: StationRef) -> PortId {
        self.bus.attach(name, station)
    }

    /// Pulls a station's plug, for good.
    pub fn detach(&mut self, port: PortId) {
        self.bus.connect(port, false);
    }

    /// A board, by its number.
    pub fn board(&mut self, index: usize) -> &mut Board {
        &mut self.boards[index]
    }

    /// All boards.
    pub fn boards(&mut self) -> &mut [Board] {
        &mut self.boards
    }

    /// Where a board is connected to the bus.
    pub fn port(&self, index: usize) -> PortId {
        self.ports[index]
    }

    /// The bus, for faults, records and statistics.
    pub fn bus(&mut self) -> &mut Bus {
        &mut self.bus
    }

    /// The bench's time.
    pub fn now(&self) -> Cycles {
        self.now
    }

    /// Whether a debugger has halted a board: then nothing moves.
    pub fn is_halted(&self) -> bool {
        self.boards.iter().any(|board| board.avr().is_halted())
    }

    /// Runs everything until `t`, or until a debugger halts a board.
    pub fn run_until(&mut self, t: Cycles) {
        while self.now < t && !self.is_halted() {
            self.step(t);
        }
    }

    /// Runs until `condition` holds; false if it does not within `timeout` cycles.
    pub fn run_until_or(&mut self, mut condition: impl FnMut(&mut Bench) -> bool, timeout: Cycles) -> bool {
        let end = self.now + timeout;
        loop {
            if condition(self) {
                return true;
            }
            if self.now >= end || self.is_halted() {
                return false;
            }
            self.step(end);
        }
    }

    /// Runs for that many microseconds.
    pub fn run_for_us(&mut self, microseconds: u64) {
        self.run_until(self.now + microseconds * F_CPU_HZ / 1_000_000);
    }

    /// Runs for that many milliseconds.
    pub fn run_for_ms(&mut self, milliseconds: u64) {
        self.run_until(self.now + milliseconds * F_CPU_HZ / 1000);
    }

    fn step(&mut self, end: Cycles) {
        let horizon = self.bus.horizon().clamp(self.now + 1, end.max(self.now + 1));
        for board in &mut self.boards {
            board.run_until(horizon);
        }
        // The others wait, where they are, until the halted board has come to the horizon too.
        if self.is_halted() {
            return;
        }
        self.bus.run_until(horizon);
        for board in &self.boards {
            board.update_int();
        }
        self.now = horizon;
    }
}
