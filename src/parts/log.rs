//! debug.LogMessage: an autopilot shows which condition begins or ends (docs/status.md).
//!
//! ```text
//! level u3 | source u8[<=31] | text u8[<=90]
//! ```
//! The node tells each condition that is not as it was told last, one at a time. The serial monitor
//! makes the text between two of its own lines, and the part keeps it. A text that has become wrong
//! before it is sent is dropped, and what is right is told in its place.

use crate::monitor::{Change, Told};
use crate::tables::condition::Conditions;
use crate::tables::publication::Publication;

/// Characters of a message, behind its level. The rest of a longer line is cut.
const ROOM: usize = Publication::LogMessage.longest() as usize - 1;

/// The shortest time between two messages, in milliseconds. A condition that begins and ends with
/// each frame must not fill the bus.
const PERIOD_MS: u16 = 500;

/// LogLevel (DSDL uavcan/protocol/debug/LogLevel.uavcan) of the end of a condition, and of its
/// begin.
const INFO: u8 = 1;
const WARNING: u8 = 2;

/// What the text is.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Text {
    /// There is none.
    None,
    /// The serial monitor makes it.
    Growing,
    /// It waits to be sent.
    Whole,
}

/// The message that is being made, or waits to be sent, and what was told before.
pub struct Log {
    characters: [u8; ROOM],
    len: u8,
    text: Text,
    /// The condition of the text, or of the last one.
    condition: Conditions,
    /// All conditions when the text was begun.
    seen: Conditions,
    told: Told,
    /// Conditions that are to be told as they are, also if they were: but not while the node is
    /// error-passive, because then other nodes may receive nothing.
    again: Conditions,
    /// When the last message was sent.
    sent_ms: u16,
}

impl Log {
    /// No message.
    pub const fn new() -> Self {
        Self {
            characters: [0; ROOM],
            len: 0,
            text: Text::None,
            condition: Conditions::NONE,
            seen: Conditions::NONE,
            told: Told::new(),
            again: Conditions::NONE,
            sent_ms: 0,
        }
    }

    /// Begins the next message. Returns the change that it tells, whose text is to be pushed;
    /// `None` if there is none, or one is in progress. A failsafe comes first.
    #[inline(never)]
    pub fn begin(&mut self, now: Conditions, now_ms: u16) -> Option<Change> {
        if self.text != Text::None || now_ms.wrapping_sub(self.sent_ms) < PERIOD_MS {
            return None;
        }
        let mut changed = self.told.changed(now).told();
        if !now.has(Conditions::ERROR_PASSIVE) {
            changed = changed.or(self.again);
        }
        if changed.is_empty() {
            return None;
        }
        if changed.has(Conditions::FAILSAFE) {
            changed = Conditions::FAILSAFE;
        }
        let (number, condition) = changed.first();
        self.text = Text::Growing;
        self.len = 0;
        self.condition = condition;
        self.seen = now;
        Some(Change { number, begins: now.has(condition) })
    }

    /// Keeps a character, or 0 for none. Returns false if it is not of a message.
    #[inline(never)]
    pub fn push(&mut self, character: u8) -> bool {
        if self.text != Text::Growing {
            return false;
        }
        if character == b'\n' {
            self.text = Text::Whole;
        } else if character >= b' '
            && let Some(place) = self.characters.get_mut(usize::from(self.len))
        {
            *place = character;
            self.len += 1;
        }
        true
    }

    /// True if a message is due.
    pub fn is_due(&self) -> bool {
        self.text == Text::Whole
    }

    /// Removes the message: the payload, byte by byte. Returns false if it has become wrong.
    pub fn take(&mut self, now: Conditions, now_ms: u16, mut put: impl FnMut(u8)) -> bool {
        if self.text != Text::Whole {
            return false;
        }
        self.text = Text::None;
        if self.seen != now {
            return false;
        }
        let begins = now.has(self.condition);
        put(if begins { WARNING } else { INFO } << 5);
        self.characters.iter().take(usize::from(self.len)).for_each(|&character| put(character));
        self.told.tell(self.condition, begins);
        self.again.set(self.condition, now.has(Conditions::ERROR_PASSIVE));
        self.sent_ms = now_ms;
        true
    }

