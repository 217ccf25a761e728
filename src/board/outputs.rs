//! The pulses of eight outputs. Timer1 makes the pulse of output 1, and an interrupt those of the others.
//!
//! Timer1 is in the mode that it has for a single servo (see `servo.rs`): a period begins at BOTTOM, and OC1x makes the pulse of output 1 without
//! software. A period has a slot of 2.5 ms for each output, and the pulse of output `n` begins with slot `n`, counted from 1. A pulse lasts 500 us to
//! 2400 us, so no two edges are closer together than 100 us.
//!
//! In mode 14 Timer1 takes a compare value over at BOTTOM only, so it cannot interrupt at each edge. Timer0 can: in CTC mode its compare value
//! takes effect at once (ATmega48/88/168 datasheet 2545, section 15.7.2). A tick of Timer0 is 8 ticks of Timer1, so the interrupt comes
//! [`LEAD`] to `LEAD` + 7 ticks early. Its handler then polls TCNT1, and switches the pin in the tick of the edge.
//!
//! `LEAD` covers the longest time from the interrupt's flag to the poll. In cycles of 62.5 ns, from the instructions of the handlers: the end of the
//! handler of INT0 12, an instruction of the main loop 4, the beginning of the handler of INT0 for another frame 19, another instruction 4, and the
//! beginning of this handler 61. The sum is 100. The handler of Timer0's millisecond would take 34 more. It begins with TCNT0 at 0, so an interrupt
//! for this time comes a tick of Timer0 earlier.
//!
//! The main loop computes the edges for new widths, and writes them to one of two sets, while the handler uses the other. The handler changes to the new
//! set shortly before BOTTOM, and with it writes OCR1x. So all widths of one call of [`Output::set`] begin in the same period.
//!
//! After `start` only the handler uses the 16-bit registers of Timer1, which share a byte of temporary storage (section 16.3).

use core::arch::global_asm;

use super::chip::{PORTB, PORTC, PORTD, TC0, TC1};

use super::CLOCK_HZ;
use super::clock::TOP as TIMER0_TOP;
use super::pins::ServoSignal;
use node::hardware::{OUTPUT_PINS, OUTPUTS, Pin, SERVO, SLOT_US};
use node::node::parameters::{Parameter, Parameters};
use node::node::servo::{Output, Ticks, scaled};

/// Whether output 1 is on OC1A, and not on OC1B.
const IS_A: bool = SERVO.bit == 1;

const PRESCALER: u32 = 8;

/// Ticks in a second.
const TICKS: u32 = {
    assert!(CLOCK_HZ / PRESCALER == 2_000_000, "a tick is half a microsecond");
    CLOCK_HZ / PRESCALER
};

/// Ticks of Timer1 in a tick of Timer0.
const TICKS_OF_TIMER0: Ticks = 8;
/// Ticks of Timer0 in a millisecond, after which it begins again.
const TIMER0_PERIOD: u8 = TIMER0_TOP + 1;

/// Ticks from the beginning of a pulse to the beginning of the next output's pulse.
const SLOT: Ticks = (SLOT_US * (TICKS / 1_000_000)) as Ticks;

/// The interrupt comes at least this number of ticks before an edge. See the module.
const LEAD: Ticks = 15;

/// The handler takes an edge that is less than this number of ticks ahead. An edge that is farther ahead is for a later round of Timer0.
const DUE: Ticks = LEAD + 3 * TICKS_OF_TIMER0;

/// An edge that is this number of ticks ahead, modulo 65,536, or more, is late. If an interrupt were missed, the next one, a millisecond later, would take
/// the edge. The shortest period is longer, so an edge of the next period does not look late.
const LATE: Ticks = ((TICKS / 1000) as u16 + 0x200).wrapping_neg() & 0xFF00;

/// The handler changes to the new widths this number of ticks before BOTTOM. That is after the longest pulse of the last slot, and early enough to be
/// complete at BOTTOM even if a frame is received meanwhile.
const CHANGE_AHEAD: Ticks = 100;

/// Time of an event without an edge at the beginning of a period. So the change to new widths is never followed by another one, for which TCNT1
/// would be due in the same period.
const BEGIN_AT: Ticks = 1000;

