//! The filters and masks of the CAN controller, derived from the table of received types
//! ([`kind`](super::kind)).
//!
//! Every priority and every source passes. Transfers of several frames come in bursts: ArrayCommand
//! and the requests to this node. They get RXB0, from which a frame rolls over to RXB1 when RXB0 is
//! full. Their common mask ignores the high byte of a message's type, because that byte is the
//! service ID in a service. So messages with a type of 1010 modulo 256 also pass.
//!
//! All other types share the four filters of RXB1. For up to four types the mask compares all 16
//! bits of the type. For more types it compares only as many bits of the low byte as let all of
//! them pass ([`Wide`]).

use dronecan_wire::{Id, NodeId};
use mcp2515_ordered::{Acceptance, Pattern};

use crate::progmem::Progmem;

use super::kind::Kind;

/// Bytes of a row: registers of six filters and two masks.
const ROW: usize = 4 * 8;

/// The register with the destination of requests: EID8 of RXF1.
const DESTINATION: u8 = 4 + 2;

/// Filters of RXB1.
const SLOTS: usize = 4;

/// A set of filters and masks: a row of [`PACKED`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Row {
    /// DroneCAN v0, for a node with an ID.
    V0,
    /// The same with esc.RawCommand, for a node with motors. With one type more, the mask compares
    /// fewer bits.
    #[cfg(feature = "outputs")]
    WithMotors,
    /// A node without an ID takes Allocation only: from allocators in RXB0, from other nodes
    /// without an ID in RXB1.
    #[cfg(feature = "allocation")]
    WithoutId,
    /// Both dialects. RXB1 compares three bits of the type's high byte. NodeStatus and the commands
    /// of both dialects pass, and requests of the draft.
    #[cfg(feature = "draft")]
    Either,
    /// The types of the thesis's node, in the draft. Every source passes; the thesis's filters
    /// passed node 1 only.
    #[cfg(feature = "draft")]
    Thesis,
}

const ROWS: usize = 1
    + cfg!(feature = "outputs") as usize
    + cfg!(feature = "allocation") as usize
    + 2 * cfg!(feature = "draft") as usize;

/// A mask for types, and the filters under it.
struct Wide {
    mask: u16,
    filters: [u16; SLOTS],
}

impl Wide {
    const fn new(types: &[u16]) -> Self {
        let mut best = Self { mask: 0, filters: [0; SLOTS] };
        // Use all 16 bits if they fit, else the mask of the low byte with the most bits.
        let mut candidate = 0x100u16;
        while candidate > 0 {
            candidate -= 1;
            let mask = if candidate == 0xFF && Self::fit(types, 0xFFFF).is_some() {
                0xFFFF
            } else {
                candidate
            };
            if mask.count_ones() > best.mask.count_ones()
                && let Some(filters) = Self::fit(types, mask)
            {
                best = Self { mask, filters };
            }
        }
        best
    }

    /// The types under a mask. `None` if there are not enough filters. Unused filters repeat the
    /// first.
    const fn fit(types: &[u16], mask: u16) -> Option<[u16; SLOTS]> {
        let mut filters = [types[0] & mask; SLOTS];
        let mut used = 1;
        let mut n = 1;
        while n < types.len() {
            let mut at = 0;
            while at < used && filters[at] != types[n] & mask {
                at += 1;
            }
            if at == SLOTS {
                return None;
            }
            filters[at] = types[n] & mask;
            if at == used {
                used += 1;
            }
            n += 1;
        }
        Some(filters)
    }
}

/// The number of types of the table that RXB1 takes.
const fn singles(has_motors: bool) -> usize {
    let mut count = 0;
    let mut n = 0;
    while n < Kind::ALL.len() {
        count += is_single(Kind::ALL[n], has_motors) as usize;
        n += 1;
    }
    count
}

