//! The chips: sizes of memory, and the interrupts with their vectors and enable bits.
//!
//! Sources: ATmega48/88/168 datasheet 2545, sections 7, 8 and 11, and ATmega328P datasheet 7810.
//! Both chips have the same peripherals. A vector has two words.

use std::str::FromStr;

use anyhow::{Context, Error, Result, bail};
use object::LittleEndian;
use object::elf::FileHeader32;
use object::read::elf::{FileHeader, SectionHeader};

/// A chip that the analysis knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Chip {
    /// ATmega168: 16 KiB of flash, 1 KiB of RAM.
    Atmega168,
    /// ATmega328P: 32 KiB of flash, 2 KiB of RAM.
    Atmega328p,
}

impl Chip {
    /// The name, as the compilers have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Atmega168 => "atmega168",
            Self::Atmega328p => "atmega328p",
        }
    }

    /// The chip that an ELF names; `None` if it names none.
    ///
    /// # Errors
    /// If the ELF cannot be read, or is for another chip.
    pub fn of_elf(elf: &[u8]) -> Result<Option<Self>> {
        let header = FileHeader32::<LittleEndian>::parse(elf).context("not an ELF of 32 bits")?;
        let endian = header.endian().context("not little-endian")?;
        let sections = header.sections(endian, elf).context("no sections")?;
        let Some((_, section)) = sections.section_by_name(endian, DEVICE_NOTE) else {
            return Ok(None);
        };
        let note = section.data(endian, elf).context("a section outside the file")?;
        let name = device_of_note(note).and_then(|name| str::from_utf8(name).ok());
        name.map(str::parse).transpose()
    }

    /// Bytes of flash.
    pub fn flash_bytes(self) -> u32 {
        match self {
            Self::Atmega168 => 0x4000,
            Self::Atmega328p => 0x8000,
        }
    }

    /// Address of the last byte of RAM, in the data space. A reset sets SP to it.
    pub fn ram_end(self) -> u16 {
        match self {
            Self::Atmega168 => 0x4FF,
            Self::Atmega328p => 0x8FF,
        }
    }
}

impl FromStr for Chip {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        match name.to_lowercase().as_str() {
            "atmega168" | "atmega168a" | "atmega168p" | "atmega168pa" => Ok(Self::Atmega168),
            "atmega328" | "atmega328p" => Ok(Self::Atmega328p),
            _ => bail!("{name}: the analysis knows atmega168 and atmega328p only"),
        }
    }
}

/// Name of the section with [the note](device_of_note).
const DEVICE_NOTE: &[u8] = b".note.gnu.avr.deviceinfo";

/// The name of the device in the note of an ELF. The note has the name "AVR", the addresses and
/// sizes of three memories, a table of offsets, and texts. The first offset is that of the device's
/// name (binutils, include/elf/avr.h). `None` if the note is cut or the name is empty.
fn device_of_note(note: &[u8]) -> Option<&[u8]> {
    const TABLE_BYTES_AT: usize = 40;
    const TABLE_AT: usize = 44;
    let word =
        |at: usize| Some(u32::from_le_bytes(note.get(at..at + 4)?.try_into().ok()?) as usize);
    let texts = TABLE_BYTES_AT.checked_add(word(TABLE_BYTES_AT)?)?;
    let text = note.get(texts.checked_add(word(TABLE_AT)?)?..)?;
    text.split(|byte| *byte == 0).next().filter(|name| !name.is_empty())
}

/// First address of RAM behind the registers, in the data space.
pub const RAM_START: u16 = 0x100;

/// Addresses of registers in the data space. I/O addresses are lower by 0x20.
pub mod register {
    /// SPI data register.
    pub const SPDR: u16 = 0x4E;
    /// Control register of the core, with IVSEL.
    pub const MCUCR: u16 = 0x55;
    /// Stack pointer, low byte.
    pub const SPL: u16 = 0x5D;
    /// Stack pointer, high byte.
    pub const SPH: u16 = 0x5E;
    /// Status register.
    pub const SREG: u16 = 0x5F;
}

/// An interrupt.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interrupt {
    /// Name in the datasheet.
    pub name: &'static str,
    /// The register with its enable bit, in the data space, and the bit.
    pub enable: (u16, u8),
}

/// The interrupts in the order of their vectors, from vector 1.
pub const INTERRUPTS: [Interrupt; 25] = [
    Interrupt { name: "INT0", enable: (0x3D, 0) },
    Interrupt { name: "INT1", enable: (0x3D, 1) },
    Interrupt { name: "PCINT0", enable: (0x68, 0) },
    Interrupt { name: "PCINT1", enable: (0x68, 1) },
    Interrupt { name: "PCINT2", enable: (0x68, 2) },
    Interrupt { name: "WDT", enable: (0x60, 6) },
    Interrupt { name: "TIMER2_COMPA", enable: (0x70, 1) },
    Interrupt { name: "TIMER2_COMPB", enable: (0x70, 2) },
    Interrupt { name: "TIMER2_OVF", enable: (0x70, 0) },
    Interrupt { name: "TIMER1_CAPT", enable: (0x6F, 5) },
    Interrupt { name: "TIMER1_COMPA", enable: (0x6F, 1) },
    Interrupt { name: "TIMER1_COMPB", enable: (0x6F, 2) },
    Interrupt { name: "TIMER1_OVF", enable: (0x6F, 0) },
    Interrupt { name: "TIMER0_COMPA", enable: (0x6E, 1) },
    Interrupt { name: "TIMER0_COMPB", enable: (0x6E, 2) },
    Interrupt { name: "TIMER0_OVF", enable: (0x6E, 0) },
    Interrupt { name: "SPI_STC", enable: (0x4C, 7) },
    Interrupt { name: "USART_RX", enable: (0xC1, 7) },
    Interrupt { name: "USART_UDRE", enable: (0xC1, 5) },
    Interrupt { name: "USART_TX", enable: (0xC1, 6) },
    Interrupt { name: "ADC", enable: (0x7A, 3) },
    Interrupt { name: "EE_READY", enable: (0x3F, 3) },
    Interrupt { name: "ANALOG_COMP", enable: (0x50, 3) },
    Interrupt { name: "TWI", enable: (0xBC, 0) },
    Interrupt { name: "SPM_READY", enable: (0x57, 7) },
];

/// Byte address of the vector of an interrupt, an index of [`INTERRUPTS`].
pub fn vector(index: usize) -> u32 {
    4 * (index as u32 + 1)
}
