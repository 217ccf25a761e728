//! The serial monitor: what happens, in lines of text, at the pace of the UART.
//!
//! What happened is queued as an [`Event`] of eight bytes, in a few microseconds. Text is made of it later, one character at
//! a time, whenever the UART has room: so a burst of twelve events needs 96 bytes instead of 600, nothing ever waits, and
//! the costliest step is one number. When the queue is full, events are dropped and counted, and the count is told.
//!
//! The text itself stays in flash ([`text`]); numbers are written by `ufmt`.

pub mod text;

use heapless::{Deque, Vec};
use ufmt::uwrite;

use text::FlashText;
pub use text::Line;

/// Events that can wait. At 115200 baud a line takes about 5 ms, so this bridges 60 ms of one event every frame slot.
const QUEUE_LEN: usize = 12;

/// A line of text to be, with the values for its fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    /// The text.
    pub line: Line,
    /// `%s`: a node ID.
    pub source: u8,
    /// `%t`: a transfer ID.
    pub transfer: u8,
    /// `%c` or `%x`: a code, decimal or hexadecimal; `%h` and `%m`: a health and a mode, in its high and low half; `%w`: the
    /// line to put in here.
    pub code: u8,
    /// `%a`: a number; `%1`, `%3`: a signed number in tenths, in thousandths.
    pub a: u16,
    /// `%b`: a number; `%p`: a number in halves. `%u`: a number of 32 bits, with its low half in `a`.
    pub b: u16,
}

impl Event {
    /// The line with all values zero.
    pub const fn new(line: Line) -> Self {
        Self { line, source: 0, transfer: 0, code: 0, a: 0, b: 0 }
    }
}

/// Turns events into text.
pub struct Monitor {
    queue: Deque<Event, QUEUE_LEN>,
    /// Events dropped since that was last told.
    lost: u16,
    /// Where the values of a dropped event go.
    dropped: Event,
    /// The event that is being told.
    current: Event,
    /// The next byte of its text; 0 when nothing is being told.
    cursor: u16,
    /// Where to go on after an inserted line; 0 when there is none.
    resume: u16,
    /// A number on its way out, and how many of its characters have gone.
    number: Vec<u8, 10>,
    number_sent: u8,
    /// The line feed after a carriage return.
    line_feed: bool,
}

impl Monitor {
    /// With nothing to tell.
    pub const fn new() -> Self {
        Self {
            queue: Deque::new(),
            lost: 0,
            dropped: Event::new(Line::Lost),
            current: Event::new(Line::Lost),
            cursor: 0,
            resume: 0,
            number: Vec::new(),
            number_sent: 0,
            line_feed: false,
        }
    }

    /// Tells a line as soon as the UART allows, with the values that the caller puts into the event, all zero so far. Where
    /// there is no room it is dropped and counted; the caller fills in an event that nobody reads.
    #[inline(never)]
    pub fn tell(&mut self, line: Line) -> &mut Event {
        if self.queue.push_back(Event::new(line)).is_err() {
            self.lost = self.lost.saturating_add(1);
            return &mut self.dropped;
        }
        match self.queue.back_mut() {
            Some(event) => event,
            None => &mut self.dropped,
        }
    }

    /// The next character for the UART.
    #[inline(never)]
    pub fn next_byte(&mut self, text: &impl FlashText) -> Option<u8> {
        if core::mem::take(&mut self.line_feed) {
            return Some(b'\n');
        }
        // Each turn either returns or moves on in the text, so the longest way is over a field that is empty.
        loop {
            if let Some(&byte) = self.number.get(usize::from(self.number_sent)) {
                self.number_sent = self.number_sent.wrapping_add(1);
                return Some(byte);
            }
            if self.cursor == 0 {
                self.current = self.next_event()?;
                self.cursor = text::start(text, self.current.line as u8);
            }
            match self.next_of_text(text) {
                text::END if self.resume != 0 => self.cursor = core::mem::take(&mut self.resume),
                text::END => {
                    self.cursor = 0;
                    self.line_feed = true;
                    return Some(b'\r');
                }
                b'%' => {
                    let field = self.next_of_text(text);
                    self.begin_field(field, text);
                }
                byte => return Some(byte),
            }
        }
    }

    fn next_of_text(&mut self, text: &impl FlashText) -> u8 {
        let byte = text.byte(self.cursor);
        self.cursor = self.cursor.wrapping_add(1);
        byte
    }

    fn next_event(&mut self) -> Option<Event> {
        if let Some(event) = self.queue.pop_front() {
            return Some(event);
        }
        match core::mem::take(&mut self.lost) {
            0 => None,
            lost => Some(Event { a: lost, ..Event::new(Line::Lost) }),
        }
    }

    /// Prepares the value of a field: as a number, or as a line to insert.
    #[inline(never)]
    fn begin_field(&mut self, field: u8, text: &impl FlashText) {
        let Event { source, transfer, code, a, b, .. } = self.current;
        self.number.clear();
        self.number_sent = 0;
        let insert = match field {
            b'h' => Line::Health as u8 + (code >> 4),
            b'm' => Line::Mode as u8 + (code & 15),
            b'w' => code,
            _ => 0,
        };
        if insert != 0 {
            self.resume = self.cursor;
            self.cursor = text::start(text, insert);
            return;
        }
        match field {
            b's' => self.write(u16::from(source)),
            b't' => self.write(u16::from(transfer)),
            b'c' => self.write(u16::from(code)),
            b'x' => {
                for nibble in [code >> 4, code & 15] {
                    self.push(if nibble < 10 { b'0' + nibble } else { b'A' - 10 + nibble });
                }
            }
            b'a' => self.write(a),
            b'b' => self.write(b),
            b'1' => self.write_places(a, 1),
            b'3' => self.write_places(a, 3),
            b'p' => {
                self.write(b >> 1);
                self.push(b'.');
                self.push(if b & 1 == 0 { b'0' } else { b'5' });
            }
            b'u' => self.write_long(u32::from(b) << 16 | u32::from(a)),
            _ => {}
        }
    }

