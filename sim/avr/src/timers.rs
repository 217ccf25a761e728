//! Timer0, Timer1 and Timer2, in place of simavr's: their registers, interrupts and pins.
//!
//! `counter` has the model of a timer, `modes` the waveform generation modes, `layout` what differs
//! between the three. A timer is advanced when the program or the board reads or writes something
//! that it can change. It is scheduled as simavr's cycle timer only while an interrupt of it is
//! enabled or while somebody observes a pin that it drives.
//!
//! Time is exact to the CPU cycle: a write takes effect at the end of its instruction, and a read
//! has the value at the start of the last cycle of its instruction. A flag that is set while its
//! interrupt is masked interrupts when it is unmasked, which simavr loses.
//!
//! Limits: the external clocks T0 and T1, Timer2's own crystal (AS2), and captures by the analogue
//! comparator are refused with a message. The prescalers count from the last reset of the chip.
//!
//! Source: Atmel 2545, sections 15 (Timer0), 16 (Timer1), 17 (prescaler) and 18 (Timer2).

mod counter;
mod layout;
mod modes;
mod outputs;
#[cfg(test)]
mod tests;

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use self::counter::{Counter, ICF, Step};
use self::layout::{LAYOUTS, Layout};
use self::outputs::Output;
use super::base::{Base, Peripheral, Timer};
use super::chip::Chip;
use super::core::Vector;
use super::pins::Overrides;
use super::processor::Oc;
use super::regs;
use sim_base::Cycles;
use sim_base::Noise;

/// Expire at the next event of a timer.
const EVENTS: [Timer; 3] = [Timer::Counter0, Timer::Counter1, Timer::Counter2];
/// Expires when an edge on ICP1 has passed the synchroniser and the noise canceler.
const CAPTURE: Timer = Timer::Capture;
const ALL_TIMERS: [Timer; 4] = [EVENTS[0], EVENTS[1], EVENTS[2], CAPTURE];

/// Delay of the synchroniser and edge detector of ICP1 (section 16.6.1 and figure 17-1).
const CAPTURE_DELAY: Cycles = 3;
/// Further delay of the noise canceler (section 16.6.2).
const NOISE_CANCELER_DELAY: Cycles = 4;

/// One timer and its pins.
struct Unit {
    counter: Counter,
    /// Timer1's TEMP register (section 16.3).
    temp: u8,
    /// A time at which the prescaler was 0.
    prescaler_zero: Cycles,
    /// Expiry time that is set for the timer.
    scheduled: Option<Cycles>,
    outputs: [Output; 2],
}

impl Unit {
    fn new(layout: &Layout) -> Unit {
        Unit {
            counter: Counter::new(layout.max()),
            temp: 0,
            prescaler_zero: 0,
            scheduled: None,
            outputs: layout.pins.map(|_| Output::new(layout.is_wide)),
        }
    }

    fn word(&self, low: u8) -> u16 {
        u16::from_le_bytes([low, self.temp])
    }
}

/// The three timers.
pub(super) struct Timers {
    units: [RefCell<Unit>; 3],
    overrides: Rc<Overrides>,
    /// Pins with watchers, by port.
    watched: [Cell<u8>; 3],
    /// The timers that a sleep mode has stopped, by their bits of PRR, and since when.
    asleep: Cell<(u8, Cycles)>,
}

impl Peripheral for Timers {
    fn for_chip(_: Chip) -> Timers {
        Timers {
            units: LAYOUTS.each_ref().map(|layout| RefCell::new(Unit::new(layout))),
            overrides: Rc::default(),
            watched: Default::default(),
            asleep: Default::default(),
        }
    }

