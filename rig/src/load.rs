//! The rig under load: a sender that fills the bus, a client that keeps the node busy, and a meter
//! of what a received frame costs. The meter uses the wires of the board and the log of its CAN
//! controller.

use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::f32::consts::FRAC_PI_4;
use std::rc::Rc;
use std::sync::Mutex;

use bench::Bench;
use bench::Cycles;
use bench::Noise;
use bench::avr::Oc;
use bench::board::{Board, WireEvent};
use bench::can::{Frame, Id, SoftNode};
use bench::dronecan::{
    DataType, Message, Opcode, ParameterRequest, TransferId, Value, split, types,
};
use bench::mcp2515::Fate;

use super::{ARRAY_COMMAND, MS, NODE, NODE_STATUS, Rig, SERVO_COMMAND, US, array_command};

/// uavcan.equipment.esc.RawCommand.
const RAW_COMMAND: u32 = 0x0704_0600;
const RAW_COMMAND_SIGNATURE: u64 = 0x217F_5C87_D7EC_951D;
/// Node ID of the sender that fills the bus.
pub const SENDER: u32 = 10;
/// Frames that wait in the sender's queue, so that the bus never becomes idle.
const QUEUE: usize = 24;
/// Mask of an identifier's bits below the priority.
const BELOW_PRIORITY: u32 = 0x00FF_FFFF;
/// A message type that the node does not accept.
const FOREIGN: u32 = 0x1804_5600;
/// Identifier that RXF0 of `third-party/job.rs` accepts; the frame rolls over to RXB1.
const THIRD_PARTY: u32 = 0x1234_5600;
/// LightsCommand.
const LIGHTS_COMMAND: u32 = 0x1804_3900;
/// Addresses of the low bytes of OCR1A and OCR1B.
const OCR1AL: u16 = 0x88;
const OCR1BL: u16 = 0x8A;
/// ArmingStatus.
const ARMING_STATUS: u32 = 0x1804_4C00;
/// A vendor-specific message, type 20210, with the low byte of ArrayCommand's type.
const LOOK_ALIKE: u32 = 0x184E_F200;
/// Anonymous request for a node ID: type 1. With this discriminator its identifier equals that of a
/// NodeStatus of node 0.
const ANONYMOUS: u32 = 0x1801_5500;
/// Parameters with which the node publishes everything at the highest rate.
const BUSY: [(&str, i64); 3] =
    // Without the failsafe, which restarts the controller: it then receives nothing for 5 ms.
    [("TELEM_RATE", 50), ("TEMP_RATE", 50), ("OUT1_TIMEOUT", 0)];
/// Time after which a client gives up an answer.
const CLIENT_TIMEOUT_MS: u64 = 300;
/// Address of CANINTF; [`RX_FLAGS`] are its RX0IF and RX1IF.
const CANINTF: u8 = 0x2C;
const RX_FLAGS: u8 = 0b11;

/// True if the node may lose some frames of a bus full of `kind` at 1 Mbit/s. It accepts both
/// dialects and assembles two transfers at a time, so a command of the thesis takes longer than its
/// frame lasts (docs/decisions.md).
pub fn may_lose_commands(kind: Kind) -> bool {
    super::takes_both_dialects()
        && super::board().fastest_bit_rate() == 1_000_000
        && kind == Kind::Thesis
}

