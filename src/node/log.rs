//! The begin and the end of each condition, as a line of the serial monitor and as a LogMessage.

use super::{Node, console};
use crate::hardware::OUTPUTS;
use crate::monitor::{self, Change, Event, Line, Monitor};
use crate::tables::condition::Conditions;

impl Node {
    /// Logs the next condition that has changed.
    #[inline(never)]
    pub(super) fn log_condition(&mut self, monitor: &mut Monitor) {
        if monitor::IS_THERE
            && let Some(change) = self.console.next_change(self.record.health.conditions)
        {
            self.describe(change, monitor.log_line(Line::Over));
        }
    }

    /// Begins a LogMessage, if one is to be sent and the serial monitor can make its text.
    #[inline(always)]
    pub fn begin_log_message(&mut self, now_ms: u16, monitor: &mut Monitor) {
        if monitor.is_between_lines()
            && let Some(change) = self.console.log.begin(self.record.health.conditions, now_ms)
        {
            self.describe(change, monitor.next_event());
            monitor.send_first();
        }
    }

    /// Describes the begin or the end of a condition.
    fn describe(&self, change: Change, event: &mut Event) {
        const CONTROLLER: u8 = Conditions::CONTROLLER.number();
        const TEMPERATURE: u8 = Conditions::TEMPERATURE.number();
        const FAILSAFE: u8 = Conditions::FAILSAFE.number();
        const RUNNING: u8 = console::RUNNING.number();
        const DISARMED: u8 = Conditions::DISARMED.number();
        event.set_a(self.record.health.counts.overruns);
        let mut line = Line::of_condition(change.number);
        if change.number == RUNNING {
            event.set_line(Line::Running);
            return;
        }
        if change.number == TEMPERATURE {
            if self.sensors.temperature.is_sensor_faulty() {
                line = Line::SensorFault;
            }
        } else if change.number == CONTROLLER {
            let (last, number) = self.console.controller;
            line = last;
            event.set_a(number);
        } else if console::HAS_CAUSES && change.number == DISARMED {
            line = self.console.disarmed;
        }
        event.set_code(line.word());
        if !change.begins {
            line = Line::Over;
        } else if OUTPUTS > 1 && change.number == FAILSAFE {
            let outputs = self.control.outputs.reported();
            if outputs != 0 {
                line = Line::FailsafeOf;
                event.set_code(outputs);
            }
        }
        event.set_line(line);
    }
}
