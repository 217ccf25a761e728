//! The CAN controller, and the interrupt that gets frames out of it while the main loop does something else.
//!
//! The controller holds two frames, of some kinds only one, and the next may end 67 us after the last. So whatever takes
//! longer is done [`meanwhile`](Bus::meanwhile): with INT0 let in, whose handler takes the controller's frames to where the main
//! loop will find them. The rest of the time INT0 is masked, and the main loop has the controller to itself: then it looks
//! at the level of the pin, which is quicker than an interrupt.
//!
//! The handler lets other interrupts in, so the watchdog sees one that hangs.

use core::arch::asm;
use core::marker::PhantomData;
use core::sync::atomic::{Ordering, compiler_fence};

use avr_device::atmega168::EXINT;

use super::flash::Image;
use super::spi::{CanInterrupt, CanSelect, CanSpi};
use node::can::Frame;
use node::can::mcp2515::{Counted, Counters, Mcp2515};
use node::dronecan::acceptance::NodeAcceptance;

/// The CAN controller with its driver.
pub type Can = Mcp2515<CanSpi, CanSelect, CanInterrupt, NodeAcceptance<Image>>;

/// INT0 in EIMSK, and its flag in EIFR.
const INT0_BIT: u8 = 1 << 0;

/// The INT pin: its port, as IN has it, and its bit.
const PIND: u8 = 0x09;
const INT_PIN: u8 = 1 << 2;

/// The frame that the main loop is to handle next, and the one after it.
static mut FRAMES: [Frame; 2] = [Frame::EMPTY; 2];

/// Makes the second frame the first: 7 cycles a byte, of those that count, where a compiler's loop takes 12.
///
/// # Safety
///
/// Nobody else may have a reference to either.
#[inline(always)]
unsafe fn move_up() {
    // Safety: these are bytes of the two frames, whose order in memory is fixed: the length, the identifier, the data.
    unsafe {
        asm!(
            "1:",
            "ldd {byte}, Z+{size}",
            "st Z+, {byte}",
            "dec {left}",
            "brne 1b",
            byte = out(reg) _,
            size = const size_of::<Frame>(),
            left = inout(reg) FRAMES[1].len.wrapping_add(5) => _,
            inout("Z") &raw mut FRAMES => _,
            options(nostack),
        );
    }
}

/// The controller and what came out of it, with what is used most at the end: see [`node::node::Node`].
#[repr(C)]
struct Received {
    can: Can,
    /// How many of [`FRAMES`] there are. The others are the handler's.
    waiting: u8,
}

static mut RECEIVED: Received = Received {
    can: Mcp2515::new(CanSpi::new(), CanSelect::new(), CanInterrupt::new(), NodeAcceptance::nobody(Image)),
    waiting: 0,
};

impl Received {
    /// Whether the controller has a frame, or seems to, that there is room for.
    #[inline(always)]
    fn is_called(&mut self) -> bool {
        self.can.calls() && self.waiting < 2
    }

    /// Gets a frame out of the controller; whether there was one.
    #[inline(never)]
    fn fetch(&mut self) -> bool {
        // What comes from here on calls again. The bit is the only one that a write changes.
        exint().eifr().write(|w| w.intf().set(INT0_BIT));
        // Safety: one that is not waiting is not the main loop's.
        let frame = unsafe { if self.waiting == 0 { &mut FRAMES[0] } else { &mut FRAMES[1] } };
        let is_one = self.can.receive(frame);
        if is_one {
            self.waiting = self.waiting.wrapping_add(1);
        }
        is_one
    }
}

#[inline(always)]
fn exint() -> EXINT {
    // Safety: nobody else uses these registers.
    unsafe { EXINT::steal() }
}

#[inline(always)]
fn mask() {
    exint().eimsk().modify(|r, w| w.int().set(r.int().bits() & !INT0_BIT));
    // Or the compiler would move what comes next.
    compiler_fence(Ordering::SeqCst);
}

#[inline(always)]
fn unmask() {
    compiler_fence(Ordering::SeqCst);
    exint().eimsk().modify(|r, w| w.int().set(r.int().bits() | INT0_BIT));
}

#[avr_device::interrupt(atmega168)]
fn INT0() {
    mask();
    // Safety: INT0 is masked, so this handler is not interrupted by itself.
    unsafe { avr_device::interrupt::enable() };
    // Safety: only `Bus` uses this besides, and has no reference to it while INT0 is let in.
    let received = unsafe { &mut RECEIVED };
    // A line that stays low without a frame is the main loop's, which looks for that every 10 ms.
    while received.is_called() && received.fetch() {}
    avr_device::interrupt::disable();
    unmask();
}

/// The main loop's side of it.
pub struct Bus(());

impl Bus {
    pub(super) fn new() -> Self {
        exint().eimsk().write(|w| w.int().set(0));
        // A falling edge, which is remembered while masked.
        exint().eicra().write(|w| w.isc0().set(2));
        Self(())
    }

    #[inline(always)]
    fn received(&mut self) -> &mut Received {
        // Safety: there is one `Bus`, which is borrowed for as long as this is, and the handler does not run meanwhile.
        unsafe { &mut RECEIVED }
    }

    /// The controller.
    #[inline(always)]
    pub fn can(&mut self) -> &mut Can {
        &mut self.received().can
    }

    /// Does something that takes its time, while frames are received, and counted.
    #[inline(always)]
    pub fn meanwhile<R>(&mut self, what: impl FnOnce(&CanCounters) -> R) -> R {
        unmask();
        let result = what(&CanCounters(()));
        mask();
        result
    }