/// The frames of a load. RXB0 and RXB1 are the buffers whose filters accept them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// ArrayCommand in one frame of so many bytes; 5 of them are a valid command. RXB0, and RXB1
    /// when RXB0 is full.
    Command(usize),
    /// ArrayCommand of one position, 5 bytes. The node needs a division for it.
    Position,
    /// ArrayCommands of 15 commands, nine frames each.
    LongCommand,
    /// esc.RawCommands for eight motors, three frames each. RXB1.
    RawCommand,
    /// First frames of ArrayCommands that never continue.
    Beginning,
    /// NodeStatus in a frame of so many bytes; 8 of them are a valid status. RXB1 only.
    Status(usize),
    /// The thesis's command, 2 bytes. RXB1.
    Thesis,
    /// ArmingStatus, 2 bytes. RXB1.
    Arming,
    /// GetNodeInfo request. RXB0.
    Request,
    /// GetSet request for a parameter by index, 3 bytes.
    ParameterRequest,
    /// GetSet request for a parameter by name, three frames.
    LongRequest,
    /// ExecuteOpcode request to save the parameters, 8 bytes.
    OpcodeRequest,
    /// RestartNode request with a wrong magic number, 6 bytes.
    RestartRequest,
    /// BeginFirmwareUpdate request, four frames.
    UpdateRequest,
    /// Frame of so many bytes of another message whose type has the low byte of ArrayCommand's.
    /// RXB0 and RXB1.
    LookAlike(usize),
    /// Request of so many bytes for a service that the node does not have. RXB0 and RXB1.
    UnknownRequest(usize),
    /// Anonymous request for a node ID whose identifier looks like a NodeStatus. RXB1.
    Anonymous,
    /// Command from a sender with the node's own ID.
    OwnId,
    /// Random kinds except positions. Transfers of several frames are sent whole.
    Mixed,
    /// Message of 8 bytes for other nodes.
    Foreign,
    /// Frame of so many bytes that the firmwares of `third-party/` accept.
    ThirdParty(usize),
}

impl Kind {
    /// All kinds that the node's filters let through (`src/node/acceptance.rs`): those that the
    /// node uses, and those that it rejects after reading them. The latter are other messages
    /// whose type has the low byte of ArrayCommand's, requests for services that the node does not
    /// have, messages of the node's types from an anonymous sender or from its own ID, and
    /// frames of wrong lengths.
    ///
    /// [`Position`](Self::Position) has its own tests.
    pub const MATCHING: [Kind; 28] = [
        Kind::Command(0),
        Kind::Command(1),
        Kind::Command(2),
        Kind::Command(5),
        Kind::Command(7),
        Kind::Command(8),
        Kind::LongCommand,
        Kind::Beginning,
        Kind::Status(0),
        Kind::Status(1),
        Kind::Status(2),
        Kind::Status(7),
        Kind::Status(8),
        Kind::Thesis,
        Kind::Arming,
        Kind::Request,
        Kind::ParameterRequest,
        Kind::LongRequest,
        Kind::OpcodeRequest,
        Kind::RestartRequest,
        Kind::UpdateRequest,
        Kind::LookAlike(1),
        Kind::LookAlike(2),
        Kind::LookAlike(8),
        Kind::UnknownRequest(1),
        Kind::Anonymous,
        Kind::OwnId,
        Kind::Mixed,
    ];

    /// True if the frames are requests that the node answers.
    pub fn is_request(self) -> bool {
        matches!(
            self,
            Kind::Request
                | Kind::ParameterRequest
                | Kind::LongRequest
                | Kind::OpcodeRequest
                | Kind::RestartRequest
                | Kind::UpdateRequest
        )
    }

    /// True if the frames pass the filters but the node has no use for them.
    pub fn is_rejected_by_program(self) -> bool {
        matches!(self, Kind::LookAlike(_) | Kind::UnknownRequest(_) | Kind::Anonymous | Kind::OwnId)
    }

    /// True if some of the frames move the servo.
    pub fn moves_servo(self) -> bool {
        matches!(
            self,
            Kind::Command(5) | Kind::Position | Kind::LongCommand | Kind::Thesis | Kind::Mixed
        )
    }
}

/// Frames that fill the bus.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    pub kind: Kind,
    /// Priority: 0 wins every arbitration against the node, 31 loses every one.
    pub priority: u8,
    pub pace: Pace,
}

/// The distance between frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Back to back.
    Full,
    /// Bursts of 1 to 40 frames between silences of up to 10 ms.
    Bursts,
    /// One frame in so many cycles.
    Every(Cycles),
}

/// Runs the node under each load for so many milliseconds, with a client that
/// [saves](Client::Saving). Uses one thread per core, starts with the last load, and returns the
/// results in the order of `loads`. Calls `seen` after each load.
pub fn run_all(
    loads: &[(Load, u64)],
    seen: impl Fn(Load, u64, &Figures) + Sync,
) -> Vec<(Load, u64, Figures)> {
    let left = Mutex::new((0..loads.len()).collect::<Vec<_>>());
    let runs = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(|| {
                while let Some(n) = { left.lock().unwrap().pop() } {
                    let (load, ms) = loads[n];
                    let figures = run(load, ms);
                    seen(load, ms, &figures);
                    runs.lock().unwrap().push((n, (load, ms, figures)));
                }
            });
        }
    });
    let mut runs = runs.into_inner().unwrap();
    runs.sort_by_key(|(n, _)| *n);
    runs.into_iter().map(|(_, run)| run).collect()
}

