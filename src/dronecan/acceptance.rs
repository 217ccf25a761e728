//! Which identifiers the CAN controller lets through: just the messages that the node uses.
//!
//! A message's type is in bits 23 to 8 and bit 7 tells messages from services (see the layout in `id.rs`). The priority and
//! the sender are open.

use crate::can::mcp2515::Acceptance;

use super::{array_command, node_status, thesis};

/// Data type ID, and the bit that tells messages from services.
const TYPE_MASK: u32 = 0x00FF_FF80;

/// The filters. The commands have the first buffer, from which a frame rolls over to the second when the first is full;
/// statuses go to the second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeAcceptance;

impl Acceptance for NodeAcceptance {
    fn mask(&self, _n: u8) -> u32 {
        TYPE_MASK
    }

    fn filter(&self, n: u8) -> u32 {
        let data_type = match n {
            0 => array_command::DATA_TYPE_ID,
            1 => thesis::SERVO_COMMAND_ID,
            _ => node_status::DATA_TYPE_ID,
        };
        u32::from(data_type) << 8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn accepted(id: u32) -> bool {
        (0..6).any(|n| (id ^ NodeAcceptance.filter(n)) & NodeAcceptance.mask(n / 2) == 0)
    }

    #[test]
    fn the_messages_of_the_node_pass_from_any_sender_at_any_priority() {
        for id in [0x1801_552A, 0x1001_5501, 0x0001_557F, 0x1003_F20A, 0x1804_5701] {
            assert!(accepted(id), "{id:08X}");
        }
    }

    #[test]
    fn other_messages_and_all_services_stay_out() {
        for id in [0x1804_562A, 0x1803_F32A, 0x1E97_4D00, 0x1E01_AAFF, 0x1E01_F8FF, 0x1001_55AA, 0x1804_5801] {
            assert!(!accepted(id), "{id:08X}");
        }
    }
}
