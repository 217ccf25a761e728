//! The engine simavr: a safe interface to an AVR core in simavr. No other file accesses simavr's
//! memory.
//!
//! [`Simavr`] owns simavr's `avr_t` and has pointers to its peripherals. Its reads and writes of
//! registers have no side effects. The models in the other files implement the side effects of the
//! program's writes. They replace simavr's own handlers for the SPI, USART0, the EEPROM,
//! self-programming and the timers. simavr keeps the instructions, interrupts, ports, the ADC, and
//! the watchdog without its oscillator.

use std::any::Any;
use std::cell::{Cell, OnceCell, RefCell};
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;
use std::sync::Once;

use anyhow::{Result, ensure};
use simavr_ffi as ffi;

use super::chip::Chip;
use super::engine::{Access, Activity, Engine, Timer, Vector};
use super::regs;
use sim_base::F_CPU_HZ;

unsafe extern "C" {
    /// simavr's: runs instructions until a cycle timer is due or an interrupt is pending; returns
    /// the new program counter. Declared here because bindgen cannot process its header.
    fn avr_run_one(avr: *mut ffi::avr_t) -> ffi::avr_flashaddr_t;
    /// simavr's. Its header declares the arguments as a `va_list`, which is passed as a pointer on
    /// every host of simavr-ffi.
    fn avr_global_logger_set(logger: Option<Logger>);
    /// The C library's, with a `va_list` as a pointer.
    fn vsnprintf(
        text: *mut c_char,
        size: usize,
        format: *const c_char,
        arguments: *mut c_void,
    ) -> c_int;
    /// The C library's, for the memory that simavr allocates and does not free.
    fn free(memory: *mut c_void);
    /// The C library's.
    fn realloc(memory: *mut c_void, size: usize) -> *mut c_void;
}

/// Callback for simavr's log messages: chip, level, format, arguments.
type Logger = unsafe extern "C" fn(*mut ffi::avr_t, c_int, *const c_char, *mut c_void);

/// Start of simavr's log messages about a read or a write beyond the RAM.
const WRAPS: [(&[u8], Access); 2] = [
    (b"CORE: *** Wrapping read address", Access::Read),
    (b"CORE: *** Wrapping write address", Access::Write),
];
/// Text before the address in these messages.
const ADDRESS: &str = " Address ";
/// Size of the buffer for these messages, which are shorter.
const LOG_BYTES: usize = 256;

/// Bytes of flash that LPM can address.
const LPM_BYTES: usize = 0x1_0000;
/// Size of the opcode that simavr writes after the end of the flash.
const OVERFLOW_OPCODE_BYTES: usize = 2;

static LOGGER: Once = Once::new();

/// simavr's own handler for a register write, and its parameter.
type WriteHandler = (ffi::avr_io_write_t, *mut c_void);

/// Handler of requests to simavr's flash: gets the peripheral, the request, and a pointer that
/// depends on the request. Returns -1 for unknown requests.
pub(super) type FlashHandler = unsafe extern "C" fn(*mut ffi::avr_io_t, u32, *mut c_void) -> c_int;

/// Handler of accesses beyond the RAM: gets the context, the kind of access, and the address.
pub(super) type BeyondRamHandler = unsafe fn(*mut c_void, Access, u16);

/// The parameter of the callback for a timer or a pin. simavr identifies a timer by the callback
/// and the parameter.
pub(super) struct Slot<T> {
    /// The context of the chip.
    pub context: *mut c_void,
    /// The timer, or port and bit of the pin.
    pub of: T,
}

/// A callback, and its parameter for each timer or pin.
struct Callback<F, T> {
    function: F,
    slots: Box<[Slot<T>]>,
}

impl<F, T> Callback<F, T> {
    fn new(context: *mut c_void, function: F, all: impl Iterator<Item = T>) -> Callback<F, T> {
        Callback { function, slots: all.map(|of| Slot { context, of }).collect() }
    }

    fn parameter(&self, index: usize) -> *mut c_void {
        ptr::from_ref(&self.slots[index]).cast_mut().cast()
    }
}

/// Target of `custom.data` in simavr's chip.
struct Owner {
    context: *mut c_void,
    on_beyond_ram: BeyondRamHandler,
}

/// Request of a program that executes SPM.
pub(super) const FLASH_SPM: u32 = u32::from_be_bytes(*b"fspm");
/// Request of a program that executes LPM. The pointer leads to the byte that LPM reads.
pub(super) const FLASH_LPM: u32 = u32::from_be_bytes(*b"flpm");