/// Runs the node under one load for `ms` milliseconds.
pub fn run(load: Load, ms: u64) -> Figures {
    let mut loaded = Loaded::new(Some(load), Client::Saving);
    loaded.run_ms(ms);
    loaded.finish()
}

/// The node that sends a [`Load`].
pub struct Sender {
    load: Load,
    /// The kind of the last frame of a mixture.
    mixed: Kind,
    station: Rc<RefCell<SoftNode>>,
    count: u32,
    transfer_id: u8,
    /// Frames of the current transfer that remain to be sent.
    rest: VecDeque<Vec<u8>>,
    silent_until: Cycles,
    random: Noise,
    /// Pulse widths in microseconds of the queued commands.
    widths: VecDeque<f32>,
}

/// The frames of an ArrayCommand of 15 commands: nine.
pub fn long_command((command_type, value): (u8, f32), transfer_id: u8) -> Vec<Vec<u8>> {
    let commands: Vec<_> = (1..=15).map(|actuator| (actuator, command_type, value)).collect();
    array_command(&commands, transfer_id)
}

/// Pulse width of the nth valid command, in microseconds.
fn pulse_us(n: u32) -> f32 {
    (1000 + n * 37 % 1001) as f32
}

/// Type and value of the nth valid command. The three types alternate, also if only each ninth
/// frame begins a command.
fn command(n: u32) -> (u8, f32) {
    match (n + n / 9) % 3 {
        0 => (4, pulse_us(n)),
        1 => (0, deflection(n)),
        _ => position(n),
    }
}

fn deflection(n: u32) -> f32 {
    (pulse_us(n) - 1500.0) / 500.0
}

/// Like [`command`] as a position in radians. OUT1_RANGE is 90 degrees.
fn position(n: u32) -> (u8, f32) {
    (1, deflection(n) * FRAC_PI_4)
}

/// The identifier of a request from node 127 to the node.
fn request_id(service: u32) -> u32 {
    0x1E00_80FF | service << 16 | NODE << 8
}

impl Sender {
    pub fn attach(bench: &mut Bench, load: Load) -> Sender {
        let station = Rc::new(RefCell::new(SoftNode::new(bench.bus().bit_rate())));
        bench.attach("load", station.clone());
        Sender {
            load,
            mixed: Kind::Mixed,
            station,
            count: 0,
            transfer_id: 0,
            rest: VecDeque::new(),
            silent_until: 0,
            random: Noise::new(1),
            widths: VecDeque::new(),
        }
    }

    fn next_transfer_id(&mut self) -> u8 {
        self.transfer_id = (self.transfer_id + 1) % 32;
        self.transfer_id
    }

    /// Data of a single frame of `len` bytes: `start`, a counter, and the tail byte.
    fn padded(&mut self, start: &[u8], len: usize) -> Vec<u8> {
        let mut data = start.to_vec();
        data.resize(7, self.count as u8);
        data.truncate(len.saturating_sub(1));
        let tail = 0xC0 | self.next_transfer_id();
        data.extend((len > 0).then_some(tail));
        data
    }

