//! Makes the lines of text.
//!
//! To queue an [`Event`] takes a few microseconds. The monitor makes the text later, in steps of at
//! most 125 us. So the caller never waits, and a burst of eight events needs 64 bytes of RAM; its
//! text would need 400. When the queue is full, the monitor drops events, counts them, and logs the
//! count.
//!
//! The texts stay in flash, packed ([`packing`]). The monitor unpacks them on a stack: it replaces
//! a code that stands for a pair by the two codes of the pair, and a field by the characters of its
//! value. It pushes the last code first.

use heapless::Vec;

use super::packing::{self, Code, Field};
use super::text::{Line, Texts};
use super::{Event, TextsAndNames};
use crate::hardware::OUTPUTS;
use crate::progmem::Progmem;
use crate::tables::parameters::{self, PREFIX_LEN, prefix_byte};

/// Events in the ring: the one that is being sent, and seven that wait. At 115200 baud a line takes
/// about 5 ms, so this bridges 40 ms. A power of two.
const QUEUE_LEN: usize = 8;

/// Codes on the stack at most. A test checks the depth.
const STACK_LEN: usize = 12;

/// Texts that one step of the search for a text skips at most.
const SKIPPED_AT_ONCE: u8 = 16;

/// Queues events and makes text of them.
pub struct Monitor {
    /// A ring: the event that is being sent, and after it those that wait.
    events: [Event; QUEUE_LEN],
    /// Place of the event that is being sent, modulo [`QUEUE_LEN`].
    sent: u8,
    /// Events that wait.
    waiting: u8,
    /// Events dropped since the last [`Line::Lost`], at most 255. The monitor logs the count
    /// before the next line; after a [`Line::Lost`] it logs another line first.
    lost: u8,
    /// Codes to send next. The top of the stack is the first.
    stack: Vec<u8, STACK_LEN, u8>,
    /// After the stack: index in flash of the rest of a text, and its length. While `text_skip` is
    /// not 0 the text is still to be found: `text_at` is the index of the length of some text,
    /// and the text to send is `text_skip - 1` texts after that one.
    text_at: u16,
    text_left: u8,
    text_skip: u8,
    /// After the text: index and length of the rest of the line that the text is inserted in.
    line_at: u16,
    line_left: u8,
    /// The end of the line is still to be sent.
    has_end: bool,
}

impl Monitor {
    /// An empty monitor.
    pub const fn new() -> Self {
        Self {
            // Line number 0, so that the initial value is all zero bytes.
            events: [Event::new(Line::Status); QUEUE_LEN],
            sent: 0,
            waiting: 0,
            lost: 0,
            stack: Vec::new(),
            text_at: 0,
            text_left: 0,
            text_skip: 0,
            line_at: 0,
            line_left: 0,
            has_end: false,
        }
    }

    /// Queues a line and returns its event, into which the caller puts the values. Values that the
    /// caller does not set are those of an earlier event. If the queue is full, the line
    /// replaces the last one, which is counted as dropped.
    #[inline(never)]
    pub fn log_line(&mut self, line: Line) -> &mut Event {
        if self.is_full() {
            self.lose();
        } else {
            self.waiting = self.waiting.wrapping_add(1);
        }
        let event = self.event(self.waiting);
        event.line = line;
        event
    }

    /// The same for a line about a single frame. If the queue is full, drops and counts it and
    /// returns `None`: such lines come as fast as frames do, and must not replace others.
    #[inline(never)]
    pub fn log_frame(&mut self, line: Line) -> Option<&mut Event> {
        if self.is_full() {
            self.lose();
            return None;
        }
        Some(self.log_line(line))
    }

    fn is_full(&self) -> bool {
        self.waiting == QUEUE_LEN as u8 - 1
    }

    /// Counts a line that was dropped because the queue was full.
    #[inline(never)]
    fn lose(&mut self) {
        if self.lost != u8::MAX {
            self.lost = self.lost.wrapping_add(1);
        }
    }

    /// The event that is being sent (0), or the `n`th one that waits.
    #[inline(never)]
    fn event(&mut self, n: u8) -> &mut Event {
        &mut self.events[usize::from(self.sent.wrapping_add(n)) % QUEUE_LEN]
    }

