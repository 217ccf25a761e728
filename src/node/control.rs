//! The commands, and who gives them: what moves outputs and the light, and what the node knows of
//! the autopilot.

use dronecan_wire::NodeId;

use super::autopilot::Autopilot;
use super::filters::Filters;
use super::health::Health;
use super::publisher::Publisher;
use super::record::Record;
use crate::dialect;
use crate::monitor::{Line, Words};
use crate::parts::arming;
use crate::parts::lights::Lights;
use crate::parts::measurement::Measurement;
use crate::parts::outputs::Outputs;
use crate::tables::condition::Conditions;
use crate::tables::parameters::Parameters;
use crate::tables::publication::Publication;
use crate::tables::wire::Transfer;

/// What else an action on a message needs.
#[allow(dead_code, reason = "a build may have no message that needs one")]
pub struct Context<'a> {
    /// The time, in milliseconds.
    pub now_ms: u16,
    /// The parameters in force.
    pub parameters: &'a Parameters,
    /// What is counted and logged.
    pub record: &'a mut Record,
    /// When messages are sent.
    pub publisher: &'a mut Publisher,
    /// The change of the filters that is pending.
    pub filters: &'a mut Filters,
}

/// What commands move, and who gives them.
pub struct Control {
    /// The outputs.
    pub outputs: Outputs,
    /// The light.
    pub lights: Lights,
    /// The autopilot among the nodes.
    pub autopilot: Autopilot,
    /// When the thesis's measurement is sent.
    measurement: Measurement,
}

impl Control {
    /// No command yet.
    pub const fn new() -> Self {
        Self {
            outputs: Outputs::new(),
            lights: Lights::new(),
            autopilot: Autopilot::NONE,
            measurement: Measurement::new(),
        }
    }

    /// Takes note of the sender of a command. `is_second`: the output that followed it has two
    /// commanders.
    #[inline(never)]
    pub fn commanded_by(&mut self, source: NodeId, is_second: bool, health: &mut Health) {
        let is_another = self.autopilot.commanded_by(source);
        if if arming::IS_BY_SOURCE { is_second } else { is_another } {
            health.happened(Conditions::TWO_COMMANDERS);
        }
    }

    /// Takes note of a command for an output. One that is rejected because the vehicle is disarmed
    /// still identifies the autopilot.
    #[inline(always)]
    fn note_command(&mut self, transfer: &Transfer, line: Line, context: &mut Context) -> Line {
        if line.is_refusal()
            && (line == Line::RefusedDisarmed || line == Line::RefusedSafe)
            && let Some(source) = NodeId::new(transfer.source)
        {
            self.commanded_by(source, false, &mut context.record.health);
            self.outputs.arming.expect(source);
        }
        line
    }
}

/// The actions on messages, which the table of received types names. Each returns the line to log,
/// which is the reason of a refusal if the message is refused.
#[allow(dead_code, reason = "a build may leave out the row that names one")]
impl Control {
    /// ArrayCommand: a command for servos.
    #[inline(always)]
    pub fn act_on_array_command(&mut self, command: &Transfer, context: &mut Context) -> Line {
        let line = self.outputs.act_on_array_command(command, context.parameters);
        self.note_command(command, line, context)
    }

    /// RawCommand: a command for motors.
    #[inline(always)]
    pub fn act_on_raw_command(&mut self, command: &Transfer, context: &mut Context) -> Line {
        let line = self.outputs.act_on_raw_command(command, context.parameters);
        self.note_command(command, line, context)
    }

    /// The command of the thesis.
    #[inline(always)]
    pub fn act_on_servo_command(&mut self, command: &Transfer, context: &mut Context) -> Line {
        if command.len() != 1 {
            return Line::RefusedLength;
        }
        let line = self.outputs.act_on_servo_command(command, context.parameters);
        self.note_command(command, line, context)
    }

    /// NodeStatus. The autopilot's makes the node's own due.
    #[inline(always)]
    pub fn act_on_status(&mut self, status: &Transfer, context: &mut Context) -> Line {
        let Some(heard) = dialect::read_status(status) else { return Line::RefusedLength };
        let [u0, u1, u2, u3] = heard.uptime;
        context.record.note.set_code(Words::HEALTH.number(heard.level));
        let uptime_s = if u2 | u3 == 0 { u16::from_le_bytes([u0, u1]) } else { u16::MAX };
        context.record.note.set_a(uptime_s);
        if self.is_of_autopilot(status) {
            context.publisher.autopilot_status(context.now_ms);
            if self.measurement.note_status() {
                context.publisher.publish(Publication::DegreesCelsius);
            }
        }
        Line::Status
    }

    /// ArmingStatus, if it is that of the vehicle.
    #[inline(always)]
    pub fn act_on_arming_status(&mut self, status: &Transfer, context: &mut Context) -> Line {
        if status.len() != 1 {
            return Line::RefusedLength;
        }
        // A commander is heard whoever commanded last.
        if !self.is_of_autopilot(status)
            && !self.outputs.arming.expects(status.source)
            && !self.outputs.has_commander(status.source)
        {
            return Line::RefusedSource;
        }
        let (source, &[status, ..]) = (status.source, status.bytes());
        if !self.outputs.act_on_arming_status(source, status) {
            return Line::RefusedSource;
        }
        context.record.note.set_code(status);
        Line::Arming
    }

    /// SafetyState, if it is that of the vehicle.
    #[inline(always)]
    pub fn act_on_safety_state(&mut self, state: &Transfer, context: &mut Context) -> Line {
        if state.len() != 1 {
            return Line::RefusedLength;
        }
        // A node whose commands are refused, because only another node's vehicle is armed, is the
        // autopilot, too. It must not stop what the other commands.
        if (self.outputs.arming.is_only_armed_by_others(state.source)
            || !self.is_of_autopilot(state))
            && !self.outputs.has_commander(state.source)
        {
            return Line::RefusedSource;
        }
        let (source, &[state, ..]) = (state.source, state.bytes());
        self.outputs.act_on_safety_state(source, state, context.now_ms, context.parameters);
        if self.outputs.safety.is_safe() {
            context.record.health.clear(Conditions::FAILSAFE);
        }
        context.record.note.set_code(state);
        Line::SafetyState
    }

    /// True if a message is the autopilot's, as far as the node can tell.
    #[inline(never)]
    fn is_of_autopilot(&mut self, transfer: &Transfer) -> bool {
        NodeId::new(transfer.source).is_some_and(|source| self.autopilot.is_status_of(source))
    }

    /// hardpoint.Command: a command for relays.
    #[inline(never)]
    pub fn act_on_hardpoint_command(&mut self, command: &Transfer, context: &mut Context) -> Line {
        if command.len() != 3 {
            return Line::RefusedLength;
        }
        let (source, &[id, low, high, ..]) = (command.source, command.bytes());
        context.record.note.set_code(id);
        context.record.note.set_a(u16::from_le_bytes([low, high]));
        let holds = low | high != 0;
        let line = self.outputs.act_on_hardpoint_command(source, id, holds, context.parameters);
        self.note_command(command, line, context)
    }

    /// LightsCommand.
    #[inline(always)]
    pub fn act_on_lights_command(&mut self, command: &Transfer, context: &mut Context) -> Line {
        self.lights.act_on_command(command.payload());
        context.record.note.set_code(self.lights.brightness());
        Line::Light
    }
}
