//! What the bits of a frame mean in DroneCAN: its identifier, and the tail byte.
//!
//! Source: DroneCAN specification, chapter 4, "CAN bus transport layer".

use bench::can::{Frame, Id};
use bench::dronecan::{CanId, DataType, NodeId};
use dronecan_wire::Tail;

/// Name and value of each field. None of a frame that is not DroneCAN.
pub fn meaning(frame: &Frame) -> Vec<(&'static str, String)> {
    let Id::Extended(bits) = frame.id else { return Vec::new() };
    let (Some(id), Some((tail, rest))) = (CanId::parse(bits), frame.data().split_last()) else {
        return Vec::new();
    };
    let node = |node: NodeId| format!("node {}", node.get());
    let named = |number: u16| {
        DataType::of(id).map_or(format!("{number}"), |known| format!("{number}, {}", known.name))
    };
    let urgency = |priority: u8| format!("{priority} (0 is the most urgent, 31 the least)");
    let mut fields = match id {
        CanId::Message { priority, type_id, source } => vec![
            ("priority", urgency(priority)),
            ("message", named(type_id)),
            ("from", node(source)),
            ("to", String::from("all")),
        ],
        CanId::Anonymous { priority, type_id, discriminator } => vec![
            ("priority", urgency(priority)),
            ("message", named(type_id.into())),
            ("from", format!("a node without an ID, discriminator {discriminator}")),
            ("to", String::from("all")),
        ],
        CanId::Service { priority, service_id, request, destination, source } => vec![
            ("priority", urgency(priority)),
            (if request { "request" } else { "response" }, named(service_id.into())),
            ("from", node(source)),
            ("to", node(destination)),
        ],
    };
    let tail = Tail(*tail);
    let (is_start, is_end) = (tail.is_start(), tail.is_end());
    let part = match (is_start, is_end) {
        (true, true) => "the only frame of its transfer",
        (true, false) => "the first frame of its transfer",
        (false, true) => "the last frame of its transfer",
        (false, false) => "a frame between the first and the last of its transfer",
    };
    fields.push(("tail byte: start, end", part.into()));
    if is_start && !is_end && rest.len() >= 2 {
        fields.push((
            "transfer CRC",
            format!("0x{:02X}{:02X}, the first two bytes", rest[1], rest[0]),
        ));
    }
    fields.push(("tail byte: toggle", u8::from(tail.toggle()).to_string()));
    fields.push(("tail byte: transfer ID", tail.transfer_id().to_string()));
    fields
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(id: u32, data: &[u8]) -> Vec<String> {
        let fields = meaning(&Frame::extended(id, data));
        fields.into_iter().map(|(name, value)| format!("{name}: {value}")).collect()
    }

    #[test]
    fn the_identifier_of_a_message_and_the_tail_of_a_single_frame_are_told() {
        // NodeStatus, type 341, priority 16, of node 42.
        let fields = of(16 << 24 | 341 << 8 | 42, &[0, 0, 0, 0, 0, 0, 0, 0xC5]);
        assert_eq!(fields[0], "priority: 16 (0 is the most urgent, 31 the least)");
        assert!(fields[1].starts_with("message: 341, ") && fields[1].ends_with("NodeStatus"));
        assert_eq!(fields[2..4], ["from: node 42", "to: all"]);
        assert_eq!(fields[4], "tail byte: start, end: the only frame of its transfer");
        assert_eq!(fields[5..], ["tail byte: toggle: 0", "tail byte: transfer ID: 5"]);
    }

    #[test]
    fn the_first_frame_of_a_request_has_the_crc_of_the_transfer() {
        // GetSet, service 11, from node 127 to node 9.
        let id = 30 << 24 | 11 << 16 | 1 << 15 | 9 << 8 | 1 << 7 | 127;
        let fields = of(id, &[0x34, 0x12, 0, 0, 0, 0, 0, 0x83]);
        assert!(fields[1].starts_with("request: 11, "), "{fields:?}");
        assert_eq!(fields[2..4], ["from: node 127", "to: node 9"]);
        assert!(fields.contains(&"transfer CRC: 0x1234, the first two bytes".into()), "{fields:?}");
    }

    #[test]
    fn a_frame_that_is_not_dronecan_means_nothing() {
        assert!(meaning(&Frame::standard(0x123, &[1, 2])).is_empty());
        assert!(of(341 << 8 | 42, &[]).is_empty());
    }
}
