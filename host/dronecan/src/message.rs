//! Payloads that are decoded completely, and their text for the traffic view.
//!
//! Layouts from the public DSDL; little endian throughout, float16 by the crate `half`.

use super::battery::BatteryInfo;
use super::broadcast::{
    Allocation, CanStats, CircuitStatus, HardpointStatus, KeyValue, LightCommand, LogMessage, Rpm,
    hardpoint_text,
};
use super::esc;
use super::management::{
    self, NodeInfo, NumberAndText, Opcode, ParameterRequest, ParameterResponse, TransportStats,
};
use super::status::NodeStatus;
use super::text::{list, write_raw};
use super::{id::CanId, transfer::Transfer, types, types::DataType};
use half::f16;
use std::fmt;

/// Unit of an actuator command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandUnit {
    /// -1 to +1, without a unit.
    Unitless,
    /// Radians of a servo, metres of a linear actuator.
    Position,
    Force,
    Speed,
    /// Pulse width in microseconds.
    Pwm,
    Unknown(u8),
}

impl CommandUnit {
    fn from_field(field: u8) -> CommandUnit {
        match field {
            0 => CommandUnit::Unitless,
            1 => CommandUnit::Position,
            2 => CommandUnit::Force,
            3 => CommandUnit::Speed,
            4 => CommandUnit::Pwm,
            other => CommandUnit::Unknown(other),
        }
    }

    fn field(self) -> u8 {
        match self {
            CommandUnit::Unitless => 0,
            CommandUnit::Position => 1,
            CommandUnit::Force => 2,
            CommandUnit::Speed => 3,
            CommandUnit::Pwm => 4,
            CommandUnit::Unknown(other) => other,
        }
    }
}

impl fmt::Display for CommandUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            CommandUnit::Unitless => f.pad("unitless"),
            CommandUnit::Position => f.pad("position"),
            CommandUnit::Force => f.pad("force"),
            CommandUnit::Speed => f.pad("speed"),
            CommandUnit::Pwm => f.pad("PWM"),
            CommandUnit::Unknown(other) => write!(f, "type {other}"),
        }
    }
}

/// One element of equipment.actuator.ArrayCommand: id u8 | type u8 | value float16.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActuatorCommand {
    pub actuator: u8,
    pub unit: CommandUnit,
    pub value: f16,
}

/// Length of one command in an ArrayCommand, in bytes.
const COMMAND_BYTES: usize = 4;

impl ActuatorCommand {
    /// The commands in a payload; `None` unless it has 0 to 15 complete ones.
    pub fn decode_array(payload: &[u8]) -> Option<Vec<ActuatorCommand>> {
        let (commands, rest) = payload.as_chunks::<COMMAND_BYTES>();
        if !rest.is_empty() || commands.len() > 15 {
            return None;
        }
        let decode = |&[actuator, unit, low, high]: &[u8; COMMAND_BYTES]| ActuatorCommand {
            actuator,
            unit: CommandUnit::from_field(unit),
            value: f16::from_le_bytes([low, high]),
        };
        Some(commands.iter().map(decode).collect())
    }

    /// The payload of an ArrayCommand.
    pub fn encode_array(commands: &[ActuatorCommand]) -> Vec<u8> {
        let encode = |command: &ActuatorCommand| {
            let [low, high] = command.value.to_le_bytes();
            [command.actuator, command.unit.field(), low, high]
        };
        commands.iter().flat_map(encode).collect()
    }
}

impl fmt::Display for ActuatorCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = self.value.to_f32();
        write!(f, "id {} {} ", self.actuator, self.unit)?;
        match self.unit {
            CommandUnit::Pwm => write!(f, "{value:.0} us"),
            CommandUnit::Position => write!(f, "{value:+.2} rad"),
            _ => write!(f, "{value:+.2}"),
        }
    }
}

/// equipment.actuator.Status: `id u8 | position f16 | force f16 | speed f16 | power_percent[6:0]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActuatorStatus {
    pub actuator: u8,
    pub position: f16,
    pub force: f16,
    pub speed: f16,
    /// 0 to 100; 127 means unknown.
    pub power_percent: u8,
}

const POWER_MASK: u8 = 0x7F;

