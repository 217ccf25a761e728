//! Payloads of the draft that are decoded completely, and their text for the traffic view.

use super::id::TransferType;
use super::parameters;
use super::table::table;
use super::transfer::Transfer;
use super::types::{self, DataType};
use crate::bits::{Reader, Writer};
use crate::broadcast::{decode_byte, encode_byte};
use crate::dispatch::{decode, encode, message_enum, write_fields};
use crate::fields::{Field, payload};
use crate::management::{
    self, ParameterRequest, ParameterResponse, decode_restart, decode_restarted, encode_restart,
    encode_restarted, write_magic, write_ok,
};
use crate::status::{Health, Mode};
use crate::text::{display, list, numbered};
use crate::types::Kind;
use half::f16;
use std::fmt;

numbered! {
    /// Status code of a node. 4 to 14 are not defined.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub enum StatusCode or Undefined "status {}" {
        #[default]
        Ok = 0 "OK",
        Initializing = 1 "INITIALIZING",
        Warning = 2 "WARNING",
        Critical = 3 "CRITICAL",
        Offline = 15 "OFFLINE",
    }
}

/// The vendor-specific code: none until 2015-02-03, then 32 bits, from 2015-03-19 on 16 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum VendorCode {
    #[default]
    None,
    Short(u16),
    Long(u32),
}

impl VendorCode {
    /// As 16 bits: none is 0, and a long code loses its upper half.
    pub fn low(self) -> u16 {
        match self {
            VendorCode::None => 0,
            VendorCode::Short(code) => code,
            VendorCode::Long(code) => code as u16,
        }
    }
}

/// protocol.NodeStatus. Layout: `uptime_sec u28 | status code u4 | vendor code`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NodeStatus {
    /// 28 bits.
    pub uptime_s: u32,
    pub code: StatusCode,
    pub vendor_code: VendorCode,
}

const UPTIME_BITS: u32 = 28;
const CODE_BITS: u32 = 4;

impl NodeStatus {
    /// `None` unless the payload has four, six, seven or eight bytes. Seven bytes are the thesis's
    /// node, which uses the fields of v0: `uptime_sec u32 | state u8 | vendor code u16`. For a
    /// parser of the draft the uptime's most significant byte is the status code,
    /// so such a node is OK for its first 194 days, whatever its state is.
    pub fn decode(payload: &[u8]) -> Option<NodeStatus> {
        let mut bits = Reader::new(payload);
        let uptime_s = bits.take(UPTIME_BITS)? as u32;
        let code = StatusCode::take(&mut bits, CODE_BITS)?;
        if payload.len() == 7 {
            bits.take(8)?;
        }
        let vendor_code = match payload.len() {
            4 => VendorCode::None,
            6 | 7 => VendorCode::Short(u16::take(&mut bits, 16)?),
            8 => VendorCode::Long(u32::take(&mut bits, 32)?),
            _ => return None,
        };
        Some(NodeStatus { uptime_s, code, vendor_code })
    }

    /// The payload: four, six or eight bytes, depending on the vendor code.
    pub fn encode(&self) -> Vec<u8> {
        let mut bits = Writer::default();
        self.uptime_s.put(&mut bits, UPTIME_BITS);
        self.code.put(&mut bits, CODE_BITS);
        match self.vendor_code {
            VendorCode::None => {}
            VendorCode::Short(code) => bits.put(u64::from(code), 16),
            VendorCode::Long(code) => bits.put(u64::from(code), 32),
        }
        bits.into_bytes()
    }
}

impl fmt::Display for NodeStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} up {} s", self.code, self.uptime_s)?;
        match self.vendor_code {
            VendorCode::None => Ok(()),
            VendorCode::Short(code) => write!(f, " vendor {code:#06X}"),
            VendorCode::Long(code) => write!(f, " vendor {code:#010X}"),
        }
    }
}

/// As a status of v0, for a view that shows both. A long vendor code loses its upper half.
impl From<NodeStatus> for crate::NodeStatus {
    fn from(status: NodeStatus) -> crate::NodeStatus {
        let (health, mode) = match status.code {
            StatusCode::Ok | StatusCode::Undefined(_) => (Health::Ok, Mode::Operational),
            StatusCode::Initializing => (Health::Ok, Mode::Initialization),
            StatusCode::Warning => (Health::Warning, Mode::Operational),
            StatusCode::Critical => (Health::Critical, Mode::Operational),
            StatusCode::Offline => (Health::Ok, Mode::Offline),
        };
        crate::NodeStatus {
            uptime_s: status.uptime_s,
            health,
            mode,
            sub_mode: 0,
            vendor_code: status.vendor_code.low(),
        }
    }
}

/// In a GetNodeInfo response the status has six bytes.
impl Field for NodeStatus {
    const BITS: u32 = 48;

    fn take(from: &mut Reader<'_>, _: u32) -> Option<NodeStatus> {
        Some(NodeStatus {
            uptime_s: u32::take(from, UPTIME_BITS)?,
            code: StatusCode::take(from, CODE_BITS)?,
            vendor_code: VendorCode::Short(u16::take(from, 16)?),
        })
    }

    fn put(&self, to: &mut Writer, _: u32) {
        self.uptime_s.put(to, UPTIME_BITS);
        self.code.put(to, CODE_BITS);
        self.vendor_code.low().put(to, 16);
    }
}

/// protocol.GetNodeInfo, response.
pub type NodeInfo = management::NodeInfo<NodeStatus>;

payload! {
    /// One element of equipment.actuator.ArrayCommand. A servo's command is -1 to +1.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct ActuatorCommand [31] {
        pub actuator: u8,
        pub value: f16,
    }
}

impl fmt::Display for ActuatorCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "id {} {:+.2}", self.actuator, self.value.to_f32())
    }
}

table!(message_enum);

impl Message {
    /// Decodes a transfer. Never fails: what cannot be decoded is `Other`.
    pub fn decode(transfer: &Transfer) -> Message {
        Message::decode_known(transfer).unwrap_or_else(|| Message::Other {
            name: name_of(transfer.type_id, transfer.route.transfer_type()),
            payload: transfer.payload.clone(),
        })
    }

    fn decode_known(transfer: &Transfer) -> Option<Message> {
        let (transfer_type, payload) = (transfer.route.transfer_type(), &transfer.payload);
        let data_type = DataType::of(transfer.type_id, transfer_type)?;
        match transfer_type {
            TransferType::ServiceRequest => Message::decode_request(data_type, payload),
            TransferType::ServiceResponse => Message::decode_response(data_type, payload),
            _ => Message::decode_message(data_type, payload),
        }
    }
}

/// Name of a type in a transfer of this kind: "draft.GetNodeInfo request", "draft message 222".
pub fn name_of(type_id: u16, transfer_type: TransferType) -> String {
    let direction = match transfer_type {
        TransferType::ServiceRequest => " request",
        TransferType::ServiceResponse => " response",
        TransferType::MessageBroadcast | TransferType::MessageUnicast => "",
    };
    match (DataType::of(type_id, transfer_type), transfer_type.kind()) {
        (Some(known), _) => format!("{}{direction}", known.name),
        (None, Kind::Message) => format!("draft message {type_id}"),
        (None, Kind::Service) => format!("draft service {type_id}{direction}"),
    }
}
