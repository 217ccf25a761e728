//! The serial monitor: what happens, in lines of text, at the pace of the UART.
//!
//! What happened is queued as an [`Event`] of eight bytes, in a few microseconds. Text is made of it later, in steps of less
//! than 60 us: so a burst of eight events needs 64 bytes instead of 400, and nothing ever waits. When the queue is full,
//! events are dropped and counted, and the count is told.
//!
//! The text itself stays in flash, packed ([`text`]). It is unpacked on a stack: a code of the text is pushed there as the two
//! codes that it stands for, and a field as the characters of its value, the last one first.

pub mod text;

use heapless::Vec;
use ufmt::{uWrite, uwrite};

use crate::progmem::Progmem;
pub use text::Line;
use text::{Code, Field};

/// Events that can wait. At 115200 baud a line takes about 5 ms, so this bridges 40 ms. A power of two.
const QUEUE_LEN: usize = 8;

/// The longest word or name, with what stood behind it in the codes that it was in (there is a test).
const STACK_LEN: usize = 40;

/// A line of text to be, with the values for its fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    /// The text.
    pub line: Line,
    /// `%s`: a node ID.
    pub source: u8,
    /// `%t`: a transfer ID.
    pub transfer: u8,
    /// `%c` or `%x`: a code, decimal or hexadecimal; `%w`: a line to put in here.
    pub code: u8,
    /// `%a`: a number; `%1`, `%3`: a signed number in tenths, in thousandths.
    pub a: u16,
    /// `%b`: a number; `%p`: a number in halves; `%v`: another line to put in here; `%n`: where a name is in flash, after its
    /// length.
    pub b: u16,
}

impl Line {
    /// Whether it tells that something was refused.
    pub fn is_refusal(self) -> bool {
        self <= Self::RefusedValue
    }
}

impl Event {
    /// The line with all values zero.
    pub const fn new(line: Line) -> Self {
        Self { line, source: 0, transfer: 0, code: 0, a: 0, b: 0 }
    }
}

/// Turns events into text.
pub struct Monitor {
    /// A ring: one that is told, and those that wait.
    events: [Event; QUEUE_LEN],
    told: u8,
    waiting: u8,
    /// Events dropped since that was last told.
    lost: u8,
    /// Characters and other codes that come next, the last one first.
    stack: Vec<u8, STACK_LEN, u8>,
}

impl Monitor {
    /// With nothing to tell.
    pub const fn new() -> Self {
        Self {
            // The line with number 0, so that all of this begins as zeros.
            events: [Event::new(Line::RefusedKind); QUEUE_LEN],
            told: 0,
            waiting: 0,
            lost: 0,
            stack: Vec::new(),
        }
    }

    /// Tells a line as soon as the UART allows, with the values that the caller puts into the event. Where
    /// there is no room it takes the place of the last one, and that is counted.
    #[inline(never)]
    pub fn tell(&mut self, line: Line) -> &mut Event {
        if self.waiting == QUEUE_LEN as u8 - 1 {
            self.lost = self.lost.wrapping_add(1);
        } else {
            self.waiting = self.waiting.wrapping_add(1);
        }
        let event = self.event(self.waiting);
        event.line = line;
        event
    }

    /// The event that is being told, or one that waits.
    #[inline(never)]
    fn event(&mut self, n: u8) -> &mut Event {
        &mut self.events[usize::from(self.told.wrapping_add(n)) % QUEUE_LEN]
    }

    #[inline(never)]
    fn push(&mut self, code: u8) {
        // The stack is never outgrown; a code that did that would be left out.
        let _ = self.stack.push(code);
    }

    /// The next character for the UART; 0 when this step did not get as far as that.
    #[inline(never)]
    pub fn next_byte(&mut self, flash: impl Progmem) -> u8 {
        loop {
            let Some(code) = self.stack.pop() else {
                self.begin_line(flash);
                return 0;
            };
            match Code::from(code) {
                Code::Character(character) => return character,
                Code::Pair(at) => {
                    self.push(flash.byte(at.wrapping_add(text::SECOND)));
                    self.push(flash.byte(at));
                }
                Code::Field(field) => {
                    self.push_field(field, flash);
                    return 0;
                }
            }
        }
    }