impl ActuatorStatus {
    /// `None` unless the payload has eight bytes.
    pub fn decode(payload: &[u8]) -> Option<ActuatorStatus> {
        let &[actuator, p0, p1, f0, f1, s0, s1, power] = payload else {
            return None;
        };
        Some(ActuatorStatus {
            actuator,
            position: f16::from_le_bytes([p0, p1]),
            force: f16::from_le_bytes([f0, f1]),
            speed: f16::from_le_bytes([s0, s1]),
            power_percent: power & POWER_MASK,
        })
    }

    /// The payload.
    pub fn encode(&self) -> Vec<u8> {
        let mut payload = vec![self.actuator];
        for value in [self.position, self.force, self.speed] {
            payload.extend(value.to_le_bytes());
        }
        payload.push(self.power_percent & POWER_MASK);
        payload
    }
}

impl fmt::Display for ActuatorStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "id {} position {:+.2}", self.actuator, self.position.to_f32())?;
        if !self.force.is_nan() {
            write!(f, " force {:.2}", self.force.to_f32())?;
        }
        if !self.speed.is_nan() {
            write!(f, " speed {:.2}", self.speed.to_f32())?;
        }
        if self.power_percent != 127 {
            write!(f, " power {} %", self.power_percent)?;
        }
        Ok(())
    }
}

/// equipment.device.Temperature: device u16 | kelvin f16 | flags u8 (1 too hot, 2 too cold).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Temperature {
    pub device: u16,
    pub kelvin: f16,
    pub over: bool,
    pub under: bool,
}

const FLAG_OVER: u8 = 1 << 0;
const FLAG_UNDER: u8 = 1 << 1;
const ZERO_CELSIUS_K: f32 = 273.15;

impl Temperature {
    /// `None` unless the payload has five bytes.
    pub fn decode(payload: &[u8]) -> Option<Temperature> {
        let &[d0, d1, k0, k1, flags] = payload else {
            return None;
        };
        Some(Temperature {
            device: u16::from_le_bytes([d0, d1]),
            kelvin: f16::from_le_bytes([k0, k1]),
            over: flags & FLAG_OVER != 0,
            under: flags & FLAG_UNDER != 0,
        })
    }

    /// The payload.
    pub fn encode(&self) -> Vec<u8> {
        let mut payload = self.device.to_le_bytes().to_vec();
        payload.extend(self.kelvin.to_le_bytes());
        let over = if self.over { FLAG_OVER } else { 0 };
        let under = if self.under { FLAG_UNDER } else { 0 };
        payload.push(over | under);
        payload
    }

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

/// A decoded transfer. `Display` gives "ArrayCommand id 1 unitless +0.50".
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    NodeStatus(NodeStatus),
    Allocation(Allocation),
    ArrayCommand(Vec<ActuatorCommand>),
    ActuatorStatus(ActuatorStatus),
    Temperature(Temperature),
    CircuitStatus(CircuitStatus),
    BatteryInfo(Box<BatteryInfo>),
    /// The hardpoint, and 0 to release it or another number to hold.
    HardpointCommand(u8, u16),
    HardpointStatus(HardpointStatus),
    Rpm(Rpm),
    /// For each motor -8192 to 8191.
    RawCommand(Vec<i16>),
    LightsCommand(Vec<LightCommand>),
    /// 255 is fully armed, 0 disarmed.
    ArmingStatus(u8),
    /// ArduPilot's safety switch. At 255 ("off") outputs are enabled, at 0 ("on") disabled.
    SafetyState(u8),
    /// The number of a button (1 is the safety switch), and for how many tenths of a second it has
    /// been pressed.
    Button(u8, u8),
    CanStats(CanStats),
    KeyValue(KeyValue),
    LogMessage(LogMessage),
    /// Servo command of the thesis, 0 to 255 over the full travel.
    ThesisCommand(u8),
    /// The thesis's temperature in degrees Celsius.
    ThesisTemperature(u8),
    NodeInfoRequest,
    NodeInfo(Box<NodeInfo>),
    ParameterRequest(ParameterRequest),
    ParameterResponse(ParameterResponse),
    ExecuteOpcode(Opcode),
    /// True if the opcode was executed.
    OpcodeExecuted(bool),
    /// The magic number.
    RestartNode(u64),
    /// True if the node restarts.
    Restarting(bool),
    /// Node with the file (0: the sender of the request), and the file's path.
    BeginUpdate(NumberAndText),
    /// Error (0: none), and the reason.
    UpdateBegun(NumberAndText),
    TransportStatsRequest,
    TransportStats(TransportStats),
    /// A type that is not decoded, or a payload that does not fit its type: name and bytes.
    Other {
        name: String,
        payload: Vec<u8>,
    },
}

