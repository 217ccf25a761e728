//! The own engine: `avr-core` executes the instructions. Interrupts, ports, ADC and watchdog are
//! here.
//!
//! [`Own`] has the memories and the time. During a run the core is borrowed. A model that the
//! program calls then uses the I/O registers, which are beside the core, and gets the time and the
//! program counter from the copies that the bus sets (`machine/on_own.rs`).

mod adc;
mod interrupts;
mod ports;
mod watchdog;

use std::cell::{Cell, RefCell};
use std::ops::Range;

use avr_core::{Bus, InvalidOpcode, Stop};

use super::chip::Chip;
use super::engine::{Activity, Timer};
use super::regs;
use adc::Conversion;
use interrupts::Requests;
use sim_base::Cycles;

/// A time that never comes.
const NEVER: Cycles = Cycles::MAX;
/// End of the addresses of I/O registers.
const IO_END: usize = regs::RAMSTART as usize;
/// Addresses of SPL, SPH and SREG, which the core has itself.
const OF_CORE: std::ops::RangeInclusive<u16> = regs::SPL..=regs::SREG;

/// The registers that are not 0 after a reset and have no model that sets them.
const AFTER_RESET: [(u16, u8); 4] =
    [(regs::UCSR0C, 0x06), (regs::TWSR, 0xF8), (regs::TWAR, 0xFE), (regs::TWDR, 0xFF)];

/// A chip with the own core.
pub(super) struct Own {
    chip: Chip,
    core: RefCell<avr_core::Core>,
    /// The I/O registers, by their address.
    io: [Cell<u8>; IO_END],
    /// A copy of the core's flash, for reads during a run.
    flash: Box<[Cell<u8>]>,
    now: Cell<Cycles>,
    pc: Cell<u32>,
    reset_pc: Cell<u32>,
    /// Expiry times, by timer.
    events: [Cell<Cycles>; Timer::COUNT],
    /// The earliest of them, or an earlier time.
    next: Cell<Cycles>,
    /// Time at which the run in progress ends.
    end_of_run: Cell<Cycles>,
    /// True if the run in progress must end after the present instruction.
    must_stop: Cell<bool>,
    runs_singly: Cell<bool>,
    has_crashed: Cell<bool>,
    requests: Requests,
    /// True if no enabled interrupt is requested, and no register has changed since that was known.
    has_none_pending: Cell<bool>,
    conversion: Conversion,
    watchdog: watchdog::Watchdog,
}

impl Own {
    /// A chip with erased flash, all supplies at 5 V.
    pub fn new(chip: Chip) -> Own {
        let core = avr_core::Core::new(match chip {
            Chip::Atmega168 => avr_core::Chip::ATmega168,
            Chip::Atmega328p => avr_core::Chip::ATmega328P,
        });
        Own {
            chip,
            flash: core.flash().iter().copied().map(Cell::new).collect(),
            core: RefCell::new(core),
            io: std::array::from_fn(|_| Cell::new(0)),
            now: Cell::new(0),
            pc: Cell::new(0),
            reset_pc: Cell::new(0),
            events: std::array::from_fn(|_| Cell::new(NEVER)),
            next: Cell::new(NEVER),
            end_of_run: Cell::new(0),
            must_stop: Cell::new(false),
            runs_singly: Cell::new(false),
            has_crashed: Cell::new(false),
            requests: Requests::default(),
            has_none_pending: Cell::new(false),
            conversion: Conversion::default(),
            watchdog: watchdog::Watchdog::default(),
        }
    }

    /// The type of the chip.
    pub fn chip(&self) -> Chip {
        self.chip
    }

    /// The time. Resets do not change it.
    #[inline]
    pub fn cycle(&self) -> Cycles {
        self.now.get()
    }

    /// Sets the time.
    pub fn set_cycle(&self, cycle: Cycles) {
        self.now.set(cycle);
    }

    /// One byte of the data space.
    #[inline]
    pub fn get(&self, address: u16) -> u8 {
        match self.io.get(usize::from(address)) {
            Some(register) if address >= regs::IO_FIRST && !OF_CORE.contains(&address) => {
                register.get()
            }
            _ => self.get_of_core(address),
        }
    }

    fn get_of_core(&self, address: u16) -> u8 {
        let core = self.core.borrow();
        match address {
            ..regs::IO_FIRST => core.registers[usize::from(address)],
            regs::SPL => core.sp.to_le_bytes()[0],
            regs::SPH => core.sp.to_le_bytes()[1],
            regs::SREG => core.sreg,
            _ => core.ram()[usize::from(address - regs::RAMSTART)],
        }
    }

