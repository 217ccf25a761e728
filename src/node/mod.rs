//! What the node does: follows commands, measures its temperature, and says how it is.
//!
//! [`Node`] takes received frames and the clock, and gives out frames to send and the pulse for the servo. It has no
//! hardware and never waits.

pub mod autopilot;
pub mod condition;
pub mod servo;
pub mod thermometer;

use crate::can::Frame;
use crate::can::mcp2515::{ErrorFlags, Notice, Received};
use crate::dronecan::array_command::{self, Unusable, Value};
use crate::dronecan::node_status::{self, Mode, NodeStatus};
use crate::dronecan::temperature::{self, Temperature};
use crate::dronecan::{Malformed, MessageId, NodeId, Payload, Priority, SingleFrame, TransferId, single_frame, thesis};
use crate::monitor::{Event, Line, Monitor};
use autopilot::Autopilot;
use condition::{Conditions, HOLD_S, ResetCause};
use servo::Ticks;
use thermometer::Thermometer;

/// The actuator that the node is. ArduPilot counts from 1, so this is its first servo.
const ACTUATOR_ID: u8 = 1;

/// The device that the temperature is of.
const TEMPERATURE_DEVICE_ID: u16 = 1;

/// No two statuses closer than this, in milliseconds, however often the autopilot sends its own.
const MIN_STATUS_PERIOD_MS: u16 = 500;

/// How much longer than a second to wait for the autopilot's status while there is an autopilot, in milliseconds. One that
/// sends every 1000 ms sends every 1001 at times, and would always come a moment after the node had gone ahead without it.
const AUTOPILOT_GRACE_MS: u16 = 25;

/// The thesis's temperature is sent once for so many statuses of the autopilot.
const STATUSES_PER_DEGREES: u8 = 3;

/// A message to send, in the order in which they go when several are due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Message {
    /// uavcan.protocol.NodeStatus
    NodeStatus,
    /// thesis.DegreesCelsius
    DegreesCelsius,
    /// uavcan.equipment.device.Temperature
    Temperature,
}

/// What happened to the node since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Counts {
    followed: u16,
    refused: u16,
    overruns: u16,
    given_up: u16,
}

/// The node.
pub struct Node {
    id: NodeId,
    conditions: Conditions,
    /// Seconds until the passing conditions pass.
    hold_s: u8,
    counts: Counts,

    uptime_sec: u32,
    /// Start of the running second.
    second_ms: u16,

    autopilot: Autopilot,
    /// Statuses of the autopilot since the thesis's temperature was last sent.
    autopilot_statuses: u8,
    /// Somebody has used the thesis's own command, so its own temperature is understood.
    thesis: bool,

    status_due: bool,
    degrees_due: bool,
    temperature_due: bool,
    /// Last occasion for a status: the autopilot's, or none of it for too long.
    occasion_ms: u16,
    /// Last status, once there was one: when it left, or until it has left, when it was handed to the controller.
    status_sent_ms: Option<u16>,
    status_in_controller: bool,

    status_transfer_id: TransferId,
    degrees_transfer_id: TransferId,
    temperature_transfer_id: TransferId,

    thermometer: Thermometer,
    pulse: Option<Ticks>,
}

impl Node {
    /// A node that has yet to start.
    pub const fn new(id: NodeId) -> Self {
        Self {
            id,
            conditions: Conditions::NONE,
            hold_s: 0,
            counts: Counts { followed: 0, refused: 0, overruns: 0, given_up: 0 },
            uptime_sec: 0,
            second_ms: 0,
            autopilot: Autopilot::NONE,
            autopilot_statuses: 0,
            thesis: false,
            status_due: false,
            degrees_due: false,
            temperature_due: false,
            occasion_ms: 0,
            status_sent_ms: None,
            status_in_controller: false,
            status_transfer_id: TransferId::FIRST,
            degrees_transfer_id: TransferId::FIRST,
            temperature_transfer_id: TransferId::FIRST,
            thermometer: Thermometer::new(),
            pulse: None,
        }
    }

