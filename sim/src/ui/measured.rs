//! What the node measures, as its last messages say. A message that the views show as a reading has
//! a field here, and a line in [`Measured::keep`].

use bench::dronecan::{BatteryInfo, CircuitStatus, Decoded, Message, Rpm, Temperature, draft};
use std::collections::BTreeMap;

/// The node's last measurements; each is empty before its first message.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    pub temperature: Option<Temperature>,
    pub circuit: Option<CircuitStatus>,
    pub battery: Option<BatteryInfo>,
    pub rpm: Option<Rpm>,
    /// Last hardpoint.Status of each relay, by ID.
    pub hardpoints: BTreeMap<u8, u16>,
    /// The temperature in the thesis's message, in degrees Celsius.
    pub thesis_temperature_c: Option<u8>,
    /// The measurement in the draft: degrees Celsius, or the presses of the button.
    pub draft_measurement: Option<u8>,
}

impl Measured {
    /// Keeps the measurement in a transfer of the node.
    pub fn keep(&mut self, transfer: &Decoded) {
        match transfer {
            Decoded::V0(_, Message::Temperature(temperature)) => {
                self.temperature = Some(*temperature);
            }
            Decoded::V0(_, Message::CircuitStatus(circuit)) => self.circuit = Some(*circuit),
            Decoded::V0(_, Message::Rpm(rpm)) => self.rpm = Some(*rpm),
            Decoded::V0(_, Message::HardpointStatus(status)) => {
                self.hardpoints.insert(status.hardpoint, status.status);
            }
            Decoded::V0(_, Message::BatteryInfo(battery)) => {
                self.battery = Some(battery.as_ref().clone());
            }
            Decoded::V0(_, Message::ThesisTemperature(degrees)) => {
                self.thesis_temperature_c = Some(*degrees);
            }
            Decoded::Draft(_, draft::Message::ThesisMeasurement(number)) => {
                self.draft_measurement = Some(*number);
            }
            _ => {}
        }
    }

    /// The measurements that the plain view prints when they change: topic and text, which is empty
    /// before the first message.
    pub fn printed(&self) -> [(&'static str, String); 3] {
        [
            ("power", self.circuit.map_or(String::new(), |circuit| circuit.to_string())),
            ("power", self.battery.as_ref().map_or(String::new(), BatteryInfo::to_string)),
            ("shaft", self.rpm.map_or(String::new(), |rpm| rpm.to_string())),
        ]
    }
}