/// A chip in simavr.
///
/// Invariant: `avr` and all other pointers stay valid, and are used by this thread only, until
/// `drop`.
pub(super) struct Simavr {
    chip: Chip,
    avr: *mut ffi::avr_t,
    ports: [*mut ffi::avr_ioport_t; 3],
    uart: *mut ffi::avr_uart_t,
    spi: *mut ffi::avr_spi_t,
    twi: *mut ffi::avr_twi_t,
    eeprom: *mut ffi::avr_eeprom_t,
    adc: *mut ffi::avr_adc_t,
    timers: [*mut ffi::avr_timer_t; 3],
    watchdog: *mut ffi::avr_watchdog_t,
    extint: *mut ffi::avr_extint_t,
    flash: *mut ffi::avr_flash_t,
    /// In a box, so that simavr's pointer to it stays valid.
    owner: OnceCell<Box<Owner>>,
    on_timer: OnceCell<Callback<ffi::avr_cycle_timer_t, Timer>>,
    on_pin: OnceCell<Callback<ffi::avr_irq_notify_t, (usize, u8)>>,
    /// simavr's own handlers of the registers whose writes are hooked.
    originals: RefCell<Vec<(u16, WriteHandler)>>,
    /// True if a callback needs the run loop to handle a reset or a panic.
    attention: Cell<bool>,
    panic: Cell<Option<Box<dyn Any + Send>>>,
    /// The stack pointer below which the machine wants to know; `None` if it does not.
    stack_mark: Cell<Option<u16>>,
    /// True if the program wrote SPH after SPL.
    is_sp_set_by_hand: Cell<bool>,
}

impl Simavr {
    /// A chip with erased flash, all supplies at 5 V.
    pub fn new(chip: Chip) -> Result<Simavr> {
        let name = CString::new(chip.name())?;
        // Safety: `log` has the type that simavr calls, but for the pointer that stands for a
        // `va_list`. It is set once, before there is a chip that could log.
        LOGGER.call_once(|| unsafe { avr_global_logger_set(Some(log)) });
        // Safety: the name is a C string; the returned chip is ours alone. simavr copies its
        // template into fresh memory, so chips on several threads do not meet.
        let avr = unsafe { ffi::avr_make_mcu_by_name(name.as_ptr()) };
        ensure!(!avr.is_null(), "this simavr does not know the {chip}");
        // Safety: `avr` was just made and has not been initialised before; its fields may be set
        // before and after avr_init.
        unsafe {
            ffi::avr_init(avr);
            (*avr).frequency = F_CPU_HZ as u32;
            (*avr).vcc = 5000;
            (*avr).avcc = 5000;
            (*avr).aref = 5000;
            // LPM reads at any 16-bit address, and simavr does not check that the flash is so
            // large.
            let flash = realloc((*avr).flash.cast(), LPM_BYTES).cast::<u8>();
            ensure!(!flash.is_null(), "no memory for the flash");
            let used = chip.flash_bytes() + OVERFLOW_OPCODE_BYTES;
            ptr::write_bytes(flash.add(used), 0xFF, LPM_BYTES - used);
            (*avr).flash = flash;
        }
        let core = Simavr {
            chip,
            avr,
            ports: ['B', 'C', 'D'].map(|name| find(avr, c"port", name).cast()),
            uart: find(avr, c"uart", '0').cast(),
            spi: find(avr, c"spi", '\0').cast(),
            twi: find(avr, c"twi", '\0').cast(),
            eeprom: find(avr, c"eeprom", '\0').cast(),
            adc: find(avr, c"adc", '\0').cast(),
            timers: ['0', '1', '2'].map(|name| find(avr, c"timer", name).cast()),
            watchdog: find(avr, c"watchdog", '\0').cast(),
            extint: find(avr, c"extint", '\0').cast(),
            flash: find(avr, c"flash", '\0').cast(),
            owner: OnceCell::new(),
            on_timer: OnceCell::new(),
            on_pin: OnceCell::new(),
            originals: RefCell::default(),
            attention: Cell::new(false),
            panic: Cell::new(None),
            stack_mark: Cell::new(None),
            is_sp_set_by_hand: Cell::new(false),
        };
        let modules: [*mut c_void; 8] = [
            core.uart.cast(),
            core.spi.cast(),
            core.twi.cast(),
            core.eeprom.cast(),
            core.adc.cast(),
            core.watchdog.cast(),
            core.extint.cast(),
            core.flash.cast(),
        ];
        ensure!(
            modules.iter().all(|module| !module.is_null())
                && core.ports.iter().all(|port| !port.is_null())
                && core.timers.iter().all(|timer| !timer.is_null()),
            "this simavr's {chip} lacks a peripheral"
        );
        Ok(core)
    }

