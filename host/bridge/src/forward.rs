//! CAN frames over MAVLink: CAN_FORWARD, CAN_FRAME and CAN_FILTER_MODIFY, as in ArduPilot;
//! pydronecan's `mavcan:` and the DroneCAN GUI Tool use them.
//!
//! A station that sends MAV_CMD_CAN_FORWARD with bus 1 receives all frames for five seconds, and
//! repeats the command. The frames that it sends go to the bus and to the other stations, not back
//! to it. A filter passes the message types and services with its numbers; 0 stands for anonymous
//! frames.

use crate::post::{Asker, PeerId, To};
use crate::queue::Class;
use crate::state::State;
use dronecan_host::{CanId, Frame, Id};
use mavlink::dialects::common::{
    CAN_FILTER_MODIFY_DATA, CAN_FRAME_DATA, CanFilterOp, MavMessage, MavResult,
};
use std::collections::BTreeMap;
use std::time::Duration;

/// Time for which a CAN_FORWARD is valid.
const FORWARD_FOR: Duration = Duration::from_secs(5);
/// Flag in the identifier of a CAN_FRAME: 29-bit identifier. The two bits below mark remote and
/// error frames.
const EXTENDED: u32 = 1 << 31;
const FLAGS: u32 = 0b111 << 29;
const STANDARD_ID_MAX: u32 = 0x7FF;
/// Maximum number of types in a filter, which several CAN_FILTER_MODIFY can fill.
const FILTER_MAX: usize = 1024;

/// A station that receives the frames of the bus.
#[derive(Clone, Debug)]
struct Subscriber {
    asker: Asker,
    until: Duration,
    /// Types that pass; if empty, all.
    filter: Vec<u16>,
}

impl Subscriber {
    fn wants(&self, frame: &Frame) -> bool {
        self.filter.is_empty() || self.filter.contains(&type_of(frame))
    }
}

/// The number that filters compare: a message type, a service, or 0 for an anonymous frame.
fn type_of(frame: &Frame) -> u16 {
    let Id::Extended(id) = frame.id else { return 0 };
    match CanId::parse(id) {
        Some(CanId::Message { type_id, .. }) => type_id,
        Some(CanId::Service { service_id, .. }) => service_id.into(),
        Some(CanId::Anonymous { .. }) | None => 0,
    }
}

/// The stations that receive the frames of the bus.
#[derive(Default)]
pub struct Forward {
    subscribers: BTreeMap<PeerId, Subscriber>,
}

impl Forward {
    /// MAV_CMD_CAN_FORWARD: bus 1 starts or continues, 0 ends.
    pub fn subscribe(
        &mut self,
        state: &mut State,
        now: Duration,
        asker: Asker,
        bus: i64,
    ) -> MavResult {
        let until = now + FORWARD_FOR;
        match bus {
            0 => {
                self.subscribers.remove(&asker.peer);
            }
            1 => {
                let new = Subscriber { asker, until, filter: Vec::new() };
                let subscriber = self.subscribers.entry(asker.peer).or_insert_with(|| {
                    state.log.push(format!(
                        "system {} component {} receives the frames of the bus",
                        asker.from.0, asker.from.1
                    ));
                    new
                });
                subscriber.until = until;
                subscriber.asker = asker;
            }
            // There is only one bus.
            _ => return MavResult::MAV_RESULT_DENIED,
        }
        MavResult::MAV_RESULT_ACCEPTED
    }

    /// CAN_FILTER_MODIFY. Its bus numbers start with 1.
    pub fn filter(
        &mut self,
        state: &State,
        now: Duration,
        asker: Asker,
        data: &CAN_FILTER_MODIFY_DATA,
    ) {
        if data.bus != 1 || !state.settings.rights.can {
            return;
        }
        let ids = &data.ids[..usize::from(data.num_ids).min(data.ids.len())];
        // The filter may come before the first CAN_FORWARD.
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

    /// Sends a frame of the bus to the subscribed stations, except to the one that it comes from.
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
        let wanting =
            |s: &&Subscriber| s.until > now && Some(s.asker.peer) != from && s.wants(frame);
        let askers: Vec<Asker> =
            self.subscribers.values().filter(wanting).map(|s| s.asker).collect();
        for asker in askers {
            let message = CAN_FRAME_DATA {
                id,
                target_system: asker.from.0,
                target_component: asker.from.1,
                bus: 0,
                len: frame.data().len() as u8,
                data,
            };
            let message = MavMessage::CAN_FRAME(message);
            state.post(To::One(asker.peer), Class::Frame, component, message);
        }
    }

    /// A station's CAN_FRAME as a frame for the bus. Its bus numbers start with 0.
    pub fn frame_from_station(
        &self,
        state: &mut State,
        asker: Asker,
        message: &CAN_FRAME_DATA,
    ) -> Option<Frame> {
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

    /// Ends subscriptions that were not renewed.
    pub fn poll(&mut self, now: Duration) {
        self.subscribers.retain(|_, subscriber| subscriber.until > now);
    }

    pub fn drop_station(&mut self, peer: PeerId) {
        self.subscribers.remove(&peer);
    }
}
