//! The machine on simavr: the run loop, and the functions that simavr calls in the middle of an
//! instruction.
//!
//! Each of them finds the machine by its context, and hands over. A panic must not unwind through
//! simavr's frames: `Simavr::guard` keeps it for the run loop.

use std::ffi::{c_int, c_void};
use std::rc::Rc;

use simavr_ffi as ffi;

use super::Machine;
use crate::adc::Adc;
use crate::base::Timer;
use crate::core::{Access, Activity};
use crate::processor::ResetCause;
use crate::regs;
use crate::simavr::{FLASH_LPM, FLASH_SPM, Simavr, Slot};
use crate::unmodelled;
use sim_base::Cycles;

/// Registers with SPM's and LPM's operands.
const R0: u16 = 0;
const R1: u16 = 1;
const ZL: u16 = 30;
const ZH: u16 = 31;

/// Makes simavr call the machine.
pub(super) fn hook(machine: &Rc<Machine>, simavr: &Simavr) {
    let context = Rc::as_ptr(machine).cast_mut().cast();
    simavr.set_context(context, on_beyond_ram);
    simavr.hook_timers(Some(on_timer));
    simavr.hook_reset(on_reset);
    simavr.hook_interrupts(Some(on_interrupt), Some(on_bad_opcode));
    simavr.hook_adc(Some(on_adc_sample));
    simavr.hook_watchdog(Some(on_watchdog));
    simavr.hook_flash(on_flash);
    simavr.hook_write(regs::MCUSR, Some(on_write));
    for pins in [regs::PINB, regs::PINC, regs::PIND] {
        simavr.hook_read(pins, Some(on_read));
    }
    for pins in [regs::PINB, regs::PIND] {
        simavr.unhook_bit_writes(pins);
    }
    simavr.hook_write(regs::SREG, Some(on_write));
    for address in unmodelled::WRITES {
        if machine.owner(*address).is_none() {
            simavr.hook_write(*address, Some(on_write));
        }
    }
    for address in unmodelled::READS {
        simavr.hook_read(*address, Some(on_read));
    }
    for peripheral in machine.peripherals.iter() {
        for address in peripheral.writes() {
            simavr.hook_write(*address, Some(on_write));
        }
        for address in peripheral.reads() {
            simavr.hook_read(*address, Some(on_read));
        }
    }
}

impl Machine {
    /// Runs the program and the peripherals until `until`, or until a debugger halts the chip.
    pub(super) fn run_simavr(&self, simavr: &Simavr, until: Cycles) {
        if self.base.now() >= until {
            return;
        }
        self.base.schedule(Timer::Stop, until);
        self.settle_stack(simavr);
        loop {
            simavr.run_freely();
            let cpu_waits = self.cpu_waits();
            if self.debug.is_watching()
                && (self.debug.is_halted() || !cpu_waits && self.debug.halts(&self.base.core))
            {
                return;
            }
            if !cpu_waits && simavr.activity() == Activity::Running {
                self.peripherals.nvm.spm.borrow().check_execution(&self.base);
            }
            self.keep_asleep(simavr);
            let asleep_for_good =
                simavr.activity() == Activity::Sleeping && !simavr.interrupts_enabled();
            if simavr.activity() == Activity::Running && !cpu_waits {
                if self.trace.is_on() {
                    self.trace.before_instruction(&self.base);
                }
                if simavr.stack_mark().is_some() {
                    let (pc, opcode) = (simavr.pc(), self.base.core.opcode());
                    simavr.run_singly();
                    simavr.run_one();
                    if simavr.can_lower_stack(opcode) {
                        self.check_stack(simavr, pc);
                    }
                } else {
                    simavr.run_one();
                }
                if simavr.activity() == Activity::Sleeping {
                    if self.falls_asleep() {
                        self.stop_clocks();
                    } else {
                        simavr.set_activity(Activity::Running);
                    }
                }
            }
            let mut idle = simavr.process_timers();
            if simavr.take_attention() {
                self.after_reset();
                if self.base.now() < until {
                    self.base.schedule(Timer::Stop, until);
                }
                idle = 0;
            } else if asleep_for_good && simavr.activity() == Activity::Running {
                // simavr wakes the core for an interrupt even if the I flag is 0; the chip does
                // not.
                simavr.set_activity(Activity::Sleeping);
            }
            if self.keep_asleep(simavr) {
                idle = simavr.process_timers();
            }
            match simavr.activity() {
                Activity::Running if !self.cpu_waits() => {
                    let pc = simavr.pc();
                    simavr.service_interrupts();
                    if simavr.pc() != pc {
                        self.check_stack(simavr, pc);
                    }
                }
                Activity::Running | Activity::Sleeping | Activity::Crashed => {
                    let rest = until.saturating_sub(self.base.now());
                    simavr.set_cycle(simavr.cycle() + idle.min(rest));
                    // Or the program would first run for as long again.
                    simavr.stop_soon();
                }
            }
            if self.base.now() >= until {
                return;
            }
        }
    }

