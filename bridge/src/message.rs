//! MAVLink messages as the bridge makes and takes them, and their bytes.
//!
//! The crate's messages hold enumerations, which are a ground station's to extend: a command that the crate does not know must
//! be answered, not lost. So commands and parameter types are plain numbers here ([`Request`]), and so they are in what is
//! sent ([`Content`]).
//!
//! A ground station is answered in the version of MAVLink that it speaks. But the first message to it is of version 2, for there
//! are stations (on pymavlink) that begin with version 1 and go on in the version that they hear first. Messages with numbers
//! above 255 do not exist in version 1; they are sent in version 2 unless that was forbidden, and a parser of version 1 takes
//! them for noise.

use crate::number::{Custom, Number};
use mavlink::dialects::common::{
    AUTOPILOT_VERSION_DATA, CAN_FILTER_MODIFY_DATA, CAN_FRAME_DATA, COMMAND_ACK_DATA, COMMAND_INT_DATA,
    COMMAND_LONG_DATA, HEARTBEAT_DATA, MavMessage, MavProtocolCapability, MavResult, MavSeverity,
    PARAM_REQUEST_LIST_DATA, PARAM_REQUEST_READ_DATA, PARAM_SET_DATA, PARAM_VALUE_DATA, STATUSTEXT_DATA,
    UAVCAN_NODE_INFO_DATA, UAVCAN_NODE_STATUS_DATA,
};
use mavlink::error::{MessageReadError, ParserError};
use mavlink::types::CharArray;
use mavlink::{
    MAVLinkMessageRaw, MAVLinkV1MessageRaw, MAVLinkV2MessageRaw, MavHeader, MavlinkReader, MavlinkVersion, Message,
    MessageData, SigningData,
};
use std::collections::VecDeque;
use std::io::{self, Read};
use std::rc::Rc;

#[cfg(test)]
mod tests;

/// Numbers of commands (MAV_CMD) that the bridge obeys.
pub mod command {
    pub const PREFLIGHT_STORAGE: u16 = 245;
    pub const PREFLIGHT_REBOOT_SHUTDOWN: u16 = 246;
    pub const REQUEST_MESSAGE: u16 = 512;
    pub const REQUEST_PROTOCOL_VERSION: u16 = 519;
    pub const REQUEST_AUTOPILOT_CAPABILITIES: u16 = 520;
    pub const UAVCAN_GET_NODE_INFO: u16 = 5200;
    pub const CAN_FORWARD: u16 = 32000;
}

/// Numbers of messages that can be asked for by MAV_CMD_REQUEST_MESSAGE.
pub mod id {
    use super::*;
    pub const HEARTBEAT: u32 = HEARTBEAT_DATA::ID;
    pub const AUTOPILOT_VERSION: u32 = AUTOPILOT_VERSION_DATA::ID;
    pub const NODE_STATUS: u32 = UAVCAN_NODE_STATUS_DATA::ID;
    pub const NODE_INFO: u32 = UAVCAN_NODE_INFO_DATA::ID;
}

/// A message to be sent, with the component that it is from.
#[derive(Clone, Debug, PartialEq)]
pub struct Out {
    pub component: u8,
    pub content: Content,
}

/// What it says.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    Message(Box<MavMessage>),
    /// UAVCAN_NODE_STATUS with the mode as DroneCAN numbers it, defined or not.
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
    /// PARAM_VALUE. How its integers are written depends on whom it is for.
    Parameter {
        name: String,
        number: Number,
        count: u16,
        index: u16,
    },
    /// AUTOPILOT_VERSION. It says how integers are written.
    Capabilities {
        software: u32,
        uid: u64,
    },
}

