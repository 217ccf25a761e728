//! The base of the models of the peripherals: the core, the time, timers, and the program's
//! violations.
//!
//! A model gets `&Base` and does not use the machine, which owns both.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use anyhow::Result;

use super::chip::Chip;
use super::core::{Core, Engine};
pub(super) use super::engine::Timer;
use super::own::Own;
use super::pins::Pins;
use super::processor::{PinWatcher, Violation};
use super::regs;
use super::silicon::Silicon;
use super::unmodelled::Unmodelled;
use sim_base::Cycles;
use sim_base::Noise;

/// Most violations that are kept. A program with a mistake in a loop makes millions.
const VIOLATIONS_KEPT: usize = 1000;

/// Opcodes, without their operands.
const IN: u16 = 0xB000;
const OUT: u16 = 0xB800;
const BIT_INSTRUCTIONS: u16 = 0x9800;
const SBI: u16 = 0x9A00;
const CBI: u16 = 0x9800;
const SBIC: u16 = 0x9900;
const SBIS: u16 = 0x9B00;

/// The model of a peripheral. The machine calls it for its registers, its timers and resets.
///
/// simavr calls back in the middle of an instruction, so a model is shared. A model borrows its
/// cells for one step. It borrows no cell while it calls [`Base::forward`] or code outside of this
/// crate.
pub(super) trait Peripheral {
    /// The model before the first reset of the chip.
    fn for_chip(chip: Chip) -> Self
    where
        Self: Sized;

    /// Registers whose writes the model handles in place of simavr.
    fn writes(&self) -> &'static [u16];

    /// Registers whose reads the model answers.
    fn reads(&self) -> &'static [u16] {
        &[]
    }

    /// All timers that the model schedules.
    fn timers(&self) -> &'static [Timer] {
        &[]
    }

    /// Writes one of the registers in [`writes`](Peripheral::writes) for the program.
    fn write(&self, base: &Base, address: u16, value: u8);

    /// Reads one of the registers in [`reads`](Peripheral::reads) for the program.
    fn read(&self, base: &Base, address: u16) -> u8 {
        base.core.get(address)
    }

    /// Handles the expiry at time `at` of one of the timers in [`timers`](Peripheral::timers).
    fn expire(&self, _base: &Base, _timer: Timer, _at: Cycles) {}

    /// Resets the model, after simavr has reset its registers and cancelled all timers. `noise`
    /// decides what is random.
    fn reset(&self, _base: &Base, _noise: &mut Noise) {}

    /// Called when an interrupt handler returns: requests again the interrupts whose condition
    /// still holds.
    fn interrupt_returns(&self, _base: &Base) {}
}

/// The core, the time, timers and violations of a chip.
pub(super) struct Base {
    pub core: Core,
    pub pins: Pins,
    pub silicon: Rc<Cell<Silicon>>,
    /// Time of the last reset. simavr counts from 0 after each reset.
    last_reset: Cell<Cycles>,
    violations: RefCell<Vec<Violation>>,
    /// All uses so far.
    unmodelled: RefCell<Vec<Unmodelled>>,
    /// Where the program ran into erased flash first.
    erased: Cell<Option<u32>>,
    /// True if it has since the last reset. What it does then is no program's work, and not
    /// reported.
    is_behind_erased: Cell<bool>,
}

impl Base {
    /// A core without hooks.
    pub fn new(engine: Engine, chip: Chip, pins: Pins) -> Result<Base> {
        Ok(Base {
            core: Core::new(engine, chip)?,
            pins,
            silicon: Rc::default(),
            last_reset: Cell::new(0),
            violations: RefCell::default(),
            erased: Cell::default(),
            is_behind_erased: Cell::default(),
            unmodelled: RefCell::default(),
        })
    }

    /// Sets the expiry time of a timer, in place of an earlier one.
    pub fn schedule(&self, timer: Timer, at: Cycles) {
        match &self.core {
            Core::Own(own) => own.schedule(timer, at),
            Core::Simavr(simavr) => {
                simavr.schedule(timer, at.saturating_sub(self.last_reset.get()))
            }
        }
    }

