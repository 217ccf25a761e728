//! What the payload of each message has. The table of sent messages names these methods. Each
//! returns false if there is nothing to send now.

use dronecan_wire::float16;

use super::Node;
use super::console::Console;
use super::control::Control;
use super::health::Health;
use super::outgoing::Outgoing;
use super::record::Record;
use super::sensors::Sensors;
use crate::dialect;
use crate::hardware::CanCounters;
use crate::tables::parameters::{OutputParameter, Parameter, Parameters};

/// NodeStatus mode (DSDL 341.NodeStatus.uavcan): the node works.
const MODE_OPERATIONAL: u8 = 0;
/// The node has measured no temperature yet.
const MODE_INITIALIZATION: u8 = 1;
/// The node has answered that it updates itself, and ends its program soon.
const MODE_SOFTWARE_UPDATE: u8 = 3;

/// Where a payload goes, and what else it needs.
#[allow(dead_code, reason = "a build may have no message that needs one")]
pub struct Filling<'a, C> {
    /// The transfer.
    pub outgoing: &'a mut Outgoing,
    /// The parameters in force.
    pub parameters: &'a Parameters,
    /// The counters of the controller.
    pub counters: &'a C,
    /// The time, in milliseconds.
    pub now_ms: u16,
}

/// The payloads that need more than one group of the node.
#[allow(dead_code, reason = "a build may leave out the row that names one")]
impl Node {
    /// NodeStatus, also as the first bytes of a GetNodeInfo response.
    #[inline(never)]
    pub(super) fn put_status(&mut self, now_ms: u16) -> bool {
        let code = self.record.health.code();
        let level = Health::level(code, &self.parameters, self.control.outputs.excused(now_ms));
        let mode = self.mode();
        let outgoing = &mut self.transmission.outgoing;
        let len = dialect::put_status(self.clock.uptime_s, level, mode, code, &mut |word| {
            outgoing.put16(word);
        });
        self.transmission.outgoing.payload.len = len;
        true
    }

    /// The mode in NodeStatus.
    #[inline(never)]
    fn mode(&self) -> u8 {
        if self.update.is_answered() {
            MODE_SOFTWARE_UPDATE
        } else if self.sensors.temperature.is_known() {
            MODE_OPERATIONAL
        } else {
            MODE_INITIALIZATION
        }
    }

    /// actuator.Status of the next output.
    #[inline(always)]
    pub(super) fn put_actuator_status(&mut self, _now_ms: u16) -> bool {
        let Some(output) = self.control.outputs.next_to_report() else { return false };
        self.transmission.outgoing.put8(self.parameters.of(output, OutputParameter::Id) as u8);
        self.transmission.outgoing.put16(self.control.outputs.position(output));
        // Force and speed are not measured.
        self.transmission.outgoing.put16(float16::NAN);
        self.transmission.outgoing.put16(float16::NAN);
        self.transmission
            .outgoing
            .put8(self.sensors.power.rating_percent(output, &self.parameters));
        true
    }

    /// LogMessage.
    pub(super) fn put_log_message(&mut self, now_ms: u16) -> bool {
        let outgoing = &mut self.transmission.outgoing;
        let now = self.record.health.conditions;
        self.console.log.take(now, now_ms, |byte| outgoing.put8(byte))
    }

    /// Allocation: the next part of the request.
    pub(super) fn put_allocation(&mut self, now_ms: u16) -> bool {
        self.identity.allocation.request(&self.identity.unique_id, now_ms, |byte| {
            self.transmission.outgoing.put8(byte)
        });
        true
    }
}

#[allow(dead_code, reason = "a build may leave out the row that names one")]
impl Sensors {
    /// device.Temperature.
    pub fn put_temperature<C: CanCounters>(&mut self, filling: &mut Filling<C>) -> bool {
        filling.outgoing.put16(filling.parameters.get(Parameter::TempId));
        filling.outgoing.put16(float16::from_fixed(self.temperature.kelvin_64ths(), 6));
        filling.outgoing.put8(self.temperature.flags());
        true
    }

    /// The temperature in degrees Celsius, as the thesis's node measured it.
    pub fn put_degrees_celsius<C: CanCounters>(&mut self, filling: &mut Filling<C>) -> bool {
        filling.outgoing.put8(self.temperature.celsius().clamp(0, 255) as u8);
        true
    }

