//! A simulated autopilot: the part of a flight controller that the node sees.
//!
//! It says that it is alive (NodeStatus, 1 Hz) and commands one servo at 50 Hz, in a unit of choice, sweeping or held.
//! Its clock is the simulated one, and each frame is queued for its exact time, so that a run can be repeated. It also
//! listens, as a real one does.
//!
//! Limits: one actuator; it does not answer services and does not allocate node IDs.

use crate::can::{Frame, SoftNode, StationRef};
use crate::dronecan::{ActuatorCommand, CommandUnit, Message, NodeId, NodeStatus, TransferId, split};
use crate::{Cycles, F_CPU_HZ};
use half::f16;
use std::cell::RefCell;
use std::f64::consts::{FRAC_PI_2, TAU};
use std::fmt;
use std::rc::Rc;

/// NodeStatus at the rate that the dialect demands as a minimum.
const STATUS_PERIOD: Cycles = F_CPU_HZ;
/// Servo output rate of ArduPilot's and PX4's DroneCAN drivers by default.
const COMMAND_PERIOD: Cycles = F_CPU_HZ / 50;
/// First command: not at the same time as a status, so that both are never due in the same cycle.
const COMMAND_OFFSET: Cycles = F_CPU_HZ / 200;
/// ArduPilot's priority for NodeStatus is lower than for actuators; these are its classes.
const STATUS_PRIORITY: u8 = 16;
const COMMAND_PRIORITY: u8 = 8;

/// Centre and half travel of a PWM command, in microseconds: the usual 1000 to 2000.
const PWM_CENTRE_US: f64 = 1500.0;
const PWM_HALF_TRAVEL_US: f64 = 500.0;

/// Frames that may wait for the bus: a status and a command or two.
const OVERDUE_MAX: usize = 3;

/// How commands are expressed.
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

impl CommandType {
    /// The next in turn.
    pub fn next(self) -> CommandType {
        match self {
            CommandType::Unitless => CommandType::Position,
            CommandType::Position => CommandType::Pwm,
            CommandType::Pwm => CommandType::Thesis,
            CommandType::Thesis => CommandType::Unitless,
        }
    }
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

/// Where the servo is told to go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// A sine over the full travel; `phase` in turns is where it stands at `since`.
    Sweep { since: Cycles, phase: f64 },
    /// -1 to +1.
    Hold(f64),
}

/// What the autopilot is set to.
#[derive(Clone, Debug)]
pub struct Settings {
    pub node_id: NodeId,
    /// Actuator that it commands.
    pub actuator: u8,
    pub command_type: CommandType,
    /// Time of one sweep there and back.
    pub sweep_period: Cycles,
    /// Angle of full deflection for position commands, in radians.
    pub position_full_rad: f64,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            node_id: NodeId::new(1).expect("1 is a node ID"),
            actuator: 1,
            command_type: CommandType::Unitless,
            sweep_period: 4 * F_CPU_HZ,
            position_full_rad: FRAC_PI_2 / 2.0,
        }
    }
}

/// The autopilot and its place on the bus.
pub struct Autopilot {
    station: Rc<RefCell<SoftNode>>,
    settings: Settings,
    motion: Motion,
    silent: bool,
    next_status_at: Cycles,
    next_command_at: Cycles,
    status_transfer: TransferId,
    array_transfer: TransferId,
    thesis_transfer: TransferId,
    commands_sent: u64,
}

impl Autopilot {
    /// An autopilot that starts at time 0, sweeping.
    pub fn new(settings: Settings, bit_rate: u32) -> Autopilot {
        Autopilot {
            station: Rc::new(RefCell::new(SoftNode::new(bit_rate))),
            settings,
            motion: Motion::Sweep { since: 0, phase: 0.0 },
            silent: false,
            next_status_at: 0,
            next_command_at: COMMAND_OFFSET,
            status_transfer: TransferId::default(),
            array_transfer: TransferId::default(),
            thesis_transfer: TransferId::default(),
            commands_sent: 0,
        }
    }

    /// Its end of the bus, to be attached.
    pub fn station(&self) -> StationRef {
        self.station.clone()
    }

    /// What it is set to.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Frames that it has heard since the last call, with the time of their end.
    pub fn take_received(&mut self) -> Vec<(Cycles, Frame)> {
        self.station.borrow_mut().take_received()
    }

