//! The type that counts the bytes of a payload.

/// Counts the bytes of a payload: `u8` for payloads of up to 255 bytes, which is enough for most
/// messages, or `u16` for the longest of services, such as 377 bytes of a GetNodeInfo response. No
/// other type can implement the trait.
pub trait Length: Copy + Ord + sealed::Length {}

impl Length for u8 {}
impl Length for u16 {}

/// What this crate needs of a length. The methods and not the operators of `core`, because a
/// compiler for a small AVR inlines these first.
pub(crate) mod sealed {
    pub trait Length: Copy {
        const ZERO: Self;
        const MAX: Self;
        /// The place of an entry of a list that is not kept: behind every buffer.
        const NOWHERE: Self;

        fn from_u8(number: u8) -> Self;

        /// The length of a slice, or the largest value.
        fn of(bytes: &[u8]) -> Self;

        fn index(self) -> usize;

        /// The lower eight bits.
        fn low(self) -> u8;

        fn is(self, other: Self) -> bool;

        fn is_below(self, other: Self) -> bool;

        /// The sum, modulo the number of values.
        fn plus(self, more: Self) -> Self;

        /// The sum, or the largest value.
        fn plus_at_most(self, more: u8) -> Self;
    }

    macro_rules! length {
        ($type:ident, $nowhere:expr) => {
            impl Length for $type {
                const ZERO: Self = 0;
                const MAX: Self = $type::MAX;
                const NOWHERE: Self = $nowhere;

                #[inline(always)]
                fn from_u8(number: u8) -> Self {
                    $type::from(number)
                }

                fn of(bytes: &[u8]) -> Self {
                    $type::try_from(bytes.len()).unwrap_or($type::MAX)
                }

                #[inline(always)]
                fn index(self) -> usize {
                    usize::from(self)
                }

                fn low(self) -> u8 {
                    self as u8
                }

                fn is(self, other: Self) -> bool {
                    self == other
                }

                fn is_below(self, other: Self) -> bool {
                    self < other
                }

                #[inline(always)]
                fn plus(self, more: Self) -> Self {
                    self.wrapping_add(more)
                }

                fn plus_at_most(self, more: u8) -> Self {
                    self.saturating_add($type::from(more))
                }
            }
        };
    }

    length!(u8, 1 << 7);
    length!(u16, 1 << 15);
}
