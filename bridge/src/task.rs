//! What is to be done with a node: for a ground station, or to know the node.

use crate::post::Asker;
use dronecan_host::Value;
use mavlink::dialects::common::MavParamError;

/// What a ground station wants of a node's parameters.
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
    /// For the table that is printed.
    Print,
}

/// What a request to a node is for.
#[derive(Clone, Debug, PartialEq)]
pub enum Purpose {
    Info,
    /// Parameter by index, for the table.
    Item(u16),
    /// A parameter by its place in the table; and what was wrong with a PARAM_SET that only reads it.
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
