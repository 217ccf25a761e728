//! What the node sends, and when: its messages, and the replies to requests.

use super::parameters::Parameter;
use super::{Dialect, MIN_STATUS_PERIOD_MS, Node, RESTART_MS, allocation, count, servo};
use crate::can::mcp2515::Counted;
use crate::dronecan::kind::Kind;
use crate::dronecan::wire::TRANSFER_ID;
use crate::dronecan::{draft, float16};
use crate::monitor::Monitor;
use crate::progmem::Progmem;

/// Priority of periodic messages: that of ArduPilot's own peripherals.
const PRIORITY_LOW: u8 = 24;

/// Priority of Allocation requests, as in the specification's example.
const PRIORITY_LOWER: u8 = 30;

/// How many messages the node has, each with its own transfer IDs.
pub const MESSAGES: usize = 7;

/// Messages to send, one bit each, in the order in which they go when several are due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Due(u8);

impl Due {
    /// Nothing to send.
    pub const NONE: Self = Self(0);
    /// uavcan.protocol.NodeStatus
    pub const NODE_STATUS: u8 = 1 << 0;
    /// thesis.DegreesCelsius
    pub const DEGREES_CELSIUS: u8 = 1 << 1;
    /// uavcan.equipment.actuator.Status
    pub const ACTUATOR_STATUS: u8 = 1 << 2;
    /// uavcan.equipment.device.Temperature
    pub const TEMPERATURE: u8 = 1 << 3;
    /// dronecan.protocol.CanStats
    pub const CAN_STATS: u8 = 1 << 4;
    /// uavcan.protocol.debug.KeyValue
    pub const BUTTON: u8 = 1 << 5;
    /// uavcan.protocol.dynamic_node_id.Allocation
    pub const ALLOCATION: u8 = 1 << 6;

    /// Adds a message.
    pub fn set(&mut self, message: u8) {
        self.0 |= message;
    }

    /// Takes one away.
    pub fn clear(&mut self, message: u8) {
        self.0 &= !message;
    }
}

/// The servo gets no pulse. No position is as far away as that.
const NO_POSITION: u16 = u16::MAX;

/// What is being sent when it is a reply and no message.
const REPLY: u8 = MESSAGES as u8;

impl Node {
    /// Whether it may be worth to [`prepare`](Self::prepare) something.
    #[inline(always)]
    pub fn has_to_send(&self) -> bool {
        self.due.0 != 0 || self.outgoing.is_busy() || !self.replies.is_empty()
    }

    /// Does a step towards the next frame, if there is one to do; whether there was.
    #[inline(never)]
    pub fn prepare(
        &mut self,
        counters: &impl Counted,
        flash: impl Progmem,
        monitor: &mut Monitor,
        now_ms: u16,
    ) -> bool {
        if self.outgoing.is_ready() {
            return false;
        }
        if self.outgoing.is_busy() {
            self.outgoing.step(&self.unique_id, flash);
            return true;
        }
        if self.due.0 != 0 && self.begin_message(counters, flash, now_ms) {
            return true;
        }
        if self.id != 0 && self.begin_reply(counters, flash, monitor) {
            self.sending = REPLY;
            return true;
        }
        false
    }

    /// Whether a frame is ready.
    #[inline(always)]
    pub fn is_ready(&self) -> bool {
        self.outgoing.is_ready()
    }

    /// The frame that is ready.
    pub fn frame(&self) -> &crate::can::Frame {
        &self.outgoing.frame
    }

    /// The controller has taken the frame.
    pub fn handed_over(&mut self, now_ms: u16) {
        if !self.outgoing.handed_over() {
            return;
        }
        count(&mut self.counts.sent);
        if self.sending == 0 {
            self.status_in_controller = true;
            self.status_sent_ms = now_ms;
        }
        if self.sending == REPLY && self.replies.pop() && !self.is_to_restart {
            self.is_to_restart = true;
            self.restart_ms = now_ms.wrapping_add(RESTART_MS);
        }
    }

    /// The controller has nothing more to send: a status that waited in it for the bus has left only now.
    pub fn controller_is_empty(&mut self, now_ms: u16) {
        if self.status_in_controller {
            self.status_in_controller = false;
            self.status_sent_ms = now_ms;
        }
    }

    pub(super) fn is_status_spaced(&self, now_ms: u16) -> bool {
        now_ms.wrapping_sub(self.status_sent_ms) >= MIN_STATUS_PERIOD_MS
    }

    /// Puts the payload of a NodeStatus, in the dialect of what is going out.
    #[inline(never)]
    pub(super) fn put_status(&mut self) {
        let code = self.conditions.code();
        let health = if code & self.parameters.get(Parameter::CritMask) != 0 {
            3 << 6
        } else if code & self.parameters.get(Parameter::ErrorMask) != 0 {
            2 << 6
        } else if code & self.parameters.get(Parameter::WarnMask) != 0 {
            1 << 6
        } else {
            0
        };
        const INITIALIZATION: u8 = 1 << 3;
        let mode = if self.thermometer.has_measured() { 0 } else { INITIALIZATION };
        let [u0, u1, u2, u3] = self.uptime_sec.to_le_bytes();
        self.outgoing.put16(u16::from_le_bytes([u0, u1]));
        self.outgoing.put8(u2);
        if self.outgoing.is_draft {
            // 28 bits of uptime; 0 is OK, 1 initialising, 2 a warning, 3 anything worse.
            let status = match health >> 6 {
                0 => mode >> 3,
                1 => 2,
                _ => 3,
            };
            self.outgoing.put8(u3 << 4 | status);
        } else {
            self.outgoing.put8(u3);
            self.outgoing.put8(health | mode);
        }
        self.outgoing.put16(code);
    }

