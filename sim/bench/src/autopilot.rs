//! A simulated autopilot: a flight controller as far as it communicates with the node.
//!
//! The autopilot sends NodeStatus at 1 Hz and commands servos at 50 Hz. One servo or all of them
//! sweep, or hold a position. On demand it commands motors, too. They are off while disarmed, and
//! follow the same motion while armed. Its [`Profile`] decides which further messages it sends. It
//! answers GetNodeInfo, and on demand it allocates node IDs ([`Allocator`]). It uses one dialect,
//! and ignores the other.
//!
//! The autopilot uses simulated time and queues each frame for its exact time, so that a run can be
//! repeated. It sends each answer a fixed time after the request.
//!
//! Limits: GetNodeInfo is its only service, and it queues all frames of a transfer at once. It
//! sends 50 commands a second to motors; ArduPilot and PX4 send at the rate of their control loops,
//! up to 400 a second.

mod allocator;
mod in_draft;
mod profile;

pub use allocator::Allocator;
use profile::Motors;
pub use profile::Profile;

use crate::can::{Frame, Id, SoftNode, StationRef};
use crate::dronecan::{
    ActuatorCommand, Allocation, CanId, CommandUnit, DataType, Decoded, Dialect, Message, NodeId,
    NodeInfo, NodeStatus, Observation, Observer, Transfer, TransferId, draft, esc, text::hex,
};
use crate::{Cycles, F_CPU_HZ};
use half::f16;
use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::f64::consts::{FRAC_PI_2, TAU};
use std::fmt;
use std::rc::Rc;

/// Period of NodeStatus: the longest that the dialects allow.
const STATUS_PERIOD: Cycles = F_CPU_HZ;
/// Default servo output period of ArduPilot's and PX4's DroneCAN drivers.
const COMMAND_PERIOD: Cycles = F_CPU_HZ / 50;
/// Time of the first command. This and the next two offsets differ, so that no two messages are due
/// in the same cycle.
const COMMAND_OFFSET: Cycles = F_CPU_HZ / 200;
/// Time of the first ArmingStatus.
const ARMING_OFFSET: Cycles = F_CPU_HZ / 80;
/// Time of the first command for motors.
const MOTORS_OFFSET: Cycles = F_CPU_HZ * 3 / 200;

/// Centre and half travel of a PWM command, in microseconds: the usual 1000 to 2000.
const PWM_CENTRE_US: f64 = 1500.0;
const PWM_HALF_TRAVEL_US: f64 = 500.0;

/// Most commands whose frames may wait for the bus before the autopilot drops its queue.
const OVERDUE_MAX: usize = 3;

/// Time from a request to its answer. At least the length of a slice of [`Autopilot::advance`], so
/// that slices change nothing.
const ANSWER_DELAY: Cycles = F_CPU_HZ / 500;
/// Time after which the autopilot repeats a request without answer.
const REQUEST_PERIOD: Cycles = F_CPU_HZ;
/// A node that was silent for longer counts as new at its next NodeStatus (DSDL
/// 341.NodeStatus.uavcan, OFFLINE_TIMEOUT_MS).
const OFFLINE_TIMEOUT: Cycles = 3 * F_CPU_HZ;
/// Priority of the allocator's messages: libuavcan's OneHigherThanLowest.
const ALLOCATION_PRIORITY: u8 = 30;

/// Values of ArmingStatus.
const FULLY_ARMED: u8 = 255;
const DISARMED: u8 = 0;
/// Value of SafetyState: the outputs are enabled.
const SAFETY_OFF: u8 = 255;

/// Message and unit of the servo commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum CommandType {
    /// ArrayCommand, -1 to +1.
    Unitless,
    /// ArrayCommand, an angle in radians.
    Position,
    /// ArrayCommand, a pulse width in microseconds.
    Pwm,
    /// The thesis's one byte, 0 to 255 over the full travel.
    Thesis,
}

impl fmt::Display for CommandType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            CommandType::Unitless => "unitless",
            CommandType::Position => "position",
            CommandType::Pwm => "PWM",
            CommandType::Thesis => "thesis",
        })
    }
}

/// Restricts the periodic messages of an autopilot to one kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Only {
    /// Send NodeStatus, but no commands.
    Status,
    /// Send commands, but no NodeStatus.
    Commands,
}

/// The commanded position of the servo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// A sine over the full travel, with `phase` at the time `since`, in turns.
    Sweep { since: Cycles, phase: f64 },
    /// A constant deflection, -1 to +1.
    Hold(f64),
}

/// The actuators that move, for a profile that commands several of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Moves {
    /// The actuator of the settings moves; each other actuator holds its own position.
    #[default]
    One,
    /// All actuators move: each sweeps ahead of the one before it, by an equal part of the period.
    All,
}

/// Settings of an autopilot.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Flight controller that the autopilot imitates.
    pub profile: Profile,
    pub dialect: Dialect,
    pub node_id: NodeId,
    /// ID of the actuator that moves.
    pub actuator: u8,
    pub moves: Moves,
    /// Number of motors to command, from index 0 on. The draft has no command for motors.
    pub motors: u8,
    pub command_type: CommandType,
    /// Time of one sweep, there and back.
    pub sweep_period: Cycles,
    /// Angle of full deflection for position commands, in radians.
    pub position_full_rad: f64,
    /// True if the autopilot allocates node IDs. The draft has no allocation.
    pub allocates: bool,
    /// Restricts the periodic messages. Answers and requests are not restricted.
    pub only: Option<Only>,
}

impl Settings {
    /// The usual settings of a flight controller.
    pub fn of(profile: Profile) -> Settings {
        let dialect = Dialect::V0;
        Settings {
            profile,
            dialect,
            node_id: profile.node_id(),
            actuator: 1,
            moves: Moves::One,
            motors: 0,
            command_type: profile.command_types(dialect)[0],
            sweep_period: 4 * F_CPU_HZ,
            position_full_rad: FRAC_PI_2 / 2.0,
            allocates: false,
            only: None,
        }
    }

