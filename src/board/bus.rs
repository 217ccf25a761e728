//! The CAN controller, and its interrupt, which reads frames from it at any point of the main loop.
//! The interrupt is INT0, or INT1 on boards with the controller's INT on D3. The comments say INT0
//! for both.
//!
//! The controller holds two frames, of some types only one, and a frame may end 67 us after the one
//! before it. So INT0 moves each frame to a queue of [`QUEUE_LEN`] frames as soon as it arrives,
//! and the main loop takes the frames from the queue.
//!
//! The controller, its SPI and its pins have one owner at a time. While INT0 is enabled, the
//! handler owns them. While INT0 is masked, the code that masked it owns them: the handler itself,
//! or a method of [`Bus`]. The queue has one writer at a time, the owner of the controller, and one
//! reader, the main loop. The writer fills the place at `WRITTEN` and then increments `WRITTEN`.
//! The reader empties the place at `READ` and then increments `READ`.
//!
//! INT0 triggers on the falling edge, and the chip remembers an edge while INT0 is masked. A level
//! interrupt would repeat for ever if INT is stuck low. INT0 misses a frame if the queue is full,
//! or if INT stays low for another frame. [`Bus::has_frame`] checks the pin and fetches
//! these frames. If INT does not follow the chip, [`Bus::poll`] fetches them.
//!
//! The handler enables other interrupts, so that Timer0 counts milliseconds and the watchdog
//! detects a handler that hangs.

use core::sync::atomic::{Ordering, compiler_fence};

use super::chip::{EXINT, SPI, steal};
use super::flash::Image;
use super::pins::{CanInterrupt, CanSelect};
use super::spi::CanSpi;
use firmware::hardware::{CAN_INTERRUPT, CanCounters, OUTPUTS};
use firmware::node::acceptance::NodeAcceptance;
use mcp2515_ordered::{Frame, Mcp2515, Notice};

/// The CAN controller with its driver.
pub type Can = Mcp2515<CanSpi, CanSelect, CanInterrupt, NodeAcceptance<Image>>;

/// Frames that can wait for the main loop. A power of two. The longest turn of the main loop takes
/// 250 us, which is as long as three of the shortest frames of a transfer. With several outputs two
/// such turns and an update of an output can come together.
const QUEUE_LEN: u8 = if OUTPUTS == 1 { 4 } else { 8 };

/// The number of the interrupt: INT0 is on D2, INT1 on D3.
const INTERRUPT: u8 = CAN_INTERRUPT.bit - 2;

/// The bit of the interrupt in EIMSK, and of its flag in EIFR.
const INT0_BIT: u8 = 1 << INTERRUPT;

/// ISC01..0 = 2 in EICRA: the falling edge. The bits of INT1 follow those of INT0.
const FALLING_EDGE: u8 = 2 << (2 * INTERRUPT);

// Safety: these are the only values of the SPI and of CS: `Pins` has none. Nothing uses them before
// they are set up: CS is set up by `Pins::new`, which makes the argument of `Bus::new`, and
// `Bus::new` sets up the SPI before it enables INT0 and returns the `Bus`.
static mut CAN: Can = unsafe {
    Mcp2515::unconfigured(
        CanSpi::steal(),
        CanSelect::steal(),
        CanInterrupt::new(),
        NodeAcceptance::nobody(Image),
    )
};

/// Returns the driver.
///
/// # Safety
///
/// INT0 must stay masked as long as the reference is alive, and there must be no other reference.
unsafe fn can<'a>() -> &'a mut Can {
    let can = &raw mut CAN;
    // Safety: the pointer is to a static, so it is always valid. The caller guarantees that there
    // is no other reference.
    unsafe { &mut *can }
}

/// The queue. `WRITTEN` and `READ` count the frames written and read so far, modulo 256.
static mut QUEUE: [Frame; QUEUE_LEN as usize] = [Frame::EMPTY; QUEUE_LEN as usize];
static mut WRITTEN: u8 = 0;
static mut READ: u8 = 0;

/// Reads a counter that the other side may change. An `AtomicU8` would disable interrupts for the
/// read, and a byte does not need that.
fn load(counter: *const u8) -> u8 {
    // Safety: callers pass only `WRITTEN` and `READ`, which are statics and thus valid. One
    // instruction reads a byte, so the value is never torn. The read is volatile because the
    // other side changes the counter between two reads.
    unsafe { counter.read_volatile() }
}

