//! Tracing, for profilers: calls a tracer before each instruction.
//!
//! With a tracer the core runs instruction by instruction; otherwise the run loop tests one flag.

use std::cell::{Cell, RefCell};

use super::base::Base;
use super::regs;
use sim_base::Cycles;

/// A function that is called before each instruction.
pub type Tracer = Box<dyn FnMut(&Moment)>;

/// The chip between two instructions. Reading it has no side effects.
pub struct Moment<'a> {
    base: &'a Base,
}

impl Moment<'_> {
    /// Simulated time, in cycles of the chip.
    pub fn at(&self) -> Cycles {
        self.base.now()
    }

    /// Byte address of the next instruction.
    pub fn pc(&self) -> u32 {
        self.base.core.pc()
    }

    /// Stack pointer. It has a wrong value between the writes of its two halves.
    pub fn sp(&self) -> u16 {
        u16::from_le_bytes([self.data(regs::SPL), self.data(regs::SPH)])
    }

    /// True if the I flag of SREG is set.
    pub fn interrupts_enabled(&self) -> bool {
        self.base.core.interrupts_enabled()
    }

    /// A byte of the data space: registers, I/O or SRAM.
    pub fn data(&self, address: u16) -> u8 {
        self.base.core.get(address)
    }
}

/// The tracer's part of the run loop.
#[derive(Default)]
pub(super) struct Trace {
    tracer: RefCell<Option<Tracer>>,
    tracing: Cell<bool>,
}

impl Trace {
    /// Sets the tracer, or ends tracing.
    pub fn set(&self, tracer: Option<Tracer>) {
        self.tracing.set(tracer.is_some());
        self.tracer.replace(tracer);
    }

    /// True if the run loop must call [`Trace::before_instruction`] before each instruction.
    #[inline]
    pub fn is_on(&self) -> bool {
        self.tracing.get()
    }

    /// Calls the tracer for the next instruction, and lets the core run only that one.
    pub fn before_instruction(&self, base: &Base) {
        if let Some(tracer) = self.tracer.borrow_mut().as_mut() {
            tracer(&Moment { base });
        }
        base.core.run_singly();
    }
}
