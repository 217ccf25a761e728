//! Reads a firmware's ELF file: the contents of flash and EEPROM, and the symbols.
//!
//! The AVR tool chains give each memory its own range of addresses: flash from 0, SRAM from
//! 0x800000, EEPROM from 0x810000, fuses and lock bits above. A segment is loaded at its physical
//! address. So initialised data is in flash after the text, and the start-up code copies it from
//! there. Fuses and lock bits are not read.
//!
//! avr-gcc's linker writes the name of the device to the section `.note.gnu.avr.deviceinfo`.

use std::collections::HashMap;
use std::io;
use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use object::LittleEndian;
use object::elf::{EM_AVR, FileHeader32, PT_LOAD, STT_FUNC, STT_OBJECT};
use object::read::elf::{FileHeader, ProgramHeader, SectionHeader, Sym};

use super::chip::Chip;
use super::regs::RAMSTART;
use sim_base::{DEVICE_NOTE, device_of_note, thousands};

const SRAM_OFFSET: u32 = 0x80_0000;
const EEPROM_OFFSET: u32 = 0x81_0000;
const EEPROM_END: u32 = 0x82_0000;
const BOARD_SECTION: &[u8] = b".board";

/// The value of the line `key=value` in a section `.board`. A line without a value counts as
/// missing.
pub fn value_of<'a>(lines: &'a [u8], key: &str) -> Option<&'a str> {
    let lines = std::str::from_utf8(lines).ok()?.lines();
    lines
        .filter_map(|line| line.trim_matches('\0').split_once('='))
        .filter(|(name, _)| *name == key)
        .map(|(_, value)| value)
        .find(|value| !value.is_empty())
}

/// A symbol of the firmware. Data addresses are those of the program, without the tool chain's
/// 0x800000.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Symbol {
    /// Byte address in flash, SRAM or EEPROM.
    pub address: u32,
    /// Size in bytes, 0 if the ELF file does not say.
    pub size: u32,
}

/// The names of the functions or of the variables of a program, by address.
#[derive(Debug, Clone, Default)]
pub struct Names(Vec<(Range<u32>, String)>);

impl Names {
    fn add(&mut self, address: u32, size: u32, name: &str) {
        self.0.push((address..address.saturating_add(size), plain_name(name)));
    }

    fn sort(&mut self) {
        self.0.sort_by_key(|(range, _)| (range.start, range.end));
    }

    /// The name of what begins at or before an address.
    pub fn at(&self, address: u32) -> Option<&str> {
        let behind = self.0.partition_point(|(range, _)| range.start <= address);
        self.0[..behind].last().map(|(_, name)| name.as_str())
    }

    /// The names of what has a byte in `range`, the one with the most bytes there first.
    pub fn within(&self, range: Range<u32>) -> Vec<&str> {
        let bytes =
            |own: &Range<u32>| own.end.min(range.end).saturating_sub(own.start.max(range.start));
        let mut found: Vec<_> = self.0.iter().filter(|(own, _)| bytes(own) > 0).collect();
        found.sort_by_key(|(own, _)| std::cmp::Reverse(bytes(own)));
        found.into_iter().map(|(_, name)| name.as_str()).collect()
    }
}

/// The name in the source, without arguments, of a name as C++ and Rust mangle it: `depth` of
/// `_Z5depthi`, `Print::write` of `_ZN5Print5writeEPKc`. Others stay as they are.
fn plain_name(mangled: &str) -> String {
    let Some(rest) = mangled.strip_prefix("_Z") else { return mangled.to_owned() };
    let (mut rest, is_nested) = match rest.strip_prefix('N') {
        Some(rest) => (rest.trim_start_matches(['K', 'V']), true),
        None => (rest.trim_start_matches('L'), false),
    };
    let mut parts = Vec::new();
    while let Some((length, behind)) = rest
        .find(|c: char| !c.is_ascii_digit())
        .and_then(|digits| Some((rest[..digits].parse::<usize>().ok()?, &rest[digits..])))
    {
        let Some((part, behind)) = behind.split_at_checked(length) else { break };
        parts.push(part);
        rest = behind;
        if !is_nested {
            break;
        }
    }
    // Rust adds a hash.
    let is_hash = |part: &&str| part.len() == 17 && part.starts_with('h');
    parts.pop_if(|part| is_hash(&&**part));
    if parts.is_empty() { mangled.to_owned() } else { parts.join("::") }
}