    /// Converts the settings to a dialect. If the profile does not support the dialect, it becomes
    /// `Profile::Plain`. If the profile does not have the command type in the dialect, the type
    /// becomes the profile's usual one.
    pub fn in_dialect(mut self, dialect: Dialect) -> Settings {
        if self.profile.command_types(dialect).is_empty() {
            self.profile = Profile::Plain;
        }
        let types = self.profile.command_types(dialect);
        if !types.contains(&self.command_type) {
            self.command_type = types[0];
        }
        Settings { dialect, ..self }
    }
}

impl Default for Settings {
    fn default() -> Settings {
        Settings::of(Profile::Plain)
    }
}

/// A node from which the autopilot has received a NodeStatus.
#[derive(Clone, Debug, Default)]
struct Known {
    last_status_at: Cycles,
    uptime_s: u32,
    /// Time of the next GetNodeInfo request; `None` after the response.
    ask_at: Option<Cycles>,
}

/// An autopilot and its station on the bus.
pub struct Autopilot {
    station: Rc<RefCell<SoftNode>>,
    settings: Settings,
    powered_at: Cycles,
    motion: Motion,
    silent: bool,
    /// True while a task runs whose frames are not sent.
    mute: bool,
    armed: bool,
    next_status_at: Cycles,
    next_command_at: Cycles,
    next_arming_at: Cycles,
    next_motors_at: Cycles,
    /// Answers that are not due yet, in order of time.
    answers: VecDeque<(Cycles, Vec<Frame>)>,
    nodes: BTreeMap<NodeId, Known>,
    allocator: Option<Allocator>,
    /// Next transfer ID for each identifier.
    transfers: HashMap<CanId, TransferId>,
    draft_transfers: HashMap<u16, draft::TransferId>,
    observer: Observer,
    events: Vec<(Cycles, String)>,
    commands_sent: u64,
}

impl Autopilot {
    /// An autopilot that starts at time 0, armed and sweeping.
    pub fn new(settings: Settings, bit_rate: u32) -> Autopilot {
        Autopilot::powered(settings, bit_rate, 0)
    }

    /// An autopilot that starts at `now`, armed and sweeping.
    pub fn powered(settings: Settings, bit_rate: u32, now: Cycles) -> Autopilot {
        Autopilot {
            station: Rc::new(RefCell::new(SoftNode::new(bit_rate))),
            allocator: settings.allocates.then(|| Allocator::new(settings.node_id)),
            settings,
            powered_at: now,
            motion: Motion::Sweep { since: now, phase: 0.0 },
            silent: false,
            mute: false,
            armed: true,
            next_status_at: now,
            next_command_at: now + COMMAND_OFFSET,
            next_arming_at: now + ARMING_OFFSET,
            next_motors_at: now + MOTORS_OFFSET,
            answers: VecDeque::new(),
            nodes: BTreeMap::new(),
            transfers: HashMap::new(),
            draft_transfers: HashMap::new(),
            observer: Observer::new(),
            events: Vec::new(),
            commands_sent: 0,
        }
    }

    /// The station of the autopilot, to attach to a bus.
    pub fn station(&self) -> StationRef {
        self.station.clone()
    }

    /// Removes the power for good: a frame on the bus is cut off, and the station sends and
    /// acknowledges nothing more.
    pub fn switch_off(self) {
        let mut station = self.station.borrow_mut();
        station.set_listen_only(true);
        station.clear_queue();
    }