    /// Tells a stack below the mark. `pc` is the instruction that has lowered it.
    fn check_stack(&self, simavr: &Simavr, pc: u32) {
        let sp = self.base.sp();
        if simavr.stack_mark().is_some_and(|mark| sp < mark) {
            simavr.set_stack_mark(Some(sp));
            self.stack.lower(self.base.now(), sp, pc, simavr.is_sp_set_by_hand());
            self.settle_stack(simavr);
        }
    }

    fn settle_stack(&self, simavr: &Simavr) {
        let mark = simavr.stack_mark().map(|mark| self.stack.settle(&self.base, mark));
        simavr.set_stack_mark(mark);
    }

    /// Keeps simavr asleep while clocks stand: it wakes at any interrupt. True in such a sleep.
    fn keep_asleep(&self, simavr: &Simavr) -> bool {
        let is_deep = self.sleep.get().is_some();
        if is_deep {
            let stand = self.clocks_stand();
            simavr.set_activity(if stand { Activity::Sleeping } else { Activity::Running });
        }
        is_deep
    }
}

/// The machine to which a callback's parameter points.
///
/// # Safety
/// `context` must be what `Machine::new` gave to `Simavr::set_context`.
unsafe fn machine<'a>(context: *mut c_void) -> &'a Machine {
    // Safety: the caller's promise; the machine lives longer than its core, and callbacks come from
    // the core only. Only shared references to the machine exist.
    unsafe { &*context.cast::<Machine>() }
}

/// Runs a callback of simavr's.
fn guard<T>(machine: &Machine, fallback: T, callback: impl FnOnce() -> T) -> T {
    match machine.base.core.simavr() {
        Some(simavr) => simavr.guard(fallback, callback),
        None => fallback,
    }
}

unsafe extern "C" fn on_write(
    _: *mut ffi::avr_t,
    address: ffi::avr_io_addr_t,
    value: u8,
    context: *mut c_void,
) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    guard(machine, (), || machine.write(address, value));
}

unsafe extern "C" fn on_read(
    _: *mut ffi::avr_t,
    address: ffi::avr_io_addr_t,
    context: *mut c_void,
) -> u8 {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    guard(machine, 0, || machine.read(address))
}

/// Called within each reset, including the watchdog's, before the peripherals reset.
unsafe extern "C" fn on_reset(avr: *mut ffi::avr_t) {
    // Safety: simavr passes the chip of the core, which has its context.
    let machine = unsafe { machine(Simavr::context_of(avr)) };
    guard(machine, (), || {
        let by_itself = machine.reset_cause.get().is_none();
        let cause = machine.reset_cause.take().unwrap_or(ResetCause::Watchdog);
        machine.note_reset(cause);
        // simavr does this at the end of the reset. By then it has started the watchdog with the
        // old clock, so that the time-out would be too long by the time that the chip had
        // run before.
        machine.base.restart_clock();
        if by_itself && let Some(simavr) = machine.base.core.simavr() {
            simavr.ask_for_attention();
        }
    });
}

unsafe extern "C" fn on_interrupt(_: *mut ffi::avr_irq_t, _: u32, context: *mut c_void) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    guard(machine, (), || {
        if machine.base.core.interrupts_enabled() {
            for peripheral in machine.peripherals.iter() {
                peripheral.interrupt_returns(&machine.base);
            }
        } else {
            // > The interrupt execution response for all the enabled AVR interrupts is four clock
            // > cycles minimum. (section 7.7.1) simavr takes none.
            machine.base.core.set_cycle(machine.base.core.cycle() + 4);
            // > When this bit is set (one), the interrupt vectors are moved to the beginning of the
            // > Boot Loader section of the Flash. (MCUCR, IVSEL) simavr leaves them where they are.
            if machine.base.core.get(regs::MCUCR) & regs::IVSEL != 0 {
                machine.base.core.set_pc(
                    machine.base.core.pc()
                        + machine.peripherals.nvm.spm.borrow().boot_start() as u32,
                );
            }
        }
    });
}

