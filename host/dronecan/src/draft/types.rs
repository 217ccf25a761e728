//! Names and CRC seeds of the draft's data types.
//!
//! `draft/table.rs` has a row for each type, and the sources.

use dronecan_wire::crc;

use super::id::TransferType;
use super::table::table;
use crate::dispatch::constants;
use crate::types::Kind;

/// A known type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DataType {
    pub kind: Kind,
    pub id: u16,
    pub name: &'static str,
    /// CRC at the beginning of a transfer, if it is known.
    pub seed: Option<u16>,
}

const fn message(id: u16, name: &'static str, signature: u64) -> DataType {
    DataType { kind: Kind::Message, id, name, seed: Some(crc::seed(signature)) }
}

const fn service(id: u16, name: &'static str, signature: u64) -> DataType {
    DataType { kind: Kind::Service, id, name, seed: Some(crc::seed(signature)) }
}

const fn named(kind: Kind, id: u16, name: &'static str) -> DataType {
    DataType { kind, id, name, seed: None }
}

table!(constants);

impl DataType {
    /// The type with this ID in a transfer of this type, if it is known.
    pub fn of(type_id: u16, transfer_type: TransferType) -> Option<&'static DataType> {
        KNOWN.iter().find(|known| known.kind == transfer_type.kind() && known.id == type_id)
    }
}
