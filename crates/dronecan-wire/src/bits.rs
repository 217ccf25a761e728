//! Identifiers and tail bytes: the bits that DroneCAN adds to a CAN frame (specification, chapter
//! 4).
//!
//! ```text
//!            byte 0          byte 1               byte 2                         byte 3
//! message:   priority[28:24] data_type[23:16]     data_type[15:8]                0[7] source[6:0]
//! anonymous: priority[28:24] discriminator[23:16] discriminator[15:10] type[9:8] 0[7] 0[6:0]
//! service:   priority[28:24] service[23:16]       request[15] destination[14:8]  1[7] source[6:0]
//!
//! tail:      start_of_transfer[7] end_of_transfer[6] toggle[5] transfer_id[4:0]
//! ```

use embedded_can::ExtendedId;

/// Index of the byte of an [`Id`] that holds a field. Only [`Id`] reads the bytes.
mod byte {
    pub const PRIORITY: usize = 0;
    pub const DATA_TYPE_HIGH: usize = 1;
    pub const SERVICE: usize = 1;
    pub const DATA_TYPE_LOW: usize = 2;
    pub const DESTINATION: usize = 2;
    pub const SOURCE: usize = 3;
}

/// A 29-bit identifier, most significant byte first. It holds bytes and not a `u32`, because an AVR
/// shifts one bit at a time.
///
/// The three highest bits have no meaning. Messages and services have different fields in the same
/// bits, so call [`is_service`](Self::is_service) before the accessors of either.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Id([u8; 4]);

impl Id {
    /// The bits of the priority in the first byte.
    const PRIORITY: u8 = 0x1F;
    /// Bit in the last byte: the frame belongs to a service.
    const SERVICE: u8 = 1 << 7;
    /// Bit in the byte of the destination: the frame belongs to a request.
    const REQUEST: u8 = 1 << 7;
    /// The bits of a node ID.
    const NODE: u8 = 0x7F;
    /// The bits of the data type ID in an anonymous message.
    const ANONYMOUS_TYPE: u8 = 0b11;

    /// Makes an identifier of its bytes, the most significant first.
    pub const fn from_bytes(bytes: [u8; 4]) -> Self {
        Self(bytes)
    }

    /// The bytes, the most significant first.
    pub const fn to_bytes(self) -> [u8; 4] {
        self.0
    }

    /// Makes the identifier of a message. Source 0 is an anonymous node.
    pub const fn message(priority: u8, data_type: u16, source: u8) -> Self {
        let [high, low] = data_type.to_be_bytes();
        Self([priority, high, low, source])
    }

    /// Makes the identifier of an anonymous message. It holds only the lower two bits of the data
    /// type ID, and the lower 14 bits of `discriminator`. The discriminator is random or a
    /// checksum of the payload, so that two nodes do not send the same identifier.
    pub const fn anonymous(priority: u8, data_type: u16, discriminator: u16) -> Self {
        Self::message(priority, discriminator << 2 | data_type & Self::ANONYMOUS_TYPE as u16, 0)
    }

    /// Makes the identifier of a request to a node.
    pub const fn request(priority: u8, service: u8, destination: u8, source: u8) -> Self {
        Self([priority, service, Self::REQUEST | destination, Self::SERVICE | source])
    }

    /// Makes the identifier of the response to a request.
    pub const fn response(priority: u8, service: u8, destination: u8, source: u8) -> Self {
        Self([priority, service, destination, Self::SERVICE | source])
    }

    /// The priority: 0 (wins every arbitration) to 31.
    pub const fn priority(self) -> u8 {
        self.0[byte::PRIORITY] & Self::PRIORITY
    }

    /// True for a service, false for a message.
    pub const fn is_service(self) -> bool {
        self.0[byte::SOURCE] & Self::SERVICE != 0
    }

    /// The data type ID of a message.
    #[inline(always)]
    pub const fn data_type(self) -> u16 {
        u16::from_le_bytes([self.0[byte::DATA_TYPE_LOW], self.0[byte::DATA_TYPE_HIGH]])
    }

    /// The lower two bits of the data type ID of an anonymous message.
    pub const fn anonymous_data_type(self) -> u8 {
        self.0[byte::DATA_TYPE_LOW] & Self::ANONYMOUS_TYPE
    }

    /// The service ID of a service.
    pub const fn service(self) -> u8 {
        self.0[byte::SERVICE]
    }

    /// True for a request, false for a response. Only for a service.
    pub const fn is_request(self) -> bool {
        self.0[byte::DESTINATION] & Self::REQUEST != 0
    }

    /// True for a request to `node`. Only for a service.
    pub const fn is_request_to(self, node: u8) -> bool {
        self.0[byte::DESTINATION] == Self::REQUEST | node
    }

    /// True for a response to `node`. Only for a service.
    pub const fn is_response_to(self, node: u8) -> bool {
        self.0[byte::DESTINATION] == node
    }

    /// The node ID of the receiver of a service.
    pub const fn destination(self) -> u8 {
        self.0[byte::DESTINATION] & Self::NODE
    }

    /// The node ID of the sender: 1 to 127, or 0 if the sender is anonymous.
    pub const fn source(self) -> u8 {
        self.0[byte::SOURCE] & Self::NODE
    }
}

impl From<ExtendedId> for Id {
    fn from(id: ExtendedId) -> Self {
        Self(id.as_raw().to_be_bytes())
    }
}

