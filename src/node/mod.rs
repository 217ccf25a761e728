//! The node: follows commands, measures the temperature, publishes its status, and answers
//! requests.
//!
//! [`Node`] takes received frames and the clock, and gives frames to send and the pulse for the
//! servo. It accesses no hardware and never waits. This file passes each event to the part that
//! handles it. Each part owns its state:
//!
//! | part | task |
//! | --- | --- |
//! | [`agenda`] | chooses what to do next |
//! | [`actuators`] | the outputs: commands, arming; [`actuator`] one output: its pulse and failsafe; [`servo`] computes the travel |
//! | [`autopilot`] | finds the autopilot among the nodes |
//! | [`dialect`] | chooses between DroneCAN v0 and the draft of 2014 |
//! | [`kind`] | the received data types; [`acceptance`] derives the filters from them, [`wire`] configures how transfers are reassembled |
//! | [`health`] | conditions and counters; [`condition`] their bits |
//! | [`parameters`] | the parameters; [`store`] keeps them in EEPROM |
//! | [`publisher`] | when to send messages; [`messages`] fills in their payload; [`outgoing`] splits it into frames |
//! | [`services`] | requests and responses |
//! | [`temperature`] | the temperature; [`thermometer`] computes it from ADC readings |

pub mod acceptance;
pub mod actuator;
pub mod actuators;
pub mod agenda;
#[cfg(feature = "allocation")]
pub mod allocation;
pub mod autopilot;
pub mod bit_rate;
#[cfg(feature = "button")]
pub mod button;
pub mod condition;
pub mod dialect;
#[cfg(feature = "draft")]
pub mod draft;
pub mod health;
pub mod information;
pub mod kind;
#[cfg(feature = "lights")]
pub mod lights;
mod messages;
pub mod outgoing;
pub mod parameters;
#[cfg(feature = "power")]
pub mod power;
pub mod publisher;
pub mod services;
pub mod servo;
pub mod store;
pub mod temperature;
pub mod thermometer;
#[cfg(feature = "tunnel")]
pub mod tunnel;
#[cfg(feature = "update")]
pub mod update;
pub mod wire;

#[cfg(feature = "outputs")]
use dronecan_wire::Slot;
use dronecan_wire::{NodeId, Rejection, Verdict};
use mcp2515_ordered::{Attempts, ErrorFlags, Event as CanEvent, Frame, Notice};

use crate::hardware::Input;
use crate::monitor::{Event, Line, Monitor};
use crate::progmem::Progmem;
use acceptance::{Filters, NodeAcceptance, Row};
use actuators::Actuators;
use agenda::Entry;
use autopilot::Autopilot;
use condition::{Conditions, ResetCause};
use dialect::Dialect;
#[cfg(feature = "draft")]
use health::Level;
use health::{Health, count};
use information::Information;
use kind::Kind;
use outgoing::Outgoing;
use parameters::{Descriptions, Parameter, Parameters};
use publisher::Publisher;
use services::Services;
use servo::{Output, Ticks};
use store::{Eeprom, Store};
use temperature::Temperature;
use wire::{Receiver, Transfer};

#[cfg(feature = "allocation")]
use allocation::Allocation;
#[cfg(feature = "button")]
use button::Button;
#[cfg(feature = "lights")]
use lights::Lights;
#[cfg(feature = "power")]
use power::Power;
#[cfg(any(
    feature = "allocation",
    feature = "button",
    feature = "outputs",
    feature = "tunnel"
))]
use publisher::Publication;
#[cfg(feature = "tunnel")]
use tunnel::Tunnel;
#[cfg(feature = "update")]
use update::Update;

/// The flash with all tables of the node.
pub trait Constants: Progmem<Descriptions> + Progmem<Information> {
    /// The byte at index `at` of [`information::PACKED`].
    #[inline(never)]
    fn information(self, at: u8) -> u8 {
        Progmem::<Information>::byte(self, u16::from(at))
    }
}

impl<P: Progmem<Descriptions> + Progmem<Information>> Constants for P {}

/// Work that takes long and therefore gets a turn of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum Chore {
    /// Apply parameters that were set.
    TakeParameters = 1 << 0,
    /// Compute a temperature: the sum of readings is complete.
    Measure = 1 << 1,
    /// Do the work of each second.
    Second = 1 << 2,
    /// Compute voltage and current: their sums of readings are complete.
    #[cfg(feature = "power")]
    MeasurePower = 1 << 3,
}