    fn writes(&self) -> &'static [u16] {
        layout::WRITES
    }

    fn reads(&self) -> &'static [u16] {
        layout::READS
    }

    fn timers(&self) -> &'static [Timer] {
        &ALL_TIMERS
    }

    fn write(&self, base: &Base, address: u16, value: u8) {
        let at = base.write_time();
        match address {
            regs::GTCCR => self.write_gtccr(base, value, at),
            regs::PRR => self.change_clocks(base, address, value, at),
            regs::ASSR => {
                self.change_clocks(base, address, value & (regs::AS2 | regs::EXCLK), at);
                if value & regs::AS2 != 0 {
                    base.report_violation(
                        "the clock of Timer2 is its own crystal (AS2), which is not modelled: \
                         the timer stops",
                    );
                }
            }
            regs::PCMSK0 | regs::PCMSK2 | regs::EICRA => {
                self.synchronise_pins(base);
                if address == regs::EICRA {
                    // > This flag is always cleared when INT0 is configured as a level interrupt.
                    // > (section 13.2.3) simavr sets it.
                    let sense = base.core.get(address);
                    (0..2).filter(|n| sense >> (2 * n) & 0b11 == 0).for_each(|n| {
                        base.core.clear(Vector::External(n));
                    });
                }
                base.core.set(address, value);
                (0..3).for_each(|n| self.schedule(base, n));
            }
            regs::PINB..=regs::PORTB => self.write_port(base, 0, address, value, at),
            regs::PIND..=regs::PORTD => self.write_port(base, 2, address, value, at),
            _ => self.write_register(base, layout::timer_of(address), address, value, at),
        }
    }

    fn read(&self, base: &Base, address: u16) -> u8 {
        let n = layout::timer_of(address);
        let layout = &LAYOUTS[n];
        if address == layout.tifr {
            self.advance(base, n, base.read_time());
            return base.core.get(address);
        }
        if matches!(address, regs::TCNT1H | regs::ICR1H) {
            return self.units[n].borrow().temp;
        }
        self.advance(base, n, base.read_time());
        let mut unit = self.units[n].borrow_mut();
        let word = if address == layout.tcnt { unit.counter.count() } else { unit.counter.icr() };
        let [low, high] = word.to_le_bytes();
        unit.temp = high;
        low
    }

    fn expire(&self, base: &Base, timer: Timer, at: Cycles) {
        if timer == CAPTURE {
            self.advance(base, 1, at);
            self.units[1].borrow_mut().counter.capture();
            self.set_flags(base, 1, ICF);
            return;
        }
        let n = EVENTS.iter().position(|event| *event == timer).unwrap_or_default();
        self.units[n].borrow_mut().scheduled = None;
        self.advance(base, n, at);
        self.schedule(base, n);
    }

    fn reset(&self, base: &Base, _: &mut Noise) {
        let now = base.now();
        self.asleep.take();
        if let Some(simavr) = base.core.simavr() {
            simavr.disconnect_timer1();
        }
        for (unit, layout) in self.units.iter().zip(&LAYOUTS) {
            let mut unit = unit.borrow_mut();
            while let Some(step) = unit.counter.step(now) {
                for index in (0..2).filter(|index| step.changed[*index]) {
                    let output = unit.counter.output(index);
                    unit.outputs[index].record(output, step.at);
                }
            }
            let outputs = std::mem::replace(&mut *unit, Unit::new(layout)).outputs;
            unit.prescaler_zero = now;
            unit.outputs = outputs;
            for (output, (port, bit)) in unit.outputs.iter_mut().zip(layout.pins) {
                output.set_port(false, false);
                output.record(None, now);
                base.release_pin(port, bit);
                self.overrides.set(port, bit, None);
            }
        }
    }
}

impl Timers {
    /// The levels that the timers drive.
    pub fn overrides(&self) -> Rc<Overrides> {
        Rc::clone(&self.overrides)
    }

    /// Brings all timers up to date for a look from outside at a register that they change, and
    /// writes the values of the counters to the data space.
    pub fn publish(&self, base: &Base) {
        for (n, layout) in LAYOUTS.iter().enumerate() {
            self.advance(base, n, base.now());
            let unit = self.units[n].borrow();
            let [low, high] = unit.counter.count().to_le_bytes();
            base.core.set(layout.tcnt, low);
            if layout.is_wide {
                base.core.set(layout.tcnt + 1, high);
                let [low, high] = unit.counter.icr().to_le_bytes();
                base.core.set(regs::ICR1L, low);
                base.core.set(regs::ICR1H, high);
            }
        }
    }

    /// Brings the timers up to date that drive pins of a port.
    pub fn advance_port(&self, base: &Base, port: usize, at: Cycles) {
        if self.overrides.driven(port) == 0 {
            return;
        }
        for (n, layout) in LAYOUTS.iter().enumerate() {
            if layout
                .pins
                .iter()
                .any(|&(owner, bit)| owner == port && self.overrides.level(port, bit).is_some())
            {
                self.advance(base, n, at);
            }
        }
    }

