//! A chip with the models around its core: what simavr's callbacks come back to.
//!
//! simavr calls back in the middle of an instruction, and what a callback does may make simavr call
//! back again. So the machine is shared, never borrowed mutably as a whole: each model sits in a
//! cell of its own that is borrowed for one step, and functions of the outside world are called
//! while no cell is borrowed.

use std::any::Any;
use std::cell::{Cell, RefCell};
use std::ffi::{c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::rc::Rc;

use anyhow::Result;
use simavr_ffi as ffi;

use super::adc::Adc;
use super::chip::Chip;
use super::core::{Access, Activity, Core, FLASH_LPM, FLASH_SPM, Vector, WriteHandler};
use super::debug::Debug;
use super::eeprom::Eeprom;
use super::pins::Pins;
use super::regs;
use super::spi::{Spi, SpiByte};
use super::spm::Spm;
use super::timer1::{Oc, Timer1};
use super::trace::Trace;
use super::uart::Uart;
use super::watchdog::Watchdog;
use super::{Reset, ResetCause, Violation};
use sim_base::Cycles;
use sim_base::Noise;

/// What is clocked by the SPI.
pub trait SpiDevice {
    /// A byte begins: the device latches what it shifts out.
    fn begin_byte(&mut self, at: Cycles);

    /// A byte is over. Returns what the device shifted out during it.
    fn end_byte(&mut self, byte: &SpiByte) -> u8;
}

/// A device that answers when the byte is over.
impl<F: FnMut(&SpiByte) -> u8> SpiDevice for F {
    fn begin_byte(&mut self, _at: Cycles) {}

    fn end_byte(&mut self, byte: &SpiByte) -> u8 {
        self(byte)
    }
}

/// Dates that the models make.
#[derive(Debug, Clone, Copy)]
pub(super) enum Timer {
    /// End of the present run.
    Stop,
    Spi,
    UartSend,
    UartReceive,
    Eeprom,
    Spm,
}

/// Registers whose writes the models see, or handle in place of simavr.
const WRITES: [u16; 31] = [
    regs::PINB,
    regs::DDRB,
    regs::PORTB,
    regs::EIFR,
    regs::EIMSK,
    regs::EECR,
    regs::EEARL,
    regs::EEARH,
    regs::GTCCR,
    regs::SPCR,
    regs::SPSR,
    regs::SPDR,
    regs::MCUSR,
    regs::SPMCSR,
    regs::WDTCSR,
    regs::TCCR1A,
    regs::TCCR1B,
    regs::TCCR1C,
    regs::TCNT1L,
    regs::TCNT1H,
    regs::ICR1L,
    regs::ICR1H,
    regs::OCR1AL,
    regs::OCR1AH,
    regs::OCR1BL,
    regs::OCR1BH,
    regs::UCSR0A,
    regs::UCSR0B,
    regs::UCSR0C,
    regs::UBRR0L,
    regs::UDR0,
];
/// Registers whose reads the models answer.
const READS: [u16; 9] = [
    regs::PINB,
    regs::EECR,
    regs::SPSR,
    regs::SPDR,
    regs::SPMCSR,
    regs::TCNT1L,
    regs::TCNT1H,
    regs::UCSR0A,
    regs::UDR0,
];

/// A program that errs in a loop makes millions of them: the first ones tell the story.
const VIOLATIONS_KEPT: usize = 1000;

/// See the module.
pub(super) struct Machine {
    pub core: Core,
    /// Time of the last reset: simavr counts from 0 again after each.
    base: Cell<Cycles>,
    /// A callback that needs the run loop to look: a reset, a panic.
    attention: Cell<bool>,
    panic: Cell<Option<Box<dyn Any + Send>>>,
    originals: RefCell<Vec<(u16, WriteHandler)>>,
    spi: RefCell<Spi>,
    spi_device: RefCell<Option<Box<dyn SpiDevice>>>,
    pub uart: RefCell<Uart>,
    pub eeprom: RefCell<Eeprom>,
    pub spm: RefCell<Spm>,
    pub adc: RefCell<Adc>,
    pub timer1: RefCell<Timer1>,
    watchdog: RefCell<Watchdog>,
    pub pins: Pins,
    pub debug: Debug,
    pub trace: Trace,
    resets: RefCell<Vec<Reset>>,
    reset_cause: Cell<Option<ResetCause>>,
    violations: RefCell<Vec<Violation>>,
    power_on_noise: RefCell<Noise>,
}

impl Machine {
    /// A chip that waits for its first reset.
    pub fn new(chip: Chip) -> Result<Rc<Machine>> {
        let machine = Rc::new(Machine {
            core: Core::new(chip)?,
            base: Cell::new(0),
            attention: Cell::new(false),
            panic: Cell::new(None),
            originals: RefCell::default(),
            spi: RefCell::default(),
            spi_device: RefCell::default(),
            uart: RefCell::default(),
            eeprom: RefCell::new(Eeprom::new(chip.eeprom_bytes())),
            spm: RefCell::new(Spm::new(chip)),
            adc: RefCell::new(Adc::new()),
            timer1: RefCell::new(Timer1::new(0)),
            watchdog: RefCell::new(Watchdog::new(0)),
            pins: Pins::default(),
            debug: Debug::default(),
            trace: Trace::default(),
            resets: RefCell::default(),
            reset_cause: Cell::new(None),
            violations: RefCell::default(),
            power_on_noise: RefCell::new(Noise::new(0)),
        });
        let core = &machine.core;
        core.set_context(Rc::as_ptr(&machine).cast_mut().cast());
        core.hook_reset(on_reset);
        core.hook_interrupts(Some(on_interrupt), Some(on_bad_opcode));
        core.hook_adc(Some(on_adc_sample));
        core.hook_watchdog(Some(on_watchdog));
        core.hook_flash(on_flash);
        for address in WRITES {
            machine.originals.borrow_mut().push((address, core.hook_write(address, Some(on_write))));
        }
        for address in READS {
            core.hook_read(address, Some(on_read));
        }
        Ok(machine)
    }

    /// The time. It goes on through resets.
    pub fn now(&self) -> Cycles {
        self.base.get() + self.core.cycle()
    }

    /// Notes a mistake of the program.
    pub fn violation(&self, text: &str) {
        let mut violations = self.violations.borrow_mut();
        if violations.len() < VIOLATIONS_KEPT {
            let text = format!("{text} (PC {:#06x})", self.core.pc());
            violations.push(Violation { at: self.now(), text });
        }
    }

    pub fn take_violations(&self) -> Vec<Violation> {
        self.violations.take()
    }

    pub fn resets_after(&self, first: usize) -> Vec<Reset> {
        self.resets.borrow().get(first..).map(<[Reset]>::to_vec).unwrap_or_default()
    }

    pub fn seed(&self, seed: u64) {
        self.power_on_noise.replace(Noise::new(seed));
        self.watchdog.replace(Watchdog::new(seed));
    }

    pub fn set_spi_device(&self, device: Box<dyn SpiDevice>) {
        self.spi_device.replace(Some(device));
    }

    /// Makes or replaces a date.
    pub fn schedule(&self, timer: Timer, at: Cycles) {
        self.core.schedule(at.saturating_sub(self.base.get()), callback(timer));
    }

    pub fn unschedule(&self, timer: Timer) {
        self.core.unschedule(callback(timer));
    }

    /// Resets the chip from outside.
    pub fn reset(&self, cause: ResetCause) {
        let flags = match cause {
            ResetCause::PowerOn => regs::PORF,
            ResetCause::External => self.core.get(regs::MCUSR) | regs::EXTRF,
            ResetCause::BrownOut => self.core.get(regs::MCUSR) | regs::BORF,
            ResetCause::Watchdog => self.core.get(regs::MCUSR) | regs::WDRF,
        };
        self.core.set(regs::MCUSR, flags);
        if cause == ResetCause::PowerOn {
            let mut noise = self.power_on_noise.borrow_mut();
            for address in (0..0x20).chain(regs::RAMSTART..=self.core.chip().ram_end()) {
                self.core.set(address, noise.next_u64() as u8);
            }
            self.eeprom.borrow_mut().lose_power(noise.next_u64() as u8);
        }
        self.reset_cause.set(Some(cause));
        self.core.reset();
        self.after_reset();
    }

    /// Runs to `until`, with all that the chip does on its own, or until a debugger halts it.
    pub fn run_until(&self, until: Cycles) {
        if self.now() >= until {
            return;
        }
        let core = &self.core;
        self.schedule(Timer::Stop, until);
        loop {
            core.run_freely();
            let cpu_waits = self.spm.borrow().halts_cpu();
            if self.debug.is_watching() && (self.debug.is_halted() || !cpu_waits && self.debug.halts(core)) {
                return;
            }
            if !cpu_waits && core.activity() == Activity::Running {
                self.spm.borrow().check_execution(self);
            }
            let asleep_for_good = core.activity() == Activity::Sleeping && !core.interrupts_enabled();
            if core.activity() == Activity::Running && !cpu_waits {
                if self.trace.is_on() {
                    self.trace.instruction(self);
                }
                core.run_one();
                if core.activity() == Activity::Sleeping && core.get(regs::SMCR) & regs::SE == 0 {
                    self.violation("SLEEP without SE in SMCR: the chip does not sleep");
                    core.set_activity(Activity::Running);
                }
            }
            let mut idle = core.process_timers();
            if self.attention.replace(false) {
                if let Some(panic) = self.panic.take() {
                    std::panic::resume_unwind(panic);
                }
                self.after_reset();
                if self.now() < until {
                    self.schedule(Timer::Stop, until);
                }
                idle = 0;
            } else if asleep_for_good && core.activity() == Activity::Running {
                // simavr wakes the core for an interrupt that the I flag holds back; the chip
                // sleeps on.
                core.set_activity(Activity::Sleeping);
            }
            match core.activity() {
                Activity::Running if !self.spm.borrow().halts_cpu() => core.service_interrupts(),
                Activity::Running | Activity::Sleeping | Activity::Crashed => {
                    let rest = until.saturating_sub(self.now());
                    core.set_cycle(core.cycle() + idle.min(rest));
                }
            }
            if self.now() >= until {
                return;
            }
        }
    }

    /// Puts right what simavr's reset leaves wrong, and what it forgot of the outside world.
    fn after_reset(&self) {
        let now = self.now();
        self.core.disconnect_timer1();
        self.spi.replace(Spi::default());
        self.uart.borrow_mut().reset(self);
        self.eeprom.borrow_mut().reset(self);
        self.spm.borrow_mut().reset(self, &mut self.power_on_noise.borrow_mut());
        self.timer1.borrow_mut().reset(now);
        self.watchdog.borrow_mut().reset(&self.core);
        self.pins.reapply(self);
    }

    fn write(&self, address: u16, value: u8) {
        match address {
            regs::SPDR => self.spi.borrow_mut().write_data(self, value),
            regs::SPSR => self.spi.borrow_mut().write_status(self, value),
            regs::SPCR => self.spi.borrow_mut().write_control(self, value),
            regs::UDR0 => self.uart.borrow_mut().write_data(self, value),
            regs::UCSR0A => self.uart.borrow_mut().write_status(self, value),
            regs::UCSR0B => self.uart.borrow_mut().write_control(self, value),
            // simavr's own rate and frame format are not used.
            regs::UCSR0C | regs::UBRR0L => self.core.set(address, value),
            regs::EECR => self.eeprom.borrow_mut().write_control(self, value),
            regs::EEARL | regs::EEARH => self.eeprom.borrow_mut().write_address(self, address, value),
            regs::SPMCSR => self.spm.borrow_mut().write_control(self, value),
            // > The flag is reset by a Power-on Reset, or by writing a logic zero to the flag.
            // > (section 11.9.1)
            regs::MCUSR => self.core.set(address, self.core.get(address) & value),
            regs::WDTCSR => {
                let before = self.core.get(address);
                self.forward(address, value);
                self.watchdog.borrow_mut().written(&self.core, before, value);
            }
            // simavr forgets an edge that comes while its interrupt is masked.
            // > [...] an edge [...] triggers an interrupt request, INTF0 becomes set [...]. If the I-bit in SREG and the INT0 bit
            // > in EIMSK are set (one), the MCU will jump to the corresponding Interrupt Vector. (section 13.2.3)
            regs::EIMSK => {
                self.core.set(address, value);
                let flags = self.core.get(regs::EIFR);
                for n in [0, 1].into_iter().filter(|n| value & flags & 1 << n != 0) {
                    self.core.raise(Vector::External(n));
                }
            }
            // > Alternatively, the flag can be cleared by writing a logical one to it. (section 13.2.3)
            regs::EIFR => {
                for n in [0, 1].into_iter().filter(|n| value & 1 << n != 0) {
                    self.core.clear(Vector::External(n));
                }
            }
            regs::GTCCR => {
                if value & regs::PSRSYNC != 0 {
                    self.timer1.borrow_mut().reset_prescaler(self.now());
                }
                self.core.set(address, value & !regs::PSRSYNC);
            }
            regs::PINB | regs::DDRB | regs::PORTB => {
                self.forward(address, value);
                let (ddrb, portb) = (self.core.get(regs::DDRB), self.core.get(regs::PORTB));
                self.timer1.borrow_mut().set_port(ddrb, portb, self.now());
            }
            _ => self.write_timer1(address, value),
        }
    }

    fn write_timer1(&self, address: u16, value: u8) {
        let written = self.timer1.borrow_mut().write(address, value, self.now());
        if let Err(text) = written {
            self.violation(text);
            return;
        }
        match address {
            regs::TCNT1H | regs::ICR1H | regs::OCR1AH | regs::OCR1BH => {}
            regs::TCNT1L | regs::ICR1L | regs::OCR1AL | regs::OCR1BL => {
                let high = self.timer1.borrow().temp();
                self.core.set(address + 1, high);
                self.forward(address, value);
            }
            _ => self.forward(address, value),
        }
    }

    fn forward(&self, address: u16, value: u8) {
        let original =
            self.originals.borrow().iter().find(|(hooked, _)| *hooked == address).map(|(_, handler)| *handler);
        if let Some(handler) = original {
            self.core.forward_write(handler, address, value);
        }
    }

    fn read(&self, address: u16) -> u8 {
        match address {
            regs::SPDR => self.spi.borrow_mut().read_data(self),
            regs::SPSR => self.spi.borrow_mut().read_status(self),
            regs::UDR0 => self.uart.borrow_mut().read_data(self),
            regs::EECR => self.eeprom.borrow().read_control(self),
            regs::SPMCSR => self.spm.borrow().read_control(self),
            regs::TCNT1L | regs::TCNT1H => self.timer1.borrow_mut().read(address, self.now()),
            regs::PINB => self.read_pinb(),
            _ => self.core.get(address),
        }
    }

    /// The levels of port B's pins, with what Timer1 drives onto two of them.
    fn read_pinb(&self) -> u8 {
        let mut timer1 = self.timer1.borrow_mut();
        let mut level = |bit| match bit {
            1 => timer1.output(Oc::A, self.now()),
            2 => timer1.output(Oc::B, self.now()),
            _ => None,
        };
        (0..8).fold(0, |pins, bit| {
            let high = level(bit).unwrap_or_else(|| self.pins.level(self, 0, bit));
            pins | u8::from(high) << bit
        })
    }

    /// A byte begins to be clocked out.
    pub fn spi_transfer_begins(&self, at: Cycles) {
        self.with_spi_device(|device| device.begin_byte(at));
    }

    /// Calls the device, which may call the machine.
    fn with_spi_device<T>(&self, call: impl FnOnce(&mut dyn SpiDevice) -> T) -> Option<T> {
        let mut device = self.spi_device.take()?;
        let result = call(&mut *device);
        self.spi_device.replace(Some(device));
        Some(result)
    }

    fn spi_transfer_ends(&self) {
        let byte = self.spi.borrow_mut().finish(self);
        let miso = byte.and_then(|byte| self.with_spi_device(|device| device.end_byte(&byte)));
        self.spi.borrow_mut().receive(self, miso.unwrap_or(0xFF));
    }

    /// Interrupts that are requested as long as a condition holds are requested again when a
    /// handler returns.
    fn interrupt_returns(&self) {
        self.uart.borrow().request_levels(self);
        self.eeprom.borrow().request_level(self);
        self.spm.borrow().update(self);
    }

    /// Runs a callback; a panic in it is carried over simavr's frames to the run loop.
    pub fn guard<T>(&self, fallback: T, callback: impl FnOnce() -> T) -> T {
        catch_unwind(AssertUnwindSafe(callback)).unwrap_or_else(|panic| {
            self.panic.set(Some(panic));
            self.attention.set(true);
            self.core.stop_soon();
            fallback
        })
    }
}

fn callback(timer: Timer) -> ffi::avr_cycle_timer_t {
    match timer {
        Timer::Stop => Some(on_stop),
        Timer::Spi => Some(on_spi),
        Timer::UartSend => Some(on_uart_send),
        Timer::UartReceive => Some(on_uart_receive),
        Timer::Eeprom => Some(on_eeprom),
        Timer::Spm => Some(on_spm),
    }
}

/// The machine behind a callback's parameter.
///
/// # Safety
/// `context` must be what `Machine::new` gave to `Core::set_context`.
unsafe fn machine<'a>(context: *mut c_void) -> &'a Machine {
    // Safety: the caller's promise; the machine lives longer than its core, and callbacks come from
    // the core only. Only shared references to the machine exist.
    unsafe { &*context.cast::<Machine>() }
}

unsafe extern "C" fn on_write(_: *mut ffi::avr_t, address: ffi::avr_io_addr_t, value: u8, context: *mut c_void) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.guard((), || machine.write(address, value));
}