    /// The next frame of the load.
    pub fn frame(&mut self) -> Frame {
        self.count += 1;
        let kind = match self.load.kind {
            Kind::Mixed if !self.rest.is_empty() => self.mixed,
            Kind::Mixed => {
                self.mixed =
                    Kind::MATCHING[self.random.below(Kind::MATCHING.len() as u64 - 1) as usize];
                self.mixed
            }
            kind => kind,
        };
        let (command_type, value) =
            if kind == Kind::Position { position(self.count) } else { command(self.count) };
        let [low, high] = half::f16::from_f32(value).to_le_bytes();
        match kind {
            Kind::Command(5) | Kind::Position => self.widths.push_back(pulse_us(self.count)),
            Kind::LongCommand if self.rest.is_empty() => {
                self.widths.push_back(pulse_us(self.count))
            }
            // Commands cover the whole travel.
            Kind::Thesis => {
                self.widths.push_back(1000.0 + f32::from(self.count as u8) * 1000.0 / 255.0)
            }
            _ => {}
        }
        let (id, data) = match kind {
            Kind::Command(len) => {
                (ARRAY_COMMAND | SENDER, self.padded(&[1, command_type, low, high], len))
            }
            Kind::Position => {
                (ARRAY_COMMAND | SENDER, self.padded(&[1, command_type, low, high], 5))
            }
            Kind::Status(len) => (NODE_STATUS | SENDER, self.padded(&[10, 0, 0, 0, 0, 0, 0], len)),
            Kind::Thesis => (SERVO_COMMAND | SENDER, self.padded(&[self.count as u8], 2)),
            // Armed.
            Kind::Arming => (ARMING_STATUS | SENDER, self.padded(&[255], 2)),
            Kind::Request => (request_id(1), self.padded(&[], 1)),
            Kind::ParameterRequest => (request_id(11), self.padded(&[0, 0], 3)),
            Kind::OpcodeRequest => (request_id(10), self.padded(&[0; 7], 8)),
            Kind::RestartRequest => (request_id(5), self.padded(&[1, 2, 3, 4, 5], 6)),
            Kind::LongRequest => {
                let request = ParameterRequest {
                    name: "OUT1_REVERSED".into(),
                    ..ParameterRequest::default()
                };
                (request_id(11), self.next_of(&types::GET_SET, &request.encode()))
            }
            Kind::UpdateRequest => {
                // From node 127.
                let update = [&[127], &b"firmware/servo-node.bin"[..]].concat();
                (request_id(40), self.next_of(&types::BEGIN_FIRMWARE_UPDATE, &update))
            }
            Kind::LookAlike(len) => (LOOK_ALIKE | SENDER, self.padded(&[], len)),
            Kind::UnknownRequest(len) => (request_id(45), self.padded(&[], len)),
            Kind::Anonymous => (ANONYMOUS, self.padded(&[0; 7], 8)),
            Kind::OwnId => (ARRAY_COMMAND | NODE, self.padded(&[1, command_type, low, high], 5)),
            Kind::Mixed => unreachable!("it is one of the others"),
            Kind::Foreign => (FOREIGN | SENDER, self.padded(&[], 8)),
            Kind::ThirdParty(len) => (THIRD_PARTY, self.padded(&[], len)),
            Kind::Beginning => (
                ARRAY_COMMAND | SENDER,
                long_command(command(self.count), self.next_transfer_id()).swap_remove(0),
            ),
            Kind::RawCommand => {
                if self.rest.is_empty() {
                    let transfer_id = TransferId::new(self.next_transfer_id());
                    self.rest =
                        split(&[self.count as u8; 14], transfer_id, RAW_COMMAND_SIGNATURE).into();
                }
                (RAW_COMMAND | SENDER, self.rest.pop_front().expect("a frame"))
            }
            Kind::LongCommand => {
                if self.rest.is_empty() {
                    self.rest = long_command(command(self.count), self.next_transfer_id()).into();
                }
                (ARRAY_COMMAND | SENDER, self.rest.pop_front().expect("a frame"))
            }
        };
        let id = match self.load.kind {
            Kind::ThirdParty(_) => id,
            _ => id & BELOW_PRIORITY | u32::from(self.load.priority) << 24,
        };
        Frame::extended(id, &data)
    }

    /// The next frame of a transfer of several frames.
    fn next_of(&mut self, data_type: &DataType, payload: &[u8]) -> Vec<u8> {
        if self.rest.is_empty() {
            let transfer_id = TransferId::new(self.next_transfer_id());
            self.rest = split(payload, transfer_id, data_type.signature.expect("known")).into();
        }
        self.rest.pop_front().expect("a frame")
    }

