//! Names and signatures of the draft's data types.
//!
//! IDs and signatures are those of 2015-03-19, except ArrayCommand: its definition is the last one
//! without a unit. The thesis's two types are its own.

use super::id::TransferType;
use crate::types::Kind;

/// A known type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DataType {
    pub kind: Kind,
    pub id: u16,
    pub name: &'static str,
    /// Known signature, for the transfer CRC.
    pub signature: Option<u64>,
}

const fn message(id: u16, name: &'static str, signature: u64) -> DataType {
    DataType { kind: Kind::Message, id, name, signature: Some(signature) }
}

const fn service(id: u16, name: &'static str, signature: u64) -> DataType {
    DataType { kind: Kind::Service, id, name, signature: Some(signature) }
}

const fn named(kind: Kind, id: u16, name: &'static str) -> DataType {
    DataType { kind, id, name, signature: None }
}

pub const ARRAY_COMMAND: DataType = message(265, "draft.ArrayCommand", 0x1679_B64E_1786_5FFF);
pub const NODE_STATUS: DataType = message(550, "draft.NodeStatus", 0xE5EB_F57B_2D92_835D);
/// One byte: servo command, 0 to 255 over the full travel.
pub const THESIS_COMMAND: DataType = named(Kind::Message, 760, "draft.ThesisCommand");
/// One byte: a measurement of a node of the thesis, degrees Celsius or a count.
pub const THESIS_MEASUREMENT: DataType = named(Kind::Message, 761, "draft.ThesisMeasurement");
pub const GET_NODE_INFO: DataType = service(551, "draft.GetNodeInfo", 0x1CC6_F807_395C_AE42);
pub const RESTART_NODE: DataType = service(560, "draft.RestartNode", 0x569E_0539_4A30_17F0);
pub const GET_SET: DataType = service(599, "draft.param.GetSet", 0xDD4B_B39E_5963_C2C1);

/// All types with a name here.
pub const KNOWN: &[DataType] = &[
    ARRAY_COMMAND,
    NODE_STATUS,
    THESIS_COMMAND,
    THESIS_MEASUREMENT,
    GET_NODE_INFO,
    RESTART_NODE,
    GET_SET,
    message(600, "draft.actuator.Status", 0xE091_86B4_F837_A665),
    named(Kind::Message, 551, "draft.GlobalDiscoveryRequest"),
    named(Kind::Message, 660, "draft.hardpoint.Command"),
    named(Kind::Message, 661, "draft.hardpoint.Status"),
    named(Kind::Message, 748, "draft.LightsCommand"),
    named(Kind::Message, 1022, "draft.debug.KeyValue"),
    named(Kind::Message, 1023, "draft.debug.LogMessage"),
    named(Kind::Service, 583, "draft.file.Read"),
    named(Kind::Service, 589, "draft.BeginFirmwareUpdate"),
    named(Kind::Service, 598, "draft.param.ExecuteOpcode"),
];

impl DataType {
    /// The type with this ID in a transfer of this type, if it is known.
    pub fn of(type_id: u16, transfer_type: TransferType) -> Option<&'static DataType> {
        KNOWN.iter().find(|known| known.kind == transfer_type.kind() && known.id == type_id)
    }
}
