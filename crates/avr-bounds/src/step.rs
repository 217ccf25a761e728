//! What an instruction does to the state: the successors of a state.

use anyhow::{Context, Result, bail};

use crate::arithmetic;
use crate::branch::assume;
use crate::interference::{Effect, Interference};
use crate::memory::{self, JUST_WRITTEN, Written, write, write_bit};
use crate::opcode::{FLAG_C, FLAG_I, FLAG_T, FLAG_Z, Immediate, One, Op, Two};
use crate::program::{Instruction, Program};
use crate::state::{ALL_FLAGS, Interrupts, Slot, State};
use crate::value::Value;
use crate::wide;

/// Where execution continues.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Flow {
    /// At an address of the same function, or of another that is jumped to.
    To(u32),
    /// In a function, which returns to the second address.
    Call(u32, u32),
    /// In a function whose address is not known; it returns to this address.
    CallAnywhere(u32),
    /// At an address that is not known.
    JumpAnywhere,
    /// At the caller.
    Return,
    /// At the interrupted program.
    ReturnFromInterrupt,
}

/// A successor.
#[derive(Debug, Clone)]
pub struct Step {
    /// Where execution continues.
    pub flow: Flow,
    /// What is known there.
    pub state: State,
    /// Cycles of the instruction on this way.
    pub cycles: u32,
    /// What the instruction writes.
    pub written: Written,
}

/// The successors of `state` at an instruction, with what the handlers change that can come behind
/// it. Those that cannot happen are left out.
///
/// # Errors
/// If the instruction breaks what the analysis rests on; the text says how, without the place.
pub fn step(
    program: &Program,
    handlers: &Interference,
    state: State,
    instruction: Instruction,
) -> Result<Vec<Step>> {
    let were_enabled = state.interrupts.may_happen();
    let changed = changed_flags(instruction.op);
    let mut steps = successors(program, handlers, state, instruction)?;
    for Step { flow, state, .. } in &mut steps {
        if state.half_sp.is_some() && were_enabled && state.interrupts.may_happen() {
            bail!(
                "an interrupt can come between the writes of SPH and SPL: disable interrupts before"
            );
        }
        state.kept_flags &= !changed;
        // What comes behind the end of a handler is known of the program that it interrupts.
        if *flow != Flow::ReturnFromInterrupt {
            handlers.apply(state);
        }
    }
    Ok(steps)
}

/// The flags that an instruction can change, without I. OUT to SREG is followed by its value.
fn changed_flags(op: Op) -> u8 {
    match op {
        Op::Bset(flag) | Op::Bclr(flag) => ALL_FLAGS & 1 << flag,
        Op::Bst(..) => 1 << FLAG_T,
        Op::Two(Two::Mov, ..) | Op::Movw(..) | Op::Immediate(Immediate::Ldi, ..) => 0,
        Op::One(One::Swap, _) | Op::Bld(..) | Op::Cpse(..) => 0,
        Op::Two(..) | Op::Product(..) | Op::Immediate(..) | Op::One(..) => {
            ALL_FLAGS & !(1 << FLAG_T)
        }
        Op::Adiw(..) | Op::Sbiw(..) => ALL_FLAGS & !(1 << FLAG_T),
        _ => 0,
    }
}

