//! A chip: the core and the models around it, the run loop, resets, and simavr's callbacks.
//!
//! To add a peripheral, write its file with a type that implements [`Peripheral`], declare the file
//! in lib.rs, and add a line to `peripherals!` below. The machine then calls the type for writes,
//! reads, timers and resets. A peripheral that needs another callback of simavr, or another model,
//! needs more code here.
//!
//! No module that this file imports may import this file. If a model needs another one, it gets it
//! as an argument, here or in `nvm`.
//!
//! simavr calls back in the middle of an instruction, and a callback can make simavr call back
//! again. So the machine is shared, and never borrowed mutably. Each model is in its own cell,
//! which is borrowed for one step. No cell is borrowed while code outside of this crate runs.

use std::cell::{Cell, RefCell};
use std::ffi::{c_int, c_void};
use std::rc::Rc;

use anyhow::Result;
use simavr_ffi as ffi;

use super::adc::Adc;
use super::base::{Base, Peripheral, Timer, TimerSlot};
use super::core::{Access, Activity, Core, FLASH_LPM, FLASH_SPM};
use super::debug::Debug;
use super::extint::ExternalInterrupts;
use super::nvm::Nvm;
use super::pins::{PORT_B, PORT_D, Pins};
use super::regs;
use super::spi::Spi;
use super::timers::Timers;
use super::trace::Trace;
use super::uart::Uart;
use super::watchdog::Watchdog;
use avr_chip::{Chip, PinWatcher, Reset, ResetCause, power_on_ram};
use sim_base::Cycles;
use sim_base::Noise;

/// Selects one of the peripherals.
type Select = fn(&Peripherals) -> &dyn Peripheral;

macro_rules! peripherals {
    ($($name:ident: $model:ty,)*) => {
        /// The models of the peripherals.
        pub(super) struct Peripherals {
            $(pub $name: $model,)*
        }

        impl Peripherals {
            /// All peripherals, in the order in which a reset resets them.
            const ALL: &[Select] = &[$(|peripherals| &peripherals.$name),*];

            fn new(chip: Chip) -> Peripherals {
                Peripherals { $($name: <$model as Peripheral>::for_chip(chip),)* }
            }
        }
    };
}

impl Peripherals {
    fn iter(&self) -> impl Iterator<Item = &dyn Peripheral> {
        Peripherals::ALL.iter().map(|select| select(self))
    }

    fn get(&self, index: usize) -> &dyn Peripheral {
        Peripherals::ALL[index](self)
    }
}

peripherals! {
    spi: Spi,
    uart: RefCell<Uart>,
    nvm: Nvm,
    timers: Timers,
    watchdog: RefCell<Watchdog>,
    external_interrupts: ExternalInterrupts,
}

/// Expires at the end of `run_until`.
const STOP: Timer = Timer("stop");

/// Bit of port B that is ICP1.
const ICP1: u8 = 0;

/// End of the addresses of registers.
const REGISTERS: usize = 0x100;

/// A chip: the core and the models around it.
pub(super) struct Machine {
    pub base: Base,
    pub peripherals: Peripherals,
    /// Index of the peripheral that models a register, by the register's address.
    owners: [Option<usize>; REGISTERS],
    /// Each timer, and the index of the peripheral that uses it.
    timers: Vec<(Timer, usize)>,
    pub adc: RefCell<Adc>,
    pub pins: Pins,
    pub debug: Debug,
    pub trace: Trace,
    resets: RefCell<Vec<Reset>>,
    reset_cause: Cell<Option<ResetCause>>,
    power_on_noise: RefCell<Noise>,
}

impl Machine {
    /// A chip before its first reset.
    pub fn new(chip: Chip) -> Result<Rc<Machine>> {
        let peripherals = Peripherals::new(chip);
        let mut owners = [None; REGISTERS];
        let mut timers = Vec::new();
        for (index, peripheral) in peripherals.iter().enumerate() {
            for address in peripheral.writes().iter().chain(peripheral.reads()) {
                let owner = owners[usize::from(*address)].replace(index);
                assert!(
                    owner.is_none_or(|owner| owner == index),
                    "two peripherals have register {address:#04x}"
                );
            }
            timers.extend(peripheral.timers().iter().map(|timer| (*timer, index)));
        }
        let pins = Pins::new(peripherals.timers.overrides());
        let machine = Rc::new(Machine {
            base: Base::new(chip)?,
            peripherals,
            owners,
            timers,
            adc: RefCell::new(Adc::new()),
            pins,
            debug: Debug::default(),
            trace: Trace::default(),
            resets: RefCell::default(),
            reset_cause: Cell::new(None),
            power_on_noise: RefCell::new(Noise::new(0)),
        });
        let base = &machine.base;
        let core = &base.core;
        core.set_context(Rc::as_ptr(&machine).cast_mut().cast(), on_beyond_ram);
        let timers: Vec<Timer> =
            machine.timers.iter().map(|(timer, _)| *timer).chain([STOP]).collect();
        base.set_timers(&timers, Some(on_timer));
        core.hook_reset(on_reset);
        core.hook_interrupts(Some(on_interrupt), Some(on_bad_opcode));
        core.hook_adc(Some(on_adc_sample));
        core.hook_watchdog(Some(on_watchdog));
        core.hook_flash(on_flash);
        base.hook_write(regs::MCUSR, Some(on_write));
        for pins in [regs::PINB, regs::PIND] {
            core.hook_read(pins, Some(on_read));
            core.unhook_bit_writes(pins);
        }
        for peripheral in machine.peripherals.iter() {
            for address in peripheral.writes() {
                base.hook_write(*address, Some(on_write));
            }
            for address in peripheral.reads() {
                core.hook_read(*address, Some(on_read));
            }
        }
        let capture = Rc::downgrade(&machine);
        let on_icp1 = Box::new(move |level, at| {
            if let Some(machine) = capture.upgrade() {
                machine.peripherals.timers.input_edge(&machine.base, level, at);
            }
        });
        machine.watch_pin(PORT_B, ICP1, on_icp1);
        Ok(machine)
    }

