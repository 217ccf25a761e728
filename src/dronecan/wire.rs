//! Where things are in an identifier and in a tail byte (specification, chapter 4).
//!
//! ```text
//! message: priority[28:24] data_type_id[23:8]                         0[7] source_node_id[6:0]
//! service: priority[28:24] data_type_id[23:16] request[15] to[14:8]   1[7] source_node_id[6:0]
//! tail:    start_of_transfer[7] end_of_transfer[6] toggle[5] transfer_id[4:0]
//! ```

/// In the last byte of an identifier: a service.
pub const SERVICE_NOT_MESSAGE: u8 = 1 << 7;
/// In the byte before, of a service: a request.
pub const REQUEST_NOT_RESPONSE: u8 = 1 << 7;

/// In the tail byte.
pub const START_OF_TRANSFER: u8 = 1 << 7;
/// In the tail byte.
pub const END_OF_TRANSFER: u8 = 1 << 6;
/// In the tail byte.
pub const TOGGLE: u8 = 1 << 5;
/// In the tail byte: the number of the transfer, 0 to 31.
pub const TRANSFER_ID: u8 = 31;