fn successors(
    program: &Program,
    handlers: &Interference,
    mut state: State,
    instruction: Instruction,
) -> Result<Vec<Step>> {
    let Instruction { at, op } = instruction;
    let next = instruction.next();
    if uses_stack(op) && state.half_sp.is_some() {
        bail!("the stack is used while half of SP is written");
    }
    let (base_cycles, flow) = (op.cycles(), Flow::To(next));
    let mut written = Written::default();
    match op {
        Op::Brbs(flag, to) => return Ok(branch(&state, flag, true, to, next)),
        Op::Brbc(flag, to) => return Ok(branch(&state, flag, false, to, next)),
        op if op.is_skip() => return skip(program, &state, instruction),
        Op::Rjmp(to) | Op::Jmp(to) => return Ok(vec![done(state, Flow::To(to), base_cycles)]),
        // The compilers reserve two bytes of the stack so.
        Op::Rcall(to) if to == next => state.stack.extend([Slot::LOCAL; 2]),
        Op::Rcall(to) | Op::Call(to) => {
            if let Some(table) = called_table(program, handlers, &state, instruction, to) {
                return Ok(table);
            }
            return Ok(vec![done(state, Flow::Call(to, next), base_cycles)]);
        }
        Op::Ijmp | Op::Icall => return indirect(program, state, instruction),
        Op::Ret | Op::Reti => {
            if state.height() != 0 {
                bail!("returns with {} bytes on the stack: a push without a pop", state.height());
            }
            if op == Op::Reti {
                state.interrupts = Interrupts::Enabled;
                return Ok(vec![done(state, Flow::ReturnFromInterrupt, base_cycles)]);
            }
            return Ok(vec![done(state, Flow::Return, base_cycles)]);
        }
        Op::Push(r) => {
            let slot = Slot { value: state.get(r), is_pushed: true };
            state.stack.push(slot);
        }
        Op::Pop(d) => {
            let slot = state.stack.pop().context("a pop without a push, as in setjmp")?;
            state.set(d, slot.value);
        }
        Op::Bset(FLAG_I) => state.interrupts = Interrupts::Enabled,
        Op::Bclr(FLAG_I) => state.interrupts = Interrupts::Disabled,
        Op::Bset(flag) => arithmetic::set_flag(&mut state, flag, Some(true)),
        Op::Bclr(flag) => arithmetic::set_flag(&mut state, flag, Some(false)),
        Op::Bst(..) => state.flags.set(FLAG_T, None),
        Op::Nop | Op::Sleep | Op::Break | Op::Wdr | Op::Spm => {}
        Op::Load(..) | Op::Store(..) | Op::Lds(..) | Op::Sts(..) | Op::Lpm(..) | Op::LpmR0 => {
            memory::access(program, &mut state, op, at, &mut written)?;
        }
        Op::In(d, io) => memory::read_register(&mut state, d, u16::from(io) + 0x20),
        Op::Out(io, r) => write(program, &mut state, u16::from(io) + 0x20, r, &mut written)?,
        Op::Sbi(io, bit) => write_bit(&mut state, io, bit, true, &mut written),
        Op::Cbi(io, bit) => write_bit(&mut state, io, bit, false, &mut written),
        op => arithmetic::compute(&mut state, op, at),
    }
    // A handler can come within it.
    let Effect { registers, flags, .. } = handlers.effect(&state);
    if registers == 0
        && flags == 0
        && let Some(table) = table_jump(program, &state, instruction)
    {
        return Ok(table);
    }
    let cycles = base_cycles + written.halt;
    Ok(vec![Step { written, ..done(state, flow, cycles) }])
}

/// A successor, with the time that has passed.
fn done(mut state: State, flow: Flow, cycles: u32) -> Step {
    state.since_spdr = match state.since_spdr {
        JUST_WRITTEN => 0,
        since => (u32::from(since) + cycles).min(SINCE_MOST) as u8,
    };
    Step { flow, state, cycles, written: Written::default() }
}

/// The most cycles since a write of SPDR that are told apart. More than a transfer takes.
const SINCE_MOST: u32 = 31;

fn uses_stack(op: Op) -> bool {
    matches!(
        op,
        Op::Push(_) | Op::Pop(_) | Op::Ret | Op::Reti | Op::Call(_) | Op::Rcall(_) | Op::Icall
    )
}

fn branch(state: &State, flag: u8, if_set: bool, to: u32, next: u32) -> Vec<Step> {
    let mut steps = Vec::new();
    for is_taken in [false, true] {
        let mut state = state.clone();
        if assume(&mut state, flag, is_taken == if_set) {
            let target = if is_taken { to } else { next };
            steps.push(done(state, Flow::To(target), 1 + u32::from(is_taken)));
        }
    }
    steps
}

