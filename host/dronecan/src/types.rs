//! Names, signatures and lengths of the data types that a bus may have. The traffic view shows the
//! names and checks the CRC of long transfers; the bus planner uses the lengths.
//!
//! Source: public DroneCAN DSDL; signatures and lengths computed with pydronecan 1.0.27. The
//! thesis's two types need no signature, because they fit in one frame.

use super::id::CanId;

/// Message or service. The two have separate data type IDs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Message,
    Service,
}

/// Length of a payload: a fixed part, and a list at the end that may be empty.
///
/// A list that is not at the end counts as empty, and a union has the length of its longest member.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Length without the list's elements, in bits.
    pub fixed_bits: u16,
    /// Length of a list element in bits; 0 without a list.
    pub element_bits: u16,
    /// Maximum number of elements in the list; 0 without a list.
    pub elements_max: u16,
}

const fn fixed(fixed_bits: u16) -> Layout {
    list(fixed_bits, 0, 0)
}

const fn list(fixed_bits: u16, element_bits: u16, elements_max: u16) -> Layout {
    Layout { fixed_bits, element_bits, elements_max }
}

impl Layout {
    /// Length in bytes with this number of elements. The last byte may be used partly.
    pub const fn bytes(self, elements: u16) -> usize {
        let bits = self.fixed_bits as usize + self.element_bits as usize * elements as usize;
        bits.div_ceil(8)
    }
}

/// A known type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DataType {
    pub kind: Kind,
    pub id: u16,
    /// Short name, without the namespace if it is unambiguous without.
    pub name: &'static str,
    /// Signature for the transfer CRC, if it is known.
    pub signature: Option<u64>,
    /// Payload of the message, or of the service's request.
    pub payload: Layout,
    /// Payload of the service's response.
    pub response: Option<Layout>,
}

const fn message(id: u16, name: &'static str, signature: u64, payload: Layout) -> DataType {
    DataType { kind: Kind::Message, id, name, signature: Some(signature), payload, response: None }
}

const fn service(
    id: u16,
    name: &'static str,
    signature: u64,
    request: Layout,
    response: Layout,
) -> DataType {
    let (signature, response) = (Some(signature), Some(response));
    DataType { kind: Kind::Service, id, name, signature, payload: request, response }
}

const fn thesis(id: u16, name: &'static str) -> DataType {
    DataType { kind: Kind::Message, id, name, signature: None, payload: fixed(8), response: None }
}

pub const ALLOCATION: DataType = message(1, "Allocation", 0x0B2A_8126_20A1_1D40, list(8, 8, 16));
pub const NODE_STATUS: DataType = message(341, "NodeStatus", 0x0F08_68D0_C1A7_C6F1, fixed(56));
pub const ARRAY_COMMAND: DataType =
    message(1010, "ArrayCommand", 0xD8A7_4862_38EC_3AF3, list(0, 32, 15));
pub const ACTUATOR_STATUS: DataType =
    message(1011, "actuator.Status", 0x5E9B_BA44_FAF1_EA04, fixed(64));
pub const RAW_COMMAND: DataType =
    message(1030, "esc.RawCommand", 0x217F_5C87_D7EC_951D, list(0, 14, 20));
pub const LIGHTS_COMMAND: DataType =
    message(1081, "LightsCommand", 0x2031_D93C_8BDD_1EC4, list(0, 24, 20));
pub const CIRCUIT_STATUS: DataType =
    message(1091, "CircuitStatus", 0x8313_D33D_0DDD_A115, fixed(56));
pub const RPM: DataType = message(1045, "rpm.RPM", 0x1407_07C0_9274_F6E7, fixed(56));
pub const HARDPOINT_COMMAND: DataType =
    message(1070, "hardpoint.Command", 0xA1A0_3626_8B0C_3455, fixed(24));
pub const HARDPOINT_STATUS: DataType =
    message(1071, "hardpoint.Status", 0x624A_519D_4255_3D82, fixed(56));
pub const BATTERY_INFO: DataType =
    message(1092, "power.BatteryInfo", 0x249C_2654_8A71_1966, list(184, 8, 31));
pub const ARMING_STATUS: DataType = message(1100, "ArmingStatus", 0x8700_F375_556A_8003, fixed(8));
pub const TEMPERATURE: DataType = message(1110, "Temperature", 0x7026_1C28_A941_44C6, fixed(40));
/// One byte: servo command, 0 to 255 over the full travel.
pub const THESIS_COMMAND: DataType = thesis(1111, "thesis.ServoCommand");
/// One byte: degrees Celsius.
pub const THESIS_TEMPERATURE: DataType = thesis(1112, "thesis.DegreesCelsius");
pub const CAN_STATS: DataType = message(343, "CanStats", 0xCE08_0CAE_3CA3_3C75, fixed(200));
pub const KEY_VALUE: DataType =
    message(16370, "debug.KeyValue", 0xE02F_25D6_E0C9_8AE0, list(32, 8, 58));
