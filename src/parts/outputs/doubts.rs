//! Motors whose commands have stopped while the vehicle counts as armed: is it a failsafe?
//!
//! ArduPilot sends no esc.RawCommand while it is disarmed, if no channel then has a pulse. It says
//! that it has disarmed with the next ArmingStatus, half a second later at most, and MOT_TIMEOUT
//! may be shorter. So the motor stops at MOT_TIMEOUT, and the next ArmingStatus of its commander
//! decides: armed means that commands are lost. They are also lost if no ArmingStatus comes.

/// The motors in doubt.
pub struct Doubts {
    /// Bit n is output n.
    outputs: u8,
}

impl Doubts {
    /// No doubt.
    pub const fn new() -> Self {
        Self { outputs: 0 }
    }

    /// The commands for this motor, a bit, have stopped.
    #[inline(always)]
    pub fn begin(&mut self, bit: u8) {
        self.outputs |= bit;
    }

    /// The motors in doubt, a bit each.
    #[inline(always)]
    pub fn outputs(&self) -> u8 {
        self.outputs
    }

    /// Ends the doubt about these outputs, a bit each. Returns those that were in doubt.
    #[inline(always)]
    pub fn end(&mut self, outputs: u8) -> u8 {
        let doubted = self.outputs & outputs;
        self.outputs ^= doubted;
        doubted
    }
}
