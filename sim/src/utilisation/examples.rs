//! Ready plans.

/// A plan with a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Example {
    /// Vertiq's quadcopter: RawCommand for four motors at 400 Hz, telemetry of each at 10 Hz
    Quadcopter,
    /// The thesis's bus: an autopilot and a node with a servo and a temperature sensor
    Thesis,
    /// ArduPilot with 15 servo nodes at its usual rates
    #[value(name = "ardupilot-15-servos")]
    Ardupilot15Servos,
}

impl Example {
    /// Its messages, as for `--message`.
    pub fn messages(self) -> &'static [&'static str] {
        match self {
            Example::Quadcopter => {
                &["RawCommand[4]@400", "4x esc.Status@10", "4x esc.StatusExtended@10"]
            }
            // A command and a status each second; the node's temperature every three seconds.
            Example::Thesis => {
                &["2x NodeStatus@1", "thesis.ServoCommand@1", "thesis.DegreesCelsius@0.3333"]
            }
            // 50 Hz is the default of CAN_D1_UC_SRV_RT; the safety and arming states are sent at 2
            // Hz.
            Example::Ardupilot15Servos => &[
                "16x NodeStatus@1",
                "ArrayCommand[15]@50",
                "SafetyState@2",
                "ArmingStatus@2",
                "15x actuator.Status@10",
                "15x Temperature@1",
            ],
        }
    }
}
