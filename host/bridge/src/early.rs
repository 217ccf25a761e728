//! Messages for a node that is not known yet but may appear in a moment, as after the start of the
//! bridge.

use crate::message::{In, Request};
use crate::post::{Asker, PeerId};
use crate::state::State;
use dronecan_host::NodeId;
use std::time::Duration;

/// Time for which such a message waits. Nodes send a status each second.
const WAITS_FOR: Duration = Duration::from_secs(3);
const WAITING_MAX: usize = 32;

/// Messages, each with the time at which it expires.
#[derive(Default)]
pub struct Early {
    waiting: Vec<(Duration, Asker, In)>,
}

impl Early {
    /// Keeps a message if it is for an unknown node.
    pub fn keep(&mut self, state: &State, now: Duration, asker: Asker, message: &In) {
        let unknown = NodeId::new(message.to.1).is_some_and(|id| !state.nodes.contains_key(&id));
        let wanted = match message.request {
            // A list of all nodes is also for those that appear later.
            Request::ParameterList => unknown || message.to.1 == 0,
            Request::ParameterRead { .. } | Request::ParameterSet { .. } | Request::Command(_) => {
                unknown
            }
            _ => false,
        };
        let own = message.to.1 == state.settings.component;
        let again = self.waiting.iter().any(|(_, who, what)| (who, what) == (&asker, message));
        if wanted && !own && !again && self.waiting.len() < WAITING_MAX {
            self.waiting.push((now + WAITS_FOR, asker, message.clone()));
        }
    }

    /// Takes the messages for a node that has appeared, or for all nodes, addressed to that node.
    pub fn take(&mut self, id: NodeId, system: u8) -> Vec<(Asker, In)> {
        let of_it = |(_, _, message): &&(Duration, Asker, In)| {
            message.to.1 == id.get() || message.to.1 == 0
        };
        let to_it = |message: &In| In { to: (system, id.get()), ..message.clone() };
        let taken = self
            .waiting
            .iter()
            .filter(of_it)
            .map(|(_, asker, message)| (*asker, to_it(message)))
            .collect();
        self.waiting.retain(|(_, _, message)| message.to.1 != id.get());
        taken
    }

    pub fn poll(&mut self, now: Duration) {
        self.waiting.retain(|(until, ..)| *until > now);
    }

    pub fn drop_station(&mut self, peer: PeerId) {
        self.waiting.retain(|(_, asker, _)| asker.peer != peer);
    }
}
