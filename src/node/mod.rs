//! What the node does: follows commands, measures its temperature, says how it is, and lets itself be managed.
//!
//! [`Node`] takes received transfers and the clock, and gives out frames to send and the pulse for the servo. It has no
//! hardware and never waits.

pub mod allocation;
pub mod autopilot;
pub mod button;
pub mod condition;
pub mod information;
pub mod outgoing;
pub mod parameters;
mod send;
mod serve;
pub mod servo;
pub mod store;
pub mod thermometer;

use crate::can::Frame;
use crate::can::mcp2515::{ErrorFlags, Event as CanEvent, Notice};
use crate::dronecan::acceptance::{self, NodeAcceptance};
use crate::dronecan::draft::DRAFT;
use crate::dronecan::kind::Kind;
use crate::dronecan::receive::{Receiver, Refusal, Transfer};
use crate::dronecan::wire::{END_OF_TRANSFER, SERVICE_NOT_MESSAGE, START_OF_TRANSFER, TOGGLE, TRANSFER_ID};
use crate::dronecan::{NodeId, float16};
use crate::monitor::{Event, Line, Monitor};
use crate::progmem::Progmem;
use allocation::Allocation;
use autopilot::Autopilot;
use button::Button;
use condition::{Conditions, HOLD_S, ResetCause};
use outgoing::Outgoing;
use parameters::{Parameter, Parameters};
use send::Due;
use serve::Replies;
use servo::{CommandType, Output, Ticks, Travel};
use store::{Eeprom, Store};
use thermometer::{Thermometer, celsius, corrected};

/// No node may be silent for longer, in milliseconds (DSDL 341.NodeStatus.uavcan, MAX_BROADCASTING_PERIOD_MS).
const MAX_BROADCASTING_PERIOD_MS: u16 = 1000;

/// No two statuses closer than this, in milliseconds, however often the autopilot sends its own.
const MIN_STATUS_PERIOD_MS: u16 = 500;

/// How much longer than a second to wait for the autopilot's status while there is an autopilot, in milliseconds. One that
/// sends every 1000 ms sends every 1001 at times, and would always come a moment after the node had gone ahead without it.
const AUTOPILOT_GRACE_MS: u16 = 25;

/// The thesis's temperature is sent once for so many statuses of the autopilot.
const STATUSES_PER_DEGREES: u8 = 3;

/// ArmingStatus comes twice a second from ArduPilot; in the course of so many seconds without one the vehicle counts as
/// disarmed.
const ARMING_TIMEOUT_S: u8 = 4;

/// A chore: the sensor has been read often enough for a temperature.
const CHORE_MEASURE: u8 = 1 << 0;

/// A chore that follows that one.
const CHORE_CORRECT: u8 = 1 << 3;

/// A chore: a second is over.
const CHORE_SECOND: u8 = 1 << 1;

/// A chore: parameters have been set.
const CHORE_PARAMETERS: u8 = 1 << 2;

/// A chore that follows that one: how many of the two gains are to be worked out.
const CHORE_GAIN: u8 = 1 << 4;
const CHORE_GAINS: u8 = 2 * CHORE_GAIN;

/// Error flag of a Temperature: below TEMP_MIN. The other, above TEMP_MAX, is 1.
const OVERCOOLING: u8 = 2;

/// From the last frame of the answer to a restart: the controller gets it out, and the servo reaches its failsafe.
const RESTART_MS: u16 = 100;

/// For so long after an autopilot has spoken it the node is sure of the dialect, in milliseconds.
const SURE_MS: u16 = 1500;

/// What a node speaks, by the numbers of the parameter DIALECT.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Dialect(u8);

impl Dialect {
    /// Whichever is heard; v0 until then.
    const ANY: Self = Self(0);
    /// DroneCAN.
    const V0: Self = Self(1);
    /// The draft of 2014.
    const DRAFT: Self = Self(2);

    /// The one that this is not.
    fn other(self) -> Self {
        Self(self.0 ^ Self::V0.0 ^ Self::DRAFT.0)
    }
}

/// The type of ArrayCommand, as it is in an identifier.
const COMMAND: [u8; 2] = Kind::ARRAY_COMMAND.data_type().to_be_bytes();

/// That of the thesis's command.
const THESIS: [u8; 2] = Kind::SERVO_COMMAND.data_type().to_be_bytes();

/// Whether a frame has the lower byte of a command's type.
#[inline(always)]
pub fn is_like_a_command(frame: &Frame) -> bool {
    frame.id[2] == COMMAND[1] || frame.id[2] == THESIS[1]
}

