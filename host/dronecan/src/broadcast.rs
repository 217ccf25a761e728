//! Payloads of other broadcast messages: Allocation, lights, switches, sensors, counters, named
//! values.
//!
//! Layouts from the public DSDL, little endian.

use super::fields::{decode, payload};
use super::id::UNIQUE_ID_LEN;
use super::text::{flags, hex};
use half::f16;
use std::fmt;

payload! {
    /// protocol.dynamic_node_id.Allocation.
    #[derive(Clone, Debug, Default, PartialEq, Eq)]
    pub struct Allocation {
        /// The requested or granted ID; 0 in a request means any, in an answer none yet.
        pub node_id: u8 as 7,
        /// True in the request with the first part of the unique ID.
        pub first_part: bool as 1,
        /// In a request the next part; in an answer all parts so far.
        pub unique_id: Vec<u8> as UNIQUE_ID_LEN as u32,
    }
}

impl fmt::Display for Allocation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.node_id != 0 {
            write!(f, "node ID {} ", self.node_id)?;
        }
        if self.first_part {
            write!(f, "first part ")?;
        }
        write!(f, "unique ID {}", hex(&self.unique_id))
    }
}

payload! {
    /// One element of equipment.indication.LightsCommand.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct LightCommand [20] {
        pub light: u8,
        /// 0 to 31.
        pub red: u8 as 5,
        /// 0 to 63.
        pub green: u8 as 6,
        /// 0 to 31.
        pub blue: u8 as 5,
    }
}

impl fmt::Display for LightCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "id {} red {} green {} blue {}", self.light, self.red, self.green, self.blue)
    }
}

payload! {
    /// equipment.power.CircuitStatus, in volts and amperes.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct CircuitStatus {
        pub circuit: u16,
        pub voltage: f16,
        pub current: f16,
        /// Error flags, including unknown ones.
        pub errors: u8,
    }
}

/// Names of the error flags, from bit 0 on.
const CIRCUIT_ERRORS: [&str; 3] = ["OVERVOLTAGE", "UNDERVOLTAGE", "OVERCURRENT"];

impl CircuitStatus {
    /// The errors as text, with a space before each. Unknown flags are a number.
    pub fn errors_text(&self) -> String {
        flags(self.errors.into(), &CIRCUIT_ERRORS, 4)
    }
}

impl fmt::Display for CircuitStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "circuit {}", self.circuit)?;
        if !self.voltage.is_nan() {
            write!(f, " {:.2} V", self.voltage.to_f32())?;
        }
        if !self.current.is_nan() {
            write!(f, " {:.2} A", self.current.to_f32())?;
        }
        write!(f, "{}", self.errors_text())
    }
}

payload! {
    /// equipment.hardpoint.Status: the weight is in newtons; a status of 0 is released, 1 and above
    /// held.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct HardpointStatus {
        pub hardpoint: u8,
        pub weight: f16,
        pub weight_variance: f16,
        pub status: u16,
    }
}

impl fmt::Display for HardpointStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.hardpoint, hardpoint_text(self.status))?;
        if !self.weight.is_nan() {
            write!(f, " {:.1} N", self.weight.to_f32())?;
        }
        Ok(())
    }
}

payload! {
    /// equipment.hardpoint.Command: a command of 0 is to release, 1 and above to hold.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct HardpointCommand {
        pub hardpoint: u8,
        pub command: u16,
    }
}

impl fmt::Display for HardpointCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.hardpoint, hardpoint_text(self.command))
    }
}

/// What a hardpoint is asked to do, or does.
pub fn hardpoint_text(command: u16) -> String {
    match command {
        0 => String::from("release"),
        1 => String::from("hold"),
        other => format!("hold {other}"),
    }
}

payload! {
    /// equipment.device.Temperature.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Temperature {
        pub device: u16,
        pub kelvin: f16,
        void 6,
        pub under: bool as 1,
        pub over: bool as 1,
    }
}

const ZERO_CELSIUS_K: f32 = 273.15;

impl Temperature {
    /// The temperature in degrees Celsius.
    pub fn celsius(&self) -> f32 {
        self.kelvin.to_f32() - ZERO_CELSIUS_K
    }
}

