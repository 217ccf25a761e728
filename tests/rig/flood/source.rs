//! What the senders of a flood send: valid transfers with random values, from a seed.

use std::collections::BTreeMap;

use bench::can::Frame;
use bench::dronecan::draft;
use bench::dronecan::esc::encode_commands;
use bench::dronecan::types::{self, DataType};
use bench::dronecan::{NodeId, TransferId, split};
use bench::{Cycles, Noise};

use super::super::{ARMED, MS, NOT_SAFE, SERVO_COMMAND};
use super::setup::{Preset, Setup};
use super::values::{Recent, STOPPED, Unit};

/// Node IDs of the senders.
pub const SENDERS: [u8; 2] = [20, 21];
/// Actuator IDs that no output has are this and above.
const ELSEWHERE: u64 = 100;
/// Frames of [`Traffic::Foreign`]: uavcan.equipment.esc.Status, and a response of param.GetSet to
/// node 22.
const ESC_STATUS: u32 = 1034 << 8;
const RESPONSE_TO_OTHERS: u32 = 11 << 16 | 22 << 8 | 1 << 7;
/// Time between two ArmingStatus, which motors need.
const ARMING_PERIOD: Cycles = 500 * MS;
/// Time between two commands for each output that is not flooded.
const TRICKLE_PERIOD: Cycles = 20 * MS;

/// What a flood consists of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Traffic {
    /// ArrayCommands of one entry with this unit, one frame, each for a random servo.
    Command(Unit),
    /// ArrayCommands of so many entries, in random order and with random units: for all servos if
    /// they are enough, the others for other nodes.
    List(usize),
    /// esc.RawCommands of so many motors.
    Throttles(usize),
    /// thesis.ServoCommand: one byte for the first output.
    Byte,
    /// The draft's command of one byte, type 760.
    DraftByte,
    /// NodeStatus of the draft.
    DraftStatus,
    /// ArrayCommands of one entry that are for other nodes.
    Elsewhere,
    /// NodeStatus.
    Status,
    /// ArmingStatus, SafetyState, LightsCommand.
    Arming,
    Safety,
    Lights,
    /// ArrayCommands of one entry for the first servo, and one each 20 ms for the others.
    OneServo,
    /// Frames of other nodes for others, of random length, and each 20 ms a command for all
    /// outputs: with several outputs the filters let them pass.
    Foreign,
    /// NodeStatus, and short messages of which few come at a time: thesis.ServoCommand, or
    /// ArmingStatus for motors alone.
    LongAndShort,
    /// All that are for these outputs, at random.
    Mixed,
}

impl Traffic {
    /// All kinds that the program reads with these outputs. The filters keep others from it.
    pub fn all(setup: Setup) -> Vec<Traffic> {
        if !setup.is_v0() {
            return vec![Traffic::DraftByte, Traffic::DraftStatus, Traffic::Mixed];
        }
        let mut all = Vec::new();
        if setup.servos > 0 {
            all.extend(Unit::ALL.map(Traffic::Command));
            all.extend([4, 8, 15].map(Traffic::List));
            all.push(Traffic::Byte);
        }
        if setup.motors > 0 {
            all.extend([1, 2, 4, 8, 12].map(Traffic::Throttles));
        }
        all.extend([Traffic::Elsewhere, Traffic::Status, Traffic::Arming]);
        if matches!(setup.preset, Preset::Remote | Preset::Full) {
            all.push(Traffic::Safety);
        }
        if setup.preset == Preset::Full {
            all.push(Traffic::Lights);
        }
        if setup.outputs() > 1 {
            all.extend([Traffic::Foreign, Traffic::LongAndShort]);
        }
        if setup.servos > 1 {
            all.push(Traffic::OneServo);
        }
        all.push(Traffic::Mixed);
        all
    }