    /// Calls `watcher` at each change of the pin from now on.
    pub fn watch_pin(&self, port: usize, bit: u8, watcher: PinWatcher) {
        self.peripherals.timers.watch(&self.base, port, bit);
        self.pins.watch(&self.base, port, bit, watcher);
    }

    pub fn resets_after(&self, first: usize) -> Vec<Reset> {
        self.resets.borrow().get(first..).map(<[Reset]>::to_vec).unwrap_or_default()
    }

    pub fn seed(&self, seed: u64) {
        self.power_on_noise.replace(Noise::new(seed));
        self.peripherals.watchdog.replace(Watchdog::new(seed));
    }

    /// Resets the chip from outside.
    pub fn reset(&self, cause: ResetCause) {
        let flags = match cause {
            ResetCause::PowerOn => regs::PORF,
            ResetCause::External => self.base.core.get(regs::MCUSR) | regs::EXTRF,
            ResetCause::BrownOut => self.base.core.get(regs::MCUSR) | regs::BORF,
            ResetCause::Watchdog => self.base.core.get(regs::MCUSR) | regs::WDRF,
        };
        self.base.core.set(regs::MCUSR, flags);
        if cause == ResetCause::PowerOn {
            let mut noise = self.power_on_noise.borrow_mut();
            for (address, value) in power_on_ram(self.base.core.chip(), &mut noise) {
                self.base.core.set(address, value);
            }
            self.peripherals.nvm.eeprom.borrow_mut().lose_power(noise.next_u64() as u8);
        }
        self.reset_cause.set(Some(cause));
        self.base.core.reset();
        self.after_reset();
    }

    /// Runs the program and the peripherals until `until`, or until a debugger halts the chip.
    pub fn run_until(&self, until: Cycles) {
        if self.base.now() >= until {
            return;
        }
        let core = &self.base.core;
        self.base.schedule(STOP, until);
        loop {
            core.run_freely();
            let cpu_waits = self.peripherals.nvm.spm.borrow().halts_cpu();
            if self.debug.is_watching()
                && (self.debug.is_halted() || !cpu_waits && self.debug.halts(core))
            {
                return;
            }
            if !cpu_waits && core.activity() == Activity::Running {
                self.peripherals.nvm.spm.borrow().check_execution(&self.base);
            }
            let asleep_for_good =
                core.activity() == Activity::Sleeping && !core.interrupts_enabled();
            if core.activity() == Activity::Running && !cpu_waits {
                if self.trace.is_on() {
                    self.trace.before_instruction(&self.base);
                }
                core.run_one();
                if core.activity() == Activity::Sleeping && core.get(regs::SMCR) & regs::SE == 0 {
                    self.base.report_violation("SLEEP without SE in SMCR: the chip does not sleep");
                    core.set_activity(Activity::Running);
                }
            }
            let mut idle = core.process_timers();
            if self.base.take_attention() {
                self.after_reset();
                if self.base.now() < until {
                    self.base.schedule(STOP, until);
                }
                idle = 0;
            } else if asleep_for_good && core.activity() == Activity::Running {
                // simavr wakes the core for an interrupt even if the I flag is 0; the chip does
                // not.
                core.set_activity(Activity::Sleeping);
            }
            match core.activity() {
                Activity::Running if !self.peripherals.nvm.spm.borrow().halts_cpu() => {
                    core.service_interrupts()
                }
                Activity::Running | Activity::Sleeping | Activity::Crashed => {
                    let rest = until.saturating_sub(self.base.now());
                    core.set_cycle(core.cycle() + idle.min(rest));
                }
            }
            if self.base.now() >= until {
                return;
            }
        }
    }

