//! Names and signatures of the data types that may be met on a bus, so that the traffic view can name them and check
//! the CRC of long transfers.
//!
//! Source: public DroneCAN DSDL; signatures computed with pydronecan 1.0.27. The thesis's two types have no CRC to
//! check, as they fit in one frame.

use super::id::CanId;

/// Whether a type is broadcast or asked for. The two have separate number spaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Message,
    Service,
}

/// One known type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DataType {
    pub kind: Kind,
    pub id: u16,
    /// Short name, without the name space where it is plain without.
    pub name: &'static str,
    /// Known signature, for the transfer CRC.
    pub signature: Option<u64>,
}

const fn message(id: u16, name: &'static str, signature: u64) -> DataType {
    DataType { kind: Kind::Message, id, name, signature: Some(signature) }
}

const fn service(id: u16, name: &'static str, signature: u64) -> DataType {
    DataType { kind: Kind::Service, id, name, signature: Some(signature) }
}

pub const ALLOCATION: DataType = message(1, "Allocation", 0x0B2A_8126_20A1_1D40);
pub const NODE_STATUS: DataType = message(341, "NodeStatus", 0x0F08_68D0_C1A7_C6F1);
pub const ARRAY_COMMAND: DataType = message(1010, "ArrayCommand", 0xD8A7_4862_38EC_3AF3);
pub const ACTUATOR_STATUS: DataType = message(1011, "actuator.Status", 0x5E9B_BA44_FAF1_EA04);
pub const ARMING_STATUS: DataType = message(1100, "ArmingStatus", 0x8700_F375_556A_8003);
pub const TEMPERATURE: DataType = message(1110, "Temperature", 0x7026_1C28_A941_44C6);
/// One byte: servo command, 0..255 over the full travel.
pub const THESIS_COMMAND: DataType = thesis(1111, "thesis.ServoCommand");
/// One byte: degrees Celsius.
pub const THESIS_TEMPERATURE: DataType = thesis(1112, "thesis.DegreesCelsius");
pub const GET_NODE_INFO: DataType = service(1, "GetNodeInfo", 0xEE46_8A81_21C4_6A9E);

const fn thesis(id: u16, name: &'static str) -> DataType {
    DataType { kind: Kind::Message, id, name, signature: None }
}

/// All types with a name here.
pub const KNOWN: &[DataType] = &[
    ALLOCATION,
    message(4, "GlobalTimeSync", 0x2027_1116_A793_C2DB),
    message(5, "Panic", 0x8B79_B410_1811_C1D7),
    NODE_STATUS,
    message(342, "Stats", 0x763A_E3B8_A986_F8D1),
    message(343, "CanStats", 0xCE08_0CAE_3CA3_3C75),
    message(380, "enumeration.Indication", 0x884C_B630_50A8_4F35),
    ARRAY_COMMAND,
    ACTUATOR_STATUS,
    message(1030, "esc.RawCommand", 0x217F_5C87_D7EC_951D),
    message(1070, "hardpoint.Command", 0xA1A0_3626_8B0C_3455),
    message(1071, "hardpoint.Status", 0x624A_519D_4255_3D82),
    message(1080, "BeepCommand", 0xBE9E_A9FE_C2B1_5D52),
    message(1081, "LightsCommand", 0x2031_D93C_8BDD_1EC4),
    message(1091, "CircuitStatus", 0x8313_D33D_0DDD_A115),
    ARMING_STATUS,
    TEMPERATURE,
    THESIS_COMMAND,
    THESIS_TEMPERATURE,
    message(2010, "tunnel.Broadcast", 0x5AA2_D4D9_CF4B_1E85),
    message(3001, "tunnel.Targetted", 0xB138_E7EA_72A2_A2E9),
    message(16370, "debug.KeyValue", 0xE02F_25D6_E0C9_8AE0),
    message(16383, "debug.LogMessage", 0xD654_A48E_0C04_9D75),
    message(20000, "SafetyState", 0xE965_701A_95A1_A6A1),
    GET_NODE_INFO,
    service(4, "GetTransportStats", 0xBE6F_76A7_EC31_2B04),
    service(5, "RestartNode", 0x569E_0539_4A30_17F0),
    service(10, "param.ExecuteOpcode", 0x3B13_1AC5_EB69_D2CD),
    service(11, "param.GetSet", 0xA7B6_22F9_39D1_A4D5),
    service(15, "enumeration.Begin", 0x196A_E064_26A3_B5D8),
    service(40, "BeginFirmwareUpdate", 0xB7D7_25DF_7272_4126),
    service(45, "file.GetInfo", 0x5004_891E_E8A2_7531),
    service(48, "file.Read", 0x8DCD_CA93_9F33_F678),
    service(63, "tunnel.Call", 0xDB11_EDC5_1050_2658),
];

impl DataType {
    /// The type that a frame with this identifier carries, if it is a known one.
    pub fn of(id: CanId) -> Option<&'static DataType> {
        let (kind, number) = match id {
            CanId::Message { type_id, .. } => (Kind::Message, type_id),
            CanId::Anonymous { type_id, .. } => (Kind::Message, u16::from(type_id)),
            CanId::Service { service_id, .. } => (Kind::Service, u16::from(service_id)),
        };
        KNOWN.iter().find(|t| t.kind == kind && t.id == number)
    }

    /// Identifier of a broadcast of this type. Meant for messages: a service also needs a destination.
    pub fn message_id(&self, priority: u8, source: super::NodeId) -> CanId {
        debug_assert!(self.kind == Kind::Message, "{} is a service", self.name);
        CanId::Message { priority, type_id: self.id, source }
    }
}