/// True for a message of v0, except ArrayCommand, which RXB0 takes, and Allocation, which a node
/// with an ID does not need. RawCommand is only for motors.
const fn is_single(kind: Kind, has_motors: bool) -> bool {
    let _ = has_motors;
    match kind {
        Kind::ArrayCommand => false,
        #[cfg(feature = "outputs")]
        Kind::RawCommand => has_motors,
        #[cfg(feature = "allocation")]
        Kind::Allocation => false,
        #[cfg(feature = "draft")]
        Kind::DraftCommand => false,
        kind => !kind.is_request(),
    }
}

const fn message(data_type: u16) -> Pattern {
    Pattern::filter(Id::message(0, data_type, 0).to_bytes())
}

/// A mask with these bits of a message's type, and the bit that distinguishes services from
/// messages.
const fn message_mask(bits: u16) -> Pattern {
    let [priority, high, low, service] = Id::message(0, bits, 0).to_bytes();
    Pattern::mask([priority, high, low, service | SERVICE])
}

/// The bit that distinguishes services from messages.
const SERVICE: u8 = 1 << 7;

const V0: [Pattern; 8] = v0::<{ singles(false) }>(false);
#[cfg(feature = "outputs")]
const WITH_MOTORS: [Pattern; 8] = v0::<{ singles(true) }>(true);

const fn v0<const SINGLES: usize>(has_motors: bool) -> [Pattern; 8] {
    let mut types = [0; SINGLES];
    let (mut count, mut n) = (0, 0);
    while n < Kind::ALL.len() {
        if is_single(Kind::ALL[n], has_motors) {
            types[count] = Kind::ALL[n].id();
            count += 1;
        }
        n += 1;
    }
    let wide = Wide::new(&types);
    [
        message(Kind::ArrayCommand.id() & 0xFF),
        // Every service ID passes. `register` puts the destination in place of the 0.
        Pattern::filter(Id::request(0, 0, 0, 0).to_bytes()),
        message(wide.filters[0]),
        message(wide.filters[1]),
        message(wide.filters[2]),
        message(wide.filters[3]),
        message_mask(0x00FF),
        message_mask(wide.mask),
    ]
}

#[cfg(feature = "allocation")]
const WITHOUT_ID: [Pattern; 8] = {
    let allocation = message(Kind::Allocation.id());
    let [.., anonymous] = Id::message(0, 0, 0x7F).to_bytes();
    [
        allocation,
        allocation,
        allocation,
        allocation,
        allocation,
        allocation,
        message_mask(0xFFFF),
        // An anonymous message has two bits of its type, and a source of 0.
        Pattern::mask([0, 0, 0b11, SERVICE | anonymous]),
    ]
};

#[cfg(feature = "draft")]
const EITHER: [Pattern; 8] = {
    let [commands, requests, .., bursts, _] = V0;
    const fn high(bits: u16) -> Pattern {
        message(bits << 8)
    }
    // High bytes in v0: NodeStatus 0x01, others 0x04. In the draft: NodeStatus 0x34, ArrayCommand
    // 0x4C, the thesis's command 0xC4, GetNodeInfo 0x3A, RestartNode 0x82. The lowest bit is a
    // bit of the source in the draft.
    [
        commands,
        requests,
        high(0x00),
        high(0x04),
        high(0x30),
        high(0x34),
        bursts,
        message_mask(0x3400),
    ]
};

#[cfg(feature = "draft")]
const THESIS: [Pattern; 8] = {
    const COMMAND: [u8; 4] = 0x17C4_0408u32.to_be_bytes();
    const STATUS: [u8; 4] = 0x1134_0408u32.to_be_bytes();
    // Compares the data type, the kind of transfer, and the last-frame bit.
    const MASK: [u8; 4] = 0x1FFE_0008u32.to_be_bytes();
    let (command, status, mask) =
        (Pattern::filter(COMMAND), Pattern::filter(STATUS), Pattern::mask(MASK));
    [command, status, command, status, command, status, mask, mask]
};