    /// Commands queued so far.
    pub fn commands_sent(&self) -> u64 {
        self.commands_sent
    }

    /// Whether it sends nothing at all.
    pub fn is_silent(&self) -> bool {
        self.silent
    }

    /// Stops or resumes sending. Time goes on meanwhile: nothing is made up for afterwards.
    pub fn set_silent(&mut self, silent: bool) {
        self.silent = silent;
    }

    /// Changes its identity, as a user of a ground station may.
    pub fn set_node_id(&mut self, id: NodeId) {
        self.settings.node_id = id;
    }

    /// Changes the unit of the commands to come.
    pub fn set_command_type(&mut self, command_type: CommandType) {
        self.settings.command_type = command_type;
    }

    /// Whether it sweeps.
    pub fn is_sweeping(&self) -> bool {
        matches!(self.motion, Motion::Sweep { .. })
    }

    /// Starts a sweep at `now` from where the servo is, without a jump.
    pub fn sweep(&mut self, now: Cycles) {
        let phase = self.deflection(now).asin() / TAU;
        self.motion = Motion::Sweep { since: now, phase };
    }

    /// Holds one deflection, limited to -1..=1.
    pub fn hold(&mut self, deflection: f64) {
        self.motion = Motion::Hold(deflection.clamp(-1.0, 1.0));
    }

    /// Moves by `step` from where it is at `now`, and holds there.
    pub fn nudge(&mut self, step: f64, now: Cycles) {
        self.hold(self.deflection(now) + step);
    }

    /// Commanded deflection at `now`, -1 to +1.
    pub fn deflection(&self, now: Cycles) -> f64 {
        match self.motion {
            Motion::Hold(deflection) => deflection,
            Motion::Sweep { since, phase } => {
                let turns = now.saturating_sub(since) as f64 / self.settings.sweep_period.max(1) as f64;
                ((turns + phase) * TAU).sin()
            }
        }
    }

    /// Queues everything that is due before `until`, each for its exact time. To be called when the bus has come to the
    /// `until` of the call before.
    pub fn advance(&mut self, until: Cycles) {
        // A controller does not send stale commands after the bus was blocked: what waits too long is given up.
        if self.station.borrow().queued() > OVERDUE_MAX {
            self.station.borrow_mut().clear_queue();
        }
        for (at, frame) in self.due(until) {
            self.station.borrow_mut().send_at(at, frame);
        }
    }

    /// Frames due before `until`, in order of time.
    fn due(&mut self, until: Cycles) -> Vec<(Cycles, Frame)> {
        let mut frames = Vec::new();
        loop {
            let at = self.next_status_at.min(self.next_command_at);
            if at >= until {
                return frames;
            }
            if at == self.next_status_at {
                self.next_status_at += STATUS_PERIOD;
                if !self.silent {
                    self.status(at, &mut frames);
                }
            } else {
                self.next_command_at += COMMAND_PERIOD;
                if !self.silent {
                    self.command(at, &mut frames);
                }
            }
        }
    }

    fn status(&mut self, at: Cycles, frames: &mut Vec<(Cycles, Frame)>) {
        let uptime_s = u32::try_from(at / F_CPU_HZ).unwrap_or(u32::MAX);
        let status = Message::NodeStatus(NodeStatus { uptime_s, ..NodeStatus::default() });
        let transfer = self.status_transfer.advance();
        self.broadcast(&status, transfer, STATUS_PRIORITY, at, frames);
    }

    fn command(&mut self, at: Cycles, frames: &mut Vec<(Cycles, Frame)>) {
        let deflection = self.deflection(at);
        let array = |unit, value: f64| {
            Message::ArrayCommand(vec![ActuatorCommand {
                actuator: self.settings.actuator,
                unit,
                value: f16::from_f64(value),
            }])
        };
        let message = match self.settings.command_type {
            CommandType::Unitless => array(CommandUnit::Unitless, deflection),
            CommandType::Position => {
                let angle_rad = deflection * self.settings.position_full_rad;
                array(CommandUnit::Position, angle_rad)
            }
            CommandType::Pwm => {
                let pulse_us = PWM_CENTRE_US + deflection * PWM_HALF_TRAVEL_US;
                array(CommandUnit::Pwm, pulse_us.round())
            }
            CommandType::Thesis => Message::ThesisCommand(((deflection + 1.0) * 127.5).round() as u8),
        };
        let transfer = match self.settings.command_type {
            CommandType::Thesis => self.thesis_transfer.advance(),
            _ => self.array_transfer.advance(),
        };
        self.commands_sent += 1;
        self.broadcast(&message, transfer, COMMAND_PRIORITY, at, frames);
    }