    /// Fills the queue. Call it at least once a millisecond.
    pub fn feed(&mut self, now: Cycles) {
        self.station.borrow_mut().take_received();
        let queued = self.station.borrow().queued();
        match self.load.pace {
            Pace::Full => self.send((QUEUE - queued.min(QUEUE)) as u64),
            Pace::Bursts if queued == 0 && now >= self.silent_until => {
                let (frames, silence_us) = (1 + self.random.below(40), self.random.below(10_000));
                self.send(frames);
                // A frame lasts 160 us at most.
                self.silent_until = now + (frames * 160 + silence_us) * US;
            }
            Pace::Bursts => {}
            Pace::Every(period) => {
                self.silent_until = self.silent_until.max(now);
                while self.silent_until < now + MS {
                    let frame = self.frame();
                    self.station.borrow_mut().send_at(self.silent_until, frame);
                    self.silent_until += period;
                }
            }
        }
    }

    fn send(&mut self, frames: u64) {
        for _ in 0..frames {
            let frame = self.frame();
            self.station.borrow_mut().send(frame);
        }
    }

    /// Ends the load.
    fn stop(&mut self) {
        self.load.pace = Pace::Bursts;
        self.silent_until = Cycles::MAX;
        self.station.borrow_mut().clear_queue();
    }
}

/// Values of which the median and the maximum are reported.
#[derive(Clone, Debug, Default)]
pub struct Samples {
    values: Vec<u32>,
}

impl Samples {
    pub fn push(&mut self, value: Cycles) {
        self.values.push(u32::try_from(value).unwrap_or(u32::MAX));
    }

    pub fn values(&self) -> &[u32] {
        &self.values
    }

    /// The value that `percent` of the samples do not exceed; 0 without samples.
    pub fn percentile(&self, percent: usize) -> u32 {
        let mut sorted = self.values.clone();
        let at = (sorted.len() * percent).div_ceil(100).saturating_sub(1);
        if sorted.is_empty() { 0 } else { *sorted.select_nth_unstable(at).1 }
    }

    pub fn median(&self) -> u32 {
        self.percentile(50)
    }

    pub fn max(&self) -> u32 {
        self.values.iter().copied().max().unwrap_or(0)
    }
}

/// One SPI instruction, from chip select low to high.
#[derive(Clone, Debug, Default)]
struct Instruction {
    start: Cycles,
    end: Cycles,
    mosi: Vec<u8>,
    miso: Vec<u8>,
}

/// Why the driver sends an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Purpose {
    /// To check for a received frame.
    Check,
    /// To read or release a frame.
    Read,
    /// To send a frame.
    Send,
    Other,
}

impl Instruction {
    /// The purpose, by the instruction byte (DS20001801J table 12-1).
    fn purpose(&self) -> Purpose {
        match self.mosi[..] {
            [0xA0 | 0xB0, ..] | [0x03, CANINTF, ..] => Purpose::Check,
            [0x90..=0x96, ..] | [0x03, 0x60..=0x7F, ..] | [0x02 | 0x05, CANINTF, ..] => {
                Purpose::Read
            }
            [0x40..=0x45 | 0x80..=0x87, ..] | [0x02 | 0x05, 0x30..=0x5F, ..] => Purpose::Send,
            _ => Purpose::Other,
        }
    }

    /// The frame that READ RX BUFFER returned, if it was read from its first byte.
    fn frame_read(&self) -> Option<Frame> {
        let ([0x90 | 0x94, ..], [_, sidh, sidl, eid8, eid0, dlc, data @ ..]) =
            (&self.mosi[..], &self.miso[..])
        else {
            return None;
        };
        let standard = u32::from(*sidh) << 3 | u32::from(sidl >> 5);
        let id = standard << 18
            | u32::from(sidl & 0b11) << 16
            | u32::from(*eid8) << 8
            | u32::from(*eid0);
        let length = usize::from(dlc & 0x0F).min(8);
        Some(Frame::extended(id, data.get(..length)?))
    }
}

/// Longest pause, in cycles, between the check and the first byte of the frame that counts as
/// service. After a longer one the driver had checked ahead, while the program handled the frame
/// before.
const PAUSE: Cycles = 300;

