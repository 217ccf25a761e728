//! Payloads of the messages that move actuators, and of their status.
//!
//! Layouts from the public DSDL; little endian, float16 by the crate `half`.

use crate::fields::payload;
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

payload! {
    /// One element of equipment.actuator.ArrayCommand.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct ActuatorCommand [15] {
        pub actuator: u8,
        pub unit: CommandUnit,
        pub value: f16,
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

payload! {
    /// equipment.actuator.Status.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct ActuatorStatus {
        pub actuator: u8,
        pub position: f16,
        pub force: f16,
        pub speed: f16,
        void 1,
        /// 0 to 100; 127 means unknown.
        pub power_percent: u8 as 7,
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