    fn broadcast(
        &self,
        message: &Message,
        transfer: TransferId,
        priority: u8,
        at: Cycles,
        frames: &mut Vec<(Cycles, Frame)>,
    ) {
        let (data_type, payload) = message.encode().expect("only encodable messages are made");
        let id = data_type.message_id(priority, self.settings.node_id).build();
        let data = split(&payload, transfer, data_type.signature.unwrap_or(0));
        frames.extend(data.iter().map(|data| (at, Frame::extended(id, data))));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dronecan::{Assembler, Outcome};

    fn autopilot(command_type: CommandType) -> Autopilot {
        let settings = Settings { command_type, ..Settings::default() };
        Autopilot::new(settings, 1_000_000)
    }

    /// What it sends before `until`.
    fn sent(autopilot: &mut Autopilot, until: Cycles) -> Vec<(Cycles, Message)> {
        let mut assembler = Assembler::new();
        let frames = autopilot.due(until);
        let decode = |(at, frame): (Cycles, Frame)| {
            let crate::can::Id::Extended(id) = frame.id else {
                panic!("standard frame");
            };
            match assembler.push(id, frame.data(), at) {
                Outcome::Complete(transfer) => (at, Message::decode(&transfer)),
                other => panic!("{other:?}"),
            }
        };
        frames.into_iter().map(decode).collect()
    }

    fn is_command(message: &Message) -> bool {
        matches!(message, Message::ArrayCommand(_) | Message::ThesisCommand(_))
    }

    #[test]
    fn status_comes_once_and_commands_fifty_times_a_second() {
        let mut autopilot = autopilot(CommandType::Unitless);
        let messages = sent(&mut autopilot, 10 * F_CPU_HZ);
        let commands = messages.iter().filter(|(_, m)| is_command(m)).count();
        assert_eq!((messages.len() - commands, commands), (10, 500));
        assert!(messages.is_sorted_by_key(|(at, _)| *at));
    }

    /// The same messages come out, however the time is cut.
    #[test]
    fn steps_do_not_change_what_is_sent() {
        let mut whole = autopilot(CommandType::Unitless);
        let mut pieces = autopilot(CommandType::Unitless);
        let at_once = sent(&mut whole, F_CPU_HZ);
        let stepped: Vec<_> = (1..=1000).flat_map(|ms| sent(&mut pieces, ms * F_CPU_HZ / 1000)).collect();
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
    fn a_held_position_is_said_in_each_unit() {
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
    fn a_sweep_starts_where_the_servo_is() {
        let mut autopilot = autopilot(CommandType::Unitless);
        autopilot.hold(-0.75);
        autopilot.sweep(12_345);
        assert!((autopilot.deflection(12_345) + 0.75).abs() < 1e-9);
        autopilot.nudge(-0.5, 12_345);
        assert_eq!(autopilot.deflection(99_999), -1.0);
    }

    /// A silenced autopilot must not send its backlog later.
    #[test]
    fn silence_loses_messages_and_keeps_the_clock() {
        let mut autopilot = autopilot(CommandType::Unitless);
        autopilot.set_silent(true);
        assert!(sent(&mut autopilot, 5 * F_CPU_HZ).is_empty());
        autopilot.set_silent(false);
        let messages = sent(&mut autopilot, 6 * F_CPU_HZ);
        assert_eq!(messages.len(), 51);
        assert!(messages.iter().all(|(at, _)| *at >= 5 * F_CPU_HZ));
    }

    #[test]
    fn its_identity_can_be_changed() {
        let mut autopilot = autopilot(CommandType::Unitless);
        autopilot.set_node_id(NodeId::new(10).unwrap());
        let frames = autopilot.due(1);
        assert_eq!(frames[0].1, Frame::extended(0x1001_550A, frames[0].1.data()));
    }
}
