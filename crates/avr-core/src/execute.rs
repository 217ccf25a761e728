//! Execution: interrupts between runs of instructions, and the instructions.
//!
//! The inner loop has one condition, the deadline. Whatever else ends it (an invalid opcode, I that
//! is set, sleep, a call for attention) sets the deadline to 0.

use crate::bus::{Bus, Clock, Spm};
use crate::flags::{Flags, I, T};
use crate::table::{Entry, Op};
use crate::{Core, DATA_BYTES, InvalidOpcode, RAM_START, Stop, TABLE};

/// Data addresses of the registers that the core has itself.
const SPL: u16 = 0x5D;
const SPH: u16 = 0x5E;
const SREG: u16 = 0x5F;
/// First I/O address.
const IO_START: u16 = 0x20;

/// Low registers of the pointers.
const X: u8 = 26;
const Y: u8 = 28;
const POINTER_Z: u8 = 30;

/// > The interrupt execution response for all the enabled AVR interrupts is four clock cycles
/// > minimum. (DS40002061B, 7.7.1)
const ENTRY_CYCLES: u64 = 4;
/// > If an interrupt occurs when the MCU is in sleep mode, the interrupt execution response time
/// > is increased by four clock cycles. (7.7.1)
const WAKE_CYCLES: u64 = 4;
/// Cycles of a run that [`Run::left`] can count.
const LONGEST_RUN: u64 = 1 << 62;
/// Words of a vector.
const VECTOR_WORDS: u16 = 2;

impl Core {
    /// Runs the program until `clock.now` is at least `until`, or until another [`Stop`].
    ///
    /// # Errors
    /// The program reached an opcode that the chip does not have.
    pub fn run<B: Bus>(&mut self, bus: &mut B, until: u64) -> Result<Stop, InvalidOpcode> {
        self.clock.attention = false;
        while self.clock.now < until {
            if self.clock.attention {
                return Ok(Stop::Attention);
            }
            let one_first = core::mem::take(&mut self.holds_interrupts);
            if !one_first && self.sreg & I != 0 && self.enter_interrupt(bus) {
                continue;
            }
            if self.is_asleep {
                return Ok(Stop::Asleep);
            }
            let longest = if one_first { 1 } else { LONGEST_RUN };
            self.clock.deadline = until.min(self.clock.now.saturating_add(longest));
            let mut run = Run::new(self, bus);
            let result = run.execute();
            run.keep();
            result?;
        }
        Ok(if self.clock.attention { Stop::Attention } else { Stop::Deadline })
    }

    /// Executes one instruction or enters an interrupt.
    ///
    /// # Errors
    /// As [`Core::run`].
    pub fn step<B: Bus>(&mut self, bus: &mut B) -> Result<Stop, InvalidOpcode> {
        self.run(bus, self.clock.now + 1)
    }

    /// Enters the pending interrupt, if I is set and no instruction must come first. A debugger
    /// that runs the core with [`Core::step`] calls this after each step.
    pub fn enter_pending_interrupt<B: Bus>(&mut self, bus: &mut B) {
        if !self.holds_interrupts && self.sreg & I != 0 {
            self.enter_interrupt(bus);
        }
    }

    /// Enters the pending interrupt; false if there is none.
    fn enter_interrupt<B: Bus>(&mut self, bus: &mut B) -> bool {
        let Some(vector) = bus.take_interrupt(&mut self.clock) else { return false };
        if self.is_asleep {
            self.is_asleep = false;
            self.clock.now += WAKE_CYCLES;
        }
        let table = (bus.vector_table() / 2) as u16;
        let mut run = Run::new(self, bus);
        run.push_pc::<false>();
        run.check_stack::<false>();
        run.set_pc(table.wrapping_add(u16::from(vector) * VECTOR_WORDS));
        run.keep();
        self.sreg &= !I;
        self.clock.now += ENTRY_CYCLES;
        true
    }

