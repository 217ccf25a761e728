//! A model of the ATmega168 and ATmega328P at 16 MHz on either of two engines: the own core,
//! `avr-core`, or simavr, corrected where it differs from the datasheet.
//!
//! [`Avr`] runs a program up to a given time. The board around it drives and watches pins, connects
//! a device to the SPI, sends and receives on the serial port, and sets the ADC's inputs. Time
//! counts from the start of the simulation; a reset does not change it.
//!
//! Modules. Each imports only modules further down:
//!
//! ```text
//! Avr (this file)
//! debugger               a debugger's access to the machine
//! machine                the run loop of each engine, resets, simavr's callbacks
//! ├─ peripherals, the same on both engines
//! │  ├─ spi, uart, nvm   (nvm: eeprom, spm)
//! │  ├─ timers           Timer0, Timer1 and Timer2
//! │  ├─ extint           EIMSK and EIFR
//! │  └─ watchdog         the watchdog's oscillator, with tolerance and jitter
//! ├─ sleep               which clocks stand in a sleep, and what ends it
//! ├─ adc, pins           voltages and levels from outside
//! ├─ unmodelled, starts  what a program uses that is not modelled; its starts without a reset
//! ├─ stack               how deep the stack is, and whether it runs into variables
//! └─ debug, trace        for debuggers and profilers
//! base                   time, timers, violations; the trait of the peripherals
//! core                   one of the engines: instructions, interrupts, ports, ADC, watchdog
//! ├─ own                  `avr-core`, and what it lacks
//! └─ simavr
//! silicon                values that differ from chip to chip; time inside and outside
//! processor              the interface to a board
//! elf, hex, chip, pulse, analog   programs, sizes of memories, pulses, what is not digital
//! ```
//!
//! Limits: CLKPR has no effect, and PRR and sleep on the timers only; IVSEL needs no IVCE. Each
//! file names further limits.
//!
//! Of the simulator's crates only this one has `unsafe` code, for simavr: in `simavr` and
//! `machine::on_simavr`. It is sound because simavr's memory lives as long as the machine, all code
//! runs on one thread, and callbacks use shared references to the machine only.
//!
//! Source: Atmel 2545, "ATmega48/88/168", cited by section; the ATmega328P is the same in these
//! sections. simavr as bundled by simavr-ffi 1.2.

mod adc;
mod analog;
mod base;
mod chip;
#[macro_use]
mod core;
mod debug;
mod debugger;
mod eeprom;
mod elf;
mod engine;
mod extint;
mod hex;
mod machine;
mod nvm;
mod own;
mod pins;
mod processor;
mod pulse;
pub mod regs;
mod silicon;
#[cfg_attr(not(feature = "simavr"), path = "absent/simavr.rs")]
mod simavr;
mod sleep;
mod spi;
mod spm;
mod stack;
mod starts;
mod timers;
mod trace;
mod twi;
mod uart;
mod unmodelled;
mod watchdog;

use std::collections::HashMap;
use std::ops::RangeInclusive;
use std::path::Path;
use std::rc::{Rc, Weak};

use anyhow::{Context, Result};

pub use chip::Chip;
pub use debug::{Halt, Resume};
pub use debugger::{Debugger, Registers};
pub use elf::{Firmware, Names, Symbol, value_of};
pub use engine::Engine;
pub use processor::{
    Oc, PinWatcher, Reset, ResetCause, SerialCharacter, SpiByte, SpiDevice, State, TwiBus,
    Violation,
};
pub use pulse::{Pulse, PulseMeter};
pub use silicon::Silicon;
pub use spm::{PAGE_BYTES, PAGE_PROGRAMMING_CYCLES};
pub use trace::{Moment, Tracer};
pub use uart::{byte_read_at, rates_match};
pub use unmodelled::Unmodelled;

