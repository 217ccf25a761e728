//! Tests of the engine and the bus by topic, and the two benches that they use: [`Lab`],
//! engines on a wire without a clock, and [`Rig`], soft nodes on a [`Bus`]. `script` runs tables of
//! tests on both.

mod arbitration;
mod bus;
mod confinement;
mod errors;
mod faults;
mod mixed_rates;
mod random;
mod script;
mod signalling;

use super::*;
use sim_base::Cycles;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

/// Bits from the end of the stuffed part to the last end-of-frame bit: CRC delimiter, ACK
/// slot, ACK delimiter, 7 EOF.
const TAIL: usize = 10;
const ACTIVE_FLAG: u64 = 6;
const DELIMITER: u64 = 8;
const INTERMISSION: u64 = 3;

/// Numbers of the bits in the fixed part of a frame.
struct Bits {
    crc_delimiter: u64,
    ack_slot: u64,
    last_eof: u64,
}

fn bits_of(frame: &Frame) -> Bits {
    let len = frame.wire_bits().len();
    Bits {
        crc_delimiter: (len - TAIL) as u64,
        ack_slot: (len - TAIL + 1) as u64,
        last_eof: (len - 1) as u64,
    }
}

/// Engines on one wire, and a log of their events. Bit numbers count from the lab's start.
struct Lab {
    engines: Vec<Engine>,
    pending: Vec<VecDeque<Frame>>,
    /// Levels that an engine (`None`: all) receives instead of the real one, by bit.
    disturbed: Vec<(u64, Option<usize>, Level)>,
    bit: u64,
    /// Level that each engine drove in each bit.
    driven: Vec<Vec<Level>>,
    events: Vec<(u64, usize, Event)>,
}

impl Lab {
    /// Engines in normal mode that have integrated: the next bit can be a SOF.
    fn of(count: usize) -> Lab {
        let mut lab = Lab::cold(count);
        lab.run(11);
        lab
    }

    /// Engines in normal mode that have not received a bit yet.
    fn cold(count: usize) -> Lab {
        let mut engine = Engine::new();
        engine.set_mode(EngineMode::Normal);
        Lab {
            engines: vec![engine; count],
            pending: vec![VecDeque::new(); count],
            disturbed: Vec::new(),
            bit: 0,
            driven: vec![Vec::new(); count],
            events: Vec::new(),
        }
    }

    fn send(&mut self, node: usize, frame: Frame) {
        self.pending[node].push_back(frame);
    }

    /// In the bit that comes after `bit` more bits, `node` (`None`: all) receives `level`.
    fn disturb(&mut self, bit: u64, node: impl Into<Option<usize>>, level: Level) {
        self.disturbed.push((self.bit + bit, node.into(), level));
    }

    fn run(&mut self, bits: u64) {
        for _ in 0..bits {
            self.step();
        }
    }

    /// Runs until no engine has anything to do.
    #[track_caller]
    fn settle(&mut self) {
        for _ in 0..100_000 {
            let idle = self.engines.iter().all(Engine::is_idle);
            if idle && self.pending.iter().all(VecDeque::is_empty) {
                return;
            }
            self.step();
        }
        panic!("the bus does not come to rest");
    }

    fn step(&mut self) {
        let mut level = Level::Recessive;
        for (node, engine) in self.engines.iter_mut().enumerate() {
            let driven = engine.drive(self.pending[node].front());
            self.driven[node].push(driven);
            level &= driven;
        }
        for node in 0..self.engines.len() {
            let disturbance = self.disturbed.iter().find(|&&(bit, victim, _)| {
                bit == self.bit && victim.is_none_or(|victim| victim == node)
            });
            let seen = disturbance.map_or(level, |&(_, _, level)| level);
            for event in self.engines[node].sample(seen) {
                if let Event::Transmitted(_) = event {
                    self.pending[node].pop_front();
                }
                self.events.push((self.bit, node, event));
            }
        }
        self.bit += 1;
    }

    fn events_of(&self, node: usize) -> Vec<Event> {
        let of_node = self.events.iter().filter(|&&(_, other, _)| other == node);
        of_node.map(|&(_, _, event)| event).collect()
    }

    fn errors_of(&self, node: usize) -> Vec<ErrorKind> {
        let error = |event| match event {
            Event::Error { kind, .. } => Some(kind),
            _ => None,
        };
        self.events_of(node).into_iter().filter_map(error).collect()
    }

    /// Bits at which the node had an event that satisfies `is`.
    fn bits_where(&self, node: usize, is: impl Fn(Event) -> bool) -> Vec<u64> {
        let events = self.events.iter();
        let hits = events.filter(|&&(_, other, event)| other == node && is(event));
        hits.map(|&(bit, _, _)| bit).collect()
    }

