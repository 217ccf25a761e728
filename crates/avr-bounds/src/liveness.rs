//! The registers that a function reads before it writes them: its result depends on no others.

use std::collections::{BTreeMap, BTreeSet};

use crate::opcode::{Immediate, Mode, One, Op, Two};
use crate::program::Program;

/// The registers that an instruction reads, and those that it writes, a bit for each.
pub fn uses(op: Op) -> (u32, u32) {
    let bit = |r: u8| 1u32 << r;
    let both = |r: u8| 3u32 << r;
    match op {
        Op::Movw(d, r) => (both(r), both(d)),
        // The result does not depend on the register.
        Op::Two(Two::Eor | Two::Sub, d, r) if d == r => (0, bit(d)),
        Op::Two(Two::Mov, d, r) => (bit(r), bit(d)),
        Op::Two(Two::Cp | Two::Cpc, d, r) | Op::Cpse(d, r) => (bit(d) | bit(r), 0),
        Op::Two(_, d, r) => (bit(d) | bit(r), bit(d)),
        Op::Product(_, d, r) => (bit(d) | bit(r), both(0)),
        Op::Immediate(Immediate::Ldi, d, _) => (0, bit(d)),
        Op::Immediate(Immediate::Cpi, d, _) => (bit(d), 0),
        Op::Immediate(_, d, _) => (bit(d), bit(d)),
        Op::One(One::Com | One::Neg | One::Swap | One::Inc, d) | Op::One(_, d) => (bit(d), bit(d)),
        Op::Adiw(d, _) | Op::Sbiw(d, _) => (both(d), both(d)),
        Op::Load(d, pointer, mode) => {
            let changed = if matches!(mode, Mode::Displaced(_)) { 0 } else { both(pointer.low()) };
            (both(pointer.low()), bit(d) | changed)
        }
        Op::Store(r, pointer, mode) => {
            let changed = if matches!(mode, Mode::Displaced(_)) { 0 } else { both(pointer.low()) };
            (both(pointer.low()) | bit(r), changed)
        }
        Op::Lds(d, _) | Op::In(d, _) | Op::Pop(d) => (0, bit(d)),
        Op::Sts(_, r) | Op::Out(_, r) => (bit(r), 0),
        Op::Lpm(d, increments) => (both(30), bit(d) | if increments { both(30) } else { 0 }),
        Op::LpmR0 => (both(30), bit(0)),
        Op::Spm => (both(0) | both(30), 0),
        Op::Bld(d, _) => (bit(d), bit(d)),
        Op::Bst(r, _) | Op::Sbrc(r, _) | Op::Sbrs(r, _) => (bit(r), 0),
        Op::Ijmp | Op::Icall => (both(30), 0),
        _ => (0, 0),
    }
}

/// The registers that are read before they are written, from `entry` along the edges. `calls` has
/// the registers that the functions called at an address read.
pub fn reads(
    program: &Program,
    edges: &BTreeSet<(u32, u32)>,
    calls: &BTreeMap<u32, u32>,
    entry: u32,
) -> u32 {
    let mut live: BTreeMap<u32, u32> = BTreeMap::new();
    let mut before: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    let mut pending: BTreeSet<u32> = BTreeSet::from([entry]);
    for (from, to) in edges {
        before.entry(*to).or_default().push(*from);
        pending.extend([*from, *to]);
    }
    let mut after: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (from, to) in edges {
        after.entry(*from).or_default().push(*to);
    }
    while let Some(at) = pending.pop_last() {
        let Ok(instruction) = program.instruction(at) else { continue };
        let next = after.get(&at).into_iter().flatten();
        let behind = next.fold(0, |all, to| all | live.get(to).unwrap_or(&0));
        let (read, written) = uses(instruction.op);
        let here = behind & !written | read | calls.get(&at).unwrap_or(&0);
        if live.get(&at) != Some(&here) {
            live.insert(at, here);
            pending.extend(before.get(&at).into_iter().flatten());
        }
    }
    *live.get(&entry).unwrap_or(&0)
}