    /// The type of the chip.
    pub fn chip(&self) -> Chip {
        self.chip
    }

    /// Sets the parameter of all callbacks, and the handler of accesses beyond the RAM. Call it
    /// once, before setting hooks.
    pub fn set_context(&self, context: *mut c_void, on_beyond_ram: BeyondRamHandler) {
        let owner = self.owner.get_or_init(|| Box::new(Owner { context, on_beyond_ram }));
        // Safety: see the invariant of `Simavr`; simavr itself does not use custom.data after
        // avr_init.
        unsafe { (*self.avr).custom.data = ptr::from_ref::<Owner>(owner).cast_mut().cast() }
    }

    /// The context of `set_context`; null before that call.
    pub fn context(&self) -> *mut c_void {
        self.owner.get().map_or(ptr::null_mut(), |owner| owner.context)
    }

    /// The context of a chip, in callbacks that get no other parameter.
    ///
    /// # Safety
    /// `avr` must be the chip of a `Simavr` after `set_context`.
    pub unsafe fn context_of(avr: *mut ffi::avr_t) -> *mut c_void {
        // Safety: the caller's promise: custom.data points to the owner in the core's box.
        unsafe { (*(*avr).custom.data.cast::<Owner>()).context }
    }

    /// Cycles since the last reset.
    pub fn cycle(&self) -> u64 {
        // Safety: see the invariant of `Simavr`.
        unsafe { (*self.avr).cycle }
    }

    /// Sets simavr's clock. Cycle timers keep their absolute times.
    pub fn set_cycle(&self, cycle: u64) {
        // Safety: see the invariant of `Simavr`.
        unsafe { (*self.avr).cycle = cycle }
    }

    /// One byte of the data space (registers, I/O, SRAM), without side effects.
    pub fn get(&self, address: u16) -> u8 {
        assert!(address <= self.chip.ram_end(), "no data at {address:#06x}");
        // Safety: see the invariant of `Simavr`; data holds ram_end + 1 bytes.
        unsafe { *(*self.avr).data.add(address.into()) }
    }

    /// Sets one byte of the data space, without side effects.
    pub fn set(&self, address: u16, value: u8) {
        assert!(address <= self.chip.ram_end(), "no data at {address:#06x}");
        // Safety: see the invariant of `Simavr`; data holds ram_end + 1 bytes.
        unsafe { *(*self.avr).data.add(address.into()) = value }
    }

    /// A range of the flash.
    pub fn flash(&self, range: Range<usize>) -> Vec<u8> {
        // Safety: see the invariant of `Simavr`; flash holds flash_bytes bytes and more, which do
        // not change while they are copied.
        let flash =
            unsafe { std::slice::from_raw_parts((*self.avr).flash, self.chip.flash_bytes()) };
        flash[range].to_vec()
    }

    /// Copies bytes into flash.
    pub fn write_flash(&self, address: usize, bytes: &[u8]) {
        let end = self.chip.flash_bytes();
        assert!(address + bytes.len() <= end, "flash ends at {end:#x}");
        // Safety: see the invariant of `Simavr`; the range was checked, and `bytes` cannot overlap
        // simavr's memory unless it came from `flash`, for which `copy` allows.
        unsafe { ptr::copy(bytes.as_ptr(), (*self.avr).flash.add(address), bytes.len()) }
    }

    /// Program counter as a byte address.
    pub fn pc(&self) -> u32 {
        // Safety: see the invariant of `Simavr`.
        unsafe { (*self.avr).pc }
    }

    /// Sets the program counter, a byte address.
    pub fn set_pc(&self, address: u32) {
        assert!((address as usize) < self.chip.flash_bytes(), "no flash at {address:#06x}");
        // Safety: see the invariant of `Simavr`; simavr expects an even address within flash.
        unsafe { (*self.avr).pc = address & !1 }
    }

    /// Status register.
    pub fn sreg(&self) -> u8 {
        // Safety: see the invariant of `Simavr`; sreg has eight flags of 0 or 1.
        let flags = unsafe { (*self.avr).sreg };
        flags.iter().enumerate().fold(0, |sreg, (bit, flag)| sreg | u8::from(*flag != 0) << bit)
    }

    /// Sets the status register. If this sets the I flag, pending interrupts run after the next
    /// instruction, as after SEI.
    pub fn set_sreg(&self, value: u8) {
        let enabled_before = self.interrupts_enabled();
        // Safety: see the invariant of `Simavr`. interrupt_state is what simavr's own SREG writes
        // set: -1 for "look after the next instruction", 0 for none.
        unsafe {
            (*self.avr).sreg = std::array::from_fn(|bit| value >> bit & 1);
            if !self.interrupts_enabled() {
                (*self.avr).interrupt_state = 0;
            } else if !enabled_before {
                (*self.avr).interrupt_state = -1;
            }
        }
    }