/// A program for a chip.
#[derive(Debug, Default)]
pub struct Firmware {
    /// Pieces of flash and their byte addresses.
    pub flash: Vec<(usize, Vec<u8>)>,
    /// Pieces of EEPROM and their byte addresses.
    pub eeprom: Vec<(usize, Vec<u8>)>,
    /// All named symbols.
    pub symbols: HashMap<String, Symbol>,
    /// The device in the linker's note, such as "atmega328p".
    pub device: Option<String>,
    /// Functions by address.
    pub functions: Names,
    /// Variables by address.
    pub variables: Names,
    /// Bytes of RAM for variables.
    pub statics: u32,
    /// True if the file says how many they are: a HEX file does not.
    pub has_statics: bool,
    /// The section `.board` of programs of this project: lines `key=value`. The line "mcu" names
    /// the chip.
    pub board: Option<Vec<u8>>,
}

impl Firmware {
    /// Reads an ELF file.
    ///
    /// # Errors
    /// If the file is missing or is not an AVR executable.
    pub fn read(path: &Path) -> Result<Firmware> {
        if !path.exists() {
            let text = format!(
                "{} does not exist: is its name right? \"make firmware\" builds the node's",
                path.display()
            );
            return Err(io::Error::new(io::ErrorKind::NotFound, text).into());
        }
        let bytes = sim_base::read_file(path, sim_base::PROGRAM_BYTES)
            .with_context(|| format!("cannot read {}", path.display()))?;
        Firmware::parse(&bytes)
            .with_context(|| format!("{} is not a firmware for an AVR", path.display()))
    }

    /// Reads the bytes of an ELF file.
    ///
    /// # Errors
    /// If the bytes are not an AVR executable.
    pub fn parse(bytes: &[u8]) -> Result<Firmware> {
        ensure!(
            !bytes.starts_with(b":"),
            "it is an Intel HEX file; use the ELF file, which the compiler writes beside it"
        );
        let header =
            FileHeader32::<LittleEndian>::parse(bytes).context("it is not a 32-bit ELF file")?;
        let endian = header.endian()?;
        ensure!(
            header.e_machine(endian) == EM_AVR,
            "the ELF is for another processor than the AVR"
        );
        let mut firmware = Firmware { has_statics: true, ..Firmware::default() };
        for segment in header.program_headers(endian, bytes)? {
            if segment.p_type(endian) != PT_LOAD {
                continue;
            }
            let start = segment.p_vaddr(endian);
            if (SRAM_OFFSET..EEPROM_OFFSET).contains(&start) {
                let end = start.saturating_add(segment.p_memsz(endian)) - SRAM_OFFSET;
                firmware.statics = firmware.statics.max(end.saturating_sub(RAMSTART.into()));
            }
            if segment.p_filesz(endian) == 0 {
                continue;
            }
            let Ok(data) = segment.data(endian, bytes) else {
                bail!("a segment lies outside the file");
            };
            firmware.place(segment.p_paddr(endian), data)?;
        }
        ensure!(!firmware.flash.is_empty(), "nothing to load into flash");
        let sections = header.sections(endian, bytes)?;
        if let Some((_, note)) = sections.section_by_name(endian, DEVICE_NOTE) {
            let device = device_of_note(note.data(endian, bytes)?);
            firmware.device = device.map(|name| String::from_utf8_lossy(name).into_owned());
        }
        if let Some((_, section)) = sections.section_by_name(endian, BOARD_SECTION) {
            firmware.board = Some(section.data(endian, bytes)?.to_vec());
        }
        let symbols = sections.symbols(endian, bytes, object::elf::SHT_SYMTAB)?;
        for symbol in symbols.iter() {
            let name = symbol.name(endian, symbols.strings()).unwrap_or_default();
            if name.is_empty() {
                continue;
            }
            let name = String::from_utf8_lossy(name);
            let (value, size) = (symbol.st_value(endian), symbol.st_size(endian));
            let address = local_address(value);
            match (symbol.st_type(), value) {
                (STT_FUNC, 0..SRAM_OFFSET) => firmware.functions.add(address, size, &name),
                (STT_OBJECT, SRAM_OFFSET..EEPROM_OFFSET) => {
                    firmware.variables.add(address, size, &name);
                }
                _ => {}
            }
            firmware.symbols.insert(name.into_owned(), Symbol { address, size });
        }
        firmware.functions.sort();
        firmware.variables.sort();
        Ok(firmware)
    }

