//! A bus full of valid transfers whose values change with every frame, for each program that ships.
//! Every frame that the controller loses is a lost frame.
//!
//! [`setup`] has the programs with their outputs, [`source`] makes the transfers, [`follow`] finds
//! the commands in the pulses, and [`fill`] explains why the firmware's queue becomes full. A
//! [`Flood`] runs them together and returns an [`Outcome`].
//!
//! [`load`](super::load) has the other loads: frames that the node reads and rejects, requests, and
//! values that it can compute in advance.

pub mod fill;
pub mod follow;
pub mod setup;
pub mod source;
pub mod values;

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use bench::can::{Fault, Id, OnWire, SoftNode};
use bench::dronecan::Message;
use bench::{Cycles, F_CPU_HZ, Noise};

pub use fill::Fills;
pub use follow::{Pulses, Register};
pub use setup::{Escs, Preset, Setup};
pub use source::{Sent, Source, Traffic};
pub use values::Unit;

use super::load::{BusyClient, Client, Meter, compare_register};
use super::manage::SAVE_TIMEOUT_MS;
use super::queue::Queue;
use super::status::{FRAMES_LOST, TRANSFER_ERRORS};
use super::{DRAFT_STATUS_OF_NODE, MS, NODE, Rig, STATUS_OF_NODE, TRANSFER_ID_OF_DRAFT, US};

/// Frames that wait in the sender's queue, so that a full bus never becomes idle.
const QUEUED: usize = 24;
/// Time between two looks at the firmware's queue and the compare register. The handler that stores
/// a frame in the queue takes longer.
const LOOK: Cycles = 4 * US;
/// Time after the flood in which the node follows the last command.
const AFTER_MS: u64 = 45;

/// The distance between frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Back to back.
    Full,
    /// With random gaps, so that the frames take this share of the time in percent.
    Percent(u64),
    /// Commands at this rate a second, as an autopilot sends them. Other transfers are in between.
    Hz(u64),
    /// Bursts of 1 to 40 frames between silences of up to 10 ms.
    Bursts,
}

/// A flood.
#[derive(Clone, Copy, Debug)]
pub struct Scenario {
    pub setup: Setup,
    pub traffic: Traffic,
    /// Number of senders, 1 or 2.
    pub senders: usize,
    /// Priority in v0: 0 wins every arbitration against the node, 31 loses every one.
    pub priority: u8,
    pub pace: Pace,
    /// Bits on the bus that are inverted, in a million.
    pub noise_per_million: u32,
    /// Also measures the service of each frame, which takes half as long again.
    pub measures_service: bool,
    /// Also finds the turns in which the queue becomes full, which takes several times as long.
    pub explains: bool,
    pub seed: u64,
}

impl Scenario {
    /// Back to back from one sender, at a priority below the node's.
    pub const fn full(setup: Setup, traffic: Traffic) -> Scenario {
        Scenario {
            setup,
            traffic,
            senders: 1,
            priority: 31,
            pace: Pace::Full,
            noise_per_million: 0,
            measures_service: false,
            explains: false,
            seed: 1,
        }
    }
}

/// What a flood did to the node.
#[derive(Default)]
pub struct Outcome {
    /// Frames that the controller received or lost, with those of the client.
    pub meter: Meter,
    /// Of the first output, if it is the only one.
    pub register: Register,
    /// Of each output, if several are in use.
    pub pulses: Vec<Pulses>,
    /// Number of commands on the bus, one for each entry for an output.
    pub commands: u64,
    /// Most frames in the firmware's queue, and its number of places.
    pub deepest: u8,
    pub places: u8,
    /// True if the node's status says that it lost frames or transfers. `None` if it was not asked.
    pub reports_loss: Option<bool>,
    /// The turns in which the queue became full, if the scenario asks for them.
    pub fills: Vec<String>,
    /// Number of frames and of NodeStatus that the node sent.
    pub own_frames: u64,
    pub own_statuses: u64,
    /// Number of characters of the serial monitor.
    pub characters: u64,
    /// Number of answers that the client received.
    pub answers: u64,
    /// Width of the first output's last pulse, in cycles.
    pub last_width: Option<u64>,
    /// Number of pulses of the first output, and of those with another period than the first.
    pub periods: u64,
    pub jitter: u64,
    /// Share of the time that the bus was busy, in percent.
    pub busy_percent: f64,
}

impl Outcome {
    /// Number of frames that reached the controller.
    pub fn frames(&self) -> u64 {
        self.meter.frames + self.meter.lost
    }

    /// Longest time from the end of a received command until the output had its value or a newer
    /// one, in cycles.
    pub fn longest_to_follow(&self) -> u32 {
        let pulses = self.pulses.iter().map(|pulses| pulses.stale.max());
        pulses.chain([self.register.settled.max()]).max().unwrap_or(0)
    }
}

