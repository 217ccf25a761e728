//! What a flag says about the values from which it comes.

use crate::arithmetic::signed_range;
use crate::opcode::{FLAG_C, FLAG_I, FLAG_N, FLAG_S, FLAG_V, FLAG_Z};
use crate::state::{Interrupts, State, Test};
use crate::value::Value;
use crate::wide;

/// Assumes the value of a flag; false if that is impossible.
pub fn assume(state: &mut State, flag: u8, is_set: bool) -> bool {
    if flag == FLAG_I {
        let now = if is_set { Interrupts::Enabled } else { Interrupts::Disabled };
        if state.interrupts != Interrupts::Either && state.interrupts != now {
            return false;
        }
        state.interrupts = now;
        return true;
    }
    if let Some(known) = state.flags.get(flag) {
        return known == is_set;
    }
    state.flags.set(flag, Some(is_set));
    let test = state.flags.test.clone();
    match test {
        Test::None => true,
        Test::Result(bytes) => assume_result(state, &bytes, flag, is_set),
        Test::Compare(bytes) => assume_comparison(state, &bytes, flag, is_set),
        Test::Decrement(new, old) => match (flag, is_set) {
            // From 0 it would be negative.
            (FLAG_N, false) => {
                let (lo, hi) = (old.lo.max(1), old.hi.min(0x80));
                lo <= hi && state.refine(old, lo, hi) && state.refine(new, lo - 1, hi - 1)
            }
            (FLAG_Z | FLAG_N, _) => assume_result(state, &[new], flag, is_set),
            _ => true,
        },
        Test::Difference(new, old, k) => match flag {
            FLAG_C => assume_borrow(state, &new, &old, &k, is_set),
            FLAG_Z | FLAG_N => assume_result(state, &new, flag, is_set),
            _ => true,
        },
    }
}

fn assume_result(state: &mut State, bytes: &[Value], flag: u8, is_set: bool) -> bool {
    let Some(top) = bytes.last() else { return true };
    match flag {
        FLAG_Z if is_set => bytes.iter().all(|byte| state.refine(*byte, 0, 0)),
        FLAG_Z => {
            let mut unknown = bytes.iter().filter(|byte| byte.hi != 0);
            match (unknown.next(), unknown.next()) {
                (Some(byte), None) => state.refine(*byte, byte.lo.max(1), 255),
                (None, _) => false,
                _ => true,
            }
        }
        FLAG_N => assume_sign(state, *top, is_set),
        // S is N xor V.
        FLAG_S if state.flags.get(FLAG_V) == Some(false) => assume_sign(state, *top, is_set),
        _ => true,
    }
}

fn assume_sign(state: &mut State, top: Value, is_negative: bool) -> bool {
    if is_negative { state.refine(top, 0x80, 255) } else { state.refine(top, 0, 0x7F) }
}

/// Narrows a number of several bytes to a range.
fn narrow(state: &mut State, bytes: &[Value], lo: u32, hi: u32) -> bool {
    let (old_lo, old_hi) = wide::range(bytes);
    let (lo, hi) = (lo.max(old_lo), hi.min(old_hi));
    if lo > hi {
        return false;
    }
    bytes.iter().enumerate().all(|(n, byte)| {
        let (lo, hi) = wide::byte_range(lo, hi, n);
        state.refine(*byte, lo, hi)
    })
}

fn assume_comparison(state: &mut State, bytes: &[(Value, Value)], flag: u8, is_set: bool) -> bool {
    let (left, right): (Vec<Value>, Vec<Value>) = bytes.iter().copied().unzip();
    match flag {
        FLAG_Z if is_set => bytes.iter().all(|(left, right)| {
            state.refine(*left, right.lo, right.hi) && state.refine(*right, left.lo, left.hi)
        }),
        FLAG_Z => assume_unequal(state, bytes),
        FLAG_C => {
            let ((lo, hi), (other_lo, other_hi)) = (wide::range(&left), wide::range(&right));
            if is_set {
                // left < right
                other_hi > 0
                    && narrow(state, &left, lo, other_hi - 1)
                    && narrow(state, &right, lo.saturating_add(1), other_hi)
            } else {
                narrow(state, &left, other_lo, hi) && narrow(state, &right, other_lo, hi)
            }
        }
        FLAG_S => assume_signed(state, &left, &right, is_set),
        _ => true,
    }
}

