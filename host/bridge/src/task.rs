//! Operations with a node, for a ground station or for the bridge itself.

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