    /// Starts the node: says why on the serial monitor, and in the status that is due at once.
    pub fn start(&mut self, cause: ResetCause, monitor: &mut Monitor) {
        self.conditions = Conditions::after(cause);
        self.status_due = true;
        let banner = monitor.tell(Line::Banner);
        banner.source = self.id.get();
        banner.code = Line::PowerOn as u8 + cause as u8;
    }

    /// The width of the servo pulse; `None` before the first command.
    pub fn pulse(&self) -> Option<Ticks> {
        self.pulse
    }

    /// Takes a reading of the temperature sensor.
    pub fn read_temperature(&mut self, reading: u16) {
        self.thermometer.add(reading);
    }

    /// To be called at every tick of the millisecond clock.
    #[inline(never)]
    pub fn tick(&mut self, now_ms: u16, monitor: &mut Monitor) {
        self.autopilot.tick(now_ms);
        let grace_ms = if self.autopilot.is_present() { AUTOPILOT_GRACE_MS } else { 0 };
        if now_ms.wrapping_sub(self.occasion_ms) >= node_status::MAX_BROADCASTING_PERIOD_MS + grace_ms {
            self.occasion_ms = now_ms;
            self.status_due = true;
        }
        if now_ms.wrapping_sub(self.second_ms) >= 1000 {
            self.second_ms = self.second_ms.wrapping_add(1000);
            self.second(monitor);
        }
    }

    fn second(&mut self, monitor: &mut Monitor) {
        self.uptime_sec = self.uptime_sec.wrapping_add(1);
        if self.hold_s > 0 {
            self.hold_s -= 1;
            if self.hold_s == 0 {
                self.conditions.pass();
            }
        }
        if let Some(reading) = self.thermometer.latest() {
            self.temperature_due = true;
            monitor.tell(Line::Temperature).a = reading.tenths_celsius();
        }
    }

    /// Acts on what the controller received.
    #[inline(never)]
    pub fn receive(&mut self, received: Received<'_>, now_ms: u16, monitor: &mut Monitor) {
        // Every frame gives one line.
        let event = monitor.tell(Line::RefusedKind);
        let result = match received {
            Received::Frame(id, data) => self.frame(id, data, now_ms, event),
            Received::Standard | Received::Remote => Err(Line::RefusedKind),
        };
        event.line = result.unwrap_or_else(|why| {
            self.counts.refused = self.counts.refused.saturating_add(1);
            why
        });
    }

    /// Acts on a frame and notes what it says in `event`. The line that tells of it, or why it is refused.
    fn frame(&mut self, id: u32, data: &[u8], now_ms: u16, event: &mut Event) -> Result<Line, Line> {
        // The filters let no service through.
        let MessageId { data_type, source } = MessageId::parse(id).ok_or(Line::RefusedKind)?;
        event.a = data_type;
        event.source = source.map_or(0, NodeId::get);
        let source = source.filter(|&source| source != self.id).ok_or(Line::RefusedSource)?;
        let SingleFrame { transfer_id, payload } = SingleFrame::parse(data).ok_or(Line::RefusedTransfer)?;
        event.transfer = transfer_id.get();
        match data_type {
            node_status::DATA_TYPE_ID => {
                let heard = node_status::Heard::parse(payload)?;
                self.status_of(source, now_ms);
                event.code = heard.health << 4 | heard.mode;
                [event.a, event.b] = [heard.uptime_sec as u16, (heard.uptime_sec >> 16) as u16];
                Ok(Line::Status)
            }
            array_command::DATA_TYPE_ID => {
                event.code = ACTUATOR_ID;
                let mut commands = array_command::commands(payload)?;
                let Some(command) = commands.find(|command| command.actuator_id == ACTUATOR_ID) else {
                    return Ok(Line::CommandElsewhere);
                };
                let value = command.value()?;
                let pulse = servo::pulse(value).ok_or(Line::RefusedValue)?;
                event.b = self.follow(pulse, source, now_ms);
                Ok(match value {
                    Value::Unitless(value) => {
                        event.a = thousandths(value, 14);
                        Line::CommandUnitless
                    }
                    Value::Position(value) => {
                        event.a = thousandths(value, 12);
                        Line::CommandPosition
                    }
                    Value::Pwm(half_us) => {
                        event.a = (half_us >> 1).min(i32::from(u16::MAX)) as u16;
                        Line::CommandPwm
                    }
                })
            }
            thesis::SERVO_COMMAND_ID => {
                let position = thesis::servo_command(payload)?;
                self.thesis = true;
                event.code = position;
                event.b = self.follow(servo::pulse_of_byte(position), source, now_ms);
                Ok(Line::CommandThesis)
            }
            _ => Err(Line::RefusedKind),
        }
    }

