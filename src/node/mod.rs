//! The node: follows commands, measures the temperature, publishes its status, and answers
//! requests.
//!
//! [`Node`] takes received frames and the clock, and gives frames to send and the pulses of the
//! outputs. It accesses no hardware and never waits. This file passes the events of time to the
//! modules that handle them, `receive` those of the bus, and `messages` and `services` fill in what
//! the node sends. Each module, and each part in [`parts`](crate::parts), owns its state:
//!
//! | module | task |
//! | --- | --- |
//! | [`acceptance`] | derives the filters from the table of received types |
//! | [`agenda`] | chooses what to do next |
//! | [`autopilot`] | finds the autopilot among the nodes |
//! | `dispatch` | calls the method that a row of a table names |
//! | [`health`] | conditions and counters |
//! | [`store`] | keeps the parameters in EEPROM |
//! | [`publisher`] | when to send messages; `messages` fills in their payload; [`outgoing`] splits it into frames |
//! | [`services`] | requests and responses |
//! | [`temperature`] | the temperature; [`thermometer`] computes it from ADC readings |

pub mod acceptance;
pub mod agenda;
pub mod autopilot;
mod chores;
mod controller;
mod dispatch;
mod get_set;
pub mod health;
mod measure;
mod messages;
pub mod outgoing;
pub mod publisher;
mod receive;
mod restart;
pub mod services;
pub mod store;
pub mod temperature;
pub mod thermometer;
pub mod trust;

use dronecan_wire::{NodeId, Rejection};

use crate::dialect;
use crate::eeprom::Eeprom;
use crate::monitor::{Event, Line, Monitor, Words};
use crate::parts::allocation::Allocation;
use crate::parts::battery::Battery;
use crate::parts::button::Button;
use crate::parts::lights::Lights;
use crate::parts::log::Log;
use crate::parts::measurement::Measurement;
use crate::parts::outputs::travel::Ticks;
use crate::parts::outputs::{Outputs, Pulses};
use crate::parts::power::Power;
use crate::parts::rpm::Shaft;
use crate::parts::stats::Stats;
use crate::parts::tunnel::Tunnel;
use crate::parts::update::Update;
use crate::progmem::Progmem;
use crate::tables::Constants;
use crate::tables::condition::{Conditions, ResetCause};
use crate::tables::parameters::{Descriptions, Parameter, Parameters};
use crate::tables::publication::Publication;
use autopilot::Autopilot;
use chores::{Chore, Chores};
use health::{Health, count};
use outgoing::Outgoing;
use publisher::Publisher;
use services::Services;
use store::Store;
use temperature::Temperature;
use trust::Receiver;

/// The longest time that new filters wait for the end of an outgoing transfer, in seconds. Longer
/// than a transfer may take.
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
    autopilot: Autopilot,
    health: Health,
    temperature: Temperature,
    publisher: Publisher,
    services: Services,
    outgoing: Outgoing,
    /// What the outgoing frames belong to.
    sending: outgoing::Sending,
    /// The log line about the current transfer.
    note: Event,
    /// Seconds until new filters are set even during a transfer. 0 if no new filters are pending.
    filters_s: u8,
    outputs: Outputs,
    allocation: Allocation,
    battery: Battery,
    button: Button,
    lights: Lights,
    measurement: Measurement,
    power: Power,
    shaft: Shaft,
    stats: Stats,
    tunnel: Tunnel,
    log: Log,
    update: Update,
}

impl Node {
    /// A node before [`start`](Self::start).
    pub const fn new() -> Self {
        Self {
            id: 0,
            unique_id: [0; 16],
            uptime_sec: 0,
            second_ms: 0,
            chores: Chores::NONE,
            parameters: Parameters::new(),
            store: Store::new(),
            autopilot: Autopilot::NONE,
            health: Health::new(),
            temperature: Temperature::new(),
            publisher: Publisher::new(),
            services: Services::new(),
            outgoing: Outgoing::new(),
            sending: outgoing::Sending::Status,
            note: Event::new(Line::Status),
            filters_s: 0,
            outputs: Outputs::new(),
            allocation: Allocation::new(),
            battery: Battery::new(),
            button: Button::new(),
            lights: Lights::new(),
            measurement: Measurement::new(),
            power: Power::new(),
            shaft: Shaft::new(),
            stats: Stats::new(),
            tunnel: Tunnel::new(),
            log: Log::new(),
            update: Update::new(),
        }
    }

