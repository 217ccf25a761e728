//! The program: the contents of flash and the symbols of an AVR ELF.

use std::collections::{BTreeMap, HashSet};
use std::fmt;

use anyhow::{Context, Result, bail, ensure};
use object::LittleEndian;
use object::elf::{EM_AVR, FileHeader32, PT_LOAD, SHT_SYMTAB, STT_FUNC, STT_OBJECT};
use object::read::elf::{FileHeader, ProgramHeader, Sym};

use crate::chip::{Chip, INTERRUPTS, vector};
use crate::opcode::Op;

/// How the symbols of the tables of virtual functions begin.
const VIRTUAL_TABLE: &str = "_ZTV";
/// Virtual addresses of the data space begin here in an AVR ELF.
const DATA_SPACE: u32 = 0x80_0000;

/// A byte address of flash, printed in hexadecimal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Address(pub u32);

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:#x}", self.0)
    }
}

/// An instruction of the program, with the address of the next one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Instruction {
    /// Its address in bytes.
    pub at: u32,
    /// What it does.
    pub op: Op,
}

impl Instruction {
    /// Address of the instruction behind it.
    pub fn next(self) -> u32 {
        self.at + self.op.bytes()
    }
}

/// A program in flash.
#[derive(Debug, Clone)]
pub struct Program {
    /// `None` where the ELF has nothing: there the flash can contain anything.
    flash: Vec<Option<u8>>,
    /// Named code: the names at each address, functions first.
    code: BTreeMap<u32, Symbol>,
    /// Every symbol with its value, for addresses of the data space and the linker's constants.
    values: BTreeMap<String, u32>,
    /// The tables of virtual functions.
    tables: Vec<Vec<u16>>,
    /// Where execution begins: 0, or the address of the boot section.
    pub entry: u32,
    /// The chip, which has the table of vectors.
    pub chip: Chip,
}

#[derive(Debug, Clone)]
struct Symbol {
    name: String,
    is_function: bool,
}

impl Program {
    /// Reads an ELF.
    ///
    /// # Errors
    /// If the file is no AVR ELF with code.
    pub fn from_elf(bytes: &[u8], chip: Chip) -> Result<Self> {
        let header = FileHeader32::<LittleEndian>::parse(bytes).context("not an ELF of 32 bits")?;
        let endian = header.endian().context("not little-endian")?;
        ensure!(header.e_machine(endian) == EM_AVR, "not for an AVR");
        let mut flash = Vec::new();
        // Where the initial values of variables are: addresses of the variables and of the flash.
        let mut initial = Vec::new();
        for segment in header.program_headers(endian, bytes).context("no segments")? {
            let from = segment.p_paddr(endian) as usize;
            if segment.p_type(endian) != PT_LOAD || segment.p_filesz(endian) == 0 {
                continue;
            }
            // Fuses, lock bits, EEPROM and signature are at higher addresses.
            if from >= DATA_SPACE as usize {
                continue;
            }
            let data = segment.data(endian, bytes).ok().context("a segment outside the file")?;
            let end = from + data.len();
            initial.push((segment.p_vaddr(endian), from as u32, data.len() as u32));
            ensure!(end <= chip.flash_bytes() as usize, "code up to {end:#x}, behind the flash");
            flash.resize(flash.len().max(end), None);
            for (byte, known) in flash[from..end].iter_mut().zip(data) {
                *byte = Some(*known);
            }
        }
        ensure!(!flash.is_empty(), "no code");
        let mut program = Self {
            flash,
            code: BTreeMap::new(),
            values: BTreeMap::new(),
            tables: Vec::new(),
            entry: header.e_entry(endian) & 0x1FFFF,
            chip,
        };
        let sections = header.sections(endian, bytes).context("no sections")?;
        let symbols =
            sections.symbols(endian, bytes, SHT_SYMTAB).context("no symbols: link without -s")?;
        for symbol in symbols.iter() {
            let name = symbols.symbol_name(endian, symbol).unwrap_or_default();
            let Ok(name) = std::str::from_utf8(name) else { continue };
            if name.starts_with(VIRTUAL_TABLE) {
                let (value, size) = (symbol.st_value(endian), symbol.st_size(endian));
                program.add_table(&initial, value, size);
            }
            if !name.is_empty() {
                let is_data = symbol.st_type() == STT_OBJECT;
                // Handlers in assembler often have no type.
                let is_function = symbol.st_type() == STT_FUNC || is_handler(name);
                program.add(name, symbol.st_value(endian), is_function, is_data);
            }
        }
        let mut before = program.flash.iter().take(program.entry as usize).flatten();
        if before.any(|byte| *byte != 0xFF) {
            program.entry = 0;
        }
        Ok(program)
    }

