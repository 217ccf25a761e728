//! A simulated autopilot: a flight controller as far as it communicates with the node.
//!
//! The autopilot sends NodeStatus at 1 Hz and commands servos at 50 Hz. One servo or all of them
//! sweep, or hold a position. On demand it commands motors, too. They are off while disarmed, and
//! follow the same motion while armed. Its [`Profile`] decides which further messages it sends:
//! `sim/bench/tests/autopilot_types.rs` compares them with recordings of the real ones. It
//! answers GetNodeInfo, and on demand it allocates node IDs ([`Allocator`]). It uses one dialect,
//! and ignores the other.
//!
//! The autopilot uses simulated time and queues each frame for its exact time, so that a run can be
//! repeated. It sends each answer a fixed time after the request.
//!
//! Limits: it queues all frames of a transfer at once.

mod allocator;
mod in_draft;
mod profile;
mod receive;
mod send;
#[cfg(test)]
mod tests;

pub use allocator::Allocator;
pub use profile::Profile;

use crate::can::{Frame, PortId, SoftNode, StationRef};
use crate::dronecan::{CanId, Dialect, Message, NodeId, Observer, TransferId, draft};
use crate::{Bench, Cycles, F_CPU_HZ};
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
/// Time of the first NotifyState, GetEscID and GlobalTimeSync.
const NOTIFY_OFFSET: Cycles = F_CPU_HZ / 125;
const ESC_ID_OFFSET: Cycles = F_CPU_HZ * 9 / 1000;
const TIME_SYNC_OFFSET: Cycles = F_CPU_HZ * 3 / 500;
/// Time of the first hardpoint.Command, BasicID and LightsCommand.
const HARDPOINT_OFFSET: Cycles = F_CPU_HZ * 11 / 1000;
const IDENTITY_OFFSET: Cycles = F_CPU_HZ * 17 / 1000;
const LIGHTS_OFFSET: Cycles = F_CPU_HZ * 19 / 1000;
/// Time of the first GetNodeInfo to a known node.
const VERIFY_OFFSET: Cycles = F_CPU_HZ * 5;
/// Commands for motors a second without [`Settings::motor_rate_hz`]: ArduPlane's.
const MOTOR_RATE_HZ: u32 = 50;

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

/// Priority of ArduPilot's GetSet requests: libcanard's medium.
const PARAMETER_PRIORITY: u8 = 16;

/// Values of ArmingStatus.
const FULLY_ARMED: u8 = 255;
const DISARMED: u8 = 0;

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
    /// Number of actuators in each ArrayCommand of a profile that commands several, from its first
    /// ID on; with 0 it sends none.
    pub servos: u8,
    /// Number of motors to command, from index 0 on. The draft has no command for motors.
    pub motors: u8,
    /// Commands for motors a second, 1 to 400.
    pub motor_rate_hz: u32,
    /// True if, while disarmed, ArrayCommand leaves out the actuators that move, and no RawCommand
    /// is sent. ArduPilot leaves out channels without a pulse, as the throttle with
    /// `ARMING_REQUIRE` 2 (AP_DroneCAN.cpp:941-949 at 90700977c5), and sends no RawCommand if none
    /// of its channels has one.
    pub omits_disarmed: bool,
    pub command_type: CommandType,
    /// Time of one sweep, there and back.
    pub sweep_period: Cycles,
    /// Angle of full deflection for position commands, in radians.
    pub position_full_rad: f64,
    /// Parameter that the autopilot reads from each new node by its name, as ArduPilot does for its
    /// scripts and drivers (AP_DroneCAN::get_parameter_on_node).
    pub parameter: Option<String>,
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
            servos: profile.array().map_or(0, |array| array.count),
            motors: 0,
            motor_rate_hz: MOTOR_RATE_HZ,
            omits_disarmed: false,
            command_type: profile.command_types(dialect)[0],
            sweep_period: 4 * F_CPU_HZ,
            position_full_rad: FRAC_PI_2 / 2.0,
            parameter: None,
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
    /// True if the response was reported as an event.
    is_reported: bool,
}

