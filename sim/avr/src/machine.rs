//! A chip: the engine and the models around it, and resets. `on_own` and `on_simavr` have the run
//! loop and the calls of each engine.
//!
//! To add a peripheral, write its file with a type that implements [`Peripheral`], declare the file
//! in lib.rs, and add a line to `peripherals!` below. The machine then calls the type for writes,
//! reads, timers and resets. A peripheral that needs another callback of an engine, or another
//! model, needs more code here.
//!
//! No module that this file imports may import this file. If a model needs another one, it gets it
//! as an argument, here or in `nvm`.
//!
//! An engine calls back in the middle of an instruction, and a callback can make it call back
//! again. So the machine is shared, and never borrowed mutably. Each model is in its own cell,
//! which is borrowed for one step. No cell is borrowed while code outside of this crate runs.

mod on_own;
#[cfg_attr(not(feature = "simavr"), path = "absent/on_simavr.rs")]
mod on_simavr;

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use anyhow::Result;

use super::adc::Adc;
use super::analog::power_on_ram;
use super::base::{Base, Peripheral, Timer};
use super::chip::Chip;
use super::core::{Access, Core, Engine, Vector};
use super::debug::Debug;
use super::extint::ExternalInterrupts;
use super::nvm::Nvm;
use super::pins::Pins;
use super::processor::{PinWatcher, Reset, ResetCause};
use super::regs::{self, PORT_B, PORT_D};
use super::silicon::Silicon;
use super::sleep::{self, Mode};
use super::spi::Spi;
use super::stack::Stack;
use super::starts::Starts;
use super::timers::Timers;
use super::trace::Trace;
use super::twi::Twi;
use super::uart::Uart;
use super::unmodelled;
use super::watchdog::Watchdog;
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
    twi: Twi,
}

/// PINx, by port.
const PINS: [u16; 3] = [regs::PINB, regs::PINC, regs::PIND];

/// Bit of port B that is ICP1.
const ICP1: u8 = 0;

/// Bits of port D that are INT0 and INT1.
const INT_PINS: [u8; 2] = [2, 3];

/// End of the addresses of registers.
const REGISTERS: usize = 0x100;

/// A sleep in which clocks stand.
#[derive(Debug, Clone, Copy)]
struct Sleep {
    mode: Mode,
    /// EIFR when it began.
    edges: u8,
    /// When the clocks start, once something has woken the chip.
    ends: Option<Cycles>,
}

/// A chip: the core and the models around it.
pub(super) struct Machine {
    pub base: Base,
    pub peripherals: Peripherals,
    /// Index of the peripheral that models a register, by the register's address.
    owners: [Option<usize>; REGISTERS],
    /// The same of the peripherals that answer reads.
    readers: [Option<usize>; REGISTERS],
    /// True for a register that a program reads without an effect, by its address.
    plain: [bool; REGISTERS],
    /// Index of the peripheral that uses a timer, by the timer.
    timers: [Option<usize>; Timer::COUNT],
    pub adc: RefCell<Adc>,
    pub debug: Debug,
    pub trace: Trace,
    pub stack: Stack,
    resets: RefCell<Vec<Reset>>,
    starts: Starts,
    /// Pins that the program has read since power-on, by port.
    inputs_read: [Cell<u8>; 3],
    reset_cause: Cell<Option<ResetCause>>,
    power_on_noise: RefCell<Noise>,
    /// The sleep in which clocks stand now.
    sleep: Cell<Option<Sleep>>,
    /// End of the start-up after the last reset.
    started_at: Cell<Cycles>,
}

