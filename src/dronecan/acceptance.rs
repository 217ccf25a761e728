//! Which identifiers the CAN controller lets through: just what the node uses.
//!
//! A message's type is in bits 23 to 8 and bit 7 tells messages from services (see the layout in `wire.rs`). The priority and
//! the sender are open.

use crate::can::mcp2515::{Acceptance, Pattern};
use crate::progmem::{self, Progmem};

use super::NodeId;
use super::draft;
use super::kind::Kind;
use super::wire::{REQUEST_NOT_RESPONSE as REQUEST, SERVICE_NOT_MESSAGE as SERVICE};

/// Six filters and two masks.
const ROW: u8 = 4 * 8;
/// Where the masks begin in a row.
const MASKS: u8 = 4 * 6;
/// Where the masks for a node without an ID begin in [`PACKED`].
const MASKS_WITHOUT_ID: u8 = 3 * ROW;
/// Where the only filter of a node without an ID begins.
const FILTER_WITHOUT_ID: u8 = MASKS_WITHOUT_ID + 2 * 4;
/// The register with the destination of requests.
const DESTINATION: u8 = 4 + 2;

/// What a node with an ID takes: which row of [`PACKED`].
pub const EITHER: u8 = 0;
/// See [`EITHER`].
pub const V0: u8 = ROW;
/// See [`EITHER`].
pub const DRAFT: u8 = 2 * ROW;

/// The registers of filters and masks, for flash.
pub const PACKED: [u8; FILTER_WITHOUT_ID as usize + 4] = {
    // RXF0 and RXF1 of v0.
    let commands = Pattern::filter([0, 0, Kind::ARRAY_COMMAND.data_type() as u8, 0]);
    let requests = Pattern::filter([0, 0, REQUEST, SERVICE]);
    // RXM0 of v0: of messages the low byte of the type only; of services the destination and whether it is a request.
    let bursts = Pattern::mask([0x00, 0x00, 0xFF, SERVICE]);
    // The type of a draft, message or request, without the sender.
    let drafts = Pattern::mask([0xFF, 0xFE, 0x00, 0x00]);
    let patterns = [
        // Either dialect.
        commands,
        requests,
        // Of v0 what is with NodeStatus (1), and with the others (4); of the draft NodeStatus, and what both kinds of commands have.
        Pattern::filter([0, 0x00, 0, 0]),
        Pattern::filter([0, 0x04, 0, 0]),
        Pattern::filter([0, 0x34, 0, 0]),
        Pattern::filter([0, 0x44, 0, 0]),
        bursts,
        Pattern::mask([0x00, 0x76, 0x00, SERVICE]),
        // v0: RXF0 and RXF1, RXF2 to RXF5.
        commands,
        requests,
        message(Kind::NODE_STATUS),
        message(Kind::LIGHTS_COMMAND),
        message(Kind::ARMING_STATUS),
        message(Kind::SERVO_COMMAND),
        bursts,
        // RXM1, and RXM0 of a node without an ID: the type, and that it is a message.
        Pattern::mask([0x00, 0xFF, 0xFF, SERVICE]),
        // The draft: commands first, which can be longer than a frame.
        draft(draft::ARRAY_COMMAND),
        draft(draft::SERVO_COMMAND),
        draft(draft::NODE_STATUS),
        draft(draft::GET_NODE_INFO),
        draft(draft::RESTART_NODE),
        draft(draft::RESTART_NODE),
        drafts,
        drafts,
        // RXM0 and RXM1 of a node without an ID: the type, and what an anonymous message has of its type, and that it has no sender.
        Pattern::mask([0x00, 0xFF, 0xFF, SERVICE]),
        Pattern::mask([0x00, 0x00, 0x03, 0xFF]),
        message(Kind::ALLOCATION),
    ];
    let mut packed = [0; FILTER_WITHOUT_ID as usize + 4];
    let mut n = 0;
    while n < packed.len() {
        packed[n] = patterns[n / 4].registers()[n % 4];
        n += 1;
    }
    packed
};