    /// Stores a byte in an I/O register, with the side effects of a program's store.
    pub fn store(&self, address: u16, value: u8) {
        assert!(
            (regs::IO_FIRST..regs::RAMSTART).contains(&address),
            "no I/O register at {address:#06x}"
        );
        // Safety: see the invariant of `Simavr`; io has an entry for each address from 0x20 on.
        let slot = unsafe { (*self.avr).io[usize::from(address - regs::IO_FIRST)].w };
        self.call((slot.c, slot.param), address, value);
    }

    /// Sets the byte address at which the program starts after a reset.
    pub fn set_reset_pc(&self, address: u32) {
        // Safety: see the invariant of `Simavr`.
        unsafe { (*self.avr).reset_pc = address }
    }

    /// True if the I flag of SREG is set.
    pub fn interrupts_enabled(&self) -> bool {
        // Safety: see the invariant of `Simavr`; sreg has eight flags, of which I is the last.
        unsafe { (*self.avr).sreg[7] != 0 }
    }

    /// State of the core.
    pub fn activity(&self) -> Activity {
        // Safety: see the invariant of `Simavr`.
        match unsafe { (*self.avr).state } as u32 {
            ffi::cpu_Running => Activity::Running,
            ffi::cpu_Sleeping => Activity::Sleeping,
            _ => Activity::Crashed,
        }
    }

    /// Sets the state of the core.
    pub fn set_activity(&self, activity: Activity) {
        let state = match activity {
            Activity::Running => ffi::cpu_Running,
            Activity::Sleeping => ffi::cpu_Sleeping,
            Activity::Crashed => ffi::cpu_Crashed,
        };
        // Safety: see the invariant of `Simavr`.
        unsafe { (*self.avr).state = state as i32 }
    }

    /// Runs instructions up to the next cycle timer, interrupt or sleep.
    pub fn run_one(&self) {
        // Safety: see the invariant of `Simavr`. Callbacks come back through pointers to the
        // machine that owns this core and form shared references only.
        unsafe { (*self.avr).pc = avr_run_one(self.avr) }
    }

    /// Calls the cycle timers that are due. Returns the cycles to the next one.
    pub fn process_timers(&self) -> u64 {
        // Safety: as `run_one`.
        unsafe { ffi::avr_cycle_timer_process(self.avr) }
    }

    /// Enters the handler of a pending interrupt, if any.
    pub fn service_interrupts(&self) {
        // Safety: as `run_one`.
        unsafe {
            if (*self.avr).interrupt_state != 0 {
                ffi::avr_service_interrupts(self.avr);
            }
        }
    }

    /// Ends `run_one` after the present instruction.
    pub fn stop_soon(&self) {
        // Safety: see the invariant of `Simavr`.
        unsafe { (*self.avr).run_cycle_count = 1 }
    }

    /// The stack pointer below which the machine wants to know, if it does.
    pub fn stack_mark(&self) -> Option<u16> {
        self.stack_mark.get()
    }

    /// Sets it.
    pub fn set_stack_mark(&self, mark: Option<u16>) {
        self.stack_mark.set(mark);
    }

    /// True if the program wrote SPH after SPL.
    pub fn is_sp_set_by_hand(&self) -> bool {
        self.is_sp_set_by_hand.get()
    }

    /// True if an instruction that was executed can have lowered the stack: a push, a call, or a
    /// write of SPL, whose high byte compilers write first.
    pub fn can_lower_stack(&self, opcode: u16) -> bool {
        let is = |mask: u16, value: u16| opcode & mask == value;
        let (sets_low, sets_high) = (is(0xFE0F, 0xBE0D), is(0xFE0F, 0xBE0E));
        if sets_low || sets_high {
            self.is_sp_set_by_hand.set(sets_high);
        }
        let pushes = is(0xFE0F, 0x920F);
        let calls = is(0xF000, 0xD000) || is(0xFE0E, 0x940E) || opcode == 0x9509;
        sets_low || pushes || calls
    }

    /// Resets the chip; the flags in MCUSR are kept.
    pub fn reset(&self) {
        // Safety: as `run_one`.
        unsafe { ffi::avr_reset(self.avr) }
    }

    /// Lets `run_one` run to the next cycle timer. simavr's reset limits it to one instruction.
    pub fn run_freely(&self) {
        // Safety: see the invariant of `Simavr`.
        unsafe { (*self.avr).run_cycle_limit = u64::MAX }
    }

