//! Pairs of registers as numbers of 16 bits.

use crate::state::State;
use crate::value::{Half, Value, pair};

/// The range of a number of several bytes, lowest first.
pub fn range(bytes: &[Value]) -> (u32, u32) {
    let number = |of: fn(&Value) -> u8| {
        bytes.iter().rev().fold(0, |number, byte| number << 8 | u32::from(of(byte)))
    };
    (number(|byte| byte.lo), number(|byte| byte.hi))
}

/// The range of byte `n` of a number in a range.
pub fn byte_range(lo: u32, hi: u32, n: usize) -> (u8, u8) {
    let shift = 8 * n as u32;
    if u64::from(lo) >> (shift + 8) == u64::from(hi) >> (shift + 8) {
        ((lo >> shift) as u8, (hi >> shift) as u8)
    } else {
        (0, 255)
    }
}

/// Adds a constant to a pair of registers, without the flags.
pub fn add(state: &mut State, low: u8, constant: u16, at: u32) {
    state.name_pair(low, at);
    let (a, b) = (state.get(low), state.get(low + 1));
    let symbol = pair(a, b);
    let (from, to) = range(&[a, b]);
    let (from, to) = (from + u32::from(constant), to + u32::from(constant));
    let (mut new_low, mut new_high) = (Value::ANY, Value::ANY);
    if from >> 16 == to >> 16 {
        let (from, to) = (from & 0xFFFF, to & 0xFFFF);
        let value = |n| {
            let (lo, hi) = byte_range(from, to, n);
            Value::range(lo, hi)
        };
        (new_low, new_high) = (value(0), value(1));
    }
    if let Some((id, offset)) = symbol {
        let offset = offset.wrapping_add(constant);
        new_low = new_low.with(Some(Half::low(id, offset)));
        new_high = new_high.with(Some(Half::high(id, offset)));
    } else if let Some(half) = a.half.filter(|half| !half.is_high) {
        let offset = half.offset.wrapping_add(constant);
        new_low = new_low.with(Some(Half::low(half.id, offset)));
    }
    state.set(low, new_low);
    state.set(low + 1, new_high);
}
