//! The arithmetic instructions: values and flags of their results.

use crate::opcode::{FLAG_C, FLAG_N, FLAG_S, FLAG_V, FLAG_Z, Immediate, One, Op, Product, Two};
use crate::state::{KnownBits, State, Test};
use crate::value::{Half, Value};
use crate::wide;

/// Sets a flag, by an instruction that does nothing else.
pub fn set_flag(state: &mut State, flag: u8, value: Option<bool>) {
    state.flags.set(flag, value);
    state.flags.test = Test::None;
    state.flags.chain = None;
}

/// Does an instruction of the arithmetic unit.
pub fn compute(state: &mut State, op: Op, at: u32) {
    match op {
        Op::Movw(d, r) => {
            state.name_pair(r, at);
            copy(state, d, r);
            copy(state, d + 1, r + 1);
        }
        Op::Two(Two::Mov, d, r) => {
            state.name(r, at, 0);
            copy(state, d, r);
        }
        Op::Two(what, d, r) => two(state, what, d, r, at),
        Op::Immediate(what, d, k) => immediate(state, what, d, k, at),
        Op::One(what, d) => one(state, what, d, at),
        Op::Adiw(d, k) => {
            wide::add(state, d, k.into(), at);
            state.flags.forget();
            result(state, vec![state.get(d), state.get(d + 1)]);
        }
        Op::Sbiw(d, k) => {
            state.name_pair(d, at);
            let old = vec![state.get(d), state.get(d + 1)];
            wide::add(state, d, u16::from(k).wrapping_neg(), at);
            let new = vec![state.get(d), state.get(d + 1)];
            difference(state, new, old, vec![k, 0]);
        }
        Op::Product(what, d, r) => product(state, what, d, r),
        Op::Bld(d, _) => state.set(d, Value::ANY),
        _ => {}
    }
}

fn copy(state: &mut State, d: u8, r: u8) {
    let (value, bits) = (state.get(r), state.bits[usize::from(r)]);
    state.set(d, value);
    state.bits[usize::from(d)] = bits;
}

/// The flags Z, N and S of a result, and C, V where they are known already.
fn result(state: &mut State, bytes: Vec<Value>) {
    let is_zero =
        known(bytes.iter().all(|byte| byte.hi == 0), bytes.iter().any(|byte| byte.lo > 0));
    let top = bytes.last().copied().unwrap_or(Value::ANY);
    let is_negative = sign(top);
    state.flags.set(FLAG_Z, is_zero);
    state.flags.set(FLAG_N, is_negative);
    let overflow = state.flags.get(FLAG_V);
    let signed = is_negative.zip(overflow).map(|(negative, overflow)| negative != overflow);
    state.flags.set(FLAG_S, signed);
    state.flags.test = Test::Result(bytes);
}

fn sign(value: Value) -> Option<bool> {
    known(value.lo >= 0x80, value.hi < 0x80)
}

/// True or false, if one of them is certain.
fn known(is_true: bool, is_false: bool) -> Option<bool> {
    (is_true || is_false).then_some(is_true)
}

/// The flags of `old - k`, which was stored as `new`.
fn difference(state: &mut State, new: Vec<Value>, old: Vec<Value>, k: Vec<u8>) {
    let (lo, hi) = wide::range(&old);
    let constant = k.iter().rev().fold(0u32, |number, byte| number << 8 | u32::from(*byte));
    let chain = state.flags.chain.take();
    state.flags.forget();
    result(state, new.clone());
    state.flags.set(FLAG_C, borrow(lo, hi, constant, constant));
    state.flags.chain = chain;
    state.flags.test = Test::Difference(new, old, k);
}

/// True if a number is less than another, if their ranges say so.
fn borrow(lo: u32, hi: u32, other_lo: u32, other_hi: u32) -> Option<bool> {
    known(hi < other_lo, lo >= other_hi)
}