    /// Lets `run_one` run one instruction only. [`Simavr::stop_soon`] alone does not: an
    /// instruction that sets a cycle timer, such as WDR or a write to UDR0, cancels its effect.
    pub fn run_singly(&self) {
        // Safety: see the invariant of `Simavr`.
        unsafe { (*self.avr).run_cycle_limit = 1 }
        self.stop_soon();
    }

    /// Sets the callback of all timers. Its parameter is a [`Slot`] with the timer.
    pub fn hook_timers(&self, function: ffi::avr_cycle_timer_t) {
        self.on_timer
            .get_or_init(|| Callback::new(self.context(), function, Timer::ALL.into_iter()));
    }

    /// The callback of a timer, and its parameter.
    fn timer(&self, timer: Timer) -> (ffi::avr_cycle_timer_t, *mut c_void) {
        let callback = self.on_timer.get().expect("the machine hooks the timers at its start");
        (callback.function, callback.parameter(timer as usize))
    }

    /// Lets a timer expire when simavr's clock reaches `cycle`, in place of an earlier time.
    pub fn schedule(&self, timer: Timer, cycle: u64) {
        let delay = cycle.saturating_sub(self.cycle());
        let (function, parameter) = self.timer(timer);
        // Safety: see the invariant of `Simavr`; the parameter lives as long as the chip.
        unsafe { ffi::avr_cycle_timer_register(self.avr, delay, function, parameter) }
    }

    /// Cancels a timer.
    pub fn unschedule(&self, timer: Timer) {
        let (function, parameter) = self.timer(timer);
        // Safety: see the invariant of `Simavr`.
        unsafe { ffi::avr_cycle_timer_cancel(self.avr, function, parameter) }
    }

    /// Sets an interrupt's flag, and requests it if it is enabled.
    pub fn raise(&self, vector: Vector) {
        // Safety: see the invariant of `Simavr`; the vector lies in a peripheral of this chip.
        unsafe { ffi::avr_raise_interrupt(self.avr, self.vector(vector)) };
    }

    /// Clears an interrupt's flag and its request.
    pub fn clear(&self, vector: Vector) {
        // Safety: see the invariant of `Simavr`; the vector lies in a peripheral of this chip.
        unsafe { ffi::avr_clear_interrupt(self.avr, self.vector(vector)) };
    }

    fn vector(&self, vector: Vector) -> *mut ffi::avr_int_vector_t {
        // Safety: see the invariant of `Simavr`; only addresses are formed.
        unsafe {
            match vector {
                Vector::SpiTransferComplete => &raw mut (*self.spi).spi,
                Vector::UsartReceiveComplete => &raw mut (*self.uart).rxc,
                Vector::UsartDataRegisterEmpty => &raw mut (*self.uart).udrc,
                Vector::UsartTransmitComplete => &raw mut (*self.uart).txc,
                Vector::EepromReady => &raw mut (*self.eeprom).ready,
                Vector::SpmReady => &raw mut (*self.flash).flash,
                Vector::Twi => &raw mut (*self.twi).twi,
                Vector::Adc => &raw mut (*self.adc).adc,
                Vector::PinChange(port) => &raw mut (*self.ports[usize::from(port)]).pcint,
                Vector::External(n) => &raw mut (*self.extint).eint[usize::from(n)].vector,
                Vector::Watchdog => &raw mut (*self.watchdog).watchdog,
                Vector::Timer(n, flag) => {
                    let timer = self.timers[usize::from(n)];
                    match flag {
                        0b0001 => &raw mut (*timer).overflow,
                        0b0010 => &raw mut (*timer).comp[0].interrupt,
                        0b0100 => &raw mut (*timer).comp[1].interrupt,
                        _ => &raw mut (*timer).icr,
                    }
                }
            }
        }
    }

    /// Installs `handler` as a register's write handler. [`Simavr::forward`] calls the one that it
    /// replaces.
    pub fn hook_write(&self, address: u16, handler: ffi::avr_io_write_t) {
        // Safety: see the invariant of `Simavr`; io has an entry for each address from 0x20 on.
        let original = unsafe {
            let slot = &raw mut (*self.avr).io[usize::from(address - 0x20)].w;
            let original = ((*slot).c, (*slot).param);
            (*slot).c = handler;
            (*slot).param = self.context();
            original
        };
        self.originals.borrow_mut().push((address, original));
    }

    /// Installs `handler` as a register's read handler.
    pub fn hook_read(&self, address: u16, handler: ffi::avr_io_read_t) {
        // Safety: see the invariant of `Simavr`; io has an entry for each address from 0x20 on.
        unsafe {
            let slot = &raw mut (*self.avr).io[usize::from(address - 0x20)].r;
            (*slot).c = handler;
            (*slot).param = self.context();
        }
    }

