//! What a profiler sees of the chip: each instruction before it runs.
//!
//! While somebody traces, the core runs instruction by instruction; otherwise the run loop tests one flag.

use std::cell::{Cell, RefCell};

use super::base::Base;
use super::regs;
use sim_base::Cycles;

/// Is called before each instruction.
pub type Tracer = Box<dyn FnMut(&Moment)>;

/// The chip between two instructions. Looking has no side effect.
pub struct Moment<'a> {
    base: &'a Base,
}

impl Moment<'_> {
    /// The time.
    pub fn at(&self) -> Cycles {
        self.base.now()
    }

    /// Byte address of the next instruction.
    pub fn pc(&self) -> u32 {
        self.base.core.pc()
    }

    /// Stack pointer. A program that writes its two halves one after the other is seen in between, too.
    pub fn sp(&self) -> u16 {
        u16::from_le_bytes([self.data(regs::SPL), self.data(regs::SPH)])
    }

    /// A byte of the data space: registers, I/O or SRAM.
    pub fn data(&self, address: u16) -> u8 {
        self.base.core.get(address)
    }
}

/// The part of the run loop that looks after a tracer.
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

    /// Whether [`Trace::instruction`] must be called before each instruction.
    #[inline]
    pub fn is_on(&self) -> bool {
        self.tracing.get()
    }

    /// Shows the next instruction, and lets the core run that one only.
    pub fn instruction(&self, base: &Base) {
        if let Some(tracer) = self.tracer.borrow_mut().as_mut() {
            tracer(&Moment { base });
        }
        base.core.run_singly();
    }
}