/// A flood at work.
pub struct Flood {
    pub rig: Rig,
    pub outcome: Outcome,
    scenario: Scenario,
    source: Source,
    station: Rc<RefCell<SoftNode>>,
    /// Frames that the bus has not carried yet, the oldest first.
    sent: VecDeque<Sent>,
    /// Earliest beginning of the next frame or burst, if the bus is not to be full.
    next_at: Cycles,
    gaps: Noise,
    client: BusyClient,
    queue: Queue,
    fills: Option<Fills>,
    register: u16,
    period: Option<u64>,
    ms: u64,
}

impl Flood {
    /// A running node, and the flood that begins now.
    #[track_caller]
    pub fn new(scenario: Scenario) -> Flood {
        Flood::with_rig(scenario, scenario.setup.running())
    }

    /// Like [`Flood::new`] with a running node of the scenario's setup.
    #[track_caller]
    pub fn with_rig(scenario: Scenario, mut rig: Rig) -> Flood {
        rig.overflows_expected = true;
        let Scenario { setup, traffic, senders, priority, seed, noise_per_million, .. } = scenario;
        let noise = Fault::BitErrorRate { per_million: noise_per_million, seed };
        rig.bench.bus().inject(noise);
        let station = Rc::new(RefCell::new(SoftNode::new(rig.bench.bus().bit_rate())));
        rig.bench.attach("flood", station.clone());
        let queue = Queue::of(rig.board().avr());
        let meter = match scenario.measures_service {
            true => Meter::attach(rig.board()),
            false => Meter::attach_to_log(rig.board()),
        };
        let client = if setup.is_v0() { Client::Saving } else { Client::None };
        let several = if setup.outputs() > 1 { setup.outputs() } else { 0 };
        Flood {
            outcome: Outcome {
                meter,
                pulses: (0..several).map(|_| Pulses::of(setup.escs)).collect(),
                places: queue.places,
                ..Outcome::default()
            },
            source: Source::new(setup, traffic, senders, priority, seed),
            station,
            sent: VecDeque::new(),
            next_at: rig.now(),
            gaps: Noise::new(seed),
            client: BusyClient::new(client, rig.now()),
            queue,
            fills: scenario.explains.then(|| Fills::begin(setup, rig.board())),
            register: compare_register(rig.board()),
            period: None,
            ms: 0,
            scenario,
            rig,
        }
    }

    /// Runs for so many milliseconds of simulated time.
    pub fn run_ms(&mut self, ms: u64) {
        let before = self.rig.bench.bus().stats().clone();
        for _ in 0..ms {
            self.feed();
            self.millisecond();
        }
        self.outcome.busy_percent = 100.0 * self.rig.bench.bus().stats().load_since(&before);
    }

    /// Ends the flood with the last transfer that has been queued, lets the node follow the last
    /// command, and returns the outcome.
    pub fn finish(mut self) -> Outcome {
        self.client.stop();
        for _ in 0..AFTER_MS {
            self.millisecond();
        }
        self.outcome.answers = self.client.answers;
        if self.scenario.setup.is_v0() {
            let code = self.vendor_code();
            self.outcome.reports_loss =
                code.map(|code| code & (FRAMES_LOST | TRANSFER_ERRORS) != 0);
        }
        self.outcome.fills = self.fills.take().map_or(Vec::new(), |fills| fills.found);
        self.outcome
    }

    /// The vendor-specific status code in an answer to GetNodeInfo. `None` without an answer.
    fn vendor_code(&mut self) -> Option<u16> {
        let asked = self.rig.request(&Message::NodeInfoRequest);
        let end = self.rig.now() + SAVE_TIMEOUT_MS * MS;
        while self.rig.now() < end {
            self.rig.run_ms(5);
            for (_, number, answer) in self.rig.answers() {
                if let Message::NodeInfo(info) = answer
                    && number == asked
                {
                    return Some(info.status.vendor_code);
                }
            }
        }
        None
    }

    /// Queues the frames of the next milliseconds.
    fn feed(&mut self) {
        self.station.borrow_mut().take_received();
        self.station.borrow_mut().take_events();
        let now = self.rig.now();
        self.next_at = self.next_at.max(now);
        match self.scenario.pace {
            Pace::Full => {
                while self.station.borrow().queued() < QUEUED {
                    self.send(|_| 0);
                }
            }
            Pace::Percent(percent) => {
                let bit = F_CPU_HZ / u64::from(self.rig.bench.bus().bit_rate());
                while self.next_at < now + 2 * MS {
                    self.send(|flood| {
                        let frame = u64::from(flood.sent.back().expect("a frame").0.bit_count());
                        // The gap that is due on average, and up to twice as much.
                        let gap = 2 * frame * bit * (100 - percent) / percent;
                        frame * bit + flood.gaps.below(gap + 1)
                    });
                }
            }
            Pace::Hz(rate) => {
                while self.next_at < now + 2 * MS {
                    let at = self.next_at;
                    self.send(|_| 0);
                    let is_command = self.sent.back().is_some_and(|sent| !sent.1.is_empty());
                    self.next_at = if is_command { at + F_CPU_HZ / rate } else { at };
                }
            }
            Pace::Bursts if now >= self.next_at && self.station.borrow().queued() == 0 => {
                let frames = 1 + self.gaps.below(40) as usize;
                while self.station.borrow().queued() < frames {
                    self.send(|_| 0);
                }
                // A frame lasts 160 us at most.
                let burst = frames as Cycles * 160 * US;
                self.next_at = now + burst + self.gaps.below(10 * MS);
            }
            Pace::Bursts => {}
        }
    }

