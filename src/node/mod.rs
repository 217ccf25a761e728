//! The node: follows commands, measures the temperature, publishes its status, and answers
//! requests.
//!
//! [`Node`] takes received frames and the clock, and gives frames to send and the pulses of the
//! outputs. It accesses no hardware and never waits. Its fields are groups with methods of their
//! own. This file passes the events of time to the groups, `receive` those of the bus.
//!
//! | module | task |
//! | --- | --- |
//! | `receive`, `dispatch` | what a received frame leads to: the method that the row of a table names |
//! | `control` | commands, and who gives them; [`autopilot`] finds the autopilot among the nodes |
//! | `requests` | what the node does at a request, and its response |
//! | `payloads`, `sending` | what a message has; how a frame leaves |
//! | `transmission` | when messages are sent ([`publisher`]), the requests that wait ([`services`]), the transfer in progress ([`outgoing`]) |
//! | `sensors` | what is measured; [`temperature`] and [`thermometer`] compute the temperature |
//! | `record` | what is counted and logged; [`health`] has conditions and counters |
//! | `console`, `log` | who reads the log; the begin and the end of each condition |
//! | `identity` | the ID, and the unique ID of the hardware |
//! | `controller`, `filters` | what the node wants of the CAN controller; [`acceptance`] derives the filters from the table of received types |
//! | [`store`], `restart` | the parameters in EEPROM; the end of the program |
//! | [`agenda`], `chores` | what to do next |

pub mod acceptance;
pub mod agenda;
pub mod autopilot;
mod chores;
mod console;
mod control;
mod controller;
mod dispatch;
mod filters;
mod get_set;
pub mod health;
mod identity;
mod log;
pub mod outgoing;
mod payloads;
pub mod publisher;
mod receive;
mod record;
mod requests;
mod restart;
mod sending;
mod sensors;
pub mod services;
pub mod store;
pub mod temperature;
pub mod thermometer;
mod transmission;
pub mod trust;

use dronecan_wire::{NodeId, Rejection};

use crate::dialect;
use crate::eeprom::Eeprom;
use crate::hardware::{Input, OUTPUTS, ShaftPulses};
use crate::monitor::{Line, Monitor, Words};
use crate::parts::outputs::Pulses;
use crate::parts::outputs::travel::Ticks;
use crate::parts::update::Update;
use crate::progmem::Progmem;
use crate::tables::Constants;
use crate::tables::condition::{Conditions, ResetCause};
use crate::tables::parameters::{Descriptions, Parameter, Parameters};
use crate::tables::publication::Publication;
use chores::Chores;
use console::Console;
use control::Control;
use filters::Filters;
use health::{Health, count};
use identity::Identity;
use record::Record;
use sensors::Sensors;
use store::Store;
use transmission::Transmission;
use trust::Receiver;

/// The time since the start.
#[derive(Default)]
pub struct Clock {
    uptime_s: u32,
    /// Start of the current second, in milliseconds.
    second_ms: u16,
}

/// The node.
pub struct Node {
    identity: Identity,
    clock: Clock,
    chores: Chores,
    /// The parameters in force.
    pub parameters: Parameters,
    store: Store,
    update: Update,
    record: Record,
    control: Control,
    sensors: Sensors,
    transmission: Transmission,
    filters: Filters,
    console: Console,
}

