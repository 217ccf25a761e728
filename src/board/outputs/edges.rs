//! The interrupt that switches the outputs 2 to 8. [`outputs`](super) has the whole.

use core::arch::global_asm;
use core::mem::offset_of;

pub(super) mod schedule;

use super::super::chip::{TC0, steal};
use super::super::clock::TOP as TIMER0_TOP;
use super::super::timer1::{self, TICKS};
use firmware::parts::outputs::travel::Ticks;
use schedule::{Edge, Event, LEAD, Moment, Schedule, TICKS_OF_TIMER0, plus, register, tc1};

/// The handler takes an edge that is less than this number of ticks ahead. An edge that is farther
/// ahead is for a later round of Timer0.
const DUE: Ticks = LEAD + 2 * TICKS_OF_TIMER0;

/// An interrupt can come in time for an edge that is at least this number of ticks ahead.
const IN_TIME: Ticks = DUE + TICKS_OF_TIMER0;

/// An edge that is this number of ticks ahead, modulo 65,536, or more, is late. If an interrupt
/// were missed, the next one, a millisecond later, would take the edge. The shortest period is
/// longer, so an edge of the next period does not look late.
const LATE: Ticks = ((TICKS / 1000) as u16 + 0x200).wrapping_neg() & 0xFF00;

/// OCIE0A and OCIE0B in TIMSK0, and OCF0B in TIFR0.
const OCIE0A: u8 = 1 << 1;
const OCIE0B: u8 = 1 << 2;
const OCF0B: u8 = 1 << 2;

pub(super) static mut SCHEDULE: Schedule = Schedule::new();

pub(super) fn tc0() -> TC0 {
    // Safety: `Clock` uses other registers of Timer0, and TIMSK0 only before interrupts are
    // enabled.
    unsafe { steal::<TC0>() }
}

// The handler of the interrupt. It returns if the edge is not due. Else it polls the low byte of
// TCNT1 until the tick of the edge, in turns of 5 cycles of the 8 of a tick, and writes to the
// port, and 9 cycles later to the port of the next pulse of a chain. Then it disables its own
// interrupt, so that it can enable the others, and `go_on` prepares the next edge.
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
    "    lds  r30, {schedule}+{at}",
    "    lds  r31, {schedule}+{at}+1",
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
    "2:  lds  r30, {schedule}+{port}",
    "    ldi  r31, 0",
    "    ld   r23, Z",
    "    lds  r24, {schedule}+{set}",
    "    or   r23, r24",
    "    lds  r24, {schedule}+{keep}",
    "    and  r23, r24",
    "    cpi  r25, {late}",
    "    brsh 4f",
    "    lds  r24, {schedule}+{at}",
    "3:  lds  r25, 0x84",
    "    cpse r25, r24",
    "    rjmp 3b",
    "4:  st   Z, r23",
    // The next pulse of a chain.
    "    lds  r30, {schedule}+{next_port}",
    "    ld   r23, Z",
    "    lds  r24, {schedule}+{next_set}",
    "    or   r23, r24",
    "    st   Z, r23",
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
    "    ldi  r24, lo8({schedule})",
    "    ldi  r25, hi8({schedule})",
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
    schedule = sym SCHEDULE,
    at = const offset_of!(Schedule, edge.at),
    port = const offset_of!(Schedule, edge.port),
    set = const offset_of!(Schedule, edge.set),
    keep = const offset_of!(Schedule, edge.keep),
    next_port = const offset_of!(Schedule, edge.next_port),
    next_set = const offset_of!(Schedule, edge.next_set),
    go_on = sym go_on,
    due = const DUE,
    late = const LATE >> 8,
    ocie0a = const OCIE0A,
);

/// Prepares the next edge. The handler calls it with interrupts enabled and its own disabled, and
/// with a reference to [`SCHEDULE`]: after `start` only the handler uses that. Returns the other
/// way round.
extern "C" fn go_on(schedule: &mut Schedule) {
    let Moment { at, compare } = schedule.advance();
    schedule.edge.at = at;
    let mut compare = plus(compare, schedule.timer0);
    if compare == TIMER0_TOP {
        // Before the handler of the millisecond, which begins when this tick ends.
        compare -= 1;
    }
    avr_device::interrupt::disable();
    // If the interrupt cannot come in time, it comes as soon as it can. That takes more than two
    // frames since the last edge.
    let ahead = at.wrapping_sub(tc1().tcnt1.read().bits());
    let is_in_time = (IN_TIME..LATE).contains(&ahead);
    tc0()
        .ocr0b
        .write(|w| w.bits(if is_in_time { compare } else { plus(tc0().tcnt0.read().bits(), 2) }));
    enable_interrupt();
}

/// Enables the interrupt of Timer0's compare match B.
pub(super) fn enable_interrupt() {
    // The old value may have matched meanwhile. A write to TIFR0 changes only the bits that are 1.
    // Safety: every value of TIFR0 and TIMSK0 is valid.
    unsafe {
        tc0().tifr0.write(|w| w.bits(OCF0B));
        tc0().timsk0.write(|w| w.bits(OCIE0A | OCIE0B));
    }
}

/// Ends the pulses that interrupts would end, and begins none. For a restart of the program: call
/// it with interrupts disabled, after which no pulse begins.
pub fn finish() {
    let schedule = &raw mut SCHEDULE;
    // Safety: interrupts are disabled, so the handler does not run.
    let schedule = unsafe { &mut *schedule };
    while schedule.event == Event::Fall {
        let Edge { at, port, keep, .. } = schedule.edge;
        let mut turns = timer1::TURNS_OF_A_PULSE;
        // Until the tick of the edge.
        while turns != 0 && at.wrapping_sub(tc1().tcnt1.read().bits()).wrapping_sub(1) < LATE {
            turns -= 1;
        }
        // Safety: the port is PORTx of an output, and nothing interrupts.
        unsafe {
            let port = register(port);
            port.write_volatile(port.read_volatile() & keep);
        }
        schedule.edge.at = schedule.advance().at;
    }
}