impl Out {
    /// Messages with the same key say the same: only the newest is worth sending.
    pub fn key(&self) -> Option<(u8, u32, u16)> {
        match &self.content {
            Content::Parameter { index, .. } => Some((self.component, PARAM_VALUE_DATA::ID, *index)),
            Content::Message(message) => match **message {
                MavMessage::HEARTBEAT(_) => Some((self.component, HEARTBEAT_DATA::ID, 0)),
                MavMessage::UAVCAN_NODE_INFO(_) => Some((self.component, UAVCAN_NODE_INFO_DATA::ID, 0)),
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
    let text = chars(words.as_bytes());
    MavMessage::STATUSTEXT(STATUSTEXT_DATA { severity: MavSeverity::MAV_SEVERITY_NOTICE, text, id: 0, chunk_seq: 0 })
}

/// Bytes as a text field, cut to fit.
pub fn chars<const N: usize>(bytes: &[u8]) -> CharArray<N> {
    let mut field = [0; N];
    let len = bytes.len().min(N);
    field[..len].copy_from_slice(&bytes[..len]);
    CharArray::new(field)
}

/// A name field up to its end.
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

/// What a ground station wants.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    Heartbeat,
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
    /// Anything else: it shows that somebody is there.
    Other,
}

/// A message that came, with whom it is from and for.
#[derive(Clone, Debug, PartialEq)]
pub struct In {
    /// System and component.
    pub from: (u8, u8),
    /// System and component; 0 is every one.
    pub to: (u8, u8),
    pub request: Request,
}

/// Byte positions of what is read before the crate may see it.
const COMMAND_AT: usize = 28;
const INT_FRAME_AT: usize = 32;
const PARAM_TYPE_AT: usize = 22;
const KNOWN_PARAM_TYPE: u8 = 9;

impl In {
    /// Takes a message apart whose CRC is right.
    ///
    /// # Errors
    /// If its content is nonsense.
    fn parse(raw: &MAVLinkMessageRaw) -> Result<In, ParserError> {
        let version = raw.version();
        // Trailing zeros are not sent.
        let mut payload = [0; 255];
        payload[..raw.payload().len()].copy_from_slice(raw.payload());
        let numbered = |payload: &mut [u8; 255]| {
            let number = u16::from_le_bytes([payload[COMMAND_AT], payload[COMMAND_AT + 1]]);
            payload[COMMAND_AT..COMMAND_AT + 2].copy_from_slice(&command::REQUEST_MESSAGE.to_le_bytes());
            number
        };
        let (to, request) = match raw.message_id() {
            HEARTBEAT_DATA::ID => ((0, 0), Request::Heartbeat),
            PARAM_REQUEST_LIST_DATA::ID => {
                let data = PARAM_REQUEST_LIST_DATA::deser(version, &payload)?;
                ((data.target_system, data.target_component), Request::ParameterList)
            }
            PARAM_REQUEST_READ_DATA::ID => {
                let data = PARAM_REQUEST_READ_DATA::deser(version, &payload)?;
                let request =
                    Request::ParameterRead { index: u16::try_from(data.param_index).ok(), name: name(&data.param_id) };
                ((data.target_system, data.target_component), request)
            }
            PARAM_SET_DATA::ID => {
                let kind = std::mem::replace(&mut payload[PARAM_TYPE_AT], KNOWN_PARAM_TYPE);
                let data = PARAM_SET_DATA::deser(version, &payload)?;
                let request = Request::ParameterSet { name: name(&data.param_id), value: data.param_value, kind };
                ((data.target_system, data.target_component), request)
            }
            COMMAND_LONG_DATA::ID => {
                let number = numbered(&mut payload);
                let d = COMMAND_LONG_DATA::deser(version, &payload)?;
                let params = [d.param1, d.param2, d.param3, d.param4, d.param5, d.param6, d.param7];
                ((d.target_system, d.target_component), Request::Command(Command { number, params }))
            }
            COMMAND_INT_DATA::ID => {
                let number = numbered(&mut payload);
                payload[INT_FRAME_AT] = 0;
                let d = COMMAND_INT_DATA::deser(version, &payload)?;
                let params = [d.param1, d.param2, d.param3, d.param4, d.x as f32, d.y as f32, d.z];
                ((d.target_system, d.target_component), Request::Command(Command { number, params }))
            }
            CAN_FRAME_DATA::ID => {
                let data = CAN_FRAME_DATA::deser(version, &payload)?;
                ((data.target_system, data.target_component), Request::Frame(data))
            }
            CAN_FILTER_MODIFY_DATA::ID => {
                let data = CAN_FILTER_MODIFY_DATA::deser(version, &payload)?;
                ((data.target_system, data.target_component), Request::Filter(data))
            }
            _ => ((0, 0), Request::Other),
        };
        Ok(In { from: (raw.system_id().min(255) as u8, raw.component_id()), to, request })
    }
}

/// Bytes that have come and were not looked at.
#[derive(Default)]
struct Received(VecDeque<u8>);

impl Read for Received {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.0.is_empty() {
            return Err(io::ErrorKind::WouldBlock.into());
        }
        self.0.read(buffer)
    }
}

/// Why a message was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// Its fields are nonsense.
    Malformed,
    /// It is not signed, or wrongly.
    Signature,
}