    /// Does something that has to be quick at first, and may take its time from where it says so.
    #[inline(always)]
    pub fn and_then_meanwhile(&mut self, what: impl for<'a> FnOnce(Door<'a>)) {
        what(Door(PhantomData));
        mask();
    }

    /// Gets a frame out of the controller, if it has one. Whether it had.
    #[inline(never)]
    pub fn receive(&mut self) -> bool {
        let received = self.received();
        received.is_called() && received.fetch()
    }

    /// Waits until there is one, but no longer than 0.1 ms.
    #[inline(always)]
    pub fn wait(&mut self) {
        let received = self.received();
        if received.waiting != 0 || received.can.has_seen_one() {
            return;
        }
        // Safety: reads the port only. A round takes 6 cycles, a compiler's twice as many.
        unsafe {
            asm!(
                "1:",
                "in {pins}, {pind}",
                "andi {pins}, {int}",
                "breq 2f",
                "dec {rounds}",
                "brne 1b",
                "2:",
                pins = out(reg_upper) _,
                rounds = inout(reg) 250u8 => _,
                pind = const PIND,
                int = const INT_PIN,
                options(nostack, readonly),
            );
        }
    }

    /// Whether there is a frame to [`handle`](Self::handle).
    #[inline(always)]
    pub fn has_frame(&mut self) -> bool {
        self.received().waiting != 0
    }

    /// Whether there is one, and that is such a one.
    #[inline(always)]
    pub fn has_frame_like(&mut self, is_such: impl FnOnce(&Frame) -> bool) -> bool {
        // Safety: while it waits it is not the handler's, and there is one `Bus`, which is borrowed.
        self.has_frame() && is_such(unsafe { &FRAMES[0] })
    }

    /// Changes the oldest frame, if there is one, before anybody handles it, while others are received.
    #[inline(always)]
    pub fn prepare(&mut self, what: impl FnOnce(&mut Frame)) {
        if self.has_frame() {
            Door(PhantomData).open();
            // Safety: while it waits it is not the handler's, and there is one `Bus`, which is borrowed.
            what(unsafe { &mut FRAMES[0] });
            mask();
        }
    }

    /// Handles the oldest frame that has come out of the controller, if there is one: what has to be quick at first, and may
    /// take its time from where it says so. Whether there was one.
    #[inline(always)]
    pub fn handle(&mut self, what: impl for<'a> FnOnce(&Frame, Door<'a>)) -> bool {
        if !self.has_frame() {
            return false;
        }
        // Safety: while it waits it is not the handler's, and there is one `Bus`, which is borrowed.
        what(unsafe { &FRAMES[0] }, Door(PhantomData));
        mask();
        self.release(0);
        true
    }

    /// Handles the oldest frame that is to be handled so, if there is one; it stays if it was not handled. Whether one was.
    #[inline(always)]
    pub fn handle_first(&mut self, is_such: impl Fn(&Frame) -> bool, what: impl FnOnce(&Frame) -> bool) -> bool {
        let waiting = self.received().waiting;
        if waiting == 0 {
            return false;
        }
        // Safety: as above.
        let [first, second] = unsafe { &FRAMES };
        let (n, frame) = if is_such(first) {
            (0, first)
        } else if waiting == 2 && is_such(second) {
            (1, second)
        } else {
            return false;
        };
        if !what(frame) {
            return false;
        }
        self.release(n);
        true
    }

    #[inline(never)]
    fn release(&mut self, n: u8) {
        let received = self.received();
        received.waiting = received.waiting.wrapping_sub(1);
        if received.waiting != 0 {
            if n == 0 {
                // Safety: the handler does not run meanwhile, and nobody else has a reference.
                unsafe { move_up() };
            }
            // One that there was no room for does not call again.
            self.receive();
        }
    }
}

/// What lets frames in, for what is done [`and_then_meanwhile`](Bus::and_then_meanwhile), or while a frame is
/// [`prepare`d](Bus::prepare) or [`handle`d](Bus::handle).
pub struct Door<'a>(PhantomData<&'a ()>);

impl Door<'_> {
    /// From here on frames are received, if there is a place for one: otherwise an interrupt would be for nothing.
    #[inline(always)]
    pub fn open(self) {
        // Safety: the handler does not run yet, and the `Bus` is borrowed for as long as this exists.
        if unsafe { &RECEIVED }.waiting < 2 {
            unmask();
        }
    }
}

/// What the controller has counted, for what is done [`meanwhile`](Bus::meanwhile).
pub struct CanCounters(());

impl CanCounters {
    /// Looks at them while nobody counts.
    #[inline(always)]
    fn look<R>(what: impl FnOnce(&Counters) -> R) -> R {
        mask();
        // Safety: the handler does not run now, and the `Bus` is borrowed for as long as this exists.
        let result = what(unsafe { &RECEIVED }.can.counters());
        unmask();
        result
    }
}

impl Counted for CanCounters {
    #[inline(never)]
    fn word(&self, n: u8) -> u16 {
        Self::look(|counters| counters.word(n))
    }

    #[inline(never)]
    fn copy(&self, places: &mut [[u8; 2]]) {
        // Byte by byte, seven cycles each: a compiler's loop over the words takes half as long again.
        let bytes = size_of::<Counters>().min(size_of_val(places)) as u8;
        Self::look(|counters| {
            // Safety: both have as many bytes, and nobody else looks at either.
            unsafe {
                asm!(
                    "1:",
                    "ld {byte}, Z+",
                    "st X+, {byte}",
                    "dec {left}",
                    "brne 1b",
                    byte = out(reg) _,
                    left = inout(reg) bytes => _,
                    inout("Z") counters as *const Counters => _,
                    inout("X") places.as_mut_ptr() => _,
                    options(nostack),
                );
            }
        });
    }
}
