//! CAN identifiers of messages (specification, chapter 4).
//!
//! ```text
//! message: priority[28:24] data_type_id[23:8] service_not_message[7]=0 source_node_id[6:0]
//! ```

/// The address of a node: 1 to 127. Zero, the address of anonymous nodes, is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct NodeId(core::num::NonZeroU8);

impl NodeId {
    /// `None` unless `raw` is 1 to 127.
    pub const fn new(raw: u8) -> Option<Self> {
        if raw > 127 {
            return None;
        }
        match core::num::NonZeroU8::new(raw) {
            Some(raw) => Some(Self(raw)),
            None => None,
        }
    }

    /// 1 to 127.
    pub const fn get(self) -> u8 {
        self.0.get()
    }
}

/// Priority of a transfer: 0 is the highest, 31 the lowest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Priority(u8);

impl Priority {
    /// What periodic messages of no urgency use: that of ArduPilot's own peripherals.
    pub const LOW: Self = Self(24);
}

/// The identifier of a message frame, without its priority.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageId {
    /// Data type ID.
    pub data_type: u16,
    /// Who sent it; `None` if anonymous.
    pub source: Option<NodeId>,
}

impl MessageId {
    /// Takes the identifier of a frame apart; `None` if it belongs to a service.
    pub fn parse(id: u32) -> Option<Self> {
        let [_, type_high, type_low, low] = id.to_be_bytes();
        if low & SERVICE_NOT_MESSAGE != 0 {
            return None;
        }
        Some(Self { data_type: u16::from_be_bytes([type_high, type_low]), source: NodeId::new(low) })
    }

    /// The identifier of a frame with this message.
    pub fn build(priority: Priority, data_type: u16, source: NodeId) -> u32 {
        let [type_high, type_low] = data_type.to_be_bytes();
        u32::from_be_bytes([priority.0, type_high, type_low, source.get()])
    }
}

const SERVICE_NOT_MESSAGE: u8 = 1 << 7;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn node_ids_are_1_to_127() {
        assert_eq!(NodeId::new(0), None);
        assert_eq!(NodeId::new(1).unwrap().get(), 1);
        assert_eq!(NodeId::new(127).unwrap().get(), 127);
        assert_eq!(NodeId::new(128), None);
    }

    #[test]
    fn golden_identifiers_go_both_ways() {
        let source = NodeId::new(42).unwrap();
        assert_eq!(MessageId::build(Priority::LOW, 341, source), 0x1801_552A);
        assert_eq!(MessageId::parse(0x1801_552A), Some(MessageId { data_type: 341, source: Some(source) }));
        assert_eq!(MessageId::parse(0x1E97_4D00).unwrap().source, None, "anonymous");
        assert_eq!(MessageId::parse(0x1E01_AAFF), None, "a service request");
    }
}
