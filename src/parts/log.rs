//! debug.LogMessage: an autopilot shows which condition begins or ends (docs/status.md).
//!
//! ```text
//! level u3 | source u8[<=31] | text u8[<=90]
//! ```
//! The text is that of the serial monitor, whose characters the part keeps while they are sent. So
//! a line that the monitor drops has no message. One message can wait. A line that tells of a
//! failsafe takes its place.

use crate::monitor::Line;
use crate::monitor::text::level;
use crate::tables::publication::Publication;

/// True: autopilots show which conditions begin and end.
pub const IS_THERE: bool = true;

/// Characters of a message, behind its level. The rest of a longer line is cut.
const ROOM: usize = Publication::LogMessage.longest() as usize - 1;

/// The shortest time between two messages, in milliseconds. A condition that begins and ends with
/// each frame must not fill the bus. Meanwhile one message can wait; further ones are dropped.
const PERIOD_MS: u16 = 500;

/// Time that the serial monitor waits for a message, in milliseconds: enough for one that is sent
/// at once, so that the next line can be kept, too.
const HOLD_MS: u16 = 20;

/// The line that is being kept, or waits to be sent.
pub struct Log {
    text: [u8; ROOM],
    len: u8,
    /// The level of the message that waits; 0 while there is none.
    level: u8,
    /// A character of the present line was not kept.
    is_cut: bool,
    /// When the message was whole, and when the last one was sent.
    whole_ms: u16,
    sent_ms: u16,
}

impl Log {
    /// No message.
    pub const fn new() -> Self {
        Self { text: [0; ROOM], len: 0, level: level::NONE, is_cut: false, whole_ms: 0, sent_ms: 0 }
    }

    /// True if the serial monitor may write a character.
    pub fn has_room(&self, now_ms: u16) -> bool {
        self.level == level::NONE || now_ms.wrapping_sub(self.whole_ms) >= HOLD_MS
    }

    /// Keeps a character of this line, or 0 for none.
    #[inline(never)]
    pub fn push(&mut self, character: u8, line: Line, now_ms: u16) {
        let waits = self.level != level::NONE;
        if character == b'\n' {
            let is_cut = core::mem::take(&mut self.is_cut);
            if waits {
                return;
            }
            if is_cut || line.level() == level::NONE {
                self.len = 0;
                return;
            }
            self.level = line.level();
            self.whole_ms = now_ms;
        } else if character >= b' ' {
            if self.is_cut {
                return;
            }
            if waits {
                if !line.begins_failsafe() {
                    self.is_cut = true;
                    return;
                }
                self.len = 0;
                self.level = level::NONE;
            }
            if let Some(place) = self.text.get_mut(usize::from(self.len)) {
                *place = character;
                self.len += 1;
            }
        }
    }

    /// True if a message is due.
    pub fn is_due(&self, now_ms: u16) -> bool {
        self.level != level::NONE && now_ms.wrapping_sub(self.sent_ms) >= PERIOD_MS
    }

    /// Removes the message: the payload, byte by byte.
    pub fn take(&mut self, now_ms: u16, mut put: impl FnMut(u8)) {
        put(self.level << 5);
        self.text.iter().take(usize::from(self.len)).for_each(|&character| put(character));
        self.len = 0;
        self.level = level::NONE;
        self.sent_ms = now_ms;
    }
}

impl Default for Log {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::InMemory;
    use crate::monitor::Monitor;
    use crate::monitor::text::LINES;
    use std::vec::Vec;

    fn say(log: &mut Log, text: &str, line: Line) {
        text.bytes().chain(*b"\r\n").for_each(|character| log.push(character, line, 0));
    }

    fn message(log: &mut Log, now_ms: u16) -> (u8, Vec<u8>) {
        let mut payload = Vec::new();
        log.take(now_ms, |byte| payload.push(byte));
        (payload[0], payload[1..].to_vec())
    }