unsafe extern "C" fn on_read(_: *mut ffi::avr_t, address: ffi::avr_io_addr_t, context: *mut c_void) -> u8 {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.guard(0, || machine.read(address))
}

/// Inside each reset, the watchdog's too, before the peripherals reset.
unsafe extern "C" fn on_reset(avr: *mut ffi::avr_t) {
    // Safety: simavr passes the chip, whose custom.data is the context.
    let machine = unsafe { machine((*avr).custom.data) };
    machine.guard((), || {
        let at = machine.now();
        let by_itself = machine.reset_cause.get().is_none();
        let cause = machine.reset_cause.take().unwrap_or(ResetCause::Watchdog);
        machine.resets.borrow_mut().push(Reset { at, cause });
        machine.base.set(at);
        // simavr does this at the end of the reset. The watchdog has started by then, with its date
        // on the old clock, and would not bark for as long again as the chip had run before.
        machine.core.set_cycle(0);
        if by_itself {
            machine.attention.set(true);
        }
    });
}

unsafe extern "C" fn on_interrupt(_: *mut ffi::avr_irq_t, _: u32, context: *mut c_void) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.guard((), || {
        if machine.core.interrupts_enabled() {
            machine.interrupt_returns();
        } else {
            // > The interrupt execution response for all the enabled AVR interrupts is four clock
            // > cycles minimum. (section 7.7.1) simavr takes none.
            machine.core.set_cycle(machine.core.cycle() + 4);
            // > When this bit is set (one), the interrupt vectors are moved to the beginning of the Boot Loader section of the
            // > Flash. (MCUCR, IVSEL) simavr leaves them where they are.
            if machine.core.get(regs::MCUCR) & regs::IVSEL != 0 {
                machine.core.set_pc(machine.core.pc() + machine.spm.borrow().boot_start() as u32);
            }
        }
    });
}

