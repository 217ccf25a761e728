//! uavcan.protocol.NodeStatus (DSDL 341.NodeStatus.uavcan): how a node is. Once a second at least.
//!
//! ```text
//! uptime_sec[0..4] LE; health[4]:2 mode:3 sub_mode:3; vendor_specific_status_code[5..7] LE
//! ```

use super::Malformed;

/// Data type ID.
pub const DATA_TYPE_ID: u16 = 341;

/// No node may be silent for longer, in milliseconds (MAX_BROADCASTING_PERIOD_MS).
pub const MAX_BROADCASTING_PERIOD_MS: u16 = 1000;

/// A node that is silent for longer counts as gone, in milliseconds (OFFLINE_TIMEOUT_MS).
pub const OFFLINE_TIMEOUT_MS: u16 = 3000;

/// Bytes of the payload.
pub const LEN: usize = 7;

/// How well the node can do its job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Health {
    /// Fully.
    Ok = 0,
    /// Something minor is wrong, or was.
    Warning = 1,
    /// A major failure.
    Error = 2,
    /// Not at all.
    Critical = 3,
}

/// What the node is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Mode {
    /// Its job.
    Operational = 0,
    /// Starting.
    Initialization = 1,
}

/// The message as a node sends it. A sub-mode is not used in v0 and stays zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeStatus {
    /// Since the start of the node, in seconds.
    pub uptime_sec: u32,
    /// How well it is.
    pub health: Health,
    /// What it is doing.
    pub mode: Mode,
    /// Whatever else it has to say.
    pub vendor_specific_status_code: u16,
}

impl NodeStatus {
    /// The payload.
    pub fn emit(&self) -> [u8; LEN] {
        let [u0, u1, u2, u3] = self.uptime_sec.to_le_bytes();
        let [v0, v1] = self.vendor_specific_status_code.to_le_bytes();
        [u0, u1, u2, u3, (self.health as u8) << 6 | (self.mode as u8) << 3, v0, v1]
    }
}

/// What is of interest in another node's status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heard {
    /// Since the start of that node, in seconds.
    pub uptime_sec: u32,
    /// Health, 0 to 3 as in [`Health`].
    pub health: u8,
    /// Mode, 0 to 7.
    pub mode: u8,
}

impl Heard {
    /// # Errors
    ///
    /// If the payload has not the length of a NodeStatus.
    pub fn parse(payload: &[u8]) -> Result<Self, Malformed> {
        let &[u0, u1, u2, u3, state, _, _] = payload else {
            return Err(Malformed);
        };
        Ok(Self { uptime_sec: u32::from_le_bytes([u0, u1, u2, u3]), health: state >> 6, mode: state >> 3 & 7 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOLDEN: [u8; LEN] = [0x78, 0x56, 0x34, 0x12, 0x40, 0xEF, 0xBE];

    #[test]
    fn golden_bytes_go_both_ways() {
        let status = NodeStatus {
            uptime_sec: 0x1234_5678,
            health: Health::Warning,
            mode: Mode::Operational,
            vendor_specific_status_code: 0xBEEF,
        };
        assert_eq!(status.emit(), GOLDEN);
        assert_eq!(Heard::parse(&GOLDEN), Ok(Heard { uptime_sec: 0x1234_5678, health: 1, mode: 0 }));
        let starting = NodeStatus {
            uptime_sec: 1,
            health: Health::Ok,
            mode: Mode::Initialization,
            vendor_specific_status_code: 0,
        };
        assert_eq!(starting.emit(), [1, 0, 0, 0, 0x08, 0, 0]);
        assert_eq!(Heard::parse(&starting.emit()), Ok(Heard { uptime_sec: 1, health: 0, mode: 1 }));
    }

    #[test]
    fn a_payload_of_another_length_is_malformed() {
        assert_eq!(Heard::parse(&GOLDEN[..6]), Err(Malformed));
        assert_eq!(Heard::parse(&[0; 8]), Err(Malformed));
        assert_eq!(Heard::parse(&[]), Err(Malformed));
    }
}