    /// Starts the node with the contents of the EEPROM. Logs the reset cause and makes a status due
    /// at once, which also reports the cause.
    pub fn start(
        &mut self,
        cause: ResetCause,
        has_loader: bool,
        eeprom: &mut impl Eeprom,
        noise: impl FnMut() -> u8,
        flash: impl Progmem<Descriptions>,
        monitor: &mut Monitor,
    ) {
        self.store.identify(&mut self.unique_id, eeprom, noise);
        self.health.start(cause);
        self.health.set_silently(dialect::CONDITION);
        let is_lost = if dialect::HAS_REQUESTS {
            self.store.load(&mut self.parameters, eeprom, flash)
        } else {
            // Another build has saved what nobody can set here.
            self.parameters.set_defaults(flash);
            store::has_parameters(eeprom)
        };
        self.health.set(Conditions::PARAMETERS_LOST, is_lost, [Line::ParametersLost; 2], monitor);
        self.outputs.start(&self.parameters);
        self.outputs.update(&self.parameters);
        self.lights.update(&self.parameters);
        self.filters_s = 0;
        self.id = self.parameters.get(Parameter::CanNode) as u8;
        let banner = monitor.log_line(Line::Banner);
        banner.set_source(self.id);
        banner.set_code(Words::RESET.number(cause.0));
        self.publisher.start();
        self.allocation.start(&self.unique_id, 0);
        self.update.start(has_loader);
    }

    /// The node's ID; 0 while it has none.
    pub fn id(&self) -> u8 {
        self.id
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
        self.outputs.pulse(output)
    }

    /// Gives the pulses to the outputs of the board.
    #[inline(always)]
    pub fn show(&mut self, board: &mut impl Pulses) {
        self.outputs.show(board);
    }

    /// The brightness of the light, 0 to 255.
    #[inline(always)]
    pub fn light(&self) -> u8 {
        self.lights.brightness()
    }

    /// True if the program has run for a minute.
    #[inline(always)]
    pub fn has_run_a_minute(&self) -> bool {
        self.uptime_sec >= 60
    }

    /// Takes the state of the button during the last `passed_ms` milliseconds.
    #[inline(always)]
    pub fn read_button(&mut self, is_pressed: bool, passed_ms: u8, monitor: &mut Monitor) {
        if self.button.tick(is_pressed, passed_ms) {
            monitor.log_line(Line::Button).set_a(self.button.count());
            self.publisher.publish(Publication::PRESSES);
        }
        if self.button.counts_tenth(passed_ms) {
            self.publisher.publish(Publication::Button);
        }
    }

    /// True if a chore is pending.
    #[inline(always)]
    pub fn has_chore(&self) -> bool {
        !self.chores.is_empty()
    }

    /// Does one pending chore.
    #[inline(always)]
    pub fn do_chore(&mut self, now_ms: u16, monitor: &mut Monitor) {
        if self.chores.remove(Chore::ApplyParameters) {
            self.apply_next_parameters();
        } else if self.chores.remove(Chore::Measure) {
            self.temperature.measure(&self.parameters);
        } else if self.chores.remove(Chore::Second) {
            self.second(monitor);
        } else if self.chores.remove(Chore::MeasurePower) {
            self.measure_power(now_ms);
        }
    }

    /// Has the parameters applied after some were set.
    #[inline(always)]
    pub fn apply_parameters(&mut self) {
        self.outputs.begin_update();
        self.chores.add(Chore::ApplyParameters);
    }

    /// Applies the parameters of the next output, and with those of the last one all others.
    fn apply_next_parameters(&mut self) {
        let row = self.row();
        if !self.outputs.update_next(&self.parameters) {
            self.chores.add(Chore::ApplyParameters);
        }
        self.lights.update(&self.parameters);
        if row != self.row() {
            self.change_filters();
        }
    }

    /// Drops transfers that timed out. Call at every tick.
    #[inline(never)]
    pub fn expire(
        &mut self,
        receiver: &mut Receiver,
        now_ms: u16,
        flash: impl Constants,
        monitor: &mut Monitor,
    ) {
        if let Some(transfer) = receiver.expire(now_ms) {
            let data_type = dialect::data_type(transfer.kind, flash);
            self.lose(Rejection::Broken, data_type, transfer.source, monitor);
        }
    }