    fn begin_line(&mut self, flash: impl Progmem) {
        if self.lost != 0 {
            let lost = core::mem::take(&mut self.lost);
            let event = self.event(0);
            event.line = Line::Lost;
            event.code = lost;
        } else if self.waiting != 0 {
            self.waiting = self.waiting.wrapping_sub(1);
            self.told = self.told.wrapping_add(1);
        } else {
            return;
        }
        self.push(text::LINE_END);
        let line = self.event(0).line.number();
        self.push_word(line, flash);
    }

    /// Pushes the value of a field.
    #[inline(never)]
    fn push_field(&mut self, field: u8, flash: impl Progmem) {
        let &mut Event { source, transfer, code, a, b, .. } = self.event(0);
        match field {
            Field::HEX => {
                self.push_nibble(code & 15);
                self.push_nibble(code >> 4);
            }
            Field::WORD => self.push_word(code, flash),
            Field::OTHER_WORD => self.push_word(b as u8, flash),
            Field::NAME => self.push_text(b, flash.byte(b.wrapping_sub(1)), flash),
            Field::SOURCE => self.push_number(u16::from(source), 0),
            Field::TRANSFER => self.push_number(u16::from(transfer), 0),
            Field::CODE => self.push_number(u16::from(code), 0),
            Field::B => self.push_number(b, 0),
            Field::HALVES => {
                self.push(if b & 1 == 0 { b'0' } else { b'5' });
                self.push(b'.');
                self.push_number(b >> 1, 0);
            }
            Field::TENTHS => self.push_signed(a, 1),
            Field::THOUSANDTHS => self.push_signed(a, 3),
            _ => self.push_number(a, 0),
        }
    }

    fn push_signed(&mut self, number: u16, places: u8) {
        let is_negative = (number as i16) < 0;
        self.push_number(if is_negative { number.wrapping_neg() } else { number }, places);
        self.push(if is_negative { b'-' } else { b'+' });
    }

    /// Pushes the digits of a number with so many of them after the point, the last one first.
    #[inline(never)]
    fn push_number(&mut self, mut number: u16, places: u8) {
        let mut before_point = places;
        loop {
            let quotient = number / 10;
            let digit = (number as u8).wrapping_sub((quotient as u8).wrapping_mul(10));
            let mut character = Character(0);
            let _ = uwrite!(character, "{}", digit.min(9));
            self.push(character.0);
            number = quotient;
            before_point = before_point.wrapping_sub(1);
            if before_point == 0 {
                self.push(b'.');
            } else if number == 0 && before_point >= 0x80 {
                break;
            }
        }
    }

    #[inline(never)]
    fn push_nibble(&mut self, nibble: u8) {
        let digit = if nibble < 10 { b'0' } else { b'A' - 10 };
        self.push(digit.wrapping_add(nibble));
    }

    #[inline(never)]
    fn push_word(&mut self, line: u8, flash: impl Progmem) {
        let at = text::start(line, flash);
        self.push_text(at, flash.byte(at.wrapping_sub(1)), flash);
    }

    /// Pushes a text of this length from the flash.
    #[inline(never)]
    fn push_text(&mut self, at: u16, mut left: u8, flash: impl Progmem) {
        while left > 0 {
            left = left.wrapping_sub(1);
            self.push(flash.byte(at.wrapping_add(u16::from(left))));
        }
    }
}

/// A character that `ufmt` writes.
struct Character(u8);

impl uWrite for Character {
    type Error = core::convert::Infallible;

    #[inline(always)]
    fn write_str(&mut self, text: &str) -> Result<(), Self::Error> {
        if let &[character] = text.as_bytes() {
            self.0 = character;
        }
        Ok(())
    }
}

impl Default for Monitor {
    fn default() -> Self {
        Self::new()
    }
}