    /// Tells the bus if the stack is below its mark, after what can lower it: not between the
    /// writes of SPH and SPL, when the stack pointer is neither the old nor the new one.
    fn check_stack<B: Bus>(&mut self, bus: &mut B) {
        if self.sp < self.mark {
            self.set_stack_mark(self.sp);
            bus.stack_below_mark(self.sp, self.is_sp_set_by_hand, &mut self.clock);
        }
    }

    #[inline(never)]
    fn load_outside_ram<B: Bus>(&mut self, bus: &mut B, address: u16) -> u8 {
        match address {
            ..IO_START => self.registers[usize::from(address)],
            SPL => self.sp.to_le_bytes()[0],
            SPH => self.sp.to_le_bytes()[1],
            _ => bus.read(address, &mut self.clock),
        }
    }

    #[inline(never)]
    fn store_outside_ram<B: Bus>(&mut self, bus: &mut B, address: u16, value: u8) {
        match address {
            ..IO_START => self.registers[usize::from(address)] = value,
            SPL => {
                self.sp = self.sp & 0xFF00 | u16::from(value);
                self.is_sp_set_by_hand = false;
                self.check_stack(bus);
            }
            SPH => {
                self.sp = self.sp & 0x00FF | u16::from(value) << 8;
                self.is_sp_set_by_hand = true;
            }
            _ => bus.write(address, value, &mut self.clock),
        }
    }

    #[inline(always)]
    fn is_ram(&self, address: u16) -> bool {
        address.wrapping_sub(RAM_START) < self.ram_bytes
    }

    /// True if so many bytes can be pushed in the SRAM without passing the mark.
    #[inline(always)]
    fn has_stack_for(&self, bytes: u16) -> bool {
        let above = self.sp.wrapping_sub(self.stack_floor);
        above < self.stack_room && above >= bytes - 1
    }

    /// Makes one instruction come before any interrupt.
    ///
    /// > The instruction following SEI will be executed before any pending interrupts.
    /// > (DS40002198, SEI; DS40002061B, 7.7, for RETI)
    pub fn hold_interrupts(&mut self) {
        self.holds_interrupts = true;
        self.clock.deadline = 0;
    }
}

/// A run of instructions. What most of them change is here and not in the core, so that the
/// compiler keeps it in the processor's registers; a call of the bus brings the core up to date.
struct Run<'a, B> {
    core: &'a mut Core,
    bus: &'a mut B,
    /// Program counter in words; it can be beyond the end of the flash, where it wraps.
    pc: u32,
    flags: Flags,
    /// As in the clock when the bus was called last.
    deadline: u64,
    /// Cycles to the deadline.
    left: i64,
}

impl<'a, B: Bus> Run<'a, B> {
    #[inline(always)]
    fn new(core: &'a mut Core, bus: &'a mut B) -> Self {
        let Clock { pc, now, deadline, .. } = core.clock;
        let flags = Flags::new(core.sreg);
        Run { core, bus, pc, flags, deadline, left: deadline.wrapping_sub(now) as i64 }
    }

    /// Brings the core's clock up to date.
    #[inline(always)]
    fn set_clock(&mut self) {
        self.core.clock.pc = self.pc & u32::from(self.core.pc_mask);
        self.core.clock.now = self.deadline.wrapping_sub(self.left as u64);
    }

    /// Brings the core up to date.
    #[inline(always)]
    fn keep(&mut self) {
        self.set_clock();
        self.core.sreg = self.flags.sreg();
    }

    /// Calls what uses the bus.
    #[inline(always)]
    fn outside<T>(&mut self, call: impl FnOnce(&mut Core, &mut B) -> T) -> T {
        self.set_clock();
        let result = call(self.core, self.bus);
        self.deadline = self.core.clock.deadline;
        self.left = self.deadline.wrapping_sub(self.core.clock.now) as i64;
        result
    }

    /// Ends the run after this instruction.
    #[inline(always)]
    fn end(&mut self) {
        self.left = self.left.wrapping_sub(self.deadline as i64);
        self.deadline = 0;
    }

    /// Sets the program counter, which wraps at the end of the flash.
    #[inline(always)]
    fn set_pc(&mut self, word: u16) {
        self.pc = u32::from(word & self.core.pc_mask);
    }