impl Message {
    /// Decodes a transfer. Never fails: what cannot be decoded is `Other`.
    pub fn decode(transfer: &Transfer) -> Message {
        let payload = transfer.payload.as_slice();
        Message::decode_known(transfer.id, payload).unwrap_or_else(|| Message::Other {
            name: name_of(transfer.id),
            payload: payload.to_vec(),
        })
    }

    fn decode_known(id: CanId, payload: &[u8]) -> Option<Message> {
        let data_type = DataType::of(id)?;
        match id {
            CanId::Service { request: true, .. } => Message::decode_request(data_type, payload),
            CanId::Service { request: false, .. } => Message::decode_response(data_type, payload),
            _ => Message::decode_message(data_type, payload),
        }
    }

    fn decode_message(data_type: &DataType, payload: &[u8]) -> Option<Message> {
        let byte = || match *payload {
            [byte] => Some(byte),
            _ => None,
        };
        match *data_type {
            types::NODE_STATUS => NodeStatus::decode(payload).map(Message::NodeStatus),
            types::ALLOCATION => Allocation::decode(payload).map(Message::Allocation),
            types::ARRAY_COMMAND => {
                ActuatorCommand::decode_array(payload).map(Message::ArrayCommand)
            }
            types::ACTUATOR_STATUS => ActuatorStatus::decode(payload).map(Message::ActuatorStatus),
            types::TEMPERATURE => Temperature::decode(payload).map(Message::Temperature),
            types::CIRCUIT_STATUS => CircuitStatus::decode(payload).map(Message::CircuitStatus),
            types::BATTERY_INFO => {
                BatteryInfo::decode(payload).map(|info| Message::BatteryInfo(Box::new(info)))
            }
            types::HARDPOINT_COMMAND => match *payload {
                [hardpoint, low, high] => {
                    let command = u16::from_le_bytes([low, high]);
                    Some(Message::HardpointCommand(hardpoint, command))
                }
                _ => None,
            },
            types::HARDPOINT_STATUS => {
                HardpointStatus::decode(payload).map(Message::HardpointStatus)
            }
            types::RPM => Rpm::decode(payload).map(Message::Rpm),
            types::RAW_COMMAND => esc::decode_commands(payload).map(Message::RawCommand),
            types::LIGHTS_COMMAND => {
                LightCommand::decode_array(payload).map(Message::LightsCommand)
            }
            types::ARMING_STATUS => byte().map(Message::ArmingStatus),
            types::SAFETY_STATE => byte().map(Message::SafetyState),
            types::BUTTON => match *payload {
                [button, tenths] => Some(Message::Button(button, tenths)),
                _ => None,
            },
            types::CAN_STATS => CanStats::decode(payload).map(Message::CanStats),
            types::KEY_VALUE => KeyValue::decode(payload).map(Message::KeyValue),
            types::LOG_MESSAGE => LogMessage::decode(payload).map(Message::LogMessage),
            types::THESIS_COMMAND => byte().map(Message::ThesisCommand),
            types::THESIS_TEMPERATURE => byte().map(Message::ThesisTemperature),
            _ => None,
        }
    }

    fn decode_request(data_type: &DataType, payload: &[u8]) -> Option<Message> {
        let empty = |message| payload.is_empty().then_some(message);
        match *data_type {
            types::GET_NODE_INFO => empty(Message::NodeInfoRequest),
            types::GET_SET => ParameterRequest::decode(payload).map(Message::ParameterRequest),
            types::EXECUTE_OPCODE => Opcode::decode(payload).map(Message::ExecuteOpcode),
            types::RESTART_NODE => management::decode_restart(payload).map(Message::RestartNode),
            types::BEGIN_FIRMWARE_UPDATE => {
                NumberAndText::decode(payload).map(Message::BeginUpdate)
            }
            types::GET_TRANSPORT_STATS => empty(Message::TransportStatsRequest),
            _ => None,
        }
    }

