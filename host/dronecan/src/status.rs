//! The status of a node: protocol.NodeStatus, which is a message and the beginning of a GetNodeInfo
//! response.

use crate::text::numbered;
use std::fmt;

/// A NodeStatus in a GetNodeInfo response, in the form of a dialect.
pub trait StatusField: Sized {
    /// Its length in bytes.
    const LEN: usize;
    /// Decodes [`LEN`](Self::LEN) bytes; `None` for another length.
    fn read(bytes: &[u8]) -> Option<Self>;
    /// Encodes it.
    fn bytes(&self) -> Vec<u8>;
}

/// Health of a node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Health {
    #[default]
    Ok,
    Warning,
    Error,
    Critical,
}

impl fmt::Display for Health {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Health::Ok => "OK",
            Health::Warning => "WARNING",
            Health::Error => "ERROR",
            Health::Critical => "CRITICAL",
        })
    }
}

numbered! {
    /// Mode of a node. The dialect does not define 4 to 6.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub enum Mode or Undefined "mode {}" {
        #[default]
        Operational = 0 "OPERATIONAL",
        Initialization = 1 "INITIALIZATION",
        Maintenance = 2 "MAINTENANCE",
        SoftwareUpdate = 3 "SOFTWARE_UPDATE",
        Offline = 7 "OFFLINE",
    }
}

/// protocol.NodeStatus. Layout: `uptime_sec u32 | health[7:6] mode[5:3] sub_mode[2:0] | vendor code
/// u16`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NodeStatus {
    pub uptime_s: u32,
    pub health: Health,
    pub mode: Mode,
    pub sub_mode: u8,
    pub vendor_code: u16,
}

impl StatusField for NodeStatus {
    const LEN: usize = 7;

    fn read(bytes: &[u8]) -> Option<NodeStatus> {
        NodeStatus::decode(bytes)
    }

    fn bytes(&self) -> Vec<u8> {
        self.encode()
    }
}

impl NodeStatus {
    /// `None` unless the payload has seven bytes.
    pub fn decode(payload: &[u8]) -> Option<NodeStatus> {
        let &[u0, u1, u2, u3, state, v0, v1] = payload else {
            return None;
        };
        Some(NodeStatus {
            uptime_s: u32::from_le_bytes([u0, u1, u2, u3]),
            health: match state >> 6 {
                0 => Health::Ok,
                1 => Health::Warning,
                2 => Health::Error,
                _ => Health::Critical,
            },
            mode: Mode::from_field(state >> 3 & 7),
            sub_mode: state & 7,
            vendor_code: u16::from_le_bytes([v0, v1]),
        })
    }

    /// The payload.
    pub fn encode(&self) -> Vec<u8> {
        let mut payload = self.uptime_s.to_le_bytes().to_vec();
        payload.push((self.health as u8) << 6 | (self.mode.field() & 7) << 3 | self.sub_mode & 7);
        payload.extend(self.vendor_code.to_le_bytes());
        payload
    }
}

impl fmt::Display for NodeStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.health, self.mode)?;
        if self.sub_mode != 0 {
            write!(f, ".{}", self.sub_mode)?;
        }
        write!(f, " up {} s vendor {:#06X}", self.uptime_s, self.vendor_code)
    }
}
