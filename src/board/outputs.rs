//! The pulses of eight outputs. Timer1 makes the pulse of output 1, and an interrupt those of the
//! others.
//!
//! Timer1 is in the mode that it has for a single servo (see `timer1.rs`): a period begins at
//! BOTTOM, and OC1x makes the pulse of output 1 without software. How the other pulses lie in a
//! period says [`Layout`]:
//!
//! * Slots: a slot of 2.5 ms for each output. The pulse of output `n` begins with slot `n`, counted
//!   from 1, and lasts 500 us to 2400 us, so no two edges are closer together than 100 us.
//! * Overlapping, for three motors beside output 1: the pulses begin 128 us after each other, and
//!   the shortest begins first. So they also end at least 128 us after each other. The order and
//!   the widths are those of the beginning of the period.
//! * A chain, for OneShot125: each pulse begins half a microsecond after the end of the one before
//!   it, in the same interrupt. So its period changes with the pulses before it.
//!
//! In mode 14 Timer1 takes a compare value over at BOTTOM only, so it cannot interrupt at each
//! edge. Timer0 can: in CTC mode its compare value takes effect at once (ATmega48/88/168 datasheet
//! 2545, section 15.7.2). A tick of Timer0 is 8 ticks of Timer1, so the interrupt comes
//! [`LEAD`](edges::schedule::LEAD) to `LEAD` + 7 ticks early. Its handler then polls TCNT1, and
//! switches the pin in the tick of the edge.
//!
//! `LEAD` covers the longest time from the interrupt's flag to the poll. In cycles of 62.5 ns, from
//! the instructions of the handlers: the end of the handler of INT0 12, the main loop while it
//! writes a width 9, the beginning of the handler of INT0 for another frame 19, an instruction 4,
//! and the beginning of this handler 60. The sum is 104. The handler of Timer0's millisecond would
//! take 34 more. It begins with TCNT0 at 0, so an interrupt for this time comes a tick of Timer0
//! earlier. With the feature `rpm` the handlers of `shaft.rs` take 37 and 20 more, each with
//! another instruction, 4. The sum is 169, and `LEAD` longer.
//!
//! The main loop writes a width at any time. The handler reads it right after the pulse has begun,
//! so a pulse has the newest width, unless pulses overlap. A pulse that the handler has decided to
//! begin, but whose width has become 0 since then, lasts as long as it was decided. The width of
//! output 1 is read shortly before BOTTOM, where Timer1 takes OCR1x over. After each edge the
//! handler computes the next one.
//!
//! After `start` only the handler uses the 16-bit registers of Timer1, which share a byte of
//! temporary storage (section 16.3).

mod edges;

use super::chip::TC1;
use super::pins::ServoSignal;
use super::timer1;
use edges::schedule::{Event, TICKS_OF_TIMER0, pin, plus, register, tc1, width_of};
use edges::{SCHEDULE, enable_interrupt, tc0};
use firmware::hardware::{HAS_ESCS, OUTPUTS};
use firmware::parts::outputs::Pulses;
use firmware::parts::outputs::travel::Ticks;
use firmware::tables::parameters::{Layout, Parameters};

pub use edges::finish;

/// The outputs. They make no pulse before the first [`set`](Pulses::set).
pub struct Outputs {
    /// The pin of output 1.
    signal: ServoSignal,
    /// Only output 1 is in use. It needs no interrupt, and gets its widths at once.
    is_single: bool,
    layout: Layout,
}

impl Outputs {
    pub(super) fn new(tc1: TC1, signal: ServoSignal) -> Self {
        timer1::stop(&tc1, &signal);
        Self { signal, is_single: false, layout: Layout::Slots }
    }

    /// Starts the outputs in use, with the timing that the parameters ask for. Call it once, before
    /// interrupts are enabled, and while Timer0 runs.
    pub fn start(&mut self, parameters: &Parameters) {
        let count = usize::from(parameters.outputs()).min(OUTPUTS);
        self.layout = parameters.layout();
        self.is_single = count == 1;
        let mut period = timer1::period(parameters.rate_hz());
        if !self.is_single {
            // A multiple of a tick of Timer0, so that the timers keep their phase.
            period &= !(TICKS_OF_TIMER0 - 1);
        }
        let tc1 = tc1();
        timer1::set_period(&tc1, period);
        timer1::run(&tc1);
        let schedule = &raw mut SCHEDULE;
        // Safety: the handler is not enabled yet.
        let schedule = unsafe { &mut *schedule };
        // Wait for the end of a tick of Timer0, 64 cycles at most.
        let before = tc0().tcnt0.read().bits();
        let mut timer0 = before;
        while timer0 == before || timer0 == 0 {
            timer0 = tc0().tcnt0.read().bits();
        }
        let phase = tc1.tcnt1.read().bits() as u8;
        schedule.begin(self.layout, count as u8, period, timer0, phase);
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
        schedule.edge.at = schedule.change.at;
        tc0().ocr0b.write(|w| w.bits(plus(schedule.change.compare, schedule.timer0)));
        enable_interrupt();
    }
}

impl Pulses for Outputs {
    #[inline(never)]
    fn set(&mut self, output: usize, pulse: Ticks) {
        let width = self.layout.width(pulse);
        let current = width_of(output);
        // A pulse that has begun is not cut.
        let is_cut = self.is_single && width == 0 && self.signal.is_driven_high();
        // Safety: `current` points to a width, and only the main loop writes widths.
        if unsafe { *current } == width || is_cut {
            return;
        }
        // Safety: as above. Without interrupts the handler never reads half of a width.
        avr_device::interrupt::free(|_| unsafe { current.write_volatile(width) });
        if self.is_single {
            timer1::set_width(&tc1(), width);
        }
    }

    #[inline(always)]
    fn next(&self) -> Option<u8> {
        if HAS_ESCS && self.layout != Layout::Slots {
            return None;
        }
        let schedule = &raw const SCHEDULE;
        // Safety: the pointer is to a static. One instruction reads each byte. If the handler
        // changes one between the reads, the next output is followed one turn later.
        let (output, event) = unsafe {
            (
                (&raw const (*schedule).output).read_volatile(),
                (&raw const (*schedule).event).read_volatile(),
            )
        };
        Some(output.wrapping_add((event != Event::Rise).into()))
    }

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
}
