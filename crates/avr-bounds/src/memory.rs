//! Loads and stores: registers, local variables on the stack, constants in flash.

use anyhow::{Result, bail};

use crate::chip::{RAM_START, register};
use crate::enables::{ENABLE_BITS, Enables};
use crate::opcode::{FLAG_I, Mode, Op, Pointer};
use crate::program::Program;
use crate::state::{ALL_FLAGS, Interrupts, KnownBits, State};
use crate::value::{
    ENTRY_SP, Half, SREG_DISABLED, SREG_EITHER, SREG_ENABLED, SREG_KEPT, Value, pair,
};
use crate::wide;

/// What an instruction writes, besides the registers and the stack of the function.
#[derive(Debug, Clone, Default)]
pub struct Written {
    /// An index of the enable registers, and their bits that it may set.
    pub sets: Option<(usize, u8)>,
    /// An address in the RAM.
    pub ram: Option<u16>,
    /// True if the address is not known.
    pub is_anywhere: bool,
    /// A byte above the stack of the function: its offset from SP at the entry.
    pub above: Option<u16>,
    /// True for SPDR.
    pub is_spdr: bool,
    /// Cycles for which the core halts then.
    pub halt: u32,
}

/// The EEPROM's control register.
const EECR: u16 = 0x3F;
/// Cycles for which the core halts behind an instruction that sets EERE (ATmega48/88/168 datasheet
/// 2545, 8.4.1).
const HALT_OF_READ: u32 = 4;
/// The same of EEPE.
const HALT_OF_WRITE: u32 = 2;

/// Replaces the cycles since a write of SPDR during the instruction that writes it: the time counts
/// from its end.
pub const JUST_WRITTEN: u8 = u8::MAX;

/// Does a load or a store.
///
/// # Errors
/// If the analysis cannot follow what a store does.
pub fn access(
    program: &Program,
    state: &mut State,
    op: Op,
    at: u32,
    written: &mut Written,
) -> Result<()> {
    match op {
        Op::Lds(d, address) => read_register(state, d, address),
        Op::Sts(address, r) => write(program, state, address, r, written)?,
        Op::Load(d, pointer, mode) => {
            let displacement = before(state, pointer, mode, at);
            load(state, d, pointer, displacement);
            after(state, pointer, mode, at);
        }
        Op::Store(r, pointer, mode) => {
            let displacement = before(state, pointer, mode, at);
            store(program, state, (r, pointer, displacement), written)?;
            after(state, pointer, mode, at);
        }
        Op::Lpm(d, increments) => {
            let value = constant(program, state);
            if increments {
                wide::add(state, 30, 1, at);
            }
            state.set(d, value);
        }
        Op::LpmR0 => {
            let value = constant(program, state);
            state.set(0, value);
        }
        _ => {}
    }
    Ok(())
}

/// Decrements the pointer if the mode does; returns the displacement.
fn before(state: &mut State, pointer: Pointer, mode: Mode, at: u32) -> u16 {
    match mode {
        Mode::Displaced(q) => return q.into(),
        Mode::PreDecrement => wide::add(state, pointer.low(), 0xFFFF, at),
        Mode::PostIncrement => {}
    }
    0
}

fn after(state: &mut State, pointer: Pointer, mode: Mode, at: u32) {
    if mode == Mode::PostIncrement {
        wide::add(state, pointer.low(), 1, at);
    }
}

/// The address in a pointer, if it is known.
fn address(state: &State, pointer: Pointer) -> Option<u16> {
    let low = pointer.low();
    Some(u16::from_le_bytes([state.get(low).known()?, state.get(low + 1).known()?]))
}

fn load(state: &mut State, d: u8, pointer: Pointer, displacement: u16) {
    let (low, high) = (state.get(pointer.low()), state.get(pointer.low() + 1));
    if let Some(address) = address(state, pointer) {
        return read_register(state, d, address.wrapping_add(displacement));
    }
    let mut value = Value::ANY;
    if let Some(offset) = stack_offset(low, high)
        && let Some(slot) = state.slot(offset.wrapping_add(displacement))
        && !slot.is_pushed
    {
        value = slot.value;
    }
    state.set(d, value);
}

