//! The table of bit timing in docs/wiring.md, against two controllers with clocks of their own.
//!
//! [`Line`] steps each controller by its time quanta, with synchronisation as in DS20001801J 5.4,
//! and delays each level by the cable and the transceivers. A frame is the work of `can-model`'s
//! engine. `can-model`'s own bus has no quanta: there all stations are in step.

use std::collections::VecDeque;

use bench::Noise;
use bench::can::{Engine, EngineMode, Event, Frame, Level};
use mcp2515_ordered::BitTiming;

const FS_PER_S: u64 = 1_000_000_000_000_000;
const FS_PER_NS: u64 = 1_000_000;
/// From TXD to RXD of a TJA1050 or an MCP2551 at most.
const LOOP_NS: u64 = 255;
const CABLE_NS_PER_M: u64 = 5;
/// Payloads whose falling edges are up to ten bits apart, with all phases, and others.
const PATTERNS: [u8; 12] = [0x0F, 0x87, 0xC3, 0xE1, 0xF0, 0x78, 0x3C, 0x1E, 0x00, 0xFF, 0x55, 0x10];

/// A controller at one end of the bus.
struct Controller {
    engine: Engine,
    /// Quanta before the sample point, without the synchronisation segment, and after it.
    before: u32,
    after: u32,
    quantum_fs: u64,
    /// Start of the next quantum, and its number in the bit.
    next_fs: u64,
    quantum: u32,
    /// Quanta by which this bit is longer before, and shorter after its sample point.
    longer: u32,
    shorter: u32,
    last_seen: Level,
    last_sampled: Level,
    drives: Level,
    /// The last changes of the level that it drives.
    changes: VecDeque<(u64, Level)>,
    pending: Option<Frame>,
    received: usize,
    errors: usize,
}

const JUMP_WIDTH: u32 = 1;

impl Controller {
    /// A controller whose crystal deviates by `ppm`.
    fn new(f_osc_hz: u32, timing: BitTiming, ppm: i64) -> Controller {
        assert_eq!(timing.cnf1() >> 6, 0, "a jump width of one quantum");
        let width = |bits: u8| u32::from(bits & 7) + 1;
        let divisor = 2 * (u64::from(timing.cnf1()) + 1);
        let hz = u64::from(f_osc_hz);
        let mut engine = Engine::new();
        engine.set_mode(EngineMode::Normal);
        Controller {
            engine,
            before: width(timing.cnf2()) + width(timing.cnf2() >> 3),
            after: width(timing.cnf3()),
            quantum_fs: divisor * FS_PER_S / hz * 1_000_000 / 1_000_000_u64.strict_add_signed(ppm),
            next_fs: 0,
            quantum: 0,
            longer: 0,
            shorter: 0,
            last_seen: Level::Recessive,
            last_sampled: Level::Recessive,
            drives: Level::Recessive,
            changes: VecDeque::from([(0, Level::Recessive)]),
            pending: None,
            received: 0,
            errors: 0,
        }
    }

    /// The level that it drove at a time.
    fn drove_at(&self, fs: u64) -> Level {
        let change = self.changes.iter().rev().find(|(at, _)| *at <= fs);
        change.map_or(Level::Recessive, |(_, level)| *level)
    }

    fn step(&mut self, seen: Level) {
        let is_edge = self.last_seen == Level::Recessive && seen == Level::Dominant;
        self.last_seen = seen;
        if is_edge && self.synchronises() {
            // The edge lies in the synchronisation segment, which ends now.
            self.begin_bit();
            self.quantum = 1;
        } else if self.quantum == 0 {
            self.begin_bit();
        }
        if self.quantum == 1 + self.before + self.longer {
            self.last_sampled = seen;
            for event in self.engine.sample(seen) {
                match event {
                    Event::Received(_) => self.received += 1,
                    Event::Transmitted(_) => self.pending = None,
                    Event::Error { .. } => self.errors += 1,
                    _ => {}
                }
            }
        }
        self.next_fs += self.quantum_fs;
        self.quantum += 1;
        if self.quantum >= self.quanta() {
            self.quantum = 0;
        }
    }

    /// Quanta of this bit.
    fn quanta(&self) -> u32 {
        1 + self.before + self.longer + self.after - self.shorter
    }

    fn begin_bit(&mut self) {
        (self.quantum, self.longer, self.shorter) = (0, 0, 0);
        let level = self.engine.drive(self.pending.as_ref());
        if level != self.drives {
            self.drives = level;
            self.changes.push_back((self.next_fs, level));
            if self.changes.len() > 16 {
                self.changes.pop_front();
            }
        }
    }

