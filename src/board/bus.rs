//! The CAN controller, and the interrupt that takes frames out of it whatever the main loop does.
//!
//! The controller holds two frames, of some types only one, and the next may end 67 us after the last. So INT0 moves each frame to a queue of
//! [`QUEUE_LEN`] as soon as it is there, and the main loop takes them from the queue.
//!
//! The controller, its SPI and its pins have one owner at a time: the handler while INT0 is let in, and the main loop while it is masked, which
//! is only within [`Bus::controller`]. The queue has one writer and one reader: the handler fills the place at `written` before it counts that
//! up, and the main loop empties the place at `read` before it counts that up.
//!
//! The interrupt is that of the falling edge, which is remembered while masked: a level would come back for ever where INT is stuck. What it
//! misses, because the queue was full or INT fell and stayed low, [`Bus::has_frame`] finds by a look at the pin.
//!
//! The handler lets other interrupts in, so that milliseconds are counted and the watchdog sees a handler that hangs.

use core::sync::atomic::{Ordering, compiler_fence};

use avr_device::atmega168::{EXINT, SPI};

use super::flash::Image;
use super::pins::{CanInterrupt, CanSelect};
use super::spi::CanSpi;
use node::can::Frame;
use node::can::mcp2515::{Counted, Mcp2515};
use node::dronecan::acceptance::NodeAcceptance;

/// The CAN controller with its driver.
pub type Can = Mcp2515<CanSpi, CanSelect, CanInterrupt, NodeAcceptance<Image>>;

/// Frames that can wait for the main loop. A power of two. The longest turn of the main loop, 250 us, is as long as three of the shortest frames
/// of a transfer.
const QUEUE_LEN: u8 = 4;

/// INT0 in EIMSK, and its flag in EIFR.
const INT0_BIT: u8 = 1 << 0;

// Safety: these are the only values of the SPI and of CS, for `Pins` has no other. `Bus::new`, without which there is no `Bus` and no
// interrupt, is called after both are set up.
static mut CAN: Can =
    unsafe { Mcp2515::new(CanSpi::steal(), CanSelect::steal(), CanInterrupt::new(), NodeAcceptance::nobody(Image)) };

/// The driver.
///
/// # Safety
///
/// INT0 is masked as long as the reference is alive, and there is no other.
#[inline(always)]
unsafe fn can<'a>() -> &'a mut Can {
    let can = &raw mut CAN;
    // Safety: the static is always valid, and who calls this sees to it that there is no other reference.
    unsafe { &mut *can }
}

/// The queue. Frames written and read so far are counted modulo 256.
static mut QUEUE: [Frame; QUEUE_LEN as usize] = [Frame::EMPTY; QUEUE_LEN as usize];
static mut WRITTEN: u8 = 0;
static mut READ: u8 = 0;

/// Reads a counter that the other side may change. An `AtomicU8` would hold interrupts back for it, which a byte does not need.
#[inline(always)]
fn load(counter: *const u8) -> u8 {
    // Safety: only `WRITTEN` and `READ` are passed, which are statics and thus valid. A byte is read by one instruction, so it cannot be torn;
    // volatile, because the other side changes it in between.
    unsafe { counter.read_volatile() }
}

#[inline(always)]
fn exint() -> EXINT {
    // Safety: `Bus::new` has consumed these registers, so only this module uses them; each is written by one instruction.
    unsafe { EXINT::steal() }
}

#[inline(always)]
fn mask() {
    exint().eimsk().modify(|r, w| w.int().set(r.int().bits() & !INT0_BIT));
    // The compiler must not move what belongs to the owner of the controller out of the time in which it owns it.
    compiler_fence(Ordering::SeqCst);
}

#[inline(always)]
fn unmask() {
    compiler_fence(Ordering::SeqCst);
    exint().eimsk().modify(|r, w| w.int().set(r.int().bits() | INT0_BIT));
}

