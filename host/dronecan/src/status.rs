//! The status of a node: protocol.NodeStatus, which is a message and the beginning of a GetNodeInfo
//! response.

use crate::fields::{as_number, payload};
use crate::text::numbered;
use std::fmt;

/// Health of a node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Health {
    #[default]
    Ok,
    Warning,
    Error,
    Critical,
}

as_number! {
    Health: u8, |field| Some(match field {
        0 => Health::Ok,
        1 => Health::Warning,
        2 => Health::Error,
        _ => Health::Critical,
    }), |health| health as u8;
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

payload! {
    /// protocol.NodeStatus.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct NodeStatus {
        pub uptime_s: u32,
        pub health: Health as 2,
        pub mode: Mode as 3,
        pub sub_mode: u8 as 3,
        pub vendor_code: u16,
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
