//! The pulses of eight outputs. Timer1 makes the pulse of output 1, and an interrupt those of the
//! others.
//!
//! Timer1 is in the mode that it has for a single servo (see `timer1.rs`): a period begins at
//! BOTTOM, and OC1x makes the pulse of output 1 without software. A period has a slot of 2.5 ms for
//! each output, and the pulse of output `n` begins with slot `n`, counted from 1. A pulse lasts 500
//! us to 2400 us, so no two edges are closer together than 100 us.
//!
//! In mode 14 Timer1 takes a compare value over at BOTTOM only, so it cannot interrupt at each
//! edge. Timer0 can: in CTC mode its compare value takes effect at once (ATmega48/88/168 datasheet
//! 2545, section 15.7.2). A tick of Timer0 is 8 ticks of Timer1, so the interrupt comes
//! [`LEAD`](edges::LEAD) to `LEAD` + 7 ticks early. Its handler then polls TCNT1, and switches the
//! pin in the tick of the edge.
//!
//! `LEAD` covers the longest time from the interrupt's flag to the poll. In cycles of 62.5 ns, from
//! the instructions of the handlers: the end of the handler of INT0 12, an instruction of the main
//! loop 4, the beginning of the handler of INT0 for another frame 19, another instruction 4, and
//! the beginning of this handler 60. The sum is 99. The handler of Timer0's millisecond would take
//! 34 more. It begins with TCNT0 at 0, so an interrupt for this time comes a tick of Timer0
//! earlier. With the feature `rpm` the handlers of `shaft.rs` take 37 and 20 more, each with
//! another instruction, 4. The sum is 164, and `LEAD` longer.
//!
//! The widths are in three sets. The main loop writes to one, and declares it the newest when it is
//! complete. The handler changes to the newest set shortly before BOTTOM, and with it writes OCR1x.
//! So all widths between two calls of [`Pulses::commit`] begin in the same period, and no side
//! waits for the other. After each edge the handler computes the next one from the slot and the
//! width.
//!
//! After `start` only the handler uses the 16-bit registers of Timer1, which share a byte of
//! temporary storage (section 16.3).

mod edges;

use core::sync::atomic::{Ordering, compiler_fence};

use super::chip::TC1;
use super::pins::ServoSignal;
use super::timer1;
use edges::{
    BEGIN_AT, CHANGE_AHEAD, EDGE, Edge, Moment, NEWEST, SCHEDULE, TICKS_OF_TIMER0, USED,
    enable_interrupt, modulo, pin, plus, register, tc0, tc1, widths,
};
use firmware::hardware::OUTPUTS;
use firmware::parts::outputs::Pulses;
use firmware::parts::outputs::travel::Ticks;
use firmware::tables::parameters::{Parameter, Parameters};

pub use edges::finish;

/// The outputs. They make no pulse before the first [`set`](Pulses::set).
pub struct Outputs {
    /// The pin of output 1.
    signal: ServoSignal,
    /// The set that the main loop writes: the widths of the pulses as they were set last.
    set: u8,
    /// True if one of them was not committed yet.
    has_change: bool,
    /// Only output 1 is in use. It needs no interrupt, and gets its widths at once.
    is_single: bool,
}

impl Outputs {
    pub(super) fn new(tc1: TC1, signal: ServoSignal) -> Self {
        timer1::stop(&tc1, &signal);
        Self { signal, set: 1, has_change: false, is_single: false }
    }

    /// Starts the outputs in use, with OUT_RATE. Call it once, before interrupts are enabled, and
    /// while Timer0 runs.
    pub fn start(&mut self, parameters: &Parameters) {
        let count = usize::from(parameters.outputs()).min(OUTPUTS);
        let rate_hz = parameters.get(Parameter::OutRate);
        self.is_single = count == 1;
        let mut period = timer1::period(rate_hz);
        if !self.is_single {
            // A multiple of a tick of Timer0, so that the timers keep their phase.
            period &= !(TICKS_OF_TIMER0 - 1);
        }
        let tc1 = tc1();
        timer1::set_period(&tc1, period);
        timer1::run(&tc1);
        let (schedule, edge) = (&raw mut SCHEDULE, &raw mut EDGE);
        // Safety: the handler is not enabled yet.
        let (schedule, edge) = unsafe { (&mut *schedule, &mut *edge) };
        // Wait for the end of a tick of Timer0, 64 cycles at most.
        let before = tc0().tcnt0().read().bits();
        while schedule.timer0 == before || schedule.timer0 == 0 {
            schedule.timer0 = tc0().tcnt0().read().bits();
        }
        schedule.phase = tc1.tcnt1().read().bits() as u8;
        schedule.period = modulo(period / TICKS_OF_TIMER0);
        schedule.slots = count as u8;
        schedule.change = schedule.moment(period.wrapping_sub(CHANGE_AHEAD));
        for output in 0..count {
            let (port, mask) = pin(output);
            // DDRx is before PORTx. The bit of PORTx is 0.
            // Safety: these pins are of this module, and interrupts are not enabled yet.
            unsafe {
                let direction = register(port.wrapping_sub(1));
                direction.write_volatile(direction.read_volatile() | mask);
            }
        }
        if self.is_single {
            return;
        }
        // The first event has no edge.
        let Moment { at, compare } = schedule.moment(BEGIN_AT);
        let (port, _) = pin(0);
        *edge = Edge { at, port, set: 0, keep: u8::MAX };
        tc0().ocr0b().write(|w| w.set(plus(compare, schedule.timer0)));
        enable_interrupt();
    }
}

impl Pulses for Outputs {
    #[inline(never)]
    fn set(&mut self, output: usize, width: Ticks) {
        // Safety: only the main loop uses this set.
        let current = unsafe { &mut (*widths(self.set))[output % OUTPUTS] };
        // A pulse that has begun is not cut.
        let is_cut = self.is_single && width == 0 && self.signal.is_driven_high();
        if *current == width || is_cut {
            return;
        }
        *current = width;
        if self.is_single {
            timer1::set_width(&tc1(), width);
        } else {
            self.has_change = true;
        }
    }

    #[inline(always)]
    fn set_level(&mut self, output: usize, is_high: bool) {
        let (port, mask) = pin(output);
        // Safety: a write to PINx, two registers before PORTx, switches the bits of PORTx that are
        // 1 in it and no others, in one instruction.
        unsafe {
            if (register(port).read_volatile() & mask != 0) != is_high {
                register(port.wrapping_sub(2)).write_volatile(mask);
            }
        }
    }

    #[inline(always)]
    fn commit(&mut self) {
        if self.has_change {
            self.has_change = false;
            self.hand_over();
        }
    }
}

impl Outputs {
    /// Gives the new widths to the handler.
    #[inline(never)]
    fn hand_over(&mut self) {
        let newest = self.set;
        // Safety: bytes, which one instruction reads or writes. Volatile, so the set is complete
        // before. From here on the handler uses the set that it used, or this one.
        let used = unsafe {
            compiler_fence(Ordering::SeqCst);
            (&raw mut NEWEST).write_volatile(newest);
            (&raw const USED).read_volatile()
        };
        let is_free = |set| set != newest && set != used;
        let set = if is_free(0) {
            0
        } else if is_free(1) {
            1
        } else {
            2
        };
        self.set = set;
        // Safety: these are two sets. The handler reads one of them at most, and writes none.
        unsafe { *widths(set) = *widths(newest) };
    }
}