    /// Program counter in words, within the flash.
    #[inline(always)]
    fn pc_word(&self) -> u16 {
        self.pc as u16 & self.core.pc_mask
    }

    #[inline(always)]
    fn get(&self, register: u8) -> u8 {
        self.core.registers[usize::from(register & 31)]
    }

    #[inline(always)]
    fn set(&mut self, register: u8, value: u8) {
        self.core.registers[usize::from(register & 31)] = value;
    }

    #[inline(always)]
    fn pair(&self, low: u8) -> u16 {
        u16::from_le_bytes([self.get(low), self.get(low | 1)])
    }

    #[inline(always)]
    fn set_pair(&mut self, low: u8, value: u16) {
        let [first, second] = value.to_le_bytes();
        self.set(low, first);
        self.set(low | 1, second);
    }

    /// Reads the data space.
    #[inline(always)]
    fn load<const INSIDE: bool>(&mut self, address: u16) -> u8 {
        if INSIDE || self.core.is_ram(address) {
            return self.core.data[usize::from(address) % DATA_BYTES];
        }
        self.load_outside_ram(address)
    }

    #[inline(always)]
    fn load_outside_ram(&mut self, address: u16) -> u8 {
        if address == SREG {
            return self.flags.sreg();
        }
        self.outside(|core, bus| core.load_outside_ram(bus, address))
    }

    /// Writes the data space.
    #[inline(always)]
    fn store<const INSIDE: bool>(&mut self, address: u16, value: u8) {
        if INSIDE || self.core.is_ram(address) {
            self.core.data[usize::from(address) % DATA_BYTES] = value;
        } else {
            self.store_outside_ram(address, value);
        }
    }

    #[inline(always)]
    fn store_outside_ram(&mut self, address: u16, value: u8) {
        if address == SREG {
            self.set_sreg(value);
            self.outside(|core, bus| bus.status_written(&mut core.clock));
        } else {
            self.outside(|core, bus| core.store_outside_ram(bus, address, value));
        }
    }

    /// A program writes SREG. If I becomes 1, one instruction comes before interrupts.
    #[inline(always)]
    fn set_sreg(&mut self, value: u8) {
        let holds = value & !self.flags.kept & I != 0;
        self.flags = Flags::new(value);
        if holds {
            self.hold_interrupts();
        }
    }

    /// Makes one instruction come before any interrupt.
    #[inline(always)]
    fn hold_interrupts(&mut self) {
        self.core.hold_interrupts();
        self.end();
    }

    #[inline(always)]
    fn push<const INSIDE: bool>(&mut self, value: u8) {
        self.store::<INSIDE>(self.core.sp, value);
        self.core.sp = self.core.sp.wrapping_sub(1);
    }

    /// Checks the stack after a push; inside, it is known to be above the mark.
    #[inline(always)]
    fn check_stack<const INSIDE: bool>(&mut self) {
        if !INSIDE && self.core.sp < self.core.mark {
            self.outside(Core::check_stack);
        }
    }

    #[inline(always)]
    fn pop<const INSIDE: bool>(&mut self) -> u8 {
        self.core.sp = self.core.sp.wrapping_add(1);
        self.load::<INSIDE>(self.core.sp)
    }

    /// Pushes a return address, the low byte first.
    #[inline(always)]
    fn push_pc<const INSIDE: bool>(&mut self) {
        let [low, high] = self.pc_word().to_le_bytes();
        self.push::<INSIDE>(low);
        self.push::<INSIDE>(high);
    }

    #[inline(always)]
    fn pop_pc<const INSIDE: bool>(&mut self) {
        let high = self.pop::<INSIDE>();
        let low = self.pop::<INSIDE>();
        self.set_pc(u16::from_le_bytes([low, high]));
    }

    /// Jumps by a distance in words from the next instruction.
    #[inline(always)]
    fn jump_by(&mut self, words: u16) {
        self.set_pc((self.pc as u16).wrapping_add(words));
    }