    /// The chip for which the program was built; `None` if the file does not say.
    ///
    /// # Errors
    /// If the simulator does not know the device.
    pub fn chip(&self) -> Result<Option<Chip>> {
        if let Some(name) = self.board.as_deref().and_then(|lines| value_of(lines, "mcu")) {
            return name
                .parse()
                .map(Some)
                .map_err(anyhow::Error::msg)
                .context("its section .board");
        }
        let Some(device) = &self.device else { return Ok(None) };
        let chip = Chip::of_device(device).with_context(|| {
            let names = Chip::ALL.map(Chip::name).join(" and ");
            format!(
                "the program is for an {device}, and the simulator has {names}: build it for one"
            )
        })?;
        Ok(Some(chip))
    }

    /// Checks that the program fits a chip.
    ///
    /// # Errors
    /// If the program does not fit; the message has the sizes, and names a chip that the program
    /// fits.
    pub fn check_fits(&self, chip: Chip) -> Result<()> {
        let end = |pieces: &[(usize, Vec<u8>)]| {
            pieces.iter().map(|(start, bytes)| start + bytes.len()).max().unwrap_or(0)
        };
        for (what, bytes, memory, capacity) in [
            (
                "code and initialised data",
                end(&self.flash),
                "flash",
                Chip::flash_bytes as fn(Chip) -> usize,
            ),
            ("data", end(&self.eeprom), "EEPROM", Chip::eeprom_bytes),
            ("variables", self.statics as usize, "RAM", Chip::ram_bytes),
        ] {
            if bytes <= capacity(chip) {
                continue;
            }
            let larger = Chip::ALL.into_iter().find(|chip| bytes <= capacity(*chip));
            let advice =
                larger.map(|larger| format!("; is it for an {larger}? --mcu {}", larger.name()));
            bail!(
                "{} bytes of {what} do not fit the {} bytes of {memory} of an {chip}{}",
                thousands(bytes),
                thousands(capacity(chip)),
                advice.unwrap_or_default()
            );
        }
        Ok(())
    }

    /// Start of the boot section for a program that is a bootloader, a byte address.
    ///
    /// # Errors
    /// If the program does not fit the chip, or no boot section can start at its first byte.
    pub fn boot_section(&self, chip: Chip) -> Result<usize> {
        self.check_fits(chip)?;
        let first = self.flash.iter().map(|(address, _)| *address).min().unwrap_or_default();
        if !chip.boot_sections().contains(&first) {
            let starts = chip.boot_sections().map(|start| format!("{start:#06x}")).join(", ");
            bail!("it begins at {first:#06x}; a bootloader of an {chip} begins at one of {starts}");
        }
        Ok(first)
    }

