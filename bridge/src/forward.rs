//! CAN frames through MAVLink: CAN_FORWARD, CAN_FRAME and CAN_FILTER_MODIFY, as ArduPilot has them and as pydronecan's `mavcan:`
//! and the DroneCAN GUI Tool use them.
//!
//! A station that sends MAV_CMD_CAN_FORWARD with bus 1 sees all frames for five seconds; it sends it again and again. Frames that
//! it sends itself go to the bus, and to the other stations, and do not come back. A filter lets through the message types and
//! services with its numbers; 0 stands for anonymous frames.

use crate::message::Content;
use crate::post::{Asker, PeerId, To};
use crate::queue::Class;
use crate::state::State;
use dronecan_host::{CanId, Frame, Id};
use mavlink::dialects::common::{CAN_FILTER_MODIFY_DATA, CAN_FRAME_DATA, CanFilterOp, MavMessage, MavResult};
use std::collections::BTreeMap;
use std::time::Duration;

/// How long a CAN_FORWARD counts.
const FORWARD_FOR: Duration = Duration::from_secs(5);
/// In the identifier of a CAN_FRAME: it has 29 bits. The two below it mark remote and error frames.
const EXTENDED: u32 = 1 << 31;
const FLAGS: u32 = 0b111 << 29;
const STANDARD_ID_MAX: u32 = 0x7FF;
/// What a filter may hold, over several CAN_FILTER_MODIFY.
const FILTER_MAX: usize = 1024;

/// A station that wants to see the bus.
#[derive(Clone, Debug)]
struct Subscriber {
    asker: Asker,
    until: Duration,
    /// Empty for everything.
    filter: Vec<u16>,
}

impl Subscriber {
    fn wants(&self, frame: &Frame) -> bool {
        self.filter.is_empty() || self.filter.contains(&type_of(frame))
    }
}

/// What filters go by: a message type, a service, 0 for an anonymous frame.
fn type_of(frame: &Frame) -> u16 {
    let Id::Extended(id) = frame.id else { return 0 };
    match CanId::parse(id) {
        Some(CanId::Message { type_id, .. }) => type_id,
        Some(CanId::Service { service_id, .. }) => service_id.into(),
        Some(CanId::Anonymous { .. }) | None => 0,
    }
}

/// The stations that see the bus.
#[derive(Default)]
pub struct Forward {
    subscribers: BTreeMap<PeerId, Subscriber>,
}

impl Forward {
    /// MAV_CMD_CAN_FORWARD: bus 1 begins, or goes on; 0 ends.
    pub fn subscribe(&mut self, state: &mut State, now: Duration, asker: Asker, bus: i64) -> MavResult {
        let until = now + FORWARD_FOR;
        match bus {
            0 => {
                self.subscribers.remove(&asker.peer);
            }
            1 => {
                let new = Subscriber { asker, until, filter: Vec::new() };
                let subscriber = self.subscribers.entry(asker.peer).or_insert_with(|| {
                    state.log.push(format!("system {} component {} looks at the bus", asker.from.0, asker.from.1));
                    new
                });
                subscriber.until = until;
                subscriber.asker = asker;
            }
            // There is one bus only.
            _ => return MavResult::MAV_RESULT_DENIED,
        }
        MavResult::MAV_RESULT_ACCEPTED
    }

    /// CAN_FILTER_MODIFY. Its bus counts from 1.
    pub fn filter(&mut self, state: &State, now: Duration, asker: Asker, data: &CAN_FILTER_MODIFY_DATA) {
        if data.bus != 1 || !state.settings.rights.can {
            return;
        }
        let ids = &data.ids[..usize::from(data.num_ids).min(data.ids.len())];
        // It may come before the first CAN_FORWARD.
        let new = Subscriber { asker, until: now + FORWARD_FOR, filter: Vec::new() };
        let filter = &mut self.subscribers.entry(asker.peer).or_insert(new).filter;
        match data.operation {
            CanFilterOp::CAN_FILTER_REPLACE => *filter = ids.to_vec(),
            CanFilterOp::CAN_FILTER_ADD => filter.extend(ids),
            CanFilterOp::CAN_FILTER_REMOVE => filter.retain(|id| !ids.contains(id)),
        }
        filter.sort_unstable();
        filter.dedup();
        filter.truncate(FILTER_MAX);
    }

    /// Shows a frame that is on the bus to those who want to see it, except for whom it came from.
    pub fn show(&self, state: &mut State, now: Duration, frame: &Frame, from: Option<PeerId>) {
        if frame.remote || self.subscribers.is_empty() {
            return;
        }
        let id = match frame.id {
            Id::Standard(id) => u32::from(id),
            Id::Extended(id) => id | EXTENDED,
        };
        let mut data = [0; 8];
        data[..frame.data().len()].copy_from_slice(frame.data());
        let component = state.settings.component;
        let wanting = |s: &&Subscriber| s.until > now && Some(s.asker.peer) != from && s.wants(frame);
        let askers: Vec<Asker> = self.subscribers.values().filter(wanting).map(|s| s.asker).collect();
        for asker in askers {
            let message = CAN_FRAME_DATA {
                id,
                target_system: asker.from.0,
                target_component: asker.from.1,
                bus: 0,
                len: frame.data().len() as u8,
                data,
            };
            state.post(To::One(asker.peer), Class::Frame, component, Content::from(MavMessage::CAN_FRAME(message)));
        }
    }

    /// A station's CAN_FRAME, for the bus. Its bus counts from 0.
    pub fn frame_from_station(&self, state: &mut State, asker: Asker, message: &CAN_FRAME_DATA) -> Option<Frame> {
        let rights = state.settings.rights;
        if !(rights.can && rights.change) {
            return None;
        }
        let id = message.id & !FLAGS;
        let data = message.data.get(..usize::from(message.len))?;
        let frame = match message.id & FLAGS {
            EXTENDED => Frame::extended(id, data),
            0 if id <= STANDARD_ID_MAX => Frame::standard(id as u16, data),
            _ => return None,
        };
        if message.bus != 0 {
            return None;
        }
        state.outgoing.push((frame, Some(asker.peer)));
        Some(frame)
    }

    /// Ends what was not renewed.
    pub fn poll(&mut self, now: Duration) {
        self.subscribers.retain(|_, subscriber| subscriber.until > now);
    }

    pub fn drop_station(&mut self, peer: PeerId) {
        self.subscribers.remove(&peer);
    }
}
