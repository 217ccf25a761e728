//! Loops that only count a number down to zero, such as those of `_delay_ms`: their rounds are
//! counted and not followed.

use crate::interference::Interference;
use crate::opcode::{FLAG_C, FLAG_Z, Immediate, One, Op};
use crate::order::Loop;
use crate::program::Program;
use crate::state::State;
use crate::value::Value;

/// Rounds that are counted at most: those of 24 bits.
const MOST_ROUNDS: u32 = 1 << 24;

/// A number of one to four bytes from which a constant is subtracted in each round.
#[derive(Debug, Default)]
struct Counter {
    /// Its registers, the lowest byte first.
    registers: Vec<u8>,
    constant: u32,
    /// Cycles of a round that goes back.
    cycles: u32,
    /// The flag that ends the loop when it is 1.
    flag: u8,
}

/// Sets the number to its value in the last round, if the loop is one of these and the number is
/// known. Returns how often the loop goes back before that round, and the cycles.
pub fn skip(
    program: &Program,
    handlers: &Interference,
    inner: &Loop,
    state: &mut State,
) -> Option<(u32, u32)> {
    // A handler could change the flag before the branch tests it.
    if handlers.effect(state).flags != 0 {
        return None;
    }
    let counter = Counter::of(program, inner)?;
    let known = counter
        .registers
        .iter()
        .rev()
        .try_fold(0u64, |number, r| Some(number << 8 | u64::from(state.get(*r).known()?)))?;
    let modulus = 1u64 << (8 * counter.registers.len());
    let (mut number, mut rounds) = (known, 0);
    loop {
        let is_borrow = number < u64::from(counter.constant);
        let next = (number + modulus - u64::from(counter.constant)) % modulus;
        if if counter.flag == FLAG_C { is_borrow } else { next == 0 } {
            break;
        }
        (number, rounds) = (next, rounds + 1);
        if rounds > MOST_ROUNDS {
            return None;
        }
    }
    if rounds == 0 {
        return None;
    }
    for (n, r) in counter.registers.iter().enumerate() {
        state.set(*r, Value::of((number >> (8 * n)) as u8));
    }
    state.flags.forget();
    Some((rounds, rounds.checked_mul(counter.cycles)?))
}

impl Counter {
    /// The counter of a loop without other effects.
    fn of(program: &Program, inner: &Loop) -> Option<Self> {
        let mut counter = Self::default();
        let mut at = inner.head;
        for _ in 0..inner.nodes.len() {
            let instruction = program.instruction(at).ok()?;
            counter.cycles += instruction.op.cycles();
            let next = instruction.next();
            let is_first = counter.registers.is_empty();
            match instruction.op {
                Op::Nop | Op::Wdr if is_first => {}
                Op::Rjmp(to) if is_first && to == next => {}
                Op::One(One::Dec, r) if is_first => {
                    (counter.registers, counter.constant, counter.flag) = (vec![r], 1, FLAG_Z);
                }
                Op::Sbiw(r, k) if is_first => {
                    (counter.registers, counter.constant) = (vec![r, r + 1], k.into());
                }
                Op::Immediate(Immediate::Subi, r, k) if is_first => {
                    (counter.registers, counter.constant) = (vec![r], k.into());
                }
                Op::Immediate(Immediate::Sbci, r, k)
                    if !is_first
                        && counter.flag == 0
                        && counter.registers.len() < 4
                        && !counter.registers.contains(&r) =>
                {
                    counter.constant |= u32::from(k) << (8 * counter.registers.len());
                    counter.registers.push(r);
                }
                // DEC leaves the carry.
                Op::Brbc(flag, to) if to == inner.head && !is_first => {
                    let is_decrement = counter.flag == FLAG_Z;
                    if !matches!(flag, FLAG_Z | FLAG_C) || is_decrement && flag == FLAG_C {
                        return None;
                    }
                    counter.flag = flag;
                    // One more than a branch that is not taken.
                    counter.cycles += 1;
                    return inner.nodes.contains(&at).then_some(counter);
                }
                _ => return None,
            }
            at = next;
        }
        None
    }
}
