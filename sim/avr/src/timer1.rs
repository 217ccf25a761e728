//! The waveforms of Timer1 on OC1A (D9) and OC1B (D10), exact to the CPU cycle.
//!
//! simavr changes these pins at the end of an instruction, and updates OCR1x at once; the chip does
//! neither. This model follows the ATmega168 datasheet (Atmel 2545, section 16, "16-bit
//! Timer/Counter1 with PWM"): the free-running prescaler, the TEMP register, double-buffered OCR1x,
//! and compare outputs in all waveform modes. It calculates the past when the program writes
//! a register or the board takes the edges, and goes from one event to the next.
//!
//! Limits: no external clock on T1, no input capture, no TSM; PRR is ignored. simavr has the
//! interrupt flags.

use std::cell::RefCell;
use std::collections::VecDeque;

use super::base::{Base, Peripheral};
use super::chip::Chip;
use super::regs;
use sim_base::Cycles;
use sim_base::Noise;

/// Most edges that are kept; then the oldest are dropped. Enough for more than 5 h of servo pulses.
const EDGE_LIMIT: usize = 1 << 21;

/// One of the two output compare pins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Oc {
    /// OC1A = PB1 = D9.
    A,
    /// OC1B = PB2 = D10.
    B,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Normal mode and CTC mode.
    Plain,
    FastPwm,
    /// OCR1x is updated at TOP.
    PhaseCorrect,
    /// OCR1x is updated at BOTTOM.
    PhaseAndFrequencyCorrect,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Top {
    Fixed(u16),
    Icr1,
    Ocr1a,
}

/// Datasheet table 16-4, "Waveform Generation Mode Bit Description", by WGM13:0. Mode 13 is
/// reserved.
const MODES: [(Kind, Top); 16] = [
    (Kind::Plain, Top::Fixed(0xFFFF)),
    (Kind::PhaseCorrect, Top::Fixed(0x00FF)),
    (Kind::PhaseCorrect, Top::Fixed(0x01FF)),
    (Kind::PhaseCorrect, Top::Fixed(0x03FF)),
    (Kind::Plain, Top::Ocr1a),
    (Kind::FastPwm, Top::Fixed(0x00FF)),
    (Kind::FastPwm, Top::Fixed(0x01FF)),
    (Kind::FastPwm, Top::Fixed(0x03FF)),
    (Kind::PhaseAndFrequencyCorrect, Top::Icr1),
    (Kind::PhaseAndFrequencyCorrect, Top::Ocr1a),
    (Kind::PhaseCorrect, Top::Icr1),
    (Kind::PhaseCorrect, Top::Ocr1a),
    (Kind::Plain, Top::Icr1),
    (Kind::Plain, Top::Fixed(0xFFFF)),
    (Kind::FastPwm, Top::Icr1),
    (Kind::FastPwm, Top::Ocr1a),
];

/// CPU cycles per timer clock, by CS12:0. 0: stopped, also for the external clock, which is not
/// modelled.
const PRESCALERS: [u64; 8] = [0, 1, 8, 64, 256, 1024, 0, 0];

/// State of one compare unit and of its pin.
#[derive(Debug, Default)]
struct Channel {
    /// OCR1x buffer, which the program writes.
    ocr_buffer: u16,
    /// OCR1x compare register, which the comparator uses.
    ocr: u16,
    /// The OC1x register: drives the pin while COM1x connects it.
    latch: bool,
    ddr: bool,
    port: bool,
    level: bool,
    edges: VecDeque<(Cycles, bool)>,
}

/// Timer1's counter and compare outputs.
#[derive(Debug)]
pub struct Timer1 {
    tccr1a: u8,
    tccr1b: u8,
    /// The TEMP register: high byte for the next write of a low byte.
    temp: u8,
    icr1: u16,
    channels: [Channel; 2],
    tcnt: u16,
    down: bool,
    /// A write of TCNT1 blocks the compare match of the next timer clock (section 16.7.2).
    match_blocked: bool,
    /// Time of the prescaler's last reset.
    prescaler_start: Cycles,
    next_tick: Cycles,
}

impl Peripheral for RefCell<Timer1> {
    fn for_chip(_: Chip) -> RefCell<Timer1> {
        RefCell::new(Timer1::new(0))
    }

