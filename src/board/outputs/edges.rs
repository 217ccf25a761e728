//! The interrupt that switches the outputs 2 to 8, and its schedule. [`outputs`](super) has the
//! whole.

use core::arch::global_asm;
use core::mem::offset_of;

use super::super::chip::{PORTB, PORTC, PORTD, TC0, TC1};
use super::super::clock::TOP as TIMER0_TOP;
use super::super::flash::Image;
use super::super::timer1::{self, TICKS};
use firmware::hardware::{OUTPUTS, OutputPins, SHAFT, SLOT_US};
use firmware::parts::outputs::travel::Ticks;
use firmware::progmem::Progmem;

/// Ticks of Timer1 in a tick of Timer0.
pub(super) const TICKS_OF_TIMER0: Ticks = 8;
/// Ticks of Timer0 in a millisecond, after which it begins again.
pub(super) const TIMER0_PERIOD: u8 = TIMER0_TOP + 1;

/// Ticks from the beginning of a pulse to the beginning of the next output's pulse.
pub(super) const SLOT: Ticks = (SLOT_US * (TICKS / 1_000_000)) as Ticks;

/// The interrupt comes at least this number of ticks before an edge. See the module.
pub(super) const LEAD: Ticks = if SHAFT.is_some() { 21 } else { 15 };

/// The handler takes an edge that is less than this number of ticks ahead. An edge that is farther
/// ahead is for a later round of Timer0.
pub(super) const DUE: Ticks = LEAD + 3 * TICKS_OF_TIMER0;

/// An edge that is this number of ticks ahead, modulo 65,536, or more, is late. If an interrupt
/// were missed, the next one, a millisecond later, would take the edge. The shortest period is
/// longer, so an edge of the next period does not look late.
pub(super) const LATE: Ticks = ((TICKS / 1000) as u16 + 0x200).wrapping_neg() & 0xFF00;

/// The handler changes to the new widths this number of ticks before BOTTOM. That is after the
/// longest pulse of the last slot, and early enough to be complete at BOTTOM even if a frame is
/// received meanwhile.
pub(super) const CHANGE_AHEAD: Ticks = 100;

/// Time of an event without an edge at the beginning of a period. So the change to new widths is
/// never followed by another one, for which TCNT1 would be due in the same period.
pub(super) const BEGIN_AT: Ticks = 1000;

/// OCIE0A and OCIE0B in TIMSK0, and OCF0B in TIFR0.
pub(super) const OCIE0A: u8 = 1 << 1;
pub(super) const OCIE0B: u8 = 1 << 2;
pub(super) const OCF0B: u8 = 1 << 2;

/// A time in a period.
#[derive(Clone, Copy)]
pub(super) struct Moment {
    /// Value of TCNT1.
    pub(super) at: Ticks,
    /// OCR0B for the interrupt before it, if TCNT0 is 0 when [`Schedule::timer0`] says which value
    /// it has.
    pub(super) compare: u8,
}

/// The next edge, as the handler needs it.
pub(super) struct Edge {
    pub(super) at: Ticks,
    /// Address of the port, which is below 256, the bits to set in it, and the bits to keep.
    pub(super) port: u8,
    pub(super) set: u8,
    pub(super) keep: u8,
}

/// What happens at the time of an event.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Event {
    /// Nothing: a period has begun.
    Begin,
    /// The pulse of the current slot begins.
    Rise,
    /// The pulse of the current slot ends.
    Fall,
    /// The handler changes to the new widths.
    Change,
}

/// What [`go_on`] knows.
pub(super) struct Schedule {
    /// The next event, and its slot.
    pub(super) event: Event,
    pub(super) slot: u8,
    /// Slots in use.
    pub(super) slots: u8,
    pub(super) change: Moment,
    /// TCNT0 in its tick that begins `phase` ticks after BOTTOM of the event's period.
    pub(super) timer0: u8,
    pub(super) phase: u8,
    /// Ticks of Timer0 in a period, modulo [`TIMER0_PERIOD`].
    pub(super) period: u8,
}