    /// Cancels a timer.
    pub fn unschedule(&self, timer: Timer) {
        match &self.core {
            Core::Own(own) => own.unschedule(timer),
            Core::Simavr(simavr) => simavr.unschedule(timer),
        }
    }

    /// Applies the level of a pin that is driven from outside. Updates PINx, and requests pin
    /// change and external interrupts.
    pub fn drive_pin(&self, port: usize, bit: u8, level: bool) {
        match &self.core {
            Core::Own(own) => self.update_pins(own, port),
            Core::Simavr(simavr) => simavr.drive_pin(port, bit, level),
        }
    }

    /// Applies the level that a compare unit drives on a pin, until [`Base::release_pin`]. Requests
    /// pin change and external interrupts if the level changes.
    pub fn hold_pin(&self, port: usize, bit: u8, level: bool) {
        match &self.core {
            Core::Own(own) => self.update_pins(own, port),
            Core::Simavr(simavr) => simavr.hold_pin(port, bit, level),
        }
    }

    /// Ends `hold_pin`. The pin keeps its level until the next write to its port.
    pub fn release_pin(&self, port: usize, bit: u8) {
        if let Core::Simavr(simavr) = &self.core {
            simavr.release_pin(port, bit);
        }
    }

    /// Tells the own engine the levels of a port's pins, some of which may have changed.
    fn update_pins(&self, own: &Own, port: usize) {
        let changed = own.set_levels(port, self.pins.levels(&self.core, port));
        if changed != 0 {
            self.check_watches(port, changed);
        }
    }

    /// Calls the watchers of pins of a port whose levels have changed, of those in `mask`.
    pub fn check_watches(&self, port: usize, mask: u8) {
        self.pins.check_watches(&self.core, self.now(), port, mask);
    }

    /// Calls `watcher` at each change of the pin from now on.
    pub fn watch_pin(&self, port: usize, bit: u8, watcher: PinWatcher) {
        self.pins.watch(&self.core, port, bit, watcher);
    }

    /// Drives a pin from outside; `None` stops driving it.
    pub fn drive_from_outside(&self, port: usize, bit: u8, level: Option<bool>) {
        let (driven, levels) = self.pins.set_outside(port, bit, level);
        if let Some(simavr) = self.core.simavr() {
            simavr.set_external(port, driven, levels);
        }
        self.apply_outside(port, bit);
    }

    /// Drives the pins again after a reset, which makes all pins inputs and clears the levels from
    /// outside in simavr.
    pub fn reapply_pins(&self) {
        for port in 0..3 {
            let driven = self.pins.driven_outside(port);
            (0..8)
                .filter(|bit| driven & 1 << bit != 0)
                .for_each(|bit| self.apply_outside(port, bit));
        }
        (0..3).for_each(|port| self.check_watches(port, 0xFF));
    }

    /// Applies the level of an input. Does nothing for an output, because simavr would take the
    /// level for the output's.
    fn apply_outside(&self, port: usize, bit: u8) {
        if self.core.get(regs::port_register(port) - 1) & 1 << bit == 0 {
            self.drive_pin(port, bit, self.pins.level(&self.core, port, bit));
        }
    }

    /// Simulated time since the start. A reset does not change it.
    pub fn now(&self) -> Cycles {
        self.time_of(self.core.cycle())
    }

    /// Time at which a write by the present instruction takes effect: the clock edge at its end.
    /// OUT takes one cycle, all other stores two.
    pub fn write_time(&self) -> Cycles {
        self.now() + if self.core.opcode() & 0xF800 == OUT { 1 } else { 2 }
    }

    /// Time whose value a read by the present instruction has: the start of the cycle in which it
    /// reads. That is the first cycle of IN, SBIC, SBIS, SBI and CBI, and the second of all others.
    pub fn read_time(&self) -> Cycles {
        let opcode = self.core.opcode();
        let is_first = opcode & 0xF800 == IN || opcode & 0xFC00 == BIT_INSTRUCTIONS;
        self.now() + if is_first { 0 } else { 1 }
    }