/// Whether a frame is of a request, or of an answer to one.
#[inline(always)]
pub fn is_of_service(frame: &Frame) -> bool {
    frame.id[3] & SERVICE_NOT_MESSAGE != 0
}

/// Whether a frame is a whole request, to whomever: the filters let through those to this node.
#[inline(always)]
fn is_request(frame: &Frame) -> bool {
    is_of_service(frame) && frame.data().last().is_some_and(|&tail| tail >= START_OF_TRANSFER | END_OF_TRANSFER)
}

/// Whether it has the length, too, of one that [can be followed at once](Node::follow_at_once).
#[inline(always)]
pub fn may_be_followed_at_once(frame: &Frame) -> bool {
    frame.id[2] == COMMAND[1] && frame.len == 5 || frame.id[2] == THESIS[1] && frame.len == 2
}

#[inline(never)]
fn count(counter: &mut u16) {
    *counter = counter.wrapping_add(1);
}

/// What happened to the node since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Counts {
    followed: u16,
    refused: u16,
    overruns: u16,
    given_up: u16,
    /// Transfers that came whole, that went whole, and that broke.
    received: u16,
    sent: u16,
    broken: u16,
}

/// The node.
///
/// Its fields are in this order in memory, too, and those of the driver end with what is used most: the 64 bytes from there on that
/// are used most cost two bytes of program less each time (`scripts/link-small`).
#[repr(C)]
pub struct Node {
    due: Due,
    /// What has been left over.
    chores: u8,
    conditions: Conditions,
    /// 1 to 127; 0 while it has none.
    id: u8,
    store: Store,
    travel: Travel,
    pulse: Ticks,
    /// Seconds until the passing conditions pass.
    hold_s: u8,
    autopilot: Autopilot,
    /// A command has been followed, and none has been missing since.
    is_following: bool,
    /// Seconds that the vehicle still counts as armed.
    armed_s: u8,
    /// See [`takes_filters`](Self::takes_filters).
    has_filters_to_give: bool,
    /// The controller is to have other filters right after a command that was followed, or after the autopilot's status where there are none:
    /// they are five milliseconds in which it hears nothing.
    wants_filters: bool,
    /// What the node speaks; nothing yet is v0.
    dialect: Dialect,
    /// Sure of that, it hears nothing else.
    is_sure: bool,
    /// What the last frame was in.
    spoken: Dialect,
    /// What the controller is to let through, a row of `acceptance`.
    row: u8,
    /// Last status: when it left, or until it has left, when it was handed to the controller.
    status_sent_ms: u16,
    status_in_controller: bool,
    outgoing: Outgoing,

    // From here on what is used less.
    allocation: Allocation,
    /// While it is not sure, what it heard last. Twice the same makes sure.
    heard: Dialect,
    replies: Replies,
    /// What can be set.
    pub parameters: Parameters,
    unique_id: [u8; 16],
    counts: Counts,
    uptime_sec: u32,
    /// Start of the running second.
    second_ms: u16,
    /// Statuses of the autopilot since the thesis's temperature was last sent.
    autopilot_statuses: u8,
    /// Somebody has used the thesis's own command, so its own temperature is understood.
    thesis: bool,
    /// Thousandths of the next message of each rate.
    pace: [u16; 3],
    /// Last occasion for a status: the autopilot's, or none of it for too long.
    occasion_ms: u16,
    transfer_ids: [u8; send::MESSAGES],
    sending: u8,
    /// A request to restart has been answered, and when to do it.
    is_to_restart: bool,
    restart_ms: u16,
    thermometer: Thermometer,
    button: Button,
    light: u8,
    /// The last temperature: in 64ths of a kelvin, whole degrees, and its error flags.
    kelvin_64ths: u16,
    celsius: i16,
    temperature_flags: u8,
    /// The position that the next actuator.Status tells (see [`servo::radians`]), once it is worked out.
    position: u16,
    has_position: bool,
    followed_ms: u16,
    /// There have been commands since that were not followed.
    hears_commands: bool,
    /// What the last command said, in the fixed point of its type.
    value: i16,
}