/// Measures how a driver reads the frames that its controller receives.
#[derive(Default)]
pub struct Meter {
    open: Option<Instruction>,
    check: Option<(Cycles, Cycles, usize)>,
    reads: Vec<Instruction>,
    newest_received_at: Cycles,
    /// Number of frames read and released.
    pub frames: u64,
    /// Number of frames lost because both buffers were full.
    pub lost: u64,
    /// Number of frames released before an older one.
    pub out_of_order: u64,
    /// Number of frames read with other contents than on the bus.
    pub garbled: u64,
    /// Cycles from the chip select of the check that saw the frame to the release of its buffer.
    pub service: Samples,
    /// Cycles from the end of the frame to the release of its buffer.
    pub latency: Samples,
    /// Number of chip selects for a frame.
    pub selects: Samples,
    /// Number of SPI bytes for a frame, without its data bytes.
    pub overhead: Samples,
    /// Number of SPI bytes to read or release frames.
    pub fetched_bytes: u64,
}

impl Meter {
    /// Starts to measure now.
    pub fn attach(board: &mut Board) -> Meter {
        board.attach_probe();
        board.take_wire_events();
        board.chip().borrow_mut().take_frame_log();
        Meter::default()
    }

    /// Evaluates what happened since the last call.
    pub fn collect(&mut self, board: &mut Board) {
        let log = board.chip().borrow_mut().take_frame_log();
        let mut releases: VecDeque<(Cycles, Cycles, Frame)> = VecDeque::new();
        for entry in log {
            match entry.fate {
                Fate::Lost => self.lost += 1,
                Fate::Cleared(at) => {
                    self.frames += 1;
                    self.latency.push(at - entry.received_at);
                    if entry.received_at < self.newest_received_at {
                        self.out_of_order += 1;
                    }
                    self.newest_received_at = entry.received_at;
                    releases.push_back((at, entry.received_at, entry.frame));
                }
            }
        }
        for (at, event) in board.take_wire_events() {
            match event {
                WireEvent::Cs(false) => {
                    self.open = Some(Instruction { start: at, ..Instruction::default() })
                }
                WireEvent::Spi { byte, miso } => {
                    if let Some(open) = &mut self.open {
                        open.mosi.push(byte.mosi);
                        open.miso.push(miso);
                    }
                }
                WireEvent::Cs(true) => {
                    if let Some(mut instruction) = self.open.take() {
                        instruction.end = at;
                        self.instruction(instruction, &mut releases);
                    }
                }
                _ => {}
            }
        }
    }

    fn instruction(
        &mut self,
        instruction: Instruction,
        releases: &mut VecDeque<(Cycles, Cycles, Frame)>,
    ) {
        match instruction.purpose() {
            Purpose::Check => {
                self.check = Some((instruction.start, instruction.end, instruction.mosi.len()));
                self.reads.clear();
            }
            Purpose::Read => {
                self.fetched_bytes += instruction.mosi.len() as u64;
                self.reads.push(instruction);
            }
            // The status check was for a transmit buffer.
            Purpose::Send => self.check = None,
            Purpose::Other => {}
        }
        let Some(last) = self.reads.last() else { return };
        if releases.front().is_none_or(|&(at, ..)| at > last.end) {
            return;
        }
        let (at, _, frame) = releases.pop_front().expect("a release");
        let read = self.reads.iter().find_map(Instruction::frame_read);
        self.garbled += u64::from(read.is_some_and(|read| read != frame));
        let first = self.reads[0].start;
        let begun = match self.check {
            Some((start, end, _)) if first.saturating_sub(end) <= PAUSE => start,
            Some((start, end, _)) => first - (end - start),
            None => first,
        };
        self.service.push(at - begun);
        let bytes = self.reads.iter().map(|read| read.mosi.len()).sum::<usize>()
            + self.check.map_or(0, |check| check.2);
        self.overhead.push((bytes - frame.data().len()) as Cycles);
        self.selects.push((self.reads.len() + usize::from(self.check.is_some())) as Cycles);
        self.check = None;
        self.reads.clear();
    }
}

/// Other work of the node during a load.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Client {
    /// Nothing.
    None,
    /// A client reads the parameters, lights change, and a user types `?` on the serial monitor.
    Walking,
    /// Like `Walking`; the client also changes and saves parameters.
    Saving,
}

/// The measurements of a node under a load.
#[derive(Default)]
pub struct Figures {
    pub meter: Meter,
    /// True if a frame is still in the controller 20 ms after the load's end.
    pub stuck: bool,
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
    client: Client,
    ms: u64,
    asked_at: Cycles,
    asked: u16,
    ocr: u16,
    /// Commands on the bus: end of the last frame, and the width in microseconds.
    commands: VecDeque<(Cycles, f32)>,
}