/// Assumes that two numbers differ: of use if all but one of their bytes are equal.
fn assume_unequal(state: &mut State, bytes: &[(Value, Value)]) -> bool {
    let is_equal =
        |(left, right): &&(Value, Value)| left.known().is_some() && left.known() == right.known();
    let mut others = bytes.iter().filter(|pair| !is_equal(pair));
    let (Some((left, right)), None) = (others.next(), others.next()) else {
        return true;
    };
    exclude(state, *left, *right) && exclude(state, *right, *left)
}

/// Assumes that a value is not another one that is known.
fn exclude(state: &mut State, value: Value, other: Value) -> bool {
    match other.known() {
        Some(k) if value.lo == k && value.hi == k => false,
        Some(k) if value.lo == k => state.refine(value, k + 1, 255),
        Some(k) if value.hi == k => state.refine(value, 0, k - 1),
        _ => true,
    }
}

/// Assumes a signed comparison, of numbers whose signs are known.
fn assume_signed(state: &mut State, left: &[Value], right: &[Value], is_less: bool) -> bool {
    let flip = 0x80 << (8 * (left.len() as u32 - 1));
    let (Some((lo, hi)), Some((other_lo, other_hi))) = (signed_range(left), signed_range(right))
    else {
        return true;
    };
    let (from, to) = if is_less {
        match other_hi.checked_sub(1) {
            Some(most) => (lo, hi.min(most)),
            None => return false,
        }
    } else {
        (lo.max(other_lo), hi)
    };
    from <= to && narrow(state, left, from ^ flip, to ^ flip)
}

/// Assumes that a constant was greater than the number from which it was subtracted, or not.
fn assume_borrow(state: &mut State, new: &[Value], old: &[Value], k: &[u8], is_less: bool) -> bool {
    let constant = k.iter().rev().fold(0u32, |number, byte| number << 8 | u32::from(*byte));
    let (lo, hi) = wide::range(old);
    let (from, to) = if is_less {
        match constant.checked_sub(1) {
            Some(most) => (lo, hi.min(most)),
            None => return false,
        }
    } else {
        (lo.max(constant), hi)
    };
    if from > to || !narrow(state, old, from, to) {
        return false;
    }
    let all = u32::MAX >> (32 - 8 * new.len() as u32);
    let (from, to) = (from.wrapping_sub(constant) & all, to.wrapping_sub(constant) & all);
    narrow(state, new, from, to)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::opcode::{Immediate, Op};
    use crate::state::Enables;
    use crate::value::Value;

    fn compared(value: Value, k: u8) -> State {
        let mut state = State::at_entry(Interrupts::Enabled, Enables::default());
        state.set(24, value);
        crate::arithmetic::compute(&mut state, Op::Immediate(Immediate::Cpi, 24, k), 0);
        state
    }

    #[test]
    fn a_branch_narrows_the_compared_register() {
        let mut less = compared(Value::ANY, 6);
        assert!(assume(&mut less, FLAG_C, true));
        assert_eq!((less.get(24).lo, less.get(24).hi), (0, 5));
        let mut other = compared(Value::ANY, 6);
        assert!(assume(&mut other, FLAG_C, false));
        assert_eq!((other.get(24).lo, other.get(24).hi), (6, 255));
        let mut equal = compared(Value::range(3, 9), 3);
        assert!(assume(&mut equal, FLAG_Z, false));
        assert_eq!((equal.get(24).lo, equal.get(24).hi), (4, 9));
        assert!(!assume(&mut compared(Value::range(7, 9), 6), FLAG_C, true));
    }

    #[test]
    fn a_copy_is_narrowed_with_the_register() {
        let mut state = State::at_entry(Interrupts::Enabled, Enables::default());
        state.set(24, Value::ANY);
        crate::arithmetic::compute(&mut state, Op::Two(crate::opcode::Two::Mov, 18, 24), 0);
        crate::arithmetic::compute(&mut state, Op::Immediate(Immediate::Cpi, 24, 8), 2);
        assert!(assume(&mut state, FLAG_C, true));
        assert_eq!((state.get(18).lo, state.get(18).hi), (0, 7));
    }
}