    /// An autopilot with other settings that starts at `now`, with the motion, arming and silence
    /// of this one.
    pub fn successor(&self, settings: Settings, bit_rate: u32, now: Cycles) -> Autopilot {
        let (motion, silent, armed) = (self.motion, self.silent, self.armed);
        Autopilot { motion, silent, armed, ..Autopilot::powered(settings, bit_rate, now) }
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Removes and returns the events since the last call: information of nodes, and node IDs that
    /// were granted.
    pub fn take_events(&mut self) -> Vec<(Cycles, String)> {
        std::mem::take(&mut self.events)
    }

    /// Commands queued so far.
    pub fn commands_sent(&self) -> u64 {
        self.commands_sent
    }

    /// True if the autopilot sends nothing.
    pub fn is_silent(&self) -> bool {
        self.silent
    }

    /// Stops or resumes sending. Messages that were due meanwhile are not sent later.
    pub fn set_silent(&mut self, silent: bool) {
        self.silent = silent;
    }

    /// True if the vehicle is armed. Only some profiles send ArmingStatus.
    pub fn is_armed(&self) -> bool {
        self.armed
    }

    /// Arms or disarms the vehicle. The autopilot sends commands in both states.
    pub fn set_armed(&mut self, armed: bool) {
        self.armed = armed;
    }

    /// Changes the node ID.
    pub fn set_node_id(&mut self, id: NodeId) {
        self.settings.node_id = id;
    }

    /// Changes to the next command type of the profile; after the last to the first.
    pub fn next_command_type(&mut self) {
        let types = self.settings.profile.command_types(self.settings.dialect);
        let at = types
            .iter()
            .position(|other| *other == self.settings.command_type)
            .map_or(0, |at| at + 1);
        self.settings.command_type = types[at % types.len()];
    }

    /// True if the autopilot sweeps the servo; false if it holds it.
    pub fn is_sweeping(&self) -> bool {
        matches!(self.motion, Motion::Sweep { .. })
    }

    /// Starts a sweep at `now` from the present deflection, without a jump.
    pub fn sweep(&mut self, now: Cycles) {
        let phase = self.deflection(now).asin() / TAU;
        self.motion = Motion::Sweep { since: now, phase };
    }

    /// Holds a deflection, limited to -1..=1.
    pub fn hold(&mut self, deflection: f64) {
        self.motion = Motion::Hold(deflection.clamp(-1.0, 1.0));
    }

    /// Changes the deflection at `now` by `step`, and holds it.
    pub fn nudge(&mut self, step: f64, now: Cycles) {
        self.hold(self.deflection(now) + step);
    }

    /// Commanded deflection at `now`, -1 to +1: of the actuator that moves, or of the first one if
    /// all move.
    pub fn deflection(&self, now: Cycles) -> f64 {
        self.deflection_ahead(now, 0.0)
    }

    /// Commanded deflection at `now` of an actuator that sweeps `ahead` by this part of a period.
    fn deflection_ahead(&self, now: Cycles, ahead: f64) -> f64 {
        match self.motion {
            Motion::Hold(deflection) => deflection,
            Motion::Sweep { since, phase } => {
                let turns =
                    now.saturating_sub(since) as f64 / self.settings.sweep_period.max(1) as f64;
                ((turns + phase + ahead) * TAU).sin()
            }
        }
    }

    /// Processes the received frames, and queues the frames that are due before `until`, each for
    /// its exact time. Call it when the bus has reached the `until` of the last call.
    pub fn advance(&mut self, until: Cycles) {
        let received = self.station.borrow_mut().take_received();
        for (at, frame) in received {
            self.receive(at, &frame);
        }
        // After the bus was blocked, the autopilot must not send old commands, so it drops a long
        // queue.
        let frames_each = self.settings.profile.array().map_or(1, |array| usize::from(array.count));
        if self.station.borrow().queued() > OVERDUE_MAX * frames_each {
            self.station.borrow_mut().clear_queue();
        }
        for (at, frame) in self.due(until) {
            self.station.borrow_mut().send_at(at, frame);
        }
    }

    // ---- Reception ----

    fn receive(&mut self, at: Cycles, frame: &Frame) {
        let Id::Extended(id) = frame.id else { return };
        if frame.remote {
            return;
        }
        match self.observer.push(id, frame.data(), crate::elapsed(at)) {
            Observation::Complete(Decoded::V0(transfer, message))
                if self.settings.dialect == Dialect::V0 =>
            {
                self.handle(at, &transfer, message);
            }
            Observation::Complete(Decoded::Draft(transfer, message))
                if self.settings.dialect == Dialect::Draft =>
            {
                self.handle_in_draft(at, &transfer, message);
            }
            Observation::Complete(_) | Observation::Partial | Observation::Invalid(_) => {}
        }
    }

    fn handle(&mut self, at: Cycles, transfer: &Transfer, message: Message) {
        match (message, transfer.id) {
            (Message::NodeStatus(status), CanId::Message { source, .. }) => {
                self.handle_status(at, source, status.uptime_s)
            }
            (Message::Allocation(request), CanId::Anonymous { .. }) => self.allocate(at, &request),
            (Message::NodeInfo(info), CanId::Service { source, destination, .. })
                if self.is_own_id(destination) =>
            {
                self.nodes.entry(source).or_default().ask_at = None;
                self.events.push((at, format!("{source} is {info}")));
            }
            (
                Message::NodeInfoRequest,
                CanId::Service { priority, service_id, destination, source, .. },
            ) if self.is_own_id(destination) => {
                let id = CanId::Service {
                    priority,
                    service_id,
                    request: false,
                    destination: source,
                    source: destination,
                };
                let info = Message::NodeInfo(Box::new(self.information(self.status(at))));
                self.answers
                    .push_back((at + ANSWER_DELAY, frames(id, transfer.transfer_id, &info)));
            }
            _ => {}
        }
    }

    fn is_own_id(&self, id: NodeId) -> bool {
        id == self.settings.node_id
    }

    fn handle_status(&mut self, at: Cycles, source: NodeId, uptime_s: u32) {
        if let Some(allocator) = &mut self.allocator {
            allocator.add_taken(source);
        }
        let is_known = self.nodes.contains_key(&source);
        let node = self.nodes.entry(source).or_default();
        let is_new =
            !is_known || uptime_s < node.uptime_s || at - node.last_status_at > OFFLINE_TIMEOUT;
        if is_new
            && self.settings.dialect == Dialect::V0
            && self.settings.profile.request_priority().is_some()
        {
            node.ask_at = Some(at + ANSWER_DELAY);
        }
        (node.last_status_at, node.uptime_s) = (at, uptime_s);
    }

    fn allocate(&mut self, at: Cycles, request: &Allocation) {
        let Some(answer) =
            self.allocator.as_mut().and_then(|allocator| allocator.answer(request, at))
        else {
            return;
        };
        if answer.node_id != 0 {
            let text =
                format!("{} is allocated to unique ID {}", answer.node_id, hex(&answer.unique_id));
            self.events.push((at, text));
        }
        let message = Message::Allocation(answer);
        let id = self.broadcast_id(&message, ALLOCATION_PRIORITY);
        let transfer_id = self.next_transfer(id);
        self.answers.push_back((at + ANSWER_DELAY, frames(id, transfer_id, &message)));
    }

    fn information<S: Default>(&self, status: S) -> NodeInfo<S> {
        NodeInfo {
            status,
            software: (4, 6),
            hardware: (1, 0),
            // Differs from the unique ID of any board, which the board makes from noise.
            unique_id: *b"sim's autopilot ",
            name: self.settings.profile.name().into(),
            ..NodeInfo::default()
        }
    }

    fn uptime_s(&self, at: Cycles) -> u32 {
        u32::try_from((at - self.powered_at) / F_CPU_HZ).unwrap_or(u32::MAX)
    }

    fn status(&self, at: Cycles) -> NodeStatus {
        NodeStatus { uptime_s: self.uptime_s(at), ..NodeStatus::default() }
    }

    // ---- Transmission ----

    /// Frames due before `until`, in order of time.
    fn due(&mut self, until: Cycles) -> Vec<(Cycles, Frame)> {
        let mut frames = Vec::new();
        while let Some((at, task)) = self.next_task().filter(|(at, _)| *at < until) {
            // A silent autopilot performs its tasks, too, so that their times stay the same.
            self.mute = self.silent || !self.is_sent(task);
            let task_frames = self.perform(task, at);
            if !self.mute {
                frames.extend(task_frames.into_iter().map(|frame| (at, frame)));
            }
        }
        frames
    }

    /// True if the settings allow the messages of a task.
    fn is_sent(&self, task: Task) -> bool {
        match (self.settings.only, task) {
            (None, _) | (_, Task::Answer | Task::Ask(_)) => true,
            (Some(only), Task::Status) => only == Only::Status,
            (Some(only), Task::Command | Task::Motors) => only == Only::Commands,
            (Some(_), Task::Arming) => false,
        }
    }

    /// The next task and its time. Of tasks at the same time, the first in this list.
    fn next_task(&self) -> Option<(Cycles, Task)> {
        let is_v0 = self.settings.dialect == Dialect::V0;
        let has_arming = is_v0 && self.settings.profile.arming().is_some();
        let has_motors =
            is_v0 && self.settings.motors > 0 && self.settings.profile.motors().is_some();
        let asked = self.nodes.iter().filter_map(|(id, node)| Some((node.ask_at?, Task::Ask(*id))));
        [(self.next_status_at, Task::Status), (self.next_command_at, Task::Command)]
            .into_iter()
            .chain(has_arming.then_some((self.next_arming_at, Task::Arming)))
            .chain(has_motors.then_some((self.next_motors_at, Task::Motors)))
            .chain(self.answers.front().map(|(at, ..)| (*at, Task::Answer)))
            .chain(asked)
            .min_by_key(|(at, _)| *at)
    }

    /// Performs a task that is due at `at`, sets its next time, and returns its frames.
    fn perform(&mut self, task: Task, at: Cycles) -> Vec<Frame> {
        let profile = self.settings.profile;
        match task {
            Task::Status => {
                self.next_status_at += STATUS_PERIOD;
                if self.settings.dialect == Dialect::Draft {
                    return self.broadcast_in_draft(&self.status_in_draft(at));
                }
                let status = Message::NodeStatus(self.status(at));
                self.broadcast(&status, profile.status_priority())
            }
            Task::Command => {
                self.next_command_at += COMMAND_PERIOD;
                self.commands_sent += u64::from(!self.mute);
                if self.settings.dialect == Dialect::Draft {
                    return self.broadcast_in_draft(&self.command_in_draft(at));
                }
                let command = self.command(at);
                self.broadcast(&command, profile.command_priority())
            }
            Task::Arming => {
                let (period, priority) = profile.arming().unwrap_or((F_CPU_HZ, 0));
                self.next_arming_at += period;
                let mut frames = Vec::new();
                if profile.has_safety_switch() {
                    frames = self.broadcast(&Message::SafetyState(SAFETY_OFF), priority);
                }
                let armed = Message::ArmingStatus(if self.armed { FULLY_ARMED } else { DISARMED });
                frames.extend(self.broadcast(&armed, priority));
                frames
            }
            Task::Motors => {
                self.next_motors_at += COMMAND_PERIOD;
                let Some(Motors { priority, idle }) = profile.motors() else { return Vec::new() };
                self.broadcast(&self.motor_command(at, idle), priority)
            }
            Task::Answer => {
                let (_, frames) = self.answers.pop_front().expect("an answer is due");
                frames
            }
            Task::Ask(destination) => {
                if let Some(node) = self.nodes.get_mut(&destination) {
                    let is_there = at - node.last_status_at <= OFFLINE_TIMEOUT;
                    node.ask_at = is_there.then_some(at + REQUEST_PERIOD);
                }
                let priority = profile.request_priority().unwrap_or(0);
                let source = self.settings.node_id;
                let id =
                    CanId::Service { priority, service_id: 1, request: true, destination, source };
                let transfer_id = self.next_transfer(id);
                frames(id, transfer_id, &Message::NodeInfoRequest)
            }
        }
    }

    fn command(&self, at: Cycles) -> Message {
        let Settings { profile, actuator, moves, command_type, .. } = self.settings;
        let deflection = self.deflection(at);
        if command_type == CommandType::Thesis {
            return Message::ThesisCommand(thesis_position(deflection));
        }
        let Some(array) = profile.array() else {
            return Message::ArrayCommand(vec![self.actuator_command(actuator, deflection)]);
        };
        let all = (0..array.count).map(|index| {
            let id = array.first + index;
            let deflection = match moves {
                Moves::All => self.deflection_ahead(at, f64::from(index) / f64::from(array.count)),
                Moves::One if id == actuator => deflection,
                // Each other actuator holds another position, so that a node that listens to a
                // wrong ID is noticed.
                Moves::One => 2.0 * f64::from(index + 1) / f64::from(array.count + 1) - 1.0,
            };
            // ArduPilot and PX4 calculate a pulse width in whole microseconds first, and convert it
            // to a deflection.
            let pulse_us = (PWM_CENTRE_US + deflection * PWM_HALF_TRAVEL_US).round();
            self.actuator_command(id, (pulse_us - PWM_CENTRE_US) / PWM_HALF_TRAVEL_US)
        });
        Message::ArrayCommand(all.collect())
    }

    /// Motors are off while disarmed. While armed, deflection -1 gives `idle`, and +1 full power.
    fn motor_command(&self, at: Cycles, idle: i16) -> Message {
        let motors = self.settings.motors;
        let command = |index: u8| {
            let deflection = self.deflection_ahead(at, f64::from(index) / f64::from(motors));
            let power = (deflection + 1.0) / 2.0 * f64::from(esc::FULL_POWER);
            if self.armed { (power.round() as i16).max(idle) } else { 0 }
        };
        Message::RawCommand((0..motors).map(command).collect())
    }

    fn actuator_command(&self, actuator: u8, deflection: f64) -> ActuatorCommand {
        let (unit, value) = match self.settings.command_type {
            CommandType::Position => {
                (CommandUnit::Position, deflection * self.settings.position_full_rad)
            }
            CommandType::Pwm => {
                (CommandUnit::Pwm, (PWM_CENTRE_US + deflection * PWM_HALF_TRAVEL_US).round())
            }
            CommandType::Unitless | CommandType::Thesis => (CommandUnit::Unitless, deflection),
        };
        ActuatorCommand { actuator, unit, value: f16::from_f64(value) }
    }

    fn broadcast_id(&self, message: &Message, priority: u8) -> CanId {
        let (data_type, _) = message.encode().expect("only encodable messages are made");
        DataType::message_id(data_type, priority, self.settings.node_id)
    }

    fn broadcast(&mut self, message: &Message, priority: u8) -> Vec<Frame> {
        let id = self.broadcast_id(message, priority);
        // A message that is not sent uses no transfer ID.
        let transfer_id = if self.mute { TransferId::default() } else { self.next_transfer(id) };
        frames(id, transfer_id, message)
    }

    fn next_transfer(&mut self, id: CanId) -> TransferId {
        self.transfers.entry(id).or_default().advance()
    }
}

/// A task of the autopilot that sends messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Task {
    Status,
    Command,
    Arming,
    Motors,
    Answer,
    Ask(NodeId),
}