    fn decode_response(data_type: &DataType, payload: &[u8]) -> Option<Message> {
        match *data_type {
            types::GET_NODE_INFO => {
                NodeInfo::decode(payload).map(|info| Message::NodeInfo(Box::new(info)))
            }
            types::GET_SET => ParameterResponse::decode(payload).map(Message::ParameterResponse),
            types::EXECUTE_OPCODE => {
                management::decode_executed(payload).map(Message::OpcodeExecuted)
            }
            types::RESTART_NODE => management::decode_restarted(payload).map(Message::Restarting),
            types::BEGIN_FIRMWARE_UPDATE => {
                NumberAndText::decode(payload).map(Message::UpdateBegun)
            }
            types::GET_TRANSPORT_STATS => {
                TransportStats::decode(payload).map(Message::TransportStats)
            }
            _ => None,
        }
    }

    /// Type and payload; `None` for `Other`, which does not have its type.
    pub fn encode(&self) -> Option<(&'static DataType, Vec<u8>)> {
        Some(match self {
            Message::NodeStatus(status) => (&types::NODE_STATUS, status.encode()),
            Message::Allocation(allocation) => (&types::ALLOCATION, allocation.encode()),
            Message::ArrayCommand(commands) => {
                (&types::ARRAY_COMMAND, ActuatorCommand::encode_array(commands))
            }
            Message::ActuatorStatus(status) => (&types::ACTUATOR_STATUS, status.encode()),
            Message::Temperature(temperature) => (&types::TEMPERATURE, temperature.encode()),
            Message::CircuitStatus(status) => (&types::CIRCUIT_STATUS, status.encode()),
            Message::BatteryInfo(info) => (&types::BATTERY_INFO, info.encode()),
            Message::HardpointCommand(hardpoint, command) => {
                let [low, high] = command.to_le_bytes();
                (&types::HARDPOINT_COMMAND, vec![*hardpoint, low, high])
            }
            Message::HardpointStatus(status) => (&types::HARDPOINT_STATUS, status.encode()),
            Message::Rpm(rpm) => (&types::RPM, rpm.encode()),
            Message::RawCommand(commands) => (&types::RAW_COMMAND, esc::encode_commands(commands)),
            Message::LightsCommand(commands) => {
                (&types::LIGHTS_COMMAND, LightCommand::encode_array(commands))
            }
            Message::ArmingStatus(byte) => (&types::ARMING_STATUS, vec![*byte]),
            Message::SafetyState(byte) => (&types::SAFETY_STATE, vec![*byte]),
            Message::Button(button, tenths) => (&types::BUTTON, vec![*button, *tenths]),
            Message::CanStats(stats) => (&types::CAN_STATS, stats.encode()),
            Message::KeyValue(pair) => (&types::KEY_VALUE, pair.encode()),
            Message::LogMessage(message) => (&types::LOG_MESSAGE, message.encode()),
            Message::ThesisCommand(byte) => (&types::THESIS_COMMAND, vec![*byte]),
            Message::ThesisTemperature(byte) => (&types::THESIS_TEMPERATURE, vec![*byte]),
            Message::NodeInfoRequest => (&types::GET_NODE_INFO, Vec::new()),
            Message::NodeInfo(info) => (&types::GET_NODE_INFO, info.encode()),
            Message::ParameterRequest(request) => (&types::GET_SET, request.encode()),
            Message::ParameterResponse(response) => (&types::GET_SET, response.encode()),
            Message::ExecuteOpcode(opcode) => (&types::EXECUTE_OPCODE, opcode.encode()),
            Message::OpcodeExecuted(ok) => {
                (&types::EXECUTE_OPCODE, management::encode_executed(*ok))
            }
            Message::RestartNode(magic) => {
                (&types::RESTART_NODE, management::encode_restart(*magic))
            }
            Message::Restarting(ok) => (&types::RESTART_NODE, management::encode_restarted(*ok)),
            Message::BeginUpdate(update) | Message::UpdateBegun(update) => {
                (&types::BEGIN_FIRMWARE_UPDATE, update.encode())
            }
            Message::TransportStatsRequest => (&types::GET_TRANSPORT_STATS, Vec::new()),
            Message::TransportStats(stats) => (&types::GET_TRANSPORT_STATS, stats.encode()),
            Message::Other { .. } => return None,
        })
    }