/// Finds the messages in a stream of bytes.
pub struct Parser {
    reader: MavlinkReader<Received>,
    signing: Option<Rc<SigningData>>,
}

impl Parser {
    /// Takes signed messages only if there is a key.
    pub fn new(signing: Option<Rc<SigningData>>) -> Parser {
        Parser { reader: MavlinkReader::new(Received::default()), signing }
    }

    /// Adds bytes that have come.
    pub fn feed(&mut self, bytes: &[u8]) {
        self.reader.get_mut().0.extend(bytes);
    }

    /// The next message, with its version; `None` when all bytes are used up.
    pub fn message(&mut self) -> Option<Result<(MavlinkVersion, In), Refused>> {
        let raw = match self.reader.read_any_raw_message::<MavMessage>() {
            Ok(raw) => raw,
            Err(MessageReadError::Io(_)) => return None,
            Err(MessageReadError::Parse(_)) => return Some(Err(Refused::Malformed)),
        };
        let trusted = match (&self.signing, &raw) {
            (None, _) => true,
            (Some(_), MAVLinkMessageRaw::V1(_)) => false,
            (Some(signing), MAVLinkMessageRaw::V2(raw)) => signing.verify_signature(raw),
        };
        if !trusted {
            return Some(Err(Refused::Signature));
        }
        Some(In::parse(&raw).map(|message| (raw.version(), message)).map_err(|_| Refused::Malformed))
    }
}

/// Which version of MAVLink is spoken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Versions {
    /// That of the ground station, where the message exists in it
    #[default]
    Auto,
    /// Nothing that does not exist in version 1
    #[value(name = "1")]
    One,
    /// Nothing that is not version 2
    #[value(name = "2")]
    Two,
}

/// Makes the bytes of messages for one ground station.
pub struct Writer {
    system: u8,
    versions: Versions,
    /// By component, for each counts its own messages.
    sequences: [u8; 256],
    /// It has been shown that there is a version 2.
    greeted: bool,
    signing: Option<Rc<SigningData>>,
}

const V1_ID_MAX: u32 = 255;

impl Writer {
    pub fn new(system: u8, versions: Versions, signing: Option<Rc<SigningData>>) -> Writer {
        Writer { system, versions, sequences: [0; 256], greeted: false, signing }
    }

    /// The bytes of a message to a station that was last heard in version `heard`. `None` if that does not exist.
    pub fn bytes(&mut self, out: &Out, heard: Option<MavlinkVersion>, custom: Custom) -> Option<Vec<u8>> {
        let wire = Wire { out, custom };
        let id = wire.message_id();
        let version = match (self.versions, heard) {
            (Versions::One, _) if id > V1_ID_MAX => return None,
            (Versions::One, _) => MavlinkVersion::V1,
            // Signatures exist in version 2 only.
            (Versions::Auto, Some(MavlinkVersion::V1)) if id <= V1_ID_MAX && self.greeted && self.signing.is_none() => {
                MavlinkVersion::V1
            }
            _ => MavlinkVersion::V2,
        };
        self.greeted = true;
        let sequence = &mut self.sequences[usize::from(out.component)];
        let header = MavHeader { system_id: self.system.into(), component_id: out.component, sequence: *sequence };
        *sequence = sequence.wrapping_add(1);
        Some(match (version, &self.signing) {
            (MavlinkVersion::V1, _) => {
                let mut raw = MAVLinkV1MessageRaw::new();
                raw.serialize_message(header, &wire);
                raw.raw_bytes().to_vec()
            }
            (MavlinkVersion::V2, None) => {
                let mut raw = MAVLinkV2MessageRaw::new();
                raw.serialize_message(header, &wire);
                raw.raw_bytes().to_vec()
            }
            (MavlinkVersion::V2, Some(signing)) => {
                let mut raw = MAVLinkV2MessageRaw::new();
                raw.serialize_message_for_signing(header, &wire);
                signing.sign_message(&mut raw);
                raw.raw_bytes().to_vec()
            }
        })
    }
}