/// The flags of a comparison of two numbers, lowest byte first.
fn compare(state: &mut State, bytes: Vec<(Value, Value)>) {
    let (left, right): (Vec<Value>, Vec<Value>) = bytes.iter().copied().unzip();
    let ((lo, hi), (other_lo, other_hi)) = (wide::range(&left), wide::range(&right));
    state.flags.forget();
    let number = |value: Value| value.with(value.half.filter(|half| half.is_number()));
    let bytes: Vec<(Value, Value)> =
        bytes.into_iter().map(|(left, right)| (number(left), number(right))).collect();
    let are_equal = |(left, right): &(Value, Value)| {
        left.known().is_some() && left.known() == right.known()
            || left.half.is_some() && left.half == right.half
    };
    let differ = |(left, right): &(Value, Value)| {
        left.hi < right.lo
            || right.hi < left.lo
            || left.half.zip(right.half).is_some_and(|(a, b)| {
                a.id == b.id && a.is_high == b.is_high && !a.is_high && a.offset != b.offset
            })
    };
    let all_equal = bytes.iter().all(are_equal);
    let are_distinct = bytes.iter().any(differ) || are_distinct_pairs(&bytes);
    state.flags.set(FLAG_Z, known(all_equal, are_distinct));
    let carry = if all_equal { Some(false) } else { borrow(lo, hi, other_lo, other_hi) };
    state.flags.set(FLAG_C, carry);
    state.flags.set(FLAG_S, if all_equal { Some(false) } else { less_signed(&left, &right) });
    state.flags.test = Test::Compare(bytes);
}

/// True for two pairs of one symbol, whose low bytes are equal and whose offsets differ.
fn are_distinct_pairs(bytes: &[(Value, Value)]) -> bool {
    let [low, high] = bytes else { return false };
    match (crate::value::pair(low.0, high.0), crate::value::pair(low.1, high.1)) {
        (Some((id, offset)), Some((other, other_offset))) => id == other && offset != other_offset,
        _ => false,
    }
}

/// The range of a signed number of several bytes, mapped to unsigned order; `None` if it has both
/// signs.
pub fn signed_range(bytes: &[Value]) -> Option<(u32, u32)> {
    sign(*bytes.last()?)?;
    let flip = 0x80 << (8 * (bytes.len() as u32 - 1));
    let (lo, hi) = wide::range(bytes);
    Some((lo ^ flip, hi ^ flip))
}

fn less_signed(left: &[Value], right: &[Value]) -> Option<bool> {
    let ((lo, hi), (other_lo, other_hi)) = (signed_range(left)?, signed_range(right)?);
    borrow(lo, hi, other_lo, other_hi)
}

fn two(state: &mut State, what: Two, d: u8, r: u8, at: u32) {
    match what {
        Two::And | Two::Or | Two::Eor => return logic(state, what, d, r, at),
        Two::Cp | Two::Cpc => {
            state.name(d, at, 0);
            state.name(r, at, 1);
            let mut bytes = match (what, &state.flags.test) {
                (Two::Cpc, Test::Compare(bytes)) if bytes.len() < 4 => bytes.clone(),
                (Two::Cpc, _) => return state.flags.forget(),
                _ => Vec::new(),
            };
            bytes.push((state.get(d), state.get(r)));
            return compare(state, bytes);
        }
        _ => {}
    }
    let other = state.get(r);
    match (what, other.known()) {
        (Two::Sub, Some(k)) => return subtract(state, d, k, false, at),
        (Two::Sbc, Some(k)) if d != r => return subtract(state, d, k, true, at),
        (Two::Add, Some(k)) if d.is_multiple_of(2) && d != r => state.name_pair_for_chain(d, k, at),
        _ => {}
    }
    if d == r && what == Two::Sub {
        state.set(d, Value::ZERO);
        state.flags.forget();
        state.flags.set(FLAG_C, Some(false));
        state.flags.set(FLAG_V, Some(false));
        return result(state, vec![Value::ZERO]);
    }
    let (value, carry) = (state.get(d), state.flags.get(FLAG_C));
    let chain = state.flags.chain.take();
    let comparison = match (what, &state.flags.test) {
        (Two::Sub, _) => Some(vec![]),
        (Two::Sbc, Test::Compare(bytes)) if bytes.len() < 4 => Some(bytes.clone()),
        _ => None,
    };
    if let Some(mut bytes) = comparison {
        state.name(d, at, 0);
        state.name(r, at, 1);
        bytes.push((state.get(d), state.get(r)));
        let borrow = if what == Two::Sub { Some(false) } else { carry };
        let (new, _) = value.minus(other, borrow);
        compare(state, bytes);
        state.set(d, new);
        return;
    }
    let (new, carry) = match what {
        Two::Add => value.plus(other, Some(false)),
        Two::Adc => value.plus(other, carry),
        Two::Sbc => value.minus(other, carry),
        _ => (Value::ANY, None),
    };
    // A sum has the symbol of the operand that is not known, whichever that is.
    let (symbol, constant) = if value.known().is_some() && other.known().is_none() {
        (other, value)
    } else {
        (value, other)
    };
    let new = new.with(sum_half(symbol, constant, what, chain));
    state.flags.forget();
    state.flags.set(FLAG_C, carry);
    if let (Two::Add, Some(half), Some(k)) = (what, symbol.half, constant.known())
        && !half.is_high
    {
        state.flags.chain = Some((half, i16::from(k)));
    }
    state.set(d, new);
    result(state, vec![new]);
}

