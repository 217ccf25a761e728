//! The filters and masks of the CAN controller, derived from the table of received types
//! ([`kind`](crate::tables::kind)).
//!
//! Every priority and every source passes. Transfers of several frames come in bursts: ArrayCommand
//! and the requests to this node. They get RXB0, from which a frame rolls over to RXB1 when RXB0 is
//! full. Their common mask ignores the high byte of a message's type, because that byte is the
//! service ID in a service. So messages with a type of 1010 modulo 256 also pass.
//!
//! All other types share the four filters of RXB1, and their frames have no other buffer. For up to
//! four types the mask compares all 16 bits of the type. For more types it compares only as many
//! bits of the low byte as let all of them pass ([`Wide`]).
//!
//! With several outputs in use the interrupts of their edges take time, in which a second frame
//! can end. So RXB0 takes every frame ([`Row::WITH_SEVERAL_OUTPUTS`]), and the node drops those of
//! others.

use dronecan_wire::{Id, NodeId};
use mcp2515_ordered::{Acceptance, BitTiming, Pattern};

use crate::progmem::Progmem;

use crate::dialect;
use crate::hardware::OUTPUTS;
use crate::tables::bit_rate::{Search, timing};
use crate::tables::kind::{Filter, Kind};

/// Bytes of a row: registers of six filters and two masks.
const ROW: usize = 4 * 8;

/// The register with the destination of requests: EID8 of RXF1.
const DESTINATION: u8 = 4 + 2;

/// The first register of a mask.
const FIRST_MASK: u8 = 4 * 6;

/// Filters of RXB1.
const SLOTS: usize = 4;

/// A set of filters and masks: a row of [`PACKED`]. A set that the build does not need is the first
/// one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row(u8);

impl Row {
    /// A node with an ID.
    pub const WITH_ID: Self = Self(0);
    /// The same with esc.RawCommand, for a node with motors. With one type more, the mask compares
    /// fewer bits.
    pub const WITH_MOTORS: Self = Self(HAS_MOTORS as u8);
    /// A node with several outputs: the filters of [`WITH_ID`](Self::WITH_ID), but masks of 0, so
    /// that RXB0 takes every frame. It is not in the table.
    pub const WITH_SEVERAL_OUTPUTS: Self = Self(ROWS as u8);
    /// A node without an ID takes Allocation only: from allocators in RXB0, from other nodes
    /// without an ID in RXB1.
    pub const WITHOUT_ID: Self = Self(if HAS_ALLOCATION { ROWS as u8 - 1 } else { 0 });
}

const HAS_MOTORS: bool = singles(true) > singles(false);
const HAS_ALLOCATION: bool = Kind::Allocation as u8 != Kind::Unknown as u8;
const ROWS: usize = 1 + HAS_MOTORS as usize + HAS_ALLOCATION as usize;

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

/// True for a message that RXB1 takes.
const fn is_single(kind: Kind, has_motors: bool) -> bool {
    match kind.filter() {
        Filter::Rxb1 => true,
        Filter::WithMotors => has_motors,
        _ => false,
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

const WITH_ID: [Pattern; 8] = match dialect::FILTERS {
    Some(filters) => filters,
    None => v0::<{ singles(false) }>(false),
};
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

/// The registers of the filters and masks of each [`Row`], for flash.
pub const PACKED: [u8; ROW * ROWS] = {
    let mut rows = [WITH_ID; ROWS];
    rows[Row::WITH_MOTORS.0 as usize] = WITH_MOTORS;
    rows[Row::WITHOUT_ID.0 as usize] = WITHOUT_ID;
    rows[Row::WITH_ID.0 as usize] = WITH_ID;
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

/// The filters of a node, and its search for the bit rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeAcceptance<P> {
    /// The node's ID; `None` while it has none.
    pub node: Option<NodeId>,
    /// The set of filters.
    pub row: Row,
    /// The search for the bit rate.
    pub search: Search,
    /// The flash with [`PACKED`].
    pub flash: P,
}

impl<P> NodeAcceptance<P> {
    /// The filters of a node whose ID is not known yet.
    pub const fn nobody(flash: P) -> Self {
        Self { node: None, row: Row::WITH_ID, search: Search::NONE, flash }
    }
}

impl<P: Progmem<Filters>> Acceptance for NodeAcceptance<P> {
    fn register(&self, n: u8) -> u8 {
        // A node without an ID has no requests.
        if dialect::HAS_REQUESTS
            && n == DESTINATION
            && let Some(node) = self.node
        {
            let [_, _, destination, _] = Id::request(0, 0, node.get(), 0).to_bytes();
            return destination;
        }
        let mut row = if ROWS == 1 { 0 } else { u16::from(self.row.0) };
        if OUTPUTS > 1 && row == u16::from(Row::WITH_SEVERAL_OUTPUTS.0) {
            if n >= FIRST_MASK {
                return 0;
            }
            row = 0;
        }
        self.flash.byte(row * ROW as u16 + u16::from(n))
    }

    fn next_timing(&mut self) -> Option<BitTiming> {
        self.search.take_next().map(timing)
    }
}

#[cfg(all(test, not(feature = "draft")))]
mod tests;