pub const LOG_MESSAGE: DataType =
    message(16383, "debug.LogMessage", 0xD654_A48E_0C04_9D75, list(8, 8, 90));
/// ArduPilot's safety switch.
pub const SAFETY_STATE: DataType = message(20000, "SafetyState", 0xE965_701A_95A1_A6A1, fixed(8));
/// A button of ArduPilot's nodes.
pub const BUTTON: DataType = message(20001, "indication.Button", 0x0645_A46E_FBA7_466E, fixed(16));
/// Heading and state of ArduPilot's vehicle. Its auxiliary data is not at the end.
pub const NOTIFY_STATE: DataType = message(20007, "NotifyState", 0x631F_2A9C_1651_FDEC, fixed(80));
/// Of Hobbywing (com.hobbywing.esc).
pub const GET_ESC_ID: DataType = message(20013, "GetEscID", 0x4E2D, list(0, 8, 3));
pub const GLOBAL_TIME_SYNC: DataType =
    message(4, "GlobalTimeSync", 0x2027_1116_A793_C2DB, fixed(56));
pub const GET_NODE_INFO: DataType =
    service(1, "GetNodeInfo", 0xEE46_8A81_21C4_6A9E, fixed(0), list(328, 8, 80));
pub const GET_TRANSPORT_STATS: DataType =
    service(4, "GetTransportStats", 0xBE6F_76A7_EC31_2B04, fixed(0), list(144, 144, 3));
pub const RESTART_NODE: DataType =
    service(5, "RestartNode", 0x569E_0539_4A30_17F0, fixed(40), fixed(1));
pub const EXECUTE_OPCODE: DataType =
    service(10, "param.ExecuteOpcode", 0x3B13_1AC5_EB69_D2CD, fixed(56), fixed(49));
pub const TUNNEL_BROADCAST: DataType =
    message(2010, "tunnel.Broadcast", 0x5AA2_D4D9_CF4B_1E85, list(16, 8, 60));
pub const TUNNEL_TARGETTED: DataType =
    message(3001, "tunnel.Targetted", 0xB138_E7EA_72A2_A2E9, list(48, 8, 120));
pub const GET_SET: DataType =
    service(11, "param.GetSet", 0xA7B6_22F9_39D1_A4D5, list(80, 8, 92), list(288, 8, 92));
pub const BEGIN_FIRMWARE_UPDATE: DataType =
    service(40, "BeginFirmwareUpdate", 0xB7D7_25DF_7272_4126, list(8, 8, 200), list(8, 8, 127));
/// Reads a part of a file: at most 256 bytes.
pub const FILE_READ: DataType =
    service(48, "file.Read", 0x8DCD_CA93_9F33_F678, list(40, 8, 200), list(16, 8, 256));