fn store(
    program: &Program,
    state: &mut State,
    (r, pointer, displacement): (u8, Pointer, u16),
    written: &mut Written,
) -> Result<()> {
    let (low, high) = (state.get(pointer.low()), state.get(pointer.low() + 1));
    if let Some(address) = address(state, pointer) {
        let address = address.wrapping_add(displacement);
        if address >= RAM_START {
            state.forget_locals();
        }
        return write(program, state, address, r, written);
    }
    let Some(offset) = stack_offset(low, high) else {
        let (from, to) = wide::range(&[low, high]);
        let (from, to) = (from + u32::from(displacement), to + u32::from(displacement));
        if to < RAM_START.into() {
            let is_followed = |address: u32| is_followed(address as u16);
            if (from..=to).all(is_followed) {
                bail!(
                    "a store to one of the registers from {from:#x} to {to:#x}, which enable \
                     interrupts or belong to the core: use a fixed address"
                );
            }
            written.is_anywhere = (from..=to).any(is_followed);
            return Ok(());
        }
        // A store through a pointer never changes a return address or a saved register: the
        // program is assumed to keep within its variables.
        state.forget_locals();
        written.is_anywhere = true;
        return Ok(());
    };
    let offset = offset.wrapping_add(displacement);
    match offset {
        1 | 2 => bail!("a store overwrites the return address"),
        3..0x8000 => written.above = Some(offset),
        _ => {}
    }
    let value = state.get(r);
    if let Some(slot) = state.slot(offset) {
        (slot.value, slot.is_pushed) = (value, false);
    }
    Ok(())
}

/// Reads a register or a byte of RAM at a fixed address.
pub fn read_register(state: &mut State, d: u8, address: u16) {
    match address {
        0..0x20 => {
            let value = state.get(address as u8);
            state.set(d, value);
        }
        register::SPL | register::SPH => {
            let value = sp_half(state, address == register::SPH);
            state.set(d, value);
        }
        register::SREG => {
            let id = match state.interrupts {
                Interrupts::Disabled => SREG_DISABLED,
                Interrupts::Enabled => SREG_ENABLED,
                Interrupts::Either => SREG_EITHER,
            };
            let id = if state.kept_flags == ALL_FLAGS { id + SREG_KEPT } else { id };
            state.set(d, Value::symbol(Half::low(id, 0)));
        }
        _ => {
            state.set(d, Value::ANY);
            let bits = &mut state.bits[usize::from(d)];
            if let Some((zeros, ones)) = state.enables.read(address) {
                let same = Enables::index(address).map_or(0, |index| state.kept[index]);
                *bits = KnownBits { zeros, ones, same, of: address };
            } else if address == register::MCUCR {
                *bits = KnownBits { same: u8::MAX, of: address, ..KnownBits::NONE };
            }
        }
    }
}

/// Writes SREG: a value that was read from it, or one whose I flag is known.
pub fn write_sreg(state: &mut State, value: Value) {
    state.flags.forget();
    state.flags.set(crate::opcode::FLAG_T, None);
    let id = value.half.filter(|half| half.offset == 0 && !half.is_high).map(|half| half.id);
    let is_kept = id.is_some_and(|id| id > SREG_KEPT && id <= SREG_KEPT + SREG_EITHER);
    state.kept_flags = if is_kept { ALL_FLAGS } else { 0 };
    state.interrupts = match id.map(|id| if is_kept { id - SREG_KEPT } else { id }) {
        Some(SREG_DISABLED) => Interrupts::Disabled,
        Some(SREG_ENABLED) => Interrupts::Enabled,
        _ if value.hi < 1 << FLAG_I => Interrupts::Disabled,
        _ if value.lo >= 1 << FLAG_I => Interrupts::Enabled,
        _ => Interrupts::Either,
    };
}

