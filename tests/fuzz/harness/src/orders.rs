//! Computes from the frames and the parameters which commands may move the servo. Each sender is
//! separate. The rules are those of the specification of transfers (chapter 4) and of
//! docs/messages.md.

use std::collections::HashMap;

use dronecan_host::{CanId, DataType, NodeId, RESTART_MAGIC, crc, types};
use firmware::tables::parameters::{OutputParameter, Parameters};
use half::f16;

const START: u8 = 1 << 7;
const END: u8 = 1 << 6;
const TOGGLE: u8 = 1 << 5;
const NUMBER: u8 = 0x1F;

/// Time after which a frame no longer continues a list.
const LIST_TIMEOUT_MS: u64 = 50;
/// Time after which a frame no longer continues any other transfer (specification, chapter 4).
const TIMEOUT_MS: u64 = 2000;

/// Length of the CRC before the payload of a transfer of several frames, in bytes.
const SUM: usize = 2;

/// Length of an entry of a command array in bytes.
const ENTRY: usize = 4;

/// The type of an entry's value (DSDL uavcan/equipment/actuator/Command.uavcan).
const UNITLESS: u8 = 0;
const POSITION: u8 = 1;
const PWM: u8 = 4;

/// The node ignores the priority: frames that differ only in it belong to the same transfer.
const WITHOUT_PRIORITY: u32 = 0x00FF_FFFF;

/// A transfer that may be complete in the node, unless the node dropped it for another sender's.
pub struct Completed {
    pub id: CanId,
    pub number: u8,
    pub payload: Vec<u8>,
    /// True if the node must not drop it: it has one frame, or is a command array and no other
    /// sender has begun one.
    pub is_sure: bool,
    /// True if OUT1_ID changed during the transfer, so that the node may have used the entry of
    /// either ID.
    is_unclear: bool,
}

struct Session {
    number: u8,
    toggle: bool,
    stream: Vec<u8>,
    /// Time of its last frame.
    heard_ms: u64,
    actuator: u16,
    is_alone: bool,
}

/// The transfers of all senders.
#[derive(Default)]
pub struct Transfers {
    sessions: HashMap<u32, Session>,
}

impl Transfers {
    /// Handles a frame with a 29-bit identifier. Returns the transfer that it completes.
    pub fn push(
        &mut self,
        id: u32,
        data: &[u8],
        now_ms: u64,
        parameters: &Parameters,
    ) -> Option<Completed> {
        let seed = CanId::parse(id).and_then(DataType::of).and_then(|known| known.seed);
        let actuator = parameters.of(0, OutputParameter::Id);
        let can_id = CanId::parse(id)?;
        let key = id & WITHOUT_PRIORITY;
        let (&tail, part) = data.split_last()?;
        let (number, toggle) = (tail & NUMBER, tail & TOGGLE != 0);
        let heard = |payload, is_sure, is_unclear| {
            Some(Completed { id: can_id, number, payload, is_sure, is_unclear })
        };
        if tail & START != 0 {
            if toggle {
                return None;
            }
            if tail & END != 0 {
                return heard(part.to_vec(), true, false);
            }
            if part.len() < SUM {
                return None;
            }
            let is_alone = self.is_alone(key, now_ms);
            let stream = part.to_vec();
            self.sessions.insert(
                key,
                Session { number, toggle: true, stream, heard_ms: now_ms, actuator, is_alone },
            );
            return None;
        }
        let session = self.sessions.get_mut(&key)?;
        if session.number != number
            || session.toggle != toggle
            || now_ms - session.heard_ms > timeout_ms(key)
        {
            return None;
        }
        session.toggle = !toggle;
        session.heard_ms = now_ms;
        session.stream.extend(part);
        if tail & END == 0 {
            return None;
        }
        let session = self.sessions.remove(&key)?;
        let (sum, payload) = session.stream.split_first_chunk::<SUM>()?;
        (u16::from_le_bytes(*sum) == crc::feed(seed?, payload)).then_some(())?;
        // Maximum length of a list: 15 commands of four bytes, or 20 lights of three.
        if is_list(key) && payload.len() > 60 {
            return None;
        }
        heard(payload.to_vec(), session.is_alone, session.actuator != actuator)
    }

    /// True if the transfer that begins is a list and no other list is in progress. Marks the other
    /// lists as disturbed.
    fn is_alone(&mut self, key: u32, now_ms: u64) -> bool {
        if !is_list(key) {
            return false;
        }
        let mut is_alone = true;
        for (_, session) in
            self.sessions.iter_mut().filter(|(other, _)| **other != key && is_list(**other))
        {
            is_alone &= now_ms - session.heard_ms > LIST_TIMEOUT_MS;
            session.is_alone = false;
        }
        is_alone
    }
}

/// The longest time between two frames of a transfer with this key.
fn timeout_ms(key: u32) -> u64 {
    if is_list(key) { LIST_TIMEOUT_MS } else { TIMEOUT_MS }
}

/// True if transfers with this key are lists.
fn is_list(key: u32) -> bool {
    let lists = [types::ARRAY_COMMAND.id, types::LIGHTS_COMMAND.id];
    matches!(
        CanId::parse(key),
        Some(CanId::Message { type_id, .. }) if lists.contains(&type_id)
    )
}

/// A pulse width in ticks of half a microsecond, and the tolerance.
#[derive(Clone, Copy, Debug)]
pub struct Width {
    pub ticks: f64,
    pub tolerance: f64,
}

impl Width {
    fn exactly(ticks: f64) -> Width {
        Width { ticks, tolerance: 0.0 }
    }

    /// True if a pulse has this width.
    pub fn fits(self, ticks: u16) -> bool {
        (f64::from(ticks) - self.ticks).abs() <= self.tolerance
    }
}