    /// A program of these bytes of flash, with the names of addresses. For tests and for files
    /// without symbols.
    pub fn from_flash(flash: Vec<u8>, functions: &[(&str, u32)], chip: Chip) -> Self {
        let (code, values) = (BTreeMap::new(), BTreeMap::new());
        let flash = flash.into_iter().map(Some).collect();
        let mut program = Self { flash, code, values, tables: Vec::new(), entry: 0, chip };
        for (name, address) in functions {
            program.add(name, *address, true, false);
        }
        program
    }

    /// Adds a table of virtual functions, whose contents are in flash.
    fn add_table(&mut self, initial: &[(u32, u32, u32)], value: u32, size: u32) {
        let inside = |(at, _, bytes): &&(u32, u32, u32)| (*at..at + bytes).contains(&value);
        let Some((at, flash, _)) = initial.iter().find(inside) else { return };
        let first = flash + (value - at);
        let words = (first..first + size).step_by(2).map_while(|at| self.word(at));
        let table = words.collect();
        self.tables.push(table);
    }

    /// The tables of virtual functions: an offset, a type, and word addresses of functions.
    pub fn virtual_tables(&self) -> &[Vec<u16>] {
        &self.tables
    }

    fn add(&mut self, name: &str, value: u32, is_function: bool, is_data: bool) {
        let demangled = format!("{:#}", rustc_demangle::demangle(name));
        self.values.insert(demangled.clone(), value);
        if is_data || value as usize >= self.flash.len() || name.starts_with(".L") {
            return;
        }
        // A linker's constant, such as the size of a region, has a value in the range of flash.
        if !is_function && (name.starts_with("__") && name.ends_with("__") || name.contains('$')) {
            return;
        }
        let new = Symbol { name: demangled, is_function };
        let old = self.code.entry(value).or_insert_with(|| new.clone());
        if is_function && !old.is_function {
            *old = new;
        }
    }

    /// Every address at which paths can meet: the targets of jumps, branches and skips, and the
    /// beginnings of functions. Constants in flash that look like jumps add further addresses,
    /// which does no harm.
    pub fn leaders(&self) -> HashSet<u32> {
        let mut leaders: HashSet<u32> = self.code.keys().copied().collect();
        leaders.insert(self.entry);
        leaders.extend((0..INTERRUPTS.len()).map(vector));
        for at in (0..self.flash.len() as u32).step_by(2) {
            let Ok(instruction) = self.instruction(at) else { continue };
            match instruction.op {
                Op::Rjmp(to) | Op::Jmp(to) | Op::Brbs(_, to) | Op::Brbc(_, to) => {
                    leaders.insert(to);
                }
                op if op.is_skip() => {
                    let skipped = self.instruction(instruction.next());
                    leaders.extend(skipped.map(Instruction::next));
                }
                _ => {}
            }
        }
        leaders
    }

    /// The first instruction behind the vector of the reset.
    pub fn start(&self) -> u32 {
        match self.instruction(self.entry).map(|first| first.op) {
            Ok(Op::Jmp(to) | Op::Rjmp(to)) => to,
            _ => self.entry,
        }
    }

    /// Value of a symbol; of one in the data space its address there.
    pub fn value(&self, name: &str) -> Option<u32> {
        let value = *self.values.get(name)?;
        Some(if value >= DATA_SPACE { value - DATA_SPACE } else { value })
    }

    /// True if a function begins at the address, by the symbols.
    pub fn is_function(&self, address: u32) -> bool {
        self.code.get(&address).is_some_and(|symbol| symbol.is_function)
    }

    /// Address of a function, by the name that [`Self::function_name`] prints.
    pub fn function_address(&self, name: &str) -> Option<u32> {
        let named = |(_, symbol): &(&u32, &Symbol)| short(&symbol.name) == name;
        self.code.iter().find(named).map(|(address, _)| *address)
    }

