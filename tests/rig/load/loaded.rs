//! The node under a load.

use std::collections::{BTreeMap, VecDeque};

use bench::Cycles;
use bench::avr::Oc;
use bench::board::Board;
use bench::can::{Frame, Id};

use super::super::queue::Queue;
use super::super::{ARRAY_COMMAND, MS, NODE, Rig, SERVO_COMMAND, STATUS_OF_NODE, US};
use super::meter::CANINTF;
use super::sender::BELOW_PRIORITY;
use super::{BusyClient, Client, Load, Meter, SENDER, Samples, Sender};

/// Addresses of the low bytes of OCR1A and OCR1B.
const OCR1AL: u16 = 0x88;
const OCR1BL: u16 = 0x8A;
/// RX0IF and RX1IF in CANINTF.
const RX_FLAGS: u8 = 0b11;
/// Parameters with which the node publishes everything at the highest rate.
const BUSY: [(&str, i64); 3] =
    // Without the failsafe, which restarts the controller: it then receives nothing for 5 ms.
    [("TELEM_RATE", 50), ("TEMP_RATE", 50), ("OUT1_TIMEOUT", 0)];

/// The measurements of a node under a load.
#[derive(Default)]
pub struct Figures {
    pub meter: Meter,
    /// True if a frame is still in the controller 20 ms after the load's end.
    pub stuck: bool,
    /// Most frames in the firmware's queue, and its number of places.
    pub deepest: u8,
    pub places: u8,
    /// Number of answers that the client received.
    pub answers: u64,
    /// Number of frames that the node sent; number of NodeStatus among them.
    pub own_frames: u64,
    pub own_statuses: u64,
    /// Cycles from the end of a command's last frame to the write to the compare register. The
    /// next pulse has that width.
    pub command_to_servo: Samples,
    /// Number of writes to the compare register of values that no command had requested.
    pub unasked_moves: u64,
    /// Periods and widths of the servo's pulses in cycles, each with the number of times it
    /// occurred.
    pub periods: BTreeMap<u64, u64>,
    pub widths: BTreeMap<u64, u64>,
}

/// The node under a load, with all functions in use.
pub struct Loaded {
    pub rig: Rig,
    pub figures: Figures,
    sender: Option<Sender>,
    client: BusyClient,
    ocr: u16,
    queue: Queue,
    /// Commands on the bus: end of the last frame, and the width in microseconds.
    commands: VecDeque<(Cycles, f32)>,
}

impl Loaded {
    /// A running node with the parameters of [`BUSY`], and then the load.
    pub fn new(load: Option<Load>, client: Client) -> Loaded {
        Loaded::with(Rig::running(), load, client)
    }

    /// Like [`Loaded::new`] with this running rig.
    pub fn with_rig(rig: Rig, load: Option<Load>, client: Client) -> Loaded {
        Loaded::with(rig, load, client)
    }

    fn with(mut rig: Rig, load: Option<Load>, client: Client) -> Loaded {
        rig.overflows_expected = true;
        rig.set_all(&BUSY);
        rig.send_command(1, 4, 1500.0);
        rig.run_ms(100);
        // An autopilot.
        for _ in 0..2 {
            rig.send_status_from(1);
            rig.run_ms(10);
        }
        rig.forget();
        let sender = load.map(|load| Sender::attach(&mut rig.bench, load));
        let queue = Queue::of(rig.board().avr());
        let figures = Figures {
            meter: Meter::attach(rig.board()),
            places: queue.places,
            ..Figures::default()
        };
        let ocr = compare_register(rig.board());
        Loaded {
            client: BusyClient::new(client, rig.now()),
            rig,
            figures,
            sender,
            ocr,
            queue,
            commands: VecDeque::new(),
        }
    }

    pub fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms {
            if let Some(sender) = &mut self.sender {
                sender.feed(self.rig.now());
            }
            self.client.millisecond(&mut self.rig);
            self.millisecond();
        }
    }

    /// Ends the load and checks what remains in the controller.
    pub fn finish(mut self) -> Figures {
        if let Some(sender) = &mut self.sender {
            sender.stop();
        }
        self.client.stop();
        self.run_ms(20);
        let chip = self.rig.board().chip();
        self.figures.answers = self.client.answers;
        self.figures.stuck = chip.borrow().register(CANINTF) & RX_FLAGS != 0;
        self.figures
    }

    fn millisecond(&mut self) {
        let mut writes: Vec<(Cycles, u16)> = Vec::new();
        let Loaded { ocr, queue, figures, .. } = self;
        // After each step of the bench, which can be long while the bus is idle.
        let end = self.rig.now() + MS;
        while self.rig.now() < end && !self.rig.bench.is_halted() {
            self.rig.bench.run_until_or(
                |bench| {
                    figures.deepest = figures.deepest.max(queue.depth(bench.board(0).avr()));
                    let now = compare_register(bench.board(0));
                    if now != *ocr {
                        *ocr = now;
                        writes.push((bench.now(), now));
                    }
                    false
                },
                US,
            );
        }
        let end = self.rig.now() + 1;
        self.rig.run_until(end);
        let figures = &mut self.figures;
        for (at, frame) in self.rig.traffic.drain(..) {
            let Id::Extended(id) = frame.id else { continue };
            figures.own_frames += u64::from(id & 0xFF == NODE);
            figures.own_statuses += u64::from(id == STATUS_OF_NODE);
            let sender = self.sender.as_mut().filter(|_| is_last_of_command(id, &frame));
            self.commands.extend(
                sender.and_then(|sender| sender.widths.pop_front()).map(|width| (at, width)),
            );
        }
        for (at, written) in writes {
            // A timer count is half a microsecond; rounding adds as much.
            let is_of =
                |command: &(Cycles, f32)| (command.1 * 2.0 - f32::from(written)).abs() <= 2.0;
            match self.commands.iter().position(is_of) {
                Some(found) => {
                    let (ended_at, _) =
                        self.commands.drain(..=found).next_back().expect("a command");
                    figures.command_to_servo.push(at.saturating_sub(ended_at));
                }
                None => figures.unasked_moves += 1,
            }
        }
        for pulse in self.rig.pulses.drain(..) {
            *figures.widths.entry(pulse.width_cycles).or_default() += 1;
            if let Some(period) = pulse.period_cycles {
                *figures.periods.entry(period).or_default() += 1;
            }
        }
        figures.meter.collect(self.rig.bench.board(0));
        self.rig.serial.clear();
        self.rig.broken.clear();
        if self.client.client() == Client::None {
            self.rig.transfers.clear();
        }
    }
}

/// Value of the servo timer's compare register: OCR1A for D9, OCR1B for D10.
pub fn compare_register(board: &Board) -> u16 {
    let low = if board.wiring().servo.timer1_output() == Some(Oc::A) { OCR1AL } else { OCR1BL };
    u16::from_le_bytes([board.avr().sram(low), board.avr().sram(low + 1)])
}

/// True if the frame ends a valid command.
fn is_last_of_command(id: u32, frame: &Frame) -> bool {
    let below = id & BELOW_PRIORITY;
    let ends = frame.data().last().is_some_and(|tail| tail & 0x40 != 0);
    let single = frame.data().last().is_some_and(|tail| tail & 0x80 != 0);
    below == (ARRAY_COMMAND | SENDER) & BELOW_PRIORITY
        && ends
        && (!single || frame.data().len() == 5)
        || below == (SERVO_COMMAND | SENDER) & BELOW_PRIORITY
}