    /// True if all frames are commands for outputs.
    pub fn is_commands(self) -> bool {
        matches!(
            self,
            Traffic::Command(_)
                | Traffic::List(_)
                | Traffic::Throttles(_)
                | Traffic::Byte
                | Traffic::DraftByte
                | Traffic::OneServo
        )
    }
}

/// A command for an output.
#[derive(Clone, Copy, Debug)]
pub struct Command {
    /// The output, counted from 0.
    pub output: usize,
    /// The pulse that it asks for, in ticks.
    pub pulse: i32,
    /// An esc.RawCommand that leaves out the motor, which then stops. The node looks for such
    /// motors one after the other, so it does that less promptly than it follows commands.
    pub is_stop: bool,
}

impl Command {
    fn of(output: usize, pulse: i32) -> Command {
        Command { output, pulse, is_stop: false }
    }
}

/// A frame, and the commands of the transfer that it completes.
pub type Sent = (Frame, Vec<Command>);

/// Makes the transfers of a flood.
pub struct Source {
    setup: Setup,
    traffic: Traffic,
    senders: usize,
    priority: u8,
    random: Noise,
    recent: [Recent; 8],
    /// The last transfer ID of each sender and type.
    transfer_ids: BTreeMap<(u8, u32), u8>,
    now: Cycles,
    arming_at: Cycles,
    trickle_at: Cycles,
    trickled: usize,
}

impl Source {
    /// `senders` is 1 or 2.
    pub fn new(setup: Setup, traffic: Traffic, senders: usize, priority: u8, seed: u64) -> Source {
        assert!((1..=SENDERS.len()).contains(&senders), "{senders} senders");
        Source {
            setup,
            traffic,
            senders,
            priority,
            random: Noise::new(seed),
            recent: std::array::from_fn(|_| Recent::of(setup.escs)),
            transfer_ids: BTreeMap::new(),
            now: 0,
            arming_at: 0,
            trickle_at: 0,
            trickled: 0,
        }
    }

    /// The next frames, at least one. Of two senders the frames of two transfers alternate, if the
    /// node can receive two at a time.
    pub fn next(&mut self, now: Cycles) -> Vec<Sent> {
        self.now = now;
        if self.setup.motors > 0 && now >= self.arming_at {
            self.arming_at = now + ARMING_PERIOD;
            return self.transfer(Traffic::Arming, SENDERS[0]);
        }
        if self.senders == 1 {
            return self.transfer(self.traffic, SENDERS[0]);
        }
        let [first, second] = SENDERS.map(|sender| self.transfer(self.traffic, sender));
        if self.setup.preset != Preset::Full {
            return [first, second].concat();
        }
        let (mut first, mut second) = (first.into_iter(), second.into_iter());
        let mut both = Vec::new();
        loop {
            let pair = [first.next(), second.next()];
            if pair.iter().all(Option::is_none) {
                return both;
            }
            both.extend(pair.into_iter().flatten());
        }
    }

    fn transfer(&mut self, traffic: Traffic, sender: u8) -> Vec<Sent> {
        match traffic {
            Traffic::Mixed => {
                // Without OneServo and Mixed itself, which are last.
                let all = Traffic::all(self.setup);
                let single = all.iter().filter(|one| !matches!(one, Traffic::OneServo));
                let single: Vec<_> = single.take_while(|one| **one != Traffic::Mixed).collect();
                let drawn = *single[self.random.below(single.len() as u64) as usize];
                self.transfer(drawn, sender)
            }
            Traffic::Command(unit) => {
                let servo = self.random.below(self.setup.servos as u64) as usize;
                self.command(servo, unit, sender)
            }
            Traffic::OneServo => {
                let servo = self.trickle();
                let unit = self.unit();
                self.command(servo, unit, sender)
            }
            Traffic::List(entries) => self.list(entries, sender),
            Traffic::Foreign => self.foreign(sender),
            Traffic::LongAndShort => {
                let short = if self.setup.servos > 0 { Traffic::Byte } else { Traffic::Arming };
                let is_long = self.random.below(10) < 6;
                self.transfer(if is_long { Traffic::Status } else { short }, sender)
            }
            Traffic::Throttles(motors) => self.throttles(motors, sender),
            Traffic::Byte => {
                let (byte, pulse) = self.recent[0].byte(&mut self.random);
                let tail = 0xC0 | self.transfer_id(sender, SERVO_COMMAND);
                let id = self.with_priority(SERVO_COMMAND | u32::from(sender));
                vec![(Frame::extended(id, &[byte, tail]), vec![Command::of(0, pulse)])]
            }
            Traffic::DraftByte => {
                let (byte, pulse) = self.recent[0].byte(&mut self.random);
                self.draft(
                    &draft::types::THESIS_COMMAND,
                    sender,
                    &[byte],
                    vec![Command::of(0, pulse)],
                )
            }
            other => self.message(other, sender),
        }
    }

