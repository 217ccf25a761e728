//! What the node receives: a row for each type. To receive another one, add its row; the compiler
//! then names the places in `lib.rs` that must act on it.

use dronecan_wire::{Received, types};

/// Makes [`Kind`] of the rows: its name, `message` or `request`, its type, and how it comes: in one
/// `frame`, in several `frames`, or as a `list` with entries of so many bytes.
macro_rules! received {
    ($($name:ident: $what:ident $kind:expr, $form:ident $(($entry:literal))?;)*) => {
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Kind {
            Unknown,
            $($name,)*
        }

        impl Received for Kind {
            const UNKNOWN: Self = Self::Unknown;

            fn of_message(data_type: u16) -> Self {
                match data_type {
                    $(id if !received!(@is_request $what) && id == u16::from($kind.id) => {
                        Self::$name
                    })*
                    _ => Self::Unknown,
                }
            }

            fn of_request(service: u8) -> Self {
                match service {
                    $(id if received!(@is_request $what)
                        && u16::from(id) == u16::from($kind.id) => Self::$name,)*
                    _ => Self::Unknown,
                }
            }

            fn is_request(self) -> bool {
                match self {
                    Self::Unknown => false,
                    $(Self::$name => received!(@is_request $what),)*
                }
            }

            fn is_multi_frame(self) -> bool {
                match self {
                    Self::Unknown => false,
                    $(Self::$name => received!(@is_multi_frame $form),)*
                }
            }

            fn entry_len(self) -> u8 {
                match self {
                    Self::Unknown => 0,
                    $(Self::$name => received!(@entry_len $form $($entry)?),)*
                }
            }

            fn seed(self) -> u16 {
                match self {
                    Self::Unknown => 0,
                    // One frame has no CRC.
                    $(Self::$name if received!(@is_multi_frame $form) => $kind.seed,
                    Self::$name => 0,)*
                }
            }
        }
    };
    (@is_request message) => { false };
    (@is_request request) => { true };
    (@is_multi_frame frame) => { false };
    (@is_multi_frame frames) => { true };
    (@is_multi_frame list) => { true };
    (@entry_len frame) => { 0 };
    (@entry_len frames) => { 0 };
    (@entry_len list $entry:literal) => { $entry };
}

received! {
    // An entry for each actuator.
    ArrayCommand: message types::ARRAY_COMMAND, list(4);
    GetNodeInfo: request types::GET_NODE_INFO, frame;
    RestartNode: request types::RESTART_NODE, frame;
    GetSet: request types::GET_SET, frames;
    ExecuteOpcode: request types::EXECUTE_OPCODE, frame;
}
