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
//! the beginning of this handler 61. The sum is 100. The handler of Timer0's millisecond would take
//! 34 more. It begins with TCNT0 at 0, so an interrupt for this time comes a tick of Timer0
//! earlier. With the feature `rpm` the handlers of `shaft.rs` take 37 and 20 more, each with
//! another instruction, 4. The sum is 165, and `LEAD` longer.
//!
//! The main loop computes the edges for new widths, and writes them to one of two sets, while the
//! handler uses the other. The handler changes to the new set shortly before BOTTOM, and with it
//! writes OCR1x. So all widths of one call of [`Pulses::set`] begin in the same period.
//!
//! After `start` only the handler uses the 16-bit registers of Timer1, which share a byte of
//! temporary storage (section 16.3).

mod edges;

use super::chip::{PORTB, PORTC, PORTD, TC1};
use super::clock::TOP as TIMER0_TOP;
use super::flash::Image;
use super::pins::ServoSignal;
use super::timer1;
use edges::{
    BEGIN_AT, CHANGE_AHEAD, EDGE, Edge, FALLS, Falls, INCOMPLETE, KEPT, LEAD, MISSED, Moment, NEW,
    OTHER, SCHEDULE, SLOT, Switched, TICKS_OF_TIMER0, USED, enable_interrupt, modulo,
    modulo_of_pulse, other_falls, plus, tc0, tc1,
};
use firmware::hardware::{OUTPUTS, OutputPins};
use firmware::node::parameters::{Parameter, Parameters};
use firmware::parts::outputs::Pulses;
use firmware::parts::outputs::travel::Ticks;
use firmware::progmem::Progmem;

pub use edges::finish;

/// The outputs. They make no pulse before the first [`set`](Pulses::set).
pub struct Outputs {
    /// The pin of output 1.
    signal: ServoSignal,
    /// The ends of the pulses as they were set last.
    falls: Falls,
    /// True if one of them was not committed yet.
    has_change: bool,
    /// Only output 1 is in use. It needs no interrupt, and gets its widths at once.
    is_single: bool,
}

impl Outputs {
    pub(super) fn new(tc1: TC1, signal: ServoSignal) -> Self {
        timer1::stop(&tc1, &signal);
        Self { signal, falls: [Moment::NONE; OUTPUTS], has_change: false, is_single: false }
    }

    /// Starts the outputs in use, with OUT_RATE. Call it once, before interrupts are enabled, and
    /// while Timer0 runs.
    pub fn start(&mut self, parameters: &Parameters) {
        let (count, rate_hz) =
            (usize::from(parameters.outputs()), parameters.get(Parameter::OutRate));
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
        let mut at = 0;
        let mut pin_at = 0;
        for n in 0..OUTPUTS {
            let port = registers_of(Progmem::<OutputPins>::byte(Image, pin_at)).wrapping_add(PORTX);
            let mask = Progmem::<OutputPins>::byte(Image, pin_at + 1);
            pin_at += 2;
            let before = modulo((at / TICKS_OF_TIMER0).wrapping_add(TIMER0_TOP.into()));
            schedule.outputs[n] = Switched { port, mask, rise: schedule.moment(at), before };
            at += SLOT;
            if n < count {
                // DDRx is before PORTx. The bit of PORTx is 0.
                // Safety: these pins are of this module, and interrupts are not enabled yet.
                unsafe {
                    let direction = port.wrapping_sub(1);
                    direction.write_volatile(direction.read_volatile() | mask);
                }
            }
        }
        if self.is_single {
            return;
        }
        // Safety: the handler is not enabled yet.
        unsafe { USED = (&raw const FALLS).cast::<Falls>() };
        // The first event has no edge.
        let Moment { at, compare, .. } = schedule.moment(BEGIN_AT);
        *edge = Edge { at, port: schedule.outputs[0].port, set: 0, keep: u8::MAX };
        tc0().ocr0b().write(|w| w.set(plus(compare, schedule.timer0)));
        enable_interrupt();
    }
}

/// Offset of PORTx in the registers of a port; PINx is the first.
const PORTX: usize = 2;

/// The registers of port `B`, `C` or `D`.
fn registers_of(port: u8) -> *mut u8 {
    match port {
        b'B' => PORTB::PTR.cast_mut().cast::<u8>(),
        b'C' => PORTC::PTR.cast_mut().cast::<u8>(),
        _ => PORTD::PTR.cast_mut().cast::<u8>(),
    }
}

impl Pulses for Outputs {
    #[inline(never)]
    fn set(&mut self, output: usize, width: Ticks) {
        if self.is_single {
            // A pulse that has begun is not cut.
            let [fall, ..] = &mut self.falls;
            if fall.at != width && (width != 0 || !self.signal.is_driven_high()) {
                fall.at = width;
                timer1::set_width(&tc1(), width);
            }
            return;
        }
        // Safety: the handler changes neither the outputs nor the phase.
        let (switched, phase) = unsafe {
            (
                &*(&raw const SCHEDULE.outputs).cast::<Switched>().wrapping_add(output % OUTPUTS),
                SCHEDULE.phase,
            )
        };
        let at = if width == 0 { 0 } else { switched.rise.at.wrapping_add(width) };
        let fall = &mut self.falls[output % OUTPUTS];
        if fall.at != at {
            fall.at = at;
            fall.compare = plus(
                switched.before,
                modulo_of_pulse(width.wrapping_sub(LEAD + u16::from(phase)) / TICKS_OF_TIMER0),
            );
            self.has_change = true;
        }
    }

    #[inline(always)]
    fn set_level(&mut self, output: usize, is_high: bool) {
        // Safety: the handler does not change the outputs. A write to PINx, two registers before
        // PORTx, switches the bits of PORTx that are 1 in it and no others, in one instruction.
        unsafe {
            let outputs = (&raw const SCHEDULE.outputs).cast::<Switched>();
            let Switched { port, mask, .. } = *outputs.wrapping_add(output % OUTPUTS);
            if (port.read_volatile() & mask != 0) != is_high {
                port.wrapping_sub(2).write_volatile(mask);
            }
        }
    }

    #[inline(always)]
    fn commit(&mut self) {
        // Safety: a byte, which one instruction reads.
        let is_kept = unsafe { (&raw const OTHER).read_volatile() } == KEPT;
        if self.has_change && !is_kept {
            self.has_change = false;
            self.hand_over();
        }
    }
}

impl Outputs {
    /// Gives the new ends of the pulses to the handler.
    #[inline(never)]
    fn hand_over(&mut self) {
        // Safety: while `OTHER` is `INCOMPLETE` or `MISSED` the handler does not change to the
        // other set, so only the main loop uses that one.
        unsafe {
            (&raw mut OTHER).write_volatile(INCOMPLETE);
            let mut to = other_falls().cast::<Moment>();
            for fall in &self.falls {
                (&raw mut (*to).at).write_volatile(fall.at);
                (&raw mut (*to).compare).write_volatile(fall.compare);
                to = to.wrapping_add(1);
            }
            let is_missed = (&raw const OTHER).read_volatile() == MISSED;
            (&raw mut OTHER).write_volatile(if is_missed { KEPT } else { NEW });
        }
    }
}
