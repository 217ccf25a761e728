//! Loops that wait for the hardware: they only read one register until it changes.

use std::collections::BTreeSet;

use crate::annotations::Wait;
use crate::cycles::read_register;
use crate::opcode::{Immediate, Op, Two};
use crate::order::Loop;
use crate::stack::Analysis;
use crate::summary::Summary;

/// Status register of the SPI, in the data space. Its waits begin with the write of SPDR.
const SPSR: u16 = 0x4D;

/// How often a loop that waits goes back to its head, if it is one and an annotation says how long
/// the hardware takes. A round has `cycles`, and SPDR was written at least `since_spdr` cycles
/// before the first.
///
/// The register is read once in each round, at the same place. A read that comes when the hardware
/// is ready ends the loop.
pub fn rounds<'a>(
    analysis: &Analysis<'a>,
    inner: &Loop,
    summary: &Summary,
    since_spdr: u8,
    cycles: u32,
) -> Option<(u32, &'a Wait)> {
    let mut registers = BTreeSet::new();
    for at in &inner.nodes {
        let op = analysis.program.instruction(*at).ok()?.op;
        match read_register(op) {
            Some(register) => {
                registers.insert(register);
            }
            None if !is_harmless(op) => return None,
            None => {}
        }
        let inside = summary
            .edges
            .range((*at, 0)..=(*at, u32::MAX))
            .filter(|(_, to)| inner.nodes.contains(to));
        if inside.count() > 1 {
            return None;
        }
    }
    let register = registers.pop_first().filter(|_| registers.is_empty())?;
    let wait = analysis.annotations.wait(register)?;
    let passed = if register == SPSR { u32::from(since_spdr) } else { 0 };
    Some((wait.cycles.saturating_sub(passed).div_ceil(cycles.max(1)), wait))
}

/// True for instructions that only test what was read.
fn is_harmless(op: Op) -> bool {
    matches!(
        op,
        Op::Two(Two::And | Two::Mov | Two::Cp | Two::Cpc, ..)
            | Op::Immediate(Immediate::Andi | Immediate::Cpi, ..)
            | Op::Brbs(..)
            | Op::Brbc(..)
            | Op::Rjmp(_)
            | Op::Sbrc(..)
            | Op::Sbrs(..)
            | Op::Nop
            | Op::Wdr
    )
}