/// The symbol of a sum of a byte with a symbol and a known one.
fn sum_half(value: Value, other: Value, what: Two, chain: Option<(Half, i16)>) -> Option<Half> {
    let (half, k) = (value.half?, other.known()?);
    match what {
        Two::Add if !half.is_high => Some(Half::low(half.id, half.offset.wrapping_add(k.into()))),
        Two::Adc if half.is_high => {
            let (low, added) = chain?;
            let fits = added >= 0 && low.id == half.id && low.offset == half.offset & 0xFF;
            let sum = u16::from(k) << 8 | added as u16;
            fits.then(|| Half::high(half.id, half.offset.wrapping_add(sum)))
        }
        _ => None,
    }
}

/// Subtracts a constant, with or without borrow.
fn subtract(state: &mut State, d: u8, k: u8, with_borrow: bool, at: u32) {
    if !with_borrow && d.is_multiple_of(2) {
        state.name_pair_for_chain(d, k, at);
    }
    if state.get(d).half.is_none() {
        state.name(d, at, 2);
    }
    let value = state.get(d);
    let borrow = if with_borrow { state.flags.get(FLAG_C) } else { Some(false) };
    let (new, _) = value.minus(Value::of(k), borrow);
    let chain = state.flags.chain.take();
    let mut half = None;
    let mut next_chain = None;
    if let Some(old) = value.half {
        if !with_borrow && !old.is_high {
            half = Some(Half::low(old.id, old.offset.wrapping_sub(k.into())));
            next_chain = Some((old, -i16::from(k)));
        } else if let (true, true, Some((low, subtracted))) = (with_borrow, old.is_high, chain)
            && subtracted <= 0
            && low.id == old.id
            && low.offset == old.offset & 0xFF
        {
            let constant = u16::from(k) << 8 | subtracted.unsigned_abs();
            half = Some(Half::high(old.id, old.offset.wrapping_sub(constant)));
        }
    }
    let new = new.with(half);
    let (mut news, mut olds, mut constants) = match (with_borrow, &state.flags.test) {
        (false, _) => (vec![], vec![], vec![]),
        (true, Test::Difference(new, old, k)) if new.len() < 4 => {
            (new.clone(), old.clone(), k.clone())
        }
        _ => {
            // What the borrow is of is not known.
            state.flags.forget();
            state.set(d, new);
            return;
        }
    };
    news.push(new);
    olds.push(value);
    constants.push(k);
    state.set(d, new);
    state.flags.chain = next_chain;
    difference(state, news, olds, constants);
}

fn immediate(state: &mut State, what: Immediate, d: u8, k: u8, at: u32) {
    match what {
        Immediate::Ldi => state.set(d, Value::of(k)),
        Immediate::Cpi => {
            state.name(d, at, 0);
            compare(state, vec![(state.get(d), Value::of(k))]);
        }
        Immediate::Subi => subtract(state, d, k, false, at),
        Immediate::Sbci => subtract(state, d, k, true, at),
        Immediate::Andi | Immediate::Ori => {
            let (value, bits) = (state.get(d), state.bits[usize::from(d)]);
            let is_and = what == Immediate::Andi;
            let new = if is_and { value.and(Value::of(k)) } else { value.or(Value::of(k)) };
            // A mask with all bits changes nothing.
            let keeps = is_and && k == 255 || !is_and && k == 0;
            let new = if keeps { value } else { new };
            set_result(state, d, new, at);
            let bits = if is_and {
                KnownBits {
                    zeros: bits.zeros | !k,
                    ones: bits.ones & k,
                    same: bits.same & k,
                    ..bits
                }
            } else {
                let (zeros, ones) = (bits.zeros & !k, bits.ones | k);
                KnownBits { zeros, ones, same: bits.same & !k, ..bits }
            };
            state.bits[usize::from(d)] = bits;
        }
    }
}

/// Stores the result of a logical operation, which leaves C and clears V.
fn set_result(state: &mut State, d: u8, new: Value, at: u32) {
    state.set(d, new);
    state.name(d, at, 2);
    state.flags.set(FLAG_V, Some(false));
    state.flags.chain = None;
    result(state, vec![state.get(d)]);
}