impl Machine {
    /// A chip before its first reset.
    pub fn new(engine: Engine, chip: Chip) -> Result<Rc<Machine>> {
        let peripherals = Peripherals::new(chip);
        let mut owners = [None; REGISTERS];
        let mut readers = [None; REGISTERS];
        let mut timers = [None; Timer::COUNT];
        for (index, peripheral) in peripherals.iter().enumerate() {
            for address in peripheral.writes().iter().chain(peripheral.reads()) {
                let owner = owners[usize::from(*address)].replace(index);
                assert!(
                    owner.is_none_or(|owner| owner == index),
                    "two peripherals have register {address:#04x}"
                );
            }
            for address in peripheral.reads() {
                readers[usize::from(*address)] = Some(index);
            }
            for timer in peripheral.timers() {
                let owner = timers[*timer as usize].replace(index);
                assert!(owner.is_none(), "two peripherals have {timer:?}");
            }
        }
        let plain = std::array::from_fn(|address| {
            let special = PINS.into_iter().chain([regs::ADCL, regs::ADCH]);
            let mut special = special.chain(unmodelled::READS.iter().copied());
            readers[address].is_none() && special.all(|special| usize::from(special) != address)
        });
        let pins = Pins::new(peripherals.timers.overrides());
        let machine = Rc::new(Machine {
            base: Base::new(engine, chip, pins)?,
            peripherals,
            owners,
            readers,
            plain,
            timers,
            adc: RefCell::new(Adc::new()),
            debug: Debug::default(),
            trace: Trace::default(),
            stack: Stack::default(),
            resets: RefCell::default(),
            starts: Starts::default(),
            inputs_read: Default::default(),
            reset_cause: Cell::new(None),
            power_on_noise: RefCell::new(Noise::new(0)),
            sleep: Cell::new(None),
            started_at: Cell::new(0),
        });
        if let Core::Simavr(simavr) = &machine.base.core {
            on_simavr::hook(&machine, simavr);
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
        self.base.watch_pin(port, bit, watcher);
        if let Core::Simavr(simavr) = &self.base.core {
            on_simavr::watch(simavr, port, bit);
        }
    }

    pub fn resets_after(&self, first: usize) -> Vec<Reset> {
        self.resets.borrow().get(first..).map(<[Reset]>::to_vec).unwrap_or_default()
    }

    pub fn seed(&self, seed: u64) {
        self.power_on_noise.replace(Noise::new(seed));
        self.peripherals.watchdog.replace(Watchdog::new(seed));
        self.peripherals.watchdog.borrow_mut().tune(&self.base.silicon.get());
    }

    pub fn set_silicon(&self, silicon: Silicon) {
        assert_eq!(self.base.now(), 0, "the chip has run already");
        self.base.silicon.set(silicon);
        self.adc.borrow_mut().tune(silicon);
        let mut watchdog = self.peripherals.watchdog.borrow_mut();
        watchdog.tune(&silicon);
        watchdog.timed_out(&self.base.core);
        self.begin_start_up();
    }

    /// > After all reset sources have gone inactive, a delay counter is invoked, stretching the
    /// > internal reset. (section 11.1)
    fn begin_start_up(&self) {
        let silicon = self.base.silicon.get();
        let end = self.base.now() + silicon.cycles_in_us(silicon.start_up_us);
        self.started_at.set(end);
        if end > self.base.now() {
            self.base.schedule(Timer::Wake, end);
        }
    }

    /// True while the chip starts, or a page of flash is programmed that it cannot read meanwhile.
    fn cpu_waits(&self) -> bool {
        self.peripherals.nvm.spm.borrow().halts_cpu() || self.base.now() < self.started_at.get()
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
        match &self.base.core {
            Core::Own(own) => {
                own.reset();
                self.note_reset(cause);
            }
            Core::Simavr(simavr) => {
                self.reset_cause.set(Some(cause));
                simavr.reset();
            }
        }
        self.after_reset();
    }

    /// Runs the program and the peripherals until `until`, or until a debugger halts the chip.
    pub fn run_until(&self, until: Cycles) {
        match &self.base.core {
            Core::Own(own) => self.run_own(own, until),
            Core::Simavr(simavr) => self.run_simavr(simavr, until),
        }
    }

    /// Handles SLEEP. True if the chip sleeps.
    fn falls_asleep(&self) -> bool {
        let smcr = self.base.core.get(regs::SMCR);
        if smcr & regs::SE == 0 {
            self.base.report_violation("SLEEP without SE in SMCR: the chip does not sleep");
            return false;
        }
        if let Some(text) = unmodelled::used_by_sleep(&self.base.core, smcr) {
            self.base.report_unmodelled(text);
        }
        true
    }

    /// Stops the clocks of a chip that sleeps, if its mode stops any. True if they stand now.
    fn stop_clocks(&self) -> bool {
        let Machine { base, peripherals, .. } = self;
        let core = &base.core;
        let Some(mode) = Mode::of(core.get(regs::SMCR)) else { return false };
        if mode.converts && core.get(regs::ADCSRA) & (regs::ADEN | regs::ADSC) == regs::ADEN {
            self.write(regs::ADCSRA, core.get(regs::ADCSRA) & !regs::ADIF | regs::ADSC);
        }
        if sleep::is_pending(core) {
            return false;
        }
        peripherals.timers.fall_asleep(base, mode.stopped, base.now());
        self.sleep.set(Some(Sleep { mode, edges: core.get(regs::EIFR), ends: None }));
        true
    }

    /// True while the clocks stand in a sleep. Starts them when the time has come.
    fn clocks_stand(&self) -> bool {
        let Some(sleep) = self.sleep.get() else { return false };
        let Machine { base, peripherals, .. } = self;
        let now = base.now();
        for n in 0..2 {
            let is_new = base.core.get(regs::EIFR) & !sleep.edges & 1 << n != 0;
            if is_new && sleep::sense(&base.core, n) != 0 {
                base.core.clear(Vector::External(n as u8));
            }
        }
        let ends = match sleep.ends {
            Some(ends) => ends,
            None => {
                let is_low = INT_PINS.map(|bit| !base.pins.level(&base.core, PORT_D, bit));
                if !sleep.mode.is_woken(&base.core, is_low) {
                    return true;
                }
                let ends = now + sleep.mode.start_up;
                base.schedule(Timer::Wake, ends);
                self.sleep.set(Some(Sleep { ends: Some(ends), ..sleep }));
                ends
            }
        };
        if now < ends {
            return true;
        }
        self.sleep.set(None);
        peripherals.timers.wake(base, now);
        false
    }

    /// Handles an access of the program beyond the RAM.
    fn access_beyond_ram(&self, access: Access, address: u16) {
        let verb = match access {
            Access::Read => "reads",
            Access::Write => "writes",
        };
        let chip = self.base.core.chip();
        let end = chip.ram_end();
        self.base.report_violation(&format!(
            "the program {verb} {address:#06x}, but the RAM of an {chip} ends at {end:#06x}"
        ));
    }

    /// Notes a reset, before the models handle it.
    fn note_reset(&self, cause: ResetCause) {
        self.resets.borrow_mut().push(Reset { at: self.base.now(), cause });
        self.starts.reset();
        self.base.note_reset();
    }

    /// Stores a byte in an I/O register, with the side effects of a program's store.
    pub fn store(&self, address: u16, value: u8) {
        match &self.base.core {
            Core::Own(_) => self.write(address, value),
            Core::Simavr(simavr) => simavr.store(address, value),
        }
    }

    /// Times at which the program jumped to its start without a reset, after the first `seen` ones.
    pub fn jumps_after(&self, seen: usize) -> Vec<Cycles> {
        self.starts.jumps_after(seen)
    }

    /// Corrects the state after the engine's reset: resets the models, and drives the pins from
    /// outside again.
    fn after_reset(&self) {
        self.sleep.set(None);
        self.base.unschedule(Timer::Wake);
        self.begin_start_up();
        for peripheral in self.peripherals.iter() {
            peripheral.reset(&self.base, &mut self.power_on_noise.borrow_mut());
        }
        self.base.reapply_pins();
    }

    /// Watches the stack on simavr, which costs time; the own engine always does.
    pub fn watch_stack(&self) {
        if let Core::Simavr(simavr) = &self.base.core {
            simavr.set_stack_mark(Some(self.base.core.chip().ram_end()));
        }
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
            let levels = self.base.pins.levels(&self.base.core, port);
            if self.base.silicon.get().is_floating {
                let noise = self.power_on_noise.borrow_mut().next_u64() as u8;
                return levels ^ noise & self.base.pins.floating(&self.base.core, port);
            }
            return levels;
        }
        if unmodelled::READS.contains(&address) {
            self.base.report_unmodelled(unmodelled::used_by_read(address));
        }
        let reader = self.readers[usize::from(address)];
        match (reader.map(|index| self.peripherals.get(index)), &self.base.core) {
            (Some(reader), _) => reader.read(&self.base, address),
            (None, Core::Own(own)) => own.load(address),
            (None, Core::Simavr(simavr)) => simavr.get(address),
        }
    }

    /// True if a pin is high.
    pub fn level(&self, port: usize, bit: u8) -> bool {
        self.peripherals.timers.advance_port(&self.base, port, self.base.now());
        self.base.pins.level(&self.base.core, port, bit)
    }

    /// A byte of the data space for a look from outside, which has no side effect.
    pub fn peek(&self, address: u16) -> u8 {
        if PINS.contains(&address) || self.peripherals.timers.reads().contains(&address) {
            self.peripherals.timers.publish(&self.base);
        }
        self.base.core.get(address)
    }

    fn expire(&self, timer: Timer, at: Cycles) {
        if let Some(index) = self.timers[timer as usize] {
            self.peripherals.get(index).expire(&self.base, timer, at);
        }
    }
}
