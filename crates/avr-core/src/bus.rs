//! What the core needs from the peripherals around it.

/// The time of the core, in cycles of the CPU clock since it was made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Clock {
    /// The present time. In a call of a [`Bus`] it is the start of the instruction. A bus adds the
    /// cycles for which it halts the CPU, as a write of the EEPROM or SPM does.
    pub now: u64,
    pub(crate) deadline: u64,
    pub(crate) attention: bool,
    /// Program counter in words, within the flash. It has 32 bits because the compiler (nightly of
    /// 2026-05-20) reads 32, and a processor waits if that is more than was stored last.
    pub(crate) pc: u32,
}

impl Clock {
    /// Byte address of the instruction that calls a [`Bus`].
    pub fn instruction(&self) -> u32 {
        self.pc.wrapping_sub(1).wrapping_mul(2)
    }

    /// Makes [`Core::run`](crate::Core::run) return after this instruction, with
    /// [`Stop::Attention`](crate::Stop::Attention).
    pub fn ask_for_attention(&mut self) {
        self.attention = true;
        self.deadline = 0;
    }

    /// Makes the core look for interrupts after this instruction, because one is pending now.
    pub fn check_interrupts(&mut self) {
        self.deadline = 0;
    }
}

/// An execution of SPM (DS40002198, SPM; DS40002061B, "Self-Programming the Flash").
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Spm {
    /// Byte address of the instruction.
    pub pc: u32,
    /// The Z pointer.
    pub z: u16,
    /// R1:R0, the word for the page buffer.
    pub word: u16,
}

/// The I/O registers and what else is outside of the core.
///
/// Addresses are those of the data space: I/O register 0 of IN and OUT is 0x20. A bus gets
/// addresses from 0x20 to 0xFF, but for SPL, SPH and SREG, which the core has itself, and addresses
/// above the SRAM, which the chip does not have.
pub trait Bus {
    /// A program reads a byte (IN, LD, LDS, POP, SBIC, SBIS).
    fn read(&mut self, address: u16, clock: &mut Clock) -> u8;

    /// A program writes a byte (OUT, ST, STS, PUSH).
    fn write(&mut self, address: u16, value: u8, clock: &mut Clock);

    /// SBI (`set`) or CBI changes the bits of `mask`, one bit, without a read of the others: SBI
    /// of a PINx toggles only this pin, and flags that a one clears keep theirs.
    fn write_bit(&mut self, address: u16, mask: u8, set: bool, clock: &mut Clock);

    /// Returns the vector of the pending, enabled interrupt of the highest priority, and clears its
    /// flag if the entry does that. Vector 1 is the first after RESET. The core calls this only if
    /// I is set and the entry follows: at the start of a run, after I was set, and after each call
    /// of [`Clock::check_interrupts`].
    fn take_interrupt(&mut self, clock: &mut Clock) -> Option<u8>;

    /// LPM reads `stored` at byte address `z`. Returns what the program gets.
    fn load_program_memory(&mut self, _z: u16, stored: u8, _clock: &mut Clock) -> u8 {
        stored
    }

    /// SPM. [`Core::write_flash`](crate::Core::write_flash) changes the flash after the run.
    fn store_program_memory(&mut self, _spm: Spm, _clock: &mut Clock) {}

    /// A program wrote SREG, which has its new value.
    fn status_written(&mut self, _clock: &mut Clock) {}

    /// SLEEP. True if the chip sleeps: the bit SE of SMCR is set.
    fn sleep(&mut self, _clock: &mut Clock) -> bool {
        false
    }

    /// WDR: resets the watchdog.
    fn reset_watchdog(&mut self, _clock: &mut Clock) {}

    /// BREAK: nothing happens without a debugger.
    fn break_point(&mut self, _clock: &mut Clock) {}

    /// The stack is below its mark, and `sp` is the new mark: see
    /// [`Core::set_stack_mark`](crate::Core::set_stack_mark). `is_set_by_hand` if SPH was written
    /// after SPL. Programs with several stacks do so; compilers, which make room for local
    /// variables, write SPH first.
    fn stack_below_mark(&mut self, _sp: u16, _is_set_by_hand: bool, _clock: &mut Clock) {}

    /// Byte address of the vector table: 0, or the start of the boot section if IVSEL is set.
    fn vector_table(&self) -> u32 {
        0
    }
}

/// A bus whose I/O registers are memory, without interrupts. For tests and programs that only
/// calculate.
#[derive(Debug, Clone)]
pub struct NoPeripherals {
    /// The registers by their address in the data space.
    pub io: [u8; 0x100],
}

impl Default for NoPeripherals {
    fn default() -> Self {
        Self { io: [0; 0x100] }
    }
}

impl Bus for NoPeripherals {
    fn read(&mut self, address: u16, _clock: &mut Clock) -> u8 {
        self.io.get(usize::from(address)).copied().unwrap_or(0)
    }

    fn write(&mut self, address: u16, value: u8, _clock: &mut Clock) {
        if let Some(register) = self.io.get_mut(usize::from(address)) {
            *register = value;
        }
    }

    fn write_bit(&mut self, address: u16, mask: u8, set: bool, clock: &mut Clock) {
        let old = self.read(address, clock);
        self.write(address, if set { old | mask } else { old & !mask }, clock);
    }

    fn take_interrupt(&mut self, _clock: &mut Clock) -> Option<u8> {
        None
    }
}