    /// Calls the handler that `hook_write` has replaced; if there was none, stores the byte.
    pub fn forward(&self, address: u16, value: u8) {
        let originals = self.originals.borrow();
        let original = originals.iter().find(|(hooked, _)| *hooked == address);
        let Some(&(_, handler)) = original else { return };
        drop(originals);
        self.call(handler, address, value);
    }

    /// Calls a handler of a register; if there is none, stores the byte.
    fn call(&self, handler: WriteHandler, address: u16, value: u8) {
        match handler {
            // Safety: simavr installed this handler with this parameter for this address of this
            // chip.
            (Some(function), parameter) => unsafe { function(self.avr, address, value, parameter) },
            (None, _) => self.set(address, value),
        }
    }

    /// Runs a callback. Catches a panic, which must not unwind through simavr's frames, for the run
    /// loop.
    pub fn guard<T>(&self, fallback: T, callback: impl FnOnce() -> T) -> T {
        catch_unwind(AssertUnwindSafe(callback)).unwrap_or_else(|panic| {
            self.panic.set(Some(panic));
            self.ask_for_attention();
            self.stop_soon();
            fallback
        })
    }

    /// Asks the run loop to handle a reset or a panic: the next [`Simavr::take_attention`] returns
    /// true.
    pub fn ask_for_attention(&self) {
        self.attention.set(true);
    }

    /// True if a callback asked for attention since the last call. Resumes a panic that
    /// [`Simavr::guard`] has caught.
    pub fn take_attention(&self) -> bool {
        let attention = self.attention.replace(false);
        if attention && let Some(panic) = self.panic.take() {
            std::panic::resume_unwind(panic);
        }
        attention
    }

    /// Calls `reset` inside each reset, before the peripherals are reset.
    pub fn hook_reset(&self, reset: unsafe extern "C" fn(*mut ffi::avr_t)) {
        // Safety: see the invariant of `Simavr`. The handler replaced is empty for this chip.
        unsafe { (*self.avr).reset = Some(reset) }
    }

    /// Calls `notify` with the number of each interrupt that is entered or returned from, and at
    /// illegal instructions.
    pub fn hook_interrupts(
        &self,
        running: ffi::avr_irq_notify_t,
        bad_opcode: ffi::avr_irq_notify_t,
    ) {
        // Safety: see the invariant of `Simavr`; both IRQs exist from avr_init on.
        unsafe {
            let entered = &raw mut (*self.avr).interrupts.irq[ffi::AVR_INT_IRQ_RUNNING as usize];
            ffi::avr_irq_register_notify(entered, running, self.context());
            let bad = (*self.avr).irq.add(ffi::AVR_CORE_BAD_OPCODE as usize);
            ffi::avr_irq_register_notify(bad, bad_opcode, self.context());
        }
    }

    /// Calls `handler` in place of simavr's own at each SPM and LPM, with [`FLASH_SPM`] or
    /// [`FLASH_LPM`].
    pub fn hook_flash(&self, handler: FlashHandler) {
        // Safety: see the invariant of `Simavr`.
        unsafe { (*self.flash).io.ioctl = Some(handler) }
    }

    /// Calls `trigger` at the moment at which the ADC samples its input.
    pub fn hook_adc(&self, trigger: ffi::avr_irq_notify_t) {
        // Safety: see the invariant of `Simavr`; the ADC has this IRQ.
        unsafe {
            let irq = (*self.adc).io.irq.add(ffi::ADC_IRQ_OUT_TRIGGER as usize);
            ffi::avr_irq_register_notify(irq, trigger, self.context());
        }
    }

    /// Sets the input voltage of the ADC conversion in progress, and the CPU cycles of one ADC
    /// clock.
    pub fn set_adc_input(&self, channel: u8, millivolts: u16, cycles_per_adc_clock: u8) {
        // Safety: see the invariant of `Simavr`; the index is masked to the array's 16 entries.
        unsafe {
            (*self.adc).adc_values[usize::from(channel & 0xF)] = millivolts;
            (*self.adc).current_prescale = cycles_per_adc_clock;
        }
    }

    /// Reference voltage of the ADC conversion in progress.
    pub fn adc_reference_millivolts(&self) -> u16 {
        // Safety: see the invariant of `Simavr`; the index is masked to the array's 8 entries.
        let reference =
            unsafe { (*self.adc).ref_values[usize::from((*self.adc).current_refi & 7)] };
        // Values below ADC_VREF_V110 select an external pin, which is at 5 V here. Other values are
        // the voltage in millivolts.
        if u32::from(reference) < ffi::ADC_VREF_V110 { 5000 } else { reference }
    }

