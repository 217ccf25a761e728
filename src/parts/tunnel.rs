//! The serial monitor through the bus: tunnel.Targetted, as ArduPilot's nodes and the DroneCAN GUI
//! Tool have it.
//!
//! ```text
//! protocol u8 | target node u7 | serial port i5 | options u4 | baud rate u24 | buffer u8[<=120]
//! ```
//! The node that sends a Targetted to this node gets what the serial monitor writes, for three
//! seconds. While somebody looks, the monitor writes as fast as the tunnel takes it, at most 1,900
//! characters a second. Transfers of one frame only are taken: they hold up to one character.

/// Characters of one message. With the six bytes before them they are as long as the longest
/// message of the node, a CanStats.
const ROOM: usize = 19;

/// The shortest time between two messages, in milliseconds: 4 % of a bus of 1 Mbit/s.
const PERIOD_MS: u16 = 10;

/// An asker that has not asked again for this time is gone, in milliseconds. ArduPilot's nodes wait
/// for as long.
const ASKER_STAYS_MS: u16 = 3000;

/// Length of a Targetted without characters.
pub const HEADER_LEN: u8 = 6;

/// Serial port of a Targetted: -1, the default, in five bits.
const DEFAULT_PORT: u8 = 0x1F;

/// The tunnel.
pub struct Tunnel {
    /// The node that looks; 0 for none.
    asker: u8,
    protocol: u8,
    asked_ms: u16,
    sent_ms: u16,
    len: u8,
    characters: [u8; ROOM],
}

impl Tunnel {
    /// Closed.
    pub const fn new() -> Self {
        Self { asker: 0, protocol: 0, asked_ms: 0, sent_ms: 0, len: 0, characters: [0; ROOM] }
    }

    /// Acts on a Targetted that begins with these bytes. Returns false if it is for another node,
    /// or another port than this node has.
    pub fn act_on_message(&mut self, header: [u8; 3], node: u8, source: u8, now_ms: u16) -> bool {
        let [protocol, target, port] = header;
        let port = (target & 1) << 4 | port >> 4;
        let is_for_us = target >> 1 == node && (port == DEFAULT_PORT || port == 0);
        if is_for_us {
            self.asker = source;
            self.protocol = protocol;
            self.asked_ms = now_ms;
        }
        is_for_us
    }

    /// True if the serial monitor may write a character.
    pub fn has_room(&self) -> bool {
        self.asker == 0 || usize::from(self.len) < ROOM
    }

    /// Keeps a character of the serial monitor, or 0 for none.
    pub fn push(&mut self, character: u8) {
        if self.asker != 0
            && character != 0
            && let Some(place) = self.characters.get_mut(usize::from(self.len))
        {
            *place = character;
            self.len += 1;
        }
    }

    /// Call at every tick. Returns true if a message is due.
    pub fn tick(&mut self, now_ms: u16) -> bool {
        if now_ms.wrapping_sub(self.asked_ms) > ASKER_STAYS_MS {
            self.asker = 0;
            self.len = 0;
        }
        self.len != 0 && now_ms.wrapping_sub(self.sent_ms) >= PERIOD_MS
    }

    /// Removes the message: the payload, byte by byte.
    pub fn take(&mut self, now_ms: u16, mut put: impl FnMut(u8)) {
        put(self.protocol);
        // Serial port 0, no options, no baud rate.
        put(self.asker << 1);
        (2..HEADER_LEN).for_each(|_| put(0));
        self.characters.iter().take(usize::from(self.len)).for_each(|character| put(*character));
        self.len = 0;
        self.sent_ms = now_ms;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// For node 120: the header of a Targetted to its default port, as pydronecan writes it.
    const TO_120: [u8; 3] = [2, 0xF1, 0xF0];

    #[test]
    fn another_node_and_another_port_are_left_alone() {
        let mut tunnel = Tunnel::new();
        assert!(!tunnel.act_on_message(TO_120, 121, 5, 0));
        assert!(!tunnel.act_on_message([2, 120 << 1, 1 << 4], 120, 5, 0), "port 1");
        assert!(tunnel.act_on_message([2, 120 << 1, 0], 120, 5, 0), "port 0");
    }
}
