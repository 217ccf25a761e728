//! The standard data types: ID and CRC seed of each message and service.
//!
//! Source: the public DSDL, namespaces `uavcan`, `dronecan` and `ardupilot`; signatures computed by
//! pydronecan 1.0.27. For your own types use [`Message::new`] and [`Service::new`] with
//! [`signature::of`](crate::signature::of).

use crate::crc;

/// A message type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message {
    /// The data type ID.
    pub id: u16,
    /// The initial value of the CRC of a multi-frame transfer.
    pub seed: u16,
}

impl Message {
    /// Makes the type with this data type ID and signature.
    pub const fn new(id: u16, signature: u64) -> Self {
        Self { id, seed: crc::seed(signature) }
    }
}

/// A service type. Request and response have the same ID and the same seed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Service {
    /// The service ID.
    pub id: u8,
    /// The initial value of the CRC of a multi-frame transfer.
    pub seed: u16,
}

impl Service {
    /// Makes the service with this ID and signature.
    pub const fn new(id: u8, signature: u64) -> Self {
        Self { id, seed: crc::seed(signature) }
    }
}

macro_rules! messages {
    ($($name:ident = $id:literal, $signature:literal, $full:literal;)*) => {
        $(#[doc = $full] pub const $name: Message = Message::new($id, $signature);)*

        #[cfg(test)]
        const MESSAGES: &[(Message, u64)] = &[$(($name, $signature),)*];
    };
}

macro_rules! services {
    ($($name:ident = $id:literal, $signature:literal, $full:literal;)*) => {
        $(#[doc = $full] pub const $name: Service = Service::new($id, $signature);)*

        #[cfg(test)]
        const SERVICES: &[(Service, u64)] = &[$(($name, $signature),)*];
    };
}

messages! {
    ALLOCATION = 1, 0x0B2A_8126_20A1_1D40, "uavcan.protocol.dynamic_node_id.Allocation";
    GLOBAL_TIME_SYNC = 4, 0x2027_1116_A793_C2DB, "uavcan.protocol.GlobalTimeSync";
    PANIC = 5, 0x8B79_B410_1811_C1D7, "uavcan.protocol.Panic";
    NODE_STATUS = 341, 0x0F08_68D0_C1A7_C6F1, "uavcan.protocol.NodeStatus";
    NODE_STATS = 342, 0x763A_E3B8_A986_F8D1, "dronecan.protocol.Stats";
    CAN_STATS = 343, 0xCE08_0CAE_3CA3_3C75, "dronecan.protocol.CanStats";
    GLOBAL_TIME = 344, 0xA551_7744_8A49_0F33, "dronecan.protocol.GlobalTime";
    ENUMERATION_INDICATION = 380, 0x884C_B630_50A8_4F35, "uavcan.protocol.enumeration.Indication";
    SERVER_DISCOVERY = 390, 0x821A_E2F5_25F6_9F21,
        "uavcan.protocol.dynamic_node_id.server.Discovery";
    AHRS_SOLUTION = 1000, 0x72A6_3A3C_6F41_FA9B, "uavcan.equipment.ahrs.Solution";
    MAGNETIC_FIELD_STRENGTH = 1001, 0xE2A7_D4A9_460B_C2F2,
        "uavcan.equipment.ahrs.MagneticFieldStrength";
    MAGNETIC_FIELD_STRENGTH2 = 1002, 0xB6AC_0C44_2430_297E,
        "uavcan.equipment.ahrs.MagneticFieldStrength2";
    RAW_IMU = 1003, 0x8280_632C_40E5_74B5, "uavcan.equipment.ahrs.RawIMU";
    ARRAY_COMMAND = 1010, 0xD8A7_4862_38EC_3AF3, "uavcan.equipment.actuator.ArrayCommand";
    ACTUATOR_STATUS = 1011, 0x5E9B_BA44_FAF1_EA04, "uavcan.equipment.actuator.Status";
    TRUE_AIRSPEED = 1020, 0x306F_69E0_A591_AFAA, "uavcan.equipment.air_data.TrueAirspeed";
    INDICATED_AIRSPEED = 1021, 0x0A18_92D7_2AB8_945F, "uavcan.equipment.air_data.IndicatedAirspeed";
    ANGLE_OF_ATTACK = 1025, 0xD551_3C3F_7AFA_C74E, "uavcan.equipment.air_data.AngleOfAttack";
    SIDESLIP = 1026, 0x7B48_E55F_CFF4_2A57, "uavcan.equipment.air_data.Sideslip";
    RAW_AIR_DATA = 1027, 0xC77D_F38B_A122_F5DA, "uavcan.equipment.air_data.RawAirData";
    STATIC_PRESSURE = 1028, 0xCDC7_C434_12BD_C89A, "uavcan.equipment.air_data.StaticPressure";
    STATIC_TEMPERATURE = 1029, 0x4927_2A64_77D9_6271, "uavcan.equipment.air_data.StaticTemperature";
    ESC_RAW_COMMAND = 1030, 0x217F_5C87_D7EC_951D, "uavcan.equipment.esc.RawCommand";
    ESC_RPM_COMMAND = 1031, 0xCE0F_9F62_1CF7_E70B, "uavcan.equipment.esc.RPMCommand";
    HYGROMETER = 1032, 0xCEB3_0889_2BF1_63E8, "dronecan.sensors.hygrometer.Hygrometer";
    ESC_STATUS = 1034, 0xA9AF_28AE_A2FB_B254, "uavcan.equipment.esc.Status";
    ESC_STATUS_EXTENDED = 1036, 0x02DC_203C_5096_0EDC, "uavcan.equipment.esc.StatusExtended";
    CAMERA_GIMBAL_ANGULAR_COMMAND = 1040, 0x4AF6_E57B_2B2B_E29C,
        "uavcan.equipment.camera_gimbal.AngularCommand";
    CAMERA_GIMBAL_GEOPOI_COMMAND = 1041, 0x9371_428A_92F0_1FD6,
        "uavcan.equipment.camera_gimbal.GEOPOICommand";
    MAGNETIC_FIELD_STRENGTH_HI_RES = 1043, 0x3053_EBE3_D750_286F,
        "dronecan.sensors.magnetometer.MagneticFieldStrengthHiRes";
    CAMERA_GIMBAL_STATUS = 1044, 0xB9F1_2786_5BE0_D61E, "uavcan.equipment.camera_gimbal.Status";
    RPM = 1045, 0x1407_07C0_9274_F6E7, "dronecan.sensors.rpm.RPM";
    RANGE_SENSOR_MEASUREMENT = 1050, 0x68FF_FE70_FC77_1952,
        "uavcan.equipment.range_sensor.Measurement";
    GNSS_FIX = 1060, 0x54C1_572B_9E07_F297, "uavcan.equipment.gnss.Fix";
    GNSS_AUXILIARY = 1061, 0x9BE8_BDC4_C3DB_BFD2, "uavcan.equipment.gnss.Auxiliary";
    RTCM_STREAM = 1062, 0x1F56_030E_CB17_1501, "uavcan.equipment.gnss.RTCMStream";
    GNSS_FIX2 = 1063, 0xCA41_E700_0F37_435F, "uavcan.equipment.gnss.Fix2";
    HARDPOINT_COMMAND = 1070, 0xA1A0_3626_8B0C_3455, "uavcan.equipment.hardpoint.Command";
    HARDPOINT_STATUS = 1071, 0x624A_519D_4255_3D82, "uavcan.equipment.hardpoint.Status";
    BEEP_COMMAND = 1080, 0xBE9E_A9FE_C2B1_5D52, "uavcan.equipment.indication.BeepCommand";
    LIGHTS_COMMAND = 1081, 0x2031_D93C_8BDD_1EC4, "uavcan.equipment.indication.LightsCommand";
    PRIMARY_POWER_SUPPLY_STATUS = 1090, 0xBBA0_5074_AD75_7480,
        "uavcan.equipment.power.PrimaryPowerSupplyStatus";
    CIRCUIT_STATUS = 1091, 0x8313_D33D_0DDD_A115, "uavcan.equipment.power.CircuitStatus";
    BATTERY_INFO = 1092, 0x249C_2654_8A71_1966, "uavcan.equipment.power.BatteryInfo";
    ARMING_STATUS = 1100, 0x8700_F375_556A_8003, "uavcan.equipment.safety.ArmingStatus";
    DEVICE_TEMPERATURE = 1110, 0x7026_1C28_A941_44C6, "uavcan.equipment.device.Temperature";
    ICE_RECIPROCATING_STATUS = 1120, 0xD38A_A3EE_7553_7EC6,
        "uavcan.equipment.ice.reciprocating.Status";
    FUEL_TANK_STATUS = 1129, 0x286B_4A38_7BA8_4BC4, "uavcan.equipment.ice.FuelTankStatus";
    RC_INPUT = 1140, 0x7715_55E5_96AA_B4CF, "dronecan.sensors.rc.RCInput";
    GLOBAL_NAVIGATION_SOLUTION = 2000, 0x463B_10CC_CBE5_1C3D,
        "uavcan.navigation.GlobalNavigationSolution";
    TUNNEL_BROADCAST = 2010, 0x5AA2_D4D9_CF4B_1E85, "uavcan.tunnel.Broadcast";
    TUNNEL_SERIAL_CONFIG = 2011, 0x4237_AACE_E87E_82AD, "uavcan.tunnel.SerialConfig";
    TUNNEL_TARGETTED = 3001, 0xB138_E7EA_72A2_A2E9, "uavcan.tunnel.Targetted";
    KEY_VALUE = 16370, 0xE02F_25D6_E0C9_8AE0, "uavcan.protocol.debug.KeyValue";
    FLEX_DEBUG = 16371, 0xECA6_0382_FF03_8F39, "dronecan.protocol.FlexDebug";
    LOG_MESSAGE = 16383, 0xD654_A48E_0C04_9D75, "uavcan.protocol.debug.LogMessage";
    SAFETY_STATE = 20000, 0xE965_701A_95A1_A6A1, "ardupilot.indication.SafetyState";
    INDICATION_BUTTON = 20001, 0x0645_A46E_FBA7_466E, "ardupilot.indication.Button";
    GNSS_HEADING = 20002, 0x315C_AE39_ECED_3412, "ardupilot.gnss.Heading";
    GNSS_STATUS = 20003, 0xBA3C_B4AB_BB00_7F69, "ardupilot.gnss.Status";
    BATTERY_INFO_AUX = 20004, 0x7D7F_49FC_7548_4882, "ardupilot.equipment.power.BatteryInfoAux";
    MOVING_BASELINE_DATA = 20005, 0x09F3_2374_8C32_133A, "ardupilot.gnss.MovingBaselineData";
    REL_POS_HEADING = 20006, 0xA172_7AF2_95F9_4478, "ardupilot.gnss.RelPosHeading";
    NOTIFY_STATE = 20007, 0x631F_2A9C_1651_FDEC, "ardupilot.indication.NotifyState";
    BATTERY_CONTINUOUS = 20010, 0x756B_5613_40D5_E4AE,
        "ardupilot.equipment.power.BatteryContinuous";
    BATTERY_PERIODIC = 20011, 0x0F01_2494_E973_58D2, "ardupilot.equipment.power.BatteryPeriodic";
    BATTERY_CELLS = 20012, 0x5C8B_1ABD_1589_0EA4, "ardupilot.equipment.power.BatteryCells";
    REMOTEID_BASIC_ID = 20030, 0x5B1C_624A_8E4F_C533, "dronecan.remoteid.BasicID";
    REMOTEID_LOCATION = 20031, 0xEAA3_A2C5_BCB1_4CAA, "dronecan.remoteid.Location";
    REMOTEID_SELF_ID = 20032, 0x59BE_81DC_4C06_A185, "dronecan.remoteid.SelfID";
    REMOTEID_SYSTEM = 20033, 0x9AC8_72F4_9BF3_2437, "dronecan.remoteid.System";
    REMOTEID_OPERATOR_ID = 20034, 0x581E_7FC7_F03A_F935, "dronecan.remoteid.OperatorID";
    REMOTEID_ARM_STATUS = 20035, 0xFEDF_72CC_F06F_3BDD, "dronecan.remoteid.ArmStatus";
    BATTERY_TAG = 20500, 0x4A5A_9B42_099F_73E1, "ardupilot.equipment.power.BatteryTag";
    TRAFFIC_REPORT = 20790, 0x68E4_5DB6_0B69_81F8,
        "ardupilot.equipment.trafficmonitor.TrafficReport";
    PROXIMITY_SENSOR_PROXIMITY = 21910, 0x99DD_3985_FB32_22CE,
        "ardupilot.equipment.proximity_sensor.Proximity";
}

services! {
    GET_NODE_INFO = 1, 0xEE46_8A81_21C4_6A9E, "uavcan.protocol.GetNodeInfo";
    GET_DATA_TYPE_INFO = 2, 0x1B28_3338_A7BE_D2D8, "uavcan.protocol.GetDataTypeInfo";
    GET_TRANSPORT_STATS = 4, 0xBE6F_76A7_EC31_2B04, "uavcan.protocol.GetTransportStats";
    RESTART_NODE = 5, 0x569E_0539_4A30_17F0, "uavcan.protocol.RestartNode";
    ACCESS_COMMAND_SHELL = 6, 0x5927_6B59_21C9_246E, "uavcan.protocol.AccessCommandShell";
    EXECUTE_OPCODE = 10, 0x3B13_1AC5_EB69_D2CD, "uavcan.protocol.param.ExecuteOpcode";
    GET_SET = 11, 0xA7B6_22F9_39D1_A4D5, "uavcan.protocol.param.GetSet";
    ENUMERATION_BEGIN = 15, 0x196A_E064_26A3_B5D8, "uavcan.protocol.enumeration.Begin";
    APPEND_ENTRIES = 30, 0x8032_C709_7B48_A3CC,
        "uavcan.protocol.dynamic_node_id.server.AppendEntries";
    REQUEST_VOTE = 31, 0xCDDE_07BB_89A5_6356, "uavcan.protocol.dynamic_node_id.server.RequestVote";
    BEGIN_FIRMWARE_UPDATE = 40, 0xB7D7_25DF_7272_4126, "uavcan.protocol.file.BeginFirmwareUpdate";
    FILE_GET_INFO = 45, 0x5004_891E_E8A2_7531, "uavcan.protocol.file.GetInfo";
    GET_DIRECTORY_ENTRY_INFO = 46, 0x8C46_E8AB_568B_DA79,
        "uavcan.protocol.file.GetDirectoryEntryInfo";
    FILE_DELETE = 47, 0x7864_8C99_170B_47AA, "uavcan.protocol.file.Delete";
    FILE_READ = 48, 0x8DCD_CA93_9F33_F678, "uavcan.protocol.file.Read";
    FILE_WRITE = 49, 0x515A_A1DC_77E5_8429, "uavcan.protocol.file.Write";
    TUNNEL_CALL = 63, 0xDB11_EDC5_1050_2658, "uavcan.tunnel.Call";
    REMOTEID_SECURE_COMMAND = 64, 0x126A_47C9_C17A_8BD7, "dronecan.remoteid.SecureCommand";
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::golden;

    /// Compares with the second implementation, which works bit by bit.
    #[test]
    fn every_seed_is_the_crc_of_the_signature() {
        for &(message, signature) in MESSAGES {
            assert_eq!(message.seed, golden::crc(signature, &[]), "message {}", message.id);
        }
        for &(service, signature) in SERVICES {
            assert_eq!(service.seed, golden::crc(signature, &[]), "service {}", service.id);
        }
    }

    #[test]
    fn ids_are_unique_and_in_order() {
        assert!(MESSAGES.windows(2).all(|pair| pair[0].0.id < pair[1].0.id));
        assert!(SERVICES.windows(2).all(|pair| pair[0].0.id < pair[1].0.id));
    }
}
