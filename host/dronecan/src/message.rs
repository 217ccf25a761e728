//! A decoded transfer of any type, and its text for the traffic view.

use crate::actuator::{ActuatorCommand, ActuatorStatus};
use crate::battery::BatteryInfo;
use crate::broadcast::*;
use crate::dispatch::{decode, encode, message_enum, write_fields};
use crate::esc;
use crate::management::{
    NodeInfo, NumberAndText, Opcode, ParameterRequest, ParameterResponse, TransportStats,
    decode_executed, decode_restart, decode_restarted, encode_executed, encode_restart,
    encode_restarted, write_magic, write_ok, write_result, write_update,
};
use crate::status::NodeStatus;
use crate::table::table;
use crate::text::{display, list};
use crate::types::{self, DataType};
use crate::{CanId, Transfer};
use std::fmt;

table!(message_enum);

impl Message {
    /// Decodes a transfer. Never fails: what cannot be decoded is `Other`.
    pub fn decode(transfer: &Transfer) -> Message {
        let payload = transfer.payload.as_slice();
        Message::decode_known(transfer.id, payload).unwrap_or_else(|| Message::Other {
            name: name_of(transfer.id),
            payload: payload.to_vec(),
        })
    }

    fn decode_known(id: CanId, payload: &[u8]) -> Option<Message> {
        let data_type = DataType::of(id)?;
        match id {
            CanId::Service { request: true, .. } => Message::decode_request(data_type, payload),
            CanId::Service { request: false, .. } => Message::decode_response(data_type, payload),
            _ => Message::decode_message(data_type, payload),
        }
    }
}

/// Name of the type of an identifier: "GetNodeInfo request", "message 2222".
pub fn name_of(id: CanId) -> String {
    let direction = match id {
        CanId::Service { request: true, .. } => " request",
        CanId::Service { request: false, .. } => " response",
        _ => "",
    };
    let name = match (DataType::of(id), id) {
        (Some(known), _) => known.name.to_owned(),
        (None, CanId::Message { type_id, .. }) => format!("message {type_id}"),
        (None, CanId::Anonymous { type_id, .. }) => format!("message {type_id}"),
        (None, CanId::Service { service_id, .. }) => format!("service {service_id}"),
    };
    name + direction
}
