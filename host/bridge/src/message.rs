//! MAVLink messages that the bridge sends and receives, and their bytes.
//!
//! Commands and parameter types are plain numbers here ([`Request`], [`Content`]); [`gaps`] has the
//! reason.

mod gaps;
mod parser;
mod writer;

use crate::number::Number;
use mavlink::MessageData;
use mavlink::dialects::common::{
    AUTOPILOT_VERSION_DATA, CAN_FILTER_MODIFY_DATA, CAN_FRAME_DATA, HEARTBEAT_DATA, MavMessage,
    MavResult, MavSeverity, PARAM_VALUE_DATA, STATUSTEXT_DATA, UAVCAN_NODE_INFO_DATA,
    UAVCAN_NODE_STATUS_DATA,
};
use mavlink::types::CharArray;

pub use parser::{Parser, Received, Refused};
pub use writer::{Versions, Writer};

#[cfg(test)]
mod tests;

/// Length of FILE_TRANSFER_PROTOCOL.payload in bytes.
pub const FTP_PAYLOAD_LEN: usize = 251;

/// Numbers of the commands (MAV_CMD) that the bridge executes.
pub mod command {
    pub const PREFLIGHT_STORAGE: u16 = 245;
    pub const PREFLIGHT_REBOOT_SHUTDOWN: u16 = 246;
    pub const REQUEST_MESSAGE: u16 = 512;
    pub const REQUEST_PROTOCOL_VERSION: u16 = 519;
    pub const REQUEST_AUTOPILOT_CAPABILITIES: u16 = 520;
    pub const UAVCAN_GET_NODE_INFO: u16 = 5200;
    pub const CAN_FORWARD: u16 = 32000;
}

/// Numbers of the messages that MAV_CMD_REQUEST_MESSAGE can request.
pub mod id {
    use super::*;
    pub const HEARTBEAT: u32 = HEARTBEAT_DATA::ID;
    pub const AUTOPILOT_VERSION: u32 = AUTOPILOT_VERSION_DATA::ID;
    pub const NODE_STATUS: u32 = UAVCAN_NODE_STATUS_DATA::ID;
    pub const NODE_INFO: u32 = UAVCAN_NODE_INFO_DATA::ID;
}

/// A message to be sent, with the component that it comes from.
#[derive(Clone, Debug, PartialEq)]
pub struct Out {
    pub component: u8,
    pub content: Content,
}

/// The content of a message.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    Message(Box<MavMessage>),
    /// UAVCAN_NODE_STATUS. The mode is DroneCAN's number, defined or not.
    Status {
        data: UAVCAN_NODE_STATUS_DATA,
        mode: u8,
    },
    /// COMMAND_ACK to a system and component.
    Ack {
        command: u16,
        result: MavResult,
        to: (u8, u8),
    },
    /// PARAM_VALUE. The recipient decides the encoding of integers.
    Parameter {
        name: String,
        number: Number,
        count: u16,
        index: u16,
    },
    /// AUTOPILOT_VERSION. Its capabilities include the encoding of integers.
    Capabilities {
        software: u32,
        unique_id: [u8; 16],
    },
}

impl Out {
    /// Messages with the same key replace each other: only the newest needs to be sent.
    pub fn key(&self) -> Option<(u8, u32, u16)> {
        match &self.content {
            Content::Parameter { index, .. } => {
                Some((self.component, PARAM_VALUE_DATA::ID, *index))
            }
            Content::Message(message) => match **message {
                MavMessage::HEARTBEAT(_) => Some((self.component, HEARTBEAT_DATA::ID, 0)),
                MavMessage::UAVCAN_NODE_INFO(_) => {
                    Some((self.component, UAVCAN_NODE_INFO_DATA::ID, 0))
                }
                _ => None,
            },
            _ => None,
        }
    }
}

impl From<MavMessage> for Content {
    fn from(message: MavMessage) -> Content {
        Content::Message(Box::new(message))
    }
}

/// A STATUSTEXT; longer ones are cut at 50 bytes.
pub fn text(words: &str) -> MavMessage {
    status_text(MavSeverity::MAV_SEVERITY_NOTICE, words)
}

/// A STATUSTEXT about a problem that the user must solve.
pub fn warning(words: &str) -> MavMessage {
    status_text(MavSeverity::MAV_SEVERITY_WARNING, words)
}

fn status_text(severity: MavSeverity, words: &str) -> MavMessage {
    MavMessage::STATUSTEXT(STATUSTEXT_DATA {
        severity,
        text: chars(words.as_bytes()),
        id: 0,
        chunk_seq: 0,
    })
}

/// Bytes as a text field, cut to its length.
pub fn chars<const N: usize>(bytes: &[u8]) -> CharArray<N> {
    let mut field = [0; N];
    let len = bytes.len().min(N);
    field[..len].copy_from_slice(&bytes[..len]);
    CharArray::new(field)
}

/// The text of a name field, up to the first zero.
pub fn name<const N: usize>(field: &CharArray<N>) -> String {
    let end = field.iter().position(|byte| *byte == 0).unwrap_or(N);
    String::from_utf8_lossy(&field[..end]).into_owned()
}

/// COMMAND_LONG or COMMAND_INT.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    pub number: u16,
    pub params: [f32; 7],
}

/// A message from a ground station.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// HEARTBEAT, with its type and autopilot.
    Heartbeat {
        kind: u8,
        autopilot: u8,
    },
    ParameterList,
    ParameterRead {
        index: Option<u16>,
        name: String,
    },
    ParameterSet {
        name: String,
        value: f32,
        kind: u8,
    },
    Command(Command),
    Frame(CAN_FRAME_DATA),
    Filter(CAN_FILTER_MODIFY_DATA),
    /// FILE_TRANSFER_PROTOCOL: its payload.
    Ftp(Box<[u8; FTP_PAYLOAD_LEN]>),
    /// RADIO_STATUS, from a radio on the way: the free part of the buffer for what it has to send
    /// (`txbuf`).
    Radio {
        free_percent: u8,
    },
    /// Any other message. It shows that the sender is online.
    Other,
}

/// A received message with its sender and its target.
#[derive(Clone, Debug, PartialEq)]
pub struct In {
    /// The sender's system and component.
    pub from: (u8, u8),
    /// The target's system and component; 0 means all.
    pub to: (u8, u8),
    pub request: Request,
}