    /// A message without a command for an output.
    fn message(&mut self, traffic: Traffic, sender: u8) -> Vec<Sent> {
        match traffic {
            Traffic::DraftStatus => {
                // Up some seconds, with a random length of the part that the draft left open.
                let status = [self.random.next_u64() as u8, 0, 0, 0, 0, 0, 0, 0];
                let length = [4, 6, 7, 8][self.random.below(4) as usize];
                self.draft(&draft::types::NODE_STATUS, sender, &status[..length], Vec::new())
            }
            Traffic::Elsewhere => {
                let payload = self.entry_elsewhere();
                self.send(&types::ARRAY_COMMAND, sender, &payload, Vec::new())
            }
            Traffic::Status => {
                let [uptime0, uptime1, uptime2, vendor0, vendor1, ..] =
                    self.random.next_u64().to_le_bytes();
                // Health OK, mode OPERATIONAL.
                let status = [uptime0, uptime1, uptime2, 0, 0, vendor0, vendor1];
                self.send(&types::NODE_STATUS, sender, &status, Vec::new())
            }
            Traffic::Arming => self.send(&types::ARMING_STATUS, sender, &[ARMED], Vec::new()),
            Traffic::Safety => self.send(&types::SAFETY_STATE, sender, &[NOT_SAFE], Vec::new()),
            Traffic::Lights => {
                let [red, green, ..] = self.random.next_u64().to_le_bytes();
                self.send(&types::LIGHTS_COMMAND, sender, &[0, red, green], Vec::new())
            }
            other => unreachable!("{other:?} has commands"),
        }
    }

    /// An esc.Status or a response of another node in one frame, or the command that is due.
    fn foreign(&mut self, sender: u8) -> Vec<Sent> {
        if self.now >= self.trickle_at {
            self.trickle_at = self.now + TRICKLE_PERIOD;
            return match self.setup.motors {
                0 => self.list(self.setup.servos, sender),
                motors => self.throttles(motors, sender),
            };
        }
        let bytes = self.random.next_u64().to_le_bytes();
        let id = [ESC_STATUS, RESPONSE_TO_OTHERS][self.random.below(2) as usize];
        let length = 1 + self.random.below(8) as usize;
        let id = self.with_priority(id | u32::from(sender));
        vec![(Frame::extended(id, &bytes[..length]), Vec::new())]
    }

    /// The servo of the next command of [`Traffic::OneServo`].
    fn trickle(&mut self) -> usize {
        let others = self.setup.servos - 1;
        if self.now < self.trickle_at {
            return 0;
        }
        self.trickle_at = self.now + TRICKLE_PERIOD / others as u64;
        self.trickled = (self.trickled + 1) % others;
        self.trickled + 1
    }

    fn unit(&mut self) -> Unit {
        Unit::ALL[self.random.below(3) as usize]
    }

    fn command(&mut self, servo: usize, unit: Unit, sender: u8) -> Vec<Sent> {
        let ([low, high], pulse) = self.recent[servo].entry(unit, &mut self.random);
        let payload = [servo as u8 + 1, unit as u8, low, high];
        self.send(&types::ARRAY_COMMAND, sender, &payload, vec![Command::of(servo, pulse)])
    }

