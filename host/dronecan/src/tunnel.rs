//! Bytes of serial ports over the bus: tunnel.Broadcast and tunnel.Targetted.

use super::fields::payload;
use super::id::NodeId;

/// Maximum number of bytes in one tunnel.Broadcast.
pub const BROADCAST_MAX: usize = 60;
/// Maximum number of bytes in one tunnel.Targetted.
pub const TARGETTED_MAX: usize = 120;
/// tunnel.Protocol.GPS_GENERIC, which ArduPilot's nodes and tools use for every serial port.
pub const GPS_GENERIC: u8 = 2;
/// Targetted.OPTION_LOCK_PORT: the node's own program does not use the port meanwhile.
pub const LOCK_PORT: u8 = 1;
/// The node's default port.
pub const DEFAULT_PORT: i8 = -1;

payload! {
    /// tunnel.Broadcast, for all nodes that use the protocol.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub struct TunnelBroadcast {
        pub protocol: u8,
        pub channel: u8,
        pub buffer: Vec<u8> as BROADCAST_MAX as u32,
    }
}

payload! {
    /// tunnel.Targetted, for one node.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub struct TunnelTargetted {
        pub protocol: u8,
        pub target: NodeId as 7,
        /// -16 to 15.
        pub serial_port: i8 as 5,
        pub options: u8 as 4,
        pub baud_rate: u32 as 24,
        pub buffer: Vec<u8> as TARGETTED_MAX as u32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bytes of pydronecan 1.0.27.
    #[test]
    fn both_messages_equal_pydronecan_s() {
        let targetted = TunnelTargetted {
            protocol: GPS_GENERIC,
            target: NodeId::new(120).unwrap(),
            serial_port: DEFAULT_PORT,
            options: LOCK_PORT,
            baud_rate: 115_200,
            buffer: b"?\r".to_vec(),
        };
        assert_eq!(targetted.encode(), [0x02, 0xF1, 0xF1, 0x00, 0xC2, 0x01, 0x3F, 0x0D]);
        let broadcast = TunnelBroadcast { protocol: 0x55, channel: 42, buffer: vec![1, 2, 3] };
        assert_eq!(broadcast.encode(), [0x55, 42, 1, 2, 3]);
        for port in -16..=15 {
            let there = TunnelTargetted { serial_port: port, ..targetted.clone() };
            assert_eq!(TunnelTargetted::decode(&there.encode()), Some(there));
        }
        assert_eq!(TunnelBroadcast::decode(&broadcast.encode()), Some(broadcast));
    }

    #[test]
    fn payloads_that_are_too_short_too_long_or_for_no_node_are_rejected() {
        assert_eq!(TunnelTargetted::decode(&[2, 0xF1, 0xF1, 0, 0]), None);
        assert_eq!(TunnelTargetted::decode(&[2, 0x01, 0xF1, 0, 0, 0]), None);
        assert_eq!(TunnelTargetted::decode(&[2; 6 + TARGETTED_MAX + 1]), None);
        assert_eq!(TunnelBroadcast::decode(&[2]), None);
        assert_eq!(TunnelBroadcast::decode(&[2; 2 + BROADCAST_MAX + 1]), None);
    }
}