pub(super) static mut EDGE: Edge = Edge { at: 0, port: 0, set: 0, keep: 0 };

pub(super) static mut SCHEDULE: Schedule = Schedule {
    event: Event::Begin,
    slot: 0,
    slots: 0,
    change: Moment { at: 0, compare: 0 },
    timer0: 0,
    phase: 0,
    period: 0,
};

/// The widths of the pulses, in three sets: the one that the handler uses, the newest complete one,
/// and one that the main loop writes. The first two may be the same. 0 is no pulse.
pub(super) type Widths = [Ticks; OUTPUTS];
pub(super) static mut WIDTHS: [Widths; SETS as usize] = [[0; OUTPUTS]; SETS as usize];
/// Number of sets.
pub(super) const SETS: u8 = 3;
/// The set that the handler uses: only the handler changes it, and only to the newest one. A byte,
/// which one instruction reads or writes.
pub(super) static mut USED: u8 = 0;
/// The newest complete set: only the main loop changes it.
pub(super) static mut NEWEST: u8 = 0;

/// A set of widths.
#[inline(always)]
pub(super) fn widths(set: u8) -> *mut Widths {
    (&raw mut WIDTHS).cast::<Widths>().wrapping_add(set.into())
}

pub(super) fn tc0() -> TC0 {
    // Safety: `Clock` uses other registers of Timer0, and TIMSK0 only before interrupts are
    // enabled.
    unsafe { TC0::steal() }
}

pub(super) fn tc1() -> TC1 {
    // Safety: `Outputs::new` has consumed these registers. After `start` only the handler uses the
    // 16-bit registers.
    unsafe { TC1::steal() }
}

// The handler of the interrupt. It returns if the edge is not due. Else it polls the low byte of
// TCNT1 until the tick of the edge, in turns of 5 cycles of the 8 of a tick, and writes to the
// port. Then it disables its own interrupt, so that it can enable the others, and `go_on` prepares
// the next edge.
//
// SREG = 0x3F, TCNT1 = 0x84, TIMSK0 = 0x6E.
global_asm!(
    ".global __vector_15",
    "__vector_15:",
    "    push r24",
    "    in   r24, 0x3F",
    "    push r24",
    "    push r23",
    "    push r25",
    "    push r30",
    "    push r31",
    "    lds  r24, 0x84",
    "    lds  r25, 0x85",
    // Ticks ahead: r25 and r24.
    "    lds  r30, {edge}+{at}",
    "    lds  r31, {edge}+{at}+1",
    "    sub  r30, r24",
    "    sbc  r31, r25",
    "    movw r24, r30",
    // Not late, and not due: this was a round of Timer0 before the right one.
    "    cpi  r25, {late}",
    "    brsh 2f",
    "    clr  r23",
    "    cpi  r24, {due}",
    "    cpc  r25, r23",
    "    brsh 5f",
    "2:  lds  r30, {edge}+{port}",
    "    ldi  r31, 0",
    "    ld   r23, Z",
    "    lds  r24, {edge}+{set}",
    "    or   r23, r24",
    "    lds  r24, {edge}+{keep}",
    "    and  r23, r24",
    "    cpi  r25, {late}",
    "    brsh 4f",
    "    lds  r24, {edge}+{at}",
    "3:  lds  r25, 0x84",
    "    cpse r25, r24",
    "    rjmp 3b",
    "4:  st   Z, r23",
    "    ldi  r24, {ocie0a}",
    "    sts  0x6E, r24",
    "    sei",
    "    push r0",
    "    push r1",
    "    clr  r1",
    "    push r18",
    "    push r19",
    "    push r20",
    "    push r21",
    "    push r22",
    "    push r26",
    "    push r27",
    "    call {go_on}",
    "    pop  r27",
    "    pop  r26",
    "    pop  r22",
    "    pop  r21",
    "    pop  r20",
    "    pop  r19",
    "    pop  r18",
    "    pop  r1",
    "    pop  r0",
    "5:  pop  r31",
    "    pop  r30",
    "    pop  r25",
    "    pop  r23",
    "    pop  r24",
    "    out  0x3F, r24",
    "    pop  r24",
    "    reti",
    edge = sym EDGE,
    at = const offset_of!(Edge, at),
    port = const offset_of!(Edge, port),
    set = const offset_of!(Edge, set),
    keep = const offset_of!(Edge, keep),
    go_on = sym go_on,
    due = const DUE,
    late = const LATE >> 8,
    ocie0a = const OCIE0A,
);

