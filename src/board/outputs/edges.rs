//! The interrupt that switches the outputs 2 to 8, and its schedule. [`outputs`](super) has the
//! whole.

use core::arch::global_asm;

use super::super::chip::{TC0, TC1};
use super::super::clock::TOP as TIMER0_TOP;
use super::super::timer1::{self, TICKS};
use firmware::hardware::{OUTPUTS, SHAFT, SLOT_US};
use firmware::parts::outputs::travel::Ticks;

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

/// A time in a period. Its size is a power of two, so that an index needs no multiplication.
#[derive(Clone, Copy)]
#[repr(C)]
pub(super) struct Moment {
    /// Value of TCNT1.
    pub(super) at: Ticks,
    /// OCR0B for the interrupt before it, if TCNT0 is 0 when [`Schedule::timer0`] says which value
    /// it has.
    pub(super) compare: u8,
    _unused: u8,
}

impl Moment {
    pub(super) const NONE: Self = Self::new(0, 0);

    pub(super) const fn new(at: Ticks, compare: u8) -> Self {
        Self { at, compare, _unused: 0 }
    }
}

/// The next edge, as the handler needs it.
#[repr(C)]
pub(super) struct Edge {
    pub(super) at: Ticks,
    /// The port, the bits to set in it, and the bits to keep.
    pub(super) port: *mut u8,
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

/// An output that interrupts switch. Its size is a power of two, as that of [`Moment`].
#[derive(Clone, Copy)]
#[repr(C)]
pub(super) struct Switched {
    pub(super) port: *mut u8,
    pub(super) mask: u8,
    /// The tick of Timer0 before the slot, as in [`Moment::compare`].
    pub(super) before: u8,
    pub(super) rise: Moment,
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
    pub(super) outputs: [Switched; OUTPUTS],
}

pub(super) static mut EDGE: Edge = Edge { at: 0, port: core::ptr::null_mut(), set: 0, keep: 0 };

pub(super) static mut SCHEDULE: Schedule = Schedule {
    event: Event::Begin,
    slot: 0,
    slots: 0,
    change: Moment::NONE,
    timer0: 0,
    phase: 0,
    period: 0,
    outputs: [Switched { port: core::ptr::null_mut(), mask: 0, rise: Moment::NONE, before: 0 };
        OUTPUTS],
};

/// The ends of the pulses, in two sets: see the module. An output whose pulse ends at 0 has none.
pub(super) type Falls = [Moment; OUTPUTS];
pub(super) static mut FALLS: [Falls; 2] = [[Moment::NONE; OUTPUTS]; 2];
/// The set that the handler uses.
pub(super) static mut USED: *const Falls = core::ptr::null();
/// What the other set is. A byte, which one instruction reads or writes.
pub(super) static mut OTHER: u8 = OLD;

/// The handler has used it, or has not had one yet.
pub(super) const OLD: u8 = 0;
/// It is complete, and newer.
pub(super) const NEW: u8 = 1;
/// The main loop writes it.
pub(super) const INCOMPLETE: u8 = 2;
/// It is complete, newer, and not to be written again before the handler changes to it.
pub(super) const KEPT: u8 = 3;
/// The main loop writes it, and the handler could not change to it. Commands may come in step with
/// the period, so the main loop keeps the set then: otherwise it could write one at each change.
pub(super) const MISSED: u8 = 4;

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
    "    lds  r30, {edge}",
    "    lds  r31, {edge}+1",
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
    "2:  lds  r30, {edge}+2",
    "    lds  r31, {edge}+3",
    "    ld   r23, Z",
    "    lds  r24, {edge}+4",
    "    or   r23, r24",
    "    lds  r24, {edge}+5",
    "    and  r23, r24",
    "    cpi  r25, {late}",
    "    brsh 4f",
    "    lds  r24, {edge}",
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
    let Moment { at, compare, .. } = schedule.advance(edge);
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

/// Ticks of Timer0 in the longest pulse, modulo its period. A remainder takes 200 cycles, this
/// takes 15.
pub(super) fn modulo_of_pulse(mut ticks: u16) -> u8 {
    const PERIOD: u16 = TIMER0_PERIOD as u16;
    const { assert!(SLOT / TICKS_OF_TIMER0 < 3 * PERIOD) };
    if ticks >= 2 * PERIOD {
        ticks -= 2 * PERIOD;
    } else if ticks >= PERIOD {
        ticks -= PERIOD;
    }
    ticks as u8
}

/// Ticks of Timer0 modulo its period. There are at most 5,000 of them in a period of Timer1, 20 ms.
pub(super) fn modulo(mut ticks: u16) -> u8 {
    while ticks >= TIMER0_PERIOD.into() {
        ticks -= u16::from(TIMER0_PERIOD);
    }
    ticks as u8
}

impl Schedule {
    /// Goes on to the next event. Returns its time.
    fn advance(&mut self, edge: &mut Edge) -> Moment {
        // Safety: `start` has set the pointer to one of two statics. The main loop writes to the
        // other one only.
        let falls = unsafe { &*(&raw const USED).read() };
        if self.event == Event::Rise {
            let slot = usize::from(self.slot) % OUTPUTS;
            self.event = Event::Fall;
            edge.set = 0;
            edge.keep = !self.outputs[slot].mask;
            return falls[slot];
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
                return self.moment(BEGIN_AT);
            }
            Event::Begin | Event::Rise | Event::Fall => {}
        }
        loop {
            self.slot += 1;
            if self.slot >= self.slots {
                self.event = Event::Change;
                return self.change;
            }
            let slot = usize::from(self.slot) % OUTPUTS;
            if falls[slot].at != 0 {
                let output = &self.outputs[slot];
                self.event = Event::Rise;
                edge.port = output.port;
                edge.set = output.mask;
                return output.rise;
            }
        }
    }

    /// A time in the period. The flag is set when the tick of Timer0 with the number of OCR0B ends.
    pub(super) fn moment(&self, at: Ticks) -> Moment {
        let ticks = at.wrapping_sub(LEAD + u16::from(self.phase)) / TICKS_OF_TIMER0;
        Moment::new(at, modulo(ticks.wrapping_sub(1)))
    }
}

/// The set that the handler does not use.
pub(super) fn other_falls() -> *mut Falls {
    let first = (&raw mut FALLS).cast::<Falls>();
    // Safety: the pointer is to a static. The handler changes it only while `OTHER` is `NEW` or
    // `KEPT`; the callers are the handler, and the main loop after it has made it `INCOMPLETE`. So
    // no interrupt comes between the reads of the two bytes of a value that changes.
    let used = unsafe { (&raw const USED).read_volatile() };
    if core::ptr::eq(used, first) { first.wrapping_add(1) } else { first }
}

/// Changes to the new widths, if there are any. No pulse is active.
pub(super) fn change() {
    // Safety: only this function writes `USED` after `start`. While the main loop writes the other
    // set, `OTHER` is `INCOMPLETE` or `MISSED`.
    let width = unsafe {
        let state = (&raw const OTHER).read_volatile();
        if state == INCOMPLETE {
            (&raw mut OTHER).write_volatile(MISSED);
        }
        if state & NEW == 0 {
            return;
        }
        (&raw mut OTHER).write_volatile(OLD);
        let other = other_falls();
        (&raw mut USED).write_volatile(other);
        (*other)[0].at
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
    unsafe { edge.port.write_volatile(edge.port.read_volatile() & edge.keep) };
}