    /// Name of the function that contains the address, without its path; an address if there is
    /// none.
    pub fn function_name(&self, address: u32) -> String {
        if address == self.entry && !self.is_function(address) {
            return "start".into();
        }
        let before = |only_functions: bool| {
            let mut before = self.code.range(..=address).rev();
            before.find(|(_, symbol)| symbol.is_function || !only_functions)
        };
        let exact = self.code.get(&address).map(|symbol| (&address, symbol));
        match exact.or_else(|| before(true)).or_else(|| before(false)) {
            Some((_, symbol)) => short(&symbol.name),
            None => Address(address).to_string(),
        }
    }

    /// The address with the function that contains it, for messages.
    pub fn place(&self, address: u32) -> String {
        format!("{} in {}", Address(address), self.function_name(address))
    }

    /// A word of flash.
    pub fn word(&self, address: u32) -> Option<u16> {
        Some(u16::from_le_bytes([self.byte(address)?, self.byte(address + 1)?]))
    }

    /// A byte of flash, if the ELF has it.
    pub fn byte(&self, address: u32) -> Option<u8> {
        self.flash.get(address as usize).copied().flatten()
    }

    /// The instruction at an address.
    ///
    /// # Errors
    /// If the address is outside the program, or there is no instruction of this core.
    pub fn instruction(&self, at: u32) -> Result<Instruction> {
        let Some(first) = self.word(at).filter(|_| at.is_multiple_of(2)) else {
            bail!("{}: the program has no code there", Address(at))
        };
        let second = self.word(at + 2).unwrap_or(0xFFFF);
        let Some(op) = Op::decode(first, second, at) else {
            bail!("{}: {first:#06x} is no instruction of this core", self.place(at))
        };
        // Relative jumps wrap around the end of flash.
        let size = self.chip.flash_bytes();
        let op = match op {
            Op::Rjmp(to) => Op::Rjmp(to % size),
            Op::Rcall(to) => Op::Rcall(to % size),
            Op::Brbs(flag, to) => Op::Brbs(flag, to % size),
            Op::Brbc(flag, to) => Op::Brbc(flag, to % size),
            op => op,
        };
        Ok(Instruction { at, op })
    }
}

/// True for avr-libc's name of a handler, `__vector_` with a number.
fn is_handler(name: &str) -> bool {
    let number = name.strip_prefix("__vector_");
    number.is_some_and(|number| number.parse::<u8>().is_ok())
}

/// The name of a function with its type, but without crates, modules and generics, so that it is
/// the same in each build.
pub fn short(demangled: &str) -> String {
    if !demangled.starts_with('<') {
        return last_part(demangled);
    }
    // `<Type as Trait>::method::<T>` or `<Type>::method::<T>`.
    let mut depth = 0;
    let end = demangled.find(|letter| {
        depth += i32::from(letter == '<') - i32::from(letter == '>');
        depth == 0
    });
    let Some((of, method)) = end.map(|end| (&demangled[1..end], &demangled[end + 1..])) else {
        return demangled.into();
    };
    let own = without_generics(of);
    let own = own.split(" as ").next().unwrap_or(&own);
    format!("{}::{}", last_part(own), last_part(method))
}

/// The last part of a path.
fn last_part(path: &str) -> String {
    let plain = without_generics(path);
    let last = plain.trim_matches(':').rsplit("::").next();
    last.filter(|last| !last.is_empty()).unwrap_or(path).into()
}

fn without_generics(path: &str) -> String {
    let mut depth = 0;
    let keeps = |letter: &char| {
        let was_outside = depth == 0;
        depth += i32::from(*letter == '<') - i32::from(*letter == '>');
        was_outside && depth == 0
    };
    path.chars().filter(keeps).collect()
}

#[cfg(test)]
mod tests {
    use super::short;

    #[test]
    fn a_name_has_its_type_and_no_generics() {
        assert_eq!(short("app::bus::fetch"), "fetch");
        assert_eq!(short("app::store::read::<app::eeprom::Eeprom>"), "read");
        assert_eq!(short("<app::Monitor>::next_byte::<app::Image>"), "Monitor::next_byte");
        assert_eq!(short("<app::Spi as embedded_hal::spi::SpiBus>::read"), "Spi::read");
        assert_eq!(short("<driver::Driver<Spi, Output<'B': char, 1: u8>>>::poll"), "Driver::poll");
        assert_eq!(short("main"), "main");
    }
}