    #[inline(never)]
    fn push(&mut self, code: u8) {
        // The stack is deep enough (see `STACK_LEN`). A code beyond it would be dropped.
        let _ = self.stack.push(code);
    }

    /// True if no line is being sent.
    pub fn is_between_lines(&self) -> bool {
        !self.has_end && self.stack.is_empty()
    }

    /// The event for [`send_first`](Self::send_first).
    pub fn next_event(&mut self) -> &mut Event {
        self.event(0)
    }

    /// Sends the line of [`next_event`](Self::next_event) before all that wait in the queue. Call
    /// it between two lines.
    pub fn send_first(&mut self) {
        let line = self.event(0).line.number();
        self.insert(packing::FIRST_LINE, line);
        self.has_end = true;
    }

    /// Does one step and returns the next character for the UART, or 0 if this step made none.
    #[inline(never)]
    pub fn next_byte<F: TextsAndNames>(&mut self, flash: F) -> u8 {
        let mut code = match self.stack.pop() {
            Some(code) => code,
            None => match self.next_code(flash) {
                Some(code) => code,
                None => return 0,
            },
        };
        loop {
            match Code::from(code) {
                Code::Character(character) => return character,
                Code::Pair(at) => {
                    self.push(flash.byte(at.wrapping_add(packing::SECOND)));
                    code = flash.byte(at);
                }
                Code::Field(field) => {
                    self.push_field::<F>(field);
                    return 0;
                }
            }
        }
    }

    /// Returns the next code of the text, or `None` if this step finds none.
    fn next_code(&mut self, flash: impl Progmem<Texts>) -> Option<u8> {
        if self.text_skip != 0 {
            self.find_text(flash);
            return None;
        }
        if self.text_left == 0 {
            self.text_at = self.line_at;
            self.text_left = core::mem::take(&mut self.line_left);
            if self.text_left == 0 {
                if core::mem::take(&mut self.has_end) {
                    return Some(packing::LINE_END);
                }
                self.begin_line();
                return None;
            }
        }
        self.text_left = self.text_left.wrapping_sub(1);
        let at = self.text_at;
        self.text_at = at.wrapping_add(1);
        Some(flash.byte(at))
    }

    /// Does one step of the search for the text.
    fn find_text(&mut self, flash: impl Progmem<Texts>) {
        let mut texts = SKIPPED_AT_ONCE;
        let mut at = self.text_at;
        let mut skip = self.text_skip;
        while texts != 0 {
            let len = flash.byte(at);
            at = at.wrapping_add(1);
            skip = skip.wrapping_sub(1);
            if skip == 0 {
                self.text_left = len;
                break;
            }
            at = at.wrapping_add(u16::from(len));
            texts = texts.wrapping_sub(1);
        }
        self.text_at = at;
        self.text_skip = skip;
    }

    /// Inserts the text that is `skip` texts after the text whose length is at `at`.
    #[inline(never)]
    fn insert(&mut self, at: u16, skip: u8) {
        self.line_at = self.text_at;
        self.line_left = self.text_left;
        self.text_at = at;
        self.text_left = 0;
        self.text_skip = skip.wrapping_add(1);
    }

    fn begin_line(&mut self) {
        // Never twice in a row, so that during an endless flood other lines are sent, too.
        if self.lost != 0 && self.event(0).line != Line::Lost {
            let lost = core::mem::take(&mut self.lost);
            let event = self.event(0);
            event.line = Line::Lost;
            event.set_code(lost);
        } else if self.waiting != 0 {
            self.waiting = self.waiting.wrapping_sub(1);
            self.sent = self.sent.wrapping_add(1);
        } else {
            return;
        }
        self.send_first();
    }

