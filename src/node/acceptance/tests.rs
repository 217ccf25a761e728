//! The filters of each build, worked out by hand.

use super::*;
use crate::image::InMemory;

const WITH_ID: NodeAcceptance<InMemory> = NodeAcceptance {
    node: NodeId::new(42),
    row: Row::WITH_ID,
    search: Search::NONE,
    flash: InMemory,
};

/// The type of each message that RXB1 takes in v0.
const SINGLE_TYPES: &[u16] = &[
    341,
    1111,
    #[cfg(feature = "standard")]
    1100,
    #[cfg(feature = "safety")]
    20_000,
    #[cfg(feature = "relay")]
    1070,
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
        assert_eq!(buffer(WITH_ID, id), None, "{id:08X}: does the mask let it pass? See only_...");
    }
}

/// Of up to four types the mask of RXB1 compares all bits; of five, 0x55, 0x57, 0x4C and two others
/// in their low bytes, all of these but bit 1; of six, with 0x20, 0x39 and 0xB9, all but bits 1 and
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
        [_, _, 1100, 20_000] => ([0x0009_5500, 0x0028_5700, 0x0028_4C00, 0x026A_2000], 0x07E3_FF80),
        [_, _, 1100, 1081] => ([0x0009_5500, 0x0028_5700, 0x0028_4C00, 0x0028_3900], 0x07E3_FF80),
        [_, _, 1100, 1070] => ([0x0009_5500, 0x0028_5700, 0x0028_4C00, 0x0028_2E00], 0x07E3_FF80),
        [_, _, 1100, 3001] => ([0x0009_5500, 0x0028_5700, 0x0028_4C00, 0x004B_B900], 0x07E3_FF80),
        [_, _, 1100, 20_000, 1081, 3001] => {
            ([0x0008_5500, 0x0008_4C00, 0x0008_2000, 0x0008_3900], 0x0000_7D80)
        }
        [_, _, 1100, 1070, 3001] => {
            ([0x0008_5500, 0x0008_4C00, 0x0008_2C00, 0x0008_B900], 0x0000_FD80)
        }
        [_, _, 1100, 20_000, 1081] => {
            ([0x0008_5500, 0x0008_4C00, 0x0008_2000, 0x0008_3900], 0x0000_FD80)
        }
        other => panic!("{other:?}"),
    };
    let filters = [&[0x0008_F200, 0x0008_AA80][..], &singles, &[0x0000_FF80, mask]].concat();
    assert_eq!(all(WITH_ID)[..], filters, "{:#010X?}", all(WITH_ID));
}

/// Types that fit are compared in all their bits. Of others the mask compares as many bits of the
/// low byte as possible.
#[test]
fn types_are_compared_in_as_many_bits_as_possible() {
    for types in [
        &[341][..],
        &[341, 1111],
        &[1, 2, 3, 4],
        &[0x0155, 0x0255, 0x0355, 0x0455],
        &[7, 7, 8, 8, 9, 9],
        &[341, 1010, 1081, 1100, 1111],
        &[1, 2, 3, 4, 5, 6, 7, 8],
        &[0x0155, 0x0455, 0x0456, 0x0457, 0x0458, 0x0459, 0x1055],
        // The low bytes are equal, so the mask compares all eight bits.
        &[0x0001, 0x0101, 0x0201, 0x0301, 0x0401],
    ] {
        let wide = Wide::new(types);
        let distinct = |mask: u16| {
            let masked = types.iter().map(|data_type| data_type & mask);
            masked.collect::<std::collections::HashSet<u16>>().len()
        };
        if distinct(0xFFFF) <= SLOTS {
            assert_eq!(wide.mask, 0xFFFF, "{types:?} fit");
        } else {
            let fits = (0..=0xFFu16).filter(|&mask| distinct(mask) <= SLOTS);
            let most = fits.map(u16::count_ones).max();
            assert_eq!((wide.mask & 0xFF00, Some(wide.mask.count_ones())), (0, most), "{types:?}");
        }
        for data_type in types {
            assert!(wide.filters.contains(&(data_type & wide.mask)), "{data_type} of {types:?}");
        }
        let is_one = |&filter: &u16| types.iter().any(|data_type| data_type & wide.mask == filter);
        assert!(wide.filters.iter().all(is_one), "{types:?}: nothing else");
    }
    assert_eq!(Wide::new(&[0x0001, 0x0101, 0x0201, 0x0301, 0x0401]).mask, 0x00FF);
}

