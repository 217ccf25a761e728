//! The bench: boards and other stations on one CAN bus, run in lock step.
//!
//! The bus names the time up to which the AVRs may run: one bit ahead in the bits of a frame in
//! which something can happen, further in the others and while it is idle. Each board runs to that
//! time, then the bus does, then the boards update their INT pins. A board can overshoot that time
//! by one instruction.

use crate::board::Board;
use crate::can::{Bus, PortId, Record, RecordKind, StationRef};
use crate::{Cycles, F_CPU_HZ};

/// Boards and other stations on one bus.
pub struct Bench {
    boards: Vec<Board>,
    ports: Vec<PortId>,
    bus: Bus,
    now: Cycles,
}

impl Bench {
    /// An empty bus with `bit_rate` bits per second.
    pub fn new(bit_rate: u32) -> Bench {
        Bench { boards: Vec::new(), ports: Vec::new(), bus: Bus::new(bit_rate), now: 0 }
    }

    /// Connects a board to the bus. Returns the board's number.
    pub fn add_board(&mut self, board: Board, name: &str) -> usize {
        self.ports.push(self.bus.attach(name, board.chip()));
        self.boards.push(board);
        self.boards.len() - 1
    }

    /// Connects another station to the bus.
    pub fn attach(&mut self, name: &str, station: StationRef) -> PortId {
        self.bus.attach(name, station)
    }

    /// Disconnects a station for good.
    pub fn detach(&mut self, port: PortId) {
        self.bus.connect(port, false);
    }

    /// The board with number `index`.
    pub fn board(&mut self, index: usize) -> &mut Board {
        &mut self.boards[index]
    }

    /// All boards.
    pub fn boards(&mut self) -> &mut [Board] {
        &mut self.boards
    }

    /// The port of the bus to which the board with number `index` is connected.
    pub fn port(&self, index: usize) -> PortId {
        self.ports[index]
    }

    /// The bus, for faults, records and statistics.
    pub fn bus(&mut self) -> &mut Bus {
        &mut self.bus
    }

    /// Removes and returns the records of the bus since the last call, each with the port and the
    /// name of its sender, if known.
    pub fn take_records(&mut self) -> Vec<(Record, Option<(PortId, String)>)> {
        let named = |bus: &Bus, record: Record| {
            let (RecordKind::Frame { from, .. } | RecordKind::ErrorFrame { from, .. }) =
                record.kind;
            (record, from.map(|port| (port, bus.name(port).to_owned())))
        };
        let records = self.bus.take_records().into_iter();
        records.map(|record| named(&self.bus, record)).collect()
    }

    /// Simulated time since power-on.
    pub fn now(&self) -> Cycles {
        self.now
    }

    /// True if a debugger has halted a board. Simulated time stops then.
    pub fn is_halted(&self) -> bool {
        self.boards.iter().any(|board| board.avr().is_halted())
    }

    /// Runs all boards and the bus until `t`, or until a debugger halts a board.
    pub fn run_until(&mut self, t: Cycles) {
        while self.now < t && !self.is_halted() {
            self.step(t);
        }
    }

    /// Runs until `condition` holds, and returns true. It is asked each time the bus has been
    /// stepped, so up to a frame after it became true. Returns false after `timeout` cycles, or if
    /// a debugger halts a board.
    pub fn run_until_or(
        &mut self,
        mut condition: impl FnMut(&mut Bench) -> bool,
        timeout: Cycles,
    ) -> bool {
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

    /// Runs for a number of milliseconds.
    pub fn run_for_ms(&mut self, milliseconds: u64) {
        self.run_until(self.now + milliseconds * F_CPU_HZ / 1000);
    }

    fn step(&mut self, end: Cycles) {
        let horizon = self.bus.horizon().clamp(self.now + 1, end.max(self.now + 1));
        for board in &mut self.boards {
            board.run_until(horizon);
        }
        // The bus and the other boards stay at their times until the halted board reaches the
        // horizon, too.
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