    /// Follows a command; gives the pulse in ticks, for the monitor.
    fn follow(&mut self, pulse: Ticks, source: NodeId, now_ms: u16) -> u16 {
        self.pulse = Some(pulse);
        self.counts.followed = self.counts.followed.saturating_add(1);
        self.autopilot.commanded_by(source, now_ms);
        pulse.0
    }

    fn status_of(&mut self, source: NodeId, now_ms: u16) {
        if !self.autopilot.is_status_of(source, now_ms) {
            return;
        }
        self.occasion_ms = now_ms;
        if self.is_status_spaced(now_ms) {
            self.status_due = true;
        }
        if self.thesis {
            self.autopilot_statuses += 1;
            if self.autopilot_statuses == STATUSES_PER_DEGREES {
                self.autopilot_statuses = 0;
                self.degrees_due = true;
            }
        }
    }

    /// Acts on what the controller has to tell of itself.
    #[inline(never)]
    pub fn notice(&mut self, notice: Notice, monitor: &mut Monitor) {
        let (line, code) = match notice {
            Notice::Running => (Line::Running, 0),
            Notice::NotAnswering(canstat) => (Line::NotAnswering, canstat),
            Notice::NotKeeping(address) => (Line::NotKeeping, address),
            Notice::NotStarting(canstat) => (Line::NotStarting, canstat),
            Notice::Lost(canstat) => (Line::ControllerLost, canstat),
            Notice::GaveUpSending => {
                self.counts.given_up = self.counts.given_up.saturating_add(1);
                self.happened(Conditions::GAVE_UP_SENDING);
                (Line::GaveUp, 0)
            }
            Notice::Flags(flags) => return self.flags(flags, monitor),
        };
        if !matches!(notice, Notice::Running | Notice::GaveUpSending) {
            self.happened(Conditions::CONTROLLER_LOST);
        }
        let event = monitor.tell(line);
        event.code = code;
        event.a = self.counts.given_up;
    }

    fn flags(&mut self, flags: ErrorFlags, monitor: &mut Monitor) {
        if flags.frames_lost() {
            self.counts.overruns = self.counts.overruns.saturating_add(1);
            self.happened(Conditions::FRAMES_LOST);
            monitor.tell(Line::FramesLost).a = self.counts.overruns;
        }
        if flags.bus_off() {
            self.happened(Conditions::BUS_OFF);
            monitor.tell(Line::BusOff);
        }
        if flags.error_passive() != self.conditions.has(Conditions::ERROR_PASSIVE) {
            self.conditions.set(Conditions::ERROR_PASSIVE, flags.error_passive());
            monitor.tell(if flags.error_passive() { Line::ErrorPassive } else { Line::ErrorActive });
        }
    }

    fn happened(&mut self, condition: Conditions) {
        self.conditions.set(condition, true);
        self.hold_s = HOLD_S;
    }

    /// Tells its counters on the serial monitor.
    #[inline(never)]
    pub fn report(&self, monitor: &mut Monitor) {
        let counts_in = monitor.tell(Line::CountsIn);
        (counts_in.a, counts_in.b) = (self.counts.followed, self.counts.refused);
        let counts_out = monitor.tell(Line::CountsOut);
        (counts_out.a, counts_out.b) = (self.counts.overruns, self.counts.given_up);
    }

    /// Whether [`outgoing`](Self::outgoing) is worth calling.
    #[inline(always)]
    pub fn has_outgoing(&self, now_ms: u16) -> bool {
        self.can_send_status(now_ms) || self.degrees_due || self.temperature_due
    }

