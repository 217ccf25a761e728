//! What the checks know of the board, and what they are to check.

use std::collections::BTreeMap;
use std::time::Duration;

use dronecan_host::{NodeId, NodeInfo, ParameterResponse, Value};

use crate::check::desk::State;
use crate::update::file::FirmwareFile;

/// What is checked, and with what.
pub struct Plan {
    pub node: NodeId,
    pub bit_rate: u32,
    /// True if there is the Arduino's serial port.
    pub has_port: bool,
    /// True if there is a logic analyser.
    pub has_analyser: bool,
    /// How long error counters are observed.
    pub watch: Duration,
    /// Programs for an update. Only the one that the node has is sent.
    pub files: Vec<FirmwareFile>,
}

/// Bits of the vendor-specific status code (docs/status.md).
pub mod bit {
    pub const RESET: u16 = 7;
    pub const BROKEN: u16 = 1 << 3;
    pub const SAME_ID: u16 = 1 << 4;
    pub const LOST: u16 = 1 << 5;
    pub const PASSIVE: u16 = 1 << 6;
    pub const BUS_OFF: u16 = 1 << 7;
    pub const CONTROLLER: u16 = 1 << 8;
    pub const FAILSAFE: u16 = 1 << 10;
    pub const PARAMETERS: u16 = 1 << 13;
}
pub const BUS_ADVICE: &str = "look at 120 ohms at both ends, CAN high and low, a common ground";
pub const BANNER: &str = "DroneCAN servo node ";

/// What is known of the board.
pub struct Board {
    pub info: NodeInfo,
    pub parameters: BTreeMap<String, ParameterResponse>,
    /// Median time of a request and its response.
    pub round_trip: Duration,
    pub has_port: bool,
}

impl Board {
    /// The value of a parameter, if the node has it.
    pub fn value(&self, name: &str) -> Option<i64> {
        match self.parameters.get(name)?.value {
            Value::Integer(value) => Some(value),
            _ => None,
        }
    }

    /// True if the program prints lines on the serial port: all but the preset `remote`.
    pub fn has_monitor(&self) -> bool {
        let has = |name: &str| self.parameters.contains_key(name);
        let is_remote = has("STATS_RATE") && has("SAFE_MODE") && !has("OUT_COUNT");
        !is_remote
    }
}

/// All bits of the status codes since a time.
pub fn codes(state: &State, since: Duration) -> u16 {
    let new = state.statuses.iter().filter(|status| status.at >= since);
    new.fold(0, |codes, status| codes | status.what.vendor_code)
}