unsafe extern "C" fn on_bad_opcode(_: *mut ffi::avr_irq_t, opcode: u32, context: *mut c_void) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.guard((), || machine.violation(&format!("illegal instruction {opcode:#06x}")));
}

/// The program reads or writes at an address beyond the RAM.
///
/// # Safety
/// As [`machine`].
pub(super) unsafe fn on_beyond_ram(context: *mut c_void, access: Access, address: u16) {
    // Safety: the caller's promise.
    let machine = unsafe { machine(context) };
    machine.guard((), || {
        let verb = match access {
            Access::Read => "reads",
            Access::Write => "writes",
        };
        let chip = machine.core.chip();
        let end = chip.ram_end();
        machine.violation(&format!("the program {verb} {address:#06x}, and the RAM of an {chip} ends at {end:#06x}"));
    });
}

unsafe extern "C" fn on_adc_sample(_: *mut ffi::avr_irq_t, mux: u32, context: *mut c_void) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.guard((), || machine.adc.borrow_mut().sample(machine, mux));
}

unsafe extern "C" fn on_watchdog(_: *mut ffi::avr_irq_t, is_raised: u32, context: *mut c_void) {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    if is_raised != 0 {
        machine.guard((), || machine.watchdog.borrow_mut().timed_out(&machine.core));
    }
}