impl Node {
    /// A node that has yet to start.
    pub const fn new() -> Self {
        Self {
            parameters: Parameters::new(),
            id: 0,
            has_filters_to_give: false,
            wants_filters: false,
            dialect: Dialect::ANY,
            is_sure: false,
            heard: Dialect::ANY,
            spoken: Dialect::ANY,
            row: acceptance::EITHER,
            unique_id: [0; 16],
            allocation: Allocation::new(),
            store: Store::new(),
            conditions: Conditions::NONE,
            hold_s: 0,
            counts: Counts { followed: 0, refused: 0, overruns: 0, given_up: 0, received: 0, sent: 0, broken: 0 },
            uptime_sec: 0,
            second_ms: 0,
            chores: 0,
            autopilot: Autopilot::NONE,
            autopilot_statuses: 0,
            thesis: false,
            due: Due::NONE,
            pace: [0; 3],
            occasion_ms: 0,
            status_sent_ms: 0,
            status_in_controller: false,
            transfer_ids: [0; send::MESSAGES],
            outgoing: Outgoing::new(),
            sending: 0,
            replies: Replies::new(),
            is_to_restart: false,
            restart_ms: 0,
            thermometer: Thermometer::new(),
            button: Button::new(),
            light: 0,
            kelvin_64ths: 0,
            celsius: 0,
            temperature_flags: 0,
            travel: Travel::NONE,
            pulse: 0,
            position: 0,
            has_position: false,
            is_following: false,
            followed_ms: 0,
            hears_commands: false,
            value: 0,
            armed_s: 0,
        }
    }

    /// Starts the node with what the EEPROM has: says why on the serial monitor, and in the status that is due at once.
    pub fn start(
        &mut self,
        cause: ResetCause,
        eeprom: &mut impl Eeprom,
        noise: impl FnMut() -> u8,
        flash: impl Progmem,
        monitor: &mut Monitor,
    ) {
        self.store.identify(&mut self.unique_id, eeprom, noise);
        self.conditions = Conditions::after(cause);
        let is_lost = self.store.load(&mut self.parameters, eeprom, flash);
        self.condition(Conditions::PARAMETERS_LOST, is_lost, [Line::ParametersLost; 2], monitor);
        self.chores = CHORE_PARAMETERS;
        self.id = self.parameters.get(Parameter::CanNode) as u8;
        let banner = monitor.tell(Line::Banner);
        banner.set_source(self.id);
        banner.set_code(Line::PowerOn.plus(cause.0).number());
        // The first status need not wait.
        self.status_sent_ms = MIN_STATUS_PERIOD_MS.wrapping_neg();
        self.due.set(Due::NODE_STATUS);
        self.allocation.start(&self.unique_id, 0);
    }

    /// What the controller is to let through.
    pub fn acceptance<P: Progmem>(&self, flash: P) -> NodeAcceptance<P> {
        NodeAcceptance { node: NodeId::new(self.id), row: self.row, flash }
    }

    /// Takes over DIALECT, and what is known of the autopilot.
    #[inline(never)]
    fn take_dialect(&mut self) {
        let dialect = Dialect(self.parameters.get(Parameter::Dialect) as u8);
        if dialect != Dialect::ANY {
            self.dialect = dialect;
        }
        if dialect == Dialect::V0 {
            self.is_sure = true;
        }
        if self.is_sure && self.dialect == Dialect::DRAFT {
            self.take_row(acceptance::DRAFT);
        } else if !self.is_sure || self.row == acceptance::DRAFT {
            // Also where the draft is asked for: in v0 that can be taken back. To be sure of v0 does not ask for other filters by
            // itself, because it takes the controller off the bus: see `refuse`.
            self.take_row(acceptance::EITHER);
        }
    }

    /// Other filters, if they are others.
    #[inline(never)]
    fn take_row(&mut self, row: u8) {
        if self.row != row {
            self.row = row;
            self.has_filters_to_give = true;
        }
    }

    /// Whether what was said is not in the dialect that DIALECT asks for.
    #[inline(always)]
    fn is_foreign(&self) -> bool {
        let wanted = Dialect(self.parameters.get(Parameter::Dialect) as u8);
        wanted != Dialect::ANY && wanted != self.spoken
    }

    /// An autopilot has spoken, while the node is not sure what.
    #[inline(never)]
    fn hear(&mut self, now_ms: u16) {
        let dialect = self.spoken;
        if self.heard != dialect {
            self.heard = dialect;
        } else {
            if (self.dialect.0 ^ dialect.0) & Dialect::DRAFT.0 != 0 {
                self.autopilot.replace(now_ms);
            }
            self.dialect = dialect;
            self.is_sure = true;
            self.take_dialect();
        }
    }

    /// The node's ID; 0 while it has none.
    pub fn id(&self) -> u8 {
        self.id
    }

    /// Whether the controller is to get its filters: they do not know the node's ID yet; or they let through what is for others; or no
    /// command comes any more, and nobody can see whether the filters are why.
    pub fn takes_filters(&mut self) -> bool {
        self.wants_filters &= !self.has_filters_to_give;
        core::mem::take(&mut self.has_filters_to_give)
    }