/// The registers of the filters and masks of each [`Row`], for flash.
pub const PACKED: [u8; ROW * ROWS] = {
    let rows: [[Pattern; 8]; ROWS] = [
        V0,
        #[cfg(feature = "outputs")]
        WITH_MOTORS,
        #[cfg(feature = "allocation")]
        WITHOUT_ID,
        #[cfg(feature = "draft")]
        EITHER,
        #[cfg(feature = "draft")]
        THESIS,
    ];
    let mut packed = [0; ROW * ROWS];
    let mut n = 0;
    while n < packed.len() {
        packed[n] = rows[n / ROW][n % ROW / 4].registers()[n % 4];
        n += 1;
    }
    packed
};

/// The table in flash: [`PACKED`].
pub struct Filters;

/// The filters of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeAcceptance<P> {
    /// The node's ID; `None` while it has none.
    pub node: Option<NodeId>,
    /// The set of filters.
    pub row: Row,
    /// The flash with [`PACKED`].
    pub flash: P,
}

impl<P> NodeAcceptance<P> {
    /// The filters of a node whose ID is not known yet.
    pub const fn nobody(flash: P) -> Self {
        Self { node: None, row: Row::V0, flash }
    }
}

impl<P: Progmem<Filters>> Acceptance for NodeAcceptance<P> {
    #[inline(always)]
    fn register(&self, n: u8) -> u8 {
        // The other rows do not use RXF1 for requests.
        if n == DESTINATION
            && let Some(node) = self.node
            && self.row.has_requests()
        {
            let [_, _, destination, _] = Id::request(0, 0, node.get(), 0).to_bytes();
            return destination;
        }
        self.flash.byte(self.row as u16 * ROW as u16 + u16::from(n))
    }
}

