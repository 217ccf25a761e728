//! The table of the draft's data types. The rows have the form of those of v0
//! ([`table`](crate::table)).
//!
//! IDs and signatures are those of 2015-03-19, except ArrayCommand: its definition is the last one
//! without a unit. The thesis's two types are its own.

macro_rules! table {
    ($callback:ident) => {
        $callback! {
        messages {
            ARRAY_COMMAND = message(265, "draft.ArrayCommand", 0x1679_B64E_1786_5FFF) => {
                ArrayCommand(commands: Vec<ActuatorCommand>)
                    by ActuatorCommand::decode_array, ActuatorCommand::encode_array, list
            };
            NODE_STATUS = message(550, "draft.NodeStatus", 0xE5EB_F57B_2D92_835D) => {
                NodeStatus(status: NodeStatus)
            };
            THESIS_COMMAND = named(Kind::Message, 760, "draft.ThesisCommand") => {
                /// Servo command of the thesis, 0 to 255 over the full travel.
                ThesisCommand(position: u8) by decode_byte, encode_byte, display
            };
            THESIS_MEASUREMENT = named(Kind::Message, 761, "draft.ThesisMeasurement") => {
                /// Measurement of a node of the thesis: degrees Celsius, or the number of presses
                /// of its button.
                ThesisMeasurement(number: u8) by decode_byte, encode_byte, display
            };
        }
        services {
            GET_NODE_INFO = service(551, "draft.GetNodeInfo", 0x1CC6_F807_395C_AE42) => {
                request NodeInfoRequest,
                response NodeInfo(info: Box<NodeInfo>)
                    by NodeInfo::decode, NodeInfo::encode, display
            };
            RESTART_NODE = service(560, "draft.RestartNode", 0x569E_0539_4A30_17F0) => {
                /// The magic number.
                request RestartNode(magic: u64)
                    by decode_restart, encode_restart, write_magic,
                /// True if the node restarts.
                response Restarting(ok: bool)
                    by decode_restarted, encode_restarted, write_ok
            };
            GET_SET = service(599, "draft.param.GetSet", 0xDD4B_B39E_5963_C2C1) => {
                request ParameterRequest(request: ParameterRequest)
                    by parameters::decode_request, parameters::encode_request, display,
                response ParameterResponse(response: ParameterResponse)
                    by parameters::decode_response, parameters::encode_response, display
            };
        }
        others {
            message(600, "draft.actuator.Status", 0xE091_86B4_F837_A665);
            named(Kind::Message, 551, "draft.GlobalDiscoveryRequest");
            named(Kind::Message, 660, "draft.hardpoint.Command");
            named(Kind::Message, 661, "draft.hardpoint.Status");
            named(Kind::Message, 748, "draft.LightsCommand");
            named(Kind::Message, 1022, "draft.debug.KeyValue");
            named(Kind::Message, 1023, "draft.debug.LogMessage");
            named(Kind::Service, 583, "draft.file.Read");
            named(Kind::Service, 589, "draft.BeginFirmwareUpdate");
            named(Kind::Service, 598, "draft.param.ExecuteOpcode");
        }
        }
    };
}
pub(crate) use table;