fn logic(state: &mut State, what: Two, d: u8, r: u8, at: u32) {
    let (value, other) = (state.get(d), state.get(r));
    let (mine, theirs) = (state.bits[usize::from(d)], state.bits[usize::from(r)]);
    if d == r && what != Two::Eor {
        // TST: the value stays.
        set_result(state, d, value, at);
        state.bits[usize::from(d)] = mine;
        return;
    }
    let new = match what {
        Two::And => value.and(other),
        Two::Or => value.or(other),
        _ if d == r => Value::ZERO,
        _ => value.eor(other),
    };
    set_result(state, d, new, at);
    // The bits that a mask of known bits leaves.
    let (of, mask) = if mine.same != 0 { (mine, theirs) } else { (theirs, mine) };
    let (zeros, ones, left) = match what {
        Two::And => (mine.zeros | theirs.zeros, mine.ones & theirs.ones, mask.ones),
        Two::Or => (mine.zeros & theirs.zeros, mine.ones | theirs.ones, mask.zeros),
        _ => return,
    };
    state.bits[usize::from(d)] = KnownBits { zeros, ones, same: of.same & left, of: of.of };
}

fn one(state: &mut State, what: One, d: u8, at: u32) {
    let value = state.get(d);
    let carry = state.flags.get(FLAG_C);
    match what {
        One::Swap => {
            let new = match value.known() {
                Some(known) => Value::of(known.rotate_left(4)),
                None if value.hi < 16 => value.map(|byte| byte << 4),
                None => Value::ANY,
            };
            state.set(d, new);
        }
        One::Inc | One::Dec => {
            let step: u8 = if what == One::Inc { 1 } else { 255 };
            if value.half.is_none() {
                state.name(d, at, 0);
            }
            let value = state.get(d);
            let wraps = if what == One::Inc { value.hi == 255 } else { value.lo == 0 };
            let new = match value.known() {
                Some(known) => Value::of(known.wrapping_add(step)),
                None if wraps => Value::ANY,
                None => value.map(|byte| byte.wrapping_add(step)),
            };
            let half = value.half.filter(|half| !half.is_high);
            let half = half.map(|half| Half::low(half.id, half.offset.wrapping_add(step.into())));
            let edge = if what == One::Inc { 0x7F } else { 0x80 };
            let overflows = match value.known() {
                Some(known) => Some(known == edge),
                None if edge < value.lo || value.hi < edge => Some(false),
                None => None,
            };
            state.set(d, new.with(half));
            state.name(d, at, 1);
            state.flags.set(FLAG_V, overflows);
            let new = state.get(d);
            result(state, vec![new]);
            if what == One::Dec {
                state.flags.test = Test::Decrement(new, value);
            }
        }
        One::Com => {
            set_result(state, d, Value::range(!value.hi, !value.lo), at);
            state.flags.set(FLAG_C, Some(true));
        }
        One::Neg => {
            let (new, carry) = Value::ZERO.minus(value, Some(false));
            state.flags.forget();
            state.flags.set(FLAG_C, carry);
            state.set(d, new);
            result(state, vec![new]);
        }
        One::Lsr | One::Ror | One::Asr => {
            let out = value.known().map(|known| known & 1 != 0);
            let new = match (what, carry) {
                (One::Lsr, _) | (One::Ror, Some(false)) => value.map(|byte| byte >> 1),
                (One::Ror, Some(true)) => value.map(|byte| byte >> 1 | 0x80),
                (One::Asr, _) if sign(value).is_some() => value.map(|byte| (byte as i8 >> 1) as u8),
                _ => Value::ANY,
            };
            state.flags.forget();
            state.flags.set(FLAG_C, out);
            state.set(d, new);
            state.name(d, at, 2);
            result(state, vec![state.get(d)]);
        }
    }
}

fn product(state: &mut State, what: Product, d: u8, r: u8) {
    let (a, b) = (state.get(d), state.get(r));
    let are_positive = a.hi < 0x80 && b.hi < 0x80;
    let is_plain = what == Product::Mul
        || are_positive && matches!(what, Product::Muls | Product::Mulsu)
        || what == Product::Mulsu && a.hi < 0x80;
    state.flags.forget();
    let (mut low, mut high) = (Value::ANY, Value::ANY);
    if is_plain {
        let least = u32::from(a.lo) * u32::from(b.lo);
        let most = u32::from(a.hi) * u32::from(b.hi);
        let value = |n| {
            let (lo, hi) = wide::byte_range(least, most, n);
            Value::range(lo, hi)
        };
        (low, high) = (value(0), value(1));
    }
    state.set(0, low);
    state.set(1, high);
}
