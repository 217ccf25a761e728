//! What the interrupt of the outputs does next, and when. [`outputs`](super::super) has the whole.

use super::super::super::chip::{PORTB, TC1, steal};
use super::super::super::clock::TOP as TIMER0_TOP;
use super::super::super::flash::Image;
use super::super::super::timer1::{self, TICKS};
use firmware::hardware::{HAS_ESCS, OUTPUTS, OutputPins, SHAFT, SLOT_US};
use firmware::parts::outputs::travel::Ticks;
use firmware::progmem::Progmem;
use firmware::tables::parameters::Layout;

/// Ticks of Timer1 in a tick of Timer0.
pub const TICKS_OF_TIMER0: Ticks = 8;
/// Ticks of Timer0 in a millisecond, after which it begins again.
const TIMER0_PERIOD: u8 = TIMER0_TOP + 1;

/// Ticks from the beginning of a slot to the beginning of the next one.
const SLOT: Ticks = (SLOT_US * (TICKS / 1_000_000)) as Ticks;
/// Ticks of Timer0 in a slot, modulo its period.
const TIMER0_OF_SLOT: u8 = {
    assert!(SLOT.is_multiple_of(TICKS_OF_TIMER0));
    (SLOT / TICKS_OF_TIMER0 % TIMER0_PERIOD as u16) as u8
};

/// The interrupt comes at least this number of ticks before an edge. See the module.
pub const LEAD: Ticks = if SHAFT.is_some() { 22 } else { 15 };

/// The handler gives Timer1 the new width this number of ticks before BOTTOM. That is after the
/// longest pulse of the period, and early enough to be complete at BOTTOM even if a frame is
/// received meanwhile.
const CHANGE_AHEAD: Ticks = 100;

/// Without slots the first pulse that an interrupt begins comes this number of ticks after BOTTOM:
/// 125 us after the change of the width.
const BEGIN_AT: Ticks = 150;
/// Overlapping pulses begin this number of ticks after each other: 128 us.
const STAGGER: Ticks = 256;
/// The least width of an overlapping pulse: 500 us.
const SHORTEST_OVERLAPPING: Ticks = 1000;
/// Ticks from the end of a pulse to the beginning of the next one of a chain.
const LINK: Ticks = 1;

/// A time in a period.
#[derive(Clone, Copy)]
pub struct Moment {
    /// Value of TCNT1.
    pub at: Ticks,
    /// OCR0B for the interrupt before it, if TCNT0 is 0 when [`Schedule::timer0`] says which value
    /// it has.
    pub compare: u8,
}

/// The next edge, as the handler needs it.
pub struct Edge {
    pub at: Ticks,
    /// Address of the port, which is below 256, the bits to set in it, and the bits to keep.
    pub port: u8,
    pub set: u8,
    pub keep: u8,
    /// The port of the pulse that begins [`LINK`] ticks later, and the bits to set in it. Without
    /// one the handler reads and writes address 0, which is r0, and changes nothing.
    pub next_port: u8,
    pub next_set: u8,
}

/// What happens at the time of an event.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Event {
    /// A pulse begins, if the output has one.
    Rise,
    /// A pulse ends. In a chain the next one begins. Also each event of overlapping pulses.
    Fall,
    /// The handler gives Timer1 the width of output 1. The period ends.
    Change,
}

/// What the handler knows.
pub struct Schedule {
    pub edge: Edge,
    layout: Layout,
    /// The next event, and its output.
    pub event: Event,
    pub output: u8,
    /// The last output in use.
    last: u8,
    pub change: Moment,
    /// The beginning of the current slot. Without slots that of the period.
    slot_at: Ticks,
    /// TCNT0 in its tick that begins at the phase of the timers after the beginning of the slot.
    pub timer0: u8,
    /// What is added to a time in a slot, so that a division gives the ticks of Timer0 until the
    /// interrupt: the phase, LEAD, and a period of Timer0.
    before: Ticks,
    /// Ticks of Timer0 from the beginning of the last slot to the end of the period, modulo
    /// [`TIMER0_PERIOD`].
    rest: u8,
    /// The width of the current pulse when the handler decided to begin it.
    decided: Ticks,
    /// The overlapping pulses of this period that interrupts make, the shortest first: four times
    /// the width, and the output, 1 to 3. The last place is not in use.
    planned: [u16; OVERLAPPING + 1],
}

/// Overlapping pulses that interrupts make.
const OVERLAPPING: usize = 3;

/// The widths of the pulses, as the main loop set them last. 0 is no pulse. Only the main loop
/// writes them, with interrupts disabled.
static mut WIDTHS: [Ticks; OUTPUTS] = [0; OUTPUTS];