    /// The width of the servo pulse; 0 for none.
    pub fn pulse(&self) -> Ticks {
        self.pulse
    }

    /// The brightness of the light.
    pub fn light(&self) -> u8 {
        self.light
    }

    /// Whether it is time to restart the program.
    pub fn is_to_restart(&self, now_ms: u16) -> bool {
        self.is_to_restart && now_ms.wrapping_sub(self.restart_ms) < 1 << 15
    }

    /// Takes a reading of the temperature sensor.
    pub fn read_temperature(&mut self, reading: u16) {
        if self.thermometer.add(reading) {
            self.chores |= CHORE_MEASURE;
        }
    }

    /// Whether ticks or requests have left something over.
    #[inline(always)]
    pub fn has_chores(&self) -> bool {
        self.chores != 0
    }

    /// Does one of the things that have been left over, so that none takes too long.
    #[inline(never)]
    pub fn do_chore(&mut self, monitor: &mut Monitor) {
        if self.chores & CHORE_PARAMETERS != 0 {
            self.chores &= !CHORE_PARAMETERS;
            self.travel.update(&self.parameters);
            self.take_dialect();
            self.chores |= CHORE_GAINS;
        } else if self.chores >= CHORE_GAIN {
            // One, then the other.
            self.chores = self.chores.wrapping_sub(CHORE_GAIN);
            self.travel.work_out(self.chores & CHORE_GAIN != 0);
        } else if self.chores & CHORE_MEASURE != 0 {
            self.chores = self.chores & !CHORE_MEASURE | CHORE_CORRECT;
            self.kelvin_64ths = self.thermometer.uncorrected(&self.parameters);
        } else if self.chores & CHORE_CORRECT != 0 {
            // Before any message: chores come before those.
            self.chores &= !CHORE_CORRECT;
            self.correct();
        } else {
            self.chores = 0;
            self.second(monitor);
        }
    }

    /// To be called at every tick of the millisecond clock, or after `passed_ms` of them.
    #[inline(never)]
    pub fn tick(
        &mut self,
        passed_ms: u8,
        is_pressed: bool,
        now_ms: u16,
        eeprom: &mut impl Eeprom,
        monitor: &mut Monitor,
    ) {
        self.store.step(&mut self.parameters, eeprom);
        if self.autopilot.tick(now_ms) >= SURE_MS && self.is_sure {
            self.is_sure = false;
            // Of the other dialect one frame is enough now, of noise it would take two.
            self.heard = self.dialect.other();
            self.take_dialect();
        }
        let grace_ms = if self.autopilot.is_present() { AUTOPILOT_GRACE_MS } else { 0 };
        if now_ms.wrapping_sub(self.occasion_ms) >= MAX_BROADCASTING_PERIOD_MS.wrapping_add(grace_ms) {
            self.occasion_ms = now_ms;
            self.due.set(Due::NODE_STATUS);
        }
        self.pace(Due::ACTUATOR_STATUS, 0, passed_ms, self.parameters.get(Parameter::TelemRate) as u8);
        self.pace(Due::TEMPERATURE, 1, passed_ms, self.parameters.get(Parameter::TempRate) as u8);
        self.pace(Due::CAN_STATS, 2, passed_ms, self.parameters.get(Parameter::StatsRate) as u8);
        if self.id == 0 && self.allocation.is_due(now_ms) {
            self.due.set(Due::ALLOCATION);
        }
        if self.button.tick(is_pressed, passed_ms) {
            monitor.tell(Line::Button).a = self.button.count();
            self.due.set(Due::BUTTON);
        }
        let timeout_ms = self.parameters.get(Parameter::Out1Timeout);
        if self.is_following && timeout_ms != 0 && now_ms.wrapping_sub(self.followed_ms) >= timeout_ms {
            self.is_following = false;
            self.has_filters_to_give = !self.hears_commands;
            self.fail_safe();
            self.condition(Conditions::FAILSAFE, true, [Line::Failsafe, Line::FailsafeEnd], monitor);
        }
        let is_disarmed = self.is_disarmed();
        if is_disarmed && self.is_following {
            self.is_following = false;
            self.fail_safe();
        }
        self.condition(Conditions::DISARMED, is_disarmed, [Line::Disarmed, Line::DisarmedEnd], monitor);
        if now_ms.wrapping_sub(self.second_ms) >= 1000 {
            self.second_ms = self.second_ms.wrapping_add(1000);
            self.chores |= CHORE_SECOND;
        }
    }

