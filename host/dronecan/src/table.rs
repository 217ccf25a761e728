//! The table of data types: a row has all that is to be said of one type.
//!
//! ```text
//! NAME = type;                             a type that is not decoded
//! NAME = type => { Variant(field: Fields) };
//! NAME = type => { Variant(field: Fields) by decode, encode, write };
//! ```
//!
//! NAME is the constant in [`types`](crate::types). The type has the data type ID, the name that
//! views show, the signature and the length of the payload. Variant is that of
//! [`Message`](crate::Message). A service has two variants, `request` and `response`; one without
//! fields has no parentheses. Three functions belong to a variant:
//!
//! ```text
//! Fields::decode(payload: &[u8]) -> Option<Fields>    None for a payload that does not fit
//! Fields::encode(fields: &Fields) -> Vec<u8>          the payload
//! display                                             its Display, after a space
//! ```
//!
//! Those behind `by` replace them. `others` has the types of which programs need only the name, the
//! CRC and the length.
//!
//! `table!(callback)` hands the rows to another macro (see [`dispatch`](crate::dispatch)).
//!
//! Source: public DroneCAN DSDL; signatures and lengths computed with pydronecan 1.0.27. The
//! thesis's two types need no signature, because they fit in one frame.

macro_rules! table {
    ($callback:ident) => {
        $callback! {
        messages {
            ALLOCATION = message(1, "Allocation", 0x0B2A_8126_20A1_1D40, list(8, 8, 16)) => {
                Allocation(allocation: Allocation)
            };
            GLOBAL_TIME_SYNC = message(4, "GlobalTimeSync", 0x2027_1116_A793_C2DB, fixed(56));
            NODE_STATUS = message(341, "NodeStatus", 0x0F08_68D0_C1A7_C6F1, fixed(56)) => {
                NodeStatus(status: NodeStatus)
            };
            CAN_STATS = message(343, "CanStats", 0xCE08_0CAE_3CA3_3C75, fixed(200)) => {
                CanStats(stats: CanStats)
            };
            ARRAY_COMMAND = message(
                1010, "ArrayCommand", 0xD8A7_4862_38EC_3AF3, list(0, 32, 15),
            ) => {
                ArrayCommand(commands: Vec<ActuatorCommand>)
                    by ActuatorCommand::decode_array, ActuatorCommand::encode_array, list
            };
            ACTUATOR_STATUS = message(
                1011, "actuator.Status", 0x5E9B_BA44_FAF1_EA04, fixed(64),
            ) => {
                ActuatorStatus(status: ActuatorStatus)
            };
            RAW_COMMAND = message(
                1030, "esc.RawCommand", 0x217F_5C87_D7EC_951D, list(0, 14, 20),
            ) => {
                /// For each motor -8192 to 8191.
                RawCommand(commands: Vec<i16>)
                    by esc::decode_commands, esc::encode_commands, list
            };
            RPM = message(1045, "rpm.RPM", 0x1407_07C0_9274_F6E7, fixed(56)) => { Rpm(rpm: Rpm) };
            HARDPOINT_COMMAND = message(
                1070, "hardpoint.Command", 0xA1A0_3626_8B0C_3455, fixed(24),
            ) => {
                HardpointCommand(command: HardpointCommand)
            };
            HARDPOINT_STATUS = message(
                1071, "hardpoint.Status", 0x624A_519D_4255_3D82, fixed(56),
            ) => {
                HardpointStatus(status: HardpointStatus)
            };
            LIGHTS_COMMAND = message(
                1081, "LightsCommand", 0x2031_D93C_8BDD_1EC4, list(0, 24, 20),
            ) => {
                LightsCommand(commands: Vec<LightCommand>)
                    by LightCommand::decode_array, LightCommand::encode_array, list
            };
            CIRCUIT_STATUS = message(1091, "CircuitStatus", 0x8313_D33D_0DDD_A115, fixed(56)) => {
                CircuitStatus(status: CircuitStatus)
            };
            BATTERY_INFO = message(
                1092, "power.BatteryInfo", 0x249C_2654_8A71_1966, list(184, 8, 31),
            ) => {
                BatteryInfo(info: Box<BatteryInfo>)
                    by BatteryInfo::decode, BatteryInfo::encode, display
            };
            ARMING_STATUS = message(1100, "ArmingStatus", 0x8700_F375_556A_8003, fixed(8)) => {
                /// 255 is fully armed, 0 disarmed.
                ArmingStatus(status: u8)
                    by decode_byte, encode_byte, write_arming
            };
            TEMPERATURE = message(1110, "Temperature", 0x7026_1C28_A941_44C6, fixed(40)) => {
                Temperature(temperature: Temperature)
            };
            THESIS_COMMAND = thesis(1111, "thesis.ServoCommand") => {
                /// Servo command of the thesis, 0 to 255 over the full travel.
                ThesisCommand(position: u8)
                    by decode_byte, encode_byte, display
            };
            THESIS_TEMPERATURE = thesis(1112, "thesis.DegreesCelsius") => {
                /// The thesis's temperature in degrees Celsius.
                ThesisTemperature(celsius: u8)
                    by decode_byte, encode_byte, write_celsius
            };
            TUNNEL_BROADCAST = message(
                2010, "tunnel.Broadcast", 0x5AA2_D4D9_CF4B_1E85, list(16, 8, 60),
            );
            TUNNEL_TARGETTED = message(
                3001, "tunnel.Targetted", 0xB138_E7EA_72A2_A2E9, list(48, 8, 120),
            );
            KEY_VALUE = message(
                16370, "debug.KeyValue", 0xE02F_25D6_E0C9_8AE0, list(32, 8, 58),
            ) => {
                KeyValue(pair: KeyValue)
            };
            LOG_MESSAGE = message(
                16383, "debug.LogMessage", 0xD654_A48E_0C04_9D75, list(8, 8, 90),
            ) => {
                LogMessage(message: LogMessage)
            };
            SAFETY_STATE = message(20000, "SafetyState", 0xE965_701A_95A1_A6A1, fixed(8)) => {
                /// ArduPilot's safety switch. At 255 ("off") outputs are enabled, at 0 ("on")
                /// disabled.
                SafetyState(state: u8)
                    by decode_byte, encode_byte, write_safety
            };
            BUTTON = message(20001, "indication.Button", 0x0645_A46E_FBA7_466E, fixed(16)) => {
                /// A button of ArduPilot's nodes.
                Button(button: Button)
            };
            /// Heading and state of ArduPilot's vehicle. Its auxiliary data is not at the end.
            NOTIFY_STATE = message(20007, "NotifyState", 0x631F_2A9C_1651_FDEC, fixed(80));
            /// Of Hobbywing (com.hobbywing.esc).
            GET_ESC_ID = message(20013, "GetEscID", 0x4E2D, list(0, 8, 3));
        }
        services {
            GET_NODE_INFO = service(
                1, "GetNodeInfo", 0xEE46_8A81_21C4_6A9E, fixed(0), list(328, 8, 80),
            ) => {
                request NodeInfoRequest,
                response NodeInfo(info: Box<NodeInfo>)
                    by NodeInfo::decode, NodeInfo::encode, display
            };
            GET_TRANSPORT_STATS = service(
                4, "GetTransportStats", 0xBE6F_76A7_EC31_2B04, fixed(0), list(144, 144, 3),
            ) => {
                request TransportStatsRequest,
                response TransportStats(stats: TransportStats)
            };
            RESTART_NODE = service(
                5, "RestartNode", 0x569E_0539_4A30_17F0, fixed(40), fixed(1),
            ) => {
                /// The magic number.
                request RestartNode(magic: u64)
                    by decode_restart, encode_restart, write_magic,
                /// True if the node restarts.
                response Restarting(ok: bool)
                    by decode_restarted, encode_restarted, write_ok
            };
            EXECUTE_OPCODE = service(
                10, "param.ExecuteOpcode", 0x3B13_1AC5_EB69_D2CD, fixed(56), fixed(49),
            ) => {
                request ExecuteOpcode(opcode: Opcode),
                /// True if the opcode was executed.
                response OpcodeExecuted(ok: bool)
                    by decode_executed, encode_executed, write_ok
            };
            GET_SET = service(
                11, "param.GetSet", 0xA7B6_22F9_39D1_A4D5, list(80, 8, 92), list(288, 8, 92),
            ) => {
                request ParameterRequest(request: ParameterRequest),
                response ParameterResponse(response: ParameterResponse)
            };
            BEGIN_FIRMWARE_UPDATE = service(
                40, "BeginFirmwareUpdate", 0xB7D7_25DF_7272_4126, list(8, 8, 200), list(8, 8, 127),
            ) => {
                /// Node with the file (0: the sender of the request), and the file's path.
                request BeginUpdate(update: NumberAndText)
                    by NumberAndText::decode, NumberAndText::encode, write_update,
                /// Error (0: none), and the reason.
                response UpdateBegun(result: NumberAndText)
                    by NumberAndText::decode, NumberAndText::encode, write_result
            };
            /// Reads a part of a file: at most 256 bytes.
            FILE_READ = service(
                48, "file.Read", 0x8DCD_CA93_9F33_F678, list(40, 8, 200), list(16, 8, 256),
            );
        }
        others {
            message(5, "Panic", 0x8B79_B410_1811_C1D7, list(0, 8, 7));
            service(15, "enumeration.Begin", 0x196A_E064_26A3_B5D8, list(16, 8, 92), fixed(8));
            service(45, "file.GetInfo", 0x5004_891E_E8A2_7531, list(0, 8, 200), fixed(64));
            service(63, "tunnel.Call", 0xDB11_EDC5_1050_2658, list(16, 8, 60), list(0, 8, 60));
            message(342, "Stats", 0x763A_E3B8_A986_F8D1, fixed(224));
            message(380, "enumeration.Indication", 0x884C_B630_50A8_4F35, list(72, 8, 92));
            message(1001, "ahrs.MagneticFieldStrength", 0xE2A7_D4A9_460B_C2F2, list(48, 16, 9));
            message(1002, "ahrs.MagneticFieldStrength2", 0xB6AC_0C44_2430_297E, list(56, 16, 9));
            message(1020, "air_data.TrueAirspeed", 0x306F_69E0_A591_AFAA, fixed(32));
            message(1021, "air_data.IndicatedAirspeed", 0x0A18_92D7_2AB8_945F, fixed(32));
            message(1025, "air_data.AngleOfAttack", 0xD551_3C3F_7AFA_C74E, fixed(40));
            message(1026, "air_data.Sideslip", 0x7B48_E55F_CFF4_2A57, fixed(32));
            message(1028, "air_data.StaticPressure", 0xCDC7_C434_12BD_C89A, fixed(48));
            message(1029, "air_data.StaticTemperature", 0x4927_2A64_77D9_6271, fixed(32));
            message(1032, "hygrometer.Hygrometer", 0xCEB3_0889_2BF1_63E8, fixed(40));
            message(1034, "esc.Status", 0xA9AF_28AE_A2FB_B254, fixed(110));
            message(1036, "esc.StatusExtended", 0x02DC_203C_5096_0EDC, fixed(56));
            message(1044, "camera_gimbal.Status", 0xB9F1_2786_5BE0_D61E, list(80, 16, 9));
            message(1050, "range_sensor.Measurement", 0x68FF_FE70_FC77_1952, fixed(120));
            message(1060, "gnss.Fix", 0x54C1_572B_9E07_F297, list(336, 16, 9));
            message(1061, "gnss.Auxiliary", 0x9BE8_BDC4_C3DB_BFD2, fixed(125));
            message(1062, "gnss.RTCMStream", 0x1F56_030E_CB17_1501, list(8, 8, 128));
            message(1063, "gnss.Fix2", 0xCA41_E700_0F37_435F, list(400, 216, 1));
            message(1080, "BeepCommand", 0xBE9E_A9FE_C2B1_5D52, fixed(32));
            message(1090, "power.PrimaryPowerSupplyStatus", 0xBBA0_5074_AD75_7480, fixed(47));
            message(1129, "ice.FuelTankStatus", 0x286B_4A38_7BA8_4BC4, fixed(104));
            message(1140, "rc.RCInput", 0x7715_55E5_96AA_B4CF, list(28, 12, 32));
            message(20002, "gnss.Heading", 0x315C_AE39_ECED_3412, fixed(34));
            message(20003, "gnss.Status", 0xBA3C_B4AB_BB00_7F69, fixed(56));
            message(20004, "power.BatteryInfoAux", 0x7D7F_49FC_7548_4882, fixed(137));
            message(20005, "gnss.MovingBaselineData", 0x09F3_2374_8C32_133A, list(0, 8, 300));
            message(20006, "gnss.RelPosHeading", 0xA172_7AF2_95F9_4478, fixed(153));
            message(20010, "power.BatteryContinuous", 0x756B_5613_40D5_E4AE, fixed(200));
            message(20011, "power.BatteryPeriodic", 0x0F01_2494_E973_58D2, fixed(272));
            message(20012, "power.BatteryCells", 0x5C8B_1ABD_1589_0EA4, fixed(21));
            message(20790, "trafficmonitor.TrafficReport", 0x68E4_5DB6_0B69_81F8, fixed(375));
            message(21910, "proximity_sensor.Proximity", 0x99DD_3985_FB32_22CE, fixed(64));
        }
        }
    };
}
pub(crate) use table;
