//! What the user sees of a channel.

use super::radio::Radio;
use super::{Channel, Transport};
use crate::queue::CLASSES;

impl Channel {
    /// Lines for the user: the channel and its peers.
    pub fn report(&self) -> Vec<String> {
        let mut first = self.spec.to_string();
        if matches!(
            self.transport,
            Transport::Away(_) | Transport::LookingUp(_) | Transport::Connecting(..)
        ) {
            first += ", not available";
        }
        let dropped = self.dropped;
        let troubles = [
            (self.malformed, "malformed"),
            (self.rejected.unsigned, "not signed"),
            (self.rejected.other_key, "signed with another key"),
            (self.rejected.old, "signed too late or repeated"),
            (self.refused, "refused"),
            (dropped, "dropped before"),
        ];
        for (count, what) in troubles.into_iter().filter(|(count, _)| *count > 0) {
            first += &format!(", {count} {what}");
        }
        let mut lines = vec![first];
        for peer in self.peers.values() {
            let mut line = format!("  {}: {} in, {} out", peer.name, peer.received, peer.sent);
            if let Some(radio) = peer.radio.as_ref().and_then(Radio::text) {
                line += &format!(", {radio}");
            }
            for (class, what) in CLASSES {
                if let Some(count) = peer.queue.dropped().get(&class) {
                    line += &format!(
                        ", {count} {what}{}",
                        if what.ends_with("out") { "" } else { " dropped" }
                    );
                }
            }
            lines.push(line);
        }
        lines
    }
}