    #[test]
    fn lines_about_conditions_are_told_with_their_level_and_no_others() {
        let mut log = Log::new();
        say(&mut log, "temperature +25.0 C", Line::Temperature);
        assert!(!log.is_due(1000));
        say(&mut log, "CAN H/L: bus-off", Line::BusOff);
        assert!(log.is_due(1000));
        assert_eq!(message(&mut log, 1000), (2 << 5, b"CAN H/L: bus-off".to_vec()));
        say(&mut log, "CAN: error-active", Line::ErrorActive);
        assert!(!log.is_due(1499) && log.is_due(1500));
        // Whoever comes meanwhile does not disturb the one that waits.
        say(&mut log, "CAN H/L: bus-off", Line::BusOff);
        assert_eq!(message(&mut log, 1500), (1 << 5, b"CAN: error-active".to_vec()));
        assert!(!log.is_due(5000));
    }

    #[test]
    fn a_line_that_begins_while_a_message_waits_is_not_told_in_part() {
        let mut log = Log::new();
        say(&mut log, "CAN H/L: bus-off", Line::BusOff);
        assert!(!log.has_room(19) && log.has_room(20), "the monitor waits for a moment only");
        log.push(b'd', Line::Disarmed, 20);
        message(&mut log, 1000);
        say(&mut log, "isarmed", Line::Disarmed);
        assert!(!log.is_due(5000) && log.has_room(0));
        say(&mut log, "commands again", Line::FailsafeEnd);
        assert_eq!(message(&mut log, 5000).1, b"commands again");
    }

    /// None is lost behind one about the bus.
    #[test]
    fn a_line_that_tells_of_a_failsafe_takes_the_place_of_the_message_that_waits() {
        let mut log = Log::new();
        for (text, line) in [
            ("FAILSAFE: no commands", Line::Failsafe),
            #[cfg(feature = "outputs")]
            ("FAILSAFE of output 12", Line::FailsafeOf),
            ("FAILSAFE while cut off", Line::FailsafeMissed),
        ] {
            say(&mut log, "CAN H/L: bus-off", Line::BusOff);
            say(&mut log, text, line);
            // While there is nothing to write, the line stays the last one.
            log.push(0, line, 0);
            assert_eq!(message(&mut log, 1000), (2 << 5, text.into()));
        }
    }

    #[test]
    fn each_text_fits_whole_with_the_longest_values() {
        for (number, text) in LINES.iter().enumerate() {
            let line = Line::with_number(number as u8);
            if line.level() == level::NONE {
                continue;
            }
            let mut monitor = Monitor::new();
            let event = monitor.log_line(line);
            event.set_code(u8::MAX);
            event.set_a(u16::MAX);
            let mut log = Log::new();
            let mut len = 0;
            for _ in 0..1000 {
                let character = monitor.next_byte(InMemory);
                len += usize::from(character >= b' ');
                log.push(character, line, 0);
            }
            assert!(len <= ROOM, "{len} characters: {text}");
            assert_eq!(message(&mut log, 1000).1.len(), len, "{text}");
        }
    }

    #[test]
    fn a_long_line_is_cut() {
        let mut log = Log::new();
        say(&mut log, &"x".repeat(100), Line::GaveUp);
        assert_eq!(message(&mut log, 1000).1.len(), ROOM);
    }

    #[test]
    fn each_condition_has_a_line_of_a_level() {
        let levels = |lines: &[Line]| lines.iter().map(|line| line.level()).collect::<Vec<_>>();
        assert_eq!(
            levels(&[Line::TwoCommanders, Line::FramesLost, Line::Failsafe, Line::SensorFault]),
            [2; 4]
        );
        assert_eq!(levels(&[Line::ErrorActive, Line::FailsafeEnd, Line::OutOfRangeEnd]), [1; 3]);
        assert_eq!(levels(&[Line::Status, Line::RefusedKind, Line::Banner, Line::NONE]), [0; 4]);
    }
}
