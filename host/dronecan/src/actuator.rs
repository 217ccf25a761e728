//! Payloads of the messages that move actuators, and of their status.
//!
//! Layouts from the public DSDL; little endian, float16 by the crate `half`.

use crate::text::numbered;
use half::f16;
use std::fmt;

numbered! {
    /// Unit of an actuator command.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum CommandUnit or Unknown "type {}" {
        /// -1 to +1, without a unit.
        Unitless = 0 "unitless",
        /// Radians of a servo, metres of a linear actuator.
        Position = 1 "position",
        Force = 2 "force",
        Speed = 3 "speed",
        /// Pulse width in microseconds.
        Pwm = 4 "PWM",
    }
}

/// One element of equipment.actuator.ArrayCommand: id u8 | type u8 | value float16.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActuatorCommand {
    pub actuator: u8,
    pub unit: CommandUnit,
    pub value: f16,
}

/// Length of one command in an ArrayCommand, in bytes.
const COMMAND_BYTES: usize = 4;

impl ActuatorCommand {
    /// The commands in a payload; `None` unless it has 0 to 15 complete ones.
    pub fn decode_array(payload: &[u8]) -> Option<Vec<ActuatorCommand>> {
        let (commands, rest) = payload.as_chunks::<COMMAND_BYTES>();
        if !rest.is_empty() || commands.len() > 15 {
            return None;
        }
        let decode = |&[actuator, unit, low, high]: &[u8; COMMAND_BYTES]| ActuatorCommand {
            actuator,
            unit: CommandUnit::from_field(unit),
            value: f16::from_le_bytes([low, high]),
        };
        Some(commands.iter().map(decode).collect())
    }

    /// The payload of an ArrayCommand.
    pub fn encode_array(commands: &[ActuatorCommand]) -> Vec<u8> {
        let encode = |command: &ActuatorCommand| {
            let [low, high] = command.value.to_le_bytes();
            [command.actuator, command.unit.field(), low, high]
        };
        commands.iter().flat_map(encode).collect()
    }
}

impl fmt::Display for ActuatorCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = self.value.to_f32();
        write!(f, "id {} {} ", self.actuator, self.unit)?;
        match self.unit {
            CommandUnit::Pwm => write!(f, "{value:.0} us"),
            CommandUnit::Position => write!(f, "{value:+.2} rad"),
            _ => write!(f, "{value:+.2}"),
        }
    }
}

/// equipment.actuator.Status: `id u8 | position f16 | force f16 | speed f16 | power_percent[6:0]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActuatorStatus {
    pub actuator: u8,
    pub position: f16,
    pub force: f16,
    pub speed: f16,
    /// 0 to 100; 127 means unknown.
    pub power_percent: u8,
}

const POWER_MASK: u8 = 0x7F;

impl ActuatorStatus {
    /// `None` unless the payload has eight bytes.
    pub fn decode(payload: &[u8]) -> Option<ActuatorStatus> {
        let &[actuator, p0, p1, f0, f1, s0, s1, power] = payload else {
            return None;
        };
        Some(ActuatorStatus {
            actuator,
            position: f16::from_le_bytes([p0, p1]),
            force: f16::from_le_bytes([f0, f1]),
            speed: f16::from_le_bytes([s0, s1]),
            power_percent: power & POWER_MASK,
        })
    }

    /// The payload.
    pub fn encode(&self) -> Vec<u8> {
        let mut payload = vec![self.actuator];
        for value in [self.position, self.force, self.speed] {
            payload.extend(value.to_le_bytes());
        }
        payload.push(self.power_percent & POWER_MASK);
        payload
    }
}

impl fmt::Display for ActuatorStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "id {} position {:+.2}", self.actuator, self.position.to_f32())?;
        if !self.force.is_nan() {
            write!(f, " force {:.2}", self.force.to_f32())?;
        }
        if !self.speed.is_nan() {
            write!(f, " speed {:.2}", self.speed.to_f32())?;
        }
        if self.power_percent != 127 {
            write!(f, " power {} %", self.power_percent)?;
        }
        Ok(())
    }
}