    /// Has these conditions told as they are, also if they were told before: something about them
    /// has changed, or other nodes may not have received it.
    #[inline(never)]
    pub fn tell_again(&mut self, conditions: Conditions) {
        self.again = self.again.or(conditions);
        // The text may be of before.
        self.seen = Conditions::EVERY;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::condition::TEXTS;
    use std::string::String;
    use std::vec::Vec;

    fn set(conditions: &[Conditions]) -> Conditions {
        conditions.iter().fold(Conditions::NONE, |all, &one| all.or(one))
    }

    /// Makes the text of a message that is due. Returns false if none is.
    fn makes_text(log: &mut Log, now: Conditions, now_ms: u16) -> bool {
        let Some(change) = log.begin(now, now_ms) else { return false };
        let over = if change.begins { "" } else { "over: " };
        for character in over.bytes().chain(TEXTS[usize::from(change.number)].bytes()) {
            assert!(log.push(0) && log.push(character), "not for the serial port");
            assert!(!log.is_due());
        }
        assert!(log.push(b'\r') && log.push(b'\n') && log.is_due() && !log.push(b'x'));
        true
    }

    /// The level and the text of the message.
    fn message(log: &mut Log, now: Conditions, now_ms: u16) -> Option<(u8, String)> {
        let mut payload = Vec::new();
        let is_sent = log.take(now, now_ms, |byte| payload.push(byte));
        let text = || String::from_utf8(payload[1..].to_vec()).unwrap();
        is_sent.then(|| (payload[0] >> 5, text()))
    }

    /// All messages while the conditions stay as they are, one each half second.
    fn messages(log: &mut Log, now: Conditions, now_ms: &mut u16) -> Vec<(u8, String)> {
        let mut told = Vec::new();
        while makes_text(log, now, *now_ms) {
            told.push(message(log, now, *now_ms).expect("nothing has changed"));
            *now_ms = now_ms.wrapping_add(PERIOD_MS);
            assert!(told.len() < 50, "{told:?}");
        }
        told
    }

    fn told(level: u8, text: &str) -> (u8, String) {
        (level, text.to_string())
    }

    #[test]
    fn each_text_fits_whole_with_the_longest_values() {
        for text in TEXTS {
            let over = format!("over: {}", text.replace("%a", "65535"));
            assert!(over.len() <= ROOM, "{over}");
        }
    }

    #[test]
    fn two_messages_are_half_a_second_apart() {
        let (mut log, now) = (Log::new(), Conditions::BUS_OFF);
        assert!(!makes_text(&mut log, now, 499) && makes_text(&mut log, now, 500));
        assert!(log.begin(now, 500).is_none(), "one is in progress");
        assert!(message(&mut log, now, 510).is_some());
        let now = Conditions::NONE;
        assert!(!makes_text(&mut log, now, 1009) && makes_text(&mut log, now, 1010));
    }

    #[test]
    fn a_condition_that_ends_before_its_text_is_sent_is_not_told() {
        let (mut log, mut now_ms) = (Log::new(), 1000);
        assert!(makes_text(&mut log, Conditions::FAILSAFE, now_ms));
        assert_eq!(message(&mut log, Conditions::NONE, now_ms), None);
        assert_eq!(messages(&mut log, Conditions::NONE, &mut now_ms), []);
        // While the text is made, too.
        assert!(log.begin(Conditions::FAILSAFE, now_ms).is_some());
        log.push(b'F');
        log.push(b'\n');
        assert_eq!(message(&mut log, Conditions::NONE, now_ms), None);
    }

    #[test]
    fn of_several_conditions_a_failsafe_is_told_first_and_none_is_lost() {
        let (mut log, mut now_ms) = (Log::new(), 1000);
        let all = [Conditions::ID_CONFLICT, Conditions::FAILSAFE, Conditions::PARAMETERS_LOST];
        let texts = messages(&mut log, set(&all), &mut now_ms);
        assert_eq!(texts[0], told(WARNING, "FAILSAFE: no commands"));
        assert_eq!(texts.len(), 3);
        let texts = messages(&mut log, Conditions::ID_CONFLICT, &mut now_ms);
        assert_eq!(texts[0], told(INFO, "over: FAILSAFE: no commands"));
        assert_eq!(texts.len(), 2);
    }

    #[test]
    fn a_condition_of_which_something_changed_is_told_again_and_its_end_once() {
        let (mut log, mut now_ms, now) = (Log::new(), 1000, Conditions::FAILSAFE);
        let begin = [told(WARNING, "FAILSAFE: no commands")];
        assert_eq!(messages(&mut log, now, &mut now_ms), begin);
        log.tell_again(now);
        assert_eq!(messages(&mut log, now, &mut now_ms), begin);
        // A text of before the change is not sent.
        log.tell_again(now);
        assert!(makes_text(&mut log, now, now_ms));
        log.tell_again(now);
        assert_eq!(message(&mut log, now, now_ms), None);
        let end = [told(INFO, "over: FAILSAFE: no commands")];
        assert_eq!(messages(&mut log, Conditions::NONE, &mut now_ms), end);
    }

    /// Nobody may have received it.
    #[test]
    fn what_is_told_while_the_node_is_error_passive_is_told_again_afterwards() {
        let (mut log, mut now_ms, passive) = (Log::new(), 1000, Conditions::ERROR_PASSIVE);
        let temperature = Conditions::TEMPERATURE;
        messages(&mut log, temperature, &mut now_ms);
        assert_eq!(messages(&mut log, set(&[temperature, passive]), &mut now_ms).len(), 1);
        let end = told(INFO, "over: temperature out of range");
        assert_eq!(messages(&mut log, passive, &mut now_ms), std::slice::from_ref(&end));
        let texts = messages(&mut log, Conditions::NONE, &mut now_ms);
        assert_eq!(texts, [end, told(INFO, "over: CAN H/L: error-passive")]);
    }
}