    /// Calls `notify` when the level of a pin may have changed. Its parameter is a [`Slot`] with
    /// port and bit. A second call for the same pin has no effect.
    pub fn hook_pin(&self, port: usize, bit: u8, notify: ffi::avr_irq_notify_t) {
        let pins = (0..self.ports.len()).flat_map(|port| (0..8).map(move |bit| (port, bit)));
        let callback = self.on_pin.get_or_init(|| Callback::new(self.context(), notify, pins));
        let parameter = callback.parameter(8 * port + usize::from(bit));
        // Safety: see the invariant of `Simavr`; the parameter lives as long as the chip.
        unsafe {
            ffi::avr_irq_register_notify(self.pin_irq(port, bit), callback.function, parameter)
        }
    }

    /// Sets the pins of a port that are driven from outside, and their levels.
    pub fn set_external(&self, port: usize, mask: u8, levels: u8) {
        // Safety: see the invariant of `Simavr`.
        unsafe {
            (*self.ports[port]).external.pull_mask = mask;
            (*self.ports[port]).external.pull_value = levels;
        }
    }

    /// Applies a level from outside to an input pin. This updates PINx, and requests pin change and
    /// external interrupts.
    pub fn drive_pin(&self, port: usize, bit: u8, level: bool) {
        // Safety: see the invariant of `Simavr`; the pointer is valid.
        unsafe { ffi::avr_raise_irq(self.pin_irq(port, bit), level.into()) }
    }

    /// Calls `notify` with 1 when a time-out of the watchdog requests its interrupt.
    pub fn hook_watchdog(&self, notify: ffi::avr_irq_notify_t) {
        // Safety: see the invariant of `Simavr`; the vector has this IRQ.
        unsafe {
            let irq = &raw mut (*self.watchdog).watchdog.irq[ffi::AVR_INT_IRQ_PENDING as usize];
            ffi::avr_irq_register_notify(irq, notify, self.context());
        }
    }

    /// Sets the length of the watchdog's next time-out in CPU cycles. A time-out that runs does not
    /// change.
    pub fn set_watchdog_cycles(&self, cycles: u64) {
        // Safety: see the invariant of `Simavr`.
        unsafe { (*self.watchdog).cycle_count = cycles }
    }

    /// Removes an interrupt's request from simavr's queue, which has room for 63 requests. simavr
    /// would leave it there.
    pub fn withdraw(&self, vector: Vector) {
        // Safety: see the invariant of `Simavr`. The queue is a ring; `read` and `write` stay below
        // its length, and simavr sets interrupt_state like this after each change of the queue.
        unsafe {
            let vector = self.vector(vector);
            (*vector).set_pending(0);
            let queue = &mut (*self.avr).interrupts.pending;
            let length = queue.buffer.len() as u16;
            let mut kept = queue.read;
            let mut at = queue.read;
            while at != queue.write {
                let entry = queue.buffer[usize::from(at)];
                if entry != vector {
                    queue.buffer[usize::from(kept)] = entry;
                    kept = (kept + 1) % length;
                }
                at = (at + 1) % length;
            }
            queue.write = kept;
            if (*self.avr).interrupt_state > 0 {
                (*self.avr).interrupt_state = i8::from(queue.read != queue.write);
            }
        }
    }

    /// Restarts the watchdog's time-out, as WDR does.
    pub fn restart_watchdog(&self) {
        // Safety: see the invariant of `Simavr`; this request takes no parameter.
        unsafe { ffi::avr_ioctl(self.avr, u32::from_be_bytes(*b"wdtr"), ptr::null_mut()) };
    }

    /// Disconnects simavr's Timer1 from ICP1. `timers` models the input capture; simavr would store
    /// the value of its own counter.
    pub fn disconnect_timer1(&self) {
        // Safety: see the invariant of `Simavr`; both IRQs exist. avr_unconnect_irq does nothing if
        // they are apart.
        unsafe {
            let target = (*self.timers[1]).io.irq.add(ffi::TIMER_IRQ_IN_ICP as usize);
            ffi::avr_unconnect_irq((*self.ports[0]).io.irq, target);
        }
    }

    /// Gives a pin a level that simavr's own writes to the port do not change, until
    /// [`Simavr::release_pin`]. Requests pin change and external interrupts if the level changes.
    pub fn hold_pin(&self, port: usize, bit: u8, level: bool) {
        self.release_pin(port, bit);
        self.drive_pin(port, bit, level);
        // Safety: as `release_pin`.
        unsafe { (*self.pin_irq(port, bit)).flags |= ffi::IRQ_FLAG_STRONG as u8 }
    }