/// A set of chores.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Chores(u8);

impl Chores {
    #[inline(always)]
    fn add(&mut self, chore: Chore) {
        self.0 |= chore as u8;
    }

    /// Removes a chore. Returns true if it was in the set.
    #[inline(always)]
    fn take(&mut self, chore: Chore) -> bool {
        let has = self.0 & chore as u8 != 0;
        self.0 &= !(chore as u8);
        has
    }
}

/// The transfer that the outgoing frames belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sending {
    /// The node's status.
    Status,
    /// Another message.
    Message,
    /// The response to the oldest request.
    Reply,
}

/// The longest time that new filters wait for a moment without a transfer, in seconds. Longer than
/// a transfer may take.
const FILTERS_WAIT_S: u8 = 4;

/// The node.
pub struct Node {
    /// 1 to 127; 0 while the node has no ID.
    id: u8,
    unique_id: [u8; 16],
    uptime_sec: u32,
    /// Start of the current second, in milliseconds.
    second_ms: u16,
    chores: Chores,
    /// The parameters in force.
    pub parameters: Parameters,
    store: Store,
    actuators: Actuators,
    autopilot: Autopilot,
    dialect: Dialect,
    health: Health,
    temperature: Temperature,
    publisher: Publisher,
    services: Services,
    outgoing: Outgoing,
    sending: Sending,
    /// The log line about the current transfer.
    note: Event,
    /// True once a thesis command was received. The node then also sends the thesis's temperature
    /// message.
    thesis: bool,
    /// Seconds until new filters are set even during a transfer. 0 if no new filters are pending.
    filters_s: u8,
    #[cfg(feature = "allocation")]
    allocation: Allocation,
    #[cfg(feature = "lights")]
    lights: Lights,
    #[cfg(feature = "button")]
    button: Button,
    #[cfg(feature = "power")]
    power: Power,
    /// The serial monitor through the bus.
    #[cfg(feature = "tunnel")]
    pub tunnel: Tunnel,
    /// What the node knows of updates over the bus.
    #[cfg(feature = "update")]
    pub update: Update,
}

impl Node {
    /// A node before [`start`](Self::start).
    pub const fn new() -> Self {
        Self {
            id: 0,
            unique_id: [0; 16],
            uptime_sec: 0,
            second_ms: 0,
            chores: Chores(0),
            parameters: Parameters::new(),
            store: Store::new(),
            actuators: Actuators::new(),
            autopilot: Autopilot::NONE,
            dialect: Dialect::new(),
            health: Health::new(),
            temperature: Temperature::new(),
            publisher: Publisher::new(),
            services: Services::new(),
            outgoing: Outgoing::new(),
            sending: Sending::Status,
            note: Event::new(Line::RefusedKind),
            thesis: false,
            filters_s: 0,
            #[cfg(feature = "allocation")]
            allocation: Allocation::new(),
            #[cfg(feature = "lights")]
            lights: Lights::new(),
            #[cfg(feature = "button")]
            button: Button::new(),
            #[cfg(feature = "power")]
            power: Power::new(),
            #[cfg(feature = "tunnel")]
            tunnel: Tunnel::new(),
            #[cfg(feature = "update")]
            update: Update::new(),
        }
    }

    /// Starts the node with the contents of the EEPROM. Logs the reset cause and makes a status due
    /// at once, which also reports the cause.
    pub fn start(
        &mut self,
        cause: ResetCause,
        eeprom: &mut impl Eeprom,
        noise: impl FnMut() -> u8,
        flash: impl Progmem<Descriptions>,
        monitor: &mut Monitor,
    ) {
        self.store.identify(&mut self.unique_id, eeprom, noise);
        self.health.start(cause);
        #[cfg(any(feature = "standard", test))]
        let is_lost = self.store.load(&mut self.parameters, eeprom, flash);
        // What there is was saved by another build, which had parameters over the bus.
        #[cfg(not(any(feature = "standard", test)))]
        let is_lost = {
            self.parameters.set_defaults(flash);
            store::has_parameters(eeprom)
        };
        self.health.set(Conditions::PARAMETERS_LOST, is_lost, [Line::ParametersLost; 2], monitor);
        #[cfg(feature = "outputs")]
        self.actuators.start(&self.parameters);
        self.take_parameters();
        self.filters_s = 0;
        self.id = self.parameters.get(Parameter::CanNode) as u8;
        let banner = monitor.log_line(Line::Banner);
        banner.set_source(self.id);
        banner.set_code(Line::PowerOn.plus(cause.0).number());
        #[cfg(feature = "draft")]
        self.show_dialect(monitor);
        self.publisher.start();
        #[cfg(feature = "allocation")]
        self.allocation.start(&self.unique_id, 0);
    }