    /// Milliseconds of a message that is sent so many times a second.
    #[inline(never)]
    fn pace(&mut self, message: u8, n: u8, passed_ms: u8, rate: u8) {
        let Some(pace) = self.pace.get_mut(usize::from(n)) else { return };
        *pace = pace.wrapping_add(u16::from(rate).wrapping_mul(u16::from(passed_ms)));
        if *pace >= 1000 {
            *pace = pace.wrapping_sub(1000);
            self.due.set(message);
        }
    }

    /// Sets or clears a condition and tells that it begins or ends; nothing where nothing changes.
    #[inline(never)]
    fn condition(&mut self, condition: Conditions, on: bool, [begins, ends]: [Line; 2], monitor: &mut Monitor) {
        if self.conditions.has(condition) != on {
            self.conditions.set(condition, on);
            monitor.tell(if on { begins } else { ends });
        }
    }

    fn is_disarmed(&self) -> bool {
        self.parameters.is_on(Parameter::ArmReq) && self.armed_s == 0
    }

    /// The pulse for when nobody commands.
    fn fail_safe(&mut self) {
        self.pulse = match self.parameters.get(Parameter::Out1Fs) as u8 {
            0 => return,
            1 => self.travel.trim,
            2 => self.travel.limit(self.parameters.get(Parameter::Out1FsPwm) << 1),
            _ => 0,
        };
    }

    /// Makes a temperature of what the last sum of readings has measured.
    #[inline(never)]
    fn correct(&mut self) {
        self.kelvin_64ths = corrected(self.kelvin_64ths, &self.parameters);
        self.celsius = celsius(self.kelvin_64ths);
        self.temperature_flags = if self.celsius < self.parameters.get(Parameter::TempMin) as i16 {
            OVERCOOLING
        } else {
            u8::from(self.celsius > self.parameters.get(Parameter::TempMax) as i16)
        };
    }

    fn second(&mut self, monitor: &mut Monitor) {
        self.uptime_sec = self.uptime_sec.wrapping_add(1);
        let is_draft = self.dialect == Dialect::DRAFT;
        self.condition(Conditions::DRAFT, is_draft, [Line::Draft, Line::DraftEnd], monitor);
        self.armed_s = self.armed_s.saturating_sub(1);
        if self.hold_s > 0 {
            self.hold_s = self.hold_s.wrapping_sub(1);
            if self.hold_s == 0 {
                self.conditions.pass();
            }
        }
        if !self.thermometer.has_measured() {
            return;
        }
        // A whole degree begins five tenths below.
        let fraction = self.kelvin_64ths.wrapping_sub(thermometer::DEGREE_ZERO) & 63;
        let tenths =
            (self.celsius as u16).wrapping_mul(10).wrapping_add(fraction.wrapping_mul(10) >> 6).wrapping_sub(5);
        monitor.tell(Line::Temperature).a = tenths;
        let is_out = self.temperature_flags != 0;
        self.condition(Conditions::TEMPERATURE, is_out, [Line::OutOfRange, Line::OutOfRangeEnd], monitor);
        let is_faulty = self.thermometer.is_sensor_faulty();
        self.condition(Conditions::SENSOR, is_faulty, [Line::SensorFault, Line::SensorFaultEnd], monitor);
    }

    /// Whether a frame may be one of the draft.
    #[inline(always)]
    pub fn hears_draft(&self) -> bool {
        !self.is_sure || self.dialect == Dialect::DRAFT
    }

    /// Takes a frame into its transfer. If that is whole then, [`act`](Self::act) must come before the next frame.
    #[inline(never)]
    pub fn receive(
        &mut self,
        frame: &Frame,
        receiver: &mut Receiver,
        now_ms: u16,
        flash: impl Progmem,
        monitor: &mut Monitor,
        the_quick_part_is_done: impl FnOnce(),
    ) {
        let mut refusal = Refusal::Busy;
        if !self.replies.is_full() || !is_request(frame) {
            let parameters = &self.parameters;
            let entry = |list| {
                let id = if list == Kind::LIGHTS_COMMAND { Parameter::LightId } else { Parameter::Out1Id };
                parameters.get(id) as u8
            };
            receiver.accept(frame, self.id, entry, now_ms, flash);
            refusal = receiver.refusal;
        }
        if refusal != Refusal::None {
            the_quick_part_is_done();
            self.refuse(refusal, frame, monitor);
        }
    }