impl From<Id> for ExtendedId {
    fn from(id: Id) -> Self {
        let raw = u32::from_be_bytes(id.0) & ExtendedId::MAX.as_raw();
        // The mask keeps the value in range, so the fallback to zero never applies.
        ExtendedId::new(raw).unwrap_or(ExtendedId::ZERO)
    }
}

impl From<Id> for embedded_can::Id {
    fn from(id: Id) -> Self {
        Self::Extended(id.into())
    }
}

/// The tail byte: the last data byte of each frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tail(pub u8);

impl Tail {
    /// The frame is the first of its transfer.
    pub const START: u8 = 1 << 7;
    /// The frame is the last of its transfer.
    pub const END: u8 = 1 << 6;
    /// The toggle bit: 0 in the first frame, and inverted in each further frame.
    pub const TOGGLE: u8 = 1 << 5;
    /// The bits of the transfer ID, which counts the transfers modulo 32.
    pub const TRANSFER_ID: u8 = 31;

    /// True for the first frame of a transfer.
    pub const fn is_start(self) -> bool {
        self.0 & Self::START != 0
    }

    /// True for the last frame of a transfer.
    pub const fn is_end(self) -> bool {
        self.0 & Self::END != 0
    }

    /// True for the only frame of a transfer.
    pub const fn is_single(self) -> bool {
        self.0 >= Self::START | Self::END
    }

    /// True if the toggle bit is set.
    pub const fn toggle(self) -> bool {
        self.0 & Self::TOGGLE != 0
    }

    /// The transfer ID: 0 to 31.
    pub const fn transfer_id(self) -> u8 {
        self.0 & Self::TRANSFER_ID
    }

    /// True if a frame with this tail can follow a frame with the tail `before`: the transfer ID is
    /// the same and the toggle bit is inverted.
    pub const fn follows(self, before: Self) -> bool {
        (before.0 ^ self.0) & (Self::TOGGLE | Self::TRANSFER_ID) == Self::TOGGLE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fields_of_an_identifier_are_where_the_specification_has_them() {
        for (source, data_type, priority) in
            [(1, 0, 0), (127, 0xFFFF, 31), (42, 341, 24), (10, 1010, 16)]
        {
            let id = Id::message(priority, data_type, source);
            let number = u32::from_be_bytes(id.to_bytes());
            assert_eq!(
                number,
                u32::from(priority) << 24 | u32::from(data_type) << 8 | u32::from(source)
            );
            assert!(!id.is_service());
            assert_eq!((id.priority(), id.data_type(), id.source()), (priority, data_type, source));
        }
        // GetNodeInfo from 127 to 42, and the response, by pydronecan.
        let (request, response) = (Id::request(30, 1, 42, 127), Id::response(30, 1, 127, 42));
        assert_eq!(
            (request.to_bytes(), response.to_bytes()),
            ([0x1E, 0x01, 0xAA, 0xFF], [0x1E, 0x01, 0x7F, 0xAA])
        );
        assert!(request.is_service() && request.is_request_to(42) && !request.is_request_to(43));
        assert!(response.is_service() && !response.is_request_to(127));
        assert_eq!((request.service(), request.source(), response.source()), (1, 127, 42));
        assert_eq!((request.is_request(), request.destination()), (true, 42));
        assert_eq!((response.is_request(), response.destination()), (false, 127));
    }

    #[test]
    fn an_anonymous_message_has_two_bits_of_its_type_and_no_source() {
        // An Allocation request, by pydronecan.
        let id = Id::from_bytes([0x1E, 0x97, 0x4D, 0x00]);
        assert_eq!(Id::anonymous(30, 1, 0x974D >> 2), id);
        assert_eq!(Id::anonymous(30, 2, 0).anonymous_data_type(), 2);
        assert_eq!(Id::anonymous(30, 0xFFFD, 0xC000 | 0x974D >> 2), id, "what does not fit");
        assert_eq!(
            (id.priority(), id.anonymous_data_type(), id.source(), id.is_service()),
            (30, 1, 0, false)
        );
    }

    #[test]
    fn identifiers_survive_a_round_trip_through_embedded_can() {
        for raw in [0, 1, 0x1003_F20A, 0x1E01_AAFF, 0x1FFF_FFFF] {
            let extended = ExtendedId::new(raw).unwrap();
            assert_eq!(Id::from(extended).to_bytes(), raw.to_be_bytes());
            assert_eq!(ExtendedId::from(Id::from(extended)), extended);
            assert_eq!(
                embedded_can::Id::from(Id::from(extended)),
                embedded_can::Id::Extended(extended)
            );
        }
        let beyond = Id::from_bytes([0xFF, 0x03, 0xF2, 0x0A]);
        assert_eq!(
            ExtendedId::from(beyond).as_raw(),
            0x1F03_F20A,
            "the three highest bits have no meaning"
        );
    }

    #[test]
    fn a_frame_follows_with_the_other_toggle_and_the_same_transfer_id() {
        let first = Tail(Tail::START | 5);
        assert!(
            Tail(Tail::TOGGLE | 5).follows(first)
                && Tail(Tail::END | Tail::TOGGLE | 5).follows(first)
        );
        assert!(!Tail(5).follows(first) && !Tail(Tail::TOGGLE | 6).follows(first));
    }

    #[test]
    fn is_single_means_that_the_first_frame_is_also_the_last() {
        for tail in 0..=u8::MAX {
            assert_eq!(
                Tail(tail).is_single(),
                Tail(tail).is_start() && Tail(tail).is_end(),
                "{tail:02X}"
            );
        }
    }
}
