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

use avr_device::atmega168::EXINT;

use super::flash::Image;
use super::spi::{CanInterrupt, CanSelect, CanSpi};
use node::can::Frame;
use node::can::mcp2515::{Counted, Mcp2515};
use node::node::acceptance::NodeAcceptance;

/// The CAN controller with its driver.
pub type Can = Mcp2515<CanSpi, CanSelect, CanInterrupt, NodeAcceptance<Image>>;

/// Frames that can wait for the main loop. A power of two. The longest turn of the main loop, 250 us, is as long as three of the shortest frames
/// of a transfer.
const QUEUE_LEN: u8 = 4;

/// INT0 in EIMSK, and its flag in EIFR.
const INT0_BIT: u8 = 1 << 0;

static mut CAN: Can = Mcp2515::new(CanSpi::new(), CanSelect::new(), CanInterrupt::new(), NodeAcceptance::nobody(Image));

/// The queue. Frames written and read so far are counted modulo 256.
static mut QUEUE: [Frame; QUEUE_LEN as usize] = [Frame::EMPTY; QUEUE_LEN as usize];
static mut WRITTEN: u8 = 0;
static mut READ: u8 = 0;

/// Reads a counter that the other side may change. An `AtomicU8` would hold interrupts back for it, which a byte does not need.
#[inline(always)]
fn load(counter: *const u8) -> u8 {
    // Safety: both counters are always there and valid, and a byte is read at once. Volatile, because it changes in between.
    unsafe { counter.read_volatile() }
}

#[inline(always)]
fn exint() -> EXINT {
    // Safety: no other code uses these three registers, and each is written by one instruction.
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

/// Moves frames from the controller to the queue, as long as there are some, and room. Only with INT0 masked.
#[inline(never)]
fn fetch() {
    // Safety: INT0 is masked, so whoever calls this owns the controller.
    let can = unsafe { &mut *(&raw mut CAN) };
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
    // Safety: INT0 is masked, so this handler is not interrupted by itself.
    unsafe { avr_device::interrupt::enable() };
    fetch();
    avr_device::interrupt::disable();
    unmask();
}

/// The main loop's side of it.
pub struct Bus(());

impl Bus {
    pub(super) fn new() -> Self {
        // A falling edge.
        exint().eicra().write(|w| w.isc0().set(2));
        exint().eimsk().write(|w| w.int().set(INT0_BIT));
        Self(())
    }

    /// Does something with the controller. Meanwhile no frame is received.
    #[inline(always)]
    pub fn controller<R>(&mut self, what: impl FnOnce(&mut Can) -> R) -> R {
        mask();
        // Safety: INT0 is masked until this reference is gone, and there is one `Bus`, which is borrowed.
        let result = what(unsafe { &mut *(&raw mut CAN) });
        unmask();
        result
    }

    /// Whether a received frame waits.
    #[inline(always)]
    pub fn has_frame(&mut self) -> bool {
        if load(&raw const WRITTEN) == load(&raw const READ) {
            if !CanInterrupt::is_low_now() {
                return false;
            }
            mask();
            fetch();
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
        // Safety: INT0 is masked, so nobody counts.
        let word = unsafe { &*(&raw const CAN) }.counters().word(n);
        unmask();
        word
    }
}