    #[inline(never)]
    fn refuse(&mut self, refusal: Refusal, frame: &Frame, monitor: &mut Monitor) {
        let [first, high, low, source] = frame.id;
        let source = source & 0x7F;
        // One that has a sender and is refused for it has this node's ID.
        if refusal >= Refusal::Broken || refusal == Refusal::Source && source != 0 {
            count(&mut self.counts.broken);
            self.happened(Conditions::TRANSFER_ERRORS);
        }
        // Filters for v0 alone would not have let it through; a standard frame none.
        if refusal == Refusal::Kind && self.is_sure && self.row == acceptance::EITHER && first < Frame::FOREIGN {
            self.row = acceptance::V0;
            self.wants_filters = true;
        }
        count(&mut self.counts.refused);
        let event = monitor.tell(Line::RefusedKind.plus((refusal as u8).wrapping_sub(Refusal::Kind as u8)));
        event.a = u16::from_be_bytes([high, low]);
        event.set_source(source);
    }

    /// Acts on the transfer that has come whole, or does a step towards that: to be called until the receiver has none.
    /// `the_quick_part_is_done` is called when a command is in the servo's register, or it is none.
    #[inline(never)]
    pub fn act(
        &mut self,
        receiver: &mut Receiver,
        now_ms: u16,
        flash: impl Progmem,
        monitor: &mut Monitor,
        servo: &mut impl Output,
        the_quick_part_is_done: impl FnOnce(),
    ) {
        let Some(transfer) = receiver.transfer() else { return };
        self.spoken = if transfer.priority & DRAFT != 0 { Dialect::DRAFT } else { Dialect::V0 };
        if let Some(line) = self.heed_command(transfer, now_ms, servo) {
            the_quick_part_is_done();
            let (source, transfer_id) = (transfer.source, transfer.transfer_id());
            let is_thesis = transfer.kind == Kind::SERVO_COMMAND;
            let code = if is_thesis { transfer.bytes[0] } else { self.parameters.get(Parameter::Out1Id) as u8 };
            receiver.clear();
            return self.tell_command(line, source, transfer_id, code, now_ms, monitor);
        }
        the_quick_part_is_done();
        if transfer.kind == Kind::GET_SET && serve::look_up(transfer, flash) {
            return receiver.hold();
        }
        count(&mut self.counts.received);
        // Every transfer gives one line.
        let event = monitor.tell(Line::RefusedLength);
        event.set_source(transfer.source);
        event.set_transfer(transfer.transfer_id());
        let line = if transfer.kind.is_request() {
            self.serve(transfer, event, flash)
        } else if !self.is_sure && self.is_foreign() {
            Line::RefusedType
        } else {
            self.heed(transfer, event, now_ms, flash)
        };
        event.line = line;
        receiver.clear();
        self.conclude(line, now_ms, monitor);
    }

    /// Acts on a command, if it is one and well-formed: the pulse comes before anything is noted of it.
    #[inline(always)]
    fn heed_command(&mut self, transfer: &Transfer, now_ms: u16, servo: &mut impl Output) -> Option<Line> {
        let source = NodeId::new(transfer.source)?;
        let is_thesis = match transfer.kind {
            // Whole entries only.
            Kind::ARRAY_COMMAND | Kind::DRAFT_COMMAND if transfer.len == 0 => false,
            Kind::SERVO_COMMAND if transfer.len == 1 => true,
            _ => return None,
        };
        if !self.is_sure && self.is_foreign() {
            return Some(Line::RefusedType);
        }
        let [b0, b1, b2, b3, ..] = transfer.bytes;
        if is_thesis {
            return Some(self.obey_thesis(b0, source, now_ms, servo));
        }
        self.hears_commands = true;
        if !transfer.has_entry {
            return Some(Line::CommandElsewhere);
        }
        let mut command = b1;
        let mut value = [b2, b3];
        if transfer.kind == Kind::DRAFT_COMMAND {
            (command, value) = (CommandType::Unitless as u8, [b1, b2]);
        }
        Some(self.obey(command, u16::from_le_bytes(value), source, now_ms, servo))
    }

    /// Tells what became of a command.
    #[inline(never)]
    fn tell_command(&mut self, line: Line, source: u8, transfer_id: u8, code: u8, now_ms: u16, monitor: &mut Monitor) {
        let event = monitor.tell(line);
        event.set_source(source);
        event.set_transfer(transfer_id);
        event.set_code(code);
        self.note(line, event);
        count(&mut self.counts.received);
        self.conclude(line, now_ms, monitor);
    }

