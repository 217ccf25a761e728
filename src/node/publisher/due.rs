//! A set of messages: those that are due.

use super::{COUNT, Publication};

/// The bits of [`Due`].
pub type Bits = <() as Width<{ COUNT > 8 }>>::Bits;

/// An integer with a bit for each message.
pub trait Width<const IS_WIDE: bool> {
    type Bits;
}

impl Width<false> for () {
    type Bits = u8;
}

impl Width<true> for () {
    type Bits = u16;
}

const _: () = assert!(COUNT <= Bits::BITS as usize, "each has a bit of `Due`");

/// A set of messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Due(pub(super) Bits);

impl Due {
    #[inline(always)]
    pub const fn bit(publication: Publication) -> Bits {
        if publication.0 == Publication::NONE.0 { 0 } else { 1 << publication.0 }
    }

    pub const fn has(self, publication: Publication) -> bool {
        self.0 & Self::bit(publication) != 0
    }

    pub const fn without(self, publication: Publication) -> Self {
        Self(self.0 & !Self::bit(publication))
    }

    /// The messages that are in both sets.
    pub const fn only(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}
