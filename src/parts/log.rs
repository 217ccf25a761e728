//! debug.LogMessage: an autopilot shows which condition begins or ends (docs/status.md).
//!
//! ```text
//! level u3 | source u8[<=31] | text u8[<=90]
//! ```
//! The text is that of the serial monitor, whose characters the part keeps while they are sent. So
//! a line that the monitor drops has no message.

use crate::monitor::Line;
use crate::monitor::text::level;
use crate::tables::publication::Publication;

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
    #[inline(always)]
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
            if waits || self.is_cut {
                self.is_cut = true;
            } else if let Some(place) = self.text.get_mut(usize::from(self.len)) {
                *place = character;
                self.len += 1;
            }
        }
    }

    /// True if a message is due.
    #[inline(always)]
    pub fn is_due(&self, now_ms: u16) -> bool {
        self.level != level::NONE && now_ms.wrapping_sub(self.sent_ms) >= PERIOD_MS
    }

    /// Removes the message: the payload, byte by byte.
    #[inline(always)]
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
        say(&mut log, "CAN: bus-off", Line::BusOff);
        assert!(log.is_due(1000));
        assert_eq!(message(&mut log, 1000), (2 << 5, b"CAN: bus-off".to_vec()));
        say(&mut log, "commands again", Line::FailsafeEnd);
        assert!(!log.is_due(1499) && log.is_due(1500));
        // Whoever comes meanwhile does not disturb the one that waits.
        say(&mut log, "FAILSAFE: no commands", Line::Failsafe);
        assert_eq!(message(&mut log, 1500), (1 << 5, b"commands again".to_vec()));
        assert!(!log.is_due(5000));
    }

    #[test]
    fn a_line_that_begins_while_a_message_waits_is_not_told_in_part() {
        let mut log = Log::new();
        say(&mut log, "CAN: bus-off", Line::BusOff);
        assert!(!log.has_room(19) && log.has_room(20), "the monitor waits for a moment only");
        log.push(b'F', Line::Failsafe, 20);
        message(&mut log, 1000);
        say(&mut log, "AILSAFE: no commands", Line::Failsafe);
        assert!(!log.is_due(5000) && log.has_room(0));
        say(&mut log, "commands again", Line::FailsafeEnd);
        assert_eq!(message(&mut log, 5000).1, b"commands again");
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