    /// Acts on another message and notes what it says in `event`. The line that tells of it, or why it is refused.
    #[inline(always)]
    fn heed(&mut self, transfer: &Transfer, event: &mut Event, now_ms: u16, flash: impl Progmem) -> Line {
        let [b0, b1, b2, b3, mut b4, ..] = transfer.bytes;
        let Some(source) = NodeId::new(transfer.source) else {
            // Only Allocation comes from nobody.
            return self.hear_allocation(transfer, now_ms);
        };
        match transfer.kind {
            Kind::NODE_STATUS
                if transfer.len == 7 || self.spoken == Dialect::DRAFT && transfer.len >= 4 && transfer.len != 5 =>
            {
                self.status_of(source, now_ms);
                if self.spoken == Dialect::DRAFT {
                    // 0 is OK, 1 initialising, 2 a warning, 3 critical, 15 offline; where v0 has health and mode.
                    b4 = if b3 & 2 == 0 {
                        b3 << 3
                    } else if b3 & 1 == 0 {
                        1 << 6
                    } else {
                        3 << 6
                    };
                }
                event.set_code(Line::Health.plus(b4 >> 6).number());
                event.b = u16::from(Line::Mode.plus(b4 >> 3 & 7).number());
                event.a = if transfer.word(2) == 0 { transfer.word(0) } else { u16::MAX };
                Line::Status
            }
            Kind::LIGHTS_COMMAND if transfer.len == 0 => {
                if transfer.has_entry {
                    // Five bits of red, six of green, five of blue; the light has one colour, so the brightest counts.
                    let (high, low) = (b1, b2);
                    let red = high & 0xF8;
                    let green = high << 5 | (low & 0xE0) >> 3;
                    let blue = low << 3;
                    let brightest = red.max(green).max(blue);
                    // All bits set where the five or six are.
                    self.light = brightest | brightest >> 5;
                }
                event.set_code(self.light);
                Line::Light
            }
            Kind::ARMING_STATUS if transfer.len == 1 => {
                const FULLY_ARMED: u8 = 255;
                self.armed_s = if b0 == FULLY_ARMED { ARMING_TIMEOUT_S } else { 0 };
                event.set_code(b0);
                Line::Arming
            }
            Kind::ALLOCATION => {
                let line = self.hear_allocation(transfer, now_ms);
                event.set_code(self.id);
                line
            }
            _ => {
                event.a = transfer.kind.id(flash);
                Line::RefusedLength
            }
        }
    }

    fn hear_allocation(&mut self, transfer: &Transfer, now_ms: u16) -> Line {
        if self.id != 0 {
            return Line::AllocationElsewhere;
        }
        self.due.clear(Due::ALLOCATION);
        self.id = self.allocation.hear(transfer, &self.unique_id, now_ms);
        if self.id == 0 {
            return Line::AllocationElsewhere;
        }
        self.has_filters_to_give = true;
        Line::Allocated
    }

    /// Follows the command of an entry.
    #[inline(never)]
    fn obey(&mut self, command: u8, value: u16, source: NodeId, now_ms: u16, servo: &mut impl Output) -> Line {
        let Some(command) = CommandType::new(command) else { return Line::RefusedType };
        if !float16::is_finite(value) {
            return Line::RefusedValue;
        }
        let value = float16::to_fixed(value, command.fraction_bits());
        let pulse = self.travel.pulse(command, value);
        if pulse == 0 {
            return Line::RefusedValue;
        }
        // Their lines are in the order of 0, 1 and 4.
        let line = Line::CommandUnitless.plus((command as u8).wrapping_add(1) >> 1);
        self.value = value;
        self.follow(pulse, line, source, now_ms, servo)
    }

    /// Follows the thesis's command.
    #[inline(never)]
    fn obey_thesis(&mut self, position: u8, source: NodeId, now_ms: u16, servo: &mut impl Output) -> Line {
        self.thesis = true;
        let pulse = self.travel.pulse_of_byte(position);
        self.follow(pulse, Line::CommandThesis, source, now_ms, servo)
    }

    /// Notes what the last command said in its event, but for the line.
    #[inline(always)]
    fn note(&self, line: Line, event: &mut Event) {
        event.b = self.pulse;
        // Thousandths: x 1000 / 2^14, or / 2^12 of a position.
        let factor = match line {
            Line::CommandPwm => {
                event.a = (self.value >> 1) as u16;
                return;
            }
            Line::CommandUnitless => 4000,
            Line::CommandPosition => 16_000,
            _ => return,
        };
        event.a = (i32::from(self.value).wrapping_mul(factor) >> 16) as u16;
    }

