//! What the node receives: add your own types here.

use dronecan_wire::{Received, types};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Unknown,
    ArrayCommand,
    GetNodeInfo,
    RestartNode,
    GetSet,
    ExecuteOpcode,
}

impl Received for Kind {
    const UNKNOWN: Self = Self::Unknown;

    fn of_message(data_type: u16) -> Self {
        if data_type == types::ARRAY_COMMAND.id { Self::ArrayCommand } else { Self::Unknown }
    }

    fn of_request(service: u8) -> Self {
        const GET_NODE_INFO: u8 = types::GET_NODE_INFO.id;
        const RESTART_NODE: u8 = types::RESTART_NODE.id;
        const GET_SET: u8 = types::GET_SET.id;
        const EXECUTE_OPCODE: u8 = types::EXECUTE_OPCODE.id;
        match service {
            GET_NODE_INFO => Self::GetNodeInfo,
            RESTART_NODE => Self::RestartNode,
            GET_SET => Self::GetSet,
            EXECUTE_OPCODE => Self::ExecuteOpcode,
            _ => Self::Unknown,
        }
    }

    fn is_request(self) -> bool {
        match self {
            Self::Unknown | Self::ArrayCommand => false,
            Self::GetNodeInfo | Self::RestartNode | Self::GetSet | Self::ExecuteOpcode => true,
        }
    }

    fn is_multi_frame(self) -> bool {
        match self {
            Self::Unknown | Self::GetNodeInfo | Self::RestartNode | Self::ExecuteOpcode => false,
            Self::ArrayCommand | Self::GetSet => true,
        }
    }

    /// An ArrayCommand is a list with an entry of four bytes for each actuator.
    fn entry_len(self) -> u8 {
        if self == Self::ArrayCommand { 4 } else { 0 }
    }

    fn seed(self) -> u16 {
        match self {
            Self::Unknown | Self::GetNodeInfo | Self::RestartNode | Self::ExecuteOpcode => 0,
            Self::ArrayCommand => types::ARRAY_COMMAND.seed,
            Self::GetSet => types::GET_SET.seed,
        }
    }
}