    /// The presses of the button.
    pub fn put_presses<C: CanCounters>(&mut self, filling: &mut Filling<C>) -> bool {
        filling.outgoing.put8(self.button.count() as u8);
        true
    }

    /// KeyValue: the presses of the button.
    pub fn put_key_value<C: CanCounters>(&mut self, filling: &mut Filling<C>) -> bool {
        put_float32(filling.outgoing, self.button.count());
        filling.outgoing.put16(u16::from_le_bytes(*b"bt"));
        filling.outgoing.put8(b'n');
        true
    }

    /// indication.Button.
    pub fn put_button<C: CanCounters>(&mut self, filling: &mut Filling<C>) -> bool {
        /// BUTTON_SAFETY.
        const SAFETY: u8 = 1;
        filling.outgoing.put8(SAFETY);
        filling.outgoing.put8(self.button.press_time_ds());
        true
    }

    /// CircuitStatus.
    pub fn put_circuit_status<C: CanCounters>(&mut self, filling: &mut Filling<C>) -> bool {
        filling.outgoing.put16(filling.parameters.get(Parameter::Pwr1Id));
        filling.outgoing.put16(self.power.voltage());
        filling.outgoing.put16(self.power.current());
        filling.outgoing.put8(self.power.flags());
        self.power.is_known()
    }

    /// BatteryInfo.
    pub fn put_battery_info<C: CanCounters>(&mut self, filling: &mut Filling<C>) -> bool {
        self.put_battery(filling.parameters, filling.outgoing)
    }

    #[inline(never)]
    fn put_battery(&self, parameters: &Parameters, outgoing: &mut Outgoing) -> bool {
        let heat = &self.temperature;
        let heat = heat.has_sensor().then_some((heat.kelvin_64ths(), heat.flags()));
        self.battery.put(&self.power, heat, parameters, |word| outgoing.put16(word));
        outgoing.put8(parameters.get(Parameter::BattId) as u8);
        // No number of the model, and no name.
        outgoing.put16(0);
        outgoing.put16(0);
        self.power.is_known()
    }

    /// RPM.
    pub fn put_rpm<C: CanCounters>(&mut self, filling: &mut Filling<C>) -> bool {
        let parameters = filling.parameters;
        filling.outgoing.put8(parameters.get(Parameter::RpmId) as u8);
        let pulses = parameters.get(Parameter::RpmPulses) as u8;
        self.shaft.put(pulses, filling.now_ms, |word| filling.outgoing.put16(word));
        true
    }
}

#[allow(dead_code, reason = "a build may leave out the row that names one")]
impl Control {
    /// KeyValue: the outputs in failsafe.
    pub fn put_failsafe_outputs<C: CanCounters>(&mut self, filling: &mut Filling<C>) -> bool {
        put_float32(filling.outgoing, self.outputs.failing().into());
        filling.outgoing.put16(u16::from_le_bytes(*b"fs"));
        true
    }

    /// hardpoint.Status.
    #[inline(never)]
    pub fn put_hardpoint_status<C: CanCounters>(&mut self, filling: &mut Filling<C>) -> bool {
        let Some((id, holds)) = self.outputs.next_relay() else { return false };
        filling.outgoing.put8(id);
        // The weight of the payload, and its variance, are not measured.
        filling.outgoing.put16(float16::NAN);
        filling.outgoing.put16(float16::NAN);
        filling.outgoing.put16(holds.into());
        true
    }
}

#[allow(dead_code, reason = "a build may leave out the row that names one")]
impl Record {
    /// CanStats.
    pub fn put_can_stats<C: CanCounters>(&mut self, filling: &mut Filling<C>) -> bool {
        // The only interface.
        filling.outgoing.put8(0);
        let Filling { outgoing, counters, .. } = filling;
        self.stats.put_can(*counters, |word| outgoing.put16(word));
        true
    }
}

#[allow(dead_code, reason = "a build may leave out the row that names one")]
impl Console {
    /// tunnel.Targetted.
    pub fn put_targetted<C: CanCounters>(&mut self, filling: &mut Filling<C>) -> bool {
        self.tunnel.take(filling.now_ms, |byte| filling.outgoing.put8(byte));
        true
    }
}

#[allow(dead_code, reason = "a build may have no KeyValue")]
#[inline(never)]
fn put_float32(outgoing: &mut Outgoing, number: u16) {
    let [high, low] = float16::to_float32(number);
    outgoing.put16(low);
    outgoing.put16(high);
}
