//! Names, CRC seeds and lengths of the data types that a bus may have. The traffic view shows the
//! names and checks the CRC of long transfers; the bus planner uses the lengths.
//!
//! `table.rs` has a row for each type, and the sources.

use dronecan_wire::types as wire;

use super::dispatch::constants;
use super::id::CanId;
use super::table::table;

/// Message or service. The two have separate data type IDs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Message,
    Service,
}

/// Length of a payload: a fixed part, and a list at the end that may be empty.
///
/// A list that is not at the end counts as empty, and a union has the length of its longest member.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Length without the list's elements, in bits.
    pub fixed_bits: u16,
    /// Length of a list element in bits; 0 without a list.
    pub element_bits: u16,
    /// Maximum number of elements in the list; 0 without a list.
    pub elements_max: u16,
}

const fn fixed(fixed_bits: u16) -> Layout {
    list(fixed_bits, 0, 0)
}

const fn list(fixed_bits: u16, element_bits: u16, elements_max: u16) -> Layout {
    Layout { fixed_bits, element_bits, elements_max }
}

impl Layout {
    /// Length in bytes with this number of elements. The last byte may be used partly.
    pub const fn bytes(self, elements: u16) -> usize {
        let bits = self.fixed_bits as usize + self.element_bits as usize * elements as usize;
        bits.div_ceil(8)
    }
}

/// A known type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DataType {
    pub kind: Kind,
    pub id: u16,
    /// Short name, without the namespace if it is unambiguous without.
    pub name: &'static str,
    /// CRC at the beginning of a transfer, if it is known.
    pub seed: Option<u16>,
    /// Payload of the message, or of the service's request.
    pub payload: Layout,
    /// Payload of the service's response.
    pub response: Option<Layout>,
}

const fn message(known: wire::Message, name: &'static str, payload: Layout) -> DataType {
    let wire::Message { id, seed } = known;
    DataType { kind: Kind::Message, id, name, seed: Some(seed), payload, response: None }
}

const fn service(
    known: wire::Service,
    name: &'static str,
    payload: Layout,
    response: Layout,
) -> DataType {
    let (id, seed) = (known.id as u16, Some(known.seed));
    DataType { kind: Kind::Service, id, name, seed, payload, response: Some(response) }
}

const fn thesis(id: u16, name: &'static str) -> DataType {
    DataType { kind: Kind::Message, id, name, seed: None, payload: fixed(8), response: None }
}

table!(constants);

/// Namespaces of public types; the thesis's types have none.
const ROOTS: [&str; 3] = ["uavcan", "ardupilot", "dronecan"];

impl DataType {
    /// The type of a frame with this identifier, if it is known.
    pub fn of(id: CanId) -> Option<&'static DataType> {
        let (kind, number) = match id {
            CanId::Message { type_id, .. } => (Kind::Message, type_id),
            CanId::Anonymous { type_id, .. } => (Kind::Message, u16::from(type_id)),
            CanId::Service { service_id, .. } => (Kind::Service, u16::from(service_id)),
        };
        KNOWN.iter().find(|t| t.kind == kind && t.id == number)
    }

    /// Identifier of a broadcast of this type. For messages only: a service also needs a
    /// destination.
    pub fn message_id(&self, priority: u8, source: super::NodeId) -> CanId {
        debug_assert!(self.kind == Kind::Message, "{} is a service", self.name);
        CanId::Message { priority, type_id: self.id, source }
    }

    /// All types that match the user's `text`: a name as here, its end ("Status"), or the full DSDL
    /// name. Case does not matter.
    pub fn by_name(text: &str) -> Vec<&'static DataType> {
        let text = text.to_ascii_lowercase();
        let full = text.split_once('.').is_some_and(|(root, _)| ROOTS.contains(&root));
        let ends_with = |whole: &str, end: &str| {
            whole.strip_suffix(end).is_some_and(|front| front.ends_with('.'))
        };
        let means =
            |name: &str| name == text || ends_with(name, &text) || full && ends_with(&text, name);
        let found: Vec<_> =
            KNOWN.iter().filter(|known| means(&known.name.to_ascii_lowercase())).collect();
        // An exact name has precedence over the end of another.
        match found.iter().find(|known| known.name.eq_ignore_ascii_case(&text)) {
            Some(exact) => vec![exact],
            None => found,
        }
    }
}