/// The width of an output's pulse. The pointer is always valid.
pub fn width_of(output: usize) -> *mut Ticks {
    (&raw mut WIDTHS).cast::<Ticks>().wrapping_add(output % OUTPUTS)
}

pub fn tc1() -> TC1 {
    // Safety: `Outputs::new` has consumed these registers. After `start` only the handler uses the
    // 16-bit registers.
    unsafe { steal::<TC1>() }
}

/// Adds ticks of Timer0, modulo its period. Both are less than the period.
pub fn plus(a: u8, b: u8) -> u8 {
    let room = TIMER0_PERIOD.wrapping_sub(b);
    if a >= room { a.wrapping_sub(room) } else { a.wrapping_add(b) }
}

/// Ticks of Timer0 modulo its period. There are at most 5,000 of them in a period of Timer1, 20 ms.
fn modulo(mut ticks: u16) -> u8 {
    while ticks >= TIMER0_PERIOD.into() {
        ticks -= u16::from(TIMER0_PERIOD);
    }
    ticks as u8
}

/// Offset of PORTx in the registers of a port; PINx is the first.
const PORTX: u8 = 2;

/// The address of PORTx of an output, and the mask of its pin.
#[inline(never)]
pub fn pin(output: usize) -> (u8, u8) {
    /// Registers of a port: PINx, DDRx and PORTx. Those of port C follow those of port B, then come
    /// those of port D (section 31).
    const REGISTERS: u8 = 3;
    let at = 2 * (output % OUTPUTS) as u16;
    let port = Progmem::<OutputPins>::byte(Image, at).wrapping_sub(b'B');
    let first = PORTB::PTR.addr() as u8;
    (first + PORTX + REGISTERS * port, Progmem::<OutputPins>::byte(Image, at + 1))
}

/// The register with this address.
pub fn register(address: u8) -> *mut u8 {
    core::ptr::with_exposed_provenance_mut(address.into())
}

impl Schedule {
    /// Before [`begin`](Self::begin).
    pub const fn new() -> Self {
        Self {
            edge: Edge { at: 0, port: 0, set: 0, keep: u8::MAX, next_port: 0, next_set: 0 },
            layout: Layout::Slots,
            event: Event::Change,
            output: 0,
            last: 0,
            change: Moment { at: 0, compare: 0 },
            slot_at: 0,
            timer0: 0,
            before: 0,
            rest: 0,
            decided: 0,
            planned: [0; OVERLAPPING + 1],
        }
    }

    /// Begins with the end of a period of this number of ticks. TCNT0 is `timer0` in its tick that
    /// begins `phase` ticks after BOTTOM.
    pub fn begin(&mut self, layout: Layout, outputs: u8, period: Ticks, timer0: u8, phase: u8) {
        self.layout = layout;
        self.last = outputs - 1;
        // The flag is set when the tick of Timer0 with the number of OCR0B ends.
        self.before = u16::from(TIMER0_PERIOD - 1) * TICKS_OF_TIMER0 - LEAD - u16::from(phase);
        let slots = if layout == Layout::Slots { self.last } else { 0 };
        let last_slot = u16::from(slots) * SLOT;
        let to_change = period - CHANGE_AHEAD - last_slot;
        self.change = Moment {
            at: period - CHANGE_AHEAD,
            compare: modulo((to_change + self.before) / TICKS_OF_TIMER0),
        };
        self.rest = modulo((period - last_slot) / TICKS_OF_TIMER0);
        self.timer0 = plus(timer0, modulo(last_slot / TICKS_OF_TIMER0));
    }

    /// Goes on to the next event. Returns its time.
    pub fn advance(&mut self) -> Moment {
        let begun = core::mem::take(&mut self.edge.set);
        self.edge.keep = u8::MAX;
        if self.event == Event::Change {
            change();
            self.timer0 = plus(self.timer0, self.rest);
            self.slot_at = 0;
            self.output = 0;
        }
        let after = match self.layout {
            _ if !HAS_ESCS => self.in_slot(begun),
            Layout::Slots => self.in_slot(begun),
            Layout::Overlapping => self.overlapping(),
            Layout::Chain => self.in_chain(),
        };
        if self.event == Event::Change { self.change } else { self.moment(after) }
    }

    /// The next event is the change.
    fn end(&mut self) -> Ticks {
        self.event = Event::Change;
        0
    }