    /// Skips the next instruction: one cycle for each of its words.
    #[inline(always)]
    fn skip_if(&mut self, condition: bool) {
        if condition {
            let entry = self.core.table[self.pc as usize % TABLE];
            let words = if entry.has_second_word() { 2 } else { 1 };
            self.pc = self.pc.wrapping_add(words);
            self.left = self.left.wrapping_sub(words.into());
        }
    }

    /// Jumps, and returns the cycle that this takes, if the condition holds.
    #[inline(always)]
    fn branch_if(&mut self, condition: bool, words: u16) -> i64 {
        if !condition {
            return 0;
        }
        self.jump_by(words);
        1
    }

    #[inline(always)]
    fn set_product(&mut self, product: u16) {
        self.flags.product(product, product);
        self.set_pair(0, product);
    }

    #[inline(always)]
    fn set_fraction(&mut self, product: u16) {
        self.flags.product(product, product << 1);
        self.set_pair(0, product << 1);
    }

    /// Executes instructions until the deadline.
    #[inline(always)]
    fn execute(&mut self) -> Result<(), InvalidOpcode> {
        while self.left > 0 {
            self.execute_inside();
            if self.left > 0 {
                self.execute_outside()?;
            }
        }
        Ok(())
    }

    /// Executes instructions up to the deadline or one that uses the bus. Nothing is called here,
    /// so that the compiler has all registers of the processor for it.
    #[inline(always)]
    fn execute_inside(&mut self) {
        let Run { pc, flags, deadline, left, .. } = *self;
        let mut run = Run { core: self.core, bus: self.bus, pc, flags, deadline, left };
        while run.left > 0 && run.execute_one::<true>() == Ok(true) {}
        let Run { pc, flags, deadline, left, .. } = run;
        (self.pc, self.flags, self.deadline, self.left) = (pc, flags, deadline, left);
    }

    /// Executes an instruction that may use the bus.
    #[inline(never)]
    fn execute_outside(&mut self) -> Result<(), InvalidOpcode> {
        self.execute_one::<false>().map(|_| ())
    }