    /// The next message to hand to the controller, and its frame.
    #[inline(never)]
    pub fn outgoing(&self, now_ms: u16) -> Option<(Message, Frame)> {
        let message = if self.can_send_status(now_ms) {
            Message::NodeStatus
        } else if self.degrees_due {
            Message::DegreesCelsius
        } else if self.temperature_due {
            Message::Temperature
        } else {
            return None;
        };
        let reading = self.thermometer.latest();
        let (data_type, transfer_id, payload) = match message {
            Message::NodeStatus => {
                let status = NodeStatus {
                    uptime_sec: self.uptime_sec,
                    health: self.conditions.health(),
                    mode: if reading.is_some() { Mode::Operational } else { Mode::Initialization },
                    vendor_specific_status_code: self.conditions.code(),
                };
                (node_status::DATA_TYPE_ID, self.status_transfer_id, Payload::new(status.emit()))
            }
            Message::DegreesCelsius => {
                (thesis::DEGREES_CELSIUS_ID, self.degrees_transfer_id, Payload::new([reading?.degrees()]))
            }
            Message::Temperature => {
                let temperature =
                    Temperature { device_id: TEMPERATURE_DEVICE_ID, kelvin_64ths: reading?.kelvin_64ths() };
                (temperature::DATA_TYPE_ID, self.temperature_transfer_id, Payload::new(temperature.emit()))
            }
        };
        let id = MessageId::build(Priority::LOW, data_type, self.id);
        Some((message, single_frame(id, transfer_id, payload)))
    }

    fn can_send_status(&self, now_ms: u16) -> bool {
        self.status_due && !self.status_in_controller && self.is_status_spaced(now_ms)
    }

    fn is_status_spaced(&self, now_ms: u16) -> bool {
        self.status_sent_ms.is_none_or(|sent_ms| now_ms.wrapping_sub(sent_ms) >= MIN_STATUS_PERIOD_MS)
    }

    /// The controller has taken the frame of this message.
    pub fn handed_over(&mut self, message: Message, now_ms: u16) {
        match message {
            Message::NodeStatus => {
                self.status_due = false;
                self.status_in_controller = true;
                self.status_sent_ms = Some(now_ms);
                self.status_transfer_id.take();
            }
            Message::DegreesCelsius => {
                self.degrees_due = false;
                self.degrees_transfer_id.take();
            }
            Message::Temperature => {
                self.temperature_due = false;
                self.temperature_transfer_id.take();
            }
        }
    }

    /// The controller has nothing more to send: a status that waited in it for the bus has left only now.
    pub fn controller_is_empty(&mut self, now_ms: u16) {
        if self.status_in_controller {
            self.status_in_controller = false;
            self.status_sent_ms = Some(now_ms);
        }
    }
}

/// A fixed-point number in thousandths, limited to what the monitor can show. The product stays below 2^31.
fn thousandths(value: i32, fraction_bits: u8) -> u16 {
    (value.clamp(-(1 << 17), 1 << 17).wrapping_mul(1000) >> fraction_bits).clamp(-32_767, 32_767) as u16
}

impl From<Malformed> for Line {
    fn from(_: Malformed) -> Self {
        Self::RefusedLength
    }
}

impl From<Unusable> for Line {
    fn from(unusable: Unusable) -> Self {
        match unusable {
            Unusable::Type => Self::RefusedType,
            Unusable::NotFinite => Self::RefusedValue,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Zero is what a dead chip reads as, and the address of the first filter.
    #[test]
    fn a_controller_in_trouble_shows_in_the_status_whatever_was_read_from_it() {
        for seen in [0x00, 0x80, 0xFF] {
            for notice in
                [Notice::NotAnswering(seen), Notice::NotKeeping(seen), Notice::NotStarting(seen), Notice::Lost(seen)]
            {
                let mut node = Node::new(NodeId::new(120).unwrap());
                node.notice(notice, &mut Monitor::new());
                assert!(node.conditions.has(Conditions::CONTROLLER_LOST), "{notice:?}");
            }
        }
        let mut node = Node::new(NodeId::new(120).unwrap());
        node.notice(Notice::Running, &mut Monitor::new());
        node.notice(Notice::GaveUpSending, &mut Monitor::new());
        assert!(!node.conditions.has(Conditions::CONTROLLER_LOST));
    }
}