    fn writes(&self) -> &'static [u16] {
        &[
            regs::PINB,
            regs::DDRB,
            regs::PORTB,
            regs::GTCCR,
            regs::TCCR1A,
            regs::TCCR1B,
            regs::TCCR1C,
            regs::TCNT1L,
            regs::TCNT1H,
            regs::ICR1L,
            regs::ICR1H,
            regs::OCR1AL,
            regs::OCR1AH,
            regs::OCR1BL,
            regs::OCR1BH,
        ]
    }

    fn reads(&self) -> &'static [u16] {
        &[regs::TCNT1L, regs::TCNT1H]
    }

    fn write(&self, base: &Base, address: u16, value: u8) {
        match address {
            regs::GTCCR => {
                if value & regs::PSRSYNC != 0 {
                    self.borrow_mut().reset_prescaler(base.now());
                }
                base.core.set(address, value & !regs::PSRSYNC);
            }
            regs::PINB | regs::DDRB | regs::PORTB => {
                base.forward(address, value);
                let (ddrb, portb) = (base.core.get(regs::DDRB), base.core.get(regs::PORTB));
                self.borrow_mut().set_port(ddrb, portb, base.now());
            }
            _ => {
                let written = self.borrow_mut().write(address, value, base.now());
                if let Err(text) = written {
                    base.report_violation(text);
                    return;
                }
                match address {
                    regs::TCNT1H | regs::ICR1H | regs::OCR1AH | regs::OCR1BH => {}
                    regs::TCNT1L | regs::ICR1L | regs::OCR1AL | regs::OCR1BL => {
                        let high = self.borrow().temp;
                        base.core.set(address + 1, high);
                        base.forward(address, value);
                    }
                    _ => base.forward(address, value),
                }
            }
        }
    }

    fn read(&self, base: &Base, address: u16) -> u8 {
        self.borrow_mut().read(address, base.now())
    }

    fn reset(&self, base: &Base, _: &mut Noise) {
        self.borrow_mut().reset(base.now());
    }
}

impl Timer1 {
    /// A timer after a reset at `now`.
    pub fn new(now: Cycles) -> Timer1 {
        Timer1 {
            tccr1a: 0,
            tccr1b: 0,
            temp: 0,
            icr1: 0,
            channels: Default::default(),
            tcnt: 0,
            down: false,
            match_blocked: false,
            prescaler_start: now,
            next_tick: now,
        }
    }

    /// Resets the timer. The pins become inputs. Edges that were not taken yet stay.
    pub fn reset(&mut self, now: Cycles) {
        self.advance(now);
        let edges = self.channels.each_mut().map(|channel| std::mem::take(&mut channel.edges));
        let levels = self.channels.each_ref().map(|channel| channel.level);
        *self = Timer1::new(now);
        for ((channel, edges), level) in self.channels.iter_mut().zip(edges).zip(levels) {
            channel.edges = edges;
            channel.level = level;
        }
        self.update_pins(now);
    }