unsafe extern "C" fn on_stop(_: *mut ffi::avr_t, _: ffi::avr_cycle_count_t, _: *mut c_void) -> ffi::avr_cycle_count_t {
    0
}

unsafe extern "C" fn on_spi(
    _: *mut ffi::avr_t,
    _: ffi::avr_cycle_count_t,
    context: *mut c_void,
) -> ffi::avr_cycle_count_t {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.guard((), || machine.spi_transfer_ends());
    0
}

unsafe extern "C" fn on_uart_send(
    _: *mut ffi::avr_t,
    when: ffi::avr_cycle_count_t,
    context: *mut c_void,
) -> ffi::avr_cycle_count_t {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.guard((), || machine.uart.borrow_mut().sent_byte(machine, machine.base.get() + when));
    0
}

unsafe extern "C" fn on_uart_receive(
    _: *mut ffi::avr_t,
    when: ffi::avr_cycle_count_t,
    context: *mut c_void,
) -> ffi::avr_cycle_count_t {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.guard((), || machine.uart.borrow_mut().received_byte(machine, machine.base.get() + when));
    0
}

unsafe extern "C" fn on_eeprom(
    _: *mut ffi::avr_t,
    _: ffi::avr_cycle_count_t,
    context: *mut c_void,
) -> ffi::avr_cycle_count_t {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.guard((), || {
        machine.eeprom.borrow_mut().finish(machine);
        machine.spm.borrow().update(machine);
    });
    0
}

unsafe extern "C" fn on_spm(
    _: *mut ffi::avr_t,
    _: ffi::avr_cycle_count_t,
    context: *mut c_void,
) -> ffi::avr_cycle_count_t {
    // Safety: simavr passes the context on.
    let machine = unsafe { machine(context) };
    machine.guard((), || machine.spm.borrow_mut().finish(machine));
    0
}

/// SPM and LPM, in the middle of the instruction.
unsafe extern "C" fn on_flash(flash: *mut ffi::avr_io_t, request: u32, byte: *mut c_void) -> c_int {
    if request != FLASH_SPM && request != FLASH_LPM {
        return -1;
    }
    // Safety: simavr passes the peripheral, which belongs to a chip whose custom.data is the context.
    let machine = unsafe { machine((*(*flash).avr).custom.data) };
    machine.guard((), || {
        if request == FLASH_SPM {
            machine.spm.borrow_mut().execute(machine);
        } else {
            // Safety: with this request simavr passes a pointer to the byte that it has read, in the frame of its caller.
            let byte = unsafe { &mut *byte.cast::<u8>() };
            *byte = machine.spm.borrow_mut().load(machine, *byte);
        }
    });
    0
}