    /// The filters and masks for the CAN controller.
    pub fn acceptance<P: Progmem<Filters>>(&self, flash: P) -> NodeAcceptance<P> {
        #[allow(unused_mut, reason = "a build may have no other row")]
        let mut row = self.row();
        #[cfg(feature = "allocation")]
        if self.id == 0 {
            row = Row::WithoutId;
        }
        NodeAcceptance { node: NodeId::new(self.id), row, flash }
    }

    /// The set of filters for a node with an ID.
    #[inline(always)]
    fn row(&self) -> Row {
        let row = self.dialect.row();
        #[cfg(feature = "outputs")]
        if row == Row::V0 && self.actuators.has_motors() {
            return Row::WithMotors;
        }
        row
    }

    /// How often the controller tries to send a frame. An anonymous frame is sent once, because
    /// other nodes may send frames with the same identifier (specification, chapter 4).
    #[inline(always)]
    pub fn attempts(&self) -> Attempts {
        if self.id == 0 { Attempts::Once } else { Attempts::UntilSent }
    }

    /// The node's ID; 0 while it has none.
    pub fn id(&self) -> u8 {
        self.id
    }

    /// True if the controller should get new filters now. New filters are pending after the node
    /// got an ID, after DIALECT was set, and after a failsafe during which no command was
    /// received, because wrong filters may be the cause. Setting filters takes the controller off
    /// the bus for 5 ms. So the node waits, for `FILTERS_WAIT_S` at most, until it neither
    /// sends a transfer nor receives a list, and the controller has sent all its
    /// frames (`is_controller_empty`). It does not wait for the rest of a request, which may take
    /// two seconds: until then it could send nothing.
    pub fn wants_filters(&self, is_controller_empty: bool, receiver: &Receiver) -> bool {
        self.filters_s != 0
            && (self.filters_s == 1
                || is_controller_empty && !self.outgoing.is_busy() && !receiver.is_receiving_list())
    }

    /// True if new filters are pending.
    fn awaits_filters(&self) -> bool {
        self.filters_s != 0
    }

    /// Notes that the controller got its filters.
    pub fn filters_are_set(&mut self) {
        self.filters_s = 0;
    }

    fn change_filters(&mut self) {
        self.filters_s = FILTERS_WAIT_S;
    }

    /// How the node is: its conditions and its counters.
    pub fn health(&self) -> &Health {
        &self.health
    }

    /// The unique ID of the hardware.
    pub fn unique_id(&self) -> &[u8; 16] {
        &self.unique_id
    }

    /// The width of an output's pulse; 0 for none.
    pub fn pulse(&self, output: usize) -> Ticks {
        self.actuators.pulse(output)
    }

    /// Gives the pulses to the outputs of the board.
    pub fn show(&mut self, board: &mut impl Output) {
        self.actuators.show(board);
    }

    /// The brightness of the light, 0 to 255.
    #[cfg(feature = "lights")]
    pub fn light(&self) -> u8 {
        self.lights.brightness()
    }

    /// True if it is time to restart the program.
    pub fn is_to_restart(&self, now_ms: u16) -> bool {
        self.services.is_to_restart(now_ms)
    }

    /// True if the program has run for a minute.
    #[cfg(feature = "update")]
    pub fn has_run_a_minute(&self) -> bool {
        self.uptime_sec >= 60
    }

    /// The input of the ADC for the next reading.
    #[inline(always)]
    pub fn next_input(&self) -> Input {
        #[cfg(feature = "power")]
        return self.power.next_input(&self.parameters);
        #[cfg(not(feature = "power"))]
        Input::Sensor
    }