impl Node {
    /// A node before [`start`](Self::start).
    pub const fn new() -> Self {
        Self {
            identity: Identity::new(),
            clock: Clock { uptime_s: 0, second_ms: 0 },
            chores: Chores::NONE,
            parameters: Parameters::new(),
            store: Store::new(),
            update: Update::new(),
            record: Record::new(),
            control: Control::new(),
            sensors: Sensors::new(),
            transmission: Transmission::new(),
            filters: Filters::new(),
            console: Console::new(),
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
        self.store.identify(&mut self.identity.unique_id, eeprom, flash, noise);
        self.record.health.start(cause);
        self.record.health.set_silently(dialect::CONDITION);
        let is_lost = if dialect::HAS_REQUESTS {
            self.store.load(&mut self.parameters, eeprom, flash)
        } else {
            // Another build has saved what nobody can set here.
            self.parameters.set_defaults(flash);
            store::has_parameters(eeprom)
        };
        self.record.health.set(Conditions::PARAMETERS_LOST, is_lost);
        self.control.outputs.start(&self.parameters);
        self.control.outputs.update(&self.parameters);
        self.control.lights.update(&self.parameters);
        self.filters.are_set();
        self.identity.id = self.parameters.get(Parameter::CanNode) as u8;
        let banner = monitor.log_line(Line::Banner);
        banner.set_source(self.identity.id);
        banner.set_code(Words::RESET.number(cause.0));
        self.transmission.publisher.publish_status(0);
        self.identity.allocation.start(&self.identity.unique_id, 0);
        self.update.start(has_loader);
    }

    /// The node's ID; 0 while it has none.
    pub fn id(&self) -> u8 {
        self.identity.id
    }

    /// How the node is: its conditions and its counters.
    pub fn health(&self) -> &Health {
        &self.record.health
    }

    /// The unique ID of the hardware.
    pub fn unique_id(&self) -> &[u8; 16] {
        &self.identity.unique_id
    }

    /// The width of an output's pulse; 0 for none.
    pub fn pulse(&self, output: usize) -> Ticks {
        self.control.outputs.pulse(output)
    }

    /// Gives the pulses to the outputs of the board.
    #[inline(always)]
    pub fn show(&mut self, board: &mut impl Pulses) {
        self.control.outputs.show(board);
    }

    /// The brightness of the light, 0 to 255.
    pub fn light(&self) -> u8 {
        self.control.lights.brightness()
    }

    /// True if the program has run for a minute.
    pub fn has_run_a_minute(&self) -> bool {
        self.clock.uptime_s >= 60
    }

    /// Takes the state of the button during the last `passed_ms` milliseconds.
    pub fn read_button(&mut self, is_pressed: bool, passed_ms: u8, monitor: &mut Monitor) {
        let publisher = &mut self.transmission.publisher;
        self.sensors.read_button(is_pressed, passed_ms, publisher, monitor);
    }

    /// True if a chore is pending.
    pub fn has_chore(&self) -> bool {
        !self.chores.is_empty()
    }

    /// Does one pending chore.
    pub fn do_chore(&mut self, receiver: &mut Receiver, now_ms: u16, monitor: &mut Monitor) {
        match self.chores.take_first() {
            Chores::APPLY_PARAMETERS => self.apply_next_parameters(receiver),
            Chores::MEASURE => self.sensors.temperature.measure(&self.parameters),
            Chores::SECOND => self.second(monitor),
            Chores::MEASURE_POWER => self.sensors.measure_power(&self.parameters, now_ms),
            _ => {}
        }
    }

    /// Has the parameters applied after some were set.
    pub fn apply_parameters(&mut self) {
        self.store.save_again();
        self.control.outputs.begin_update();
        self.chores.add(Chores::APPLY_PARAMETERS);
    }

    /// Applies the parameters of the next output, and with those of the last one all others.
    fn apply_next_parameters(&mut self, receiver: &mut Receiver) {
        let row = self.row();
        let applied = self.control.outputs.update_next(&self.parameters);
        if !applied.is_last {
            self.chores.add(Chores::APPLY_PARAMETERS);
        }
        if OUTPUTS > 1 {
            receiver.forget_entries(applied.moved);
        }
        self.control.lights.update(&self.parameters);
        if row != self.row() {
            self.filters.change();
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
            self.record.lose(Rejection::Broken, data_type, transfer.source, monitor);
        }
    }

    /// Does the next step of a save. Call when there is nothing else to do.
    #[inline(always)]
    pub fn step_store(&mut self, eeprom: &mut impl Eeprom, flash: impl Progmem<Descriptions>) {
        self.store.step_once(&mut self.parameters, eeprom, flash);
    }

    /// Does the work of `passed_ms` milliseconds. Call at every tick of the millisecond clock, or
    /// after several of them.
    #[inline(always)]
    pub fn tick(
        &mut self,
        passed_ms: u8,
        now_ms: u16,
        eeprom: &mut impl Eeprom,
        flash: impl Progmem<Descriptions>,
        monitor: &mut Monitor,
    ) {
        self.store.step(&mut self.parameters, eeprom, flash);
        if self.identity.id != 0 && !self.store.is_saving() {
            self.update.step(self.identity.id, &self.parameters, eeprom);
        }
        self.transmission.publisher.tick(
            passed_ms,
            now_ms,
            self.control.autopilot.is_present(),
            &self.parameters,
        );
        if self.identity.id == 0 && self.identity.allocation.is_due(now_ms) {
            self.transmission.publisher.publish(Publication::Allocation);
        }
        if self.console.tunnel.tick(now_ms) {
            self.transmission.publisher.publish(Publication::Targetted);
        }
        if self.console.log.is_due() {
            self.transmission.publisher.publish(Publication::LogMessage);
        }
        if self.control.outputs.tick(now_ms, &self.parameters)
            && self.control.outputs.hears_nothing()
        {
            self.filters.change();
        }
        self.report_outputs();
        self.log_condition(monitor);
        if now_ms.wrapping_sub(self.clock.second_ms) >= 1000 {
            self.clock.second_ms = self.clock.second_ms.wrapping_add(1000);
            self.chores.add(Chores::SECOND);
        }
    }

    /// Logs and publishes what has changed with the outputs: their failsafes, and if the vehicle is
    /// disarmed.
    fn report_outputs(&mut self) {
        let (health, outputs) = (&mut self.record.health, &mut self.control.outputs);
        if !outputs.has_recovered() {
            health.set(Conditions::FAILSAFE, true);
        }
        if outputs.take_change() {
            if outputs.failing() != 0 {
                self.console.tell_again(Conditions::FAILSAFE);
            }
            self.transmission.publisher.publish(Publication::FailsafeOutputs);
        }
        let (is_safe, is_refused) = (outputs.safety.is_safe(), outputs.are_commands_refused());
        let is_disarmed = is_safe | is_refused | outputs.arming.is_disarmed(&self.parameters);
        health.set(Conditions::DISARMED, is_disarmed);
        if is_disarmed {
            self.console.note_disarmed(is_safe, is_refused);
        }
    }

    /// True if an entry of a command waits to be followed.
    pub fn has_entry(&self) -> bool {
        self.control.outputs.has_entry()
    }

    /// Follows the next entry of a command, and counts and logs it.
    pub fn follow_next(&mut self, now_ms: u16, monitor: &mut Monitor, board: &mut impl Pulses) {
        let followed = self.control.outputs.follow_next(
            &mut self.record.note,
            now_ms,
            &self.parameters,
            board,
        );
        if followed.line.is_refusal() {
            count(&mut self.record.health.counts.refused);
        }
        if let Some(source) = NodeId::new(followed.commander) {
            count(&mut self.record.health.counts.followed);
            let health = &mut self.record.health;
            self.control.commanded_by(source, followed.is_second, health);
        }
        self.record.log(followed.line, monitor);
        self.end_failsafe();
    }

    /// Ends the failsafe if commands are followed again.
    fn end_failsafe(&mut self) {
        if self.record.health.has(Conditions::FAILSAFE) && self.control.outputs.has_recovered() {
            if self.record.health.is_or_was_cut_off() {
                self.console.log.tell_again(Conditions::FAILSAFE);
            }
            self.record.health.set(Conditions::FAILSAFE, false);
        }
    }

    /// Does the work of each second.
    fn second(&mut self, monitor: &mut Monitor) {
        self.clock.uptime_s = self.clock.uptime_s.wrapping_add(1);
        self.filters.second();
        self.control.autopilot.second();
        self.control.outputs.second(self.clock.second_ms, &self.parameters);
        self.control.outputs.superseded.second(monitor);
        self.record.health.second();
        self.console.second();
        if self.control.outputs.is_one_of_several_failing() {
            self.transmission.publisher.publish(Publication::FailsafeOutputs);
        }
        self.sensors.second(&self.parameters, &mut self.record.health, monitor);
    }

    /// True if the serial monitor may write a character.
    pub fn takes_character(&self) -> bool {
        self.console.takes_character()
    }

    /// Keeps a character of the log, or 0 for none, for whoever reads it through the bus. Returns
    /// true if it is not for the serial port.
    pub fn keep_character(&mut self, character: u8) -> bool {
        self.console.keep_character(character)
    }

    /// The input of the ADC for the next reading.
    pub fn next_input(&self) -> Input {
        self.sensors.power.next_input(&self.parameters)
    }

    /// Takes a reading of the ADC, which measures the input `next` now.
    pub fn read_input(&mut self, reading: u16, next: Input) {
        self.sensors.read_input(reading, next, &mut self.chores);
    }

    /// True if the board should count the pulses of the shaft.
    pub fn counts_pulses(&self) -> bool {
        Sensors::counts_pulses(&self.parameters)
    }

    /// Takes the pulses of the shaft since the last call. Call it each millisecond.
    pub fn read_shaft(&mut self, pulses: ShaftPulses, now_ms: u16, monitor: &mut Monitor) {
        self.sensors.read_shaft(pulses, now_ms, &self.parameters, monitor);
    }

    /// Logs the counters.
    pub fn report(&self, monitor: &mut Monitor) {
        self.record.health.report(monitor);
        self.control.outputs.superseded.report(monitor);
    }
}

#[cfg(all(test, not(feature = "draft")))]
mod tests;