/// Moves frames from the controller to the queue, as long as there are some, and room.
///
/// # Safety
///
/// INT0 is masked, and no reference to the controller is alive.
#[inline(never)]
unsafe fn fetch() {
    // Safety: with INT0 masked, the handler cannot get a reference beside this one; the caller has none.
    let can = unsafe { can() };
    while can.calls() {
        let written = load(&raw const WRITTEN);
        if written.wrapping_sub(load(&raw const READ)) == QUEUE_LEN {
            return;
        }
        // What comes from here on calls again. The bit is the only one that a write changes.
        exint().eifr().write(|w| w.intf().set(INT0_BIT));
        // Safety: this place is not among those between READ and WRITTEN, which the main loop may have a reference to.
        let place = unsafe { &mut *(&raw mut QUEUE).cast::<Frame>().add(usize::from(written % QUEUE_LEN)) };
        if !can.receive(place) {
            // INT is low without a frame: the driver looks into that every 10 ms.
            return;
        }
        // Safety: only the owner of the controller writes this counter.
        unsafe { (&raw mut WRITTEN).write_volatile(written.wrapping_add(1)) };
    }
}

#[avr_device::interrupt(atmega168)]
fn INT0() {
    mask();
    // Safety: INT0 is masked, so this handler is not interrupted by itself, and no other handler uses the controller or the queue.
    unsafe { avr_device::interrupt::enable() };
    // Safety: INT0 is masked. It was not before, and outside `Bus::controller` and `Bus::word`, which mask it, nobody has a reference.
    unsafe { fetch() };
    avr_device::interrupt::disable();
    unmask();
}

/// The main loop's side of it.
pub struct Bus {
    interrupt: CanInterrupt,
}

impl Bus {
    /// Sets up the SPI and INT0. The pins must be set up.
    pub(super) fn new(spi: SPI, exint: EXINT, interrupt: CanInterrupt) -> Self {
        CanSpi::set_up(spi);
        // A falling edge.
        exint.eicra().write(|w| w.isc0().set(2));
        exint.eimsk().write(|w| w.int().set(INT0_BIT));
        Self { interrupt }
    }

    /// Does something with the controller. Meanwhile no frame is received.
    #[inline(always)]
    pub fn controller<R>(&mut self, what: impl FnOnce(&mut Can) -> R) -> R {
        mask();
        // Safety: INT0 is masked until this reference is gone, and there is one `Bus`, which is borrowed.
        let result = what(unsafe { can() });
        unmask();
        result
    }

    /// Whether a received frame waits.
    #[inline(always)]
    pub fn has_frame(&mut self) -> bool {
        if load(&raw const WRITTEN) == load(&raw const READ) {
            if !self.interrupt.is_pulled_low() {
                return false;
            }
            mask();
            // Safety: INT0 is masked, and this method has no reference to the controller.
            unsafe { fetch() };
            unmask();
        }
        load(&raw const WRITTEN) != load(&raw const READ)
    }

    /// Does something with the oldest received frame, if there is one.
    #[inline(always)]
    pub fn take_frame(&mut self, what: impl FnOnce(&Frame)) {
        let read = load(&raw const READ);
        if load(&raw const WRITTEN) == read {
            return;
        }
        // Safety: this place is between READ and WRITTEN, so the handler leaves it alone until READ is counted up.
        what(unsafe { &*(&raw const QUEUE).cast::<Frame>().add(usize::from(read % QUEUE_LEN)) });
        // Safety: only the main loop writes this counter, and the reference is gone.
        unsafe { (&raw mut READ).write_volatile(read.wrapping_add(1)) };
    }
}

impl Counted for Bus {
    #[inline(never)]
    fn word(&self, n: u8) -> u16 {
        mask();
        // Safety: INT0 is masked until this reference is gone, so the handler, which counts, has none.
        let word = unsafe { can() }.counters().word(n);
        unmask();
        word
    }
}