    /// Corrects the state after simavr's reset: resets the models, and drives the pins from outside
    /// again.
    fn after_reset(&self) {
        for peripheral in self.peripherals.iter() {
            peripheral.reset(&self.base, &mut self.power_on_noise.borrow_mut());
        }
        self.pins.reapply(&self.base);
    }

    fn owner(&self, address: u16) -> Option<&dyn Peripheral> {
        self.owners[usize::from(address)].map(|index| self.peripherals.get(index))
    }

    fn write(&self, address: u16, value: u8) {
        let core = &self.base.core;
        if address == regs::MCUSR {
            // > The flag is reset by a Power-on Reset, or by writing a logic zero to the flag.
            // > (section 11.9.1)
            core.set(address, core.get(address) & value);
        } else if let Some(peripheral) = self.owner(address) {
            peripheral.write(&self.base, address, value);
        }
    }

    fn read(&self, address: u16) -> u8 {
        let port = match address {
            regs::PINB => Some(PORT_B),
            regs::PIND => Some(PORT_D),
            _ => None,
        };
        if let Some(port) = port {
            self.peripherals.timers.advance_port(&self.base, port, self.base.read_time());
            return self.pins.levels(&self.base, port);
        }
        self.owner(address)
            .map_or_else(|| self.base.core.get(address), |owner| owner.read(&self.base, address))
    }

    /// True if a pin is high.
    pub fn level(&self, port: usize, bit: u8) -> bool {
        self.peripherals.timers.advance_port(&self.base, port, self.base.now());
        self.pins.level(&self.base, port, bit)
    }

    /// A byte of the data space for a look from outside, which has no side effect.
    pub fn peek(&self, address: u16) -> u8 {
        if address < regs::RAMSTART {
            self.peripherals.timers.publish(&self.base);
        }
        self.base.core.get(address)
    }

    fn expire(&self, timer: Timer, at: Cycles) {
        if let Some((_, index)) = self.timers.iter().find(|(owned, _)| *owned == timer) {
            self.peripherals.get(*index).expire(&self.base, timer, at);
        }
    }
}

/// The machine to which a callback's parameter points.
///
/// # Safety
/// `context` must be what `Machine::new` gave to `Core::set_context`.
unsafe fn machine<'a>(context: *mut c_void) -> &'a Machine {
    // Safety: the caller's promise; the machine lives longer than its core, and callbacks come from
    // the core only. Only shared references to the machine exist.
    unsafe { &*context.cast::<Machine>() }
}

unsafe extern "C" fn on_write(
    _: *mut ffi::avr_t,
    address: ffi::avr_io_addr_t,
    value: u8,
    context: *mut c_void,
) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.base.guard((), || machine.write(address, value));
}

unsafe extern "C" fn on_read(
    _: *mut ffi::avr_t,
    address: ffi::avr_io_addr_t,
    context: *mut c_void,
) -> u8 {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.base.guard(0, || machine.read(address))
}

/// Called within each reset, including the watchdog's, before the peripherals reset.
unsafe extern "C" fn on_reset(avr: *mut ffi::avr_t) {
    // Safety: simavr passes the chip of the core, which has its context.
    let machine = unsafe { machine(Core::context_of(avr)) };
    machine.base.guard((), || {
        let at = machine.base.now();
        let by_itself = machine.reset_cause.get().is_none();
        let cause = machine.reset_cause.take().unwrap_or(ResetCause::Watchdog);
        machine.resets.borrow_mut().push(Reset { at, cause });
        // simavr does this at the end of the reset. By then it has started the watchdog with the
        // old clock, so that the time-out would be too long by the time that the chip had
        // run before.
        machine.base.restart_clock();
        if by_itself {
            machine.base.ask_for_attention();
        }
    });
}

unsafe extern "C" fn on_interrupt(_: *mut ffi::avr_irq_t, _: u32, context: *mut c_void) {
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

unsafe extern "C" fn on_bad_opcode(_: *mut ffi::avr_irq_t, opcode: u32, context: *mut c_void) {
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
unsafe fn on_beyond_ram(context: *mut c_void, access: Access, address: u16) {
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

unsafe extern "C" fn on_adc_sample(_: *mut ffi::avr_irq_t, mux: u32, context: *mut c_void) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.base.guard((), || machine.adc.borrow_mut().sample(&machine.base.core, mux));
}

unsafe extern "C" fn on_watchdog(_: *mut ffi::avr_irq_t, is_raised: u32, context: *mut c_void) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    if is_raised != 0 {
        machine
            .base
            .guard((), || machine.peripherals.watchdog.borrow_mut().timed_out(&machine.base.core));
    }
}

unsafe extern "C" fn on_timer(
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
unsafe extern "C" fn on_flash(flash: *mut ffi::avr_io_t, request: u32, byte: *mut c_void) -> c_int {
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
