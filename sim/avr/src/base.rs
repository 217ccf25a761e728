//! What the models of the peripherals build on: the core, the time, timers, and the program's violations.
//!
//! A model gets `&Base` and knows nothing of the machine above it, which owns both.

use std::any::Any;
use std::cell::{Cell, OnceCell, RefCell};
use std::ffi::c_void;
use std::panic::{AssertUnwindSafe, catch_unwind};

use anyhow::Result;
use simavr_ffi as ffi;

use super::chip::Chip;
use super::core::{Core, WriteHandler};
use sim_base::Cycles;
use sim_base::Noise;

/// A program that makes a mistake in a loop makes millions of violations: the first ones are enough.
const VIOLATIONS_KEPT: usize = 1000;

/// A mistake of the program that the chip would bear in silence.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation {
    /// When.
    pub at: Cycles,
    /// What, with the program counter.
    pub text: String,
}

/// A timer of a model, by its name, which no other timer has. It has one date at most.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Timer(pub &'static str);

/// The model of a peripheral. The machine passes on to it what concerns its registers and timers.
///
/// simavr calls back in the middle of an instruction, so a model is shared. It borrows its cells for one step, and no cell
/// while it calls [`Base::forward`] or the outside world.
pub(super) trait Peripheral {
    /// The peripheral before the first reset.
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

    /// The program writes one of [`writes`](Peripheral::writes).
    fn write(&self, base: &Base, address: u16, value: u8);

    /// The program reads one of [`reads`](Peripheral::reads).
    fn read(&self, base: &Base, address: u16) -> u8 {
        base.core.get(address)
    }

    /// The date of one of [`timers`](Peripheral::timers) has come; it was `at`.
    fn expire(&self, _base: &Base, _timer: Timer, _at: Cycles) {}

    /// The chip was reset: simavr has reset its registers and forgotten all dates. `noise` decides what is left to chance.
    fn reset(&self, _base: &Base, _noise: &mut Noise) {}

    /// An interrupt handler returns: interrupts that are requested as long as a condition holds are requested again.
    fn interrupt_returns(&self, _base: &Base) {}
}

/// A timer as simavr knows it: the parameter of its callback.
pub(super) struct TimerSlot {
    /// The context of the core.
    pub context: *mut c_void,
    pub timer: Timer,
}

/// The timers, and what simavr calls for each of them.
struct Timers {
    slots: Box<[TimerSlot]>,
    callback: ffi::avr_cycle_timer_t,
}

/// See the module.
pub(super) struct Base {
    pub core: Core,
    /// Time of the last reset: simavr counts from 0 again after each.
    last_reset: Cell<Cycles>,
    timers: OnceCell<Timers>,
    /// A callback that needs the run loop to look: a reset, a panic.
    attention: Cell<bool>,
    panic: Cell<Option<Box<dyn Any + Send>>>,
    originals: RefCell<Vec<(u16, WriteHandler)>>,
    violations: RefCell<Vec<Violation>>,
}

impl Base {
    /// A core without timers and hooks.
    pub fn new(chip: Chip) -> Result<Base> {
        Ok(Base {
            core: Core::new(chip)?,
            last_reset: Cell::new(0),
            timers: OnceCell::new(),
            attention: Cell::new(false),
            panic: Cell::new(None),
            originals: RefCell::default(),
            violations: RefCell::default(),
        })
    }

    /// Sets which timers there are. simavr calls `callback` with a pointer to a [`TimerSlot`] that lives as long as this.
    ///
    /// # Panics
    /// If two timers have the same name, or the timers were set before.
    pub fn set_timers(&self, timers: &[Timer], callback: ffi::avr_cycle_timer_t) {
        for (index, timer) in timers.iter().enumerate() {
            assert!(!timers[..index].contains(timer), "two timers are called {:?}", timer.0);
        }
        let context = self.core.context();
        let slots = timers.iter().map(|timer| TimerSlot { context, timer: *timer }).collect();
        assert!(self.timers.set(Timers { slots, callback }).is_ok(), "the timers are set twice");
    }

    /// simavr's callback of a timer and its parameter, by which simavr distinguishes timers.
    fn callback(&self, timer: Timer) -> (ffi::avr_cycle_timer_t, *mut c_void) {
        let timers = self.timers.get();
        let found = timers.and_then(|timers| {
            let slot: *const TimerSlot = timers.slots.iter().find(|slot| slot.timer == timer)?;
            Some((timers.callback, slot.cast_mut().cast()))
        });
        found.unwrap_or_else(|| panic!("timer {:?} is in no peripheral's list", timer.0))
    }

    /// Makes or replaces the date of a timer.
    pub fn schedule(&self, timer: Timer, at: Cycles) {
        let (callback, slot) = self.callback(timer);
        self.core.schedule(at.saturating_sub(self.last_reset.get()), callback, slot);
    }

    /// Forgets the date of a timer.
    pub fn unschedule(&self, timer: Timer) {
        let (callback, slot) = self.callback(timer);
        self.core.unschedule(callback, slot);
    }

    /// The time. It goes on through resets.
    pub fn now(&self) -> Cycles {
        self.time_of(self.core.cycle())
    }

    /// The time at which simavr's clock is at `cycle`.
    pub fn time_of(&self, cycle: u64) -> Cycles {
        self.last_reset.get() + cycle
    }

    /// Sets simavr's clock to 0, as a reset does; the time goes on.
    pub fn restart_clock(&self) {
        self.last_reset.set(self.now());
        self.core.set_cycle(0);
    }

    /// Notes a mistake of the program.
    pub fn violation(&self, text: &str) {
        let mut violations = self.violations.borrow_mut();
        if violations.len() < VIOLATIONS_KEPT {
            let text = format!("{text} (PC {:#06x})", self.core.pc());
            violations.push(Violation { at: self.now(), text });
        }
    }

    /// The violations since the last call.
    pub fn take_violations(&self) -> Vec<Violation> {
        self.violations.take()
    }

    /// Puts `handler` in front of simavr's write handler of a register.
    pub fn hook_write(&self, address: u16, handler: ffi::avr_io_write_t) {
        self.originals.borrow_mut().push((address, self.core.hook_write(address, handler)));
    }

    /// Lets simavr do its part of a write to a hooked register.
    pub fn forward(&self, address: u16, value: u8) {
        let original =
            self.originals.borrow().iter().find(|(hooked, _)| *hooked == address).map(|(_, handler)| *handler);
        if let Some(handler) = original {
            self.core.forward_write(handler, address, value);
        }
    }

    /// Runs a callback; carries a panic in it over simavr's frames to the run loop.
    pub fn guard<T>(&self, fallback: T, callback: impl FnOnce() -> T) -> T {
        catch_unwind(AssertUnwindSafe(callback)).unwrap_or_else(|panic| {
            self.panic.set(Some(panic));
            self.ask_for_attention();
            self.core.stop_soon();
            fallback
        })
    }

    /// Makes the next [`Base::take_attention`] true.
    pub fn ask_for_attention(&self) {
        self.attention.set(true);
    }

    /// True if a callback asked for attention since the last call. Goes on with a panic that [`Base::guard`] has caught.
    pub fn take_attention(&self) -> bool {
        let attention = self.attention.replace(false);
        if attention && let Some(panic) = self.panic.take() {
            std::panic::resume_unwind(panic);
        }
        attention
    }
}