/// Prepares the next edge. The handler calls it with interrupts enabled and its own disabled.
/// Returns the other way round.
extern "C" fn go_on() {
    let (schedule, edge) = (&raw mut SCHEDULE, &raw mut EDGE);
    // Safety: after `start` only this function and the handler use these, and the handler is
    // disabled.
    let (schedule, edge) = unsafe { (&mut *schedule, &mut *edge) };
    let Moment { at, compare } = schedule.advance(edge);
    edge.at = at;
    let mut compare = plus(compare, schedule.timer0);
    if compare == TIMER0_TOP {
        // Before the handler of the millisecond, which begins when this tick ends.
        compare -= 1;
    }
    avr_device::interrupt::disable();
    // If the interrupt cannot come in time, it comes as soon as it can. That takes more than two
    // frames since the last edge.
    let ahead = at.wrapping_sub(tc1().tcnt1().read().bits());
    let is_in_time = (DUE..LATE).contains(&ahead);
    tc0()
        .ocr0b()
        .write(|w| w.set(if is_in_time { compare } else { plus(tc0().tcnt0().read().bits(), 2) }));
    enable_interrupt();
}

/// Enables the interrupt of Timer0's compare match B.
pub(super) fn enable_interrupt() {
    // The old value may have matched meanwhile. A write to TIFR0 changes only the bits that are 1.
    // Safety: every value of TIFR0 and TIMSK0 is valid.
    unsafe {
        tc0().tifr0().write(|w| w.bits(OCF0B));
        tc0().timsk0().write(|w| w.bits(OCIE0A | OCIE0B));
    }
}

/// Adds ticks of Timer0, modulo its period. Both are less than the period.
pub(super) fn plus(a: u8, b: u8) -> u8 {
    let room = TIMER0_PERIOD.wrapping_sub(b);
    if a >= room { a.wrapping_sub(room) } else { a.wrapping_add(b) }
}

/// Ticks of Timer0 modulo its period. There are at most 5,000 of them in a period of Timer1, 20 ms.
pub(super) fn modulo(mut ticks: u16) -> u8 {
    while ticks >= TIMER0_PERIOD.into() {
        ticks -= u16::from(TIMER0_PERIOD);
    }
    ticks as u8
}

/// Offset of PORTx in the registers of a port; PINx is the first.
const PORTX: u8 = 2;

/// The address of PORTx of an output, and the mask of its pin.
#[inline(always)]
pub(super) fn pin(output: usize) -> (u8, u8) {
    let at = 2 * (output % OUTPUTS) as u16;
    let first = match Progmem::<OutputPins>::byte(Image, at) {
        b'B' => PORTB::PTR.addr(),
        b'C' => PORTC::PTR.addr(),
        _ => PORTD::PTR.addr(),
    };
    (first as u8 + PORTX, Progmem::<OutputPins>::byte(Image, at + 1))
}

/// The register with this address.
#[inline(always)]
pub(super) fn register(address: u8) -> *mut u8 {
    core::ptr::with_exposed_provenance_mut(address.into())
}