use self::core::Activity;
use machine::Machine;
use silicon::Outside;
use sim_base::Cycles;

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
        Avr::blank_on(Engine::default(), chip)
    }

    /// [`Avr::blank`], on an engine.
    ///
    /// # Errors
    /// Those of [`Avr::blank`].
    pub fn blank_on(engine: Engine, chip: Chip) -> Result<Avr> {
        let machine = Machine::new(engine, chip)?;
        machine.reset(ResetCause::PowerOn);
        Ok(Avr { machine, symbols: HashMap::new(), board: None })
    }

    /// A chip with the program of an ELF file, just powered on. If the file does not name the chip,
    /// it is an ATmega168.
    ///
    /// # Errors
    /// If the file is missing, or is not a program for one of these chips; the message says what to
    /// do.
    pub fn load(elf: &Path) -> Result<Avr> {
        Avr::with_firmware(&Firmware::read(elf)?).with_context(|| elf.display().to_string())
    }

    /// A chip with a program that is read already. If the program does not name the chip, it is an
    /// ATmega168.
    ///
    /// # Errors
    /// If the simulator does not know the chip, or the program does not fit.
    pub fn with_firmware(firmware: &Firmware) -> Result<Avr> {
        Avr::programmed(firmware.chip()?.unwrap_or_default(), firmware)
    }

    /// The given chip with a program that is read already.
    ///
    /// # Errors
    /// If the program does not fit.
    pub fn programmed(chip: Chip, firmware: &Firmware) -> Result<Avr> {
        Avr::programmed_on(Engine::default(), chip, firmware)
    }

    /// [`Avr::programmed`], on an engine.
    ///
    /// # Errors
    /// Those of [`Avr::programmed`].
    pub fn programmed_on(engine: Engine, chip: Chip, firmware: &Firmware) -> Result<Avr> {
        let mut avr = Avr::blank_on(engine, chip)?;
        avr.load_further(firmware)?;
        avr.symbols.clone_from(&firmware.symbols);
        avr.board.clone_from(&firmware.board);
        avr.machine.stack.set_program(Some(firmware));
        Ok(avr)
    }

    /// Writes a further program to flash and EEPROM, such as an application beside a bootloader.
    /// The chip keeps the symbols and the section `.board` of the first program.
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

    /// Writes a bootloader to flash, and sets BOOTSZ and BOOTRST to its start. Takes effect at the
    /// next reset.
    ///
    /// # Errors
    /// If the program does not fit, or no boot section can start at its first byte.
    pub fn install_bootloader(&mut self, loader: &Firmware) -> Result<()> {
        let start = loader.boot_section(self.chip())?;
        self.load_further(loader)?;
        self.set_reset_vector(start as u32);
        // It can load another program.
        self.machine.stack.set_program(None);
        Ok(())
    }

    /// Watches the stack on simavr, too, which makes it slower.
    pub fn watch_stack(&mut self) {
        self.machine.watch_stack();
    }

    /// Size of the stack at its deepest, in bytes; `None` if nobody watches it, or the program has
    /// several.
    pub fn deepest_stack(&self) -> Option<u16> {
        self.machine.stack.lowest().map(|sp| self.chip().ram_end().saturating_sub(sp))
    }

    /// Where the program ran into erased flash first, a byte address. Until the reset that follows
    /// nothing that it does is a violation. simavr does not find it.
    pub fn erased_flash_entered(&self) -> Option<u32> {
        self.machine.base.erased()
    }

    /// True if the stack has run into variables: what the program does since is by chance.
    pub fn has_stack_overrun(&self) -> bool {
        self.machine.stack.has_overrun()
    }

    /// The type of the chip.
    pub fn chip(&self) -> Chip {
        self.machine.base.core.chip()
    }

    /// The section `.board` of the program, if it has one.
    pub fn board_section(&self) -> Option<&[u8]> {
        self.board.as_deref()
    }

    /// Writes bytes to flash from byte address `address` on.
    pub fn load_flash(&mut self, address: usize, bytes: &[u8]) {
        self.machine.base.core.write_flash(address, bytes);
    }

    /// Sets the byte address at which the program starts after a reset. Takes effect at the next
    /// reset. If a boot section can start there, sets BOOTSZ to that section and programs
    /// BOOTRST.
    pub fn set_reset_vector(&mut self, address: u32) {
        let is_boot_section = self.chip().boot_sections().contains(&(address as usize));
        self.machine.peripherals.nvm.spm.borrow_mut().set_boot_reset(is_boot_section);
        if is_boot_section {
            self.set_boot_section(address as usize);
        }
        self.machine.base.core.set_reset_pc(address);
    }

    /// Sets BOOTSZ by the start of the boot section, a byte address. SPM works only from the boot
    /// section. A new chip has the longest one.
    ///
    /// # Panics
    /// If no boot section of the chip starts there.
    pub fn set_boot_section(&mut self, start: usize) {
        self.machine.peripherals.nvm.spm.borrow_mut().set_boot_start(start);
    }

    /// True while a page of flash is erased or written, or the lock bits are written.
    pub fn is_programming_flash(&self) -> bool {
        self.machine.peripherals.nvm.spm.borrow().is_busy()
    }

    /// The lock bits; 0 is programmed.
    pub fn lock_bits(&self) -> u8 {
        self.machine.peripherals.nvm.spm.borrow().lock_bits()
    }

    /// A symbol of the ELF file whose name contains `part`. Compilers add characters to names.
    pub fn symbol_with(&self, part: &str) -> Option<Symbol> {
        self.symbols.iter().find(|(name, _)| name.contains(part)).map(|(_, symbol)| *symbol)
    }

    /// The symbol of the ELF file with this name.
    pub fn symbol(&self, name: &str) -> Option<Symbol> {
        self.symbols.get(name).copied()
    }

    /// Simulated time since the start.
    pub fn now(&self) -> Cycles {
        self.time_of(self.machine.base.now())
    }

    /// Runs the program until `t`. The last instruction or interrupt entry can end later. Time also
    /// passes while the chip sleeps or has crashed, but not while a debugger halts it.
    pub fn run_until(&mut self, t: Cycles) -> State {
        self.machine.run_until(self.machine.base.silicon.get().cycle_at(t));
        self.state()
    }

    /// State of the processor.
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

    /// Sets the seed of the properties that differ between chips: the contents of SRAM after the
    /// next power-on, and the frequency and jitter of the watchdog's oscillator. The default
    /// seed is 0.
    pub fn seed(&mut self, seed: u64) {
        self.machine.seed(seed);
    }

    /// Sets the values in which chips of a type differ.
    ///
    /// # Panics
    /// If the chip has run already: its clock cannot change.
    pub fn set_silicon(&mut self, silicon: Silicon) {
        self.machine.set_silicon(silicon);
    }

    /// All resets so far, including the first power-on.
    pub fn resets(&self) -> Vec<Reset> {
        self.resets_after(0)
    }

    /// The resets after the first `seen` ones.
    pub fn resets_after(&self, seen: usize) -> Vec<Reset> {
        let mut resets = self.machine.resets_after(seen);
        resets.iter_mut().for_each(|reset| self.move_outside(&mut reset.at));
        resets
    }

    /// Removes and returns the program's mistakes since the last call.
    pub fn take_violations(&mut self) -> Vec<Violation> {
        let overrun = self.machine.stack.take_overrun(&self.machine.base);
        let all = overrun.into_iter().chain(self.machine.base.take_violations());
        let mut all: Vec<Violation> = all.collect();
        all.iter_mut().for_each(|violation| self.move_outside(&mut violation.at));
        all
    }

    /// The features of the chip that are not modelled exactly and that the program has used, each
    /// once, after the first `seen` ones.
    pub fn unmodelled_after(&self, seen: usize) -> Vec<Unmodelled> {
        let mut uses = self.machine.base.unmodelled_after(seen);
        uses.iter_mut().for_each(|used| self.move_outside(&mut used.at));
        uses
    }

    /// Times at which the program jumped to its start without a reset, after the first `seen` ones.
    /// Only programs with avr-libc's start code are noticed.
    pub fn jumps_after(&self, seen: usize) -> Vec<Cycles> {
        let mut jumps = self.machine.jumps_after(seen);
        jumps.iter_mut().for_each(|at| self.move_outside(at));
        jumps
    }

    /// True if the program can know the level of a pin: it has read the pin since power-on, or one
    /// of the pin's interrupts is enabled. A read of the whole port counts.
    pub fn observes_pin(&self, port: char, bit: u8) -> bool {
        self.machine.inputs_read(pins::port_index(port)) & 1 << bit != 0
            || self.interrupt_pins().contains(&(port, bit))
    }

    /// The pins whose external or pin change interrupt is enabled.
    pub fn interrupt_pins(&self) -> Vec<(char, u8)> {
        let get = |address| self.machine.base.core.get(address);
        let external = [(0, 2), (1, 3)].into_iter();
        let external = external.filter(|(int, _)| get(regs::EIMSK) & 1 << int != 0);
        let mut pins: Vec<(char, u8)> = external.map(|(_, bit)| ('D', bit)).collect();
        for (index, port) in ['B', 'C', 'D'].into_iter().enumerate() {
            if get(regs::PCICR) & 1 << index != 0 {
                let mask = get(regs::PCMSK0 + index as u16);
                pins.extend((0..8).filter(|bit| mask & 1 << bit != 0).map(|bit| (port, bit)));
            }
        }
        pins
    }

    /// True if a pin is high. PD2 is `('D', 2)`.
    pub fn pin(&self, port: char, bit: u8) -> bool {
        self.machine.level(pins::port_index(port), bit)
    }

    /// Calls `watcher` at each change of a pin. Edges that a timer makes have their exact time.
    pub fn watch_pin(&mut self, port: char, bit: u8, mut watcher: PinWatcher) {
        let silicon = Rc::clone(&self.machine.base.silicon);
        let outside = move |level, at| watcher(level, silicon.get().time_of(at));
        self.watch_pin_in_cycles(port, bit, Box::new(outside));
    }

    /// [`Avr::watch_pin`] with the times in cycles of the chip.
    pub fn watch_pin_in_cycles(&mut self, port: char, bit: u8, watcher: PinWatcher) {
        self.machine.watch_pin(pins::port_index(port), bit, watcher);
    }

    /// Drives a pin from outside, also during resets. Has no effect while the pin is an output.
    pub fn drive_pin(&mut self, port: char, bit: u8, level: bool) {
        self.machine.base.drive_from_outside(pins::port_index(port), bit, Some(level));
    }

    /// Stops driving a pin.
    pub fn release_pin(&mut self, port: char, bit: u8) {
        self.machine.base.drive_from_outside(pins::port_index(port), bit, None);
    }

    /// A handle with which watchers and SPI devices can drive a pin.
    pub fn input_pin(&self, port: char, bit: u8) -> InputPin {
        InputPin { machine: Rc::downgrade(&self.machine), port: pins::port_index(port), bit }
    }

    /// Connects the device on the SPI, in place of an earlier one. Chip select is an ordinary pin.
    pub fn connect_spi(&mut self, device: Box<dyn SpiDevice>) {
        let silicon = Rc::clone(&self.machine.base.silicon);
        self.machine.peripherals.spi.set_device(Box::new(Outside { device, silicon }));
    }

    /// Connects what is on the two-wire bus (TWI), in place of what was there. Without it nothing
    /// acknowledges.
    pub fn connect_twi(&mut self, bus: Box<dyn TwiBus>) {
        let silicon = Rc::clone(&self.machine.base.silicon);
        self.machine.peripherals.twi.set_bus(Box::new(Outside { device: bus, silicon }));
    }

    /// Removes and returns the bytes that the program sent on the serial port since the last call,
    /// each with the time of the end of its stop bit.
    pub fn serial_take(&mut self) -> Vec<(Cycles, u8)> {
        let mut sent = self.machine.peripherals.uart.borrow_mut().take_sent();
        sent.iter_mut().for_each(|(at, _)| self.move_outside(at));
        sent
    }

    /// Removes and returns the characters that began on TXD and RXD since the last call. The first
    /// call starts the recording.
    pub fn serial_trace(&mut self) -> Vec<SerialCharacter> {
        let silicon = self.machine.base.silicon.get();
        let trace = self.machine.peripherals.uart.borrow_mut().take_trace();
        trace.into_iter().map(|character| silicon.character_outside(character)).collect()
    }

    /// Sends bytes to the serial port. Once the receiver is on, they arrive one after the other at
    /// the rate that the program has set. A program that reads too slowly loses bytes.
    pub fn serial_send(&mut self, bytes: &[u8]) {
        self.machine.peripherals.uart.borrow_mut().send_to_chip(&self.machine.base, bytes);
    }

    /// Number of bytes given to [`Avr::serial_send`] that have not arrived yet.
    pub fn serial_unsent(&self) -> usize {
        self.machine.peripherals.uart.borrow().unsent_to_chip()
    }

    /// Drops the bytes given to [`Avr::serial_send`] that have not begun to arrive.
    pub fn serial_discard(&mut self) {
        self.machine.peripherals.uart.borrow_mut().discard_to_chip();
    }

    /// True if the program has looked for a byte on the serial port since `since`, and none is on
    /// its way in either direction.
    pub fn polls_serial(&self, since: Cycles) -> bool {
        let since = self.machine.base.silicon.get().cycle_at(since);
        self.machine.peripherals.uart.borrow().is_polled(since)
    }

    /// Rate, in bits per second, of the last byte that the program sent on the serial port, by the
    /// clock of the other end.
    pub fn serial_sent_rate(&self) -> u64 {
        self.machine.peripherals.uart.borrow().sent_rate()
    }

    /// Number of bytes that the program lost because it read too late.
    pub fn serial_overruns(&self) -> u32 {
        self.machine.peripherals.uart.borrow().overruns()
    }

    /// Rate of the serial port, in bits per second, as the program has set it.
    pub fn serial_bits_per_second(&self) -> u64 {
        let clock_hz = self.machine.base.silicon.get().clock_hz();
        clock_hz / uart::Uart::cycles_per_bit(&self.machine.base)
    }

    /// Sets the rate, in bits per second, at which the other end of the serial port sends; `None`
    /// is the program's own, whatever it sets. The program reads garbage from a rate that is
    /// more than 4 % away.
    pub fn set_serial_line_rate(&mut self, bits_per_second: Option<u64>) {
        self.machine.peripherals.uart.borrow_mut().set_line_rate(bits_per_second);
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

    /// Removes and returns the edges of OC1A or OC1B since the last call, exact to the cycle, while
    /// the pin is an output.
    pub fn take_edges(&mut self, oc: Oc) -> Vec<(Cycles, bool)> {
        let mut edges = self.take_edges_in_cycles(oc);
        edges.iter_mut().for_each(|(at, _)| self.move_outside(at));
        edges
    }

    /// [`Avr::take_edges`] with the times in cycles of the chip.
    pub fn take_edges_in_cycles(&mut self, oc: Oc) -> Vec<(Cycles, bool)> {
        self.machine.peripherals.timers.take_edges(&self.machine.base, oc)
    }

    /// Duty cycle of OC2B (D3), 0 to 1, if Timer2 drives it in a PWM mode (datasheet section 18.7).
    pub fn oc2b_duty(&self) -> Option<f64> {
        analog::oc2b_duty(|address| self.machine.base.core.get(address))
    }

    /// A byte of the data space: registers, I/O or SRAM. Reading has no side effect.
    ///
    /// # Panics
    /// If `address` is above the end of the RAM.
    pub fn sram(&self, address: u16) -> u8 {
        self.machine.peek(address)
    }

    /// Bytes of the data space.
    pub fn sram_range(&self, addresses: RangeInclusive<u16>) -> Vec<u8> {
        addresses.map(|address| self.machine.peek(address)).collect()
    }

    /// Sets a byte of the data space, without side effects. For causing faults.
    pub fn poke_sram(&mut self, address: u16, value: u8) {
        self.machine.base.core.set(address, value);
    }

    /// Stack pointer.
    pub fn sp(&self) -> u16 {
        self.machine.base.sp()
    }

    /// Program counter, as a byte address.
    pub fn pc(&self) -> u32 {
        self.machine.base.core.pc()
    }

    /// True if a debugger has halted the chip. No time passes for the chip then.
    pub fn is_halted(&self) -> bool {
        self.machine.debug.is_halted()
    }

    /// Access for a debugger.
    pub fn debugger(&mut self) -> Debugger {
        Debugger::new(Rc::clone(&self.machine))
    }

    /// Calls `tracer` before each instruction, which makes the simulation several times slower;
    /// `None` ends the tracing. The tracer must not run the chip.
    pub fn trace(&mut self, tracer: Option<Tracer>) {
        self.machine.trace.set(tracer);
    }

    /// The whole flash. Resets and power-off do not change it. A page that is being programmed has
    /// its old contents.
    pub fn flash(&self) -> Vec<u8> {
        self.machine.base.core.flash(0..self.chip().flash_bytes())
    }

    /// Largest size of the stack in bytes, of a program that filled SRAM from `bottom` on with
    /// `paint` at its start; 0 if `bottom` is above the end of the SRAM.
    pub fn stack_high_water(&self, paint: u8, bottom: u16) -> u16 {
        let untouched = (bottom..=self.chip().ram_end())
            .take_while(|address| self.sram(*address) == paint)
            .count();
        (self.chip().ram_end() + 1).saturating_sub(bottom) - untouched as u16
    }

    /// The time outside at which a cycle of the chip begins.
    pub fn time_of(&self, cycle: Cycles) -> Cycles {
        self.machine.base.silicon.get().time_of(cycle)
    }

    fn move_outside(&self, at: &mut Cycles) {
        *at = self.time_of(*at);
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

/// A handle to drive an input pin of an [`Avr`] from outside.
#[derive(Clone)]
pub struct InputPin {
    machine: Weak<Machine>,
    port: usize,
    bit: u8,
}

impl InputPin {
    /// Sets the level of the pin. Has no effect if the chip was dropped.
    pub fn drive(&self, level: bool) {
        if let Some(machine) = self.machine.upgrade() {
            machine.base.drive_from_outside(self.port, self.bit, Some(level));
        }
    }
}
