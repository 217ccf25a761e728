//! What executes the program: [`Core`] has one of two engines, and the models of the peripherals
//! use it without knowing which.
//!
//! An engine has the instructions, the interrupts, the ports with INT0, INT1 and pin changes, the
//! ADC, and the watchdog without its oscillator. The two have these from different hands, so that
//! one judges the other. Reads and writes of registers here have no side effects.

use std::ops::Range;

use super::chip::Chip;
pub(super) use super::engine::{Access, Activity, Engine, Vector};
use super::own::Own;
use super::simavr::Simavr;
use anyhow::Result;

/// The engine of a chip.
pub(super) enum Core {
    Own(Box<Own>),
    Simavr(Box<Simavr>),
}

/// Gives the methods that every engine has to the macro `$with`.
macro_rules! methods {
    ($with:ident) => {
        $with! {
            /// The type of the chip.
            fn chip() -> Chip;
            /// The engine's clock in cycles.
            fn cycle() -> u64;
            /// Sets the engine's clock: halts the CPU if it is later than the present time.
            fn set_cycle(cycle: u64);
            /// One byte of the data space (registers, I/O, SRAM).
            fn get(address: u16) -> u8;
            /// Sets one byte of the data space.
            fn set(address: u16, value: u8);
            /// A range of the flash.
            fn flash(range: Range<usize>) -> Vec<u8>;
            /// Copies bytes into flash.
            fn write_flash(address: usize, bytes: &[u8]);
            /// The word of flash at a byte address, or 0 beyond the end of the flash.
            fn word(address: u32) -> u16;
            /// Program counter as a byte address; in the middle of an instruction, that of the
            /// instruction.
            fn pc() -> u32;
            /// Sets the program counter, a byte address.
            fn set_pc(address: u32);
            /// Status register.
            fn sreg() -> u8;
            /// Sets the status register.
            fn set_sreg(value: u8);
            /// Sets the byte address at which the program starts after a reset.
            fn set_reset_pc(address: u32);
            /// True if the I flag of SREG is set.
            fn interrupts_enabled() -> bool;
            /// State of the core.
            fn activity() -> Activity;
            /// Sets the state of the core.
            fn set_activity(activity: Activity);
            /// Lets the run loop run one instruction only.
            fn run_singly();
            /// Sets an interrupt's flag, and requests it if it is enabled.
            fn raise(vector: Vector);
            /// Clears an interrupt's flag and its request.
            fn clear(vector: Vector);
            /// Removes an interrupt's request.
            fn withdraw(vector: Vector);
            /// Sets the length of the watchdog's next time-out in CPU cycles. A time-out that runs
            /// does not change.
            fn set_watchdog_cycles(cycles: u64);
            /// Restarts the watchdog's time-out, as WDR does.
            fn restart_watchdog();
        }
    };
}

/// Calls the same method of either engine.
macro_rules! of_both {
    ($($(#[$doc:meta])* fn $name:ident($($argument:ident: $type:ty),*) $(-> $result:ty)?;)*) => {
        impl Core {
            $($(#[$doc])* #[inline]
            pub fn $name(&self $(, $argument: $type)*) $(-> $result)? {
                match self {
                    Core::Own(own) => own.$name($($argument),*),
                    Core::Simavr(simavr) => simavr.$name($($argument),*),
                }
            })*
        }
    };
}

methods!(of_both);

impl Core {
    /// A chip with erased flash, all supplies at 5 V.
    pub fn new(engine: Engine, chip: Chip) -> Result<Core> {
        Ok(match engine {
            Engine::Own => Core::Own(Box::new(Own::new(chip))),
            Engine::Simavr => Core::Simavr(Box::new(Simavr::new(chip)?)),
        })
    }

    /// The engine simavr, if the chip has it.
    pub fn simavr(&self) -> Option<&Simavr> {
        match self {
            Core::Own(_) => None,
            Core::Simavr(simavr) => Some(simavr),
        }
    }

    /// Sets the bits of `mask` in a register.
    pub fn set_bits(&self, address: u16, mask: u8) {
        self.set(address, self.get(address) | mask);
    }

    /// Clears the bits of `mask` in a register.
    pub fn clear_bits(&self, address: u16, mask: u8) {
        self.set(address, self.get(address) & !mask);
    }

    /// First word of the instruction at the program counter. While an instruction runs, it is that
    /// instruction.
    pub fn opcode(&self) -> u16 {
        self.word(self.pc())
    }
}