impl Schedule {
    /// Goes on to the next event. Returns its time.
    fn advance(&mut self, edge: &mut Edge) -> Moment {
        // Safety: only this handler writes `USED`. The main loop writes to other sets only.
        let widths = unsafe { &*widths((&raw const USED).read()) };
        if self.event == Event::Rise {
            self.event = Event::Fall;
            edge.keep = !edge.set;
            edge.set = 0;
            return self.moment_of_slot(widths[usize::from(self.slot) % OUTPUTS]);
        }
        // An event without an edge changes no bit.
        edge.set = 0;
        edge.keep = u8::MAX;
        match self.event {
            Event::Change => {
                change();
                self.event = Event::Begin;
                self.slot = 0;
                self.timer0 = plus(self.timer0, self.period);
                return self.moment_of_slot(BEGIN_AT);
            }
            Event::Begin | Event::Rise | Event::Fall => {}
        }
        let mut width = widths.as_ptr().wrapping_add(self.slot.into());
        loop {
            self.slot += 1;
            width = width.wrapping_add(1);
            if self.slot >= self.slots {
                self.event = Event::Change;
                return self.change;
            }
            // Safety: `slots` is at most the number of widths in a set.
            if unsafe { *width } != 0 {
                self.event = Event::Rise;
                (edge.port, edge.set) = pin(self.slot.into());
                return self.moment_of_slot(0);
            }
        }
    }

    /// A time in the period. The flag is set when the tick of Timer0 with the number of OCR0B ends.
    pub(super) fn moment(&self, at: Ticks) -> Moment {
        let ticks = at.wrapping_sub(LEAD + u16::from(self.phase)) / TICKS_OF_TIMER0;
        Moment { at, compare: modulo(ticks.wrapping_sub(1)) }
    }

    /// The time `after` ticks, at most a slot, from the beginning of the current slot. It is equal
    /// to that of [`moment`](Self::moment), whose division takes 200 cycles.
    #[inline(never)]
    fn moment_of_slot(&self, after: Ticks) -> Moment {
        const PERIOD: u16 = TIMER0_PERIOD as u16;
        /// Ticks of Timer0 from BOTTOM to an odd slot, modulo its period. An even slot has 0.
        const ODD: u8 = (SLOT / TICKS_OF_TIMER0 % PERIOD) as u8;
        const {
            assert!(SLOT.is_multiple_of(TICKS_OF_TIMER0));
            assert!((2 * SLOT / TICKS_OF_TIMER0).is_multiple_of(PERIOD));
            assert!(SLOT / TICKS_OF_TIMER0 + PERIOD < 4 * PERIOD);
        }
        // A period of Timer0 more, so that the difference is not negative.
        let since = after + (PERIOD * TICKS_OF_TIMER0 - LEAD) - u16::from(self.phase);
        let mut ticks = since / TICKS_OF_TIMER0;
        if ticks >= 2 * PERIOD {
            ticks -= 2 * PERIOD;
        }
        if ticks >= PERIOD {
            ticks -= PERIOD;
        }
        let before = if self.slot & 1 == 0 { TIMER0_PERIOD - 1 } else { ODD - 1 };
        let at = u16::from(self.slot) * SLOT + after;
        Moment { at, compare: plus(ticks as u8, before) }
    }
}

/// Changes to the newest widths. No pulse is active.
fn change() {
    // Safety: only this function writes `USED`, and the main loop does not write the newest set.
    let width = unsafe {
        let newest = (&raw const NEWEST).read_volatile();
        (&raw mut USED).write_volatile(newest);
        (*widths(newest))[0]
    };
    timer1::set_width(&tc1(), width);
}

/// Ends the pulse that an interrupt would end. For a restart of the program: call it with
/// interrupts disabled, after which no pulse begins.
pub fn finish() {
    let (schedule, edge) = (&raw const SCHEDULE, &raw const EDGE);
    // Safety: interrupts are disabled, so the handler does not run.
    let (event, edge) = unsafe { ((*schedule).event, &*edge) };
    if event != Event::Fall {
        return;
    }
    let mut turns = timer1::TURNS_OF_A_PULSE;
    while turns != 0 && edge.at.wrapping_sub(tc1().tcnt1().read().bits()) < LATE {
        turns -= 1;
    }
    // Safety: the port is PORTx of an output, and nothing interrupts.
    unsafe {
        let port = register(edge.port);
        port.write_volatile(port.read_volatile() & edge.keep);
    }
}