/// All types with a name here.
pub const KNOWN: &[DataType] = &[
    ALLOCATION,
    NODE_STATUS,
    ARRAY_COMMAND,
    ACTUATOR_STATUS,
    ARMING_STATUS,
    TEMPERATURE,
    THESIS_COMMAND,
    THESIS_TEMPERATURE,
    LIGHTS_COMMAND,
    CAN_STATS,
    KEY_VALUE,
    SAFETY_STATE,
    BUTTON,
    GET_NODE_INFO,
    GET_TRANSPORT_STATS,
    RESTART_NODE,
    EXECUTE_OPCODE,
    GET_SET,
    BEGIN_FIRMWARE_UPDATE,
    FILE_READ,
    GLOBAL_TIME_SYNC,
    message(5, "Panic", 0x8B79_B410_1811_C1D7, list(0, 8, 7)),
    message(342, "Stats", 0x763A_E3B8_A986_F8D1, fixed(224)),
    message(380, "enumeration.Indication", 0x884C_B630_50A8_4F35, list(72, 8, 92)),
    message(1001, "ahrs.MagneticFieldStrength", 0xE2A7_D4A9_460B_C2F2, list(48, 16, 9)),
    message(1002, "ahrs.MagneticFieldStrength2", 0xB6AC_0C44_2430_297E, list(56, 16, 9)),
    message(1020, "air_data.TrueAirspeed", 0x306F_69E0_A591_AFAA, fixed(32)),
    message(1021, "air_data.IndicatedAirspeed", 0x0A18_92D7_2AB8_945F, fixed(32)),
    message(1025, "air_data.AngleOfAttack", 0xD551_3C3F_7AFA_C74E, fixed(40)),
    message(1026, "air_data.Sideslip", 0x7B48_E55F_CFF4_2A57, fixed(32)),
    message(1028, "air_data.StaticPressure", 0xCDC7_C434_12BD_C89A, fixed(48)),
    message(1029, "air_data.StaticTemperature", 0x4927_2A64_77D9_6271, fixed(32)),
    RAW_COMMAND,
    message(1032, "hygrometer.Hygrometer", 0xCEB3_0889_2BF1_63E8, fixed(40)),
    message(1034, "esc.Status", 0xA9AF_28AE_A2FB_B254, fixed(110)),
    message(1036, "esc.StatusExtended", 0x02DC_203C_5096_0EDC, fixed(56)),
    message(1044, "camera_gimbal.Status", 0xB9F1_2786_5BE0_D61E, list(80, 16, 9)),
    RPM,
    message(1050, "range_sensor.Measurement", 0x68FF_FE70_FC77_1952, fixed(120)),
    message(1060, "gnss.Fix", 0x54C1_572B_9E07_F297, list(336, 16, 9)),
    message(1061, "gnss.Auxiliary", 0x9BE8_BDC4_C3DB_BFD2, fixed(125)),
    message(1062, "gnss.RTCMStream", 0x1F56_030E_CB17_1501, list(8, 8, 128)),
    message(1063, "gnss.Fix2", 0xCA41_E700_0F37_435F, list(400, 216, 1)),
    HARDPOINT_COMMAND,
    HARDPOINT_STATUS,
    message(1080, "BeepCommand", 0xBE9E_A9FE_C2B1_5D52, fixed(32)),
    message(1090, "power.PrimaryPowerSupplyStatus", 0xBBA0_5074_AD75_7480, fixed(47)),
    CIRCUIT_STATUS,
    BATTERY_INFO,
    message(1129, "ice.FuelTankStatus", 0x286B_4A38_7BA8_4BC4, fixed(104)),
    message(1140, "rc.RCInput", 0x7715_55E5_96AA_B4CF, list(28, 12, 32)),
    TUNNEL_BROADCAST,
    TUNNEL_TARGETTED,
    LOG_MESSAGE,
    message(20002, "gnss.Heading", 0x315C_AE39_ECED_3412, fixed(34)),
    message(20003, "gnss.Status", 0xBA3C_B4AB_BB00_7F69, fixed(56)),
    message(20004, "power.BatteryInfoAux", 0x7D7F_49FC_7548_4882, fixed(137)),
    message(20005, "gnss.MovingBaselineData", 0x09F3_2374_8C32_133A, list(0, 8, 300)),
    message(20006, "gnss.RelPosHeading", 0xA172_7AF2_95F9_4478, fixed(153)),
    NOTIFY_STATE,
    GET_ESC_ID,
    message(20010, "power.BatteryContinuous", 0x756B_5613_40D5_E4AE, fixed(200)),
    message(20011, "power.BatteryPeriodic", 0x0F01_2494_E973_58D2, fixed(272)),
    message(20012, "power.BatteryCells", 0x5C8B_1ABD_1589_0EA4, fixed(21)),
    message(20790, "trafficmonitor.TrafficReport", 0x68E4_5DB6_0B69_81F8, fixed(375)),
    message(21910, "proximity_sensor.Proximity", 0x99DD_3985_FB32_22CE, fixed(64)),
    service(15, "enumeration.Begin", 0x196A_E064_26A3_B5D8, list(16, 8, 92), fixed(8)),
    service(45, "file.GetInfo", 0x5004_891E_E8A2_7531, list(0, 8, 200), fixed(64)),
    service(63, "tunnel.Call", 0xDB11_EDC5_1050_2658, list(16, 8, 60), list(0, 8, 60)),
];

/// Namespaces of public types; the thesis's types have none.
const ROOTS: [&str; 3] = ["uavcan", "ardupilot", "dronecan"];

impl DataType {
    /// The type of a frame with this identifier, if it is known.
    pub fn of(id: CanId) -> Option<&'static DataType> {
        let (kind, number) = match id {
            CanId::Message { type_id, .. } => (Kind::Message, type_id),
            CanId::Anonymous { type_id, .. } => (Kind::Message, u16::from(type_id)),
            CanId::Service { service_id, .. } => (Kind::Service, u16::from(service_id)),
        };
        KNOWN.iter().find(|t| t.kind == kind && t.id == number)
    }

    /// Identifier of a broadcast of this type. For messages only: a service also needs a
    /// destination.
    pub fn message_id(&self, priority: u8, source: super::NodeId) -> CanId {
        debug_assert!(self.kind == Kind::Message, "{} is a service", self.name);
        CanId::Message { priority, type_id: self.id, source }
    }

    /// All types that match the user's `text`: a name as here, its end ("Status"), or the full DSDL
    /// name. Case does not matter.
    pub fn by_name(text: &str) -> Vec<&'static DataType> {
        let text = text.to_ascii_lowercase();
        let full = text.split_once('.').is_some_and(|(root, _)| ROOTS.contains(&root));
        let ends_with = |whole: &str, end: &str| {
            whole.strip_suffix(end).is_some_and(|front| front.ends_with('.'))
        };
        let means =
            |name: &str| name == text || ends_with(name, &text) || full && ends_with(&text, name);
        let found: Vec<_> =
            KNOWN.iter().filter(|known| means(&known.name.to_ascii_lowercase())).collect();
        // An exact name has precedence over the end of another.
        match found.iter().find(|known| known.name.eq_ignore_ascii_case(&text)) {
            Some(exact) => vec![exact],
            None => found,
        }
    }
}