    /// Takes a reading of the ADC, which measures the input `next` now.
    #[inline(always)]
    pub fn read_input(&mut self, reading: u16, next: Input) {
        #[cfg(feature = "power")]
        match self.power.add(reading, next) {
            (Input::Sensor, _) => {}
            (_, true) => return self.chores.add(Chore::MeasurePower),
            (_, false) => return,
        }
        let _ = next;
        if self.temperature.add(reading) {
            self.chores.add(Chore::Measure);
        }
    }

    /// True if a chore is pending.
    #[inline(always)]
    pub fn has_chore(&self) -> bool {
        self.chores.0 != 0
    }

    /// Does one pending chore.
    pub fn do_chore(&mut self, monitor: &mut Monitor) {
        if self.chores.take(Chore::TakeParameters) {
            self.take_parameters();
        } else if self.chores.take(Chore::Measure) {
            self.temperature.measure(&self.parameters);
        } else if self.chores.take(Chore::Second) {
            self.second(monitor);
        } else {
            #[cfg(feature = "power")]
            if self.chores.take(Chore::MeasurePower) {
                self.power.measure(&self.parameters);
            }
        }
    }

    /// Applies the parameters after some were set.
    pub fn take_parameters(&mut self) {
        let row = self.row();
        self.actuators.update(&self.parameters);
        self.dialect.update(&self.parameters);
        if row != self.row() {
            self.change_filters();
        }
    }

    /// Drops transfers that timed out. Call at every tick.
    #[inline(never)]
    pub fn expire(&mut self, receiver: &mut Receiver, now_ms: u16, monitor: &mut Monitor) {
        if let Some(transfer) = receiver.expire(now_ms) {
            self.lose(Rejection::Broken, transfer.kind.id(), transfer.source, monitor);
        }
    }

    /// Does the work of `passed_ms` milliseconds. Call at every tick of the millisecond clock, or
    /// after several of them.
    pub fn tick(
        &mut self,
        passed_ms: u8,
        now_ms: u16,
        eeprom: &mut impl Eeprom,
        monitor: &mut Monitor,
    ) {
        self.store.step(&mut self.parameters, eeprom);
        self.publisher.tick(passed_ms, now_ms, self.autopilot.is_present(), &self.parameters);
        #[cfg(feature = "allocation")]
        if self.id == 0 && self.allocation.is_due(now_ms) {
            self.publisher.publish(Publication::Allocation);
        }
        #[cfg(feature = "tunnel")]
        if self.tunnel.tick(now_ms) {
            self.publisher.publish(Publication::Targetted);
        }
        if self.actuators.tick(now_ms, &self.parameters) {
            if self.actuators.hears_nothing() {
                self.change_filters();
            }
            self.health.set(Conditions::FAILSAFE, true, [Line::Failsafe; 2], monitor);
        }
        #[cfg(feature = "outputs")]
        self.report_failsafe(monitor);
        #[cfg(feature = "standard")]
        let is_disarmed = self.actuators.is_safe() || self.actuators.is_disarmed(&self.parameters);
        #[cfg(feature = "safety")]
        let begins = if self.actuators.is_safe() { Line::Safe } else { Line::Disarmed };
        #[cfg(all(feature = "standard", not(feature = "safety")))]
        let begins = Line::Disarmed;
        #[cfg(feature = "standard")]
        self.health.set(Conditions::DISARMED, is_disarmed, [begins, Line::DisarmedEnd], monitor);
        if now_ms.wrapping_sub(self.second_ms) >= 1000 {
            self.second_ms = self.second_ms.wrapping_add(1000);
            self.chores.add(Chore::Second);
        }
    }

    /// If an entry of a command waits to be followed.
    #[inline(always)]
    pub fn entry(&self) -> Entry {
        #[cfg(feature = "outputs")]
        return self.actuators.entry();
        #[cfg(not(feature = "outputs"))]
        return Entry::None;
    }

    /// Follows the next entry of a command, and counts and logs it.
    #[cfg(feature = "outputs")]
    pub fn follow_next(&mut self, now_ms: u16, monitor: &mut Monitor, board: &mut impl Output) {
        let line = self.actuators.follow_next(&mut self.note, now_ms, &self.parameters, board);
        if line.is_refusal() {
            count(&mut self.health.counts.refused);
        } else if line != Line::CommandWaits {
            count(&mut self.health.counts.followed);
            if let Some(source) = NodeId::new(self.actuators.commander()) {
                self.commanded_by(source, monitor);
            }
        }
        self.log_note(line, monitor);
        self.end_failsafe(monitor);
    }

