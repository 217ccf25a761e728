//! Reads a firmware ELF: what goes to flash and EEPROM, and where the symbols are.
//!
//! The AVR tool chains give each memory its own range of addresses: flash from 0, SRAM from
//! 0x800000, EEPROM from 0x810000, fuses and lock bits above. A segment is loaded at its physical
//! address, so that initialised data lands in flash behind the text, from where the start-up code
//! copies it. Fuses and lock bits are not read.

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use object::LittleEndian;
use object::elf::{EM_AVR, FileHeader32, PT_LOAD};
use object::read::elf::{FileHeader, ProgramHeader, Sym};

use super::regs::{EEPROM_BYTES, FLASH_BYTES};

const SRAM_OFFSET: u32 = 0x80_0000;
const EEPROM_OFFSET: u32 = 0x81_0000;
const EEPROM_END: u32 = 0x82_0000;

/// A symbol of the firmware. Data addresses are those the program uses, without the tool chain's
/// 0x800000.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Symbol {
    /// Byte address in flash, SRAM or EEPROM.
    pub address: u32,
    /// Size in bytes, 0 if the ELF does not say.
    pub size: u32,
}

/// What an ELF file holds for the chip.
#[derive(Debug, Default)]
pub struct Firmware {
    /// Pieces of flash and their byte addresses.
    pub flash: Vec<(usize, Vec<u8>)>,
    /// Pieces of EEPROM and their byte addresses.
    pub eeprom: Vec<(usize, Vec<u8>)>,
    /// All named symbols.
    pub symbols: HashMap<String, Symbol>,
}

impl Firmware {
    /// Reads the file.
    ///
    /// # Errors
    /// If the file is missing, is not an AVR executable, or does not fit an ATmega168.
    pub fn read(path: &Path) -> Result<Firmware> {
        if !path.exists() {
            bail!("{} does not exist: run \"make firmware\" first", path.display());
        }
        let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        Firmware::parse(&bytes).with_context(|| format!("{} is not a firmware for the ATmega168", path.display()))
    }

    /// Reads the bytes of an ELF file.
    ///
    /// # Errors
    /// As [`Firmware::read`].
    pub fn parse(bytes: &[u8]) -> Result<Firmware> {
        let header = FileHeader32::<LittleEndian>::parse(bytes).context("no 32-bit ELF file")?;
        let endian = header.endian()?;
        ensure!(header.e_machine(endian) == EM_AVR, "the ELF is for another processor than the AVR");
        let mut firmware = Firmware::default();
        for segment in header.program_headers(endian, bytes)? {
            if segment.p_type(endian) != PT_LOAD || segment.p_filesz(endian) == 0 {
                continue;
            }
            let Ok(data) = segment.data(endian, bytes) else {
                bail!("a segment lies outside the file");
            };
            firmware.place(segment.p_paddr(endian), data)?;
        }
        ensure!(!firmware.flash.is_empty(), "nothing to load into flash");
        let sections = header.sections(endian, bytes)?;
        let symbols = sections.symbols(endian, bytes, object::elf::SHT_SYMTAB)?;
        for symbol in symbols.iter() {
            let name = symbol.name(endian, symbols.strings()).unwrap_or_default();
            if !name.is_empty() {
                let found = Symbol { address: local_address(symbol.st_value(endian)), size: symbol.st_size(endian) };
                firmware.symbols.insert(String::from_utf8_lossy(name).into_owned(), found);
            }
        }
        Ok(firmware)
    }

    fn place(&mut self, address: u32, data: &[u8]) -> Result<()> {
        let (memory, start, capacity, name) = match address {
            0..SRAM_OFFSET => (&mut self.flash, address, FLASH_BYTES, "flash"),
            EEPROM_OFFSET..EEPROM_END => (&mut self.eeprom, address - EEPROM_OFFSET, EEPROM_BYTES, "EEPROM"),
            SRAM_OFFSET..EEPROM_OFFSET => bail!("initialised data without a place in flash"),
            _ => return Ok(()),
        };
        let start = start as usize;
        ensure!(
            start + data.len() <= capacity,
            "{} bytes at {start:#x} do not fit the {capacity} bytes of {name}",
            data.len()
        );
        memory.push((start, data.to_vec()));
        Ok(())
    }
}

fn local_address(address: u32) -> u32 {
    match address {
        EEPROM_OFFSET..EEPROM_END => address - EEPROM_OFFSET,
        SRAM_OFFSET..EEPROM_OFFSET => address - SRAM_OFFSET,
        _ => address,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_file_points_to_make_firmware() {
        let error = Firmware::read(Path::new("/nonexistent/node.elf")).unwrap_err();
        assert!(error.to_string().contains("make firmware"), "{error}");
    }

    #[test]
    fn a_file_that_is_no_elf_is_refused() {
        assert!(Firmware::parse(b"no ELF at all").is_err());
    }

    #[test]
    fn an_elf_for_another_processor_is_refused() {
        let mut header = vec![0; 52];
        header[..7].copy_from_slice(b"\x7fELF\x01\x01\x01");
        header[16] = 2;
        header[18] = 40;
        header[20] = 1;
        let error = Firmware::parse(&header).unwrap_err();
        assert!(error.to_string().contains("another processor"), "{error:#}");
    }

    #[test]
    fn data_that_exceeds_a_memory_is_refused() {
        let mut firmware = Firmware::default();
        assert!(firmware.place(0, &[0; FLASH_BYTES]).is_ok());
        assert!(firmware.place(1, &[0; FLASH_BYTES]).is_err());
        assert!(firmware.place(EEPROM_OFFSET + 511, &[0]).is_ok());
        assert!(firmware.place(EEPROM_OFFSET + 512, &[0]).is_err());
    }
}