impl fmt::Display for Temperature {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (kelvin, celsius) = (self.kelvin.to_f32(), self.celsius());
        write!(f, "device {} {kelvin:.2} K ({celsius:.1} C)", self.device)?;
        if self.over {
            write!(f, " OVER")?;
        }
        if self.under {
            write!(f, " UNDER")?;
        }
        Ok(())
    }
}

payload! {
    /// dronecan.sensors.rpm.RPM: revolutions a minute.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Rpm {
        pub sensor: u8,
        pub flags: u16,
        pub rpm: f32,
    }
}

impl Rpm {
    /// Flag: the sensor is not healthy.
    pub const UNHEALTHY: u16 = 1;

    /// The speed without a unit. Speeds below 100 have a decimal place.
    pub fn speed_text(&self) -> String {
        let decimals = usize::from(self.rpm != 0.0 && self.rpm.abs() < 100.0);
        format!("{:.decimals$}", self.rpm)
    }
}

impl fmt::Display for Rpm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} rpm", self.sensor, self.speed_text())?;
        if self.flags & Rpm::UNHEALTHY != 0 {
            write!(f, " UNHEALTHY")?;
        }
        Ok(())
    }
}

payload! {
    /// dronecan.protocol.CanStats.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct CanStats {
        pub interface: u8,
        pub tx_requests: u32,
        pub tx_rejected: u16,
        pub tx_overflow: u16,
        pub tx_success: u16,
        pub tx_timedout: u16,
        pub tx_abort: u16,
        pub rx_received: u32,
        pub rx_overflow: u16,
        pub rx_errors: u16,
        pub busoff_errors: u16,
    }
}

impl fmt::Display for CanStats {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "interface {} out {}/{}", self.interface, self.tx_success, self.tx_requests)?;
        let faults = [
            ("rejected", self.tx_rejected),
            ("overflow", self.tx_overflow),
            ("timed out", self.tx_timedout),
            ("aborted", self.tx_abort),
        ];
        write_faults(f, &faults)?;
        write!(f, ", in {}", self.rx_received)?;
        let faults = [
            ("overflow", self.rx_overflow),
            ("errors", self.rx_errors),
            ("bus-off", self.busoff_errors),
        ];
        write_faults(f, &faults)
    }
}

/// Writes the counts that are not 0.
fn write_faults(f: &mut fmt::Formatter<'_>, faults: &[(&str, u16)]) -> fmt::Result {
    let mut counted = faults.iter().filter(|(_, count)| *count != 0);
    counted.try_for_each(|(name, count)| write!(f, " {name} {count}"))
}

/// protocol.debug.LogMessage: `level u3 | source u8[<=31] | text`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LogMessage {
    /// 0 DEBUG, 1 INFO, 2 WARNING, 3 ERROR.
    pub level: u8,
    /// The part of the node that says it.
    pub source: Vec<u8>,
    /// What it says.
    pub text: Vec<u8>,
}

impl LogMessage {
    /// `None` if the payload is too short.
    pub fn decode(payload: &[u8]) -> Option<LogMessage> {
        let (&first, rest) = payload.split_first()?;
        let (source, text) = rest.split_at_checked(usize::from(first & 0x1F))?;
        Some(LogMessage { level: first >> 5, source: source.to_vec(), text: text.to_vec() })
    }

    /// The payload.
    pub fn encode(&self) -> Vec<u8> {
        let first = self.level << 5 | self.source.len() as u8 & 0x1F;
        [&[first], self.source.as_slice(), &self.text].concat()
    }
}

impl fmt::Display for LogMessage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.level {
            0 => write!(f, "DEBUG")?,
            1 => write!(f, "INFO")?,
            2 => write!(f, "WARNING")?,
            3 => write!(f, "ERROR")?,
            level => write!(f, "level {level}")?,
        }
        if !self.source.is_empty() {
            write!(f, " from {}", self.source.escape_ascii())?;
        }
        write!(f, ": {}", self.text.escape_ascii())
    }
}

payload! {
    /// protocol.debug.KeyValue.
    #[derive(Clone, Debug, Default, PartialEq)]
    pub struct KeyValue {
        pub value: f32,
        pub key: Vec<u8>,
    }
}

impl fmt::Display for KeyValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} = {}", self.key.escape_ascii(), self.value)
    }
}