    fn push(&mut self, byte: u8) {
        // Numbers never outgrow the buffer; a digit that did would be cut.
        let _ = self.number.push(byte);
    }

    fn write(&mut self, value: u16) {
        let _ = uwrite!(self.number, "{}", value);
    }

    /// Up to 65,535,999, two years in seconds; what is more is cut to that. In two groups of digits, because `ufmt` would
    /// divide in 32 bits for each digit: 600 cycles and 1.2 KB of flash, against 200 cycles in 16 bits.
    fn write_long(&mut self, value: u32) {
        let (thousands, ones) = by_1000(value);
        if thousands > 0 {
            self.write(thousands);
            self.pad(ones);
        }
        self.write(ones);
    }

    fn pad(&mut self, below_1000: u16) {
        if below_1000 < 100 {
            self.push(b'0');
        }
        if below_1000 < 10 {
            self.push(b'0');
        }
    }

    /// A signed number with one or three decimal places.
    fn write_places(&mut self, value: u16, places: u8) {
        let value = value as i16;
        self.push(if value < 0 { b'-' } else { b'+' });
        let magnitude = value.unsigned_abs();
        let one = if places == 1 { 10 } else { 1000 };
        self.write(magnitude / one);
        self.push(b'.');
        if places != 1 {
            self.pad(magnitude % one);
        }
        self.write(magnitude % one);
    }
}

/// Quotient (limited to 16 bits) and remainder. Four bits at a time, so that each step is a division of 16 bits.
fn by_1000(value: u32) -> (u16, u16) {
    let (mut quotient, mut remainder) = (0u32, 0u16);
    for byte in value.to_be_bytes() {
        for nibble in [byte >> 4, byte & 15] {
            remainder = remainder << 4 | u16::from(nibble);
            quotient <<= 4;
            // The first digits are never that large, and a division takes 220 cycles.
            if remainder >= 1000 {
                quotient |= u32::from(remainder / 1000);
                remainder %= 1000;
            }
        }
    }
    (quotient.min(u32::from(u16::MAX)) as u16, remainder)
}

impl Default for Monitor {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct InMemory;

    impl FlashText for InMemory {
        fn byte(&self, index: u16) -> u8 {
            text::PACKED[usize::from(index)]
        }
    }

    fn told(monitor: &mut Monitor) -> std::string::String {
        std::iter::from_fn(|| monitor.next_byte(&InMemory)).map(char::from).collect()
    }

    fn line_of(event: Event) -> std::string::String {
        let mut monitor = Monitor::new();
        *monitor.tell(event.line) = event;
        told(&mut monitor)
    }

    #[test]
    fn a_command_is_told_with_type_source_transfer_and_value() {
        let event = Event { source: 10, transfer: 7, code: 1, a: 500, b: 3500, ..Event::new(Line::CommandUnitless) };
        assert_eq!(line_of(event), "rx ArrayCommand from 10 tid 7: id 1 unitless +0.500, pulse 1750.0 us\r\n");
    }

    #[test]
    fn a_status_is_told_with_words_for_health_and_mode() {
        let event = Event { source: 1, transfer: 31, code: 0x10, a: 57920, b: 1, ..Event::new(Line::Status) };
        assert_eq!(line_of(event), "rx NodeStatus from 1 tid 31: up 123456 s, WARNING, OPERATIONAL\r\n");
    }

    #[test]
    fn numbers_of_every_kind_are_written_right() {
        let thousandths = |a: i16| line_of(Event { a: a as u16, ..Event::new(Line::CommandUnitless) });
        for (a, expected) in [(0, "+0.000"), (7, "+0.007"), (-45, "-0.045"), (1000, "+1.000"), (i16::MIN, "-32.768")] {
            assert!(thousandths(a).contains(expected), "{a}: {}", thousandths(a));
        }
        let seconds = |s: u32| line_of(Event { a: s as u16, b: (s >> 16) as u16, ..Event::new(Line::Status) });
        for s in [0, 9, 999, 1000, 1009, 65_535, 65_536, 1_000_000, 65_535_999] {
            assert!(seconds(s).contains(&format!("up {s} s")), "{s}: {}", seconds(s));
        }
    }

    #[test]
    fn every_line_ends_and_uses_only_known_fields() {
        for line in 0..text::LINES.len() {
            let text = text::LINES[line];
            let mut rest = text;
            while let Some((_, after)) = rest.split_once('%') {
                assert!("stcxab13puhmw".contains(&after[..1]), "unknown field in {text:?}");
                rest = &after[1..];
            }
            assert!(text.bytes().all(|b| (0x20..0x7F).contains(&b)), "{text:?}");
        }
    }

    #[test]
    fn what_does_not_fit_is_dropped_and_counted() {
        let mut monitor = Monitor::new();
        for _ in 0..QUEUE_LEN + 5 {
            monitor.tell(Line::Running);
        }
        let text = told(&mut monitor);
        assert_eq!(text.lines().count(), QUEUE_LEN + 1);
        assert_eq!(text.lines().last().unwrap(), "serial monitor: 5 lines did not fit and were dropped");
        assert_eq!(told(&mut monitor), "");
    }
}