    /// From now on the timers report each edge that they make on this pin.
    pub fn watch(&self, base: &Base, port: usize, bit: u8) {
        self.synchronise_pins(base);
        self.watched[port].set(self.watched[port].get() | 1 << bit);
        (0..3).for_each(|n| self.schedule(base, n));
    }

    /// Removes and returns the edges of OC1A or OC1B since the last call.
    pub fn take_edges(&self, base: &Base, oc: Oc) -> Vec<(Cycles, bool)> {
        self.advance(base, 1, base.now());
        self.units[1].borrow_mut().outputs[oc as usize].take_edges()
    }

    /// Handles an edge on ICP1 (section 16.6).
    pub fn input_edge(&self, base: &Base, level: bool, at: Cycles) {
        let control = base.core.get(regs::TCCR1B);
        let cancels_noise = control & regs::ICNC1 != 0;
        if self.units[1].borrow().counter.has_top_in_icr() {
            return;
        }
        if level == (control & regs::ICES1 != 0) {
            let further = if cancels_noise { NOISE_CANCELER_DELAY } else { 0 };
            base.schedule(CAPTURE, at + CAPTURE_DELAY + further);
        } else if cancels_noise {
            base.unschedule(CAPTURE);
        }
    }

    /// Performs the clocks of a timer up to and including `to`.
    fn advance(&self, base: &Base, n: usize, to: Cycles) {
        loop {
            let step = self.units[n].borrow_mut().counter.step(to);
            let Some(Step { at, flags, changed }) = step else { return };
            self.set_flags(base, n, flags);
            for index in (0..2).filter(|index| changed[*index]) {
                self.update_output(base, n, index, at);
            }
        }
    }

    /// Sets flags in TIFRn, and requests their interrupts.
    fn set_flags(&self, base: &Base, n: usize, flags: u8) {
        let layout = &LAYOUTS[n];
        let idle = !base.core.get(layout.tifr) | base.core.get(layout.timsk);
        for flag in layout.each_flag(flags & idle) {
            base.core.raise(Vector::Timer(layout.number, flag));
        }
    }

    /// Sets the expiry time of a timer to its next event, if the event can matter before the timer
    /// is read.
    fn schedule(&self, base: &Base, n: usize) {
        let layout = &LAYOUTS[n];
        let matters = base.core.get(layout.timsk) != 0
            || layout.pins.iter().any(|&(port, bit)| {
                self.overrides.level(port, bit).is_some() && self.is_observed(base, port, bit)
            });
        let mut unit = self.units[n].borrow_mut();
        let next = if matters { unit.counter.next_event() } else { None };
        if unit.scheduled != next {
            unit.scheduled = next;
            match next {
                Some(at) => base.schedule(EVENTS[n], at),
                None => base.unschedule(EVENTS[n]),
            }
        }
    }

    /// Changes a register that can stop or start timers.
    fn change_clocks(&self, base: &Base, address: u16, value: u8, at: Cycles) {
        (0..3).for_each(|n| self.advance(base, n, at));
        base.core.set(address, value);
        (0..3).for_each(|n| self.apply_clock(base, n, at));
    }

    /// Section 17.4.1: PSRSYNC and PSRASY reset the prescalers, and halt them while TSM is set.
    fn write_gtccr(&self, base: &Base, value: u8, at: Cycles) {
        let before = base.core.get(regs::GTCCR);
        (0..3).for_each(|n| self.advance(base, n, at));
        let kept = regs::TSM | regs::PSRASY | regs::PSRSYNC;
        base.core.set(regs::GTCCR, if value & regs::TSM != 0 { value & kept } else { 0 });
        for (n, layout) in LAYOUTS.iter().enumerate() {
            if (before | value) & layout.prescaler_reset != 0 {
                let mut unit = self.units[n].borrow_mut();
                unit.prescaler_zero = at;
                unit.counter.set_clock(0, at, at);
                drop(unit);
                self.apply_clock(base, n, at);
            }
        }
    }

    /// Stops timers, given by their bits of PRR, and their prescalers, until [`wake`](Self::wake).
    pub fn fall_asleep(&self, base: &Base, stopped: u8, at: Cycles) {
        (0..3).for_each(|n| self.advance(base, n, at));
        self.asleep.set((stopped, at));
        (0..3).for_each(|n| self.apply_clock(base, n, at));
    }