/// The successors of a skip: the next instruction, or the one behind it.
fn skip(program: &Program, state: &State, instruction: Instruction) -> Result<Vec<Step>> {
    let next = instruction.next();
    let skipped = program.instruction(next)?;
    let mut steps = Vec::new();
    for skips in [false, true] {
        let mut state = state.clone();
        if !assume_skip(&mut state, instruction, skips) {
            continue;
        }
        let (to, cycles) =
            if skips { (skipped.next(), 1 + skipped.op.bytes() / 2) } else { (next, 1) };
        steps.push(done(state, Flow::To(to), cycles));
    }
    Ok(steps)
}

/// Assumes that a skip skips, or does not; false if that is impossible.
fn assume_skip(state: &mut State, instruction: Instruction, skips: bool) -> bool {
    match instruction.op {
        Op::Cpse(d, r) => {
            let mut compared = state.clone();
            arithmetic::compute(&mut compared, Op::Two(Two::Cp, d, r), instruction.at);
            let is_possible = assume(&mut compared, FLAG_Z, skips);
            let flags = state.flags.clone();
            *state = compared;
            // CPSE changes no flag.
            state.flags = flags;
            is_possible
        }
        Op::Sbrc(r, bit) => assume_bit(state, r, bit, !skips, instruction.at),
        Op::Sbrs(r, bit) => assume_bit(state, r, bit, skips, instruction.at),
        Op::Sbic(io, bit) => is_possible_bit(state, io, bit, !skips),
        Op::Sbis(io, bit) => is_possible_bit(state, io, bit, skips),
        _ => true,
    }
}

fn is_possible_bit(state: &State, io: u8, bit: u8, is_set: bool) -> bool {
    state.enables.get(u16::from(io) + 0x20, bit).is_none_or(|known| known == is_set)
}

/// Assumes the value of a bit of a register.
fn assume_bit(state: &mut State, r: u8, bit: u8, is_set: bool, at: u32) -> bool {
    let (value, bits) = (state.get(r), state.bits[usize::from(r)]);
    let mask = 1u8 << bit;
    if is_set && bits.zeros & mask != 0 || !is_set && bits.ones & mask != 0 {
        return false;
    }
    state.name(r, at, 0);
    let value = Value { half: state.get(r).half, ..value };
    if is_set {
        return state.refine(value, mask, 255);
    }
    let above = u16::from(mask) * 2 - 1;
    if u16::from(value.hi) <= above { state.refine(value, 0, mask - 1) } else { true }
}

/// IJMP and ICALL: to a known address, or to one of a table of jumps.
fn indirect(program: &Program, state: State, instruction: Instruction) -> Result<Vec<Step>> {
    let (low, high) = (state.get(30), state.get(31));
    let is_call = instruction.op == Op::Icall;
    let cycles = instruction.op.cycles();
    let flow = |target: u32| {
        if is_call { Flow::Call(target, instruction.next()) } else { Flow::To(target) }
    };
    if let (Some(low), Some(high)) = (low.known(), high.known()) {
        let target = u32::from(u16::from_le_bytes([low, high])) * 2;
        return Ok(vec![done(state, flow(target), cycles)]);
    }
    if let Some(high) = high.known()
        && !is_call
        && low.hi - low.lo < MOST_ENTRIES
    {
        let targets = (low.lo..=low.hi).map(|low| u32::from(u16::from_le_bytes([low, high])) * 2);
        let is_table = targets.clone().all(|target| {
            program.instruction(target).is_ok_and(|entry| matches!(entry.op, Op::Rjmp(_)))
        });
        if is_table {
            return Ok(targets.map(|to| done(state.clone(), flow(to), cycles)).collect());
        }
    }
    let flow = if is_call { Flow::CallAnywhere(instruction.next()) } else { Flow::JumpAnywhere };
    Ok(vec![done(state, flow, cycles)])
}