impl Loaded {
    /// A running node with the parameters of [`BUSY`], and then the load.
    pub fn new(load: Option<Load>, client: Client) -> Loaded {
        Loaded::with(Rig::running(), load, client)
    }

    /// Like [`Loaded::new`] with a node that accepts DroneCAN v0 only.
    pub fn of_v0_only(load: Option<Load>, client: Client) -> Loaded {
        let mut rig = Rig::running();
        rig.accept_v0_only();
        Loaded::with(rig, load, client)
    }

    /// Like [`Loaded::new`] with this running rig.
    pub fn with_rig(rig: Rig, load: Option<Load>, client: Client) -> Loaded {
        Loaded::with(rig, load, client)
    }

    fn with(mut rig: Rig, load: Option<Load>, client: Client) -> Loaded {
        rig.overflows_expected = true;
        for (name, value) in BUSY {
            rig.set(name, value);
        }
        rig.send_command(1, 4, 1500.0);
        rig.run_ms(100);
        // An autopilot.
        for _ in 0..2 {
            rig.send_status_from(1);
            rig.run_ms(10);
        }
        rig.forget();
        let sender = load.map(|load| Sender::attach(&mut rig.bench, load));
        let figures = Figures { meter: Meter::attach(rig.board()), ..Figures::default() };
        let ocr = compare_register(rig.board());
        Loaded {
            asked_at: rig.now(),
            rig,
            figures,
            sender,
            client,
            ms: 0,
            asked: 0,
            ocr,
            commands: VecDeque::new(),
        }
    }

    pub fn run_ms(&mut self, ms: u64) {
        for _ in 0..ms {
            self.ms += 1;
            if let Some(sender) = &mut self.sender {
                sender.feed(self.rig.now());
            }
            self.busy_client();
            self.millisecond();
        }
    }

    /// Ends the load and checks what remains in the controller.
    pub fn finish(mut self) -> Figures {
        if let Some(sender) = &mut self.sender {
            sender.stop();
        }
        self.client = Client::None;
        self.run_ms(20);
        let chip = self.rig.board().chip();
        self.figures.stuck = chip.borrow().register(CANINTF) & RX_FLAGS != 0;
        self.figures
    }

    fn busy_client(&mut self) {
        if self.client == Client::None {
            return;
        }
        let rig = &mut self.rig;
        // The client sends its next request after the whole answer.
        let answered = !rig.answers().is_empty();
        if answered || rig.now() - self.asked_at > CLIENT_TIMEOUT_MS * MS {
            self.figures.answers += u64::from(answered);
            self.asked = self.asked.wrapping_add(1);
            self.asked_at = rig.now();
            rig.transfers.clear();
            let saving = self.client == Client::Saving;
            let request = match self.asked % 32 {
                31 => Message::NodeInfoRequest,
                30 if saving => Message::ExecuteOpcode(Opcode::SAVE),
                29 if saving => Message::ParameterRequest(ParameterRequest {
                    index: 0,
                    value: Value::Integer(i64::from(self.asked)),
                    name: "TEMP_ID".into(),
                }),
                // The node answers requests beyond the last parameter, too.
                index => Message::ParameterRequest(ParameterRequest {
                    index,
                    ..ParameterRequest::default()
                }),
            };
            rig.request(&request);
        }
        if self.ms % 50 == 25 {
            let tail = 0xC0 | (self.ms / 50 % 32) as u8;
            rig.send(LIGHTS_COMMAND | SENDER, &[0, 0xFF, self.ms as u8, tail]);
        }
        if self.ms % 500 == 250 {
            rig.board().avr_mut().serial_send(b"?");
        }
        if self.ms % 1000 == 500 {
            rig.send_status_from(1);
        }
    }

    fn millisecond(&mut self) {
        let mut writes: Vec<(Cycles, u16)> = Vec::new();
        let ocr = &mut self.ocr;
        // After each step of the bench, which can be long while the bus is idle.
        let end = self.rig.now() + MS;
        while self.rig.now() < end && !self.rig.bench.is_halted() {
            self.rig.bench.run_until_or(
                |bench| {
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
            figures.own_statuses += u64::from(id == super::STATUS_OF_NODE);
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
        if self.client == Client::None {
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