/// An autopilot and its station on the bus.
pub struct Autopilot {
    station: Rc<RefCell<SoftNode>>,
    settings: Settings,
    powered_at: Cycles,
    motion: Motion,
    /// Deflections of actuators that do not follow the motion.
    held: BTreeMap<u8, f64>,
    /// Powers of motors that do not follow the motion.
    held_motors: BTreeMap<u8, f64>,
    silent: bool,
    /// True while a task runs whose frames are not sent.
    mute: bool,
    armed: bool,
    /// True if the safety switch is on.
    safe: bool,
    next_status_at: Cycles,
    next_command_at: Cycles,
    next_arming_at: Cycles,
    next_motors_at: Cycles,
    next_notify_at: Cycles,
    next_esc_id_at: Cycles,
    next_time_sync_at: Cycles,
    next_hardpoint_at: Cycles,
    next_identity_at: Cycles,
    next_lights_at: Cycles,
    next_verify_at: Cycles,
    /// Node that was verified last.
    verified: Option<NodeId>,
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
            held: BTreeMap::new(),
            held_motors: BTreeMap::new(),
            silent: false,
            mute: false,
            armed: true,
            safe: false,
            next_status_at: now,
            next_command_at: now + COMMAND_OFFSET,
            next_arming_at: now + ARMING_OFFSET,
            next_motors_at: now + MOTORS_OFFSET,
            next_notify_at: now + NOTIFY_OFFSET,
            next_esc_id_at: now + ESC_ID_OFFSET,
            next_time_sync_at: now + TIME_SYNC_OFFSET,
            next_hardpoint_at: now + HARDPOINT_OFFSET,
            next_identity_at: now + IDENTITY_OFFSET,
            next_lights_at: now + LIGHTS_OFFSET,
            next_verify_at: now + VERIFY_OFFSET,
            verified: None,
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

    /// Replaces the autopilot at a port of a bench by one with other settings that starts now, with
    /// the motion, arming and silence of the old one.
    pub fn replace(&mut self, settings: Settings, bench: &mut Bench, port: &mut PortId) {
        let (motion, held, held_motors) =
            (self.motion, self.held.clone(), self.held_motors.clone());
        let (silent, armed, safe) = (self.silent, self.armed, self.safe);
        let new = Autopilot {
            motion,
            held,
            held_motors,
            silent,
            armed,
            safe,
            ..Autopilot::powered(settings, bench.bus().bit_rate(), bench.now())
        };
        let new_port = bench.attach("autopilot", new.station());
        bench.detach(std::mem::replace(port, new_port));
        std::mem::replace(self, new).switch_off();
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

    /// True if the safety switch is on. Only some profiles send SafetyState.
    pub fn is_safe(&self) -> bool {
        self.safe
    }

    /// Turns the safety switch on or off.
    pub fn set_safe(&mut self, safe: bool) {
        self.safe = safe;
    }

    /// Commands so many motors from `now` on.
    pub fn set_motors(&mut self, motors: u8, now: Cycles) {
        self.settings.motors = motors;
        self.next_motors_at = self.next_motors_at.max(now);
    }

    /// Holds a motor at a power, 0 to 1, until the next sweep. It is off while disarmed all the
    /// same.
    pub fn hold_motor(&mut self, index: u8, power: f64) {
        self.held_motors.insert(index, power.clamp(0.0, 1.0));
    }

    /// Commanded power of a motor at `at`, 0 to 1, while armed.
    pub fn motor_power(&self, index: u8, at: Cycles) -> f64 {
        let ahead = f64::from(index) / f64::from(self.settings.motors.max(1));
        let moving = || (self.deflection_ahead(at, ahead) + 1.0) / 2.0;
        self.held_motors.get(&index).copied().unwrap_or_else(moving)
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
        self.held.clear();
        self.held_motors.clear();
    }

    /// Holds one actuator at a deflection, limited to -1..=1, until the next sweep. The others go
    /// on.
    pub fn hold_actuator(&mut self, actuator: u8, deflection: f64) {
        self.held.insert(actuator, deflection.clamp(-1.0, 1.0));
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

    /// Commanded deflection at `now` of the actuator of the settings: held, or moving.
    fn own_deflection(&self, now: Cycles) -> f64 {
        let held = self.held.get(&self.settings.actuator);
        held.copied().unwrap_or_else(|| self.deflection(now))
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
        let frames_each = usize::from(self.settings.servos.max(1) + self.settings.motors);
        if self.station.borrow().queued() > OVERDUE_MAX * frames_each {
            self.station.borrow_mut().clear_queue();
        }
        for (at, frame) in self.due(until) {
            self.station.borrow_mut().send_at(at, frame);
        }
    }
}

/// The frames of a message.
fn frames(id: CanId, transfer_id: TransferId, message: &Message) -> Vec<Frame> {
    let (_, payload) = message.encode().expect("only encodable messages are made");
    dronecan_host::frames(id, &payload, transfer_id)
}