    /// Follows a command for this actuator that is a single frame, without the detour over its transfer; whether it was one. Only when
    /// the node is sure of the dialect.
    #[inline(always)]
    pub fn follow_at_once(
        &mut self,
        frame: &Frame,
        now_ms: u16,
        monitor: &mut Monitor,
        servo: &mut impl Output,
    ) -> bool {
        const ONE_FRAME: u8 = START_OF_TRANSFER | END_OF_TRANSFER;
        let [first, high, low, source] = frame.id;
        // Most frames are not, which their lengths show.
        let is_thesis = low == THESIS[1];
        if frame.len != if is_thesis { 2 } else { 5 } {
            return false;
        }
        let [code, command, v0, v1, mut tail, ..] = frame.data;
        if is_thesis {
            tail = command;
            if high != THESIS[0] {
                return false;
            }
        } else if low != COMMAND[1] || code != self.parameters.get(Parameter::Out1Id) as u8 || high != COMMAND[0] {
            return false;
        }
        if tail & (ONE_FRAME | TOGGLE) != ONE_FRAME
            || (first ^ self.dialect.0 << 5) & (Frame::FOREIGN | DRAFT) != 0
            || source == self.id
            || !self.is_sure
        {
            return false;
        }
        // A service has the highest bit of the sender set.
        let Some(source) = NodeId::new(source) else { return false };
        // The pulse comes first.
        let line = if is_thesis {
            self.obey_thesis(code, source, now_ms, servo)
        } else {
            self.hears_commands = true;
            self.obey(command, u16::from_le_bytes([v0, v1]), source, now_ms, servo)
        };
        self.tell_command(line, source.get(), tail & TRANSFER_ID, code, now_ms, monitor);
        true
    }

    /// What is done about a transfer in the end, whatever it was.
    #[inline(never)]
    fn conclude(&mut self, line: Line, now_ms: u16, monitor: &mut Monitor) {
        if line.is_refusal() {
            count(&mut self.counts.refused);
        }
        if !self.is_sure && line.is_of_autopilot() {
            self.hear(now_ms);
        }
        if self.is_following {
            self.condition(Conditions::FAILSAFE, false, [Line::Failsafe, Line::FailsafeEnd], monitor);
        }
    }

    /// Sets a pulse, unless the vehicle must be armed for that.
    #[inline(never)]
    fn follow(&mut self, pulse: Ticks, mut line: Line, source: NodeId, now_ms: u16, servo: &mut impl Output) -> Line {
        if self.is_disarmed() {
            line = Line::RefusedDisarmed;
        } else {
            servo.set(pulse);
            self.pulse = pulse;
            self.is_following = true;
            self.hears_commands = false;
            self.followed_ms = now_ms;
            self.has_filters_to_give |= self.wants_filters;
            count(&mut self.counts.followed);
        }
        self.autopilot.commanded_by(source, now_ms);
        line
    }

    fn status_of(&mut self, source: NodeId, now_ms: u16) {
        if !self.autopilot.is_status_of(source, now_ms) {
            return;
        }
        self.occasion_ms = now_ms;
        const NO_COMMANDS_MS: u16 = 256;
        self.has_filters_to_give |= self.wants_filters && now_ms.wrapping_sub(self.followed_ms) >= NO_COMMANDS_MS;
        // Soon after the last it waits until it may go.
        self.due.set(Due::NODE_STATUS);
        if self.thesis || self.dialect == Dialect::DRAFT {
            self.autopilot_statuses = self.autopilot_statuses.wrapping_add(1);
            if self.autopilot_statuses == STATUSES_PER_DEGREES {
                self.autopilot_statuses = 0;
                self.due.set(Due::DEGREES_CELSIUS);
            }
        }
    }

    /// Acts on what the controller has to tell of itself.
    #[inline(never)]
    pub fn notice(&mut self, notice: Notice, monitor: &mut Monitor) {
        if notice.event == CanEvent::Flags {
            return self.flags(ErrorFlags(notice.value), monitor);
        }
        if notice.event == CanEvent::GaveUpSending {
            count(&mut self.counts.given_up);
            self.happened(Conditions::GAVE_UP_SENDING);
        } else if notice.event != CanEvent::Running {
            self.happened(Conditions::CONTROLLER_LOST);
        }
        // In the order of the events.
        let line = Line::Running.plus(notice.event as u8);
        let event = monitor.tell(line);
        event.set_code(notice.value);
        event.a = self.counts.given_up;
    }

    fn flags(&mut self, flags: ErrorFlags, monitor: &mut Monitor) {
        if flags.frames_lost() {
            count(&mut self.counts.overruns);
            self.happened(Conditions::FRAMES_LOST);
            monitor.tell(Line::FramesLost).a = self.counts.overruns;
        }
        if flags.bus_off() {
            self.happened(Conditions::BUS_OFF);
            monitor.tell(Line::BusOff);
        }
        self.condition(
            Conditions::ERROR_PASSIVE,
            flags.error_passive(),
            [Line::ErrorPassive, Line::ErrorActive],
            monitor,
        );
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
}

impl Default for Node {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
