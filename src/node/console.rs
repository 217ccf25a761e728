//! Who reads the log: through the serial port, through the tunnel, and the autopilot by LogMessage.

use crate::monitor::{self, Change, Line, Told};
use crate::parts::log::Log;
use crate::parts::tunnel::Tunnel;
use crate::tables::condition::Conditions;

/// True if DISARMED has several causes.
pub const HAS_CAUSES: bool =
    monitor::IS_THERE && (Line::Safe.is_built() || Line::CommandsRefused.is_built());

/// The bit in [`Told`] that asks for the line "CAN: running": that of DRAFT, which has no line of
/// its own.
pub const RUNNING: Conditions = Conditions::DRAFT;

/// The line of DISARMED for ARM_REQ.
const DISARMED: Line = Line::of_condition(Conditions::DISARMED.number());

/// The readers.
pub struct Console {
    /// The conditions that the serial monitor has told.
    pub told: Told,
    /// The conditions that it has told in this second.
    told_now: Conditions,
    /// The last line about the controller, and its number.
    pub controller: (Line, u16),
    /// The line of the last cause of DISARMED.
    pub disarmed: Line,
    /// The tunnel.
    pub tunnel: Tunnel,
    /// The messages for the autopilot.
    pub log: Log,
}

impl Console {
    /// Nobody reads.
    pub const fn new() -> Self {
        // Lines of number 0, so that the initial value is all zero bytes.
        Self {
            told: Told::new(),
            told_now: Conditions::NONE,
            controller: (Line::Status, 0),
            disarmed: Line::Status,
            tunnel: Tunnel::new(),
            log: Log::new(),
        }
    }

    /// Begins a second. In each the serial monitor tells a condition at most once, because some
    /// come and go with each frame.
    pub fn second(&mut self) {
        if monitor::IS_THERE {
            self.told_now = Conditions::NONE;
        }
    }

    /// The next change to be logged, also of [`RUNNING`].
    #[inline(always)]
    pub fn next_change(&mut self, now: Conditions) -> Option<Change> {
        self.told.next(now, &mut self.told_now)
    }

    /// Has the serial monitor tell that the controller is on the bus.
    #[inline(always)]
    pub fn note_running(&mut self) {
        if monitor::IS_THERE {
            self.told.tell(RUNNING, true);
        }
    }

    /// Has the serial monitor tell that a condition is set, also if it has told so before.
    #[inline(never)]
    pub fn happened(&mut self, condition: Conditions) {
        if monitor::IS_THERE {
            self.told.forget(condition);
        }
    }

    /// Takes note of a line about the controller. The last one is logged.
    pub fn note_controller(&mut self, line: Line, number: u16) {
        if monitor::IS_THERE {
            self.controller = (line, number);
            self.tell_again(Conditions::CONTROLLER);
        }
    }

    /// Takes note of the cause of DISARMED: the safety switch, a refusal of commands for motors, or
    /// else ARM_REQ. Another cause is told, too.
    pub fn note_disarmed(&mut self, is_safe: bool, is_refused: bool) {
        if !HAS_CAUSES {
            return;
        }
        let cause = if is_safe {
            Line::Safe
        } else if is_refused {
            Line::CommandsRefused
        } else {
            DISARMED
        };
        if self.disarmed != cause {
            self.disarmed = cause;
            self.tell_again(Conditions::DISARMED);
        }
    }

    /// Has a condition that is set told again: something about it has changed.
    pub fn tell_again(&mut self, condition: Conditions) {
        self.happened(condition);
        self.log.tell_again(condition);
    }

    /// True if the serial monitor may write a character: always if no tunnel is open.
    pub fn takes_character(&self) -> bool {
        self.tunnel.has_room()
    }

    /// Keeps a character of the log, or 0 for none. Returns true if it is not for the serial port.
    pub fn keep_character(&mut self, character: u8) -> bool {
        let is_of_message = self.log.push(character);
        if !is_of_message {
            self.tunnel.push(character);
        }
        is_of_message
    }
}
