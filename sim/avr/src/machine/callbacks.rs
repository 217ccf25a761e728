//! The functions that simavr calls, in the middle of an instruction. Each finds the machine by its
//! context, and hands over. A panic must not unwind through simavr's frames: `Base::guard` keeps it
//! for the run loop.

use std::ffi::{c_int, c_void};

use simavr_ffi as ffi;

use super::Machine;
use crate::base::TimerSlot;
use crate::core::{Access, Core, FLASH_LPM, FLASH_SPM};
use crate::regs;
use avr_chip::{Reset, ResetCause};

/// The machine to which a callback's parameter points.
///
/// # Safety
/// `context` must be what `Machine::new` gave to `Core::set_context`.
unsafe fn machine<'a>(context: *mut c_void) -> &'a Machine {
    // Safety: the caller's promise; the machine lives longer than its core, and callbacks come from
    // the core only. Only shared references to the machine exist.
    unsafe { &*context.cast::<Machine>() }
}

pub(super) unsafe extern "C" fn on_write(
    _: *mut ffi::avr_t,
    address: ffi::avr_io_addr_t,
    value: u8,
    context: *mut c_void,
) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.base.guard((), || machine.write(address, value));
}

pub(super) unsafe extern "C" fn on_read(
    _: *mut ffi::avr_t,
    address: ffi::avr_io_addr_t,
    context: *mut c_void,
) -> u8 {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.base.guard(0, || machine.read(address))
}

/// Called within each reset, including the watchdog's, before the peripherals reset.
pub(super) unsafe extern "C" fn on_reset(avr: *mut ffi::avr_t) {
    // Safety: simavr passes the chip of the core, which has its context.
    let machine = unsafe { machine(Core::context_of(avr)) };
    machine.base.guard((), || {
        let at = machine.base.now();
        let by_itself = machine.reset_cause.get().is_none();
        let cause = machine.reset_cause.take().unwrap_or(ResetCause::Watchdog);
        machine.resets.borrow_mut().push(Reset { at, cause });
        machine.starts.reset();
        // simavr does this at the end of the reset. By then it has started the watchdog with the
        // old clock, so that the time-out would be too long by the time that the chip had
        // run before.
        machine.base.restart_clock();
        if by_itself {
            machine.base.ask_for_attention();
        }
    });
}

pub(super) unsafe extern "C" fn on_interrupt(_: *mut ffi::avr_irq_t, _: u32, context: *mut c_void) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.base.guard((), || {
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

pub(super) unsafe extern "C" fn on_bad_opcode(
    _: *mut ffi::avr_irq_t,
    opcode: u32,
    context: *mut c_void,
) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine
        .base
        .guard((), || machine.base.report_violation(&format!("illegal instruction {opcode:#06x}")));
}

/// Called when the program reads or writes at an address beyond the RAM.
///
/// # Safety
/// The same as that of [`machine`].
pub(super) unsafe fn on_beyond_ram(context: *mut c_void, access: Access, address: u16) {
    // Safety: the caller's promise.
    let machine = unsafe { machine(context) };
    machine.base.guard((), || {
        let verb = match access {
            Access::Read => "reads",
            Access::Write => "writes",
        };
        let chip = machine.base.core.chip();
        let end = chip.ram_end();
        machine.base.report_violation(&format!(
            "the program {verb} {address:#06x}, but the RAM of an {chip} ends at {end:#06x}"
        ));
    });
}

pub(super) unsafe extern "C" fn on_adc_sample(
    _: *mut ffi::avr_irq_t,
    mux: u32,
    context: *mut c_void,
) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.base.guard((), || machine.adc.borrow_mut().sample(&machine.base.core, mux));
}

pub(super) unsafe extern "C" fn on_watchdog(
    _: *mut ffi::avr_irq_t,
    is_raised: u32,
    context: *mut c_void,
) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    if is_raised != 0 {
        machine
            .base
            .guard((), || machine.peripherals.watchdog.borrow_mut().timed_out(&machine.base.core));
    }
}

pub(super) unsafe extern "C" fn on_timer(
    _: *mut ffi::avr_t,
    when: ffi::avr_cycle_count_t,
    slot: *mut c_void,
) -> ffi::avr_cycle_count_t {
    // Safety: simavr passes on what `Base` registers: a slot that lives as long as the core's base,
    // with the context.
    let (machine, timer) = unsafe {
        let slot = &*slot.cast::<TimerSlot>();
        (machine(slot.context), slot.timer)
    };
    machine.base.guard((), || machine.expire(timer, machine.base.time_of(when)));
    0
}

/// Called for SPM and LPM, in the middle of the instruction.
pub(super) unsafe extern "C" fn on_flash(
    flash: *mut ffi::avr_io_t,
    request: u32,
    byte: *mut c_void,
) -> c_int {
    if request != FLASH_SPM && request != FLASH_LPM {
        return -1;
    }
    // Safety: simavr passes the peripheral, which belongs to the chip of the core, which has its
    // context.
    let machine = unsafe { machine(Core::context_of((*flash).avr)) };
    machine.base.guard((), || {
        if request == FLASH_SPM {
            machine.peripherals.nvm.execute_spm(&machine.base);
        } else {
            // Safety: with this request simavr passes a pointer to the byte that it has read, in
            // the frame of its caller.
            let byte = unsafe { &mut *byte.cast::<u8>() };
            *byte = machine.peripherals.nvm.spm.borrow_mut().load(&machine.base, *byte);
        }
    });
    0
}
