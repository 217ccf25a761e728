//! When the node of the thesis sends its measurement, the temperature. `Publication` has the
//! message, and the dialect its type.

/// The node sends the thesis's temperature once for this number of statuses from the autopilot.
const STATUSES_PER_DEGREES: u8 = 3;

/// When the thesis's measurement is sent.
#[derive(Default)]
pub struct Measurement {
    /// Statuses of the autopilot since the temperature was last due.
    statuses: u8,
}

impl Measurement {
    /// No status yet.
    pub const fn new() -> Self {
        Self { statuses: 0 }
    }

    /// Takes note of a status of the autopilot. Returns true if the temperature is due.
    pub fn note_status(&mut self) -> bool {
        self.statuses += 1;
        if self.statuses < STATUSES_PER_DEGREES {
            return false;
        }
        self.statuses = 0;
        true
    }
}
