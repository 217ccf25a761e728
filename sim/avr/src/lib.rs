//! An ATmega168 or ATmega328P at 16 MHz, simulated by simavr and corrected where the datasheet says otherwise.
//!
//! [`Avr`] runs a program up to a given time and lets a board around it drive and watch its pins,
//! be its SPI device, talk to its serial port, and feed its ADC. Time is counted from the start of
//! the simulation and goes on through resets.
//!
//! Modules. Each imports only modules further down:
//!
//! ```text
//! Avr (this file)
//! debugger               a debugger's access to the machine
//! machine                the run loop, resets, simavr's callbacks
//! ├─ peripherals
//! │  ├─ spi, uart, nvm   replace simavr's models (nvm: eeprom, spm)
//! │  ├─ timer1           the waveforms of OC1A and OC1B; simavr keeps the interrupts
//! │  ├─ extint           edges of INT0 and INT1 that come while masked, which simavr forgets
//! │  └─ watchdog         its oscillator, which differs from chip to chip and has jitter
//! ├─ adc, pins           what is outside
//! └─ debug, trace        for debuggers and profilers
//! base                   time, timers, violations; the trait of the peripherals
//! core                   simavr: instructions, interrupts, ports, ADC, Timer0/2, watchdog
//! ```
//!
//! Limits: every sleep mode is Idle and wakes at once; CLKPR and PRR have no effect; IVSEL needs no IVCE. Each file names
//! its own.
//!
//! This is the one crate of the simulator with `unsafe` code. Its argument is in `core` and
//! `machine`: simavr's memory lives as long as the machine, everything runs on one thread, and
//! callbacks see the machine through shared references only.
//!
//! Source: Atmel 2545, "ATmega48/88/168", cited by section, which holds for the ATmega328P, too; simavr as bundled by simavr-ffi 1.2.

mod adc;
mod base;
mod chip;
mod core;
mod debug;
mod debugger;
mod eeprom;
mod elf;
mod extint;
mod hex;
mod machine;
mod nvm;
mod pins;
mod pulse;
pub mod regs;
mod spi;
mod spm;
mod timer1;
mod trace;
mod uart;
mod watchdog;

use std::collections::HashMap;
use std::ops::RangeInclusive;
use std::path::Path;
use std::rc::{Rc, Weak};

use anyhow::{Context, Result};

pub use base::Violation;
pub use chip::Chip;
pub use debug::Halt;
pub use debugger::{Debugger, Registers};
pub use elf::{Firmware, Symbol, value_of};
pub use machine::{Reset, ResetCause};
pub use pins::PinWatcher;
pub use pulse::{Pulse, PulseMeter};
pub use spi::{SpiByte, SpiDevice};
pub use spm::{PAGE_BYTES, PAGE_PROGRAMMING_CYCLES};
pub use timer1::Oc;
pub use trace::{Moment, Tracer};
pub use uart::SerialCharacter;

use self::core::Activity;
use machine::Machine;
use sim_base::{Cycles, F_CPU_HZ};

/// What the processor does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// Executes instructions.
    Running,
    /// Sleeps until an interrupt.
    Sleeping,
    /// Ran off the end of flash, or into flash that cannot be read while other flash is programmed; the byte address of the
    /// program counter. Only a reset helps.
    Crashed(u32),
    /// Sleeps with interrupts off. Only a reset helps.
    Done,
}

/// A simulated chip.
pub struct Avr {
    machine: Rc<Machine>,
    symbols: HashMap<String, Symbol>,
    board: Option<Vec<u8>>,
}

impl Avr {
    /// A chip with erased flash and EEPROM, just powered on.
    ///
    /// # Errors
    /// If simavr does not know the chip.
    pub fn blank(chip: Chip) -> Result<Avr> {
        let machine = Machine::new(chip)?;
        machine.reset(ResetCause::PowerOn);
        Ok(Avr { machine, symbols: HashMap::new(), board: None })
    }

    /// The chip that an ELF file is for, with its program, just powered on. It is an ATmega168 if the file does not say.
    ///
    /// # Errors
    /// If the file is missing or is no program for such a chip; the message says what to do.
    pub fn load(elf: &Path) -> Result<Avr> {
        Avr::with_firmware(&Firmware::read(elf)?).with_context(|| elf.display().to_string())
    }

    /// The chip that a program is for, with the program. It is an ATmega168 if the program does not say.
    ///
    /// # Errors
    /// If there is no such chip, or the program does not fit.
    pub fn with_firmware(firmware: &Firmware) -> Result<Avr> {
        Avr::programmed(firmware.chip()?.unwrap_or_default(), firmware)
    }