    /// Does the work of `passed_ms` milliseconds. Call at every tick of the millisecond clock, or
    /// after several of them.
    #[inline(always)]
    pub fn tick(
        &mut self,
        passed_ms: u8,
        now_ms: u16,
        eeprom: &mut impl Eeprom,
        monitor: &mut Monitor,
    ) {
        self.store.step(&mut self.parameters, eeprom);
        if self.id != 0 && !self.store.is_saving() {
            self.update.step(self.id, &self.parameters, eeprom);
        }
        self.publisher.tick(passed_ms, now_ms, self.autopilot.is_present(), &self.parameters);
        if self.id == 0 && self.allocation.is_due(now_ms) {
            self.publisher.publish(Publication::Allocation);
        }
        if self.tunnel.tick(now_ms) {
            self.publisher.publish(Publication::Targetted);
        }
        if self.log.is_due(now_ms) {
            self.publisher.publish(Publication::LogMessage);
        }
        if self.outputs.tick(now_ms, &self.parameters) {
            if self.outputs.hears_nothing() {
                self.change_filters();
            }
            self.health.set(Conditions::FAILSAFE, true, [Line::Failsafe; 2], monitor);
        }
        self.report_outputs(monitor);
        if now_ms.wrapping_sub(self.second_ms) >= 1000 {
            self.second_ms = self.second_ms.wrapping_add(1000);
            self.chores.add(Chore::Second);
        }
    }

    /// Logs and publishes what has changed with the outputs: their failsafes, and if the vehicle is
    /// disarmed.
    #[inline(always)]
    fn report_outputs(&mut self, monitor: &mut Monitor) {
        if let Some((output, begins)) = self.outputs.take_change() {
            let line = if begins { Line::FailsafeOf } else { Line::FailsafeOfEnd };
            monitor.log_line(line).set_code(output as u8 + 1);
            self.publisher.publish(Publication::FailsafeOutputs);
        }
        let is_safe = self.outputs.safety.is_safe();
        let is_disarmed = is_safe || self.outputs.arming.is_disarmed(&self.parameters);
        let begins = if is_safe { Line::Safe } else { Line::Disarmed };
        self.health.set(Conditions::DISARMED, is_disarmed, [begins, Line::DisarmedEnd], monitor);
    }

    /// True if an entry of a command waits to be followed.
    #[inline(always)]
    pub fn has_entry(&self) -> bool {
        self.outputs.has_entry()
    }

    /// Follows the next entry of a command, and counts and logs it.
    #[inline(always)]
    pub fn follow_next(&mut self, now_ms: u16, monitor: &mut Monitor, board: &mut impl Pulses) {
        let followed = self.outputs.follow_next(&mut self.note, now_ms, &self.parameters, board);
        if followed.line.is_refusal() {
            count(&mut self.health.counts.refused);
        }
        if let Some(source) = NodeId::new(followed.commander) {
            count(&mut self.health.counts.followed);
            self.commanded_by(source, followed.is_second, monitor);
        }
        self.log_note(followed.line, monitor);
        self.end_failsafe(monitor);
    }

    /// Ends the failsafe if commands are followed again.
    #[inline(always)]
    fn end_failsafe(&mut self, monitor: &mut Monitor) {
        if self.health.has(Conditions::FAILSAFE) && self.outputs.has_recovered() {
            self.health.set(Conditions::FAILSAFE, false, [Line::FailsafeEnd; 2], monitor);
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
        self.outputs.second(self.second_ms, &self.parameters);
        self.outputs.superseded.second(monitor);
        self.health.second();
        if self.outputs.is_one_of_several_failing() {
            self.publisher.publish(Publication::FailsafeOutputs);
        }
        self.temperature.second(&mut self.health, monitor);
        let is_wrong = self.power.second(&self.parameters, monitor);
        let lines = [Line::PowerOutOfRange, Line::PowerOutOfRangeEnd];
        self.health.set(Conditions::POWER, is_wrong, lines, monitor);
    }

    /// True if the serial monitor may write a character: without somebody who looks through the
    /// bus, nearly always.
    #[inline(always)]
    pub fn takes_character(&self, now_ms: u16) -> bool {
        self.tunnel.has_room() && self.log.has_room(now_ms)
    }

    /// Keeps a character of this line of the serial monitor, or 0 for none, for whoever looks
    /// through the bus.
    #[inline(always)]
    pub fn keep_character(&mut self, character: u8, line: Line, now_ms: u16) {
        self.tunnel.push(character);
        self.log.push(character, line, now_ms);
    }

    /// Logs the counters.
    pub fn report(&self, monitor: &mut Monitor) {
        self.health.report(monitor);
        self.outputs.superseded.report(monitor);
    }
}

impl Default for Node {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(all(test, not(feature = "draft")))]
mod tests;
