//! Operations with a node, for a ground station or for the bridge itself.

use crate::calls::{Timeouts, Urgency};
use crate::post::Asker;
use dronecan_host::Value;
use mavlink::dialects::common::MavParamError;

/// An operation with a node's parameters.
#[derive(Clone, Debug, PartialEq)]
pub enum Op {
    List(Asker),
    ReadIndex(Asker, u16),
    ReadName(Asker, String),
    Set {
        asker: Asker,
        name: String,
        value: f32,
        kind: u8,
    },
    /// For the table that `--names` prints.
    Print,
}

/// The purpose of a request to a node.
#[derive(Clone, Debug, PartialEq)]
pub enum Purpose {
    Info,
    /// Fetches a parameter by index, for the table.
    Item(u16),
    /// Reads or sets a parameter, given by its place in the table; and the error of a PARAM_SET
    /// that only reads it.
    Read {
        asker: Asker,
        at: usize,
        error: Option<MavParamError>,
    },
    Set {
        asker: Asker,
        at: usize,
        wanted: Value,
    },
    /// Commands, by their number.
    Opcode(u32),
    Restart(u32),
    Autosave,
}

const INFO_TIMEOUTS: Timeouts = Timeouts::from_ms(500, 2500);
/// The GUI tool waits 100 ms. A node that writes its memory first needs more, and some nodes take a
/// second for each request.
const PARAMETER_TIMEOUTS: Timeouts = Timeouts::from_ms(300, 4000);
/// For ExecuteOpcode. They are long because a small node writes all of its parameters.
const OPCODE_TIMEOUTS: Timeouts = Timeouts::from_ms(1500, 3000);
const RESTART_TIMEOUTS: Timeouts = Timeouts::from_ms(1000, 2000);

impl Purpose {
    /// The timeouts and the urgency of the request.
    pub fn pace(&self) -> (Timeouts, Urgency) {
        match self {
            Purpose::Info => (INFO_TIMEOUTS, Urgency::Background),
            Purpose::Item(_) => (PARAMETER_TIMEOUTS, Urgency::Background),
            Purpose::Read { .. } | Purpose::Set { .. } => (PARAMETER_TIMEOUTS, Urgency::Now),
            Purpose::Opcode(_) | Purpose::Autosave => (OPCODE_TIMEOUTS, Urgency::Now),
            Purpose::Restart(_) => (RESTART_TIMEOUTS, Urgency::Now),
        }
    }
}