/// A message together with what its bytes depend on.
struct Wire<'a> {
    out: &'a Out,
    custom: Custom,
}

const STATUS_MODE_AT: usize = 15;
const ACK_COMMAND_AT: usize = 0;

/// Writes bytes over those of a payload whose trailing zeros are not counted; gives its new length.
fn patch(payload: &mut [u8], len: usize, at: usize, bytes: &[u8]) -> usize {
    payload[at..at + bytes.len()].copy_from_slice(bytes);
    let last = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| at + last + 1);
    len.max(last)
}

impl Message for Wire<'_> {
    fn message_id(&self) -> u32 {
        match &self.out.content {
            Content::Message(message) => message.message_id(),
            Content::Status { .. } => UAVCAN_NODE_STATUS_DATA::ID,
            Content::Ack { .. } => COMMAND_ACK_DATA::ID,
            Content::Parameter { .. } => PARAM_VALUE_DATA::ID,
            Content::Capabilities { .. } => AUTOPILOT_VERSION_DATA::ID,
        }
    }

    fn ser(&self, version: MavlinkVersion, bytes: &mut [u8]) -> usize {
        match &self.out.content {
            Content::Message(message) => message.ser(version, bytes),
            Content::Status { data, mode } => {
                let len = data.ser(version, bytes);
                patch(bytes, len, STATUS_MODE_AT, &[*mode])
            }
            Content::Ack { command, result, to } => {
                let (target_system, target_component) = *to;
                let data = COMMAND_ACK_DATA {
                    result: *result,
                    target_system,
                    target_component,
                    ..COMMAND_ACK_DATA::default()
                };
                let len = data.ser(version, bytes);
                patch(bytes, len, ACK_COMMAND_AT, &command.to_le_bytes())
            }
            Content::Parameter { name, number, count, index } => PARAM_VALUE_DATA {
                param_value: number.encode(self.custom),
                param_count: *count,
                param_index: *index,
                param_id: chars(name.as_bytes()),
                param_type: number.kind(),
            }
            .ser(version, bytes),
            Content::Capabilities { software, uid } => {
                let encoding = match self.custom {
                    Custom::Bytewise => MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE,
                    Custom::Cast => MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST,
                };
                let capabilities = encoding
                    | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2
                    | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT;
                let data = AUTOPILOT_VERSION_DATA {
                    capabilities,
                    uid: *uid,
                    flight_sw_version: *software,
                    ..AUTOPILOT_VERSION_DATA::default()
                };
                data.ser(version, bytes)
            }
        }
    }

    fn extra_crc(id: u32) -> u8 {
        MavMessage::extra_crc(id)
    }

    fn message_name(&self) -> &'static str {
        ""
    }

    fn target_system_id(&self) -> Option<u8> {
        None
    }

    fn target_component_id(&self) -> Option<u8> {
        None
    }

    fn target_system_id_mut(&mut self) -> Option<&mut u8> {
        None
    }

    fn target_component_id_mut(&mut self) -> Option<&mut u8> {
        None
    }

    fn parse(_: MavlinkVersion, id: u32, _: &[u8]) -> Result<Self, ParserError> {
        Err(ParserError::UnknownMessage { id })
    }

    fn message_id_from_name(_: &str) -> Option<u32> {
        None
    }

    fn default_message_from_id(_: u32) -> Option<Self> {
        None
    }
}
