//! The safety switch, by the SafetyState of the autopilot: while it is on, no command is followed.

use crate::tables::parameters::{Parameter, Parameters};

/// The safety switch counts as on for this time after a SafetyState that says so, or up to a second
/// longer, in seconds. ArduPilot sends two a second.
const TIMEOUT_S: u8 = 4;

/// The safety switch.
pub struct Safety {
    /// Beginnings of a second until it no longer counts as on.
    safe_s: u8,
    /// Node ID of whoever put it on; 0 if several nodes did, of which none can put it off.
    source: u8,
}

impl Safety {
    /// Off.
    pub const fn new() -> Self {
        Self { safe_s: 0, source: 0 }
    }

    /// True while the safety switch is on.
    pub fn is_safe(&self) -> bool {
        self.safe_s != 0
    }

    /// True while it is on by this node, which alone can put it off.
    pub fn is_safe_by(&self, source: u8) -> bool {
        self.is_safe() && self.source == source
    }

    /// A SafetyState of this node says that it is on.
    pub fn begin(&mut self, source: u8) {
        if !self.is_safe() {
            self.source = source;
        } else if self.source != source {
            self.source = 0;
        }
        // The first second may begin at once.
        self.safe_s = TIMEOUT_S + 1;
    }

    /// True if SAFE_MODE ends the pulses while it is on.
    pub fn ends_pulses(&self, parameters: &Parameters) -> bool {
        parameters.is_on(Parameter::SafeMode)
    }

    /// A SafetyState says that it is off, or none came in time.
    pub fn end(&mut self) {
        self.safe_s = 0;
    }

    /// Counts down the timeout. Returns true if it ends. Call once a second.
    pub fn second(&mut self) -> bool {
        if self.safe_s == 0 {
            return false;
        }
        self.safe_s -= 1;
        self.safe_s == 0
    }
}