    fn received(&self, node: usize) -> Vec<Frame> {
        let frame = |event| match event {
            Event::Received(frame) => Some(frame),
            _ => None,
        };
        self.events_of(node).into_iter().filter_map(frame).collect()
    }

    /// True if the node drove this level in all of the bits.
    fn drove(&self, node: usize, level: Level, bits: std::ops::Range<u64>) -> bool {
        let range = bits.start as usize..bits.end as usize;
        self.driven[node][range].iter().all(|driven| *driven == level)
    }

    fn counters(&self, node: usize) -> (u16, u16) {
        (self.engines[node].tec(), self.engines[node].rec())
    }

    /// Raises an engine's receive error counter to at least `rec` with levels that only it
    /// receives.
    #[track_caller]
    fn raise_rec(&mut self, node: usize, rec: u16) {
        while self.engines[node].rec() < rec {
            // A dominant bit on the idle bus, then recessive ones: a stuff error for this node. The
            // others must not receive its flag.
            let was = self.engines[node].rec();
            let mut victim = self.engines[node].clone();
            victim.drive(None);
            victim.sample(Level::Dominant);
            while !victim.is_idle() {
                let level = victim.drive(None);
                victim.sample(level);
            }
            assert!(victim.rec() > was);
            self.engines[node] = victim;
        }
    }
}

/// Soft nodes on a bus of 1 Mbit/s.
struct Rig {
    bus: Bus,
    nodes: Vec<Rc<RefCell<SoftNode>>>,
    ports: Vec<PortId>,
}

/// A bit at 1 Mbit/s.
const BIT: Cycles = 16;

impl Rig {
    /// `count` nodes that have integrated.
    fn of(count: usize) -> Rig {
        Rig::with_rates(&vec![1_000_000; count])
    }

    /// Nodes at these rates on a bus of 1 Mbit/s.
    fn with_rates(rates: &[u32]) -> Rig {
        let mut rig = Rig { bus: Bus::new(1_000_000), nodes: Vec::new(), ports: Vec::new() };
        for (at, &rate) in rates.iter().enumerate() {
            let node = Rc::new(RefCell::new(SoftNode::new(rate)));
            rig.ports.push(rig.bus.attach(&format!("node {at}"), node.clone()));
            rig.nodes.push(node);
        }
        rig.run_bits(100);
        rig
    }

    fn send(&self, node: usize, frame: Frame) {
        self.nodes[node].borrow_mut().send(frame);
    }

    fn run_bits(&mut self, bits: u64) {
        let until = self.bus.now() + bits * BIT;
        self.bus.run_until(until);
    }

    fn received(&self, node: usize) -> Vec<Frame> {
        let received = self.nodes[node].borrow_mut().take_received();
        received.into_iter().map(|(_, frame)| frame).collect()
    }

    fn events(&self, node: usize) -> Vec<Event> {
        let events = self.nodes[node].borrow_mut().take_events();
        events.into_iter().map(|(_, event)| event).collect()
    }

    fn counters(&self, node: usize) -> (u16, u16) {
        (self.nodes[node].borrow().tec(), self.nodes[node].borrow().rec())
    }

    /// The frames among the records, with their sender's number and whether they were acknowledged.
    fn recorded_frames(&mut self) -> Vec<(Frame, Option<usize>, bool)> {
        let frame = |record: Record| match record.kind {
            RecordKind::Frame { frame, from, acked } => {
                Some((frame, from.map(PortId::index), acked))
            }
            RecordKind::ErrorFrame { .. } => None,
        };
        self.bus.take_records().into_iter().filter_map(frame).collect()
    }
}

/// A soft node whose driven levels are recorded, and whose rate a test can change. The bus steps
/// each bit for it.
struct Watched {
    node: SoftNode,
    drove_dominant: bool,
    bit_time_ps: u64,
}

impl Watched {
    fn new(node: SoftNode) -> Watched {
        let bit_time_ps = node.bit_time_ps().expect("a soft node is on the bus");
        Watched { node, drove_dominant: false, bit_time_ps }
    }
}

impl Station for Watched {
    fn drive(&mut self, at: Cycles) -> Level {
        let level = self.node.drive(at);
        self.drove_dominant |= level.is_dominant();
        level
    }
    fn sample(&mut self, level: Level, at: Cycles) {
        self.node.sample(level, at);
    }
    fn quiet(&self, at: Cycles) -> bool {
        self.node.quiet(at)
    }
    fn transmitting(&self) -> bool {
        self.node.transmitting()
    }
    fn bit_time_ps(&self) -> Option<u64> {
        Some(self.bit_time_ps)
    }
    fn skip_idle(&mut self, bits: u64) {
        self.node.skip_idle(bits);
    }
}

fn frame(text: &str) -> Frame {
    text.parse().expect("a frame in candump's form")
}
