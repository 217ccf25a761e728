//! Starts of a program that no reset caused.

use std::cell::RefCell;

use super::base::Base;
use sim_base::Cycles;

/// Starts of a program: the beginning of the C library's start code, which clears SREG.
///
/// A jump to address 0, as through a null pointer, starts the program again, but resets no register
/// and sets no flag in MCUSR. It shows in the second run of the same start code.
#[derive(Default)]
pub(super) struct Starts {
    /// Addresses of the start code that ran since the last reset: that of a bootloader, and that
    /// of the application.
    since_reset: RefCell<Vec<u32>>,
    jumps: RefCell<Vec<Cycles>>,
}

/// `clr r1` and `out SREG, r1`, with which avr-libc's start code begins (gcrt1.S).
const START_CODE: [u16; 2] = [0x2411, 0xBE1F];

impl Starts {
    /// Times of the jumps to the start, after the first `seen` ones.
    pub fn jumps_after(&self, seen: usize) -> Vec<Cycles> {
        self.jumps.borrow().get(seen..).map(<[Cycles]>::to_vec).unwrap_or_default()
    }

    /// Handles a reset.
    pub fn reset(&self) {
        self.since_reset.borrow_mut().clear();
    }

    /// Handles a write of SREG by the present instruction.
    pub fn check(&self, base: &Base) {
        let pc = base.core.pc();
        if pc < 2
            || base.is_behind_erased()
            || START_CODE != [pc - 2, pc].map(|at| base.core.word(at))
        {
            return;
        }
        let mut since_reset = self.since_reset.borrow_mut();
        if since_reset.contains(&pc) {
            self.jumps.borrow_mut().push(base.now());
        } else {
            since_reset.push(pc);
        }
    }
}