    /// Sets one byte of the data space.
    #[inline]
    pub fn set(&self, address: u16, value: u8) {
        match self.io.get(usize::from(address)) {
            Some(register) if address >= regs::IO_FIRST && !OF_CORE.contains(&address) => {
                register.set(value);
                self.has_none_pending.set(false);
            }
            _ => self.set_of_core(address, value),
        }
    }

    fn set_of_core(&self, address: u16, value: u8) {
        let mut core = self.core.borrow_mut();
        let [low, high] = core.sp.to_le_bytes();
        match address {
            ..regs::IO_FIRST => core.registers[usize::from(address)] = value,
            regs::SPL => core.sp = u16::from_le_bytes([value, high]),
            regs::SPH => core.sp = u16::from_le_bytes([low, value]),
            regs::SREG => core.sreg = value,
            _ => core.ram_mut()[usize::from(address - regs::RAMSTART)] = value,
        }
    }

    /// A range of the flash.
    pub fn flash(&self, range: Range<usize>) -> Vec<u8> {
        self.flash[range].iter().map(Cell::get).collect()
    }

    /// Copies bytes into flash.
    pub fn write_flash(&self, address: usize, bytes: &[u8]) {
        let end = self.flash.len();
        assert!(address + bytes.len() <= end, "flash ends at {end:#x}");
        self.flash[address..].iter().zip(bytes).for_each(|(cell, byte)| cell.set(*byte));
        self.core.borrow_mut().write_flash(address, bytes);
    }

    /// The word of flash at a byte address, or 0 beyond the end of the flash.
    #[inline]
    pub fn word(&self, address: u32) -> u16 {
        let byte = |at| self.flash.get(at as usize).map(Cell::get);
        match (byte(address), byte(address + 1)) {
            (Some(low), Some(high)) => u16::from_le_bytes([low, high]),
            _ => 0,
        }
    }

    /// Program counter as a byte address.
    #[inline]
    pub fn pc(&self) -> u32 {
        self.pc.get()
    }

    /// Sets the program counter, a byte address.
    pub fn set_pc(&self, address: u32) {
        let mut core = self.core.borrow_mut();
        core.set_pc(address);
        self.pc.set(core.pc());
    }

    /// Goes to the word after the one at a byte address, in a cycle; behind the last word of the
    /// flash the program has crashed.
    pub fn pass_word(&self, address: u32) {
        if address as usize + 2 >= self.flash.len() {
            self.set_activity(Activity::Crashed);
            return;
        }
        self.set_pc(address + 2);
        self.now.set(self.now.get() + 1);
    }

    /// Status register.
    pub fn sreg(&self) -> u8 {
        self.core.borrow().sreg
    }

    /// Sets the status register.
    pub fn set_sreg(&self, value: u8) {
        self.core.borrow_mut().sreg = value;
    }

    /// Sets the byte address at which the program starts after a reset.
    pub fn set_reset_pc(&self, address: u32) {
        self.reset_pc.set(address);
    }

    /// True if the I flag of SREG is set.
    pub fn interrupts_enabled(&self) -> bool {
        self.sreg() & 0x80 != 0
    }

    /// State of the core.
    pub fn activity(&self) -> Activity {
        if self.has_crashed.get() {
            Activity::Crashed
        } else if self.core.borrow().is_asleep() {
            Activity::Sleeping
        } else {
            Activity::Running
        }
    }

    /// Stops the program for good if `activity` is `Crashed`. The core has the other states itself.
    pub fn set_activity(&self, activity: Activity) {
        self.has_crashed.set(activity == Activity::Crashed);
    }

    /// Lets [`Own::run`] run one instruction only.
    pub fn run_singly(&self) {
        self.runs_singly.set(true);
        self.must_stop.set(true);
    }

    /// Lets [`Own::run`] run to the next timer.
    #[inline]
    pub fn run_freely(&self) {
        self.runs_singly.set(false);
    }

    /// Sets the expiry time of a timer, in place of an earlier one.
    pub fn schedule(&self, timer: Timer, at: Cycles) {
        self.events[timer as usize].set(at);
        if at < self.next.get() {
            self.next.set(at);
        }
        if at < self.end_of_run.get() {
            self.must_stop.set(true);
        }
    }

    /// Cancels a timer.
    pub fn unschedule(&self, timer: Timer) {
        self.events[timer as usize].set(NEVER);
    }

    /// Removes and returns the earliest timer that is due, and its time.
    #[inline]
    pub fn take_due(&self) -> Option<(Timer, Cycles)> {
        if self.next.get() > self.now.get() { None } else { self.take_next() }
    }

