//! A command for one output.

use super::travel::CommandType;
use crate::tables::wire::Transfer;

/// A command for one output, which waits to be followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Command {
    /// Node ID of the sender.
    pub source: u8,
    /// Transfer ID of the command.
    pub transfer: u8,
    /// The unit of the value.
    pub unit: CommandType,
    /// The value, low byte first: a float16, or the number of a [`CommandType::Byte`] or
    /// [`CommandType::Throttle`].
    pub value: [u8; 2],
}

impl Command {
    /// The command of a transfer, in this unit.
    pub fn of(command: &Transfer, unit: CommandType, value: [u8; 2]) -> Self {
        Self { source: command.source, transfer: command.transfer_id(), unit, value }
    }
}