const fn draft([b0, b1]: [u8; 2]) -> Pattern {
    Pattern::filter([b0, b1, 0, 0])
}

const fn message(kind: Kind) -> Pattern {
    let [high, low] = kind.data_type().to_be_bytes();
    Pattern::filter([0, high, low, 0])
}

/// The filters of a node, by its ID.
///
/// With an ID: transfers of several frames, which come in bursts, have the first buffer, from which a frame rolls over to the
/// second when the first is full. These are ArrayCommand and the requests to the node. Their common mask leaves the high
/// byte of a message's type open, so messages whose type has the same low byte (0xF2) come through, too. The second buffer is
/// for NodeStatus, LightsCommand, ArmingStatus and the thesis's command.
///
/// In the draft: commands have the first buffer, NodeStatus and requests the second; the destination of requests is in the data,
/// where no filter looks. For either dialect: as in v0, but what the second buffer takes of NodeStatus and commands of the draft, and of
/// single messages of v0, is let through by five bits of the identifier, and much else with it. Requests of the draft are not.
///
/// Without an ID: Allocation only, from allocators in the first buffer, and from other nodes without an ID in the second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeAcceptance<P> {
    /// The node's ID; `None` while it has none.
    pub node: Option<NodeId>,
    /// What a node with an ID takes: [`EITHER`], [`V0`], or [`DRAFT`].
    pub row: u8,
    /// Where [`PACKED`] is.
    pub flash: P,
}

impl<P> NodeAcceptance<P> {
    /// The filters of a node without an ID.
    pub const fn nobody(flash: P) -> Self {
        Self { node: None, row: EITHER, flash }
    }
}

