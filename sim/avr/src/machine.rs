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

mod callbacks;

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use anyhow::Result;

use super::adc::Adc;
use super::base::{Base, Peripheral, Timer};
use super::core::Activity;
use super::debug::Debug;
use super::extint::ExternalInterrupts;
use super::nvm::Nvm;
use super::pins::{PORT_B, Pins};
use super::regs;
use super::spi::Spi;
use super::starts::Starts;
use super::timers::Timers;
use super::trace::Trace;
use super::uart::Uart;
use super::unmodelled;
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

/// PINx, by port.
const PINS: [u16; 3] = [regs::PINB, regs::PINC, regs::PIND];

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
    starts: Starts,
    /// Pins that the program has read since power-on, by port.
    inputs_read: [Cell<u8>; 3],
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
            starts: Starts::default(),
            inputs_read: Default::default(),
            reset_cause: Cell::new(None),
            power_on_noise: RefCell::new(Noise::new(0)),
        });
        let base = &machine.base;
        let core = &base.core;
        core.set_context(Rc::as_ptr(&machine).cast_mut().cast(), callbacks::on_beyond_ram);
        let timers: Vec<Timer> =
            machine.timers.iter().map(|(timer, _)| *timer).chain([STOP]).collect();
        base.set_timers(&timers, Some(callbacks::on_timer));
        core.hook_reset(callbacks::on_reset);
        core.hook_interrupts(Some(callbacks::on_interrupt), Some(callbacks::on_bad_opcode));
        core.hook_adc(Some(callbacks::on_adc_sample));
        core.hook_watchdog(Some(callbacks::on_watchdog));
        core.hook_flash(callbacks::on_flash);
        base.hook_write(regs::MCUSR, Some(callbacks::on_write));
        for pins in [regs::PINB, regs::PINC, regs::PIND] {
            core.hook_read(pins, Some(callbacks::on_read));
        }
        for pins in [regs::PINB, regs::PIND] {
            core.unhook_bit_writes(pins);
        }
        base.hook_write(regs::SREG, Some(callbacks::on_write));
        for address in unmodelled::WRITES {
            if machine.owner(*address).is_none() {
                base.hook_write(*address, Some(callbacks::on_write));
            }
        }
        for address in unmodelled::READS {
            core.hook_read(*address, Some(callbacks::on_read));
        }
        for peripheral in machine.peripherals.iter() {
            for address in peripheral.writes() {
                base.hook_write(*address, Some(callbacks::on_write));
            }
            for address in peripheral.reads() {
                core.hook_read(*address, Some(callbacks::on_read));
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
                if core.activity() == Activity::Sleeping {
                    self.fall_asleep();
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

    /// Handles SLEEP.
    fn fall_asleep(&self) {
        let smcr = self.base.core.get(regs::SMCR);
        if smcr & regs::SE == 0 {
            self.base.report_violation("SLEEP without SE in SMCR: the chip does not sleep");
            self.base.core.set_activity(Activity::Running);
        } else if let Some(text) = unmodelled::used_by_sleep(smcr) {
            self.base.report_unmodelled(text);
        }
    }

    /// Times at which the program jumped to its start without a reset, after the first `seen` ones.
    pub fn jumps_after(&self, seen: usize) -> Vec<Cycles> {
        self.starts.jumps_after(seen)
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

    /// The bits of the pins of a port that the program has read since power-on.
    pub fn inputs_read(&self, port: usize) -> u8 {
        self.inputs_read[port].get()
    }

    fn write(&self, address: u16, value: u8) {
        let core = &self.base.core;
        if address == regs::SREG {
            core.set(address, value);
            self.starts.check(&self.base);
            return;
        }
        if let Some(text) = unmodelled::used_by_write(core, address, value) {
            self.base.report_unmodelled(text);
        }
        if address == regs::MCUSR {
            // > The flag is reset by a Power-on Reset, or by writing a logic zero to the flag.
            // > (section 11.9.1)
            core.set(address, core.get(address) & value);
        } else if let Some(peripheral) = self.owner(address) {
            peripheral.write(&self.base, address, value);
        } else {
            self.base.forward(address, value);
        }
    }

    fn read(&self, address: u16) -> u8 {
        if let Some(port) = PINS.iter().position(|pins| *pins == address) {
            let read = &self.inputs_read[port];
            read.set(read.get() | self.base.tested_bits());
            self.peripherals.timers.advance_port(&self.base, port, self.base.read_time());
            return self.pins.levels(&self.base, port);
        }
        if unmodelled::READS.contains(&address) {
            self.base.report_unmodelled(unmodelled::used_by_read(address));
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