/// The bytes of the queue before the place of a counter. A product of one byte: the compiler makes
/// one of two bytes from halves, at 14 bytes of flash each.
fn offset(counter: u8) -> usize {
    const { assert!(QUEUE_LEN as usize * size_of::<Frame>() < 256) };
    usize::from((counter % QUEUE_LEN).wrapping_mul(size_of::<Frame>() as u8))
}

fn exint() -> EXINT {
    // Safety: `Bus::new` has consumed these registers, so only this module uses them. One
    // instruction writes each register, so an interrupt cannot come between a read and a write.
    unsafe { steal::<EXINT>() }
}

fn mask() {
    // Safety: every value of EIMSK is valid.
    exint().eimsk.modify(|r, w| unsafe { w.bits(r.bits() & !INT0_BIT) });
    // The compiler must not move an access to the controller to before the mask is set.
    compiler_fence(Ordering::SeqCst);
}

fn unmask() {
    // The compiler must not move an access to the controller to after the mask is cleared.
    compiler_fence(Ordering::SeqCst);
    // Safety: every value of EIMSK is valid.
    exint().eimsk.modify(|r, w| unsafe { w.bits(r.bits() | INT0_BIT) });
}

/// Moves frames from the controller to the queue until the controller is empty or the queue is
/// full.
///
/// # Safety
///
/// INT0 must be masked, and no reference to the controller may be alive.
#[inline(never)]
unsafe fn fetch() {
    // Safety: the caller guarantees that INT0 is masked, so the handler gets no reference, and that
    // no other reference is alive.
    let can = unsafe { can() };
    while can.has_frame() {
        let written = load(&raw const WRITTEN);
        if written.wrapping_sub(load(&raw const READ)) == QUEUE_LEN {
            return;
        }
        // Clears the flag, so that an edge from here on triggers INT0 again. A write changes only
        // the bits that are 1.
        // Safety: every value of EIFR is valid.
        exint().eifr.write(|w| unsafe { w.bits(INT0_BIT) });
        // Safety: the index is less than the length. The main loop has references only to places
        // from READ to WRITTEN, and this place is not among them, because the queue is not
        // full.
        let place = unsafe { &mut *(&raw mut QUEUE).cast::<Frame>().byte_add(offset(written)) };
        if !can.receive(place) {
            // INT does not follow the chip. The driver checks for that every 10 ms.
            return;
        }
        // Safety: the pointer is to a static. Only the owner of the controller writes this counter,
        // and that is the caller.
        unsafe { (&raw mut WRITTEN).write_volatile(written.wrapping_add(1)) };
    }
}

/// Does the work of the handler of the interrupt, with other interrupts enabled.
fn fetch_in_handler() {
    // Safety: INT0 is masked, so the handler cannot interrupt itself, and no other handler uses the
    // controller or the queue. INT0 was enabled when the handler started, and the main loop has
    // a reference to the controller only in the methods of `Bus` that mask INT0.
    unsafe { fetch() };
}

/// The handler of the interrupt.
#[cfg(not(feature = "outputs"))]
fn handle_interrupt() {
    mask();
    // Safety: INT0 is masked, so this handler cannot interrupt itself.
    unsafe { avr_device::interrupt::enable() };
    fetch_in_handler();
    avr_device::interrupt::disable();
    unmask();
}

#[cfg(all(can_interrupt = "INT0", not(feature = "outputs")))]
super::chip::interrupt!(INT0 { handle_interrupt() });
#[cfg(all(can_interrupt = "INT1", not(feature = "outputs")))]
super::chip::interrupt!(INT1 { handle_interrupt() });