    /// Pushes the value of a field.
    #[inline(never)]
    fn push_field<F: TextsAndNames>(&mut self, field: u8) {
        let event = self.event(0);
        if let Some(&byte) = event.bytes.get(usize::from(field)) {
            return self.push_number(u16::from(byte), 0);
        }
        let &mut Event { bytes: [.., code], a, b, .. } = event;
        match field {
            Field::WORD => self.insert(packing::FIRST_LINE, code),
            Field::NAME => {
                let (row, output) = parameters::row_and_output(b as u8);
                self.insert(F::NAMES, row);
                if output != 0 {
                    (0..PREFIX_LEN).rev().for_each(|at| self.push(prefix_byte(at, output)));
                }
            }
            Field::OUTPUTS if OUTPUTS > 1 => {
                let (mut left, mut digit) = (code, b'8');
                while digit != b'0' {
                    if left & 0x80 != 0 {
                        self.push(digit);
                    }
                    left <<= 1;
                    digit -= 1;
                }
            }
            Field::HALVES => {
                self.push(b'0' | (b as u8 & 1).wrapping_neg() & 5);
                self.push(b'.');
                self.push_number(b >> 1, 0);
            }
            Field::B => self.push_number(b, 0),
            Field::A => self.push_number(a, 0),
            Field::SIGN => self.push(if (a as i16) < 0 { b'-' } else { b'+' }),
            _ => self.push_number((a as i16).unsigned_abs(), field.wrapping_sub(Field::NO_PLACES)),
        }
    }