    /// The bits of `value` that the present instruction writes as one to a register in which a one
    /// has an effect and a zero none.
    ///
    /// > [...] the CBI and SBI instructions will only operate on the specified bit, and can
    /// > therefore be used on registers containing such Status Flags. (section 31, note 3)
    pub fn with_single_bit(&self, value: u8) -> u8 {
        let opcode = self.core.opcode();
        match opcode & 0xFF00 {
            SBI => 1 << (opcode & 0b111),
            CBI => 0,
            _ => value,
        }
    }

    /// The bits of a register that the present instruction can see: one for SBIC and SBIS, all for
    /// others.
    pub fn tested_bits(&self) -> u8 {
        let opcode = self.core.opcode();
        match opcode & 0xFF00 {
            SBIC | SBIS => 1 << (opcode & 0b111),
            _ => 0xFF,
        }
    }

    /// Simulated time at which simavr's clock is `cycle`.
    pub fn time_of(&self, cycle: u64) -> Cycles {
        self.last_reset.get() + cycle
    }

    /// Stack pointer.
    pub fn sp(&self) -> u16 {
        u16::from_le_bytes([self.core.get(regs::SPL), self.core.get(regs::SPH)])
    }

    /// Sets simavr's clock to 0, as a reset does. Simulated time does not change.
    #[allow(dead_code, reason = "a build may be without simavr")]
    pub fn restart_clock(&self) {
        self.last_reset.set(self.now());
        self.core.set_cycle(0);
    }

    /// Adds a mistake of the program, at the present time and program counter.
    pub fn report_violation(&self, text: &str) {
        let mut violations = self.violations.borrow_mut();
        if violations.len() < VIOLATIONS_KEPT && !self.is_behind_erased() {
            let text = format!("{text} (PC {:#06x})", self.core.pc());
            violations.push(Violation { at: self.now(), text });
        }
    }

    /// Removes and returns the violations since the last call.
    pub fn take_violations(&self) -> Vec<Violation> {
        self.violations.take()
    }

    /// Notes that the program uses a feature that is not modelled exactly. Each counts once.
    pub fn report_unmodelled(&self, text: &'static str) {
        let mut known = self.unmodelled.borrow_mut();
        let is_known = known.iter().any(|unmodelled| unmodelled.text == text);
        if !is_known && !self.is_behind_erased() {
            known.push(Unmodelled { at: self.now(), text });
        }
    }

    /// The features that are not modelled exactly and that the program has used so far, after the
    /// first `seen` ones.
    pub fn unmodelled_after(&self, seen: usize) -> Vec<Unmodelled> {
        self.unmodelled.borrow().get(seen..).map(<[Unmodelled]>::to_vec).unwrap_or_default()
    }

    /// Notes that the program runs into erased flash at a byte address.
    pub fn note_erased(&self, address: u32) {
        self.is_behind_erased.set(true);
        self.erased.set(self.erased.get().or(Some(address)));
    }

    /// Notes a reset.
    pub fn note_reset(&self) {
        self.is_behind_erased.set(false);
    }

    /// True if the program has run into erased flash since the last reset.
    pub fn is_behind_erased(&self) -> bool {
        self.is_behind_erased.get()
    }

    /// Where the program ran into erased flash first.
    pub fn erased(&self) -> Option<u32> {
        self.erased.get()
    }

    /// Calls the engine's own write handler of a register.
    pub fn forward(&self, address: u16, value: u8) {
        match &self.core {
            Core::Own(own) => {
                let is_pcifr = address == regs::PCIFR;
                own.store(address, if is_pcifr { self.with_single_bit(value) } else { value });
                match address {
                    regs::PINB..=regs::PORTD => {
                        self.update_pins(own, usize::from((address - regs::PINB) / 3));
                    }
                    regs::MCUCR => (0..3).for_each(|port| self.update_pins(own, port)),
                    _ => {}
                }
            }
            Core::Simavr(simavr) => simavr.forward(address, value),
        }
    }
}