    /// The next event with slots, in ticks after the beginning of its slot. `begun` are the bits
    /// that the last one has set.
    fn in_slot(&mut self, begun: u8) -> Ticks {
        if begun != 0 {
            self.event = Event::Fall;
            self.edge.keep = !begun;
            return self.newest();
        }
        if self.output == self.last {
            return self.end();
        }
        self.output += 1;
        self.slot_at += SLOT;
        self.timer0 = plus(self.timer0, TIMER0_OF_SLOT);
        self.event = Event::Rise;
        (self.edge.port, self.edge.set) = self.decide();
        0
    }

    /// The next event of overlapping pulses, in ticks after BOTTOM. The shortest pulse begins
    /// first, so that the ends are as far apart as the beginnings.
    #[inline(never)]
    fn overlapping(&mut self) -> Ticks {
        /// Steps of a period: the beginnings, then the ends.
        const STEPS: u8 = 2 * OVERLAPPING as u8;
        let step = self.output;
        if step == STEPS {
            return self.end();
        }
        if step == 0 {
            self.event = Event::Fall;
            self.plan();
        }
        self.output += 1;
        let is_end = step >= OVERLAPPING as u8;
        let place = if is_end { step - OVERLAPPING as u8 } else { step };
        let planned = self.planned[usize::from(place) % self.planned.len()];
        let width = planned / 4;
        let (port, mask) = pin(usize::from(planned as u8 % 4));
        self.edge.port = port;
        let mut after = BEGIN_AT + STAGGER * u16::from(place);
        if is_end {
            self.edge.keep = !mask;
            // An output without a pulse has an end, too, which changes nothing.
            after += width.max(SHORTEST_OVERLAPPING);
        } else if width != 0 {
            self.edge.set = mask;
        }
        after
    }

    /// Plans the overlapping pulses of a period.
    fn plan(&mut self) {
        let sorted = |a: u16, b: u16| if a <= b { (a, b) } else { (b, a) };
        // Safety: the main loop, which writes widths, does not run now.
        let of = |output| 4 * unsafe { width_of(output).read_volatile() } + output as u16;
        let (a, b, c) = (of(1), of(2), of(3));
        let (a, b) = sorted(a, b);
        let (b, c) = sorted(b, c);
        let (a, b) = sorted(a, b);
        self.planned = [a, b, c, 0];
    }

    /// The next event of a chain, in ticks after BOTTOM: the end of the pulse that the last event
    /// has begun.
    fn in_chain(&mut self) -> Ticks {
        if self.event == Event::Change {
            self.event = Event::Rise;
            self.output = 1;
            (self.edge.next_port, self.edge.next_set) = self.decide();
            return BEGIN_AT;
        }
        if self.output > self.last {
            return self.end();
        }
        self.event = Event::Fall;
        // An output without a pulse leaves its time free.
        let width = self.newest().max(Layout::SHORTEST_ONESHOT125);
        self.edge.port = self.edge.next_port;
        self.edge.keep = !core::mem::take(&mut self.edge.next_set);
        self.output += 1;
        if self.output <= self.last {
            (self.edge.next_port, self.edge.next_set) = self.decide();
        }
        self.edge.at + LINK + width
    }

    /// Decides if the output has a pulse. Returns the port, and the bits to set in it.
    #[inline(never)]
    fn decide(&mut self) -> (u8, u8) {
        let output = self.output.into();
        // Safety: the main loop, which writes widths, does not run now.
        self.decided = unsafe { width_of(output).read_volatile() };
        let (port, mask) = pin(output);
        (port, if self.decided == 0 { 0 } else { mask })
    }

    /// The width of a pulse that has begun: the newest, or the one that was decided if there should
    /// be no pulse since then.
    fn newest(&self) -> Ticks {
        // Safety: the main loop, which writes widths, does not run now.
        let newest = unsafe { width_of(self.output.into()).read_volatile() };
        if newest == 0 { self.decided } else { newest }
    }

    /// The time `after` ticks, at most a slot, from the beginning of the current slot.
    fn moment(&self, after: Ticks) -> Moment {
        const PERIOD: u16 = TIMER0_PERIOD as u16;
        const { assert!(SLOT / TICKS_OF_TIMER0 + PERIOD < 4 * PERIOD) }
        let mut ticks = (after + self.before) / TICKS_OF_TIMER0;
        if ticks >= 2 * PERIOD {
            ticks -= 2 * PERIOD;
        }
        if ticks >= PERIOD {
            ticks -= PERIOD;
        }
        Moment { at: self.slot_at + after, compare: ticks as u8 }
    }
}

/// Gives Timer1 the width of the next pulse of output 1.
fn change() {
    // Safety: the main loop, which writes widths, does not run now.
    let width = unsafe { width_of(0).read_volatile() };
    timer1::set_width(&tc1(), width);
}
