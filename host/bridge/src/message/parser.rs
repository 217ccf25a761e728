//! Finds and decodes the messages in a stream of bytes.

use super::{Command, In, Request, gaps, name};
use crate::signing::{Rejection, Signer};
use mavlink::dialects::common::{
    CAN_FILTER_MODIFY_DATA, CAN_FRAME_DATA, COMMAND_INT_DATA, COMMAND_LONG_DATA,
    FILE_TRANSFER_PROTOCOL_DATA, HEARTBEAT_DATA, MavMessage, PARAM_REQUEST_LIST_DATA,
    PARAM_REQUEST_READ_DATA, PARAM_SET_DATA, RADIO_STATUS_DATA,
};
use mavlink::error::{MessageReadError, ParserError};
use mavlink::{MAVLinkMessageRaw, MavlinkReader, MavlinkVersion, MessageData};
use std::collections::VecDeque;
use std::io::{self, Read};

impl In {
    /// Decodes a message whose CRC is valid.
    ///
    /// # Errors
    /// If a field has an invalid value.
    fn parse(raw: &MAVLinkMessageRaw) -> Result<In, ParserError> {
        let version = raw.version();
        // MAVLink 2 does not send trailing zeros.
        let mut payload = [0; gaps::PAYLOAD_MAX];
        payload[..raw.payload().len()].copy_from_slice(raw.payload());
        let (to, request) = match raw.message_id() {
            HEARTBEAT_DATA::ID => {
                let (kind, autopilot) = gaps::heartbeat_kind(&payload);
                ((0, 0), Request::Heartbeat { kind, autopilot })
            }
            PARAM_REQUEST_LIST_DATA::ID => {
                let data = PARAM_REQUEST_LIST_DATA::deser(version, &payload)?;
                ((data.target_system, data.target_component), Request::ParameterList)
            }
            PARAM_REQUEST_READ_DATA::ID => {
                let data = PARAM_REQUEST_READ_DATA::deser(version, &payload)?;
                let request = Request::ParameterRead {
                    index: u16::try_from(data.param_index).ok(),
                    name: name(&data.param_id),
                };
                ((data.target_system, data.target_component), request)
            }
            PARAM_SET_DATA::ID => {
                let kind = gaps::take_param_type(&mut payload);
                let data = PARAM_SET_DATA::deser(version, &payload)?;
                let request = Request::ParameterSet {
                    name: name(&data.param_id),
                    value: data.param_value,
                    kind,
                };
                ((data.target_system, data.target_component), request)
            }
            COMMAND_LONG_DATA::ID => {
                let number = gaps::take_command(&mut payload);
                let d = COMMAND_LONG_DATA::deser(version, &payload)?;
                let params = [d.param1, d.param2, d.param3, d.param4, d.param5, d.param6, d.param7];
                (
                    (d.target_system, d.target_component),
                    Request::Command(Command { number, params }),
                )
            }
            COMMAND_INT_DATA::ID => {
                let number = gaps::take_command(&mut payload);
                gaps::replace_frame(&mut payload);
                let d = COMMAND_INT_DATA::deser(version, &payload)?;
                let params = [d.param1, d.param2, d.param3, d.param4, d.x as f32, d.y as f32, d.z];
                (
                    (d.target_system, d.target_component),
                    Request::Command(Command { number, params }),
                )
            }
            CAN_FRAME_DATA::ID => {
                let data = CAN_FRAME_DATA::deser(version, &payload)?;
                ((data.target_system, data.target_component), Request::Frame(data))
            }
            CAN_FILTER_MODIFY_DATA::ID => {
                let data = CAN_FILTER_MODIFY_DATA::deser(version, &payload)?;
                ((data.target_system, data.target_component), Request::Filter(data))
            }
            FILE_TRANSFER_PROTOCOL_DATA::ID => {
                let data = FILE_TRANSFER_PROTOCOL_DATA::deser(version, &payload)?;
                ((data.target_system, data.target_component), Request::Ftp(Box::new(data.payload)))
            }
            RADIO_STATUS_DATA::ID => {
                let data = RADIO_STATUS_DATA::deser(version, &payload)?;
                ((0, 0), Request::Radio { free_percent: data.txbuf })
            }
            _ => ((0, 0), Request::Other),
        };
        Ok(In { from: (raw.system_id().min(255) as u8, raw.component_id()), to, request })
    }
}

/// Received bytes that were not examined yet.
#[derive(Default)]
struct Buffer(VecDeque<u8>);

impl Read for Buffer {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.0.is_empty() {
            return Err(io::ErrorKind::WouldBlock.into());
        }
        self.0.read(buffer)
    }
}

/// A message with its version, or why it was rejected.
pub type Received = Result<(MavlinkVersion, In), Refused>;

/// Why a message was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// A field has an invalid value.
    Malformed,
    /// The signature is missing, wrong or old.
    Signature(Rejection),
}

/// Finds the messages in a stream of bytes.
pub struct Parser {
    reader: MavlinkReader<Buffer>,
    signer: Option<Signer>,
}

impl Parser {
    /// With a signer, accepts signed messages only, and [`Request::Radio`] also without a
    /// signature.
    pub fn new(signer: Option<Signer>) -> Parser {
        Parser { reader: MavlinkReader::new(Buffer::default()), signer }
    }

    /// Adds received bytes.
    pub fn feed(&mut self, bytes: &[u8]) {
        self.reader.get_mut().0.extend(bytes);
    }

    /// The next message; `None` when all bytes are used up.
    pub fn message(&mut self) -> Option<Received> {
        let raw = match self.reader.read_any_raw_message::<MavMessage>() {
            Ok(raw) => raw,
            Err(MessageReadError::Io(_)) => return None,
            Err(MessageReadError::Parse(_)) => return Some(Err(Refused::Malformed)),
        };
        let checked = match (&self.signer, &raw) {
            (None, _) => Ok(()),
            // A radio has no key.
            (Some(_), raw) if raw.message_id() == RADIO_STATUS_DATA::ID => Ok(()),
            (Some(_), MAVLinkMessageRaw::V1(_)) => Err(Rejection::Unsigned),
            (Some(signer), MAVLinkMessageRaw::V2(raw)) => signer.check(raw),
        };
        if let Err(why) = checked {
            return Some(Err(Refused::Signature(why)));
        }
        Some(
            In::parse(&raw).map(|message| (raw.version(), message)).map_err(|_| Refused::Malformed),
        )
    }
}
