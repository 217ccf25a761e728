//! The table of data types: a row has all that is to be said of one type.
//!
//! ```text
//! NAME = type;                             a type that is not decoded
//! NAME = type => { Variant(field: Fields) };
//! NAME = type => { Variant(field: Fields) by decode, encode, write };
//! ```
//!
//! NAME is the constant in [`types`](crate::types). The type has the data type ID, the name that
//! views show, the CRC seed and the length of the payload; ID and seed are those of
//! [`dronecan_wire`]. Variant is that of [`Message`](crate::Message). A service has two variants,
//! `request` and `response`; one without fields has no parentheses. Three functions belong to a
//! variant:
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
//! Source: public DroneCAN DSDL; lengths computed with pydronecan 1.0.27. The thesis's two types
//! need no seed, because they fit in one frame.

macro_rules! table {
    ($callback:ident) => {
        $callback! {
        messages {
            ALLOCATION = message(wire::ALLOCATION, "Allocation", list(8, 8, 16)) => {
                Allocation(allocation: Allocation)
            };
            GLOBAL_TIME_SYNC = message(wire::GLOBAL_TIME_SYNC, "GlobalTimeSync", fixed(56));
            NODE_STATUS = message(wire::NODE_STATUS, "NodeStatus", fixed(56)) => {
                NodeStatus(status: NodeStatus)
            };
            CAN_STATS = message(wire::CAN_STATS, "CanStats", fixed(200)) => {
                CanStats(stats: CanStats)
            };
            ARRAY_COMMAND = message(wire::ARRAY_COMMAND, "ArrayCommand", list(0, 32, 15)) => {
                ArrayCommand(commands: Vec<ActuatorCommand>)
                    by ActuatorCommand::decode_array, ActuatorCommand::encode_array, list
            };
            ACTUATOR_STATUS = message(wire::ACTUATOR_STATUS, "actuator.Status", fixed(64)) => {
                ActuatorStatus(status: ActuatorStatus)
            };
            RAW_COMMAND = message(wire::ESC_RAW_COMMAND, "esc.RawCommand", list(0, 14, 20)) => {
                /// For each motor -8192 to 8191.
                RawCommand(commands: Vec<i16>)
                    by esc::decode_commands, esc::encode_commands, list
            };
            RPM = message(wire::RPM, "rpm.RPM", fixed(56)) => { Rpm(rpm: Rpm) };
            HARDPOINT_COMMAND = message(
                wire::HARDPOINT_COMMAND, "hardpoint.Command", fixed(24),
            ) => {
                HardpointCommand(command: HardpointCommand)
            };
            HARDPOINT_STATUS = message(
                wire::HARDPOINT_STATUS, "hardpoint.Status", fixed(56),
            ) => {
                HardpointStatus(status: HardpointStatus)
            };
            LIGHTS_COMMAND = message(
                wire::LIGHTS_COMMAND, "LightsCommand", list(0, 24, 20),
            ) => {
                LightsCommand(commands: Vec<LightCommand>)
                    by LightCommand::decode_array, LightCommand::encode_array, list
            };
            CIRCUIT_STATUS = message(wire::CIRCUIT_STATUS, "CircuitStatus", fixed(56)) => {
                CircuitStatus(status: CircuitStatus)
            };
            BATTERY_INFO = message(
                wire::BATTERY_INFO, "power.BatteryInfo", list(184, 8, 31),
            ) => {
                BatteryInfo(info: Box<BatteryInfo>)
                    by BatteryInfo::decode, BatteryInfo::encode, display
            };
            ARMING_STATUS = message(wire::ARMING_STATUS, "ArmingStatus", fixed(8)) => {
                /// 255 is fully armed, 0 disarmed.
                ArmingStatus(status: u8)
                    by decode_byte, encode_byte, write_arming
            };
            TEMPERATURE = message(wire::DEVICE_TEMPERATURE, "Temperature", fixed(40)) => {
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
                wire::TUNNEL_BROADCAST, "tunnel.Broadcast", list(16, 8, 60),
            );
            TUNNEL_TARGETTED = message(
                wire::TUNNEL_TARGETTED, "tunnel.Targetted", list(48, 8, 120),
            );
            KEY_VALUE = message(wire::KEY_VALUE, "debug.KeyValue", list(32, 8, 58)) => {
                KeyValue(pair: KeyValue)
            };
            LOG_MESSAGE = message(wire::LOG_MESSAGE, "debug.LogMessage", list(8, 8, 90)) => {
                LogMessage(message: LogMessage)
            };
            SAFETY_STATE = message(wire::SAFETY_STATE, "SafetyState", fixed(8)) => {
                /// ArduPilot's safety switch. At 255 ("off") outputs are enabled, at 0 ("on")
                /// disabled.
                SafetyState(state: u8)
                    by decode_byte, encode_byte, write_safety
            };
            BUTTON = message(wire::INDICATION_BUTTON, "indication.Button", fixed(16)) => {
                /// A button of ArduPilot's nodes.
                Button(button: Button)
            };
            /// Heading and state of ArduPilot's vehicle. Its auxiliary data is not at the end.
            NOTIFY_STATE = message(wire::NOTIFY_STATE, "NotifyState", fixed(80)) => {
                NotifyState(state: NotifyState)
            };
            /// Of Hobbywing (com.hobbywing.esc).
            GET_ESC_ID = message(wire::Message::new(20013, 0x4E2D), "GetEscID", list(0, 8, 3));
            /// Of dronecan.remoteid. Its first list is not at the end.
            BASIC_ID = message(
                wire::Message::new(20030, 0x5B1C_624A_8E4F_C533), "BasicID", list(16, 8, 42),
            );
        }
        services {
            GET_NODE_INFO = service(
                wire::GET_NODE_INFO, "GetNodeInfo", fixed(0), list(328, 8, 80),
            ) => {
                request NodeInfoRequest,
                response NodeInfo(info: Box<NodeInfo>)
                    by NodeInfo::decode, NodeInfo::encode, display
            };
            GET_TRANSPORT_STATS = service(
                wire::GET_TRANSPORT_STATS, "GetTransportStats", fixed(0), list(144, 144, 3),
            ) => {
                request TransportStatsRequest,
                response TransportStats(stats: TransportStats)
            };
            RESTART_NODE = service(wire::RESTART_NODE, "RestartNode", fixed(40), fixed(1)) => {
                /// The magic number.
                request RestartNode(magic: u64)
                    by decode_restart, encode_restart, write_magic,
                /// True if the node restarts.
                response Restarting(ok: bool)
                    by decode_restarted, encode_restarted, write_ok
            };
            EXECUTE_OPCODE = service(
                wire::EXECUTE_OPCODE, "param.ExecuteOpcode", fixed(56), fixed(49),
            ) => {
                request ExecuteOpcode(opcode: Opcode),
                /// True if the opcode was executed.
                response OpcodeExecuted(ok: bool)
                    by decode_executed, encode_executed, write_ok
            };
            GET_SET = service(
                wire::GET_SET, "param.GetSet", list(80, 8, 92), list(288, 8, 92),
            ) => {
                request ParameterRequest(request: ParameterRequest),
                response ParameterResponse(response: ParameterResponse)
            };
            BEGIN_FIRMWARE_UPDATE = service(
                wire::BEGIN_FIRMWARE_UPDATE, "BeginFirmwareUpdate",
                list(8, 8, 200), list(8, 8, 127),
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
                wire::FILE_READ, "file.Read", list(40, 8, 200), list(16, 8, 256),
            );
        }
        others {
            message(wire::PANIC, "Panic", list(0, 8, 7));
            service(wire::ENUMERATION_BEGIN, "enumeration.Begin", list(16, 8, 92), fixed(8));
            service(wire::FILE_GET_INFO, "file.GetInfo", list(0, 8, 200), fixed(64));
            service(wire::TUNNEL_CALL, "tunnel.Call", list(16, 8, 60), list(0, 8, 60));
            message(wire::NODE_STATS, "Stats", fixed(224));
            message(wire::ENUMERATION_INDICATION, "enumeration.Indication", list(72, 8, 92));
            message(wire::MAGNETIC_FIELD_STRENGTH, "ahrs.MagneticFieldStrength", list(48, 16, 9));
            message(wire::MAGNETIC_FIELD_STRENGTH2, "ahrs.MagneticFieldStrength2", list(56, 16, 9));
            message(wire::TRUE_AIRSPEED, "air_data.TrueAirspeed", fixed(32));
            message(wire::INDICATED_AIRSPEED, "air_data.IndicatedAirspeed", fixed(32));
            message(wire::ANGLE_OF_ATTACK, "air_data.AngleOfAttack", fixed(40));
            message(wire::SIDESLIP, "air_data.Sideslip", fixed(32));
            message(wire::STATIC_PRESSURE, "air_data.StaticPressure", fixed(48));
            message(wire::STATIC_TEMPERATURE, "air_data.StaticTemperature", fixed(32));
            message(wire::HYGROMETER, "hygrometer.Hygrometer", fixed(40));
            message(wire::ESC_STATUS, "esc.Status", fixed(110));
            message(wire::ESC_STATUS_EXTENDED, "esc.StatusExtended", fixed(56));
            message(wire::CAMERA_GIMBAL_STATUS, "camera_gimbal.Status", list(80, 16, 9));
            message(wire::RANGE_SENSOR_MEASUREMENT, "range_sensor.Measurement", fixed(120));
            message(wire::GNSS_FIX, "gnss.Fix", list(336, 16, 9));
            message(wire::GNSS_AUXILIARY, "gnss.Auxiliary", fixed(125));
            message(wire::RTCM_STREAM, "gnss.RTCMStream", list(8, 8, 128));
            message(wire::GNSS_FIX2, "gnss.Fix2", list(400, 216, 1));
            message(wire::BEEP_COMMAND, "BeepCommand", fixed(32));
            message(wire::PRIMARY_POWER_SUPPLY_STATUS, "power.PrimaryPowerSupplyStatus", fixed(47));
            message(wire::FUEL_TANK_STATUS, "ice.FuelTankStatus", fixed(104));
            message(wire::RC_INPUT, "rc.RCInput", list(28, 12, 32));
            message(wire::GNSS_HEADING, "gnss.Heading", fixed(34));
            message(wire::GNSS_STATUS, "gnss.Status", fixed(56));
            message(wire::BATTERY_INFO_AUX, "power.BatteryInfoAux", fixed(137));
            message(wire::MOVING_BASELINE_DATA, "gnss.MovingBaselineData", list(0, 8, 300));
            message(wire::REL_POS_HEADING, "gnss.RelPosHeading", fixed(153));
            message(wire::BATTERY_CONTINUOUS, "power.BatteryContinuous", fixed(200));
            message(wire::BATTERY_PERIODIC, "power.BatteryPeriodic", fixed(272));
            message(wire::BATTERY_CELLS, "power.BatteryCells", fixed(21));
            message(wire::TRAFFIC_REPORT, "trafficmonitor.TrafficReport", fixed(375));
            message(wire::PROXIMITY_SENSOR_PROXIMITY, "proximity_sensor.Proximity", fixed(64));
        }
        }
    };
}
pub(crate) use table;