    /// Handles a falling edge in the quantum that ends now. True if the bit begins with that
    /// quantum: on an idle bus, or if the edge is early by no more than the jump width. One that is
    /// late makes the bit longer, unless the controller itself drives dominant; one that is earlier
    /// makes it shorter. Only after a recessive bit, and once in a bit.
    fn synchronises(&mut self) -> bool {
        if self.engine.is_idle() {
            return true;
        }
        let is_possible = self.longer + self.shorter == 0 && self.last_sampled == Level::Recessive;
        // Quanta from the synchronisation segment to the edge; at the end of the last bit it is
        // early by one.
        match self.quantum {
            _ if !is_possible => false,
            0 => true,
            quantum if quantum <= 1 + self.before => {
                if self.drives == Level::Recessive {
                    self.longer = (quantum - 1).min(JUMP_WIDTH);
                }
                false
            }
            quantum if self.quanta() - (quantum - 1) <= JUMP_WIDTH => true,
            _ => {
                self.shorter = JUMP_WIDTH;
                false
            }
        }
    }
}

/// A bus with a controller at each end.
struct Line {
    ends: [Controller; 2],
    cable_fs: u64,
}

impl Line {
    /// A bus of a length, whose ends deviate by plus and minus `ppm`.
    fn new(f_osc_hz: u32, bit_rate: u32, metres: u64, ppm: i64) -> Line {
        let timing = BitTiming::new(f_osc_hz, bit_rate);
        let ends = [ppm, -ppm].map(|ppm| Controller::new(f_osc_hz, timing, ppm));
        Line { ends, cable_fs: metres * CABLE_NS_PER_M * FS_PER_NS }
    }

    /// Errors of both ends in a number of frames, for which both arbitrate.
    fn errors_in(mut self, frames: usize) -> usize {
        let mut noise = Noise::new(7);
        // What is lost for good ends the run, too.
        let mut steps = frames * 4_000 * self.ends[0].before as usize;
        while self.ends.iter().map(|end| end.received).sum::<usize>() < frames && steps > 0 {
            steps -= 1;
            let at = usize::from(self.ends[1].next_fs < self.ends[0].next_fs);
            let now = self.ends[at].next_fs;
            for end in &mut self.ends {
                end.pending.get_or_insert_with(|| {
                    let pattern = PATTERNS[noise.below(PATTERNS.len() as u64) as usize];
                    let id = noise.below(1 << 29) as u32;
                    Frame::extended(id, &[pattern; 8])
                });
            }
            let own = self.ends[at].drove_at(now.saturating_sub(LOOP_NS * FS_PER_NS));
            let away = (LOOP_NS * FS_PER_NS + self.cable_fs).min(now);
            let other = self.ends[1 - at].drove_at(now - away);
            self.ends[at].step(own & other);
            if self.ends[at].errors > 0 {
                break;
            }
        }
        let silent = usize::from(steps == 0);
        self.ends.iter().map(|end| end.errors).sum::<usize>() + silent
    }
}

/// A row of the table: crystal and rate in hertz, parts per million, and metres.
fn rows() -> Vec<[u32; 4]> {
    let page = std::fs::read_to_string(bench::root().join("docs/wiring.md")).expect("the page");
    let rows = page.lines().filter_map(|line| {
        let cells: Vec<&str> = line.strip_prefix('|')?.split('|').map(str::trim).collect();
        let number = |cell: usize, unit: &str| {
            let text = cells.get(cell)?.strip_suffix(unit)?.trim_start_matches('±').trim();
            text.parse::<f64>().ok()
        };
        let [mhz, kbit] = [number(0, " MHz")?, number(1, " kbit/s")?];
        let [percent, metres] = [number(4, " %")?, number(5, " m")?];
        Some([mhz * 1e6, kbit * 1e3, percent * 1e4, metres].map(|value| value.round() as u32))
    });
    rows.collect()
}

const FRAMES: usize = 300;
/// The deviation of the clocks in the column of the lengths.
const DEVIATION_PPM: i64 = 1_000;

#[test]
fn clocks_may_deviate_as_far_as_the_table_says_and_errors_begin_beyond() {
    assert_eq!(rows().len(), 7);
    for [f_osc_hz, bit_rate, ppm, _] in rows() {
        let errors = |ppm: u32| Line::new(f_osc_hz, bit_rate, 1, ppm.into()).errors_in(FRAMES);
        assert_eq!(errors(ppm), 0, "{f_osc_hz} Hz, {bit_rate} bit/s, {ppm} ppm");
        let first = (1..).map(|step| ppm + 50 * step).find(|ppm| errors(*ppm) > 0).unwrap();
        assert!(first <= ppm * 11 / 10, "{f_osc_hz} Hz, {bit_rate} bit/s: {first} ppm");
    }
}

#[test]
fn a_bus_may_be_as_long_as_the_table_says_and_errors_begin_beyond() {
    for [f_osc_hz, bit_rate, _, metres] in rows() {
        let errors = |metres: u32| {
            Line::new(f_osc_hz, bit_rate, metres.into(), DEVIATION_PPM).errors_in(FRAMES)
        };
        assert_eq!(errors(metres), 0, "{f_osc_hz} Hz, {bit_rate} bit/s, {metres} m");
        let first = (1..).map(|step| metres + step).find(|metres| errors(*metres) > 0).unwrap();
        assert!(first <= metres * 103 / 100 + 3, "{f_osc_hz} Hz, {bit_rate} bit/s: {first} m");
    }
}
