#![doc = include_str!("../README.md")]
//! # Limits
//!
//! The program counter wraps at the end of the flash. SPH keeps all eight bits. What the manual
//! calls undefined (LD and ST of a half of the pointer that they change) has the order of the
//! operation here: a load overwrites the changed pointer, a store stores the half as it was. Any
//! write that changes I from 0 to 1 delays interrupts by one instruction, as SEI does; SEI while I
//! is 1 does not. Whether the program may execute or read flash that is being programmed is for the
//! [`Bus`].

#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

mod bus;
mod decode;
mod execute;
mod flags;
pub mod opcode;
mod table;
#[cfg(test)]
mod tests;

use alloc::vec;
use alloc::vec::Vec;
use core::fmt;

pub use bus::{Bus, Clock, NoPeripherals, Spm};
use table::Entry;

/// Number of entries of the table: the words of the larger flash.
const TABLE: usize = 0x4000;
/// First address of the SRAM.
const RAM_START: u16 = 0x0100;
/// Size of the array for the data space, a power of two above the SRAM of both chips.
const DATA_BYTES: usize = 0x1000;

/// The sizes of the memories.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Chip {
    /// 16 KiB of flash, 1 KiB of SRAM.
    ATmega168,
    /// 32 KiB of flash, 2 KiB of SRAM.
    ATmega328P,
}

impl Chip {
    /// Size of the flash in bytes.
    pub fn flash_bytes(self) -> usize {
        match self {
            Self::ATmega168 => 0x4000,
            Self::ATmega328P => 0x8000,
        }
    }

    /// Last address of the SRAM.
    pub fn ram_end(self) -> u16 {
        match self {
            Self::ATmega168 => 0x04FF,
            Self::ATmega328P => 0x08FF,
        }
    }
}

/// Why a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// The time was reached. The last instruction can end after it.
    Deadline,
    /// The bus called [`Clock::ask_for_attention`].
    Attention,
    /// The chip sleeps, and no interrupt is pending. The time has not advanced to the deadline:
    /// the caller advances `clock.now` to its next event.
    Asleep,
}

/// The program reached an opcode that the chip does not have. The program counter stays there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InvalidOpcode {
    /// Byte address.
    pub address: u32,
    /// The first word.
    pub opcode: u16,
}

impl fmt::Display for InvalidOpcode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { address, opcode } = self;
        write!(f, "{opcode:#06x} at {address:#06x} is no instruction of this chip")
    }
}

impl core::error::Error for InvalidOpcode {}

/// The processor, its flash and its SRAM.
pub struct Core {
    /// R0 to R31, which are also the data addresses 0 to 31.
    pub registers: [u8; 32],
    /// Status register, I in bit 7 to C in bit 0.
    pub sreg: u8,
    /// Stack pointer.
    pub sp: u16,
    /// The time.
    pub clock: Clock,
    chip: Chip,
    pc_mask: u16,
    ram_bytes: u16,
    /// The stack pointer below which the bus is called.
    mark: u16,
    /// The lowest byte of the SRAM that can be pushed without passing the mark.
    stack_floor: u16,
    /// Bytes of the SRAM from there on.
    stack_room: u16,
    /// True if SPH was written after SPL.
    is_sp_set_by_hand: bool,
    is_asleep: bool,
    /// One instruction is executed before interrupts, after SEI and RETI.
    holds_interrupts: bool,
    table: [Entry; TABLE],
    flash: Vec<u8>,
    /// The data space; only the SRAM's part is used.
    data: [u8; DATA_BYTES],
}

impl Core {
    /// A core after a reset, with erased flash and zeros in registers and SRAM.
    pub fn new(chip: Chip) -> Self {
        Self {
            registers: [0; 32],
            sreg: 0,
            sp: chip.ram_end(),
            clock: Clock::default(),
            chip,
            pc_mask: (chip.flash_bytes() / 2 - 1) as u16,
            ram_bytes: chip.ram_end() - RAM_START + 1,
            mark: chip.ram_end(),
            stack_floor: chip.ram_end() + 1,
            stack_room: 0,
            is_sp_set_by_hand: false,
            is_asleep: false,
            holds_interrupts: false,
            table: [Entry::new(0xFFFF, 0xFFFF); TABLE],
            flash: vec![0xFF; chip.flash_bytes()],
            data: [0; DATA_BYTES],
        }
    }

    /// Resets the core to the byte address `start`: the reset vector or the boot section. SREG is
    /// 0, SP the end of the SRAM. Registers, SRAM and time stay.
    pub fn reset(&mut self, start: u32) {
        self.sreg = 0;
        self.sp = self.chip.ram_end();
        self.is_sp_set_by_hand = false;
        self.is_asleep = false;
        self.holds_interrupts = false;
        self.set_pc(start);
    }

    /// The type of the chip.
    pub fn chip(&self) -> Chip {
        self.chip
    }

    /// Program counter, as a byte address.
    pub fn pc(&self) -> u32 {
        self.clock.pc * 2
    }

    /// Sets the program counter to a byte address, which wraps at the end of the flash.
    pub fn set_pc(&mut self, address: u32) {
        self.clock.pc = (address / 2) & u32::from(self.pc_mask);
    }

    /// Sets the mark of the stack. When a push, a call, an interrupt or a write of SPL makes the
    /// stack pointer lower, the core calls [`Bus::stack_below_mark`], and the mark is there. So a
    /// mark that is set once is the lowest stack pointer so far. It costs no time above the mark.
    pub fn set_stack_mark(&mut self, sp: u16) {
        self.mark = sp;
        self.stack_floor = sp.saturating_add(1).clamp(RAM_START, self.chip.ram_end() + 1);
        self.stack_room = self.chip.ram_end() + 1 - self.stack_floor;
    }

    /// The mark of the stack, at first the end of the SRAM.
    pub fn stack_mark(&self) -> u16 {
        self.mark
    }

    /// True if the chip sleeps.
    pub fn is_asleep(&self) -> bool {
        self.is_asleep
    }

    /// All of flash.
    pub fn flash(&self) -> &[u8] {
        &self.flash
    }

    /// Writes bytes of flash and decodes them anew. Bytes beyond the flash are ignored.
    pub fn write_flash(&mut self, address: usize, bytes: &[u8]) {
        let start = address.min(self.flash.len());
        let end = start.saturating_add(bytes.len()).min(self.flash.len());
        self.flash[start..end].copy_from_slice(&bytes[..end - start]);
        // The word before can be the first of an instruction of two words.
        let words = self.flash.len() / 2;
        let last = (start == 0).then_some(words - 1);
        for word in last.into_iter().chain((start / 2).saturating_sub(1)..end.div_ceil(2)) {
            let entry = Entry::new(self.word(word), self.word(word + 1));
            // The smaller flash fills the table twice, because the program counter wraps.
            self.table[word..].iter_mut().step_by(words).for_each(|place| *place = entry);
        }
    }

    /// A word of flash by its word address, which wraps.
    fn word(&self, word: usize) -> u16 {
        let at = word * 2 % self.flash.len();
        u16::from_le_bytes([self.flash[at], self.flash[at + 1]])
    }

    /// The SRAM. Its first byte has the data address 0x0100.
    pub fn ram(&self) -> &[u8] {
        &self.data[usize::from(RAM_START)..=usize::from(self.chip.ram_end())]
    }

    /// The SRAM, for changes.
    pub fn ram_mut(&mut self) -> &mut [u8] {
        &mut self.data[usize::from(RAM_START)..=usize::from(self.chip.ram_end())]
    }
}