    /// Puts a request for a node ID; its CRC, which makes it differ from other nodes' (specification, chapter 4).
    fn put_request(&mut self, now_ms: u16) -> u16 {
        let skipped = self.allocation.ask(now_ms);
        // Any node ID will do; the lowest bit says that this is the first part.
        self.outgoing.put8(u8::from(skipped == 0));
        let mut at = skipped;
        let mut left = allocation::MAX_PART_LEN;
        while left != 0 {
            if let Some(&byte) = self.unique_id.get(usize::from(at)) {
                self.outgoing.put8(byte);
            }
            at = at.wrapping_add(1);
            left = left.wrapping_sub(1);
        }
        self.outgoing.sum()
    }

    /// Begins the first message that is due and can go.
    #[inline(never)]
    fn begin_message(&mut self, counters: &impl Counted, flash: impl Progmem, now_ms: u16) -> bool {
        let mut due = self.due.0;
        if self.id == 0 {
            due &= Due::ALLOCATION;
        } else {
            due &= !Due::ALLOCATION;
            if self.status_in_controller || !self.is_status_spaced(now_ms) {
                due &= !Due::NODE_STATUS;
            }
            if !self.thermometer.has_measured() {
                due &= !(Due::TEMPERATURE | Due::DEGREES_CELSIUS);
            }
        }
        // The draft has no allocation: without an ID it is v0 that the node speaks.
        let is_draft = self.dialect == Dialect::DRAFT && self.id != 0;
        if is_draft {
            due &= Due::NODE_STATUS | Due::DEGREES_CELSIUS | Due::BUTTON;
        }
        if due == 0 {
            return false;
        }
        if due & Due::ACTUATOR_STATUS != 0 && !self.has_position {
            self.has_position = true;
            self.position = if self.pulse != 0 { self.travel.position(self.pulse) } else { NO_POSITION };
            return true;
        }
        let mut message = 0u8;
        let mut bit = 1u8;
        while due & 1 == 0 {
            message = message.wrapping_add(1);
            bit <<= 1;
            due >>= 1;
        }
        self.due.clear(bit);
        self.sending = message;

        self.outgoing.clear(is_draft);
        let kind = Kind(Kind::OWN_STATUS.0.wrapping_add(message));
        let mut id = [PRIORITY_LOW, kind.id_high(flash), kind.id_low(flash), self.id];
        match bit {
            Due::NODE_STATUS => {
                self.put_status();
            }
            Due::DEGREES_CELSIUS => {
                let degrees = self.celsius;
                self.outgoing.put8(if degrees < 0 {
                    0
                } else if degrees > 255 {
                    255
                } else {
                    degrees as u8
                });
            }
            Due::ACTUATOR_STATUS => {
                self.has_position = false;
                self.outgoing.put8(self.parameters.get(Parameter::Out1Id) as u8);
                let position = self.position;
                self.outgoing.put16(if position == NO_POSITION { float16::NAN } else { servo::radians(position) });
                self.outgoing.put16(float16::NAN);
                self.outgoing.put16(float16::NAN);
                const POWER_UNKNOWN: u8 = 127;
                self.outgoing.put8(POWER_UNKNOWN);
            }
            Due::TEMPERATURE => {
                self.outgoing.put16(self.parameters.get(Parameter::TempId));
                self.outgoing.put16(float16::from_fixed(self.kelvin_64ths, 6));
                self.outgoing.put8(self.temperature_flags);
            }
            Due::CAN_STATS => {
                self.outgoing.put8(0);
                self.outgoing.put_words(counters);
            }
            // In the draft the thesis's measurement, too.
            Due::BUTTON if is_draft => {
                message = 1;
                self.outgoing.put8(self.button.count() as u8);
            }
            Due::BUTTON => {
                let [high, low] = float32(self.button.count());
                self.outgoing.put16(low);
                self.outgoing.put16(high);
                self.outgoing.put16(u16::from_le_bytes(*b"bt"));
                self.outgoing.put8(b'n');
            }
            _ => {
                // The type in the lower two bits, and the discriminator above it.
                let [low, high] = (self.put_request(now_ms) << 1).to_le_bytes();
                id = [PRIORITY_LOWER, high, low & 0xFC | 1, 0];
            }
        }
        self.outgoing.frame.id = id;
        if is_draft {
            self.outgoing.address(if message == 0 { draft::NODE_STATUS } else { draft::MEASUREMENT }, self.id);
        }
        let Some(transfer_id) = self.transfer_ids.get_mut(usize::from(message)) else { return false };
        let current = *transfer_id;
        *transfer_id = current.wrapping_add(1) & TRANSFER_ID;
        self.outgoing.begin(current, kind.seed(flash));
        true
    }
}

/// A whole number as an IEEE 754 single: its upper and lower half.
fn float32(number: u16) -> [u16; 2] {
    if number == 0 {
        return [0; 2];
    }
    let mut mantissa = number;
    let mut exponent = 127 + 15u8;
    while mantissa & 0x8000 == 0 {
        mantissa <<= 1;
        exponent = exponent.wrapping_sub(1);
    }
    // The leading one is understood.
    let [low, high] = mantissa.to_le_bytes();
    [u16::from(exponent) << 7 | u16::from(high & 0x7F), u16::from(low) << 8]
}

#[cfg(test)]
mod tests;