    /// A chip with a program that has been read already.
    ///
    /// # Errors
    /// If the program does not fit.
    pub fn programmed(chip: Chip, firmware: &Firmware) -> Result<Avr> {
        let mut avr = Avr::blank(chip)?;
        avr.load_further(firmware)?;
        avr.symbols.clone_from(&firmware.symbols);
        avr.board.clone_from(&firmware.board);
        Ok(avr)
    }

    /// Writes a further program to flash and EEPROM, such as an application beside a boot loader. Symbols and wiring remain
    /// those of the first.
    ///
    /// # Errors
    /// If the program does not fit.
    pub fn load_further(&mut self, firmware: &Firmware) -> Result<()> {
        firmware.check_fits(self.chip())?;
        for (address, bytes) in &firmware.flash {
            self.load_flash(*address, bytes);
        }
        for (address, bytes) in &firmware.eeprom {
            self.machine.peripherals.nvm.eeprom.borrow_mut().set_cells(*address, bytes);
        }
        Ok(())
    }

    /// Writes a boot loader to flash, and sets BOOTSZ and BOOTRST to where it begins. Takes effect at the next reset.
    ///
    /// # Errors
    /// If the program does not fit, or does not begin where a boot section can.
    pub fn install_boot_loader(&mut self, loader: &Firmware) -> Result<()> {
        let start = loader.boot_section(self.chip())?;
        self.load_further(loader)?;
        self.set_reset_vector(start as u32);
        Ok(())
    }

    /// Which chip it is.
    pub fn chip(&self) -> Chip {
        self.machine.base.core.chip()
    }

    /// The section `.board` of the program that was loaded, if it has one.
    pub fn board_section(&self) -> Option<&[u8]> {
        self.board.as_deref()
    }

    /// Writes bytes to flash from a byte address on.
    pub fn load_flash(&mut self, address: usize, bytes: &[u8]) {
        self.machine.base.core.write_flash(address, bytes);
    }

    /// Byte address where resets begin: a boot loader's, if the fuses say so. Takes effect at the
    /// next reset. If a boot section can begin there, BOOTSZ is set to it and BOOTRST is programmed.
    pub fn set_reset_vector(&mut self, address: u32) {
        let is_boot_section = self.chip().boot_sections().contains(&(address as usize));
        self.machine.peripherals.nvm.spm.borrow_mut().set_boot_reset(is_boot_section);
        if is_boot_section {
            self.set_boot_section(address as usize);
        }
        self.machine.base.core.set_reset_pc(address);
    }

    /// Sets BOOTSZ by the byte address of the boot section, from which alone SPM works. A chip from the factory has the longest.
    ///
    /// # Panics
    /// If no boot section of the chip begins there.
    pub fn set_boot_section(&mut self, start: usize) {
        self.machine.peripherals.nvm.spm.borrow_mut().set_boot_start(start);
    }

    /// True while the program erases or writes a page of flash, or the lock bits.
    pub fn is_programming_flash(&self) -> bool {
        self.machine.peripherals.nvm.spm.borrow().is_busy()
    }

    /// The lock bits; 0 is programmed.
    pub fn lock_bits(&self) -> u8 {
        self.machine.peripherals.nvm.spm.borrow().lock_bits()
    }

    /// A symbol of the ELF whose name has `part` in it: compilers decorate names.
    pub fn symbol_with(&self, part: &str) -> Option<Symbol> {
        self.symbols.iter().find(|(name, _)| name.contains(part)).map(|(_, symbol)| *symbol)
    }

    /// A symbol of the ELF.
    pub fn symbol(&self, name: &str) -> Option<Symbol> {
        self.symbols.get(name).copied()
    }

    /// The time.
    pub fn now(&self) -> Cycles {
        self.machine.base.now()
    }

    /// Runs the program until `t`; the last instruction or interrupt entry may end later. A chip
    /// that sleeps or has crashed lets the time pass; one that a debugger halts does not.
    pub fn run_until(&mut self, t: Cycles) -> State {
        self.machine.run_until(t);
        self.state()
    }

    /// What the processor does.
    pub fn state(&self) -> State {
        let core = &self.machine.base.core;
        match core.activity() {
            Activity::Running => State::Running,
            Activity::Sleeping if core.interrupts_enabled() => State::Sleeping,
            Activity::Sleeping => State::Done,
            Activity::Crashed => State::Crashed(core.pc()),
        }
    }

    /// Resets the chip.
    pub fn reset(&mut self, cause: ResetCause) {
        self.machine.reset(cause);
    }