    /// Ends `hold_pin`. The pin keeps its level until the next write to its port.
    pub fn release_pin(&self, port: usize, bit: u8) {
        // Safety: see the invariant of `Simavr`; the pointer is valid.
        unsafe { (*self.pin_irq(port, bit)).flags &= !(ffi::IRQ_FLAG_STRONG as u8) }
    }

    fn pin_irq(&self, port: usize, bit: u8) -> *mut ffi::avr_irq_t {
        assert!(bit < 8);
        // Safety: see the invariant of `Simavr`; each port has an IRQ per pin.
        unsafe { (*self.ports[port]).io.irq.add(bit.into()) }
    }

    /// Removes simavr's own handler for SBI and CBI of the register at `address`, which is below
    /// 0x40. They then read and write the register.
    pub fn unhook_bit_writes(&self, address: u16) {
        // Safety: see the invariant of `Simavr`; bit_io has an entry for each address from 0x20 to
        // 0x3F, and the index is checked.
        unsafe { (*self.avr).bit_io[usize::from(address - regs::IO_FIRST)].c = None }
    }

    /// The word of flash at a byte address, or 0 beyond the end of the flash.
    pub fn word(&self, address: u32) -> u16 {
        let address = address as usize;
        if address + 1 >= self.chip.flash_bytes() {
            return 0;
        }
        // Safety: see the invariant of `Simavr`; the flash holds both bytes.
        let bytes = [0, 1].map(|offset| unsafe { *(*self.avr).flash.add(address + offset) });
        u16::from_le_bytes(bytes)
    }
}

#[allow(clippy::derivable_impls, reason = "a build without simavr has another default")]
impl Default for Engine {
    fn default() -> Engine {
        Engine::Simavr
    }
}

impl Drop for Simavr {
    fn drop(&mut self) {
        // Safety: see the invariant of `Simavr`; nothing uses the chip after this. The chip itself
        // came from malloc.
        unsafe {
            (*self.avr).custom.data = ptr::null_mut();
            ffi::avr_terminate(self.avr);
            free(self.avr.cast());
        }
    }
}

/// Reports accesses beyond the RAM to the machine. simavr only prints them; its other messages are
/// dropped.
unsafe extern "C" fn log(
    avr: *mut ffi::avr_t,
    _level: c_int,
    format: *const c_char,
    arguments: *mut c_void,
) {
    if avr.is_null() || format.is_null() {
        return;
    }
    // Safety: simavr passes a chip, whose custom.data is null or points to the owner in the core's
    // box, and a C string.
    let (owner, message) =
        unsafe { ((*avr).custom.data.cast::<Owner>().as_ref(), CStr::from_ptr(format).to_bytes()) };
    let Some((_, access)) = WRAPS.iter().find(|(start, _)| message.starts_with(start)) else {
        return;
    };
    let Some(owner) = owner else { return };
    let mut text = [0_u8; LOG_BYTES];
    // Safety: the buffer has that size, and the arguments are those of the format. The C library
    // ends the text with 0.
    unsafe { vsnprintf(text.as_mut_ptr().cast(), LOG_BYTES, format, arguments) };
    let text = String::from_utf8_lossy(&text);
    let digits = text.split_once(ADDRESS).and_then(|(_, rest)| rest.get(..4));
    if let Some(address) = digits.and_then(|digits| u16::from_str_radix(digits, 16).ok()) {
        // Safety: `set_context` was given the handler for this context.
        unsafe { (owner.on_beyond_ram)(owner.context, *access, address) };
    }
}

/// The peripheral of a kind, with `name` if the kind has several; null if there is none.
fn find(avr: *mut ffi::avr_t, kind: &CStr, name: char) -> *mut ffi::avr_io_t {
    // Safety: the chip is initialised, so its list of modules is well formed and ends with null.
    // Kinds are C strings. Of the kinds asked for by name, each has a struct in which the name can
    // be read.
    unsafe {
        let mut module = (*avr).io_port;
        while !module.is_null() {
            if CStr::from_ptr((*module).kind) == kind {
                let found = match kind.to_bytes() {
                    b"port" => (*module.cast::<ffi::avr_ioport_t>()).name,
                    b"uart" => (*module.cast::<ffi::avr_uart_t>()).name,
                    b"timer" => (*module.cast::<ffi::avr_timer_t>()).name,
                    _ => 0,
                };
                if found as u8 == name as u8 {
                    return module;
                }
            }
            module = (*module).next;
        }
    }
    ptr::null_mut()
}
