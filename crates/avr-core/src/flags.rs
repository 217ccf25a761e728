//! The flags of SREG after each kind of operation (DS40002198, section 5, "Status Register and
//! Boolean Formula" of each instruction).
//!
//! Most flags are changed again before a program looks at them. So an operation only keeps what
//! they follow from, and [`Flags::sreg`] calculates them.

/// Carry.
pub(crate) const C: u8 = 1;
/// Zero.
pub(crate) const Z: u8 = 1 << 1;
/// Negative.
pub(crate) const N: u8 = 1 << 2;
/// Overflow of two's complement.
pub(crate) const V: u8 = 1 << 3;
/// Half carry.
pub(crate) const H: u8 = 1 << 5;
/// Bit of BLD and BST.
pub(crate) const T: u8 = 1 << 6;
/// Global interrupt enable.
pub(crate) const I: u8 = 1 << 7;

/// Bit of [`Flags::carries`] that is C.
const CARRY: u32 = 1 << 8;
/// Bit of [`Flags::carries`] that is H.
const HALF_CARRY: u32 = 1 << 4;

/// What SREG follows from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Flags {
    /// I and T, at their places in SREG.
    pub kept: u8,
    /// The carries or borrows into each bit: H is bit 4, C is bit 8.
    carries: u32,
    /// V is bit 7 xor bit 8. S is N xor V, or, if bits 30 and 31 differ, the opposite: a write of
    /// SREG can make it so.
    overflow: u32,
    /// N is bit 7.
    negative: u8,
    /// Z is 1 if this is 0.
    zero: u8,
}

impl Flags {
    #[inline(always)]
    pub fn new(sreg: u8) -> Self {
        let opposite = (sreg >> 4 ^ sreg >> 3 ^ sreg >> 2) & 1;
        Self {
            kept: sreg & (I | T),
            carries: u32::from(sreg & C) << 8 | u32::from(sreg & H) >> 1,
            overflow: u32::from(sreg & V) << 4 | u32::from(opposite) << 31,
            negative: (sreg & N) << 5,
            zero: !sreg & Z,
        }
    }

    /// SREG.
    #[inline(always)]
    pub fn sreg(&self) -> u8 {
        let negative = self.negative >> 7;
        let bits = self.overflow ^ self.overflow >> 1;
        let (overflow, opposite) = (bits as u8 >> 7, (bits >> 30) as u8 & 1);
        self.kept
            | self.carry() as u8
            | u8::from(self.is_zero()) << 1
            | negative << 2
            | overflow << 3
            | (negative ^ overflow ^ opposite) << 4
            | (self.carries << 1) as u8 & H
    }

    /// C.
    #[inline(always)]
    pub fn carry(&self) -> u32 {
        self.carries >> 8 & 1
    }

    /// Z.
    #[inline(always)]
    pub fn is_zero(&self) -> bool {
        self.zero == 0
    }

    /// N.
    #[inline(always)]
    pub fn is_negative(&self) -> bool {
        self.negative & 0x80 != 0
    }

    #[inline(always)]
    fn set_result(&mut self, result: u8) {
        self.negative = result;
        self.zero = result;
    }

    /// Sets C. H stays.
    #[inline(always)]
    pub fn set_carry(&mut self, carry: u32) {
        self.carries = self.carries & HALF_CARRY | carry << 8;
    }

    /// ADD, ADC: the sum.
    #[inline(always)]
    pub fn add(&mut self, a: u8, b: u8, carry: u32) -> u8 {
        let (a, b) = (u32::from(a), u32::from(b));
        let sum = a + b + carry;
        self.carries = a ^ b ^ sum;
        self.overflow = self.carries;
        self.set_result(sum as u8);
        sum as u8
    }

    /// SUB, SUBI, CP, CPI, NEG: the difference.
    #[inline(always)]
    pub fn subtract(&mut self, a: u8, b: u8, borrow: u32) -> u8 {
        let (a, b) = (u32::from(a), u32::from(b));
        let difference = a.wrapping_sub(b).wrapping_sub(borrow);
        self.carries = a ^ b ^ difference;
        self.overflow = self.carries;
        self.set_result(difference as u8);
        difference as u8
    }

    /// SBC, SBCI, CPC: as [`Flags::subtract`], but a result of 0 keeps Z.
    #[inline(always)]
    pub fn subtract_carry(&mut self, a: u8, b: u8) -> u8 {
        let zero = self.zero;
        let result = self.subtract(a, b, self.carry());
        self.zero = zero | result;
        result
    }

    /// AND, ANDI, OR, ORI, EOR.
    #[inline(always)]
    pub fn logic(&mut self, result: u8) {
        self.overflow = 0;
        self.set_result(result);
    }

    /// COM.
    #[inline(always)]
    pub fn complement(&mut self, result: u8) {
        self.logic(result);
        self.carries |= CARRY;
    }

    /// INC and DEC; `overflow` is the result that overflowed.
    #[inline(always)]
    pub fn count(&mut self, result: u8, overflow: u8) {
        self.overflow = u32::from(result == overflow) << 7;
        self.set_result(result);
    }

    /// ASR, LSR, ROR of `operand`: C is its bit 0, V is N xor C.
    #[inline(always)]
    pub fn shift(&mut self, operand: u8, result: u8) {
        let carry = u32::from(operand) & 1;
        self.set_carry(carry);
        self.overflow = u32::from(result) | carry << 8;
        self.set_result(result);
    }

    /// ADIW (`overflow` is !Rd & R, `carry` is !R & Rd) and SBIW (the other way round).
    #[inline(always)]
    pub fn word(&mut self, result: u16, overflow: u16, carry: u16) {
        self.set_carry(u32::from(carry >> 15));
        self.overflow = u32::from(overflow >> 15) << 7;
        self.negative = (result >> 8) as u8;
        self.zero = (result | result >> 8) as u8;
    }

    /// The multiplications: C is bit 15 of the product before the shift of the fractional ones.
    #[inline(always)]
    pub fn product(&mut self, product: u16, result: u16) {
        self.set_carry(u32::from(product >> 15));
        self.zero = (result | result >> 8) as u8;
    }
}