    /// Queues the frames of the next transfer, each `after` the one before it.
    fn send(&mut self, mut after: impl FnMut(&mut Flood) -> Cycles) {
        for sent in self.source.next(self.rig.now()) {
            self.station.borrow_mut().send_at(self.next_at, sent.0);
            self.sent.push_back(sent);
            self.next_at += after(self);
        }
    }

    fn millisecond(&mut self) {
        self.ms += 1;
        self.client.millisecond(&mut self.rig);
        if !self.scenario.setup.is_v0() {
            // The thesis's node has no parameters: its other work is the button and the monitor.
            self.rig.board().press_button(self.ms % 100 < 50);
            if self.ms.is_multiple_of(250) {
                self.rig.board().avr_mut().serial_send(b"?");
            }
        }
        let writes = self.run_and_watch();
        self.record_frames();
        self.outcome.meter.collect(self.rig.board());
        for at in self.outcome.meter.lost_at.drain(..) {
            self.outcome.register.lost(at);
            for pulses in &mut self.outcome.pulses {
                pulses.lost(at);
            }
        }
        if self.outcome.pulses.is_empty() {
            for (at, register) in writes {
                // The timer counts from 0 to the value.
                self.outcome.register.written(at, i32::from(register) + 1);
            }
        }
        self.record_pulses();
        self.outcome.characters += self.rig.serial.len() as u64;
        self.rig.serial.clear();
        self.rig.broken.clear();
        self.rig.drafts.clear();
        if self.client.client() == Client::None {
            self.rig.transfers.clear();
        }
    }

    /// Runs for a millisecond. Returns the writes to the compare register.
    fn run_and_watch(&mut self) -> Vec<(Cycles, u16)> {
        let mut writes = Vec::new();
        let Flood { rig, register, queue, fills, outcome, .. } = self;
        let end = rig.now() + MS;
        // What explains a full queue follows its turns.
        let period = if fills.is_some() { US } else { LOOK };
        while rig.now() < end {
            let look = |bench: &mut bench::Bench| {
                let depth = queue.depth(bench.board(0).avr());
                outcome.deepest = outcome.deepest.max(depth);
                if let Some(fills) = fills {
                    fills.look(depth == queue.places);
                }
                let now = compare_register(bench.board(0));
                if std::mem::replace(register, now) != now {
                    writes.push((bench.now(), now));
                }
                false
            };
            rig.bench.run_until_or(look, period);
        }
        // The bench reports a frame one cycle after its end.
        rig.run_until(end + 1);
        writes
    }

    fn record_frames(&mut self) {
        for (ended, frame) in self.rig.traffic.drain(..) {
            let Id::Extended(id) = frame.id else { continue };
            let status = if self.scenario.setup.is_v0() {
                self.outcome.own_frames += u64::from(id & 0xFF == NODE);
                id == STATUS_OF_NODE
            } else {
                self.outcome.own_frames += u64::from(id >> 10 & 0x7F == NODE);
                id & !TRANSFER_ID_OF_DRAFT == DRAFT_STATUS_OF_NODE
            };
            self.outcome.own_statuses += u64::from(status);
            // In noise one before it may be missing on the bus, although its sender has sent it.
            let Some(at) = self.sent.iter().position(|sent| sent.0 == frame) else { continue };
            let (_, commands) = self.sent.drain(..=at).next_back().expect("the frame");
            self.outcome.commands += commands.iter().filter(|one| !one.is_stop).count() as u64;
            for command in commands {
                match self.outcome.pulses.get_mut(command.output) {
                    Some(pulses) => pulses.command(ended, command),
                    None => self.outcome.register.command(ended, command),
                }
            }
        }
    }

    fn record_pulses(&mut self) {
        let further = match self.outcome.pulses.len() {
            0 => Vec::new(),
            _ => self.rig.board().take_output_pulses(),
        };
        let first = std::mem::take(&mut self.rig.pulses);
        let width = first.last().map(|pulse| pulse.width_cycles);
        self.outcome.last_width = width.or(self.outcome.last_width);
        for period in first.iter().filter_map(|pulse| pulse.period_cycles) {
            self.outcome.periods += 1;
            self.outcome.jitter += u64::from(*self.period.get_or_insert(period) != period);
        }
        let all = [first].into_iter().chain(further);
        for (pulses, followed) in all.zip(&mut self.outcome.pulses) {
            for pulse in &pulses {
                followed.pulse(pulse);
            }
        }
    }
}

/// Runs a flood for `ms` milliseconds of simulated time.
pub fn run(scenario: Scenario, ms: u64) -> Outcome {
    let mut flood = Flood::new(scenario);
    flood.run_ms(ms);
    flood.finish()
}