/// The thesis's byte for a deflection: 0 to 255 over the full travel.
fn thesis_position(deflection: f64) -> u8 {
    ((deflection + 1.0) * 127.5).round() as u8
}

/// The frames of a message.
fn frames(id: CanId, transfer_id: TransferId, message: &Message) -> Vec<Frame> {
    let (_, payload) = message.encode().expect("only encodable messages are made");
    dronecan_host::frames(id, &payload, transfer_id)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dronecan::{Assembler, Outcome};

    fn autopilot(command_type: CommandType) -> Autopilot {
        let settings = Settings { command_type, ..Settings::default() };
        Autopilot::new(settings, 1_000_000)
    }

    /// Messages that `autopilot` sends before `until`.
    fn sent(autopilot: &mut Autopilot, until: Cycles) -> Vec<(Cycles, Message)> {
        let mut assembler = Assembler::new();
        let frames = autopilot.due(until);
        let decode = |(at, frame): (Cycles, Frame)| {
            let crate::can::Id::Extended(id) = frame.id else {
                panic!("standard frame");
            };
            match assembler.push(id, frame.data(), crate::elapsed(at)) {
                Outcome::Complete(transfer) => Some((at, Message::decode(&transfer))),
                Outcome::Partial => None,
                other => panic!("{other:?}"),
            }
        };
        frames.into_iter().filter_map(decode).collect()
    }

    fn like(profile: Profile) -> Autopilot {
        Autopilot::new(Settings::of(profile), 1_000_000)
    }

    /// Lets `autopilot` receive a transfer that ends at `at`.
    fn receive(autopilot: &mut Autopilot, at: Cycles, id: u32, message: &Message) {
        let id = CanId::parse(id).unwrap();
        for frame in frames(id, TransferId::new(7), message) {
            autopilot.receive(at, &frame);
        }
    }

    fn status(uptime_s: u32) -> Message {
        Message::NodeStatus(NodeStatus { uptime_s, ..NodeStatus::default() })
    }

    /// Times, in milliseconds, at which a frame with this identifier is sent before `until`.
    fn times_of(autopilot: &mut Autopilot, id: u32, until: Cycles) -> Vec<u64> {
        let frames = autopilot.due(until).into_iter();
        frames
            .filter(|(_, frame)| frame.id == Id::Extended(id))
            .map(|(at, _)| at * 1000 / F_CPU_HZ)
            .collect()
    }

    fn is_command(message: &Message) -> bool {
        matches!(message, Message::ArrayCommand(_) | Message::ThesisCommand(_))
    }

    #[test]
    fn the_autopilot_sends_one_status_and_fifty_commands_a_second() {
        let mut autopilot = autopilot(CommandType::Unitless);
        let messages = sent(&mut autopilot, 10 * F_CPU_HZ);
        let commands = messages.iter().filter(|(_, m)| is_command(m)).count();
        assert_eq!((messages.len() - commands, commands), (10, 500));
        assert!(messages.is_sorted_by_key(|(at, _)| *at));
    }

    #[test]
    fn the_length_of_the_steps_does_not_change_the_messages() {
        let mut whole = autopilot(CommandType::Unitless);
        let mut pieces = autopilot(CommandType::Unitless);
        let at_once = sent(&mut whole, F_CPU_HZ);
        let stepped: Vec<_> =
            (1..=1000).flat_map(|ms| sent(&mut pieces, ms * F_CPU_HZ / 1000)).collect();
        assert_eq!(at_once, stepped);
    }

    #[test]
    fn uptime_counts_true_seconds() {
        let mut autopilot = autopilot(CommandType::Unitless);
        let uptimes: Vec<u32> = sent(&mut autopilot, 3 * F_CPU_HZ)
            .into_iter()
            .filter_map(|(_, m)| match m {
                Message::NodeStatus(status) => Some(status.uptime_s),
                _ => None,
            })
            .collect();
        assert_eq!(uptimes, [0, 1, 2]);
    }

    #[test]
    fn a_held_position_is_sent_in_each_unit() {
        let cases = [
            (CommandType::Unitless, "ArrayCommand id 1 unitless +0.50"),
            (CommandType::Position, "ArrayCommand id 1 position +0.39 rad"),
            (CommandType::Pwm, "ArrayCommand id 1 PWM 1750 us"),
            (CommandType::Thesis, "thesis.ServoCommand 191"),
        ];
        for (command_type, expected) in cases {
            let mut autopilot = autopilot(command_type);
            autopilot.hold(0.5);
            let messages = sent(&mut autopilot, COMMAND_OFFSET + 1);
            assert_eq!(messages.last().unwrap().1.to_string(), expected);
        }
    }

    #[test]
    fn the_sweep_reaches_both_ends() {
        let autopilot = autopilot(CommandType::Unitless);
        assert_eq!(autopilot.deflection(0), 0.0);
        assert_eq!(autopilot.deflection(F_CPU_HZ), 1.0);
        assert_eq!(autopilot.deflection(3 * F_CPU_HZ), -1.0);
    }

    #[test]
    fn a_sweep_starts_at_the_present_deflection() {
        let mut autopilot = autopilot(CommandType::Unitless);
        autopilot.hold(-0.75);
        autopilot.sweep(12_345);
        assert!((autopilot.deflection(12_345) + 0.75).abs() < 1e-9);
        autopilot.nudge(-0.5, 12_345);
        assert_eq!(autopilot.deflection(99_999), -1.0);
    }

    /// A silenced autopilot must not send its backlog later.
    #[test]
    fn messages_that_are_due_during_silence_are_not_sent_later() {
        let mut autopilot = autopilot(CommandType::Unitless);
        autopilot.set_silent(true);
        assert!(sent(&mut autopilot, 5 * F_CPU_HZ).is_empty());
        autopilot.set_silent(false);
        let messages = sent(&mut autopilot, 6 * F_CPU_HZ);
        assert_eq!(messages.len(), 51);
        assert!(messages.iter().all(|(at, _)| *at >= 5 * F_CPU_HZ));
    }

    #[test]
    fn the_node_id_can_be_changed() {
        let mut autopilot = autopilot(CommandType::Unitless);
        autopilot.set_node_id(NodeId::new(10).unwrap());
        let frames = autopilot.due(1);
        assert_eq!(frames[0].1, Frame::extended(0x1001_550A, frames[0].1.data()));
    }

    #[test]
    fn ardupilot_commands_fifteen_actuators_from_1_with_nine_frames() {
        let mut autopilot = like(Profile::Ardupilot);
        autopilot.hold(0.5);
        let frames: Vec<_> = autopilot.due(COMMAND_OFFSET + 1).split_off(1);
        assert_eq!(frames.len(), 9);
        assert!(
            frames
                .iter()
                .all(|(at, frame)| *at == COMMAND_OFFSET && frame.id == Id::Extended(0x0803_F20A))
        );
        let mut autopilot = like(Profile::Ardupilot);
        autopilot.hold(0.5);
        let Message::ArrayCommand(commands) = sent(&mut autopilot, COMMAND_OFFSET + 1).remove(1).1
        else {
            panic!()
        };
        let ids: Vec<u8> = commands.iter().map(|command| command.actuator).collect();
        assert_eq!(ids, (1..=15).collect::<Vec<u8>>());
        assert!(commands.iter().all(|command| command.unit == CommandUnit::Unitless));
        let values: Vec<f32> = commands.iter().map(|command| command.value.to_f32()).collect();
        assert_eq!(values[0], 0.5);
        assert!(values[1..].is_sorted() && values[1] != values[2]);
    }

    /// The values of the first ArrayCommand.
    fn first_commands(autopilot: &mut Autopilot) -> Vec<f32> {
        let messages = sent(autopilot, COMMAND_OFFSET + 1);
        let Some((_, Message::ArrayCommand(commands))) = messages.last() else {
            panic!("{messages:?}")
        };
        commands.iter().map(|command| command.value.to_f32()).collect()
    }

    #[test]
    fn all_actuators_sweep_each_with_its_own_phase() {
        let all = |profile, motion| {
            let mut autopilot =
                Autopilot::new(Settings { moves: Moves::All, ..Settings::of(profile) }, 1_000_000);
            autopilot.motion = motion;
            first_commands(&mut autopilot)
        };
        let values = all(Profile::Px4, Motion::Sweep { since: COMMAND_OFFSET, phase: 0.0 });
        let expected = [0.0, 0.707, 1.0, 0.707, 0.0, -0.707, -1.0, -0.707];
        assert!(
            values.iter().zip(expected).all(|(value, expected)| (value - expected).abs() < 0.002),
            "{values:?}"
        );
        let mut values = all(Profile::Ardupilot, Motion::Sweep { since: 0, phase: 0.0 });
        values.sort_by(f32::total_cmp);
        values.dedup();
        assert_eq!(values.len(), 15);
        assert_eq!(all(Profile::Ardupilot, Motion::Hold(-0.5)), [-0.5; 15]);
    }

    /// Time in milliseconds and commands of each RawCommand before `until`.
    fn motor_commands(autopilot: &mut Autopilot, until: Cycles) -> Vec<(u64, Vec<i16>)> {
        let plain = |(at, message)| match message {
            Message::RawCommand(commands) => Some((at * 1000 / F_CPU_HZ, commands)),
            _ => None,
        };
        sent(autopilot, until).into_iter().filter_map(plain).collect()
    }

    #[test]
    fn motors_are_off_while_disarmed_and_follow_the_motion_while_armed() {
        for (profile, idle) in [(Profile::Ardupilot, 0), (Profile::Px4, 1)] {
            let mut autopilot =
                Autopilot::new(Settings { motors: 2, ..Settings::of(profile) }, 1_000_000);
            autopilot.hold(-1.0);
            assert_eq!(motor_commands(&mut autopilot, F_CPU_HZ / 50), [(15, vec![idle; 2])]);
            autopilot.hold(1.0);
            assert_eq!(motor_commands(&mut autopilot, F_CPU_HZ / 25), [(35, vec![8191; 2])]);
            autopilot.set_armed(false);
            assert_eq!(motor_commands(&mut autopilot, F_CPU_HZ * 3 / 50), [(55, vec![0; 2])]);
            autopilot.set_armed(true);
            autopilot.motion = Motion::Sweep { since: F_CPU_HZ * 75 / 1000, phase: 0.25 };
            assert_eq!(motor_commands(&mut autopilot, F_CPU_HZ / 10)[0], (75, vec![8191, idle]));
            assert_eq!(motor_commands(&mut autopilot, F_CPU_HZ * 11 / 10).len(), 50);
        }
    }

    #[test]
    fn motors_are_commanded_with_the_priority_of_the_profile_and_only_if_there_are_any() {
        for (profile, motors, id, frames) in [
            (Profile::Ardupilot, 20, 0x0704_060A, 6),
            (Profile::ArdupilotPwm, 4, 0x0704_060A, 1),
            (Profile::Px4, 8, 0x0004_0601, 3),
            (Profile::Px4, 0, 0x0004_0601, 0),
            (Profile::Plain, 4, 0x0004_0601, 0),
        ] {
            let mut autopilot =
                Autopilot::new(Settings { motors, ..Settings::of(profile) }, 1_000_000);
            assert_eq!(
                times_of(&mut autopilot, id, F_CPU_HZ / 50),
                vec![15; frames],
                "{profile:?}"
            );
            assert!(motors <= profile.motors_max() || profile.motors().is_none());
        }
        let mut autopilot = Autopilot::new(
            Settings { motors: 4, ..Settings::of(Profile::Px4) }.in_dialect(Dialect::Draft),
            1_000_000,
        );
        assert!(
            autopilot.due(F_CPU_HZ).iter().all(|(_, frame)| frame.id != Id::Extended(0x0004_0601))
        );
    }

    #[test]
    fn ardupilot_can_command_pulse_widths() {
        let mut autopilot = like(Profile::ArdupilotPwm);
        autopilot.hold(-0.5);
        let messages = sent(&mut autopilot, COMMAND_OFFSET + 1);
        assert!(
            messages[1].1.to_string().starts_with("ArrayCommand id 1 PWM 1250 us, id 2 PWM "),
            "{messages:?}"
        );
    }

    #[test]
    fn ardupilot_sends_arming_status_twice_a_second() {
        let mut autopilot = like(Profile::Ardupilot);
        let of_a_second = |autopilot: &mut Autopilot, second| {
            let messages = sent(autopilot, second * F_CPU_HZ).into_iter();
            messages
                .map(|(_, message)| message.to_string())
                .filter(|text| !text.starts_with("ArrayC"))
                .collect::<Vec<_>>()
        };
        let expected = [
            "NodeStatus OK OPERATIONAL up 0 s vendor 0x0000",
            "SafetyState off",
            "ArmingStatus armed",
        ];
        assert_eq!(of_a_second(&mut autopilot, 1), [&expected[..], &expected[1..]].concat());
        autopilot.set_armed(false);
        assert_eq!(of_a_second(&mut autopilot, 2)[2], "ArmingStatus disarmed");
        assert_eq!(times_of(&mut autopilot, 0x1804_4C0A, 3 * F_CPU_HZ), [2012, 2512]);
        assert_eq!(times_of(&mut autopilot, 0x1F01_550A, 4 * F_CPU_HZ), [3000]);
    }

    #[test]
    fn px4_commands_eight_actuators_from_0_with_five_frames() {
        let mut autopilot =
            Autopilot::new(Settings { actuator: 0, ..Settings::of(Profile::Px4) }, 1_000_000);
        autopilot.hold(-1.0);
        let frames = autopilot.due(COMMAND_OFFSET + 1).split_off(1);
        assert_eq!(frames.len(), 5);
        assert!(frames.iter().all(|(_, frame)| frame.id == Id::Extended(0x0603_F201)));
        let messages = sent(&mut autopilot, COMMAND_OFFSET + COMMAND_PERIOD + 1);
        let Some((_, Message::ArrayCommand(commands))) = messages.last() else {
            panic!("{messages:?}")
        };
        assert_eq!((commands.len(), commands[0].actuator, commands[7].actuator), (8, 0, 7));
        assert_eq!(commands[0].value.to_f32(), -1.0);
    }

    #[test]
    fn a_new_node_gets_get_node_info_requests_until_it_responds() {
        let mut autopilot = like(Profile::Ardupilot);
        const REQUEST: u32 = 0x1001_F88A;
        receive(&mut autopilot, 16_000, 0x1801_5578, &status(0));
        assert_eq!(times_of(&mut autopilot, REQUEST, 2 * F_CPU_HZ + F_CPU_HZ / 2), [3, 1003, 2003]);
        let info = NodeInfo { name: b"org.example.servo".to_vec(), ..NodeInfo::default() };
        receive(&mut autopilot, 2 * F_CPU_HZ, 0x1001_0AF8, &Message::NodeInfo(Box::new(info)));
        assert_eq!(times_of(&mut autopilot, REQUEST, 4 * F_CPU_HZ), []);
        let events = autopilot.take_events();
        assert!(events[0].1.starts_with("120 is org.example.servo software 0.0"), "{events:?}");
        // The same node without, then with a restart.
        receive(&mut autopilot, 3 * F_CPU_HZ, 0x1801_5578, &status(3));
        assert_eq!(times_of(&mut autopilot, REQUEST, 5 * F_CPU_HZ), []);
        receive(&mut autopilot, 5 * F_CPU_HZ, 0x1801_5578, &status(0));
        assert_eq!(times_of(&mut autopilot, REQUEST, 5 * F_CPU_HZ + F_CPU_HZ / 2), [5002]);
    }

    #[test]
    fn a_node_that_is_offline_gets_no_more_requests() {
        let mut autopilot = like(Profile::Px4);
        receive(&mut autopilot, 0, 0x1801_5578, &status(0));
        assert_eq!(times_of(&mut autopilot, 0x1E01_F881, 20 * F_CPU_HZ), [2, 1002, 2002, 3002]);
    }

    #[test]
    fn the_autopilot_answers_get_node_info() {
        let mut autopilot = like(Profile::Px4);
        receive(&mut autopilot, F_CPU_HZ, 0x1E01_81FF, &Message::NodeInfoRequest);
        let messages = sent(&mut autopilot, 2 * F_CPU_HZ);
        let (at, answer) =
            messages.iter().find(|(_, message)| matches!(message, Message::NodeInfo(_))).unwrap();
        assert_eq!(*at, F_CPU_HZ + ANSWER_DELAY);
        assert!(answer.to_string().starts_with("GetNodeInfo response org.pixhawk.px4"), "{answer}");
    }

    #[test]
    fn the_autopilot_allocates_node_ids_only_if_it_is_set_to() {
        for allocates in [false, true] {
            let mut autopilot =
                Autopilot::new(Settings { allocates, ..Settings::default() }, 1_000_000);
            let mut answers = Vec::new();
            for (first, len, at) in [(0, 6, 100), (6, 6, 300), (12, 4, 500)] {
                let request = Allocation {
                    node_id: 0,
                    first_part: first == 0,
                    unique_id: (first..first + len).collect(),
                };
                receive(&mut autopilot, at * 16_000, 0x1E97_4D00, &Message::Allocation(request));
                let messages = sent(&mut autopilot, (at + 100) * 16_000).into_iter();
                answers.extend(
                    messages.filter(|(_, message)| matches!(message, Message::Allocation(_))),
                );
            }
            let texts: Vec<_> =
                answers.iter().map(|(at, message)| format!("{} {message}", at / 16_000)).collect();
            let expected = [
                "102 Allocation unique ID 000102030405",
                "302 Allocation unique ID 000102030405060708090A0B",
                "502 Allocation node ID 125 unique ID 000102030405060708090A0B0C0D0E0F",
            ];
            assert_eq!(texts, if allocates { &expected[..] } else { &[] });
            assert_eq!(autopilot.take_events().len(), usize::from(allocates));
        }
    }

    #[test]
    fn the_next_command_type_is_one_of_the_profile() {
        let mut autopilot = autopilot(CommandType::Thesis);
        autopilot.next_command_type();
        assert_eq!(autopilot.settings().command_type, CommandType::Unitless);
        let mut autopilot = like(Profile::Ardupilot);
        autopilot.next_command_type();
        assert_eq!(autopilot.settings().command_type, CommandType::Unitless);
    }

    fn in_draft(profile: Profile, only: Option<Only>) -> Autopilot {
        let settings = Settings { only, ..Settings::of(profile).in_dialect(Dialect::Draft) };
        Autopilot::new(settings, 1_000_000)
    }

    /// Frames that `autopilot` sends before `until`, in candump's notation.
    fn frames_of(autopilot: &mut Autopilot, until: Cycles) -> Vec<String> {
        autopilot.due(until).into_iter().map(|(_, frame)| frame.to_string()).collect()
    }

    #[test]
    fn in_the_draft_the_status_and_the_commands_are_frames_of_the_draft() {
        let mut autopilot = in_draft(Profile::Plain, None);
        autopilot.hold(0.5);
        let frames = frames_of(&mut autopilot, 2 * F_CPU_HZ);
        assert_eq!(frames[..3], ["11340408#000000000000", "084C0408#010038", "084C0409#010038"]);
        assert_eq!(frames[51], "11340409#010000000000");
        assert_eq!(frames.iter().filter(|frame| frame.starts_with("1134")).count(), 2);
        assert_eq!(frames.iter().filter(|frame| frame.starts_with("084C")).count(), 100);
        // After the eight transfer IDs of the draft comes the first again.
        assert_eq!(
            (frames[8].as_str(), frames[9].as_str()),
            ("084C040F#010038", "084C0408#010038")
        );
    }

    #[test]
    fn the_autopilot_of_the_thesis_commands_one_byte_in_the_draft() {
        let mut autopilot = in_draft(Profile::Thesis, None);
        for (deflection, expected) in [(-1.0, "00"), (0.0, "80"), (1.0, "FF")] {
            autopilot.hold(deflection);
            let until = autopilot.next_command_at + 1;
            let frame = frames_of(&mut autopilot, until).pop().unwrap();
            assert_eq!(&frame[..8], format!("17C4040{:X}", 8 + autopilot.commands_sent() - 1));
            assert_eq!(&frame[9..], expected);
        }
    }

    #[test]
    fn the_autopilot_can_send_only_its_status_or_only_commands_in_either_dialect() {
        let sent = |settings: Settings| {
            let mut autopilot = Autopilot::new(settings, 1_000_000);
            let frames = autopilot.due(2 * F_CPU_HZ);
            let commands = autopilot.commands_sent();
            (frames.len(), commands, frames[1].1.to_string())
        };
        for (dialect, status, command) in [
            (Dialect::V0, "10015501#01000000000000C1", "0803F201#"),
            (Dialect::Draft, "11340409#010000000000", "084C0409#"),
        ] {
            let with =
                |only| Settings { only: Some(only), ..Settings::default().in_dialect(dialect) };
            assert_eq!(sent(with(Only::Status)), (2, 0, String::from(status)));
            let (frames, commands, text) = sent(with(Only::Commands));
            assert_eq!((frames, commands), (100, 100));
            assert!(text.starts_with(command), "{text}");
        }
        let only = Settings { only: Some(Only::Status), ..Settings::of(Profile::Ardupilot) };
        assert_eq!(sent(only).0, 2, "no ArmingStatus");
    }

    #[test]
    fn the_autopilot_answers_get_node_info_in_its_dialect_and_ignores_the_other() {
        for (profile, request) in [(Profile::Px4, "1E0181FF#C7"), (Profile::Plain, "113BFC08#01")] {
            for dialect in [Dialect::V0, Dialect::Draft] {
                let mut autopilot =
                    Autopilot::new(Settings::of(profile).in_dialect(dialect), 1_000_000);
                autopilot.set_silent(false);
                autopilot.receive(F_CPU_HZ, &request.parse().unwrap());
                let asked_in = if request.starts_with("1E") { Dialect::V0 } else { Dialect::Draft };
                assert_eq!(
                    autopilot.answers.len(),
                    usize::from(dialect == asked_in),
                    "{request} {dialect}"
                );
            }
        }
        let mut autopilot = in_draft(Profile::Plain, None);
        autopilot.receive(F_CPU_HZ, &"113BFC0D#01".parse().unwrap());
        let (at, frames) = autopilot.answers.pop_front().unwrap();
        assert_eq!(at, F_CPU_HZ + ANSWER_DELAY);
        // To 127, from 1, with the transfer ID of the request; the uptime is one second.
        assert_eq!(frames[0].id, Id::Extended(0x1138_0405));
        assert_eq!(frames[0].data()[..1], [0x7F]);
        assert_eq!(frames[0].data()[3..8], [1, 0, 0, 0, 0]);
        let text: Vec<u8> = frames.iter().flat_map(|frame| frame.data()[1..].to_vec()).collect();
        assert!(text.ends_with(b"org.example.autopilot"), "{frames:?}");
    }

    #[test]
    fn an_autopilot_that_starts_later_has_uptime_0_and_sends_nothing_before() {
        let mut autopilot = Autopilot::powered(Settings::default(), 1_000_000, 10 * F_CPU_HZ);
        let messages = sent(&mut autopilot, 12 * F_CPU_HZ);
        assert_eq!(messages.len(), 2 + 100);
        assert!(messages.iter().all(|(at, _)| *at >= 10 * F_CPU_HZ));
        assert_eq!(messages[0].1, status(0));
        assert_eq!(messages[51].1, status(1));
    }

    #[test]
    fn settings_keep_what_the_other_dialect_has() {
        let settings = Settings { actuator: 3, ..Settings::of(Profile::ArdupilotPwm) }
            .in_dialect(Dialect::Draft);
        assert_eq!(
            (settings.profile, settings.command_type),
            (Profile::Plain, CommandType::Unitless)
        );
        assert_eq!((settings.actuator, settings.node_id.get()), (3, 10));
        let settings =
            Settings::of(Profile::Thesis).in_dialect(Dialect::Draft).in_dialect(Dialect::V0);
        assert_eq!(
            (settings.profile, settings.command_type),
            (Profile::Thesis, CommandType::Thesis)
        );
        let mut autopilot = in_draft(Profile::Plain, None);
        let types = [(); 3].map(|()| {
            autopilot.next_command_type();
            autopilot.settings().command_type
        });
        assert_eq!(types, [CommandType::Thesis, CommandType::Unitless, CommandType::Thesis]);
    }
}
