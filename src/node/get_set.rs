//! Requests to read or set a parameter (DSDL uavcan/protocol/param/11.GetSet.uavcan).

use dronecan_wire::Received;

use crate::tables::Constants;
use crate::tables::kind::Kind;
use crate::tables::parameters::{self, Parameters};
use crate::tables::wire::Transfer;

/// A decoded GetSet request.
pub struct GetSet {
    /// The index of the parameter; [`parameters::NONE`] if the name is unknown or the index does
    /// not fit in eight bits.
    pub parameter: u8,
    /// The value to set. `None` if the request has no integer, or one that does not fit in 32
    /// bits.
    pub value: Option<i32>,
}

impl GetSet {
    /// Reads a request (DSDL 11.GetSet.uavcan): 13 bits of index, 3 of tag, the value, the name.
    /// Returns `None` if it is too short.
    pub fn read(request: &Transfer, flash: impl Constants) -> Option<Self> {
        const INTEGER: u8 = 1;
        let &[index, index_and_tag, v0, v1, v2, v3, v4, v5, v6, v7, ..] = request.bytes();
        let tag = index_and_tag & 7;
        let value_len = match tag {
            0 => 0,
            INTEGER => 8,
            2 => 4,
            3 => 1,
            // A text, which the receiver may have left out.
            _ if Kind::TAKES_ENTRIES => 1,
            // At most 128 bytes. So long a text leaves no whole name.
            _ => (v0 & 0x7F) + 1,
        };
        let name_at = value_len + 2;
        if name_at > request.len() || request.is_too_short() {
            return None;
        }
        let mut parameter = if index_and_tag >> 3 == 0 { index } else { parameters::NONE };
        if name_at != request.len() {
            let name = request.payload_from(name_at);
            parameter = name.map_or(parameters::NONE, |name| Parameters::find(name, flash));
        }
        let number = i32::from_le_bytes([v0, v1, v2, v3]);
        // The upper four bytes may only repeat the sign.
        let sign = (v3 as i8 >> 7) as u8;
        let is_number = tag == INTEGER && v4 == sign && v5 == sign && v6 == sign && v7 == sign;
        Some(Self { parameter, value: is_number.then_some(number) })
    }
}