payload! {
    /// ardupilot.indication.Button.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct Button {
        /// Number of the button; 1 is the safety switch.
        pub button: u8,
        /// How long it has been pressed, in tenths of a second.
        pub tenths: u8,
    }
}

impl fmt::Display for Button {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Button { button, tenths } = self;
        write!(f, "{button} pressed for {}.{} s", tenths / 10, tenths % 10)
    }
}

/// VEHICLE_STATE_* of ardupilot.indication.NotifyState, by bit.
const VEHICLE_STATES: [&str; 24] = [
    "initialising",
    "armed",
    "flying",
    "prearm",
    "prearm GPS",
    "save trim",
    "ESC calibration",
    "failsafe radio",
    "failsafe battery",
    "failsafe GCS",
    "chute released",
    "EKF bad",
    "firmware update",
    "magcal run",
    "leak detected",
    "GPS fusion",
    "GPS glitch",
    "position absolute",
    "lost",
    "throw ready",
    "powering off",
    "video recording",
    "is landing",
    "is taking off",
];

/// Type of the auxiliary data: VEHICLE_YAW_EARTH_CENTIDEGREES, u16, counter-clockwise from north.
const YAW: u8 = 0;

/// ardupilot.indication.NotifyState: type of the auxiliary data u8 | its length u8 | the data |
/// state u64.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NotifyState {
    /// What the auxiliary data is: 0 is a heading.
    pub aux_data_type: u8,
    /// At most 255 bytes.
    pub aux_data: Vec<u8>,
    /// A bit for each state of the vehicle.
    pub vehicle_state: u64,
}

impl NotifyState {
    /// `None` unless the lengths are right.
    pub fn decode(payload: &[u8]) -> Option<NotifyState> {
        let (&[aux_data_type, len], rest) = payload.split_first_chunk()?;
        let (aux_data, state) = rest.split_at_checked(len.into())?;
        Some(NotifyState {
            aux_data_type,
            aux_data: aux_data.to_vec(),
            vehicle_state: u64::from_le_bytes(state.try_into().ok()?),
        })
    }

    /// The payload.
    pub fn encode(&self) -> Vec<u8> {
        let mut payload = vec![self.aux_data_type, self.aux_data.len() as u8];
        payload.extend(&self.aux_data);
        payload.extend(self.vehicle_state.to_le_bytes());
        payload
    }
}

impl fmt::Display for NotifyState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.aux_data_type, &self.aux_data[..]) {
            (YAW, &[low, high]) => {
                // Clockwise, as a compass shows it.
                let degrees = f64::from(u16::from_le_bytes([low, high])) / 100.0;
                write!(f, "heading {:.0}", (360.0 - degrees).rem_euclid(360.0))?;
            }
            (kind, data) => write!(f, "auxiliary data {kind}: {} bytes", data.len())?,
        }
        let mut separator = "; ";
        for (bit, name) in VEHICLE_STATES.iter().enumerate() {
            if self.vehicle_state >> bit & 1 != 0 {
                write!(f, "{separator}{name}")?;
                separator = ", ";
            }
        }
        match self.vehicle_state >> VEHICLE_STATES.len() << VEHICLE_STATES.len() {
            0 => Ok(()),
            unknown => write!(f, "{separator}{unknown:#x}"),
        }
    }
}

/// A payload of one byte; `None` for another length.
pub(crate) fn decode_byte(payload: &[u8]) -> Option<u8> {
    decode(payload, 8)
}

/// The payload of one byte.
pub(crate) fn encode_byte(byte: &u8) -> Vec<u8> {
    vec![*byte]
}

/// Writes an ArmingStatus.
pub(crate) fn write_arming(f: &mut fmt::Formatter<'_>, status: &u8) -> fmt::Result {
    match status {
        0 => write!(f, " disarmed"),
        255 => write!(f, " armed"),
        other => write!(f, " {other}"),
    }
}

/// Writes a SafetyState: the state of the switch.
pub(crate) fn write_safety(f: &mut fmt::Formatter<'_>, state: &u8) -> fmt::Result {
    match state {
        0 => write!(f, " on"),
        255 => write!(f, " off"),
        other => write!(f, " {other}"),
    }
}

/// Writes degrees Celsius.
pub(crate) fn write_celsius(f: &mut fmt::Formatter<'_>, celsius: &u8) -> fmt::Result {
    write!(f, " {celsius} C")
}
