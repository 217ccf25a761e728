//! Encodes the messages for one ground station.
//!
//! The bridge answers a ground station in the station's version of MAVLink. But the first message
//! to it has version 2, because some stations (with pymavlink) begin with version 1 and continue in
//! the version that they first receive. Messages with numbers above 255 do not exist in version 1.
//! The bridge sends them in version 2 unless the user forbids that; a parser of version 1
//! ignores them.

use super::{Content, Out, chars, gaps};
use crate::number::IntegerEncoding;
use crate::signing::Signer;
use mavlink::dialects::common::{
    AUTOPILOT_VERSION_DATA, COMMAND_ACK_DATA, MavMessage, MavProtocolCapability, PARAM_VALUE_DATA,
    UAVCAN_NODE_STATUS_DATA,
};
use mavlink::error::ParserError;
use mavlink::{
    MAVLinkV1MessageRaw, MAVLinkV2MessageRaw, MavHeader, MavlinkVersion, Message, MessageData,
};

/// The version of MAVLink in which the bridge sends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Versions {
    /// The ground station's version, if the message exists in it
    #[default]
    Auto,
    /// Only messages that exist in version 1
    #[value(name = "1")]
    One,
    /// Only version 2
    #[value(name = "2")]
    Two,
}

/// Encodes the messages for one ground station.
pub struct Writer {
    system: u8,
    versions: Versions,
    /// Sequence numbers by component.
    sequences: [u8; 256],
    /// True after a message in version 2 was sent.
    has_sent_v2: bool,
    signer: Option<Signer>,
}

const V1_ID_MAX: u32 = 255;
/// Length of AUTOPILOT_VERSION.uid2 in bytes. DroneCAN's unique ID has 16.
const UID2_LEN: usize = 18;

impl Writer {
    pub fn new(system: u8, versions: Versions, signer: Option<Signer>) -> Writer {
        Writer { system, versions, sequences: [0; 256], has_sent_v2: false, signer }
    }

    /// The bytes of a message. `heard` is the version of the station's last message. `None` if the
    /// message does not exist in the version.
    pub fn bytes(
        &mut self,
        out: &Out,
        heard: Option<MavlinkVersion>,
        encoding: IntegerEncoding,
    ) -> Option<Vec<u8>> {
        let wire = Wire { out, encoding };
        let id = wire.message_id();
        let version = match (self.versions, heard) {
            (Versions::One, _) if id > V1_ID_MAX => return None,
            (Versions::One, _) => MavlinkVersion::V1,
            // Signatures exist in version 2 only.
            (Versions::Auto, Some(MavlinkVersion::V1))
                if id <= V1_ID_MAX && self.has_sent_v2 && self.signer.is_none() =>
            {
                MavlinkVersion::V1
            }
            _ => MavlinkVersion::V2,
        };
        self.has_sent_v2 = true;
        let sequence = &mut self.sequences[usize::from(out.component)];
        let header = MavHeader {
            system_id: self.system.into(),
            component_id: out.component,
            sequence: *sequence,
        };
        *sequence = sequence.wrapping_add(1);
        Some(match (version, &self.signer) {
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
            (MavlinkVersion::V2, Some(signer)) => {
                let mut raw = MAVLinkV2MessageRaw::new();
                raw.serialize_message_for_signing(header, &wire);
                signer.sign(&mut raw);
                raw.raw_bytes().to_vec()
            }
        })
    }
}

/// A message with the data that its bytes depend on.
struct Wire<'a> {
    out: &'a Out,
    encoding: IntegerEncoding,
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
                gaps::put_mode(bytes, len, *mode)
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
                gaps::put_acknowledged_command(bytes, len, *command)
            }
            Content::Parameter { name, number, count, index } => PARAM_VALUE_DATA {
                param_value: number.encode(self.encoding),
                param_count: *count,
                param_index: *index,
                param_id: chars(name.as_bytes()),
                param_type: number.kind(),
            }
            .ser(version, bytes),
            Content::Capabilities { software, unique_id } => {
                let [uid @ .., _, _, _, _, _, _, _, _] = *unique_id;
                let mut uid2 = [0; UID2_LEN];
                uid2[..unique_id.len()].copy_from_slice(unique_id);
                let encoding = match self.encoding {
                    IntegerEncoding::Bytewise => {
                        MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
                    }
                    IntegerEncoding::Cast => {
                        MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
                    }
                };
                let capabilities = encoding
                    | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2
                    | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT;
                let data = AUTOPILOT_VERSION_DATA {
                    capabilities,
                    uid: u64::from_le_bytes(uid),
                    uid2,
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