/// Of six types the mask compares five bits of the low byte: 0x06, 0x55, 0x57, 0x4C, 0x20 and
/// 0x39 differ in them, but for two pairs.
#[cfg(feature = "outputs")]
#[test]
fn a_node_with_motors_takes_raw_commands_too() {
    let with_motors = NodeAcceptance { row: Row::WITH_MOTORS, ..WITH_ID };
    for &data_type in SINGLE_TYPES.iter().chain(&[1030]) {
        let id = u32::from_be_bytes(Id::message(7, data_type, 10).to_bytes());
        assert_eq!(buffer(with_motors, id), Some(1), "{id:08X}");
    }
    for id in [0x1003_F20A, 0x1E01_AAFF] {
        assert_eq!(buffer(with_motors, id), Some(0), "{id:08X}");
    }
    assert_eq!(buffer(with_motors, 0x1804_0A0A), None, "esc.Status");
    match SINGLE_TYPES {
        [341, 1111, 1100, 20_000, 1081] => {
            let singles = [0x0008_0600, 0x0008_4400, 0x0008_4600, 0x0008_2000];
            let masks = [0x0000_FF80, 0x0000_E680];
            let filters = [&[0x0008_F200, 0x0008_AA80][..], &singles, &masks].concat();
            assert_eq!(all(with_motors)[..], filters, "{:#010X?}", all(with_motors));
        }
        [341, 1111, 1100] | [341, 1111, 1100, 1070] | [341, 1111, 1100, 1070, 3001] => {}
        other => panic!("work out the registers for {other:?}"),
    }
}

#[cfg(feature = "outputs")]
#[test]
fn a_node_with_several_outputs_takes_every_frame_in_the_first_buffer() {
    let several = NodeAcceptance { row: Row::WITH_SEVERAL_OUTPUTS, ..WITH_ID };
    for id in [0x1003_F20A, 0x1E01_AAFF, 0x1801_552A, 0x1804_0A0A, 0x1E01_2AFF, 0, 0x1FFF_FFFF] {
        assert_eq!(buffer(several, id), Some(0), "{id:08X}");
    }
    assert_eq!((&all(several)[..6], &all(several)[6..]), (&all(WITH_ID)[..6], &[0, 0][..]));
}

#[cfg(feature = "allocation")]
#[test]
fn without_an_id_only_allocation_passes() {
    const WITHOUT_ID: NodeAcceptance<InMemory> =
        NodeAcceptance { node: None, row: Row::WITHOUT_ID, search: Search::NONE, flash: InMemory };
    assert_eq!(buffer(WITHOUT_ID, 0x1E00_017F), Some(0));
    // The golden requests of another node. The discriminator is in place of the type.
    for id in [0x1E97_4D00, 0x1EBC_1100, 0x1E9D_1D00, 0x1EEE_8100] {
        assert_eq!(buffer(WITHOUT_ID, id), Some(1), "{id:08X}");
    }
    for id in
        [0x1003_F20A, 0x1801_552A, 0x1E01_AAFF, 0x1E01_80FF, 0x1E00_01FF, 0x1E97_4E00, 0x1804_4C0A]
    {
        assert_eq!(buffer(WITHOUT_ID, id), None, "{id:08X}");
    }
    assert_eq!(all(WITHOUT_ID)[..], [&[0x0008_0100; 6][..], &[0x07E3_FF80, 0x0000_03FF]].concat());
}