    /// Pushes the digits of a number with `places` decimal places, the last digit first.
    #[inline(never)]
    fn push_number(&mut self, mut number: u16, places: u8) {
        let mut before_point = places as i8;
        while number != 0 || before_point >= 0 {
            // A tenth, rounded down: exact for all numbers of 16 bits.
            let quotient = ((u32::from(number) * 0xCCCD) >> 19) as u16;
            let digit = (number as u8).wrapping_sub((quotient as u8).wrapping_mul(10));
            self.push(b'0' + digit);
            number = quotient;
            before_point = before_point.wrapping_sub(1);
            if before_point == 0 {
                self.push(b'.');
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::InMemory;
    use crate::monitor::text::LINES;
    use crate::tables::parameters::OutputParameter;
    use std::string::String;

    /// The line of a command has its type and its value.
    #[cfg(not(feature = "draft"))]
    const HAS_VALUES: bool = cfg!(feature = "values");

    /// The next character, or 0 if twelve steps make none.
    fn next(monitor: &mut Monitor) -> u8 {
        (0..12).map(|_| monitor.next_byte(InMemory)).find(|&byte| byte != 0).unwrap_or(0)
    }

    fn logged(monitor: &mut Monitor) -> String {
        std::iter::from_fn(|| Some(next(monitor)).filter(|&byte| byte != 0))
            .map(char::from)
            .collect()
    }

    #[cfg(not(feature = "draft"))]
    #[test]
    fn all_number_fields_are_formatted_correctly() {
        use crate::monitor::Words;
        let field_of = |line, bytes, a, b, before, after| {
            let mut monitor = Monitor::new();
            *monitor.log_line(line) = Event { line, bytes, a, b };
            let line = logged(&mut monitor);
            let (_, rest) = line.split_once(before).unwrap();
            rest.split_once(after).unwrap().0.to_string()
        };
        let zero = [0; 3];
        let status = [0, 0, Words::HEALTH.number(0)];
        let command = if HAS_VALUES { Line::CommandUnitless } else { Line::Command };
        for a in 0..=u16::MAX {
            assert_eq!(field_of(Line::Status, status, a, 0, "up ", " s"), a.to_string());
        }
        for a in i16::MIN..=i16::MAX {
            let sign = if a < 0 { '-' } else { '+' };
            let (whole, rest) = (a.unsigned_abs() / 1000, a.unsigned_abs() % 1000);
            let expected = format!("{sign}{whole}.{rest:03}");
            if HAS_VALUES {
                let line = Line::CommandUnitless;
                assert_eq!(field_of(line, zero, a as u16, 0, "unitless ", ","), expected);
            }
            let (whole, rest) = (a.unsigned_abs() / 10, a.unsigned_abs() % 10);
            let expected = format!("{sign}{whole}.{rest}");
            assert_eq!(
                field_of(Line::Temperature, zero, a as u16, 0, "temperature ", " C"),
                expected
            );
        }
        for (b, pulse) in [
            (0, "0.0"),
            (1, "0.5"),
            (2, "1.0"),
            (1999, "999.5"),
            (5000, "2500.0"),
            (65_535, "32767.5"),
        ] {
            assert_eq!(field_of(command, zero, 0, b, "pulse ", " us"), pulse);
        }
        for code in 0..=255 {
            let expected = code.to_string();
            assert_eq!(field_of(Line::NotAnswering, zero, code.into(), 0, "(", ")"), expected);
            let id = field_of(command, [0, 0, code], 0, 0, ": id ", "pulse");
            assert_eq!(id.split([',', ' ']).next().unwrap(), code.to_string());
        }
    }

    /// The line that the text and the values of the event give, made with `format!`.
    fn expected(text: &str, event: Event) -> String {
        let Event { bytes: [source, transfer, code], a, b, .. } = event;
        let word = |line: usize| LINES[line].to_string();
        let fixed = |places: usize| {
            let digits = format!("{:0>1$}", (a as i16).unsigned_abs(), places + 1);
            let (whole, rest) = digits.split_at(digits.len() - places);
            if places == 0 { whole.to_string() } else { format!("{whole}.{rest}") }
        };
        let mut parts = text.split('%');
        let mut line = parts.next().unwrap().to_string();
        for part in parts {
            let (field, rest) = part.split_at(1);
            line += &match field {
                "s" => source.to_string(),
                "t" => transfer.to_string(),
                "c" => code.to_string(),
                "w" => word(code.into()),
                "a" => a.to_string(),
                "+" => if (a as i16) < 0 { "-" } else { "+" }.to_string(),
                "0" => fixed(0),
                "1" => fixed(1),
                "2" => fixed(2),
                "3" => fixed(3),
                "b" => b.to_string(),
                "p" => format!("{}.{}", b / 2, b % 2 * 5),
                "n" => "OUT1_REVERSED".to_string(),
                "o" => "12345678"[..OUTPUTS].to_string(),
                _ => panic!("unknown field in {text:?}"),
            };
            line += rest;
        }
        line + "\r\n"
    }

    #[test]
    fn every_line_unpacks_to_its_text_within_the_stack() {
        let longest_word = Line::StackCollision.number();

        let mut depth = 0;
        for (number, text) in LINES.iter().enumerate() {
            let code = if text.contains("%w") { longest_word } else { 255 };
            let b = match text {
                text if text.contains("%n") => OutputParameter::Reversed.index(0).into(),
                _ => 65_535,
            };
            let line = Line::with_number(number as u8);
            let event = Event { line, bytes: [125, 31, code], a: -10_000i16 as u16, b };
            let mut monitor = Monitor::new();
            *monitor.log_line(line) = event;
            let mut sent = String::new();
            for _ in 0..400 {
                let byte = monitor.next_byte(InMemory);
                depth = depth.max(monitor.stack.len());
                if byte != 0 {
                    sent.push(char::from(byte));
                }
            }
            assert_eq!(sent, expected(text, event));
        }
        // A build with fewer lines has fewer pairs of pairs.
        assert!((STACK_LEN - 3..=STACK_LEN).contains(&depth), "{depth}");
    }

    #[test]
    fn lines_that_do_not_fit_are_dropped_and_counted() {
        let mut monitor = Monitor::new();
        monitor.log_line(Line::Running);
        assert_eq!(next(&mut monitor), b'C');
        for _ in 0..QUEUE_LEN - 1 + 5 {
            monitor.log_line(Line::IntWrong);
        }
        let text = logged(&mut monitor);
        let lines: std::vec::Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), QUEUE_LEN + 1);
        assert_eq!(lines[0], "AN: running");
        assert!(lines[1].starts_with("5 lines"), "{}", lines[1]);
        assert!(lines[2..].iter().all(|&line| line == "INT open or shorted"));
        assert_eq!(logged(&mut monitor), "");
    }

    #[test]
    fn a_line_about_a_frame_takes_no_other_line_s_place() {
        let mut monitor = Monitor::new();
        for _ in 0..QUEUE_LEN - 1 {
            monitor.log_line(Line::IntWrong);
        }
        assert!(monitor.log_frame(Line::Running).is_none());
        let text = logged(&mut monitor);
        assert!(text.starts_with("1 lines dropped") && !text.contains("running"), "{text}");
        assert_eq!(text.matches("INT open or shorted").count(), QUEUE_LEN - 1);
    }

    #[test]
    fn a_line_that_is_being_sent_is_not_overwritten() {
        let mut monitor = Monitor::new();
        monitor.log_line(Line::Temperature).a = 245;
        assert_eq!(next(&mut monitor), b't');
        for n in 0..40 {
            monitor.log_line(Line::Temperature).a = n;
        }
        assert!(logged(&mut monitor).starts_with("emperature +24.5 C\r\n"));
    }
}
