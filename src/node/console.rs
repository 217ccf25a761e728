//! Who reads the serial monitor through the bus: the tunnel, and the autopilot by LogMessage.

use crate::monitor::Line;
use crate::parts::log::Log;
use crate::parts::tunnel::Tunnel;

/// The readers.
pub struct Console {
    /// The tunnel.
    pub tunnel: Tunnel,
    /// The messages for the autopilot.
    pub log: Log,
}

impl Console {
    /// Nobody reads.
    pub const fn new() -> Self {
        Self { tunnel: Tunnel::new(), log: Log::new() }
    }

    /// True if the serial monitor may write a character: always if nobody reads it through the bus.
    pub fn takes_character(&self, now_ms: u16) -> bool {
        self.tunnel.has_room() && self.log.has_room(now_ms)
    }

    /// Keeps a character of this line of the serial monitor, or 0 for none.
    pub fn keep_character(&mut self, character: u8, line: Line, now_ms: u16) {
        self.tunnel.push(character);
        self.log.push(character, line, now_ms);
    }
}

impl Default for Console {
    fn default() -> Self {
        Self::new()
    }
}