/// The parameters that commands depend on.
#[derive(Debug)]
pub struct Travel {
    low: f64,
    trim: f64,
    high: f64,
    is_reversed: bool,
    half_range_rad: f64,
}

const TICKS_PER_US: f64 = 2.0;

impl Travel {
    pub fn of(parameters: &Parameters) -> Travel {
        let ticks = |parameter| f64::from(parameters.of(0, parameter)) * TICKS_PER_US;
        let (a, b) = (ticks(OutputParameter::Min), ticks(OutputParameter::Max));
        let (low, high) = (a.min(b), a.max(b));
        Travel {
            low,
            trim: ticks(OutputParameter::Trim).clamp(low, high),
            high,
            is_reversed: parameters.of(0, OutputParameter::Reversed) != 0,
            half_range_rad: f64::from(parameters.of(0, OutputParameter::Range)).to_radians() / 2.0,
        }
    }

    /// The expected pulse after a change of the travel.
    pub fn limited(&self, ticks: u16) -> Width {
        Width::exactly(if ticks == 0 { 0.0 } else { f64::from(ticks).clamp(self.low, self.high) })
    }

    /// Width at `fraction` (-1 to 1) between the trim and the limit on that side. `error` is the
    /// tolerance of the fraction.
    fn deflected(&self, fraction: f64, error: f64) -> Width {
        let fraction = fraction.clamp(-1.0, 1.0) * if self.is_reversed { -1.0 } else { 1.0 };
        let side = if fraction < 0.0 { self.trim - self.low } else { self.high - self.trim };
        Width { ticks: self.trim + fraction * side, tolerance: 1.0 + error * side }
    }

    fn of_entry(&self, unit: u8, value: f16) -> Option<Width> {
        /// Resolution of the node's angles in radians.
        const ANGLE_STEP: f64 = 1.0 / 4096.0;
        /// The least width that the node follows, in microseconds.
        const LEAST_WIDTH_US: f64 = 0.25;
        let value = Some(value.to_f64()).filter(|value| value.is_finite())?;
        match unit {
            UNITLESS => Some(self.deflected(value, 0.0)),
            POSITION => {
                Some(self.deflected(value / self.half_range_rad, ANGLE_STEP / self.half_range_rad))
            }
            PWM => {
                let ticks = value * TICKS_PER_US;
                // The node rejects widths that it would round to 0.
                (value >= LEAST_WIDTH_US)
                    .then(|| Width { ticks: ticks.clamp(self.low, self.high), tolerance: 1.0 })
            }
            _ => None,
        }
    }

    fn of_byte(&self, byte: u8) -> Width {
        let fraction = f64::from(if self.is_reversed { !byte } else { byte }) / 255.0;
        Width { ticks: self.low + fraction * (self.high - self.low), tolerance: 1.0 }
    }
}

/// The width of the failsafe; `None` if the servo holds.
pub fn failsafe(parameters: &Parameters) -> Option<Width> {
    let travel = Travel::of(parameters);
    match parameters.of(0, OutputParameter::Fs) {
        0 => None,
        1 => Some(Width::exactly(travel.trim)),
        2 => {
            let ticks = f64::from(parameters.of(0, OutputParameter::FsPwm)) * TICKS_PER_US;
            Some(Width::exactly(ticks.clamp(travel.low, travel.high)))
        }
        _ => Some(Width::exactly(0.0)),
    }
}

/// The effect of a transfer on the servo.
#[derive(Debug)]
pub enum Order {
    /// Move to one of these widths, if commands are allowed.
    Go {
        widths: Vec<Width>,
        /// True if the node must follow it: the harness knows which entry the node uses.
        is_clear: bool,
    },
    /// Move to the failsafe, because the node restarts.
    Restart,
    Arm(bool),
}

impl Completed {
    /// Node ID of the sender; 0 if it has none.
    pub fn source(&self) -> u8 {
        self.id.source().map_or(0, NodeId::get)
    }

    /// The order, if the node with this ID and these parameters follows it.
    pub fn order(&self, me: u8, parameters: &Parameters) -> Option<Order> {
        if self.id.source().map(NodeId::get) == Some(me) {
            return None;
        }
        match (self.id, self.payload.as_slice()) {
            (CanId::Message { type_id, .. }, payload) if type_id == types::ARRAY_COMMAND.id => {
                let actuator = parameters.of(0, OutputParameter::Id);
                let travel = Travel::of(parameters);
                let (entries, []) = payload.as_chunks::<ENTRY>() else { return None };
                let width = |&[_, unit, low, high]: &[u8; ENTRY]| {
                    travel.of_entry(unit, f16::from_le_bytes([low, high]))
                };
                if self.is_unclear {
                    return Some(Order::Go {
                        widths: entries.iter().filter_map(width).collect(),
                        is_clear: false,
                    });
                }
                let last = entries.iter().rev().find(|entry| u16::from(entry[0]) == actuator)?;
                Some(Order::Go { widths: vec![width(last)?], is_clear: true })
            }
            (CanId::Message { type_id, .. }, &[byte]) if type_id == types::THESIS_COMMAND.id => {
                Some(Order::Go {
                    widths: vec![Travel::of(parameters).of_byte(byte)],
                    is_clear: true,
                })
            }
            (CanId::Message { type_id, .. }, &[byte]) if type_id == types::ARMING_STATUS.id => {
                Some(Order::Arm(byte == 255))
            }
            (CanId::Service { service_id, request: true, destination, .. }, payload)
                if u16::from(service_id) == types::RESTART_NODE.id && destination.get() == me =>
            {
                (payload == &RESTART_MAGIC.to_le_bytes()[..5]).then_some(Order::Restart)
            }
            _ => None,
        }
    }
}
