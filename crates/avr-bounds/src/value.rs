//! What is known of a byte: a range, and optionally a symbol.
//!
//! A symbol is an unknown number of 16 bits, such as the stack pointer at the entry of a function.
//! A byte with a symbol is the low or the high byte of the symbol plus an offset. Two bytes with
//! the same symbol, half and offset are equal, whatever their value is.

/// The number of an unknown 16-bit value.
pub type SymbolId = u32;

/// The stack pointer at the entry of the function.
pub const ENTRY_SP: SymbolId = 1;
/// SREG, read while interrupts were disabled, enabled, or either.
pub const SREG_DISABLED: SymbolId = 2;
/// See [`SREG_DISABLED`].
pub const SREG_ENABLED: SymbolId = 3;
/// See [`SREG_DISABLED`].
pub const SREG_EITHER: SymbolId = 4;
/// Added to these three if the flags of arithmetic and T were those of the entry.
pub const SREG_KEPT: SymbolId = 4;
/// The pair r1:r0 at the entry of the function; the other pairs follow.
pub const ENTRY_PAIRS: SymbolId = 16;
/// The first symbol that an instruction names: see [`named`].
const NAMED: SymbolId = 64;

/// The symbol number `n`, below 4, of the instruction at `at`.
pub fn named(at: u32, n: u32) -> SymbolId {
    NAMED + at * 2 + n
}

/// The low or high byte of a symbol plus an offset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Half {
    /// The symbol.
    pub id: SymbolId,
    /// Added to the symbol, modulo 65,536. Of a low byte only the low byte of the offset counts,
    /// and the other is 0.
    pub offset: u16,
    /// True for the high byte.
    pub is_high: bool,
}

impl Half {
    /// The low byte of the symbol plus an offset.
    pub fn low(id: SymbolId, offset: u16) -> Self {
        Self { id, offset: offset & 0xFF, is_high: false }
    }

    /// True if the symbol is one number: two reads of SREG can differ.
    pub fn is_number(self) -> bool {
        self.id == ENTRY_SP || self.id >= ENTRY_PAIRS
    }

    /// A copy of SREG, whether its flags were those of the entry or not.
    fn sreg(self) -> Option<Self> {
        let id = if self.id > SREG_KEPT + 1 { self.id - SREG_KEPT } else { self.id };
        let is_copy = !self.is_number() && self.offset == 0 && !self.is_high;
        is_copy.then(|| Self::low(id, 0))
    }

    /// The high byte of the symbol plus an offset.
    pub fn high(id: SymbolId, offset: u16) -> Self {
        Self { id, offset, is_high: true }
    }
}

/// What is known of a byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Value {
    /// The least value.
    pub lo: u8,
    /// The greatest value.
    pub hi: u8,
    /// The symbol, if there is one.
    pub half: Option<Half>,
}

impl Value {
    /// Nothing is known.
    pub const ANY: Self = Self { lo: 0, hi: 255, half: None };
    /// Zero.
    pub const ZERO: Self = Self::of(0);

    /// A known byte.
    pub const fn of(value: u8) -> Self {
        Self { lo: value, hi: value, half: None }
    }

    /// A byte from `lo` to `hi`.
    pub const fn range(lo: u8, hi: u8) -> Self {
        Self { lo, hi, half: None }
    }

    /// An unknown byte with a symbol.
    pub const fn symbol(half: Half) -> Self {
        Self { lo: 0, hi: 255, half: Some(half) }
    }

    /// The value, if it is known.
    pub fn known(self) -> Option<u8> {
        (self.lo == self.hi).then_some(self.lo)
    }

    /// The same range without the symbol.
    pub fn plain(self) -> Self {
        Self { half: None, ..self }
    }

    /// This range with another symbol.
    pub fn with(self, half: Option<Half>) -> Self {
        Self { half, ..self }
    }

    /// What is true of both.
    pub fn join(self, other: Self) -> Self {
        let half = match (self.half, other.half) {
            (mine, theirs) if mine == theirs => mine,
            (Some(mine), Some(theirs)) => mine.sreg().filter(|half| theirs.sreg() == Some(*half)),
            _ => None,
        };
        Self { lo: self.lo.min(other.lo), hi: self.hi.max(other.hi), half }
    }

    /// What is known if both are true; `None` if they exclude each other.
    pub fn meet(self, lo: u8, hi: u8) -> Option<Self> {
        let (lo, hi) = (self.lo.max(lo), self.hi.min(hi));
        (lo <= hi).then_some(Self { lo, hi, ..self })
    }

    /// The range without a bound that has moved since `before`, so that repeated joins end.
    pub fn widened(self, before: Self) -> Self {
        let lo = if self.lo < before.lo { 0 } else { self.lo };
        let hi = if self.hi > before.hi { 255 } else { self.hi };
        Self { lo, hi, half: self.half }
    }

    /// The sum with another byte and a carry, and the carry of the sum if it is known.
    pub fn plus(self, other: Self, carry: Option<bool>) -> (Self, Option<bool>) {
        let least = u16::from(self.lo) + u16::from(other.lo) + u16::from(carry == Some(true));
        let most = u16::from(self.hi) + u16::from(other.hi) + u16::from(carry != Some(false));
        match (least > 255, most > 255) {
            (false, false) => (Self::range(least as u8, most as u8), Some(false)),
            (true, true) => (Self::range(least as u8, most as u8), Some(true)),
            _ => (Self::ANY, None),
        }
    }

    /// The difference to another byte and a borrow, and the borrow of the difference if it is
    /// known.
    pub fn minus(self, other: Self, borrow: Option<bool>) -> (Self, Option<bool>) {
        let least = i16::from(self.lo) - i16::from(other.hi) - i16::from(borrow != Some(false));
        let most = i16::from(self.hi) - i16::from(other.lo) - i16::from(borrow == Some(true));
        match (least < 0, most < 0) {
            (false, false) => (Self::range(least as u8, most as u8), Some(false)),
            (true, true) => (Self::range(least as u8, most as u8), Some(true)),
            _ => (Self::ANY, None),
        }
    }

    /// Bitwise AND.
    pub fn and(self, other: Self) -> Self {
        match (self.known(), other.known()) {
            (Some(a), Some(b)) => Self::of(a & b),
            _ => Self::range(0, self.hi.min(other.hi)),
        }
    }

    /// Bitwise OR.
    pub fn or(self, other: Self) -> Self {
        match (self.known(), other.known()) {
            (Some(a), Some(b)) => Self::of(a | b),
            _ => Self::range(self.lo.max(other.lo), all_below(self.hi | other.hi)),
        }
    }

    /// Bitwise exclusive OR.
    pub fn eor(self, other: Self) -> Self {
        match (self.known(), other.known()) {
            (Some(a), Some(b)) => Self::of(a ^ b),
            _ => Self::range(0, all_below(self.hi | other.hi)),
        }
    }

    /// `what` of both ends, where `what` grows with its argument.
    pub fn map(self, what: impl Fn(u8) -> u8) -> Self {
        Self::range(what(self.lo), what(self.hi))
    }
}

/// All bits up to the highest 1.
fn all_below(bits: u8) -> u8 {
    match bits {
        0 => 0,
        bits => u8::MAX >> bits.leading_zeros(),
    }
}

/// The symbol and offset of a pair whose bytes are the halves of one.
pub fn pair(low: Value, high: Value) -> Option<(SymbolId, u16)> {
    let (low, high) = (low.half?, high.half?);
    let fits = !low.is_high && high.is_high && low.id == high.id;
    (fits && low.offset == high.offset & 0xFF).then_some((high.id, high.offset))
}