    /// Seed of what makes one chip differ from another: what SRAM holds after the next power-on, and how the watchdog's
    /// oscillator runs. The default seed is 0.
    pub fn seed(&mut self, seed: u64) {
        self.machine.seed(seed);
    }

    /// All resets so far, the first power-on included.
    pub fn resets(&self) -> Vec<Reset> {
        self.machine.resets_after(0)
    }

    /// The resets after the first `seen` of them.
    pub fn resets_after(&self, seen: usize) -> Vec<Reset> {
        self.machine.resets_after(seen)
    }

    /// The program's mistakes since the last call.
    pub fn take_violations(&mut self) -> Vec<Violation> {
        self.machine.base.take_violations()
    }

    /// The level of a pin, as `('D', 2)`.
    pub fn pin(&self, port: char, bit: u8) -> bool {
        self.machine.level(pins::port_index(port), bit)
    }

    /// Calls `watcher` at each change of a pin. Edges that Timer1 makes are seen by
    /// [`Avr::take_edges`] only.
    pub fn watch_pin(&mut self, port: char, bit: u8, watcher: PinWatcher) {
        self.machine.pins.watch(&self.machine.base, pins::port_index(port), bit, watcher);
    }

    /// Drives a pin from outside, through resets too. A pin that is an output does not mind.
    pub fn drive_pin(&mut self, port: char, bit: u8, level: bool) {
        self.machine.pins.drive(&self.machine.base, pins::port_index(port), bit, Some(level));
    }

    /// Stops driving a pin.
    pub fn release_pin(&mut self, port: char, bit: u8) {
        self.machine.pins.drive(&self.machine.base, pins::port_index(port), bit, None);
    }

    /// A handle to drive a pin with from within watchers and SPI devices.
    pub fn input_pin(&self, port: char, bit: u8) -> InputPin {
        InputPin { machine: Rc::downgrade(&self.machine), port: pins::port_index(port), bit }
    }

    /// Connects the one device on the SPI. Chip select is a pin like any other.
    pub fn connect_spi(&mut self, device: Box<dyn SpiDevice>) {
        self.machine.peripherals.spi.set_device(device);
    }

    /// Bytes that the program sent on the serial port since the last call, each with the end of its
    /// stop bit.
    pub fn serial_take(&mut self) -> Vec<(Cycles, u8)> {
        self.machine.peripherals.uart.borrow_mut().take_sent()
    }

    /// Characters that began on TXD and RXD since the last call, for who draws the lines. The first call begins to
    /// keep them.
    pub fn serial_trace(&mut self) -> Vec<SerialCharacter> {
        self.machine.peripherals.uart.borrow_mut().take_trace()
    }

    /// Sends bytes to the serial port. They arrive one after the other at the rate that the program
    /// has set, once the receiver is on; a program that is too slow loses some.
    pub fn serial_send(&mut self, bytes: &[u8]) {
        self.machine.peripherals.uart.borrow_mut().send_to_chip(&self.machine.base, bytes);
    }

    /// Bytes given to [`Avr::serial_send`] that have not arrived yet.
    pub fn serial_unsent(&self) -> usize {
        self.machine.peripherals.uart.borrow().unsent_to_chip()
    }

    /// Drops the bytes given to [`Avr::serial_send`] that have not begun to arrive.
    pub fn serial_discard(&mut self) {
        self.machine.peripherals.uart.borrow_mut().discard_to_chip();
    }

    /// Bytes that the program lost because it read too late.
    pub fn serial_overruns(&self) -> u32 {
        self.machine.peripherals.uart.borrow().overruns()
    }

    /// Rate of the serial port, in bits per second, as the program has set it.
    pub fn serial_bits_per_second(&self) -> u64 {
        F_CPU_HZ / uart::Uart::cycles_per_bit(&self.machine.base)
    }

    /// Duration of a character on the serial port, in CPU cycles, at the rate that the program has set.
    pub fn serial_cycles_per_byte(&self) -> u64 {
        uart::Uart::cycles_per_byte(&self.machine.base)
    }

    /// Sets the voltage at ADC input `channel` (0..=7).
    pub fn set_analog(&mut self, channel: u8, millivolts: u32) {
        self.set_analog_uv(channel, millivolts * 1000);
    }

    /// Sets the voltage at ADC input `channel` (0..=7) in microvolts.
    pub fn set_analog_uv(&mut self, channel: u8, microvolts: u32) {
        self.machine.adc.borrow_mut().set_input_uv(channel, microvolts);
    }

    /// Adds uniform noise of plus or minus `amplitude_uv` to each ADC sample.
    pub fn set_analog_noise_uv(&mut self, amplitude_uv: u32, seed: u64) {
        self.machine.adc.borrow_mut().set_noise_uv(amplitude_uv, seed);
    }