// The handler of the interrupt does the same in the other order: it enables interrupts before it
// saves registers, and disables them after it has restored them. An edge of an output waits for it
// (see `outputs.rs`).
//
// SREG = 0x3F, EIMSK = 0x1D.
#[cfg(feature = "outputs")]
core::arch::global_asm!(
    ".global __vector_{vector}",
    "__vector_{vector}:",
    "    push r24",
    "    in   r24, 0x3F",
    "    cbi  0x1D, {bit}",
    "    sei",
    "    push r24",
    "    push r0",
    "    push r1",
    "    clr  r1",
    "    push r18",
    "    push r19",
    "    push r20",
    "    push r21",
    "    push r22",
    "    push r23",
    "    push r25",
    "    push r26",
    "    push r27",
    "    push r30",
    "    push r31",
    "    call {fetch}",
    "    pop  r31",
    "    pop  r30",
    "    pop  r27",
    "    pop  r26",
    "    pop  r25",
    "    pop  r23",
    "    pop  r22",
    "    pop  r21",
    "    pop  r20",
    "    pop  r19",
    "    pop  r18",
    "    pop  r1",
    "    pop  r0",
    "    pop  r24",
    "    cli",
    "    sbi  0x1D, {bit}",
    "    out  0x3F, r24",
    "    pop  r24",
    "    reti",
    vector = const INTERRUPT + 1,
    bit = const INTERRUPT,
    fetch = sym fetch_for_handler,
);

#[cfg(feature = "outputs")]
extern "C" fn fetch_for_handler() {
    fetch_in_handler();
}

/// The main loop's access to the controller and the queue.
pub struct Bus {
    interrupt: CanInterrupt,
}

impl Bus {
    /// Sets up the SPI, and enables INT0. The pins must be set up.
    pub(super) fn new(spi: SPI, exint: EXINT, interrupt: CanInterrupt) -> Self {
        CanSpi::set_up(spi);
        // Safety: every value of EICRA and EIMSK is valid.
        unsafe {
            exint.eicra.write(|w| w.bits(FALLING_EDGE));
            exint.eimsk.write(|w| w.bits(INT0_BIT));
        }
        Self { interrupt }
    }

    /// Calls `what` with the controller. INT0 is masked meanwhile, so no frame is received.
    pub fn controller<R>(&mut self, what: impl FnOnce(&mut Can) -> R) -> R {
        mask();
        // Safety: INT0 stays masked until the reference ends. There is one `Bus`, and this method
        // borrows it mutably, so no other method has a reference.
        let result = what(unsafe { can() });
        unmask();
        result
    }

    /// Does the controller's next step: see [`Mcp2515::poll`]. If INT does not follow the
    /// controller, also fetches its frames.
    pub fn poll(&mut self, now_ms: u16) -> Option<Notice> {
        let (notice, is_int_wrong) = self.controller(|can| (can.poll(now_ms), can.is_int_wrong()));
        if is_int_wrong {
            self.fetch_missed();
        }
        notice
    }

    /// Fetches frames for which INT0 did not come.
    #[inline(never)]
    fn fetch_missed(&mut self) {
        mask();
        // Safety: INT0 is masked. This method borrows the one `Bus` mutably and has no reference to
        // the controller itself.
        unsafe { fetch() };
        unmask();
    }

    /// True if a received frame waits. Fetches frames that INT0 missed.
    pub fn has_frame(&mut self) -> bool {
        if load(&raw const WRITTEN) == load(&raw const READ) {
            if !self.interrupt.is_pulled_low() {
                return false;
            }
            self.fetch_missed();
        }
        load(&raw const WRITTEN) != load(&raw const READ)
    }

    /// Calls `act` with the oldest received frame, if there is one, and removes the frame from the
    /// queue.
    pub fn act_on_frame(&mut self, act: impl FnOnce(&Frame)) {
        let read = load(&raw const READ);
        if load(&raw const WRITTEN) == read {
            return;
        }
        // The handler may write the place until it has written `WRITTEN`, and again once `READ` is
        // written. The compiler must not move an access to the frame to before or after that.
        compiler_fence(Ordering::SeqCst);
        // Safety: the index is less than the length. The place is from READ to WRITTEN, so `fetch`
        // does not write it before READ is incremented.
        act(unsafe { &*(&raw const QUEUE).cast::<Frame>().byte_add(offset(read)) });
        compiler_fence(Ordering::SeqCst);
        // Safety: the pointer is to a static. Only the main loop writes this counter. The reference
        // to the frame has ended, so the place is free.
        unsafe { (&raw mut READ).write_volatile(read.wrapping_add(1)) };
    }
}

impl CanCounters for Bus {
    #[inline(never)]
    fn word(&self, n: u8) -> u16 {
        mask();
        // Safety: INT0 stays masked until the reference ends, so the handler has none. `controller`
        // and `has_frame` borrow the one `Bus` mutably, so neither is active.
        let word = unsafe { can() }.counters().word(n);
        unmask();
        word
    }
}