    /// Lets them go on.
    pub fn wake(&self, base: &Base, at: Cycles) {
        (0..3).for_each(|n| self.advance(base, n, at));
        let (stopped, since) = self.asleep.take();
        for (unit, layout) in self.units.iter().zip(&LAYOUTS) {
            if stopped & layout.power_reduction != 0 {
                unit.borrow_mut().prescaler_zero += at - since;
            }
        }
        (0..3).for_each(|n| self.apply_clock(base, n, at));
    }

    /// Gives the counter the clock that the registers select.
    fn apply_clock(&self, base: &Base, n: usize, at: Cycles) {
        let layout = &LAYOUTS[n];
        let is_asleep = self.asleep.get().0 & layout.power_reduction != 0;
        let divider = if is_asleep { 0 } else { layout.divider(&base.core) };
        let mut unit = self.units[n].borrow_mut();
        if divider != unit.counter.divider() {
            let zero = unit.prescaler_zero;
            unit.counter.set_clock(divider, zero, at);
        }
        drop(unit);
        self.schedule(base, n);
    }

    fn write_register(&self, base: &Base, n: usize, address: u16, value: u8, at: Cycles) {
        let layout = &LAYOUTS[n];
        if base.core.get(regs::PRR) & layout.power_reduction != 0 {
            // Section 10.10: "[...] the I/O registers can not be read or written."
            base.report_violation(&format!(
                "a register of Timer{n} is written while PRR stops the timer: the chip ignores that"
            ));
            return;
        }
        self.advance(base, n, at);
        if address == layout.tccra {
            base.core.set(address, value & 0b1111_0011);
            self.configure(base, n, at);
        } else if address == layout.tccrb {
            base.core.set(address, value & layout.tccrb_bits());
            self.configure(base, n, at);
            if layout.has_external_clock(value) {
                base.report_violation(&format!(
                    "the clock of Timer{n} is T{n}, which is not modelled: the timer stops"
                ));
            }
        } else if address == layout.timsk {
            base.core.set(address, value & layout.flags());
            self.set_flags(base, n, base.core.get(layout.tifr));
        } else if address == layout.tifr {
            // > Alternatively, [...] cleared by writing a logic one to the flag. (section 15.9.7)
            for flag in layout.each_flag(base.with_single_bit(value)) {
                base.core.clear(Vector::Timer(layout.number, flag));
                base.core.withdraw(Vector::Timer(layout.number, flag));
            }
        } else {
            self.write_value(base, n, address, value);
        }
        if address == layout.foc {
            for index in (0..2).filter(|index| value & 0x80 >> index != 0) {
                self.units[n].borrow_mut().counter.force_compare(index);
                self.update_output(base, n, index, at);
            }
        }
        self.schedule(base, n);
    }

    /// Writes one of the registers TCNTn, OCRnx and ICR1. The high bytes of Timer1 go to TEMP.
    fn write_value(&self, base: &Base, n: usize, address: u16, value: u8) {
        let layout = &LAYOUTS[n];
        let mut unit = self.units[n].borrow_mut();
        let value16 = if layout.is_wide { unit.word(value) } else { value.into() };
        if address == layout.tcnt {
            unit.counter.set_count(value16);
        } else if let Some(index) = layout.ocr.iter().position(|ocr| *ocr == address) {
            unit.counter.set_ocr(index, value16);
            base.core.set(address, value);
            if layout.is_wide {
                base.core.set(address + 1, unit.temp);
            }
        } else if address == regs::ICR1L && unit.counter.has_top_in_icr() {
            unit.counter.set_icr(value16);
        } else if address == regs::ICR1L {
            // > The ICR1 Register can only be written when using a Waveform Generation mode that
            // > utilizes the ICR1 Register for defining the counter's TOP value. (section 16.6)
            base.report_violation(
                "ICR1 is written in a mode that does not take TOP from it: the chip ignores that",
            );
        } else if address != layout.foc {
            unit.temp = value;
        }
    }

    /// Gives the counter the mode, the outputs and the clock that TCCRnA and TCCRnB select.
    fn configure(&self, base: &Base, n: usize, at: Cycles) {
        let layout = &LAYOUTS[n];
        let [tccra, tccrb] = [layout.tccra, layout.tccrb].map(|address| base.core.get(address));
        let mode = layout.mode(tccra, tccrb);
        self.units[n].borrow_mut().counter.configure(mode, layout.com(tccra));
        self.apply_clock(base, n, at);
        (0..2).for_each(|index| self.update_output(base, n, index, at));
    }
}