    /// True for a request, false for a response of a service; `None` for a broadcast.
    pub fn is_request(&self) -> Option<bool> {
        match self {
            Message::NodeInfoRequest
            | Message::ParameterRequest(_)
            | Message::ExecuteOpcode(_)
            | Message::RestartNode(_)
            | Message::BeginUpdate(_)
            | Message::TransportStatsRequest => Some(true),
            Message::NodeInfo(_)
            | Message::ParameterResponse(_)
            | Message::OpcodeExecuted(_)
            | Message::Restarting(_)
            | Message::UpdateBegun(_)
            | Message::TransportStats(_) => Some(false),
            _ => None,
        }
    }

    /// Name of the type, with the direction of a service: "GetNodeInfo request".
    pub fn name(&self) -> String {
        if let Message::Other { name, .. } = self {
            return name.clone();
        }
        let name = self.encode().map_or("", |(data_type, _)| data_type.name);
        match self.is_request() {
            Some(true) => format!("{name} request"),
            Some(false) => format!("{name} response"),
            None => name.to_owned(),
        }
    }
}

/// Name of the type of an identifier: "GetNodeInfo request", "message 2222".
pub fn name_of(id: CanId) -> String {
    let direction = match id {
        CanId::Service { request: true, .. } => " request",
        CanId::Service { request: false, .. } => " response",
        _ => "",
    };
    let name = match (DataType::of(id), id) {
        (Some(known), _) => known.name.to_owned(),
        (None, CanId::Message { type_id, .. }) => format!("message {type_id}"),
        (None, CanId::Anonymous { type_id, .. }) => format!("message {type_id}"),
        (None, CanId::Service { service_id, .. }) => format!("service {service_id}"),
    };
    name + direction
}

impl fmt::Display for Message {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.name())?;
        match self {
            Message::NodeStatus(status) => write!(f, " {status}"),
            Message::Allocation(allocation) => write!(f, " {allocation}"),
            Message::ArrayCommand(commands) => list(f, commands),
            Message::ActuatorStatus(status) => write!(f, " {status}"),
            Message::Temperature(temperature) => write!(f, " {temperature}"),
            Message::CircuitStatus(status) => write!(f, " {status}"),
            Message::BatteryInfo(info) => write!(f, " {info}"),
            Message::HardpointCommand(hardpoint, command) => {
                write!(f, " {hardpoint} {}", hardpoint_text(*command))
            }
            Message::HardpointStatus(status) => write!(f, " {status}"),
            Message::Rpm(rpm) => write!(f, " {rpm}"),
            Message::RawCommand(commands) => list(f, commands),
            Message::LightsCommand(commands) => list(f, commands),
            Message::ArmingStatus(0) => write!(f, " disarmed"),
            Message::ArmingStatus(255) => write!(f, " armed"),
            Message::SafetyState(0) => write!(f, " on"),
            Message::SafetyState(255) => write!(f, " off"),
            Message::ArmingStatus(other) | Message::SafetyState(other) => write!(f, " {other}"),
            Message::Button(button, tenths) => {
                write!(f, " {button} pressed for {}.{} s", tenths / 10, tenths % 10)
            }
            Message::CanStats(stats) => write!(f, " {stats}"),
            Message::KeyValue(pair) => write!(f, " {pair}"),
            Message::LogMessage(message) => write!(f, " {message}"),
            Message::ThesisCommand(byte) => write!(f, " {byte}"),
            Message::ThesisTemperature(degrees) => write!(f, " {degrees} C"),
            Message::NodeInfoRequest | Message::TransportStatsRequest => Ok(()),
            Message::NodeInfo(info) => write!(f, " {info}"),
            Message::ParameterRequest(request) => write!(f, " {request}"),
            Message::ParameterResponse(response) => write!(f, " {response}"),
            Message::ExecuteOpcode(opcode) => write!(f, " {opcode}"),
            Message::OpcodeExecuted(ok) | Message::Restarting(ok) => management::write_ok(f, *ok),
            Message::RestartNode(magic) => management::write_magic(f, *magic),
            Message::BeginUpdate(update) => {
                write!(f, " of \"{}\" from node {}", update.text(), update.number)
            }
            Message::UpdateBegun(update) => write!(f, " {} \"{}\"", update.error(), update.text()),
            Message::TransportStats(stats) => write!(f, " {stats}"),
            Message::Other { payload, .. } => write_raw(f, payload),
        }
    }
}