    fn entry_elsewhere(&mut self) -> [u8; 4] {
        let id = (ELSEWHERE + self.random.below(256 - ELSEWHERE)) as u8;
        let [low, high, ..] = self.random.next_u64().to_le_bytes();
        [id, self.unit() as u8, low, high]
    }

    fn list(&mut self, entries: usize, sender: u8) -> Vec<Sent> {
        // The first `entries` of the servos in random order.
        let mut servos: Vec<usize> = (0..self.setup.servos).collect();
        self.shuffle(&mut servos);
        servos.truncate(entries);
        let mut commands = Vec::new();
        let mut list: Vec<[u8; 4]> = Vec::new();
        for servo in servos {
            let unit = self.unit();
            let ([low, high], pulse) = self.recent[servo].entry(unit, &mut self.random);
            list.push([servo as u8 + 1, unit as u8, low, high]);
            commands.push(Command::of(servo, pulse));
        }
        while list.len() < entries {
            list.push(self.entry_elsewhere());
        }
        self.shuffle(&mut list);
        self.send(&types::ARRAY_COMMAND, sender, &list.concat(), commands)
    }

    fn throttles(&mut self, motors: usize, sender: u8) -> Vec<Sent> {
        let mut commands = Vec::new();
        let throttles: Vec<i16> = (0..motors)
            .map(|motor| {
                if motor >= self.setup.motors {
                    return self.random.below(8192) as i16;
                }
                let output = self.setup.servos + motor;
                let (throttle, pulse) = self.recent[output].throttle(&mut self.random);
                commands.push(Command::of(output, pulse));
                throttle
            })
            .collect();
        for motor in motors..self.setup.motors {
            let output = self.setup.servos + motor;
            commands.push(Command { is_stop: true, ..Command::of(output, STOPPED) });
        }
        self.send(&types::RAW_COMMAND, sender, &encode_commands(&throttles), commands)
    }

    fn shuffle<T>(&mut self, items: &mut [T]) {
        for n in (1..items.len()).rev() {
            items.swap(n, self.random.below(n as u64 + 1) as usize);
        }
    }

    fn transfer_id(&mut self, sender: u8, of: u32) -> u8 {
        let last = self.transfer_ids.entry((sender, of)).or_default();
        *last = (*last + 1) % 32;
        *last
    }

    fn with_priority(&self, id: u32) -> u32 {
        id & 0x00FF_FFFF | u32::from(self.priority) << 24
    }

    /// The frames of a message; the last one completes these commands.
    fn send(
        &mut self,
        data_type: &DataType,
        sender: u8,
        payload: &[u8],
        commands: Vec<Command>,
    ) -> Vec<Sent> {
        let id = data_type.message_id(self.priority, NodeId::new(sender).expect("a node ID"));
        let transfer_id = TransferId::new(self.transfer_id(sender, u32::from(data_type.id)));
        let data = split(payload, transfer_id, data_type.seed.expect("known"));
        let frames = data.iter().map(|data| (Frame::extended(id.build(), data), Vec::new()));
        let mut frames: Vec<Sent> = frames.collect();
        frames.last_mut().expect("a frame").1 = commands;
        frames
    }

    /// A message of the draft in one frame.
    fn draft(
        &mut self,
        data_type: &draft::DataType,
        sender: u8,
        payload: &[u8],
        commands: Vec<Command>,
    ) -> Vec<Sent> {
        let transfer_id = self.transfer_id(sender, u32::from(data_type.id)) % 8;
        let id = draft::CanId {
            type_id: data_type.id,
            transfer_type: draft::TransferType::MessageBroadcast,
            source: NodeId::new(sender).expect("a node ID"),
            index: 0,
            last: true,
            transfer_id: draft::TransferId::new(transfer_id),
        };
        vec![(Frame::extended(id.build(), payload), commands)]
    }
}