    /// Writes a byte to one of the timer's registers.
    ///
    /// # Errors
    /// If the chip ignores the write; the text says why.
    pub fn write(&mut self, address: u16, value: u8, now: Cycles) -> Result<(), &'static str> {
        self.advance(now);
        let word = u16::from_le_bytes([value, self.temp]);
        match address {
            regs::TCCR1A => self.configure(value, self.tccr1b, now),
            regs::TCCR1B => {
                self.configure(self.tccr1a, value, now);
                if value & 0b111 >= 6 {
                    return Err(
                        "the clock of Timer1 is T1, which is not modelled: the timer stops",
                    );
                }
            }
            regs::TCCR1C => self.force_compare(value),
            regs::TCNT1H | regs::ICR1H | regs::OCR1AH | regs::OCR1BH => self.temp = value,
            regs::TCNT1L => {
                self.tcnt = word;
                self.match_blocked = true;
            }
            regs::ICR1L => {
                // > The ICR1 Register can only be written when using a Waveform Generation mode
                // > that utilizes the ICR1 Register for defining the counter's TOP value. (section
                // > 16.6)
                if self.mode().1 != Top::Icr1 {
                    return Err(
                        "ICR1 is written in a mode that does not take TOP from it: the chip ignores that",
                    );
                }
                self.icr1 = word;
            }
            regs::OCR1AL => self.write_ocr(0, word),
            regs::OCR1BL => self.write_ocr(1, word),
            _ => {}
        }
        self.update_pins(now);
        Ok(())
    }

    /// Reads TCNT1L, and copies the high byte to TEMP; or reads TCNT1H, which is TEMP.
    pub fn read(&mut self, address: u16, now: Cycles) -> u8 {
        if address == regs::TCNT1L {
            self.advance(now);
            let [low, high] = self.tcnt.to_le_bytes();
            self.temp = high;
            low
        } else {
            self.temp
        }
    }

    /// Sets the values of DDRB and PORTB.
    pub fn set_port(&mut self, ddrb: u8, portb: u8, now: Cycles) {
        self.advance(now);
        for (index, channel) in self.channels.iter_mut().enumerate() {
            let bit = 1 << (index + 1);
            channel.ddr = ddrb & bit != 0;
            channel.port = portb & bit != 0;
        }
        self.update_pins(now);
    }

    /// Resets the prescaler (PSRSYNC in GTCCR).
    pub fn reset_prescaler(&mut self, now: Cycles) {
        self.advance(now);
        self.prescaler_start = now;
        self.next_tick = now + self.prescaler();
    }

    /// The level that the compare unit drives on the pin; `None` if the unit is not connected or
    /// the pin is not an output.
    pub fn output(&mut self, oc: Oc, now: Cycles) -> Option<bool> {
        self.advance(now);
        let connected = self.is_connected(oc as usize);
        let channel = &self.channels[oc as usize];
        (channel.ddr && connected).then_some(channel.latch)
    }

    /// Removes and returns the edges of the pin since the last call. A pin that is not an output
    /// counts as low.
    pub fn take_edges(&mut self, oc: Oc, now: Cycles) -> Vec<(Cycles, bool)> {
        self.advance(now);
        self.channels[oc as usize].edges.drain(..).collect()
    }

    fn mode(&self) -> (Kind, Top) {
        MODES[usize::from((self.tccr1b >> 1) & 0b1100 | self.tccr1a & 0b11)]
    }

    fn prescaler(&self) -> u64 {
        PRESCALERS[usize::from(self.tccr1b & 0b111)]
    }

    fn top(&self) -> u16 {
        match self.mode().1 {
            Top::Fixed(top) => top,
            Top::Icr1 => self.icr1,
            Top::Ocr1a => self.channels[0].ocr,
        }
    }

    /// Value of COM1x1:0.
    fn com(&self, index: usize) -> u8 {
        (self.tccr1a >> (6 - 2 * index)) & 0b11
    }

    /// True if OC1x overrides the port (tables 16-1 to 16-3). Toggling in a PWM mode works only for
    /// OC1A, in some modes.
    fn is_connected(&self, index: usize) -> bool {
        match (self.mode().0, self.com(index)) {
            (_, 0) => false,
            (Kind::Plain, _) | (_, 2 | 3) => true,
            (_, _) => {
                let wgm = (self.tccr1b >> 1) & 0b1100 | self.tccr1a & 0b11;
                index == 0 && matches!(wgm, 9 | 11 | 14 | 15)
            }
        }
    }

    fn configure(&mut self, tccr1a: u8, tccr1b: u8, now: Cycles) {
        let old_prescaler = self.prescaler();
        self.tccr1a = tccr1a;
        self.tccr1b = tccr1b;
        let prescaler = self.prescaler();
        if prescaler != old_prescaler && prescaler != 0 {
            // > The prescaler is free running, i.e., operates independently of the Clock Select
            // > logic (section 17.2)
            self.next_tick = now + prescaler - (now - self.prescaler_start) % prescaler;
        }
        match self.mode().0 {
            Kind::Plain => {
                self.down = false;
                for channel in &mut self.channels {
                    channel.ocr = channel.ocr_buffer;
                }
            }
            Kind::FastPwm => self.down = false,
            Kind::PhaseCorrect | Kind::PhaseAndFrequencyCorrect => {}
        }
    }

    fn write_ocr(&mut self, index: usize, value: u16) {
        self.channels[index].ocr_buffer = value;
        if self.mode().0 == Kind::Plain {
            self.channels[index].ocr = value;
        }
    }

    /// Forces a compare match (FOC1x), which works only in modes that are not PWM (section
    /// 16.11.3).
    fn force_compare(&mut self, tccr1c: u8) {
        if self.mode().0 == Kind::Plain {
            for index in 0..2 {
                if tccr1c & (0x80 >> index) != 0 {
                    self.change_output(index, false);
                }
            }
        }
    }

    /// Performs all timer clocks up to and including `now`.
    fn advance(&mut self, now: Cycles) {
        let prescaler = self.prescaler();
        if prescaler == 0 {
            return;
        }
        while self.next_tick <= now {
            let available = (now - self.next_tick) / prescaler + 1;
            let uneventful = if self.match_blocked { 0 } else { u64::from(self.ticks_to_event()) };
            let skipped = available.min(uneventful);
            if skipped > 0 {
                // At most 65535, because ticks_to_event is a u16.
                let steps = skipped as u16;
                self.tcnt = if self.down { self.tcnt - steps } else { self.tcnt + steps };
                self.next_tick += skipped * prescaler;
            } else {
                self.tick();
                self.update_pins(self.next_tick);
                self.next_tick += prescaler;
            }
        }
    }

    /// Number of timer clocks that only count, before one that changes direction, wraps or matches.
    fn ticks_to_event(&self) -> u16 {
        let from = self.tcnt;
        let ocrs = self.channels.each_ref().map(|channel| channel.ocr);
        if self.down {
            ocrs.iter()
                .filter(|ocr| **ocr <= from)
                .map(|ocr| from - ocr)
                .min()
                .unwrap_or(from)
                .min(from)
        } else {
            let phase =
                matches!(self.mode().0, Kind::PhaseCorrect | Kind::PhaseAndFrequencyCorrect);
            if phase && from >= self.top() {
                return 0;
            }
            let stops = [ocrs[0], ocrs[1], self.top(), 0xFFFF];
            stops.iter().filter(|stop| **stop >= from).map(|stop| stop - from).min().unwrap_or(0)
        }
    }

    /// Performs one timer clock.
    fn tick(&mut self) {
        let count = self.tcnt;
        let top = self.top();
        let blocked = std::mem::take(&mut self.match_blocked);
        let matches = self.channels.each_ref().map(|channel| !blocked && channel.ocr == count);
        let (kind, top_source) = self.mode();
        match kind {
            Kind::Plain => {
                for (index, _) in matches.iter().enumerate().filter(|(_, matched)| **matched) {
                    self.change_output(index, false);
                }
                let clears = count == top && !(blocked && top_source == Top::Ocr1a);
                self.tcnt = if clears { 0 } else { count.wrapping_add(1) };
            }
            Kind::FastPwm => {
                let bottom_next = count == top || count == 0xFFFF;
                for (index, matched) in matches.into_iter().enumerate() {
                    match self.com(index) {
                        1 if matched => self.channels[index].latch = !self.channels[index].latch,
                        2 | 3 if bottom_next => self.channels[index].latch = self.com(index) == 2,
                        2 | 3 if matched => self.channels[index].latch = self.com(index) == 3,
                        _ => {}
                    }
                }
                if bottom_next {
                    self.load_buffers();
                }
                self.tcnt = if bottom_next { 0 } else { count + 1 };
            }
            Kind::PhaseCorrect | Kind::PhaseAndFrequencyCorrect => {
                let turns = if self.down { count == 0 } else { count >= top };
                if turns {
                    self.down = !self.down;
                    // Phase correct mode updates OCR1x at TOP, phase and frequency correct mode at
                    // BOTTOM.
                    if self.down == (kind == Kind::PhaseCorrect) {
                        self.load_buffers();
                    }
                }
                for (index, _) in matches.iter().enumerate().filter(|(_, matched)| **matched) {
                    self.change_output(index, self.down);
                }
                self.tcnt =
                    if self.down { count.saturating_sub(1) } else { (count + 1).min(top.max(1)) };
                if top == 0 {
                    self.tcnt = 0;
                }
            }
        }
    }

    /// Changes an output at a compare match: toggles, clears or sets it. `inverted`, while counting
    /// down, exchanges clear and set.
    fn change_output(&mut self, index: usize, inverted: bool) {
        let com = self.com(index);
        let latch = &mut self.channels[index].latch;
        match com {
            1 => *latch = !*latch,
            2 => *latch = inverted,
            3 => *latch = !inverted,
            _ => {}
        }
    }

    fn load_buffers(&mut self) {
        for channel in &mut self.channels {
            channel.ocr = channel.ocr_buffer;
        }
    }

    fn update_pins(&mut self, at: Cycles) {
        for index in 0..2 {
            let connected = self.is_connected(index);
            let channel = &mut self.channels[index];
            let level = channel.ddr && if connected { channel.latch } else { channel.port };
            if level != channel.level {
                channel.level = level;
                if channel.edges.len() == EDGE_LIMIT {
                    channel.edges.pop_front();
                }
                channel.edges.push_back((at, level));
            }
        }
    }
}

#[cfg(test)]
#[path = "timer1_tests.rs"]
mod tests;