    /// Logs and publishes which outputs are in failsafe, if that has changed and several outputs
    /// are in use.
    #[cfg(feature = "outputs")]
    fn report_failsafe(&mut self, monitor: &mut Monitor) {
        if let Some((output, begins)) = self.actuators.take_change() {
            let line = if begins { Line::FailsafeOf } else { Line::FailsafeOfEnd };
            monitor.log_line(line).set_code(output as u8 + 1);
            self.publisher.publish(Publication::FailsafeOutputs);
        }
    }

    /// Takes the state of the button during the last `passed_ms` milliseconds.
    #[cfg(feature = "button")]
    pub fn read_button(&mut self, is_pressed: bool, passed_ms: u8, monitor: &mut Monitor) {
        if self.button.tick(is_pressed, passed_ms) {
            monitor.log_line(Line::Button).a = self.button.count();
            self.publisher.publish(Publication::KeyValue);
        }
    }

    /// Does the work of each second.
    fn second(&mut self, monitor: &mut Monitor) {
        self.uptime_sec = self.uptime_sec.wrapping_add(1);
        // At 1 the node waits no longer: see `wants_filters`.
        if self.filters_s > 1 {
            self.filters_s -= 1;
        }
        self.autopilot.second();
        self.actuators.second(self.second_ms);
        self.health.second();
        #[cfg(feature = "outputs")]
        if self.actuators.publishes_failsafe() {
            self.publisher.publish(Publication::FailsafeOutputs);
        }
        self.temperature.second(&mut self.health, monitor);
        #[cfg(feature = "power")]
        self.power.second(&self.parameters, &mut self.health, monitor);
        #[cfg(feature = "draft")]
        {
            self.dialect.second();
            self.show_dialect(monitor);
        }
    }

    /// Reports the dialect in the status and in the log.
    #[cfg(feature = "draft")]
    #[inline(never)]
    fn show_dialect(&mut self, monitor: &mut Monitor) {
        self.health.set(
            Conditions::DRAFT,
            self.dialect.is_draft(),
            [Line::Draft, Line::DraftEnd],
            monitor,
        );
    }