/// The byte of flash at Z.
fn constant(program: &Program, state: &State) -> Value {
    let (low, high) = (state.get(30), state.get(31));
    let Some(high) = high.known() else { return Value::ANY };
    let base = u32::from(high) * 256;
    let mut joined: Option<Value> = None;
    for low in low.lo..=low.hi {
        let Some(byte) = program.byte(base + u32::from(low)) else { return Value::ANY };
        let value = Value::of(byte);
        joined = Some(joined.map_or(value, |known| known.join(value)));
    }
    joined.unwrap_or(Value::ANY)
}

/// Sets or clears a bit of an I/O register.
pub fn write_bit(state: &mut State, io: u8, bit: u8, is_set: bool, written: &mut Written) {
    let register = u16::from(io) + 0x20;
    let was_set = state.enables.get(register, bit) == Some(true);
    state.enables.set(register, bit, is_set);
    if let Some(index) = Enables::index(register) {
        state.kept[index] &= !(1 << bit);
        if is_set && !was_set {
            written.sets = Some((index, 1 << bit & ENABLE_BITS[index]));
        }
    }
    if register == EECR && is_set {
        written.halt = match bit {
            0 => HALT_OF_READ,
            1 => HALT_OF_WRITE,
            _ => 0,
        };
    }
}

/// Writes a register in the data space that the analysis follows, or another.
///
/// # Errors
/// If the analysis cannot follow what that does.
pub fn write(
    program: &Program,
    state: &mut State,
    register: u16,
    r: u8,
    written: &mut Written,
) -> Result<()> {
    let value = state.get(r);
    match register {
        // A register of the core.
        0..0x20 => {
            let bits = state.bits[usize::from(r)];
            state.set(register as u8, value);
            state.bits[usize::from(register)] = bits;
        }
        register::SPL | register::SPH => {
            let may_be_absolute =
                state.is_start && (state.stack.is_empty() || state.base.is_some());
            state.write_sp(register == register::SPH, value, may_be_absolute)?;
            if let Some(base) = state.base
                && base > program.chip.ram_end()
                && state.half_sp.is_none()
            {
                bail!("SP is set to {base:#x}, behind the RAM");
            }
        }
        register::SREG => write_sreg(state, value),
        register::SPDR => {
            state.since_spdr = JUST_WRITTEN;
            written.is_spdr = true;
        }
        register::MCUCR => {
            let KnownBits { zeros, same, of, .. } = state.bits[usize::from(r)];
            let same = if of == register::MCUCR { same } else { 0 };
            if (zeros | same) & IVSEL == 0 {
                bail!("may set IVSEL in MCUCR: the table of vectors is elsewhere then");
            }
        }
        RAM_START.. => written.ram = Some(register),
        _ => {
            let KnownBits { zeros, ones, same, of } = state.bits[usize::from(r)];
            if register == EECR {
                written.halt = HALT_OF_READ;
            }
            let Some(index) = Enables::index(register) else { return Ok(()) };
            let same = if of == register { same } else { 0 };
            let may_set = ENABLE_BITS[index] & !zeros & !same & !state.enables.ones[index];
            written.sets = Some((index, may_set));
            state.enables.write(register, zeros, ones);
            state.kept[index] = same;
        }
    }
    Ok(())
}

/// True for a register in the data space that the analysis follows.
pub fn is_followed(register: u16) -> bool {
    use register::{MCUCR, SPDR, SPH, SPL, SREG};
    matches!(register, 0..0x20 | EECR | MCUCR | SPDR | SPH | SPL | SREG)
        || Enables::index(register).is_some()
}

/// The bit of MCUCR that moves the table of vectors to the boot section.
const IVSEL: u8 = 1 << 1;

/// The stack pointer plus an offset that a pair of registers holds.
pub fn stack_offset(low: Value, high: Value) -> Option<u16> {
    match pair(low, high) {
        Some((ENTRY_SP, offset)) => Some(offset),
        _ => None,
    }
}

/// SP, as IN reads a half of it.
pub fn sp_half(state: &State, is_high: bool) -> Value {
    if state.half_sp.is_some() {
        return Value::ANY;
    }
    let offset = (state.height() as u16).wrapping_neg();
    Value::symbol(if is_high { Half::high(ENTRY_SP, offset) } else { Half::low(ENTRY_SP, offset) })
}
