//! Addresses of nodes (specification, chapter 4).

/// The address of a node: 1 to 127. Zero means an anonymous node and is not a valid `NodeId`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct NodeId(core::num::NonZeroU8);

impl NodeId {
    /// Makes a node ID. Returns `None` unless `raw` is 1 to 127.
    pub const fn new(raw: u8) -> Option<Self> {
        if raw > 127 {
            return None;
        }
        match core::num::NonZeroU8::new(raw) {
            Some(raw) => Some(Self(raw)),
            None => None,
        }
    }

    /// The number: 1 to 127.
    pub const fn get(self) -> u8 {
        self.0.get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn node_ids_are_1_to_127() {
        assert_eq!(NodeId::new(0), None);
        assert_eq!(NodeId::new(1).unwrap().get(), 1);
        assert_eq!(NodeId::new(127).unwrap().get(), 127);
        assert_eq!(NodeId::new(128), None);
    }
}