unsafe extern "C" fn on_bad_opcode(_: *mut ffi::avr_irq_t, opcode: u32, context: *mut c_void) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    guard(machine, (), || {
        machine.base.report_violation(&format!("illegal instruction {opcode:#06x}"))
    });
}

/// Called when the program reads or writes at an address beyond the RAM.
///
/// # Safety
/// The same as that of [`machine`].
unsafe fn on_beyond_ram(context: *mut c_void, access: Access, address: u16) {
    // Safety: the caller's promise.
    let machine = unsafe { machine(context) };
    guard(machine, (), || machine.access_beyond_ram(access, address));
}

unsafe extern "C" fn on_adc_sample(_: *mut ffi::avr_irq_t, mux: u32, context: *mut c_void) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    let Some(simavr) = machine.base.core.simavr() else { return };
    guard(machine, (), || sample(&mut machine.adc.borrow_mut(), simavr, mux));
}

/// Samples the input that `mux` (simavr's avr_adc_mux_t) selects, for a conversion by simavr. It
/// scales by 1023 in place of 1024 and, at a prescaler of 128, converts in 256 cycles in place of
/// 1664. So it gets the input for which it has the right result, and the duration of 13 ADC clocks
/// (25 for the first conversion).
fn sample(adc: &mut Adc, simavr: &Simavr, mux: u32) {
    let prescaler = 1u8 << (simavr.get(regs::ADCSRA) & regs::ADPS).max(1);
    let channel = (mux >> 19) as u8;
    let is_pin = mux & 0b111 == ffi::ADC_MUX_SINGLE;
    let reference_mv = u32::from(simavr.adc_reference_millivolts());
    let code = if is_pin { adc.sample(channel, reference_mv) } else { 0 };
    let millivolts = (code * reference_mv).div_ceil(1023);
    simavr.set_adc_input(channel, millivolts as u16, prescaler);
}

/// Calls the watchers of a pin when its level changes.
pub(super) fn watch(simavr: &Simavr, port: usize, bit: u8) {
    simavr.hook_pin(port, bit, Some(on_pin));
}

unsafe extern "C" fn on_pin(_: *mut ffi::avr_irq_t, _: u32, slot: *mut c_void) {
    // Safety: as in `on_timer`.
    let (machine, (port, bit)) = unsafe {
        let slot = &*slot.cast::<Slot<(usize, u8)>>();
        (machine(slot.context), slot.of)
    };
    guard(machine, (), || machine.base.check_watches(port, 1 << bit));
}

unsafe extern "C" fn on_watchdog(_: *mut ffi::avr_irq_t, is_raised: u32, context: *mut c_void) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    if is_raised != 0 {
        guard(machine, (), || {
            machine.peripherals.watchdog.borrow_mut().timed_out(&machine.base.core)
        });
    }
}

unsafe extern "C" fn on_timer(
    _: *mut ffi::avr_t,
    when: ffi::avr_cycle_count_t,
    slot: *mut c_void,
) -> ffi::avr_cycle_count_t {
    // Safety: simavr passes on the slot, which lives as long as the chip, and has the context.
    let (machine, timer) = unsafe {
        let slot = &*slot.cast::<Slot<Timer>>();
        (machine(slot.context), slot.of)
    };
    guard(machine, (), || machine.expire(timer, machine.base.time_of(when)));
    0
}

/// Called for SPM and LPM, in the middle of the instruction.
unsafe extern "C" fn on_flash(flash: *mut ffi::avr_io_t, request: u32, byte: *mut c_void) -> c_int {
    if request != FLASH_SPM && request != FLASH_LPM {
        return -1;
    }
    // Safety: simavr passes the peripheral, which belongs to the chip of the core, which has its
    // context.
    let machine = unsafe { machine(Simavr::context_of((*flash).avr)) };
    guard(machine, (), || {
        let [z, word] = [[ZL, ZH], [R0, R1]]
            .map(|pair| u16::from_le_bytes(pair.map(|address| machine.base.core.get(address))));
        if request == FLASH_SPM {
            machine.peripherals.nvm.execute_spm(&machine.base, z, word);
        } else {
            // Safety: with this request simavr passes a pointer to the byte that it has read, in
            // the frame of its caller.
            let byte = unsafe { &mut *byte.cast::<u8>() };
            *byte = machine.peripherals.nvm.spm.borrow_mut().load(&machine.base, z, *byte);
        }
    });
    0
}
