//! The 29-bit identifier of the draft.
//!
//! ```text
//! type[28:19] transfer type[18:17] source[16:10] frame index[9:4] last[3] transfer ID[2:0]
//! ```
//! The data type is in the most significant bits, so it is the priority.

use crate::id::NodeId;
use crate::transfer::TransferNumber;
use crate::types::Kind;

const TYPE_SHIFT: u32 = 19;
const TRANSFER_TYPE_SHIFT: u32 = 17;
const SOURCE_SHIFT: u32 = 10;
const INDEX_SHIFT: u32 = 4;
const LAST_FLAG: u32 = 1 << 3;
const TYPE_MASK: u32 = 0x3FF;
const TRANSFER_TYPE_MASK: u32 = 0x3;
const INDEX_MASK: u32 = 0x3F;

/// Index of the last frame of the longest transfer.
pub const INDEX_MAX: u8 = 62;

/// Transfer ID, modulo 8.
pub type TransferId = TransferNumber<3>;

/// Recipients and purpose of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TransferType {
    ServiceResponse,
    ServiceRequest,
    /// A message to all nodes.
    MessageBroadcast,
    /// A message to one node.
    MessageUnicast,
}

impl TransferType {
    fn from_field(field: u32) -> TransferType {
        match field & TRANSFER_TYPE_MASK {
            0 => TransferType::ServiceResponse,
            1 => TransferType::ServiceRequest,
            2 => TransferType::MessageBroadcast,
            _ => TransferType::MessageUnicast,
        }
    }

    /// Whether its data types are messages or services.
    pub fn kind(self) -> Kind {
        match self {
            TransferType::MessageBroadcast | TransferType::MessageUnicast => Kind::Message,
            TransferType::ServiceRequest | TransferType::ServiceResponse => Kind::Service,
        }
    }

    /// True if the first byte of each frame is the destination.
    pub fn has_destination(self) -> bool {
        self != TransferType::MessageBroadcast
    }
}

/// A parsed identifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CanId {
    /// Data type ID, 0 to 1023. Messages and services have separate IDs.
    pub type_id: u16,
    pub transfer_type: TransferType,
    pub source: NodeId,
    /// Index of the frame in its transfer, 0 to [`INDEX_MAX`].
    pub index: u8,
    /// True for the last frame of its transfer.
    pub last: bool,
    pub transfer_id: TransferId,
}

impl CanId {
    /// Reads a 29-bit identifier. `None` if the draft forbids it: source node 0, an index above
    /// [`INDEX_MAX`], or that index in a frame that is not the last.
    pub fn parse(id: u32) -> Option<CanId> {
        let index = (id >> INDEX_SHIFT & INDEX_MASK) as u8;
        let last = id & LAST_FLAG != 0;
        if index > INDEX_MAX || index == INDEX_MAX && !last {
            return None;
        }
        Some(CanId {
            type_id: (id >> TYPE_SHIFT & TYPE_MASK) as u16,
            transfer_type: TransferType::from_field(id >> TRANSFER_TYPE_SHIFT),
            source: NodeId::from_field(id >> SOURCE_SHIFT)?,
            index,
            last,
            transfer_id: TransferId::new(id as u8),
        })
    }

    /// The 29-bit identifier. Values that are too large for their field are truncated.
    pub fn build(self) -> u32 {
        (u32::from(self.type_id) & TYPE_MASK) << TYPE_SHIFT
            | (self.transfer_type as u32) << TRANSFER_TYPE_SHIFT
            | u32::from(self.source.get()) << SOURCE_SHIFT
            | (u32::from(self.index) & INDEX_MASK) << INDEX_SHIFT
            | if self.last { LAST_FLAG } else { 0 }
            | u32::from(self.transfer_id.get())
    }
}
