//! Bytes of serial ports over the bus: tunnel.Broadcast and tunnel.Targetted.
//!
//! ```text
//! Broadcast   protocol u8 | channel u8 | buffer u8[<=60]
//! Targetted   protocol u8 | target node u7 | serial port i5 | options u4 | baud rate u24 |
//!             buffer u8[<=120]
//! ```
//! The three fields between the protocol and the baud rate fill two bytes from the most significant
//! bit. Little endian.

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

/// tunnel.Broadcast, for all nodes that use the protocol.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TunnelBroadcast {
    pub protocol: u8,
    pub channel: u8,
    pub buffer: Vec<u8>,
}

impl TunnelBroadcast {
    /// `None` if the payload is too short or too long.
    pub fn decode(payload: &[u8]) -> Option<TunnelBroadcast> {
        match payload {
            [protocol, channel, buffer @ ..] if buffer.len() <= BROADCAST_MAX => {
                Some(TunnelBroadcast {
                    protocol: *protocol,
                    channel: *channel,
                    buffer: buffer.to_vec(),
                })
            }
            _ => None,
        }
    }

    pub fn encode(&self) -> Vec<u8> {
        [&[self.protocol, self.channel], self.buffer.as_slice()].concat()
    }
}

/// tunnel.Targetted, for one node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TunnelTargetted {
    pub protocol: u8,
    pub target: NodeId,
    /// -16 to 15.
    pub serial_port: i8,
    /// 4 bits.
    pub options: u8,
    /// 24 bits.
    pub baud_rate: u32,
    pub buffer: Vec<u8>,
}

impl TunnelTargetted {
    /// `None` if the payload is too short or too long, or the target is node 0.
    pub fn decode(payload: &[u8]) -> Option<TunnelTargetted> {
        let [protocol, a, b, baud0, baud1, baud2, buffer @ ..] = payload else { return None };
        if buffer.len() > TARGETTED_MAX {
            return None;
        }
        // Sign-extends the five bits: shifts them to the top of a byte and back.
        let serial_port = ((a << 7 | b >> 1) as i8) >> 3;
        Some(TunnelTargetted {
            protocol: *protocol,
            target: NodeId::new(a >> 1)?,
            serial_port,
            options: b & 0x0F,
            baud_rate: u32::from_le_bytes([*baud0, *baud1, *baud2, 0]),
            buffer: buffer.to_vec(),
        })
    }

    pub fn encode(&self) -> Vec<u8> {
        let port = self.serial_port as u8 & 0x1F;
        let [baud0, baud1, baud2, _] = self.baud_rate.to_le_bytes();
        let a = self.target.get() << 1 | port >> 4;
        let b = port << 4 | self.options & 0x0F;
        [&[self.protocol, a, b, baud0, baud1, baud2], self.buffer.as_slice()].concat()
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