    /// Edges of OC1A or OC1B since the last call, exact to the cycle, while the pin is an output.
    pub fn take_edges(&mut self, oc: Oc) -> Vec<(Cycles, bool)> {
        self.machine.peripherals.timer1.borrow_mut().take_edges(oc, self.now())
    }

    /// Part of the time for which OC2B (D3) is high, 0 to 1, if Timer2 drives it in a PWM mode
    /// (datasheet section 18.7).
    pub fn oc2b_duty(&self) -> Option<f64> {
        let get = |address| self.machine.base.core.get(address);
        let (control_a, control_b) = (get(regs::TCCR2A), get(regs::TCCR2B));
        let com2b = (control_a >> 4) & 0b11;
        let drives = get(regs::DDRD) & 1 << 3 != 0 && control_b & 0b111 != 0 && com2b & 0b10 != 0;
        let (ocr, ocra) = (f64::from(get(regs::OCR2B)), f64::from(get(regs::OCR2A)));
        let duty = match (control_b & 0b1000) >> 1 | control_a & 0b11 {
            1 => ocr / 255.0,
            3 => (ocr + 1.0) / 256.0,
            5 => ocr / ocra.max(1.0),
            7 => (ocr + 1.0) / (ocra + 1.0),
            _ => return None,
        };
        let duty = duty.min(1.0);
        drives.then_some(if com2b == 0b11 { 1.0 - duty } else { duty })
    }

    /// A byte of the data space: registers, I/O or SRAM. Reading has no side effect.
    ///
    /// # Panics
    /// If the chip has no such address.
    pub fn sram(&self, address: u16) -> u8 {
        self.machine.base.core.get(address)
    }

    /// Bytes of the data space.
    pub fn sram_range(&self, addresses: RangeInclusive<u16>) -> Vec<u8> {
        addresses.map(|address| self.machine.base.core.get(address)).collect()
    }

    /// Sets a byte of the data space, without side effects. Meant for provoking faults.
    pub fn poke_sram(&mut self, address: u16, value: u8) {
        self.machine.base.core.set(address, value);
    }

    /// Stack pointer.
    pub fn sp(&self) -> u16 {
        u16::from_le_bytes([self.sram(regs::SPL), self.sram(regs::SPH)])
    }

    /// Program counter, as a byte address.
    pub fn pc(&self) -> u32 {
        self.machine.base.core.pc()
    }

    /// Whether a debugger has halted the chip. No time passes for it then.
    pub fn is_halted(&self) -> bool {
        self.machine.debug.is_halted()
    }

    /// Access for a debugger.
    pub fn debugger(&mut self) -> Debugger {
        Debugger::new(Rc::clone(&self.machine))
    }

    /// Calls `tracer` before each instruction, which makes the simulation several times slower; `None` ends it. The tracer
    /// must not run the chip.
    pub fn trace(&mut self, tracer: Option<Tracer>) {
        self.machine.trace.set(tracer);
    }

    /// All of flash, which survives resets and loss of power. A page in programming still has its old content.
    pub fn flash(&self) -> &[u8] {
        self.machine.base.core.flash()
    }

    /// Bytes of stack ever used by a program that filled SRAM from `bottom` on with `paint` at its
    /// start; 0 if `bottom` is beyond the SRAM.
    pub fn stack_high_water(&self, paint: u8, bottom: u16) -> u16 {
        let untouched = (bottom..=self.chip().ram_end()).take_while(|address| self.sram(*address) == paint).count();
        (self.chip().ram_end() + 1).saturating_sub(bottom) - untouched as u16
    }

    /// The EEPROM's cells.
    pub fn eeprom(&self) -> Vec<u8> {
        self.machine.peripherals.nvm.eeprom.borrow().cells().to_vec()
    }

    /// Sets the EEPROM's cells from address 0 on.
    pub fn set_eeprom(&mut self, bytes: &[u8]) {
        self.machine.peripherals.nvm.eeprom.borrow_mut().set_cells(0, bytes);
    }
}

/// Drives an input pin of an [`Avr`] from outside, from anywhere on the same thread.
#[derive(Clone)]
pub struct InputPin {
    machine: Weak<Machine>,
    port: usize,
    bit: u8,
}

impl InputPin {
    /// Sets the level. Nothing happens if the chip is gone.
    pub fn drive(&self, level: bool) {
        if let Some(machine) = self.machine.upgrade() {
            machine.pins.drive(&machine.base, self.port, self.bit, Some(level));
        }
    }
}