    fn take_next(&self) -> Option<(Timer, Cycles)> {
        let (mut first, mut second) = ((Timer::Spi, NEVER), NEVER);
        for (timer, at) in Timer::ALL.into_iter().zip(&self.events) {
            if at.get() < first.1 {
                second = first.1;
                first = (timer, at.get());
            } else {
                second = second.min(at.get());
            }
        }
        let is_due = first.1 <= self.now.get();
        self.next.set(if is_due { second } else { first.1 });
        is_due.then(|| {
            self.unschedule(first.0);
            first
        })
    }

    /// Advances the time to the next timer, at most to `until`, while the CPU stands.
    pub fn skip(&self, until: Cycles) {
        self.now.set(self.next.get().min(until).max(self.now.get()));
    }

    /// Runs the program to the next timer, at most to `until`, or one instruction. Time stands if
    /// the chip sleeps.
    ///
    /// # Errors
    /// The program reached an opcode that the chip does not have.
    #[inline]
    pub fn run<B: Bus>(&self, bus: &mut B, until: Cycles) -> Result<Stop, InvalidOpcode> {
        let mut core = self.core.borrow_mut();
        let now = self.now.get();
        let end = if self.runs_singly.get() { now + 1 } else { self.next.get().min(until) };
        self.end_of_run.set(end);
        self.must_stop.set(false);
        core.clock.now = now;
        let result = core.run(bus, end);
        self.now.set(core.clock.now);
        self.pc.set(core.pc());
        self.end_of_run.set(0);
        result
    }

    /// Lets a pending interrupt come after the next instruction only: the board has requested it
    /// between two runs, and a pin's level passes a synchroniser (section 14.2.4). simavr does so,
    /// too.
    #[inline]
    pub fn delay_interrupts(&self) {
        if self.has_pending() {
            let mut core = self.core.borrow_mut();
            if !core.is_asleep() {
                core.hold_interrupts();
            }
        }
    }

    /// The stack pointer below which the core calls the bus.
    pub fn stack_mark(&self) -> u16 {
        self.core.borrow().stack_mark()
    }

    /// Sets it.
    pub fn set_stack_mark(&self, sp: u16) {
        self.core.borrow_mut().set_stack_mark(sp);
    }

    /// Enters the pending interrupt, if there is one, after a run.
    pub fn enter_interrupt<B: Bus>(&self, bus: &mut B) {
        let mut core = self.core.borrow_mut();
        core.clock.now = self.now.get();
        core.enter_pending_interrupt(bus);
        self.now.set(core.clock.now);
        self.pc.set(core.pc());
    }

    /// True if [`Own::run`] runs one instruction only.
    #[inline]
    pub fn runs_singly(&self) -> bool {
        self.runs_singly.get()
    }

    /// True if the run must end after the present instruction.
    #[inline]
    pub fn must_stop(&self) -> bool {
        self.must_stop.get()
    }

    /// Sets the copies of time and program counter, in the middle of an instruction.
    #[inline]
    pub fn set_moment(&self, now: Cycles, pc: u32) {
        self.now.set(now);
        self.pc.set(pc);
    }

    /// Resets the registers, cancels all timers, and starts the program again. Keeps the flags in
    /// MCUSR.
    pub fn reset(&self) {
        let flags = self.get(regs::MCUSR);
        self.io.iter().for_each(|register| register.set(0));
        self.set(regs::MCUSR, flags);
        AFTER_RESET.iter().for_each(|(address, value)| self.set(*address, *value));
        self.events.iter().for_each(|event| event.set(NEVER));
        self.next.set(NEVER);
        self.requests.reset();
        self.conversion.reset();
        self.has_crashed.set(false);
        self.core.borrow_mut().reset(self.reset_pc.get());
        self.pc.set(self.core.borrow().pc());
        self.reset_watchdog_register();
    }

    /// Reads a register that no model has, for the program.
    #[inline]
    pub fn load(&self, address: u16) -> u8 {
        self.note_read_of_result(address);
        self.get(address)
    }

    /// Writes a register that no model has, or whose model hands the write on.
    pub fn store(&self, address: u16, value: u8) {
        match address {
            regs::PINB..=regs::PORTD => self.write_port(address, value),
            regs::PCIFR => self.clear_pin_change_flags(value),
            regs::WDTCSR => self.write_watchdog(value),
            regs::ADCSRA => self.write_adc_control(value),
            _ => self.set(address, value),
        }
    }
}