impl<P: Progmem> Acceptance for NodeAcceptance<P> {
    #[inline(always)]
    fn register(&self, n: u8) -> u8 {
        let at = match self.node {
            // In the draft no mask looks there.
            Some(node) if n == DESTINATION => return REQUEST | node.get(),
            Some(_) => n + self.row,
            None if n < MASKS => FILTER_WITHOUT_ID + n % 4,
            None => n - MASKS + MASKS_WITHOUT_ID,
        };
        self.flash.byte(progmem::ACCEPTANCE + u16::from(at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progmem::InMemory;

    const WITH_ID: NodeAcceptance<InMemory> = NodeAcceptance { node: NodeId::new(42), row: V0, flash: InMemory };
    const WITHOUT_ID: NodeAcceptance<InMemory> = NodeAcceptance { node: None, row: V0, flash: InMemory };

    /// SIDH, SIDL, EID8 and EID0 of an identifier, as a number.
    fn registers(pattern: Pattern) -> u32 {
        u32::from_be_bytes(pattern.registers())
    }

    /// The buffer that an extended frame with this identifier goes to, if any.
    fn buffer(acceptance: NodeAcceptance<InMemory>, id: u32) -> Option<u8> {
        let pattern = |n: u8| u32::from_be_bytes([0, 1, 2, 3].map(|k| acceptance.register(4 * n + k)));
        let frame = registers(Pattern::filter(id.to_be_bytes()));
        let n = (0..6).find(|&n| (frame ^ pattern(n)) & pattern(6 + u8::from(n > 1)) == 0)?;
        Some(u8::from(n > 1))
    }

    #[test]
    fn bursts_have_the_first_buffer_and_single_messages_the_second() {
        // From any sender at any priority.
        for id in [0x1003_F20A, 0x0003_F27F, 0x1E01_AAFF, 0x1E0B_AAFF, 0x1E0A_AA81] {
            assert_eq!(buffer(WITH_ID, id), Some(0), "{id:08X}");
        }
        for id in [0x1801_552A, 0x1001_5501, 0x0001_557F, 0x1804_390A, 0x1804_4C0A, 0x1804_5701] {
            assert_eq!(buffer(WITH_ID, id), Some(1), "{id:08X}");
        }
    }

    #[test]
    fn other_messages_other_nodes_requests_and_all_responses_stay_out() {
        for id in
            [0x1804_562A, 0x1803_F32A, 0x1E97_4D00, 0x1E00_017F, 0x1E01_ABFF, 0x1E01_2AFF, 0x1001_55AA, 0x1804_5801]
        {
            assert_eq!(buffer(WITH_ID, id), None, "{id:08X}");
        }
    }

    #[test]
    fn without_an_id_only_allocation_comes_through_from_allocators_and_from_nobody() {
        assert_eq!(buffer(WITHOUT_ID, 0x1E00_017F), Some(0));
        // The golden requests of another node: the discriminator is where the type would be.
        for id in [0x1E97_4D00, 0x1EBC_1100, 0x1E9D_1D00, 0x1EEE_8100] {
            assert_eq!(buffer(WITHOUT_ID, id), Some(1), "{id:08X}");
        }
        for id in [0x1003_F20A, 0x1801_552A, 0x1E01_AAFF, 0x1E01_80FF, 0x1E00_01FF, 0x1E97_4E00, 0x1804_4C0A] {
            assert_eq!(buffer(WITHOUT_ID, id), None, "{id:08X}");
        }
    }

    #[test]
    fn in_the_draft_commands_have_the_first_buffer_and_all_else_that_is_of_use_the_second() {
        let draft = NodeAcceptance { row: DRAFT, ..WITH_ID };
        // The thesis's own filters: 0x11340408 and 0x17C40408.
        for (id, first) in [
            (0x084C_040A, 0),
            (0x085D_E0FF, 1),
            (0x17C4_0408, 0),
            (0x17C5_E009, 0),
            (0x1134_0408, 1),
            (0x1135_E00B, 1),
            (0x113B_FC08, 1),
            (0x1183_FC0E, 1),
        ] {
            assert_eq!(buffer(draft, id), (id != 0x085D_E0FF).then_some(first), "{id:08X}");
        }
        for id in [0x1003_F20A, 0x1801_550A, 0x1E01_AAFF, 0x17CD_E008, 0x1139_E005] {
            assert_eq!(buffer(draft, id), None, "{id:08X}");
        }
    }

    #[test]
    fn while_either_is_possible_commands_and_statuses_of_both_come_through() {
        let either = NodeAcceptance { row: EITHER, ..WITH_ID };
        for id in [0x1003_F20A, 0x1E01_AAFF] {
            assert_eq!(buffer(either, id), Some(0), "{id:08X}");
        }
        for id in [
            0x1801_550A,
            0x1804_390A,
            0x1804_4C0A,
            0x1004_5701,
            0x084C_040A,
            0x084C_0452,
            0x17C4_0409,
            0x1134_0408,
            0x1135_E00B,
        ] {
            assert_eq!(buffer(either, id), Some(1), "{id:08X}");
        }
        for id in [0x1803_F32A, 0x1E01_2AFF, 0x1E00_017F & !0x80 | 0x0200_0080, 0x1807_000A, 0x1840_000A] {
            assert_eq!(buffer(either, id), None, "{id:08X}");
        }
    }

    #[test]
    fn registers_are_those_worked_out_by_hand() {
        let all = |acceptance: NodeAcceptance<InMemory>| -> Vec<u32> {
            (0..8).map(|n| u32::from_be_bytes([0, 1, 2, 3].map(|k| acceptance.register(4 * n + k)))).collect()
        };
        let filters = [0x0008_F200, 0x0008_AA80, 0x0009_5500, 0x0028_3900, 0x0028_4C00, 0x0028_5700];
        assert_eq!(all(WITH_ID), [&filters[..], &[0x0000_FF80, 0x07E3_FF80]].concat());
        assert_eq!(all(WITHOUT_ID), [&[0x0008_0100; 6][..], &[0x07E3_FF80, 0x0000_03FF]].concat());
    }
}