    fn place(&mut self, address: u32, data: &[u8]) -> Result<()> {
        let (memory, start) = match address {
            0..SRAM_OFFSET => (&mut self.flash, address),
            EEPROM_OFFSET..EEPROM_END => (&mut self.eeprom, address - EEPROM_OFFSET),
            SRAM_OFFSET..EEPROM_OFFSET => bail!("initialised data without a place in flash"),
            _ => return Ok(()),
        };
        memory.push((start as usize, data.to_vec()));
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
    fn a_hex_file_is_rejected_and_the_error_names_the_elf_file() {
        let error = Firmware::parse(b":100000000C94").unwrap_err();
        assert!(error.to_string().contains("use the ELF"), "{error:#}");
    }

    #[test]
    fn an_elf_file_for_another_processor_is_rejected() {
        let mut header = vec![0; 52];
        header[..7].copy_from_slice(b"\x7fELF\x01\x01\x01");
        header[16] = 2;
        header[18] = 40;
        header[20] = 1;
        let error = Firmware::parse(&header).unwrap_err();
        assert!(error.to_string().contains("another processor"), "{error:#}");
    }

    #[test]
    fn a_mangled_name_is_shown_as_in_the_source() {
        for (mangled, name) in [
            ("_Z5depthi", "depth"),
            ("_ZN5Print5writeEPKc", "Print::write"),
            ("_ZNK6String6lengthEv", "String::length"),
            ("_ZL7counter", "counter"),
            ("_ZN4node4main17h0123456789abcdefE", "node::main"),
            ("__vector_16", "__vector_16"),
            ("_ZTV6Stream", "_ZTV6Stream"),
            ("_Z99x", "_Z99x"),
        ] {
            assert_eq!(plain_name(mangled), name);
        }
    }

    #[track_caller]
    fn assert_rejected(firmware: &Firmware, chip: Chip, expected: &str) {
        assert_eq!(firmware.check_fits(chip).unwrap_err().to_string(), expected);
    }

    #[test]
    fn a_bootloader_must_begin_at_the_start_of_a_boot_section() {
        let loader = |address| Firmware { flash: vec![(address, vec![0])], ..Firmware::default() };
        assert_eq!(loader(0x3800).boot_section(Chip::Atmega168).unwrap(), 0x3800);
        assert_eq!(loader(0x7E00).boot_section(Chip::Atmega328p).unwrap(), 0x7E00);
        let error = |chip, address| loader(address).boot_section(chip).unwrap_err().to_string();
        assert!(
            error(Chip::Atmega168, 0).ends_with("begins at one of 0x3800, 0x3c00, 0x3e00, 0x3f00")
        );
        assert!(error(Chip::Atmega168, 0x7E00).ends_with("--mcu atmega328p"));
    }

    #[test]
    fn the_error_of_data_that_exceeds_a_memory_names_a_chip_that_they_fit() {
        let mut firmware = Firmware::default();
        firmware.place(0, &[0; 0x4000]).unwrap();
        firmware.place(EEPROM_OFFSET + 511, &[0]).unwrap();
        assert!(firmware.check_fits(Chip::Atmega168).is_ok());
        firmware.place(EEPROM_OFFSET + 512, &[0]).unwrap();
        let text = "513 bytes of data do not fit the 512 bytes of EEPROM of an ATmega168; is it \
                    for an ATmega328P? --mcu atmega328p";
        assert_rejected(&firmware, Chip::Atmega168, text);
        firmware.place(0x4000, &[0]).unwrap();
        let text = "16,385 bytes of code and initialised data do not fit the 16,384 bytes of \
                    flash of an ATmega168; is it for an ATmega328P? --mcu atmega328p";
        assert_rejected(&firmware, Chip::Atmega168, text);
        assert!(firmware.check_fits(Chip::Atmega328p).is_ok());
        firmware.place(0x8000, &[0]).unwrap();
        let text = "32,769 bytes of code and initialised data do not fit the 32,768 bytes of \
                    flash of an ATmega328P";
        assert_rejected(&firmware, Chip::Atmega328p, text);
    }

    #[test]
    fn the_chip_is_that_of_the_device_s_name() {
        let firmware =
            |device: &str| Firmware { device: Some(device.to_owned()), ..Firmware::default() };
        assert_eq!(firmware("atmega168p").chip().unwrap(), Some(Chip::Atmega168));
        assert_eq!(Firmware::default().chip().unwrap(), None);
        let error = firmware("atmega2560").chip().unwrap_err().to_string();
        assert!(
            error.contains("for an atmega2560, and the simulator has atmega168 and atmega328p"),
            "{error}"
        );
    }
}
