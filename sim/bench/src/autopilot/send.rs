//! What the autopilot sends, and when.

use super::profile::Motors;
use super::{
    Autopilot, COMMAND_PERIOD, CommandType, DISARMED, FULLY_ARMED, Known, Moves, OFFLINE_TIMEOUT,
    Only, PWM_CENTRE_US, PWM_HALF_TRAVEL_US, REQUEST_PERIOD, STATUS_PERIOD, Settings, frames,
};
use crate::can::Frame;
use crate::dronecan::{
    ActuatorCommand, CanId, CommandUnit, DataType, Dialect, HardpointCommand, LightCommand,
    Message, NodeId, TransferId, esc, types,
};
use crate::{Cycles, F_CPU_HZ};
use half::f16;

impl Autopilot {
    /// Frames due before `until`, in order of time.
    pub(super) fn due(&mut self, until: Cycles) -> Vec<(Cycles, Frame)> {
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
            (None, _) | (_, Task::Answer | Task::Ask(_) | Task::Verify) => true,
            (Some(only), Task::Status) => only == Only::Status,
            (Some(only), Task::Command | Task::Motors) => only == Only::Commands,
            (Some(_), _) => false,
        }
    }

    /// The next task and its time. Of tasks at the same time, the first in this list.
    fn next_task(&self) -> Option<(Cycles, Task)> {
        let is_v0 = self.settings.dialect == Dialect::V0;
        let profile = self.settings.profile;
        let also = |is_sent: bool, at, task| (is_v0 && is_sent).then_some((at, task));
        let has_arming = is_v0 && profile.arming().is_some();
        let has_motors =
            is_v0 && self.settings.motors > 0 && self.settings.profile.motors().is_some();
        let asked = self.nodes.iter().filter_map(|(id, node)| Some((node.ask_at?, Task::Ask(*id))));
        [(self.next_status_at, Task::Status), (self.next_command_at, Task::Command)]
            .into_iter()
            .chain(has_arming.then_some((self.next_arming_at, Task::Arming)))
            .chain(has_motors.then_some((self.next_motors_at, Task::Motors)))
            .chain(also(profile.notify().is_some(), self.next_notify_at, Task::Notify))
            .chain(also(profile.esc_id().is_some(), self.next_esc_id_at, Task::EscId))
            .chain(also(profile.time_sync().is_some(), self.next_time_sync_at, Task::TimeSync))
            .chain(also(
                profile.hardpoint_priority().is_some(),
                self.next_hardpoint_at,
                Task::Hardpoint,
            ))
            .chain(also(
                profile.identity_priority().is_some(),
                self.next_identity_at,
                Task::Identity,
            ))
            .chain(also(profile.lights().is_some(), self.next_lights_at, Task::Lights))
            .chain(also(profile.verify_period().is_some(), self.next_verify_at, Task::Verify))
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
                if self.settings.dialect == Dialect::Draft {
                    self.commands_sent += u64::from(!self.mute);
                    return self.broadcast_in_draft(&self.command_in_draft(at));
                }
                let Some(command) = self.command(at) else { return Vec::new() };
                self.commands_sent += u64::from(!self.mute);
                self.broadcast(&command, profile.command_priority())
            }
            Task::Verify | Task::Answer | Task::Ask(_) => self.request_or_answer(task, at),
            _ => self.broadcast_of_profile(task, at),
        }
    }

    /// Performs a task of the profile's further broadcasts.
    fn broadcast_of_profile(&mut self, task: Task, at: Cycles) -> Vec<Frame> {
        let profile = self.settings.profile;
        match task {
            Task::Arming => {
                let (period, priority) = profile.arming().unwrap_or((F_CPU_HZ, 0));
                self.next_arming_at += period;
                let mut frames = Vec::new();
                if profile.has_safety_switch() {
                    let state = profile.safety_state(self.armed, self.safe);
                    frames = self.broadcast(&Message::SafetyState(state), priority);
                }
                let armed = Message::ArmingStatus(if self.armed { FULLY_ARMED } else { DISARMED });
                frames.extend(self.broadcast(&armed, priority));
                frames
            }
            Task::Motors => {
                self.next_motors_at += F_CPU_HZ / u64::from(self.settings.motor_rate_hz.max(1));
                let Some(Motors { priority, idle }) = profile.motors() else { return Vec::new() };
                if self.omits() {
                    return Vec::new();
                }
                self.broadcast(&self.motor_command(at, idle), priority)
            }
            Task::Notify => {
                let (period, priority) = profile.notify().unwrap_or((F_CPU_HZ, 0));
                self.next_notify_at += period;
                self.broadcast_raw(&types::NOTIFY_STATE, &notify_state(self.armed), priority)
            }
            Task::EscId => {
                let (period, priority) = profile.esc_id().unwrap_or((F_CPU_HZ, 0));
                self.next_esc_id_at += period;
                if self.armed {
                    return Vec::new();
                }
                self.broadcast_raw(&types::GET_ESC_ID, &[0], priority)
            }
            Task::TimeSync => {
                let (period, priority) = profile.time_sync().unwrap_or((F_CPU_HZ, 0));
                self.next_time_sync_at += period;
                // The time of the message before, in microseconds; 0 in the first.
                let before_us =
                    (at - self.powered_at).saturating_sub(period) / (F_CPU_HZ / 1_000_000);
                self.broadcast_raw(
                    &types::GLOBAL_TIME_SYNC,
                    &before_us.to_le_bytes()[..7],
                    priority,
                )
            }
            Task::Hardpoint => {
                self.next_hardpoint_at += F_CPU_HZ;
                let release = HardpointCommand { hardpoint: 0, command: 0 };
                let priority = profile.hardpoint_priority().unwrap_or(0);
                self.broadcast(&Message::HardpointCommand(release), priority)
            }
            Task::Identity => {
                self.next_identity_at += F_CPU_HZ;
                let priority = profile.identity_priority().unwrap_or(0);
                self.broadcast_raw(&types::BASIC_ID, &IDENTITY, priority)
            }
            Task::Lights => {
                let (period, priority) = profile.lights().unwrap_or((F_CPU_HZ, 0));
                self.next_lights_at += period;
                let light = LightCommand { light: 0, red: 0, green: 0, blue: 31 };
                self.broadcast(&Message::LightsCommand(vec![light]), priority)
            }
            _ => Vec::new(),
        }
    }

    /// Performs a task of a service.
    fn request_or_answer(&mut self, task: Task, at: Cycles) -> Vec<Frame> {
        match task {
            Task::Verify => {
                let period = self.settings.profile.verify_period();
                self.next_verify_at += period.unwrap_or(F_CPU_HZ);
                let Some(node) = self.next_to_verify(at) else { return Vec::new() };
                self.verified = Some(node);
                self.ask(node)
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
                self.ask(destination)
            }
            _ => Vec::new(),
        }
    }

    /// The frames of a GetNodeInfo request.
    fn ask(&mut self, destination: NodeId) -> Vec<Frame> {
        let priority = self.settings.profile.request_priority().unwrap_or(0);
        let source = self.settings.node_id;
        let id = CanId::Service { priority, service_id: 1, request: true, destination, source };
        let transfer_id = self.next_transfer(id);
        frames(id, transfer_id, &Message::NodeInfoRequest)
    }

    /// The node that follows the one that was verified last, of those that are online.
    fn next_to_verify(&self, at: Cycles) -> Option<NodeId> {
        let is_online = |node: &Known| at.saturating_sub(node.last_status_at) <= OFFLINE_TIMEOUT;
        let online = || self.nodes.iter().filter(|(_, node)| is_online(node)).map(|(id, _)| *id);
        let later = online().find(|id| self.verified.is_some_and(|verified| *id > verified));
        later.or_else(|| online().next())
    }

    /// The command that is due at `at`; `None` if it would command no actuator.
    pub(super) fn command(&self, at: Cycles) -> Option<Message> {
        let Settings { profile, actuator, moves, servos, command_type, .. } = self.settings;
        let deflection = self.own_deflection(at);
        if command_type == CommandType::Thesis {
            return Some(Message::ThesisCommand(thesis_position(deflection)));
        }
        let Some(array) = profile.array() else {
            return Some(Message::ArrayCommand(vec![self.actuator_command(actuator, deflection)]));
        };
        let omits = self.omits();
        let is_commanded = |id: &u8| !omits || (moves == Moves::One && *id != actuator);
        let ids = (array.first..array.first + servos).filter(is_commanded);
        let all = ids.map(|id| {
            let deflection = self.deflection_of(id, at);
            // ArduPilot and PX4 calculate a pulse width in whole microseconds first, and convert it
            // to a deflection.
            let pulse_us = (PWM_CENTRE_US + deflection * PWM_HALF_TRAVEL_US).round();
            self.actuator_command(id, (pulse_us - PWM_CENTRE_US) / PWM_HALF_TRAVEL_US)
        });
        let all: Vec<_> = all.collect();
        (!all.is_empty()).then_some(Message::ArrayCommand(all))
    }

    /// Commanded deflection at `at` of an actuator, -1 to +1. An autopilot without lists commands
    /// that of its settings only.
    pub fn deflection_of(&self, id: u8, at: Cycles) -> f64 {
        let Settings { profile, actuator, moves, servos, .. } = self.settings;
        let Some(array) = profile.array().filter(|_| moves == Moves::All || id != actuator) else {
            return self.own_deflection(at);
        };
        let index = id.saturating_sub(array.first);
        let moving = match moves {
            Moves::All => self.deflection_ahead(at, f64::from(index) / f64::from(servos)),
            // Each other actuator holds another position, so that a node that listens to a wrong ID
            // is noticed.
            Moves::One => 2.0 * f64::from(index + 1) / f64::from(servos + 1) - 1.0,
        };
        self.held.get(&id).copied().unwrap_or(moving)
    }

    /// True if what moves is left out of the commands now.
    fn omits(&self) -> bool {
        self.settings.omits_disarmed && !self.armed
    }

    /// Motors are off while disarmed. While armed, deflection -1 gives `idle`, and +1 full power.
    fn motor_command(&self, at: Cycles, idle: i16) -> Message {
        let motors = self.settings.motors;
        let command = |index: u8| {
            let power = self.motor_power(index, at) * f64::from(esc::FULL_POWER);
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

    pub(super) fn broadcast_id(&self, message: &Message, priority: u8) -> CanId {
        let (data_type, _) = message.encode().expect("only encodable messages are made");
        DataType::message_id(data_type, priority, self.settings.node_id)
    }

    fn broadcast(&mut self, message: &Message, priority: u8) -> Vec<Frame> {
        let id = self.broadcast_id(message, priority);
        // A message that is not sent uses no transfer ID.
        let transfer_id = if self.mute { TransferId::default() } else { self.next_transfer(id) };
        frames(id, transfer_id, message)
    }

    /// Like [`Autopilot::broadcast`], for a type that has no [`Message`].
    fn broadcast_raw(&mut self, data_type: &DataType, payload: &[u8], priority: u8) -> Vec<Frame> {
        let id = data_type.message_id(priority, self.settings.node_id);
        let transfer_id = if self.mute { TransferId::default() } else { self.next_transfer(id) };
        dronecan_host::frames(id, payload, transfer_id)
    }

    pub(super) fn next_transfer(&mut self, id: CanId) -> TransferId {
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
    Notify,
    EscId,
    TimeSync,
    Hardpoint,
    Identity,
    Lights,
    /// GetNodeInfo to the next known node.
    Verify,
    Answer,
    Ask(NodeId),
}

/// The thesis's byte for a deflection: 0 to 255 over the full travel.
pub(super) fn thesis_position(deflection: f64) -> u8 {
    ((deflection + 1.0) * 127.5).round() as u8
}

/// The payload of PX4's BasicID: no MAC, a serial number, another kind of vehicle, the number.
const IDENTITY: [u8; 22] = {
    let mut payload = [0; 22];
    [payload[0], payload[1], payload[2]] = [0x00, 0x08, 0x79];
    payload
};

/// The payload of a NotifyState, as ArduPlane sends it when it can be armed: a heading of 0 degrees
/// (its type, length and hundredths of a degree, counted backwards from 360), and 64 bits of state.
fn notify_state(armed: bool) -> [u8; 12] {
    /// VEHICLE_STATE_ARMED, _PREARM and _PREARM_GPS of ardupilot.indication.NotifyState.
    const ARMED: u64 = 1 << 1;
    const PREARM: u64 = 1 << 3 | 1 << 4;
    let state = PREARM | if armed { ARMED } else { 0 };
    let mut payload = [0; 12];
    payload[1] = 2;
    payload[2..4].copy_from_slice(&36_000_u16.to_le_bytes());
    payload[4..].copy_from_slice(&state.to_le_bytes());
    payload
}
