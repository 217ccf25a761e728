//! Calls of virtual functions of C++: a pointer to an object, the pointer to its table at offset 0,
//! and the address of a function in the table.
//!
//! Which class the object has is not known, so such a call can lead to the same place in each table
//! of the program. The tables are constants with a symbol, `_ZTV` and the class.

use std::collections::{BTreeSet, HashSet};

use crate::opcode::{Immediate, Mode, Op, Pointer, Two};
use crate::program::Program;

/// What avr-gcc puts at the place of a function that has no body; no object has such a class.
const WITHOUT_BODY: [&str; 2] = ["__cxa_pure_virtual", "__cxa_deleted_virtual"];

/// The functions to which the ICALL or IJMP at `at` can lead, if it is a virtual call and the
/// program has the tables. `leaders` are the addresses at which paths can meet.
pub fn targets(program: &Program, leaders: &HashSet<u32>, at: u32) -> Option<Vec<u32>> {
    let mut before = Before { program, leaders, at };
    let place = before.loaded_by_z()?;
    if before.loaded()? != 0 {
        return None;
    }
    let mut found = BTreeSet::new();
    for table in program.virtual_tables() {
        for first in first_functions(table) {
            let Some(word) = table.get(first + usize::from(place / 2)) else { continue };
            let target = u32::from(*word) * 2;
            if !program.is_function(target) {
                return None;
            }
            if !WITHOUT_BODY.contains(&&*program.function_name(target)) {
                found.insert(target);
            }
        }
    }
    (!found.is_empty() && place % 2 == 0).then(|| found.into_iter().collect())
}

/// The places in a table to which an object can point, behind an offset and a type. There are
/// several if the class has several bases; all have the same type.
fn first_functions(table: &[u16]) -> impl Iterator<Item = usize> {
    let is_first = |place: &usize| *place == 2 || table[place - 1] == table[1];
    (2..table.len()).filter(is_first)
}

/// Goes back over the instructions before a call, which no path enters in the middle.
struct Before<'a> {
    program: &'a Program,
    leaders: &'a HashSet<u32>,
    at: u32,
}

impl Before<'_> {
    /// The instruction before, without those that leave Z and r0 alone.
    fn op(&mut self) -> Option<Op> {
        loop {
            if self.leaders.contains(&self.at) {
                return None;
            }
            let instruction = self.program.instruction(self.at.checked_sub(2)?).ok()?;
            if instruction.next() != self.at {
                return None;
            }
            self.at = instruction.at;
            let sets = match instruction.op {
                Op::Movw(d, _)
                | Op::Two(Two::Mov, d, _)
                | Op::Immediate(Immediate::Ldi, d, _)
                | Op::Load(d, Pointer::X | Pointer::Y, _) => d,
                op => return Some(op),
            };
            if sets == 0 || sets >= 30 {
                return Some(instruction.op);
            }
        }
    }

    /// The offset of two bytes that are loaded to Z by Z.
    fn loaded_by_z(&mut self) -> Option<u8> {
        let Op::Two(Two::Mov, 30, scratch) = self.op()? else { return None };
        let (high, low) = (self.op()?, self.op()?);
        match (low, high) {
            (Op::Load(d, Pointer::Z, low), Op::Load(31, Pointer::Z, high)) if d == scratch => {
                offset(low, high)
            }
            _ => None,
        }
    }

    /// The offset of two bytes that are loaded to Z.
    fn loaded(&mut self) -> Option<u8> {
        let at = self.at;
        if let (Some(Op::Load(31, by, high)), Some(Op::Load(30, same, low))) =
            (self.op(), self.op())
        {
            return if by == same { offset(low, high) } else { None };
        }
        self.at = at;
        self.loaded_by_z()
    }
}

/// The offset of a word whose bytes are loaded one after the other.
fn offset(low: Mode, high: Mode) -> Option<u8> {
    match (low, high) {
        (Mode::PostIncrement, Mode::Displaced(0)) => Some(0),
        (Mode::Displaced(low), Mode::Displaced(high)) if high == low + 1 => Some(low),
        _ => None,
    }
}