impl Row {
    /// True if RXF1 is the filter for requests.
    const fn has_requests(self) -> bool {
        match self {
            Self::V0 => true,
            #[cfg(feature = "outputs")]
            Self::WithMotors => true,
            #[cfg(feature = "draft")]
            Self::Either => true,
            #[allow(unreachable_patterns, reason = "a build may have no others")]
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::InMemory;

    const WITH_ID: NodeAcceptance<InMemory> =
        NodeAcceptance { node: NodeId::new(42), row: Row::V0, flash: InMemory };

    /// The type of each message that RXB1 takes in v0.
    const SINGLE_TYPES: &[u16] = &[
        341,
        1111,
        #[cfg(feature = "standard")]
        1100,
        #[cfg(feature = "safety")]
        20_000,
        #[cfg(feature = "lights")]
        1081,
        #[cfg(feature = "tunnel")]
        3001,
    ];

    /// SIDH, SIDL, EID8 and EID0 of an identifier, as a number.
    fn registers(pattern: Pattern) -> u32 {
        u32::from_be_bytes(pattern.registers())
    }

    /// All registers: six filters and two masks.
    fn all(acceptance: NodeAcceptance<InMemory>) -> [u32; 8] {
        [0, 1, 2, 3, 4, 5, 6, 7]
            .map(|n| u32::from_be_bytes([0, 1, 2, 3].map(|k| acceptance.register(4 * n + k))))
    }

    /// The receive buffer for an extended frame with this identifier. `None` if no filter matches.
    fn buffer(acceptance: NodeAcceptance<InMemory>, id: u32) -> Option<u8> {
        let all = all(acceptance);
        let frame = registers(Pattern::filter(id.to_be_bytes()));
        let n = (0..6).find(|&n| (frame ^ all[n]) & all[6 + usize::from(n > 1)] == 0)?;
        Some(u8::from(n > 1))
    }

    #[test]
    fn bursts_have_the_first_buffer_and_single_messages_the_second() {
        // From several sources, at several priorities.
        for id in [0x1003_F20A, 0x0003_F27F, 0x1E01_AAFF, 0x1E0B_AAFF, 0x1E0A_AA81] {
            assert_eq!(buffer(WITH_ID, id), Some(0), "{id:08X}");
        }
        for &data_type in SINGLE_TYPES {
            for (priority, source) in [(24, 42), (16, 1), (0, 127), (31, 10)] {
                let id = u32::from_be_bytes(Id::message(priority, data_type, source).to_bytes());
                assert_eq!(buffer(WITH_ID, id), Some(1), "{id:08X}");
            }
        }
    }

    #[test]
    fn other_messages_other_nodes_requests_and_all_responses_stay_out() {
        for id in [
            0x1804_562A,
            0x1803_F32A,
            0x1E97_4D00,
            0x1E00_017F,
            0x1E01_ABFF,
            0x1E01_2AFF,
            0x1001_55AA,
            0x1804_5801,
        ] {
            assert_eq!(buffer(WITH_ID, id), None, "{id:08X}");
        }
    }

    /// Of up to four types the mask of RXB1 compares all bits; of five, 0x55, 0x57, 0x4C, 0x20 and
    /// 0x39 in their low bytes, all of these but bit 1; of six, with 0xB9, all but bits 1 and
    /// 7. RXB0 also takes messages with the low byte of ArrayCommand.
    #[test]
    fn only_messages_in_use_and_those_with_their_low_bytes_pass() {
        let mask = match SINGLE_TYPES.len() {
            0..=SLOTS => 0xFFFF,
            5 => 0x00FD,
            _ => 0x007D,
        };
        for data_type in 0..=u16::MAX {
            let id = u32::from_be_bytes(Id::message(16, data_type, 10).to_bytes());
            let expected = if data_type & 0xFF == 1010 & 0xFF {
                Some(0)
            } else if SINGLE_TYPES.iter().any(|single| (single ^ data_type) & mask == 0) {
                Some(1)
            } else {
                None
            };
            assert_eq!(buffer(WITH_ID, id), expected, "{data_type}");
        }
    }

    #[test]
    fn registers_are_those_worked_out_by_hand() {
        let (singles, mask) = match SINGLE_TYPES {
            [_, _] => ([0x0009_5500, 0x0028_5700, 0x0009_5500, 0x0009_5500], 0x07E3_FF80),
            [_, _, 1100] => ([0x0009_5500, 0x0028_5700, 0x0028_4C00, 0x0009_5500], 0x07E3_FF80),
            [_, _, 1100, 20_000] => {
                ([0x0009_5500, 0x0028_5700, 0x0028_4C00, 0x026A_2000], 0x07E3_FF80)
            }
            [_, _, 1100, 1081] => {
                ([0x0009_5500, 0x0028_5700, 0x0028_4C00, 0x0028_3900], 0x07E3_FF80)
            }
            [_, _, 1100, 3001] => {
                ([0x0009_5500, 0x0028_5700, 0x0028_4C00, 0x004B_B900], 0x07E3_FF80)
            }
            [_, _, 1100, 20_000, 1081, 3001] => {
                ([0x0008_5500, 0x0008_4C00, 0x0008_2000, 0x0008_3900], 0x0000_7D80)
            }
            [_, _, 1100, 20_000, 1081] => {
                ([0x0008_5500, 0x0008_4C00, 0x0008_2000, 0x0008_3900], 0x0000_FD80)
            }
            other => panic!("{other:?}"),
        };
        let filters = [&[0x0008_F200, 0x0008_AA80][..], &singles, &[0x0000_FF80, mask]].concat();
        assert_eq!(all(WITH_ID)[..], filters);
    }

    #[test]
    fn types_that_fit_are_compared_in_all_their_bits() {
        for types in [
            &[341][..],
            &[341, 1111],
            &[1, 2, 3, 4],
            &[0x0155, 0x0255, 0x0355, 0x0455],
            &[7, 7, 8, 8, 9, 9],
        ] {
            let wide = Wide::new(types);
            assert_eq!(wide.mask, 0xFFFF, "{types:?}");
            assert!(types.iter().all(|data_type| wide.filters.contains(data_type)), "{types:?}");
            assert!(
                wide.filters.iter().all(|filter| types.contains(filter)),
                "{types:?}: nothing else"
            );
        }
    }

    #[test]
    fn of_types_that_do_not_fit_as_many_bits_of_the_low_byte_are_compared_as_possible() {
        for types in [
            &[341, 1010, 1081, 1100, 1111][..],
            &[1, 2, 3, 4, 5, 6, 7, 8],
            &[0x0155, 0x0455, 0x0456, 0x0457, 0x0458, 0x0459, 0x1055],
            // The low bytes are equal, so the mask compares all eight bits.
            &[0x0001, 0x0101, 0x0201, 0x0301, 0x0401],
        ] {
            let wide = Wide::new(types);
            let distinct = |mask: u16| {
                let masked: std::collections::HashSet<u16> =
                    types.iter().map(|data_type| data_type & mask).collect();
                masked.len()
            };
            assert!(distinct(0xFFFF) > SLOTS, "{types:?}");
            let most =
                (0..=0xFFu16).filter(|&mask| distinct(mask) <= SLOTS).map(u16::count_ones).max();
            assert_eq!((wide.mask & 0xFF00, Some(wide.mask.count_ones())), (0, most), "{types:?}");
            assert!(
                types.iter().all(|data_type| wide.filters.contains(&(data_type & wide.mask))),
                "{types:?}"
            );
            let is_one =
                |&filter: &u16| types.iter().any(|data_type| data_type & wide.mask == filter);
            assert!(wide.filters.iter().all(is_one), "{types:?}");
        }
        assert_eq!(Wide::new(&[0x0001, 0x0101, 0x0201, 0x0301, 0x0401]).mask, 0x00FF);
    }

    /// Of six types the mask compares five bits of the low byte: 0x06, 0x55, 0x57, 0x4C, 0x20 and
    /// 0x39 differ in them, but for two pairs.
    #[cfg(feature = "outputs")]
    #[test]
    fn a_node_with_motors_takes_raw_commands_too() {
        let with_motors = NodeAcceptance { row: Row::WithMotors, ..WITH_ID };
        for &data_type in SINGLE_TYPES.iter().chain(&[1030]) {
            let id = u32::from_be_bytes(Id::message(7, data_type, 10).to_bytes());
            assert_eq!(buffer(with_motors, id), Some(1), "{id:08X}");
        }
        for id in [0x1003_F20A, 0x1E01_AAFF] {
            assert_eq!(buffer(with_motors, id), Some(0), "{id:08X}");
        }
        assert_eq!(buffer(with_motors, 0x1804_0A0A), None, "esc.Status");
        if let [341, 1111, 1100, 20_000, 1081] = SINGLE_TYPES {
            let singles = [0x0008_0600, 0x0008_4400, 0x0008_4600, 0x0008_2000];
            let filters =
                [&[0x0008_F200, 0x0008_AA80][..], &singles, &[0x0000_FF80, 0x0000_E680]].concat();
            assert_eq!(all(with_motors)[..], filters);
        }
    }

    #[cfg(feature = "allocation")]
    #[test]
    fn without_an_id_only_allocation_passes() {
        const WITHOUT_ID: NodeAcceptance<InMemory> =
            NodeAcceptance { node: None, row: Row::WithoutId, flash: InMemory };
        assert_eq!(buffer(WITHOUT_ID, 0x1E00_017F), Some(0));
        // The golden requests of another node. The discriminator is in place of the type.
        for id in [0x1E97_4D00, 0x1EBC_1100, 0x1E9D_1D00, 0x1EEE_8100] {
            assert_eq!(buffer(WITHOUT_ID, id), Some(1), "{id:08X}");
        }
        for id in [
            0x1003_F20A,
            0x1801_552A,
            0x1E01_AAFF,
            0x1E01_80FF,
            0x1E00_01FF,
            0x1E97_4E00,
            0x1804_4C0A,
        ] {
            assert_eq!(buffer(WITHOUT_ID, id), None, "{id:08X}");
        }
        assert_eq!(
            all(WITHOUT_ID)[..],
            [&[0x0008_0100; 6][..], &[0x07E3_FF80, 0x0000_03FF]].concat()
        );
    }

    #[cfg(feature = "draft")]
    #[test]
    fn while_either_is_possible_commands_and_statuses_of_both_and_requests_come_through() {
        let either = NodeAcceptance { row: Row::Either, ..WITH_ID };
        for id in [0x1003_F20A, 0x1E01_AAFF] {
            assert_eq!(buffer(either, id), Some(0), "{id:08X}");
        }
        for id in [
            0x1801_550A,
            0x1804_390A,
            0x1804_4C0A,
            0x1004_5701,
            0x104E_200A,
            0x084C_040A,
            0x084C_0452,
            0x17C4_0409,
            0x1134_0408,
            0x1135_E00B,
            // GetNodeInfo and RestartNode of the draft, from node 127.
            0x113B_FC0D,
            0x1183_FC0E,
        ] {
            assert_eq!(buffer(either, id), Some(1), "{id:08X}");
        }
        for id in [0x1803_F32A | 0x0010_0000, 0x1E01_2AFF, 0x1E01_ABFF, 0x1210_0008, 0x1840_80AA] {
            assert_eq!(buffer(either, id), None, "{id:08X}");
        }
    }

    #[cfg(feature = "draft")]
    #[test]
    fn the_row_of_the_thesis_has_its_filters_with_the_sender_left_open() {
        let thesis = NodeAcceptance { row: Row::Thesis, ..WITH_ID };
        let (command, status) = (0x17C4_0408u32, 0x1134_0408u32);
        let [filter_1, filter_2] =
            [command, status].map(|id| registers(Pattern::filter(id.to_be_bytes())));
        let all = all(thesis);
        assert_eq!(all[..6], [filter_1, filter_2, filter_1, filter_2, filter_1, filter_2]);
        // Every source and every transfer ID passes. Frames that are not the last of their
        // transfer, and other types, do not pass.
        for id in [command, status] {
            for other in [0, 1, 7, 0x0001_F800] {
                assert_eq!(buffer(thesis, id | other), Some(0), "{:08X}", id | other);
            }
            assert_eq!(buffer(thesis, id & !8), None);
        }
        for id in [
            0x084C_040A,
            0x113B_FC0D,
            0x1183_FC0E,
            0x1003_F20A,
            0x1801_550A,
            0x1E01_AAFF,
            0x17CC_0408,
        ] {
            assert_eq!(buffer(thesis, id), None, "{id:08X}");
        }
    }

    /// The filters must pass each kind of the table, except the kinds that only another row passes.
    #[test]
    fn every_kind_of_the_table_comes_through_in_v0() {
        for &kind in Kind::ALL {
            let id = if kind.is_request() {
                Id::request(16, kind.id() as u8, 42, 10)
            } else {
                Id::message(16, kind.id(), 10)
            };
            #[cfg(feature = "allocation")]
            if kind == Kind::Allocation {
                continue;
            }
            #[cfg(feature = "draft")]
            if kind == Kind::DraftCommand {
                continue;
            }
            #[cfg(feature = "outputs")]
            if kind == Kind::RawCommand {
                assert_eq!(buffer(WITH_ID, u32::from_be_bytes(id.to_bytes())), None);
                continue;
            }
            let expected = u8::from(is_single(kind, false));
            assert_eq!(
                buffer(WITH_ID, u32::from_be_bytes(id.to_bytes())),
                Some(expected),
                "{kind:?}"
            );
        }
    }
}