    /// Takes a received frame, and acts on the transfer that it completes. `has_backlog`: more
    /// frames wait, so what can wait does.
    #[inline(always)]
    #[allow(
        clippy::too_many_arguments,
        reason = "the parts of the board, which the main loop owns"
    )]
    pub fn receive(
        &mut self,
        frame: &Frame,
        receiver: &mut Receiver,
        now_ms: u16,
        has_backlog: impl FnOnce() -> bool,
        flash: impl Progmem<Descriptions>,
        monitor: &mut Monitor,
        servo: &mut impl Output,
    ) {
        #[cfg(feature = "outputs")]
        self.actuators.note_frame();
        let segment = match self.dialect.segment(frame, self.id) {
            Ok(segment) => segment,
            Err(rejection) => return self.reject(rejection, frame, monitor),
        };
        let commander = self.autopilot.commander();
        #[cfg(not(feature = "outputs"))]
        let verdict = {
            let own_id = self.parameters.get(match segment.kind {
                #[cfg(feature = "lights")]
                Kind::LightsCommand => Parameter::LightId,
                _ => Parameter::Out1Id,
            });
            receiver.accept(segment, own_id as u8, commander, now_ms)
        };
        #[cfg(feature = "outputs")]
        let verdict = {
            #[cfg(feature = "lights")]
            let light_id = (segment.kind == Kind::LightsCommand)
                .then_some(self.parameters.get(Parameter::LightId) as u8);
            #[cfg(not(feature = "lights"))]
            let light_id: Option<u8> = None;
            let actuators = &self.actuators;
            let slot_of = |id| match light_id {
                Some(own_id) => (id == own_id).then_some(Slot::new(0)),
                None => actuators.slot_of(id),
            };
            receiver.accept_entries(segment, slot_of, commander, now_ms)
        };
        match verdict {
            Verdict::More => {}
            Verdict::Rejected(rejection) => self.reject(rejection, frame, monitor),
            Verdict::Message(message) => {
                #[cfg(not(feature = "draft"))]
                {
                    self.note.a = message.kind.id();
                }
                let line = self.act(message, now_ms, has_backlog, monitor, servo);
                // The draft has another data type ID for the same kind.
                #[cfg(feature = "draft")]
                if line.is_refusal() {
                    self.note.a = Dialect::data_type(message, frame);
                }
                self.conclude(line, message, monitor);
            }
            Verdict::Request(_) if self.services.is_full() => {
                self.reject(Rejection::Busy, frame, monitor)
            }
            Verdict::Request(request) => {
                self.note.a = request.kind.id();
                let line = self.serve(request, now_ms, flash);
                self.conclude(line, request, monitor);
            }
        }
    }

    /// Counts and logs a transfer. Ends the failsafe if a command was followed.
    #[inline(never)]
    fn conclude(&mut self, line: Line, transfer: &Transfer, monitor: &mut Monitor) {
        self.health.transfers.received();
        if line.is_refusal() {
            count(&mut self.health.counts.refused);
        }
        self.note.set_source(transfer.source);
        self.note.set_transfer(transfer.transfer_id());
        self.log_note(line, monitor);
        self.end_failsafe(monitor);
    }

    /// Logs a line with the values of the note.
    #[inline(always)]
    fn log_note(&mut self, line: Line, monitor: &mut Monitor) {
        self.note.line = line;
        #[cfg(feature = "outputs")]
        if line == Line::CommandWaits {
            return;
        }
        if let Some(event) = monitor.log_frame(line) {
            *event = self.note;
        }
    }

    /// Ends the failsafe if a command was followed.
    #[inline(always)]
    fn end_failsafe(&mut self, monitor: &mut Monitor) {
        if self.health.has(Conditions::FAILSAFE) && self.actuators.has_recovered() {
            self.health.set(Conditions::FAILSAFE, false, [Line::FailsafeEnd; 2], monitor);
        }
    }

    /// Counts and logs a frame that is dropped.
    #[inline(never)]
    fn reject(&mut self, rejection: Rejection, frame: &Frame, monitor: &mut Monitor) {
        let (data_type, source) = Dialect::origin(frame);
        self.lose(rejection, data_type, source, monitor);
    }

    /// Counts and logs a frame or a transfer that is dropped.
    #[inline(never)]
    fn lose(&mut self, rejection: Rejection, data_type: u16, source: u8, monitor: &mut Monitor) {
        if rejection == Rejection::OwnId {
            self.health.happened(Conditions::ID_CONFLICT);
        } else if rejection.is_loss() {
            self.health.transfers.broken();
            self.health.happened(Conditions::TRANSFER_ERRORS);
        }
        count(&mut self.health.counts.refused);
        let line = match rejection {
            Rejection::Unknown => Line::RefusedKind,
            Rejection::Anonymous | Rejection::OwnId => Line::RefusedSource,
            Rejection::Malformed => Line::RefusedTransfer,
            Rejection::Busy => Line::RefusedBusy,
            Rejection::Broken => Line::RefusedBroken,
            Rejection::Interleaved => Line::RefusedInterleaved,
            Rejection::Length => Line::RefusedLength,
        };
        if let Some(event) = monitor.log_frame(line) {
            event.a = data_type;
            event.set_source(source);
        }
    }

    /// Acts on a message, and fills in the values of the log line. Returns the line to log, or the
    /// line for the reason of a rejection.
    #[inline(always)]
    fn act(
        &mut self,
        transfer: &Transfer,
        now_ms: u16,
        has_backlog: impl FnOnce() -> bool,
        monitor: &mut Monitor,
        servo: &mut impl Output,
    ) -> Line {
        let (kind, len) = (transfer.kind, transfer.len());
        let &[b0, ..] = transfer.bytes();
        let Some(source) = NodeId::new(transfer.source) else {
            // The only anonymous message that the node takes is an Allocation request.
            #[cfg(feature = "allocation")]
            self.hear_allocation(transfer, now_ms);
            return Line::RefusedSource;
        };
        let is_draft = Dialect::is_of_draft(transfer.priority);
        if (kind.is_command() || kind == Kind::NodeStatus) && !self.dialect.hear(is_draft) {
            return Line::RefusedType;
        }
        let line = match kind {
            Kind::NodeStatus => return self.act_on_status(transfer, is_draft, source, now_ms),
            #[cfg(feature = "standard")]
            Kind::ArmingStatus if len == 1 => {
                if !self.autopilot.is_status_of(source) {
                    return Line::RefusedSource;
                }
                self.actuators.arm(b0);
                self.note.set_code(b0);
                return Line::Arming;
            }
            #[cfg(feature = "safety")]
            Kind::SafetyState if len == 1 => {
                if !self.autopilot.is_status_of(source) {
                    return Line::RefusedSource;
                }
                let is_failsafe = self.health.has(Conditions::FAILSAFE);
                self.actuators.take_safety_state(b0, is_failsafe, now_ms, &self.parameters);
                if self.actuators.is_safe() {
                    // Commands are missing for a reason.
                    self.health.clear(Conditions::FAILSAFE);
                    #[cfg(feature = "outputs")]
                    self.actuators.clear_failing();
                }
                self.note.set_code(b0);
                return Line::SafetyState;
            }
            #[cfg(feature = "lights")]
            Kind::LightsCommand => {
                self.lights.take(transfer.payload());
                self.note.set_code(self.lights.brightness());
                return Line::Light;
            }
            #[cfg(feature = "tunnel")]
            Kind::Targetted if (tunnel::HEADER_LEN..=tunnel::HEADER_LEN + 1).contains(&len) => {
                let &[_, target, port, _, _, _, character, ..] = transfer.bytes();
                let is_for_us = self.tunnel.hear([b0, target, port], self.id, source.get(), now_ms);
                if is_for_us && len > tunnel::HEADER_LEN && character == b'?' {
                    self.health.report(monitor);
                }
                return Line::Targetted;
            }
            #[cfg(feature = "allocation")]
            Kind::Allocation => {
                let line = self.hear_allocation(transfer, now_ms);
                self.note.set_code(self.id);
                return line;
            }
            Kind::ServoCommand if len == 1 => {
                self.thesis = true;
                self.note.set_code(b0);
                self.actuators.take_servo_command(
                    b0,
                    &mut self.note,
                    now_ms,
                    &self.parameters,
                    servo,
                )
            }
            #[cfg(feature = "outputs")]
            Kind::RawCommand => self.actuators.take_raw_command(transfer, &self.parameters),
            _ if kind.is_list() => {
                self.note.set_code(self.parameters.get(Parameter::Out1Id) as u8);
                let Self { actuators, parameters, note, .. } = self;
                actuators.take_array_command(
                    transfer,
                    kind.entry_len(),
                    has_backlog,
                    note,
                    now_ms,
                    parameters,
                    servo,
                )
            }
            _ => return Line::RefusedLength,
        };
        #[cfg(feature = "outputs")]
        if line == Line::CommandWaits {
            return line;
        }
        let is_followed = !line.is_refusal() && !line.is_elsewhere();
        if is_followed {
            count(&mut self.health.counts.followed);
        }
        // A command that is rejected because the vehicle is disarmed still identifies the
        // autopilot.
        #[cfg(feature = "standard")]
        let is_followed = is_followed || line == Line::RefusedDisarmed;
        #[cfg(feature = "safety")]
        let is_followed = is_followed || line == Line::RefusedSafe;
        if is_followed {
            self.commanded_by(source, monitor);
        }
        line
    }

    /// Takes note of the sender of a command.
    #[inline(always)]
    fn commanded_by(&mut self, source: NodeId, monitor: &mut Monitor) {
        if self.autopilot.commanded_by(source) {
            self.health.set(Conditions::TWO_COMMANDERS, true, [Line::TwoCommanders; 2], monitor);
            self.health.happened(Conditions::TWO_COMMANDERS);
        }
    }

    /// Acts on a NodeStatus.
    #[inline(always)]
    fn act_on_status(
        &mut self,
        status: &Transfer,
        is_draft: bool,
        source: NodeId,
        now_ms: u16,
    ) -> Line {
        let &[u0, u1, u2, u3, state, ..] = status.bytes();
        let (level, mode);
        // In the draft the lower four bits are the status, not uptime.
        let highest = if is_draft { u3 >> 4 } else { u3 };
        #[cfg(feature = "draft")]
        if is_draft {
            if !matches!(status.len(), 4 | 6 | 7 | 8) {
                return Line::RefusedLength;
            }
            // 0 is OK, 1 initialising, 2 warning, 3 critical, 15 offline.
            (level, mode) = match u3 & 15 {
                status @ (0 | 1) => (Level::Ok as u8, status),
                2 => (Level::Warning as u8, 0),
                _ => (Level::Critical as u8, 0),
            };
        } else if status.len() == 7 {
            (level, mode) = (state >> 6, state >> 3 & 7);
        } else {
            return Line::RefusedLength;
        }
        #[cfg(not(feature = "draft"))]
        if status.len() == 7 && !is_draft {
            (level, mode) = (state >> 6, state >> 3 & 7);
        } else {
            return Line::RefusedLength;
        }
        self.note.set_code(Line::Health.plus(level).number());
        self.note.b = u16::from(Line::Mode.plus(mode.min(4)).number());
        self.note.a = if u2 | highest == 0 { u16::from_le_bytes([u0, u1]) } else { u16::MAX };
        if self.autopilot.is_status_of(source) {
            self.publisher.autopilot_status(now_ms, self.thesis || self.dialect.is_draft());
        }
        Line::Status
    }

    #[cfg(feature = "allocation")]
    #[inline(never)]
    fn hear_allocation(&mut self, transfer: &Transfer, now_ms: u16) -> Line {
        if self.id != 0 {
            return Line::AllocationElsewhere;
        }
        self.publisher.withdraw(Publication::Allocation);
        self.id = self.allocation.hear(transfer, &self.unique_id, now_ms);
        if self.id == 0 {
            return Line::AllocationElsewhere;
        }
        self.change_filters();
        Line::Allocated
    }

    /// True if the serial monitor may write a character: without somebody who looks through the
    /// bus, always.
    #[inline(always)]
    pub fn takes_character(&self) -> bool {
        #[cfg(feature = "tunnel")]
        return self.tunnel.has_room();
        #[cfg(not(feature = "tunnel"))]
        true
    }

    /// Takes a character of the serial monitor, or 0, for whoever looks through the bus.
    #[inline(always)]
    pub fn take_character(&mut self, character: u8) {
        #[cfg(feature = "tunnel")]
        self.tunnel.push(character);
        #[cfg(not(feature = "tunnel"))]
        let _ = character;
    }

    /// Acts on an event of the CAN controller.
    #[inline(never)]
    pub fn notice(&mut self, notice: Notice, monitor: &mut Monitor) {
        let line = match notice.event {
            CanEvent::Flags => return self.flags(ErrorFlags(notice.value), monitor),
            CanEvent::Running => Line::Running,
            CanEvent::NotAnswering => Line::NotAnswering,
            CanEvent::NotKeeping => Line::NotKeeping,
            CanEvent::NotStarting => Line::NotStarting,
            CanEvent::Lost => Line::ControllerLost,
            CanEvent::GaveUpSending => Line::GaveUp,
        };
        if notice.event == CanEvent::GaveUpSending {
            count(&mut self.health.counts.given_up);
        }
        if notice.event != CanEvent::Running {
            self.health.happened(Conditions::CONTROLLER);
        }
        let event = monitor.log_line(line);
        event.set_code(notice.value);
        event.a = self.health.counts.given_up;
    }

    fn flags(&mut self, flags: ErrorFlags, monitor: &mut Monitor) {
        if flags.frames_lost() {
            count(&mut self.health.counts.overruns);
            self.health.happened(Conditions::FRAMES_LOST);
            monitor.log_line(Line::FramesLost).a = self.health.counts.overruns;
        }
        if flags.bus_off() {
            self.health.happened(Conditions::BUS_OFF);
            monitor.log_line(Line::BusOff);
        }
        let is_passive = flags.error_passive();
        self.health.set(
            Conditions::ERROR_PASSIVE,
            is_passive,
            [Line::ErrorPassive, Line::ErrorActive],
            monitor,
        );
    }

    /// Logs the counters.
    pub fn report(&self, monitor: &mut Monitor) {
        self.health.report(monitor);
    }
}

impl Default for Node {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
