//! The node that sends a load.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::f32::consts::FRAC_PI_4;
use std::rc::Rc;

use bench::can::{Frame, SoftNode};
use bench::dronecan::{DataType, ParameterRequest, TransferId, split, types};
use bench::{Bench, Cycles, Noise};

use super::super::{
    ARMING_STATUS, ARRAY_COMMAND, MS, NODE, NODE_STATUS, RAW_COMMAND, SERVO_COMMAND, US,
    array_command,
};
use super::{Kind, Load, Pace};

/// Node ID of the sender that fills the bus.
pub const SENDER: u32 = 10;
/// Frames that wait in the sender's queue, so that the bus never becomes idle.
const QUEUE: usize = 24;
/// Mask of an identifier's bits below the priority.
pub(super) const BELOW_PRIORITY: u32 = 0x00FF_FFFF;
/// A message type that the node does not accept.
const FOREIGN: u32 = 0x1804_5600;
/// Identifier that RXF0 of `tests/third-party/job.rs` accepts; the frame rolls over to RXB1.
const THIRD_PARTY: u32 = 0x1234_5600;
/// A vendor-specific message, type 20210, with the low byte of ArrayCommand's type.
const LOOK_ALIKE: u32 = 0x184E_F200;
/// Anonymous request for a node ID: type 1. With this discriminator its identifier equals that of a
/// NodeStatus of node 0.
const ANONYMOUS: u32 = 0x1801_5500;
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
    pub(super) widths: VecDeque<f32>,
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
                    self.rest = split(
                        &[self.count as u8; 14],
                        transfer_id,
                        types::RAW_COMMAND.seed.expect("known"),
                    )
                    .into();
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
            self.rest = split(payload, transfer_id, data_type.seed.expect("known")).into();
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
    pub(super) fn stop(&mut self) {
        self.load.pace = Pace::Bursts;
        self.silent_until = Cycles::MAX;
        self.station.borrow_mut().clear_queue();
    }
}