/// OCIE0A and OCIE0B in TIMSK0, and OCF0B in TIFR0.
const OCIE0A: u8 = 1 << 1;
const OCIE0B: u8 = 1 << 2;
const OCF0B: u8 = 1 << 2;

/// A time in a period. Its size is a power of two, so that an index needs no multiplication.
#[derive(Clone, Copy)]
#[repr(C)]
struct Moment {
    /// Value of TCNT1.
    at: Ticks,
    /// OCR0B for the interrupt before it, if TCNT0 is 0 when [`Schedule::timer0`] says which value it has.
    compare: u8,
    _unused: u8,
}

impl Moment {
    const NONE: Self = Self::new(0, 0);

    const fn new(at: Ticks, compare: u8) -> Self {
        Self { at, compare, _unused: 0 }
    }
}

/// The next edge, as the handler needs it.
#[repr(C)]
struct Edge {
    at: Ticks,
    /// The port, the bits to set in it, and the bits to keep.
    port: *mut u8,
    set: u8,
    keep: u8,
}

/// What happens at the time of an event.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
enum Event {
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
struct Switched {
    port: *mut u8,
    mask: u8,
    /// The tick of Timer0 before the slot, as in [`Moment::compare`].
    before: u8,
    rise: Moment,
}

/// What [`go_on`] knows.
struct Schedule {
    /// The next event, and its slot.
    event: Event,
    slot: u8,
    /// Slots in use.
    slots: u8,
    change: Moment,
    /// TCNT0 in its tick that begins `phase` ticks after BOTTOM of the event's period.
    timer0: u8,
    phase: u8,
    /// Ticks of Timer0 in a period, modulo [`TIMER0_PERIOD`].
    period: u8,
    outputs: [Switched; OUTPUTS],
}

static mut EDGE: Edge = Edge { at: 0, port: core::ptr::null_mut(), set: 0, keep: 0 };

static mut SCHEDULE: Schedule = Schedule {
    event: Event::Begin,
    slot: 0,
    slots: 0,
    change: Moment::NONE,
    timer0: 0,
    phase: 0,
    period: 0,
    outputs: [Switched { port: core::ptr::null_mut(), mask: 0, rise: Moment::NONE, before: 0 }; OUTPUTS],
};

/// The ends of the pulses, in two sets: see the module. An output whose pulse ends at 0 has none.
type Falls = [Moment; OUTPUTS];
static mut FALLS: [Falls; 2] = [[Moment::NONE; OUTPUTS]; 2];
/// The set that the handler uses.
static mut USED: *const Falls = core::ptr::null();
/// True if the other set is complete, and newer.
static mut IS_NEW: bool = false;

#[inline(always)]
fn tc0() -> TC0 {
    // Safety: `Clock` uses other registers of Timer0, and TIMSK0 only before interrupts are enabled.
    unsafe { TC0::steal() }
}

#[inline(always)]
fn tc1() -> TC1 {
    // Safety: `Outputs::new` has consumed these registers. After `start` only the handler uses the 16-bit registers.
    unsafe { TC1::steal() }
}

// The handler of the interrupt. It returns if the edge is not due. Else it polls the low byte of TCNT1 until the tick of the edge, in turns of 5
// cycles of the 8 of a tick, and writes to the port. Then it disables its own interrupt, so that it can enable the others, and `go_on` prepares the
// next edge.
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

/// Prepares the next edge. The handler calls it with interrupts enabled and its own disabled. Returns the other way round.
extern "C" fn go_on() {
    let (schedule, edge) = (&raw mut SCHEDULE, &raw mut EDGE);
    // Safety: after `start` only this function and the handler use these, and the handler is disabled.
    let (schedule, edge) = unsafe { (&mut *schedule, &mut *edge) };
    let Moment { at, compare, .. } = schedule.advance(edge);
    edge.at = at;
    let mut compare = plus(compare, schedule.timer0);
    if compare == TIMER0_TOP {
        // Before the handler of the millisecond, which begins when this tick ends.
        compare -= 1;
    }
    avr_device::interrupt::disable();
    // If the interrupt cannot come in time, it comes as soon as it can. That takes more than two frames since the last edge.
    let ahead = at.wrapping_sub(tc1().tcnt1().read().bits());
    let is_in_time = (DUE..LATE).contains(&ahead);
    tc0().ocr0b().write(|w| w.set(if is_in_time { compare } else { plus(tc0().tcnt0().read().bits(), 2) }));
    enable_interrupt();
}

/// Enables the interrupt of Timer0's compare match B.
fn enable_interrupt() {
    // The old value may have matched meanwhile. A write to TIFR0 changes only the bits that are 1.
    // Safety: every value of TIFR0 and TIMSK0 is valid.
    unsafe {
        tc0().tifr0().write(|w| w.bits(OCF0B));
        tc0().timsk0().write(|w| w.bits(OCIE0A | OCIE0B));
    }
}

/// Adds ticks of Timer0, modulo its period. Both are less than the period.
#[inline(always)]
fn plus(a: u8, b: u8) -> u8 {
    let room = TIMER0_PERIOD.wrapping_sub(b);
    if a >= room { a.wrapping_sub(room) } else { a.wrapping_add(b) }
}

/// Ticks of Timer0 in the longest pulse, modulo its period. A remainder takes 200 cycles, this takes 15.
#[inline(always)]
fn modulo_of_pulse(mut ticks: u16) -> u8 {
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
fn modulo(mut ticks: u16) -> u8 {
    while ticks >= TIMER0_PERIOD.into() {
        ticks -= u16::from(TIMER0_PERIOD);
    }
    ticks as u8
}

impl Schedule {
    /// Goes on to the next event. Returns its time.
    #[inline(always)]
    fn advance(&mut self, edge: &mut Edge) -> Moment {
        // Safety: `start` has set the pointer to one of two statics. The main loop writes to the other one only.
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
    #[inline(always)]
    fn moment(&self, at: Ticks) -> Moment {
        let ticks = at.wrapping_sub(LEAD + u16::from(self.phase)) / TICKS_OF_TIMER0;
        Moment::new(at, modulo(ticks.wrapping_sub(1)))
    }
}

/// The set that the handler does not use.
#[inline(always)]
fn other_falls() -> *mut Falls {
    let first = (&raw mut FALLS).cast::<Falls>();
    // Safety: the pointer is to a static. The handler changes it only while `IS_NEW` is true; the callers are the handler, and the main loop after it
    // has made it false. So no interrupt comes between the reads of the two bytes of a value that changes.
    let used = unsafe { (&raw const USED).read_volatile() };
    if core::ptr::eq(used, first) { first.wrapping_add(1) } else { first }
}

/// Changes to the new widths, if there are any. No pulse is active.
#[inline(always)]
fn change() {
    // Safety: only this function writes `USED` after `start`. The main loop clears `IS_NEW` before it writes the other set, and sets it afterwards. It is a
    // byte, which one instruction reads or writes.
    let width = unsafe {
        if !(&raw const IS_NEW).read_volatile() {
            return;
        }
        (&raw mut IS_NEW).write_volatile(false);
        let other = other_falls();
        (&raw mut USED).write_volatile(other);
        (*other)[0].at
    };
    write_width(width);
}

/// Has Timer1 make pulses of this width from the next period on, or none. No pulse is active if it is 0.
#[inline(always)]
fn write_width(width: Ticks) {
    if width == 0 {
        tc1().tccr1a().write(|w| w.wgm1().set(2));
        return;
    }
    // OC1x stays low until BOTTOM, so the first pulse has its full width, too.
    if IS_A {
        tc1().ocr1a().write(|w| w.set(width.wrapping_sub(1)));
    } else {
        tc1().ocr1b().write(|w| w.set(width.wrapping_sub(1)));
    }
    tc1().tccr1a().write(|w| {
        let w = w.wgm1().set(2);
        if IS_A { w.com1a().match_clear() } else { w.com1b().match_clear() }
    });
}

/// Ends the pulse that an interrupt would end. For a restart of the program: call it with interrupts disabled, after which no pulse begins.
pub fn finish() {
    let (schedule, edge) = (&raw const SCHEDULE, &raw const EDGE);
    // Safety: interrupts are disabled, so the handler does not run.
    let (event, edge) = unsafe { ((*schedule).event, &*edge) };
    if event != Event::Fall {
        return;
    }
    // 8,000 turns of more than six cycles are longer than the longest pulse.
    let mut turns = 8000u16;
    while turns != 0 && edge.at.wrapping_sub(tc1().tcnt1().read().bits()) < LATE {
        turns -= 1;
    }
    // Safety: the port is PORTx of an output, and nothing interrupts.
    unsafe { edge.port.write_volatile(edge.port.read_volatile() & edge.keep) };
}

/// The outputs. They make no pulse before the first [`set`](Output::set).
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
        // After a restart of the program the timer may be in a pulse. The pulse must end and not be cut; it takes 2.5 ms at most. The loop has a
        // limit all the same: 8,000 turns of six cycles or more are 3 ms.
        let mut turns = 8000u16;
        while turns != 0 && signal.is_driven_high() {
            turns = turns.wrapping_sub(1);
        }
        // WGM11..0 = 2 and WGM13..2 = 3: mode 14. While COM1x is 0, the port drives the pin low.
        tc1.tccr1a().write(|w| w.wgm1().set(2));
        tc1.tccr1b().write(|w| w.wgm1().set(3));
        tc1.timsk1().write(|w| w.toie1().clear_bit());
        tc1.icr1().write(|w| w.set(u16::MAX));
        tc1.tccr1b().write(|w| w.wgm1().set(3).cs1().prescale_8());
        Self { signal, falls: [Moment::NONE; OUTPUTS], has_change: false, is_single: false }
    }

    /// Starts the outputs in use, with OUT_RATE. Call it once, before interrupts are enabled, and while Timer0 runs.
    pub fn start(&mut self, parameters: &Parameters) {
        let (count, rate_hz) = (parameters.outputs(), parameters.get(Parameter::OutRate));
        self.is_single = count == 1;
        let mut period = scaled((TICKS / 64) as u16, 64, rate_hz);
        if !self.is_single {
            // A multiple of a tick of Timer0, so that the timers keep their phase.
            period &= !(TICKS_OF_TIMER0 - 1);
        }
        let tc1 = tc1();
        tc1.icr1().write(|w| w.set(period.wrapping_sub(1)));
        tc1.tcnt1().write(|w| w.set(0));
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
        for (n, pin) in OUTPUT_PINS.into_iter().enumerate() {
            let (port, mask) = (port_of(pin), pin.mask());
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

/// PORTx of a pin.
fn port_of(pin: Pin) -> *mut u8 {
    /// Offset of PORTx in the registers of a port; PINx is the first.
    const PORTX: usize = 2;
    let registers = match pin.port {
        'B' => PORTB::PTR.cast_mut().cast::<u8>(),
        'C' => PORTC::PTR.cast_mut().cast::<u8>(),
        _ => PORTD::PTR.cast_mut().cast::<u8>(),
    };
    registers.wrapping_add(PORTX)
}

impl Output for Outputs {
    #[inline(never)]
    fn set(&mut self, output: usize, width: Ticks) {
        if self.is_single {
            // As in `servo.rs`: a pulse that has begun is not cut.
            let [fall, ..] = &mut self.falls;
            if fall.at != width && (width != 0 || !self.signal.is_driven_high()) {
                fall.at = width;
                write_width(width);
            }
            return;
        }
        // Safety: the handler changes neither the outputs nor the phase.
        let (switched, phase) = unsafe {
            (&*(&raw const SCHEDULE.outputs).cast::<Switched>().wrapping_add(output % OUTPUTS), SCHEDULE.phase)
        };
        let at = if width == 0 { 0 } else { switched.rise.at.wrapping_add(width) };
        let fall = &mut self.falls[output % OUTPUTS];
        if fall.at != at {
            fall.at = at;
            fall.compare =
                plus(switched.before, modulo_of_pulse(width.wrapping_sub(LEAD + u16::from(phase)) / TICKS_OF_TIMER0));
            self.has_change = true;
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
    /// Gives the new ends of the pulses to the handler.
    #[inline(never)]
    fn hand_over(&mut self) {
        // Safety: while `IS_NEW` is false the handler does not change to the other set, so only the main loop uses that one. `IS_NEW` is a byte, which
        // one instruction reads or writes.
        unsafe {
            (&raw mut IS_NEW).write_volatile(false);
            let mut to = other_falls().cast::<Moment>();
            for fall in &self.falls {
                (&raw mut (*to).at).write_volatile(fall.at);
                (&raw mut (*to).compare).write_volatile(fall.compare);
                to = to.wrapping_add(1);
            }
            (&raw mut IS_NEW).write_volatile(true);
        }
    }
}
