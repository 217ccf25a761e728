//! Identifiers and tail bytes (specification, chapter 4).
//!
//! ```text
//! message:   priority[28:24] data_type[23:8]                                  0[7] source[6:0]
//! anonymous: priority[28:24] discriminator[23:10] data_type[9:8]              0[7] 0[6:0]
//! service:   priority[28:24] service[23:16] request[15] destination[14:8]     1[7] source[6:0]
//! tail:      start_of_transfer[7] end_of_transfer[6] toggle[5] transfer_id[4:0]
//! ```

/// The 29 bits of an identifier, most significant byte first. Bytes and not an `u32`, because the AVR shifts one bit at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Id(pub [u8; 4]);

impl Id {
    const PRIORITY: u8 = 0x1F;
    const SERVICE: u8 = 1 << 7;
    const REQUEST: u8 = 1 << 7;
    const NODE: u8 = 0x7F;

    /// The identifier of a message. Source 0 is an anonymous node.
    #[inline(always)]
    pub const fn message(priority: u8, data_type: u16, source: u8) -> Self {
        let [high, low] = data_type.to_be_bytes();
        Self([priority, high, low, source])
    }

    /// The identifier of a request to a node.
    #[inline(always)]
    pub const fn request(priority: u8, service: u8, destination: u8, source: u8) -> Self {
        Self([priority, service, Self::REQUEST | destination, Self::SERVICE | source])
    }

    /// The identifier of the response to a request.
    #[inline(always)]
    pub const fn response(priority: u8, service: u8, destination: u8, source: u8) -> Self {
        Self([priority, service, destination, Self::SERVICE | source])
    }

    /// 0 (wins every arbitration) to 31.
    #[inline(always)]
    pub const fn priority(self) -> u8 {
        self.0[0] & Self::PRIORITY
    }

    /// A service and not a message.
    #[inline(always)]
    pub const fn is_service(self) -> bool {
        self.0[3] & Self::SERVICE != 0
    }

    /// Of a message: the data type ID.
    #[inline(always)]
    pub const fn data_type(self) -> u16 {
        u16::from_le_bytes([self.0[2], self.0[1]])
    }

    /// Of an anonymous message: the two bits of the data type ID that it has.
    #[inline(always)]
    pub const fn anonymous_data_type(self) -> u16 {
        self.data_type() & 0b11
    }

    /// Of a service: the service ID.
    #[inline(always)]
    pub const fn service(self) -> u8 {
        self.0[1]
    }

    /// Of a service: a request to this node.
    #[inline(always)]
    pub const fn is_request_to(self, node: u8) -> bool {
        self.0[2] == Self::REQUEST | node
    }

    /// Node ID of the sender: 1 to 127, or 0 of an anonymous one.
    #[inline(always)]
    pub const fn source(self) -> u8 {
        self.0[3] & Self::NODE
    }
}

/// The last data byte of each frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tail(pub u8);

impl Tail {
    /// First frame of a transfer.
    pub const START: u8 = 1 << 7;
    /// Last frame of a transfer.
    pub const END: u8 = 1 << 6;
    /// Alternates from frame to frame, from 0.
    pub const TOGGLE: u8 = 1 << 5;
    /// Number of the transfer, modulo 32.
    pub const TRANSFER_ID: u8 = 31;

    /// The first frame.
    #[inline(always)]
    pub const fn is_start(self) -> bool {
        self.0 & Self::START != 0
    }

    /// The last frame.
    #[inline(always)]
    pub const fn is_end(self) -> bool {
        self.0 & Self::END != 0
    }

    /// A transfer of one frame.
    #[inline(always)]
    pub const fn is_single(self) -> bool {
        self.0 >= Self::START | Self::END
    }

    /// The toggle bit.
    #[inline(always)]
    pub const fn toggle(self) -> bool {
        self.0 & Self::TOGGLE != 0
    }

    /// 0 to 31.
    #[inline(always)]
    pub const fn transfer_id(self) -> u8 {
        self.0 & Self::TRANSFER_ID
    }

    /// Whether this is the frame after one with the tail `before`: the same transfer, the other toggle.
    #[inline(always)]
    pub const fn follows(self, before: Self) -> bool {
        (before.0 ^ self.0) & (Self::TOGGLE | Self::TRANSFER_ID) == Self::TOGGLE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fields_of_an_identifier_are_where_the_specification_draws_them() {
        for (source, data_type, priority) in [(1, 0, 0), (127, 0xFFFF, 31), (42, 341, 24), (10, 1010, 16)] {
            let id = Id::message(priority, data_type, source);
            let number = u32::from_be_bytes(id.0);
            assert_eq!(number, u32::from(priority) << 24 | u32::from(data_type) << 8 | u32::from(source));
            assert!(!id.is_service());
            assert_eq!((id.priority(), id.data_type(), id.source()), (priority, data_type, source));
        }
        // GetNodeInfo from 127 to 42, and the answer, by pydronecan.
        let (request, response) = (Id::request(30, 1, 42, 127), Id::response(30, 1, 127, 42));
        assert_eq!((request.0, response.0), ([0x1E, 0x01, 0xAA, 0xFF], [0x1E, 0x01, 0x7F, 0xAA]));
        assert!(request.is_service() && request.is_request_to(42) && !request.is_request_to(43));
        assert!(response.is_service() && !response.is_request_to(127));
        assert_eq!((request.service(), request.source(), response.source()), (1, 127, 42));
    }

    #[test]
    fn a_frame_follows_with_the_other_toggle_and_the_same_transfer_id() {
        let first = Tail(Tail::START | 5);
        assert!(Tail(Tail::TOGGLE | 5).follows(first) && Tail(Tail::END | Tail::TOGGLE | 5).follows(first));
        assert!(!Tail(5).follows(first) && !Tail(Tail::TOGGLE | 6).follows(first));
    }
}