    /// Executes an instruction. If it must stay `INSIDE` and would use the bus, it changes nothing
    /// and returns false. The cycles of an instruction count after it; each takes one, and its arm
    /// adds the others.
    #[inline(always)]
    fn execute_one<const INSIDE: bool>(&mut self) -> Result<bool, InvalidOpcode> {
        let at = self.pc;
        let Entry { op, a, b } = self.core.table[at as usize % TABLE];
        let r = b as u8;
        self.pc = self.pc.wrapping_add(1);
        let mut more = 0;
        // Leaves an instruction to the caller unless it has these addresses in the SRAM.
        macro_rules! need_ram {
            ($($address:expr),*) => {
                if INSIDE && !($(self.core.is_ram($address))&&*) {
                    self.pc = at;
                    return Ok(false);
                }
            };
        }
        // The same of an instruction that pushes so many bytes, unless they are above the mark.
        macro_rules! need_stack {
            ($bytes:expr) => {
                if INSIDE && !self.core.has_stack_for($bytes) {
                    self.pc = at;
                    return Ok(false);
                }
            };
        }
        match op {
            Op::Nop => {}
            Op::Movw => self.set_pair(a, self.pair(r)),
            Op::Mov => self.set(a, self.get(r)),
            Op::Ldi => self.set(a, r),
            Op::Add => {
                let value = self.flags.add(self.get(a), self.get(r), 0);
                self.set(a, value);
            }
            Op::Adc => {
                let value = self.flags.add(self.get(a), self.get(r), self.flags.carry());
                self.set(a, value);
            }
            Op::Sub => {
                let value = self.flags.subtract(self.get(a), self.get(r), 0);
                self.set(a, value);
            }
            Op::Subi => {
                let value = self.flags.subtract(self.get(a), r, 0);
                self.set(a, value);
            }
            Op::Sbc => {
                let value = self.flags.subtract_carry(self.get(a), self.get(r));
                self.set(a, value);
            }
            Op::Sbci => {
                let value = self.flags.subtract_carry(self.get(a), r);
                self.set(a, value);
            }
            Op::Cp => {
                self.flags.subtract(self.get(a), self.get(r), 0);
            }
            Op::Cpi => {
                self.flags.subtract(self.get(a), r, 0);
            }
            Op::Cpc => {
                self.flags.subtract_carry(self.get(a), self.get(r));
            }
            Op::Neg => {
                let value = self.flags.subtract(0, self.get(a), 0);
                self.set(a, value);
            }
            Op::And => self.set_logic(a, self.get(a) & self.get(r)),
            Op::Andi => self.set_logic(a, self.get(a) & r),
            Op::Or => self.set_logic(a, self.get(a) | self.get(r)),
            Op::Ori => self.set_logic(a, self.get(a) | r),
            Op::Eor => self.set_logic(a, self.get(a) ^ self.get(r)),
            Op::Com => {
                let value = !self.get(a);
                self.flags.complement(value);
                self.set(a, value);
            }
            Op::Inc => {
                let value = self.get(a).wrapping_add(1);
                self.flags.count(value, 0x80);
                self.set(a, value);
            }
            Op::Dec => {
                let value = self.get(a).wrapping_sub(1);
                self.flags.count(value, 0x7F);
                self.set(a, value);
            }
            Op::Swap => self.set(a, self.get(a).rotate_left(4)),
            Op::Asr => self.set_shifted(a, |value, _| value >> 1 | value & 0x80),
            Op::Lsr => self.set_shifted(a, |value, _| value >> 1),
            Op::Ror => self.set_shifted(a, |value, carry| value >> 1 | carry << 7),
            Op::Adiw => {
                let old = self.pair(a);
                let value = old.wrapping_add(b);
                self.flags.word(value, !old & value, !value & old);
                self.set_pair(a, value);
                more = 1;
            }
            Op::Sbiw => {
                let old = self.pair(a);
                let value = old.wrapping_sub(b);
                self.flags.word(value, !value & old, !old & value);
                self.set_pair(a, value);
                more = 1;
            }
            Op::Mul => {
                self.set_product(u16::from(self.get(a)) * u16::from(self.get(r)));
                more = 1;
            }
            Op::Muls => {
                self.set_product(signed(self.get(a), self.get(r)));
                more = 1;
            }
            Op::Mulsu => {
                self.set_product(signed_unsigned(self.get(a), self.get(r)));
                more = 1;
            }
            Op::Fmul => {
                self.set_fraction(u16::from(self.get(a)) * u16::from(self.get(r)));
                more = 1;
            }
            Op::Fmuls => {
                self.set_fraction(signed(self.get(a), self.get(r)));
                more = 1;
            }
            Op::Fmulsu => {
                self.set_fraction(signed_unsigned(self.get(a), self.get(r)));
                more = 1;
            }
            Op::Bset => self.flags = Flags::new(self.flags.sreg() | a),
            Op::Bclr => self.flags = Flags::new(self.flags.sreg() & !a),
            Op::Sei => self.set_sreg(self.flags.sreg() | I),
            Op::Cli => self.flags.kept &= !I,
            Op::Bst => {
                let others = self.flags.kept & !T;
                self.flags.kept = if self.get(a) & r != 0 { others | T } else { others };
            }
            Op::Bld => {
                let others = self.get(a) & !r;
                self.set(a, if self.flags.kept & T != 0 { others | r } else { others });
            }
            Op::Brcs => more = self.branch_if(self.flags.carry() != 0, b),
            Op::Brcc => more = self.branch_if(self.flags.carry() == 0, b),
            Op::Breq => more = self.branch_if(self.flags.is_zero(), b),
            Op::Brne => more = self.branch_if(!self.flags.is_zero(), b),
            Op::Brmi => more = self.branch_if(self.flags.is_negative(), b),
            Op::Brpl => more = self.branch_if(!self.flags.is_negative(), b),
            Op::Brbs => more = self.branch_if(self.flags.sreg() & a != 0, b),
            Op::Brbc => more = self.branch_if(self.flags.sreg() & a == 0, b),
            Op::Cpse => self.skip_if(self.get(a) == self.get(r)),
            Op::Sbrc => self.skip_if(self.get(a) & r == 0),
            Op::Sbrs => self.skip_if(self.get(a) & r != 0),
            Op::Rjmp => {
                self.jump_by(b);
                more = 1;
            }
            Op::Jmp => {
                self.set_pc(b);
                more = 2;
            }
            Op::Ijmp => {
                self.set_pc(self.pair(POINTER_Z));
                more = 1;
            }
            Op::Rcall => {
                need_stack!(2);
                self.push_pc::<INSIDE>();
                self.check_stack::<INSIDE>();
                self.jump_by(b);
                more = 2;
            }
            Op::Call => {
                need_stack!(2);
                self.pc = self.pc.wrapping_add(1);
                self.push_pc::<INSIDE>();
                self.check_stack::<INSIDE>();
                self.set_pc(b);
                more = 3;
            }
            Op::Icall => {
                need_stack!(2);
                self.push_pc::<INSIDE>();
                self.check_stack::<INSIDE>();
                self.set_pc(self.pair(POINTER_Z));
                more = 2;
            }
            Op::Ret => {
                need_ram!(self.core.sp.wrapping_add(1), self.core.sp.wrapping_add(2));
                self.pop_pc::<INSIDE>();
                more = 3;
            }
            Op::Reti => {
                need_ram!(self.core.sp.wrapping_add(1), self.core.sp.wrapping_add(2));
                self.pop_pc::<INSIDE>();
                self.flags.kept |= I;
                self.hold_interrupts();
                more = 3;
            }
            Op::Push => {
                need_stack!(1);
                self.push::<INSIDE>(self.get(a));
                self.check_stack::<INSIDE>();
                more = 1;
            }
            Op::Pop => {
                need_ram!(self.core.sp.wrapping_add(1));
                let value = self.pop::<INSIDE>();
                self.set(a, value);
                more = 1;
            }
            Op::Lds => {
                need_ram!(b);
                let value = self.load::<INSIDE>(b);
                self.set(a, value);
                self.pc = self.pc.wrapping_add(1);
                more = 1;
            }
            Op::Sts => {
                need_ram!(b);
                self.store::<INSIDE>(b, self.get(a));
                self.pc = self.pc.wrapping_add(1);
                more = 1;
            }
            Op::LoadX => {
                need_ram!(self.pair(X));
                self.load_at::<INSIDE>(a, self.pair(X));
                more = 1;
            }
            Op::LoadY => {
                need_ram!(self.pair(Y).wrapping_add(b));
                self.load_at::<INSIDE>(a, self.pair(Y).wrapping_add(b));
                more = 1;
            }
            Op::LoadZ => {
                need_ram!(self.pair(POINTER_Z).wrapping_add(b));
                self.load_at::<INSIDE>(a, self.pair(POINTER_Z).wrapping_add(b));
                more = 1;
            }
            Op::StoreX => {
                need_ram!(self.pair(X));
                self.store::<INSIDE>(self.pair(X), self.get(a));
                more = 1;
            }
            Op::StoreY => {
                need_ram!(self.pair(Y).wrapping_add(b));
                self.store::<INSIDE>(self.pair(Y).wrapping_add(b), self.get(a));
                more = 1;
            }
            Op::StoreZ => {
                need_ram!(self.pair(POINTER_Z).wrapping_add(b));
                self.store::<INSIDE>(self.pair(POINTER_Z).wrapping_add(b), self.get(a));
                more = 1;
            }
            Op::LoadIncrement => {
                need_ram!(self.pair(r));
                let address = self.pair(r);
                self.set_pair(r, address.wrapping_add(1));
                self.load_at::<INSIDE>(a, address);
                more = 1;
            }
            Op::LoadDecrement => {
                need_ram!(self.pair(r).wrapping_sub(1));
                let address = self.pair(r).wrapping_sub(1);
                self.set_pair(r, address);
                self.load_at::<INSIDE>(a, address);
                more = 1;
            }
            Op::StoreIncrement => {
                need_ram!(self.pair(r));
                let (address, value) = (self.pair(r), self.get(a));
                self.set_pair(r, address.wrapping_add(1));
                self.store::<INSIDE>(address, value);
                more = 1;
            }
            Op::StoreDecrement => {
                need_ram!(self.pair(r).wrapping_sub(1));
                let (address, value) = (self.pair(r).wrapping_sub(1), self.get(a));
                self.set_pair(r, address);
                self.store::<INSIDE>(address, value);
                more = 1;
            }
            // The others use the bus.
            Op::Invalid
            | Op::Sbic
            | Op::Sbis
            | Op::Sbi
            | Op::Cbi
            | Op::In
            | Op::Out
            | Op::Lpm
            | Op::LpmIncrement
            | Op::Spm
            | Op::Sleep
            | Op::Wdr
            | Op::Break
                if INSIDE =>
            {
                self.pc = at;
                return Ok(false);
            }
            Op::Invalid => {
                self.pc = at;
                let address = u32::from(self.pc_word()) * 2;
                let opcode = self.core.word(at as usize);
                return Err(InvalidOpcode { address, opcode });
            }
            Op::Sbic => {
                let value = self.load::<INSIDE>(b);
                self.skip_if(value & a == 0);
            }
            Op::Sbis => {
                let value = self.load::<INSIDE>(b);
                self.skip_if(value & a != 0);
            }
            Op::Sbi => {
                self.outside(|core, bus| bus.write_bit(b, a, true, &mut core.clock));
                more = 1;
            }
            Op::Cbi => {
                self.outside(|core, bus| bus.write_bit(b, a, false, &mut core.clock));
                more = 1;
            }
            Op::In => {
                let value = self.load_outside_ram(b);
                self.set(a, value);
            }
            Op::Out => self.store_outside_ram(b, self.get(a)),
            Op::Lpm => {
                self.load_program(a);
                more = 2;
            }
            Op::LpmIncrement => {
                let z = self.load_program(a);
                self.set_pair(POINTER_Z, z.wrapping_add(1));
                more = 2;
            }
            Op::Spm => {
                let (z, word) = (self.pair(POINTER_Z), self.pair(0));
                let spm = Spm { pc: (at & u32::from(self.core.pc_mask)) * 2, z, word };
                self.outside(|core, bus| bus.store_program_memory(spm, &mut core.clock));
            }
            Op::Sleep => {
                if self.outside(|core, bus| bus.sleep(&mut core.clock)) {
                    self.core.is_asleep = true;
                    self.end();
                }
            }
            Op::Wdr => self.outside(|core, bus| bus.reset_watchdog(&mut core.clock)),
            Op::Break => self.outside(|core, bus| bus.break_point(&mut core.clock)),
        }
        self.left = self.left.wrapping_sub(1 + more);
        Ok(true)
    }