/// Entries of a table of jumps, at most.
const MOST_ENTRIES: u8 = 200;

/// The instructions of a jump by a table of word addresses in flash, as `__tablejump2__` of libgcc
/// has them: Z is doubled, the address is loaded by LPM, and IJMP follows.
struct TableJump {
    /// The register that holds the low byte of the address meanwhile.
    scratch: u8,
    cycles: u32,
}

impl TableJump {
    /// The table jump that begins with the instruction.
    fn at(program: &Program, first: Instruction) -> Option<Self> {
        if first.op != Op::Two(Two::Add, 30, 30) {
            return None;
        }
        let mut this = Self { scratch: 0, cycles: first.op.cycles() };
        let mut at = first.next();
        for position in 0..5 {
            let instruction = program.instruction(at).ok()?;
            let is_expected = match (position, instruction.op) {
                (0, Op::Two(Two::Adc, 31, 31)) | (2, Op::Lpm(31, false)) | (4, Op::Ijmp) => true,
                (1, Op::Lpm(d, true)) => {
                    this.scratch = d;
                    d != 30 && d != 31
                }
                (3, Op::Two(Two::Mov, 30, r)) => r == this.scratch,
                _ => false,
            };
            if !is_expected {
                return None;
            }
            this.cycles += instruction.op.cycles();
            at = instruction.next();
        }
        Some(this)
    }
}

/// True if a table jump begins at the address. It belongs to the function that jumps to it, which
/// has bounded the index.
pub fn is_table_jump(program: &Program, at: u32) -> bool {
    program.instruction(at).is_ok_and(|first| TableJump::at(program, first).is_some())
}

/// The successors of a whole table jump. `state` is after its first instruction.
fn table_jump(program: &Program, state: &State, first: Instruction) -> Option<Vec<Step>> {
    let TableJump { scratch, cycles } = TableJump::at(program, first)?;
    // The doubled low byte, and the high byte that is not doubled yet.
    let (low, high, carry) = (state.get(30), state.get(31).known()?, state.flags.get(FLAG_C)?);
    let base = u32::from(high) * 512 + u32::from(carry) * 256;
    let (from, to) = (base + u32::from(low.lo), base + u32::from(low.hi));
    if to - from > 2 * u32::from(MOST_ENTRIES) {
        return None;
    }
    let mut steps = Vec::new();
    for entry in (from..=to).step_by(2) {
        let target = u32::from(program.word(entry)?) * 2;
        let mut state = state.clone();
        for r in [scratch, 30, 31] {
            state.set(r, Value::ANY);
        }
        state.flags.forget();
        steps.push(done(state, Flow::To(target), cycles));
    }
    Some(steps)
}

/// The successors of a call of a table jump, as the call of the constructors of C++ has it: calls
/// of the functions in the table.
fn called_table(
    program: &Program,
    handlers: &Interference,
    state: &State,
    call: Instruction,
    to: u32,
) -> Option<Vec<Step>> {
    let TableJump { scratch, cycles } = TableJump::at(program, program.instruction(to).ok()?)?;
    let Effect { registers, flags, .. } = handlers.effect(state);
    let (from, last) = wide::range(&[state.get(30), state.get(31)]);
    if registers != 0 || flags != 0 || last - from > u32::from(MOST_ENTRIES) {
        return None;
    }
    let mut steps = Vec::new();
    for entry in from..=last {
        let target = u32::from(program.word(entry * 2)?) * 2;
        let mut state = state.clone();
        for r in [scratch, 30, 31] {
            state.set(r, Value::ANY);
        }
        state.flags.forget();
        state.kept_flags = 0;
        let flow = Flow::Call(target, call.next());
        steps.push(done(state, flow, call.op.cycles() + cycles));
    }
    Some(steps)
}