    #[inline(always)]
    fn set_logic(&mut self, register: u8, value: u8) {
        self.flags.logic(value);
        self.set(register, value);
    }

    #[inline(always)]
    fn set_shifted(&mut self, register: u8, shifted: impl Fn(u8, u8) -> u8) {
        let old = self.get(register);
        let value = shifted(old, self.flags.carry() as u8);
        self.flags.shift(old, value);
        self.set(register, value);
    }

    #[inline(always)]
    fn load_at<const INSIDE: bool>(&mut self, register: u8, address: u16) {
        let value = self.load::<INSIDE>(address);
        self.set(register, value);
    }

    /// LPM; returns Z. The address wraps at the end of the flash.
    fn load_program(&mut self, register: u8) -> u16 {
        let z = self.pair(POINTER_Z);
        let stored = self.core.flash[usize::from(z) & (self.core.flash.len() - 1)];
        let value = self.outside(|core, bus| bus.load_program_memory(z, stored, &mut core.clock));
        self.set(register, value);
        z
    }
}

/// The bits of a product of two signed numbers.
#[inline(always)]
fn signed(a: u8, b: u8) -> u16 {
    (i16::from(a as i8) * i16::from(b as i8)) as u16
}

/// The bits of a product of a signed and an unsigned number, which always fits in 16 bits.
#[inline(always)]
fn signed_unsigned(a: u8, b: u8) -> u16 {
    (i16::from(a as i8) * i16::from(b)) as u16
}
