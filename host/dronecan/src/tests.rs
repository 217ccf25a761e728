//! Tests of the codec with bytes of another implementation, pydronecan 1.0.27, in both directions.

use super::management::NumberAndText;
use super::*;
use half::f16;
use proptest::prelude::*;
use std::time::Duration;

/// Time of all frames where the time does not matter.
const AT: Duration = Duration::ZERO;

/// Golden frames of one transfer: identifier, then the data in hexadecimal, separated by `|`.
struct Golden {
    id: u32,
    data: Vec<Vec<u8>>,
}

#[track_caller]
fn golden(text: &str) -> Golden {
    let (id, data) = text.split_once(' ').unwrap();
    let field = |field: &str| {
        let bytes = field.split_whitespace();
        bytes.map(|b| u8::from_str_radix(b, 16).unwrap()).collect()
    };
    Golden { id: u32::from_str_radix(id, 16).unwrap(), data: data.split('|').map(field).collect() }
}

/// Assembles the frames of a golden transfer; the last one must complete it.
#[track_caller]
fn assemble(vector: &Golden) -> Transfer {
    let mut assembler = Assembler::new();
    let (last, parts) = vector.data.split_last().unwrap();
    for part in parts {
        assert_eq!(assembler.push(vector.id, part, AT), Outcome::Partial);
    }
    match assembler.push(vector.id, last, AT) {
        Outcome::Complete(transfer) => transfer,
        other => panic!("not complete: {other:?}"),
    }
}

/// Checks that a golden transfer decodes to `message`, and that `message` encodes to it.
#[track_caller]
fn both_ways(vector: &str, message: Message, text: &str) {
    let vector = golden(vector);
    let transfer = assemble(&vector);
    assert_eq!(Message::decode(&transfer), message);
    assert_eq!(message.to_string(), text);
    let (data_type, payload) = message.encode().unwrap();
    assert_eq!(transfer.id.build(), vector.id);
    assert_eq!(DataType::of(transfer.id), Some(data_type));
    let seed = data_type.seed.unwrap_or(0);
    assert_eq!(split(&payload, transfer.transfer_id, seed), vector.data);
}

/// Checks a golden transfer of a type that is not decoded: it must assemble with a valid CRC and
/// split into the same frames.
#[track_caller]
fn carried(vector: &str, name: &str) {
    let vector = golden(vector);
    let transfer = assemble(&vector);
    assert_eq!(transfer.id.build(), vector.id);
    let data_type = DataType::of(transfer.id).unwrap();
    let message = Message::decode(&transfer).to_string();
    assert!(message.starts_with(name), "{message}");
    let seed = data_type.seed.unwrap();
    assert_eq!(split(&transfer.payload, transfer.transfer_id, seed), vector.data);
}

fn command(actuator: u8, unit: CommandUnit, value: f32) -> ActuatorCommand {
    let value = f16::from_f32(value);
    ActuatorCommand { actuator, unit, value }
}

#[test]
fn node_status_equals_pydronecan() {
    both_ways(
        "1801552A 78 56 34 12 40 EF BE C5",
        Message::NodeStatus(NodeStatus {
            uptime_s: 0x1234_5678,
            health: Health::Warning,
            vendor_code: 0xBEEF,
            ..NodeStatus::default()
        }),
        "NodeStatus WARNING OPERATIONAL up 305419896 s vendor 0xBEEF",
    );
    both_ways(
        "10015501 01 00 00 00 08 00 00 C0",
        Message::NodeStatus(NodeStatus {
            uptime_s: 1,
            mode: Mode::Initialization,
            ..NodeStatus::default()
        }),
        "NodeStatus OK INITIALIZATION up 1 s vendor 0x0000",
    );
}

#[test]
fn array_command_of_one_frame_equals_pydronecan() {
    both_ways(
        "1003F20A 01 00 00 38 C7",
        Message::ArrayCommand(vec![command(1, CommandUnit::Unitless, 0.5)]),
        "ArrayCommand id 1 unitless +0.50",
    );
}

#[test]
fn array_command_of_two_frames_equals_pydronecan() {
    both_ways(
        "1003F20A 12 F3 01 00 00 38 02 88 | 00 00 BC 03 04 DC 65 68",
        Message::ArrayCommand(vec![
            command(1, CommandUnit::Unitless, 0.5),
            command(2, CommandUnit::Unitless, -1.0),
            command(3, CommandUnit::Pwm, 1500.0),
        ]),
        "ArrayCommand id 1 unitless +0.50, id 2 unitless -1.00, id 3 PWM 1500 us",
    );
}

/// NaN is not equal to itself, so this compares the decoded form as text. The bytes must survive
/// the round trip.
#[test]
fn actuator_status_equals_pydronecan() {
    let vector = golden("1803F32A 67 C0 01 00 34 FF 7F 81 | FF 7F 7F 61");
    let transfer = assemble(&vector);
    let message = Message::decode(&transfer);
    let (data_type, payload) = message.encode().unwrap();
    assert_eq!(message.to_string(), "actuator.Status id 1 position +0.25");
    let seed = data_type.seed.unwrap();
    assert_eq!(split(&payload, TransferId::new(1), seed), vector.data);
}

#[test]
fn temperature_equals_pydronecan() {
    both_ways(
        "1804562A 01 00 A9 5C 00 C2",
        Message::Temperature(Temperature {
            device: 1,
            kelvin: f16::from_f32(298.25),
            over: false,
            under: false,
        }),
        "Temperature device 1 298.25 K (25.1 C)",
    );
}

#[test]
fn circuit_status_equals_pydronecan() {
    let status = |circuit, voltage, current, errors| CircuitStatus {
        circuit,
        voltage: f16::from_f32(voltage),
        current: f16::from_f32(current),
        errors,
    };
    both_ways(
        "18044378 34 12 4D 4A 66 C2 06 C5",
        Message::CircuitStatus(status(0x1234, 12.6, -3.2, 6)),
        "CircuitStatus circuit 4660 12.60 V -3.20 A UNDERVOLTAGE OVERCURRENT",
    );
    let vector = golden("18044378 78 00 4D 4A FF 7F 00 C5");
    let message = Message::decode(&assemble(&vector));
    assert_eq!(
        message.to_string(),
        "CircuitStatus circuit 120 12.60 V",
        "a current of NaN is unknown and not shown"
    );
    assert_eq!(message.encode().unwrap().1, vector.data[0][..7]);
    assert_eq!(
        status(1, 0.0, 0.0, 0x81).to_string(),
        "circuit 1 0.00 V 0.00 A OVERVOLTAGE flags 0x80"
    );
}

#[test]
fn battery_info_equals_pydronecan() {
    let charging = BatteryInfo {
        temperature: f16::from_f32(310.5),
        voltage: f16::from_f32(25.2),
        current: f16::from_f32(-3.2),
        average_power: f16::from_f32(80.0),
        remaining_wh: f16::from_f32(40.0),
        full_wh: f16::from_f32(50.0),
        hours_to_full: f16::from_f32(1.5),
        flags: 0x10B,
        health: 93,
        charge: 80,
        charge_deviation: 5,
        battery: 3,
        model_instance: 0x1234_5678,
        model: b"LiPo 6S".to_vec(),
    };
    both_ways(
        "18044478 AA 24 DA 5C 4D 4E 66 89 | C2 00 55 00 51 40 52 29 | 00 3E 0B 37 68 05 03 09 | \
         78 56 34 12 4C 69 50 29 | 6F 20 36 53 49",
        Message::BatteryInfo(Box::new(charging)),
        "power.BatteryInfo battery 3 25.20 V -3.20 A 80 % 40.0 Wh 37.4 C CHARGING TEMP_HOT \
         BMS_ERROR",
    );
    let vector = golden(
        "18044478 E8 B5 FF 7F 40 4A 00 80 | 49 FF 7F FF 7F FF 7F 20 | 00 00 01 1F FF FF 00 00 | \
         00 00 00 00 60",
    );
    assert_eq!(
        Message::decode(&assemble(&vector)).to_string(),
        "power.BatteryInfo battery 0 12.50 V 10.00 A",
        "what is unknown is not shown"
    );
}

#[test]
fn hardpoints_equal_pydronecan() {
    both_ways(
        "18042E0A 01 01 00 C0",
        Message::HardpointCommand(HardpointCommand { hardpoint: 1, command: 1 }),
        "hardpoint.Command 1 hold",
    );
    both_ways(
        "10042E0A 05 34 12 C3",
        Message::HardpointCommand(HardpointCommand { hardpoint: 5, command: 0x1234 }),
        "hardpoint.Command 5 hold 4660",
    );
    both_ways(
        "18042F78 05 C0 48 00 34 00 00 C2",
        Message::HardpointStatus(HardpointStatus {
            hardpoint: 5,
            weight: f16::from_f32(9.5),
            weight_variance: f16::from_f32(0.25),
            status: 0,
        }),
        "hardpoint.Status 5 release 9.5 N",
    );
    let unknown = golden("18042F78 05 FF 7F FF 7F 01 00 C2");
    assert_eq!(Message::decode(&assemble(&unknown)).to_string(), "hardpoint.Status 5 hold");
}

#[test]
fn revolutions_equal_pydronecan() {
    let rpm = |sensor, flags, rpm| Message::Rpm(Rpm { sensor, flags, rpm });
    both_ways("18041578 03 00 00 00 80 BB 45 C2", rpm(3, 0, 6000.0), "rpm.RPM 3 6000 rpm");
    both_ways("18041578 FF 00 00 00 60 6A 47 C0", rpm(255, 0, 60_000.0), "rpm.RPM 255 60000 rpm");
    both_ways("18041578 00 01 00 00 00 00 00 C5", rpm(0, 1, 0.0), "rpm.RPM 0 0 rpm UNHEALTHY");
    both_ways("18041578 00 00 00 00 00 77 42 C5", rpm(0, 0, 61.75), "rpm.RPM 0 61.8 rpm");
}

#[test]
fn raw_commands_equal_pydronecan() {
    let raw = |commands: &[i16]| Message::RawCommand(commands.to_vec());
    both_ways("00040601 C4", raw(&[]), "esc.RawCommand (empty)");
    both_ways("00040601 01 00 C4", raw(&[1]), "esc.RawCommand 1");
    both_ways("00040601 01 00 08 00 C4", raw(&[1, 2]), "esc.RawCommand 1, 2");
    both_ways("00040601 01 00 08 00 30 00 C4", raw(&[1, 2, 3]), "esc.RawCommand 1, 2, 3");
    both_ways(
        "0704060A FF 7C 02 00 00 3F FF C1",
        raw(&[8191, -8192, 0, -1]),
        "esc.RawCommand 8191, -8192, 0, -1",
    );
    both_ways(
        "0704060A 1C 29 FF 7C 02 00 00 82 | 3F FF 00 40 04 06 40 22 | 0D 12 42",
        raw(&[8191, -8192, 0, -1, 4096, 1, 100, 4660]),
        "esc.RawCommand 8191, -8192, 0, -1, 4096, 1, 100, 4660",
    );
    let twenty: Vec<i16> = (1..=20).map(|n| 400 * n).collect();
    both_ways(
        "0704060A 0D 57 90 04 80 3B 01 83 | 10 06 D0 1D 80 9F 02 23 | A0 0C 10 3A 80 F3 04 03 | \
         70 12 50 53 81 57 05 23 | C0 19 90 68 81 CB 07 03 | 50 1F 63",
        raw(&twenty),
        "esc.RawCommand 400, 800, 1200, 1600, 2000, 2400, 2800, 3200, 3600, 4000, 4400, 4800, \
         5200, 5600, 6000, 6400, 6800, 7200, 7600, 8000",
    );
}

#[test]
fn raw_commands_of_an_impossible_length_are_shown_as_bytes() {
    for length in
        (0..=40).filter(|length| !(0..=20).any(|count| (14usize * count).div_ceil(8) == *length))
    {
        assert_eq!(esc::decode_commands(&vec![0; length]), None, "{length} bytes");
    }
    let message = Message::decode(&assemble(&golden("0704060A 01 02 03 C1")));
    assert_eq!(message.to_string(), "esc.RawCommand 010203");
}

#[test]
fn arming_status_equals_pydronecan() {
    both_ways("18044C0A FF C0", Message::ArmingStatus(255), "ArmingStatus armed");
}

#[test]
fn the_types_of_the_thesis_are_one_byte() {
    both_ways("10045701 80 C3", Message::ThesisCommand(128), "thesis.ServoCommand 128");
    both_ways("1804582A 17 DF", Message::ThesisTemperature(23), "thesis.DegreesCelsius 23 C");
}

#[test]
fn node_information_equals_pydronecan() {
    both_ways("1E01AAFF C3", Message::NodeInfoRequest, "GetNodeInfo request");
    let info = NodeInfo {
        status: NodeStatus { uptime_s: 10, ..NodeStatus::default() },
        software: (1, 2),
        commit: Some(0xDEAD_BEEF),
        image_crc: None,
        hardware: (1, 0),
        unique_id: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15],
        certificate: Vec::new(),
        name: b"org.example.servo".to_vec(),
    };
    both_ways(
        "1E017FAA 4B 03 0A 00 00 00 00 83 | 00 00 01 02 01 EF BE 23 | AD DE 00 00 00 00 00 03 | \
         00 00 00 01 00 00 01 23 | 02 03 04 05 06 07 08 03 | 09 0A 0B 0C 0D 0E 0F 23 | 00 6F 72 \
         67 2E 65 78 03 | 61 6D 70 6C 65 2E 73 23 | 65 72 76 6F 43",
        Message::NodeInfo(Box::new(info)),
        "GetNodeInfo response org.example.servo software 1.2 commit deadbeef hardware 1.0 unique \
         ID 000102030405060708090A0B0C0D0E0F",
    );
}

fn request(index: u16, value: Value, name: &[u8]) -> Message {
    Message::ParameterRequest(ParameterRequest { index, value, name: name.to_vec() })
}

#[test]
fn parameter_requests_equal_pydronecan() {
    both_ways("1E0BAAFF 00 00 C0", request(0, Value::Empty, b""), "param.GetSet request index 0");
    both_ways(
        "1E0BF8FF 2C 08 C8",
        request(300, Value::Empty, b""),
        "param.GetSet request index 300",
    );
    both_ways(
        "1E0BF8FF AC 76 00 00 43 41 4E 82 | 5F 4E 4F 44 45 62",
        request(0, Value::Empty, b"CAN_NODE"),
        "param.GetSet request CAN_NODE",
    );
    both_ways(
        "1E0BAAFF C5 16 00 01 2A 00 00 81 | 00 00 00 00 00 43 41 21 | 4E 5F 4E 4F 44 45 41",
        request(0, Value::Integer(42), b"CAN_NODE"),
        "param.GetSet request CAN_NODE = 42",
    );
    both_ways(
        "1E0BF8FF 3A DA 00 02 00 80 89 85 | 44 4F 55 54 31 5F 4D 25 | 49 4E 45",
        request(0, Value::Real(1100.0), b"OUT1_MIN"),
        "param.GetSet request OUT1_MIN = 1100.0",
    );
    both_ways(
        "1E0BF8FF 85 7E 00 03 01 41 52 86 | 4D 5F 52 45 51 66",
        request(0, Value::Boolean(true), b"ARM_REQ"),
        "param.GetSet request ARM_REQ = true",
    );
    both_ways(
        "1E0BF8FF 72 AD 00 04 03 61 62 87 | 63 4F 55 54 31 5F 4D 27 | 49 4E 47",
        request(0, Value::Text(b"abc".to_vec()), b"OUT1_MIN"),
        "param.GetSet request OUT1_MIN = \"abc\"",
    );
}

#[test]
fn parameter_responses_equal_pydronecan() {
    let response = |value, default, max, min, name: &[u8]| {
        let [value, default, max, min] = [value, default, max, min].map(Value::Integer);
        Message::ParameterResponse(ParameterResponse {
            value,
            default,
            max,
            min,
            name: name.to_vec(),
        })
    };
    both_ways(
        "1E0B7FAA CD 88 01 2A 00 00 00 81 | 00 00 00 00 01 00 00 21 | 00 00 00 00 00 00 01 01 | \
         7F 00 00 00 00 00 00 21 | 00 01 00 00 00 00 00 01 | 00 00 00 43 41 4E 5F 21 | 4E 4F 44 \
         45 41",
        response(42, 0, 127, 0, b"CAN_NODE"),
        "param.GetSet response CAN_NODE = 42 (0 to 127, default 0)",
    );
    both_ways(
        "1E0B7FF8 7E 1C 01 D8 FF FF FF 89 | FF FF FF FF 01 D8 FF 29 | FF FF FF FF FF FF 01 09 | \
         96 00 00 00 00 00 00 29 | 00 01 C9 FF FF FF FF 09 | FF FF FF 54 45 4D 50 29 | 5F 4D 49 \
         4E 49",
        response(-40, -40, 150, -55, b"TEMP_MIN"),
        "param.GetSet response TEMP_MIN = -40 (-55 to 150, default -40)",
    );
    both_ways(
        "1E0B7FF8 00 00 00 00 C2",
        Message::ParameterResponse(ParameterResponse::default()),
        "param.GetSet response no such parameter",
    );
}

#[test]
fn opcodes_and_restarts_equal_pydronecan() {
    both_ways(
        "1E0AAAFF 00 00 00 00 00 00 00 C4",
        Message::ExecuteOpcode(Opcode::SAVE),
        "param.ExecuteOpcode request SAVE",
    );
    both_ways(
        "1E0AF8FF 01 00 00 00 00 00 00 C5",
        Message::ExecuteOpcode(Opcode::ERASE),
        "param.ExecuteOpcode request ERASE",
    );
    both_ways(
        "1E0A7FAA 00 00 00 00 00 00 80 C4",
        Message::OpcodeExecuted(true),
        "param.ExecuteOpcode response ok",
    );
    both_ways(
        "1E05AAFF 1E 1B 55 CE AC C6",
        Message::RestartNode(RESTART_MAGIC),
        "RestartNode request",
    );
    both_ways("1E057FAA 80 C6", Message::Restarting(true), "RestartNode response ok");
    both_ways("1E057FF8 00 C7", Message::Restarting(false), "RestartNode response FAILED");
    let wrong = Message::RestartNode(0xBE_EFCA_FE00);
    assert_eq!(wrong.to_string(), "RestartNode request with the wrong number 0xBEEFCAFE00");
}

#[test]
fn firmware_updates_equal_pydronecan() {
    let pair = |number, text: &[u8]| NumberAndText { number, text: text.to_vec() };
    both_ways(
        "1E28AAFF 7F 66 77 2E 62 69 6E C9",
        Message::BeginUpdate(pair(127, b"fw.bin")),
        "BeginFirmwareUpdate request of \"fw.bin\" from node 127",
    );
    both_ways(
        "1E287FF8 07 C4 01 75 70 64 61 89 | 74 65 20 6F 76 65 72 29 | 20 55 53 42 20 73 65 09 | \
         72 69 61 6C 69",
        Message::UpdateBegun(pair(1, b"update over USB serial")),
        "BeginFirmwareUpdate response INVALID_MODE \"update over USB serial\"",
    );
}

#[test]
fn counters_equal_pydronecan() {
    both_ways("1E04F8FF CA", Message::TransportStatsRequest, "GetTransportStats request");
    both_ways(
        "1E047FF8 F9 20 01 00 00 00 00 8A | 00 BC 9A 78 56 34 12 2A | 03 00 00 00 00 00 04 0A | \
         00 00 00 00 00 05 00 2A | 00 00 00 00 06 00 00 0A | 00 00 00 6A",
        Message::TransportStats(TransportStats {
            transfers_tx: 1,
            transfers_rx: 0x1234_5678_9ABC,
            transfer_errors: 3,
            interfaces: vec![[4, 5, 6]],
        }),
        "GetTransportStats response transfers out 1 in 20015998343868 errors 3, frames out 4 in 5 \
         errors 6",
    );
    both_ways(
        "18015778 63 D2 00 04 03 02 01 83 | 01 00 02 00 03 00 04 23 | 00 05 00 0D 0C 0B 0A 03 | \
         06 00 07 00 08 00 63",
        Message::CanStats(CanStats {
            interface: 0,
            tx_requests: 0x0102_0304,
            tx_rejected: 1,
            tx_overflow: 2,
            tx_success: 3,
            tx_timedout: 4,
            tx_abort: 5,
            rx_received: 0x0A0B_0C0D,
            rx_overflow: 6,
            rx_errors: 7,
            busoff_errors: 8,
        }),
        "CanStats interface 0 out 3/16909060 rejected 1 overflow 2 timed out 4 aborted 5, in \
         168496141 overflow 6 errors 7 bus-off 8",
    );
    let pair = KeyValue { value: 3.0, key: b"btn".to_vec() };
    both_ways(
        "183FF278 00 00 40 40 62 74 6E C1",
        Message::KeyValue(pair),
        "debug.KeyValue btn = 3",
    );
}

#[test]
fn log_messages_equal_pydronecan() {
    let message = |level, source: &[u8], text: &[u8]| {
        Message::LogMessage(LogMessage { level, source: source.to_vec(), text: text.to_vec() })
    };
    both_ways(
        "183FFF78 7B AB 40 46 41 49 4C 80 | 53 41 46 45 20 6F 66 20 | 20 6F 75 74 70 75 74 00 | \
         20 31 60",
        message(2, b"", b"FAILSAFE of output 1"),
        "debug.LogMessage WARNING: FAILSAFE of output 1",
    );
    assert_eq!(LogMessage::decode(&[0x25, b'a']), None, "the source is cut");
    let text = message(3, b"esc", b"hot\x1b").to_string();
    assert_eq!(text, "debug.LogMessage ERROR from esc: hot\\x1b");
}

#[test]
fn lights_and_switches_equal_pydronecan() {
    let light = |light, red, green, blue| LightCommand { light, red, green, blue };
    both_ways(
        "1804390A 05 F8 00 C0",
        Message::LightsCommand(vec![light(5, 31, 0, 0)]),
        "LightsCommand id 5 red 31 green 0 blue 0",
    );
    both_ways(
        "1804390A BA 95 05 FA A9 06 0F 81 | FE 07 0F FE 61",
        Message::LightsCommand(vec![light(5, 31, 21, 9), light(6, 1, 63, 30), light(7, 1, 63, 30)]),
        "LightsCommand id 5 red 31 green 21 blue 9, id 6 red 1 green 63 blue 30, id 7 red 1 green \
         63 blue 30",
    );
    both_ways("184E200A FF C2", Message::SafetyState(255), "SafetyState off");
    both_ways(
        "184E2178 01 0A C9",
        Message::Button(Button { button: 1, tenths: 10 }),
        "indication.Button 1 pressed for 1.0 s",
    );
    let state = |yaw: u16, vehicle_state| {
        let aux_data = yaw.to_le_bytes().to_vec();
        Message::NotifyState(NotifyState { aux_data_type: 0, aux_data, vehicle_state })
    };
    both_ways(
        "184E270A 46 6F 00 02 A0 8C 1A 81 | 00 00 00 00 00 00 00 61",
        state(36_000, 1 << 1 | 1 << 3 | 1 << 4),
        "NotifyState heading 0; armed, prearm, prearm GPS",
    );
    both_ways(
        "184E270A C3 25 00 02 78 69 04 81 | 00 00 00 00 00 00 80 61",
        state(27_000, 1 << 2 | 1 << 63),
        "NotifyState heading 90; flying, 0x8000000000000000",
    );
    assert_eq!(NotifyState::decode(&[0, 3, 1, 2, 0, 0, 0, 0, 0, 0, 0, 0]), None, "no state");
}

#[test]
fn allocations_equal_pydronecan() {
    let allocation = |node_id, first_part, len| {
        Message::Allocation(Allocation { node_id, first_part, unique_id: (0..len).collect() })
    };
    both_ways(
        "1E974D00 01 00 01 02 03 04 05 C0",
        allocation(0, true, 6),
        "Allocation first part unique ID 000102030405",
    );
    both_ways(
        "1E00017F 58 5D 00 00 01 02 03 81 | 04 05 06 07 08 09 0A 21 | 0B 41",
        allocation(0, false, 12),
        "Allocation unique ID 000102030405060708090A0B",
    );
    both_ways(
        "1E00017F 8A 68 FA 00 01 02 03 82 | 04 05 06 07 08 09 0A 22 | 0B 0C 0D 0E 0F 42",
        allocation(125, false, 16),
        "Allocation node ID 125 unique ID 000102030405060708090A0B0C0D0E0F",
    );
}

#[test]
fn an_empty_list_is_shown_as_empty() {
    both_ways("1003F20A C5", Message::ArrayCommand(Vec::new()), "ArrayCommand (empty)");
}

/// Each has its own seed; a wrong one would cause a wrong CRC.
#[test]
fn types_that_are_not_decoded_equal_pydronecan() {
    carried("1E30FFAA 7E F0 00 01 00 00 00 80 | 66 77 2E 62 69 6E 60", "file.Read request");
    carried("18042E0A 01 01 00 C0", "hardpoint.Command");
}

/// The discriminator is the CRC of the payload, shifted (specification, "Anonymous transfers").
#[test]
fn anonymous_identifiers_equal_pydronecan() {
    for vector in [
        "1E974D00 01 00 01 02 03 04 05 C0",
        "1EBC1100 00 06 07 08 09 0A 0B C1",
        "1E9D1D00 00 0C 0D 0E 0F C2",
    ] {
        let vector = golden(vector);
        let transfer = assemble(&vector);
        let discriminator = (crc::feed(crc::INITIAL, &transfer.payload) >> 1) & 0x3FFF;
        let expected = CanId::Anonymous { priority: 30, type_id: 1, discriminator };
        assert_eq!(transfer.id, expected);
        assert_eq!(transfer.id.build(), vector.id);
        assert!(Message::decode(&transfer).to_string().starts_with("Allocation"));
    }
}

/// A row with the ID of another row would never be found.
#[test]
fn each_type_has_an_id_of_its_own() {
    for known in types::KNOWN {
        let source = NodeId::new(1).unwrap();
        let id = match known.kind {
            Kind::Message => known.message_id(16, source),
            Kind::Service => CanId::Service {
                priority: 16,
                service_id: known.id as u8,
                request: true,
                destination: source,
                source,
            },
        };
        assert_eq!(DataType::of(id), Some(known));
    }
}

#[test]
fn a_wrong_byte_in_a_long_transfer_is_noticed() {
    let mut vector = golden("1003F20A 12 F3 01 00 00 38 02 88 | 00 00 BC 03 04 DC 65 68");
    vector.data[1][3] ^= 0x10;
    let mut assembler = Assembler::new();
    assembler.push(vector.id, &vector.data[0], AT);
    let outcome = assembler.push(vector.id, &vector.data[1], AT);
    assert_eq!(outcome, Outcome::Invalid("wrong transfer CRC"));
}

#[test]
fn a_missing_frame_affects_only_its_own_transfer() {
    let payload: Vec<u8> = (0..20).collect();
    let frames = split(&payload, TransferId::new(4), types::ARRAY_COMMAND.seed.unwrap());
    let id = 0x1003_F20A;
    let mut assembler = Assembler::new();
    assert_eq!(assembler.push(id, &frames[0], AT), Outcome::Partial);
    let missing = Outcome::Invalid("a frame of the transfer is missing");
    assert_eq!(assembler.push(id, &frames[2], AT), missing);
    let orphan = Outcome::Invalid("continues a transfer that did not start");
    assert_eq!(assembler.push(id, &frames[3], AT), orphan);
    for frame in &frames[..3] {
        assert_eq!(assembler.push(id, frame, AT), Outcome::Partial);
    }
    assert!(matches!(assembler.push(id, &frames[3], AT), Outcome::Complete(_)));
}

#[test]
fn transfers_of_two_nodes_may_interleave() {
    let payload: Vec<u8> = (0..8).collect();
    let frames = split(&payload, TransferId::new(0), types::ARRAY_COMMAND.seed.unwrap());
    let mut assembler = Assembler::new();
    assert_eq!(assembler.push(0x1003_F20A, &frames[0], AT), Outcome::Partial);
    assert_eq!(assembler.push(0x1003_F20B, &frames[0], AT), Outcome::Partial);
    assert!(matches!(assembler.push(0x1003_F20A, &frames[1], AT), Outcome::Complete(_)));
    assert!(matches!(assembler.push(0x1003_F20B, &frames[1], AT), Outcome::Complete(_)));
}

#[test]
fn a_transfer_times_out_after_two_seconds() {
    let frames = split(&[0; 8], TransferId::new(0), types::ARRAY_COMMAND.seed.unwrap());
    let two_seconds = Duration::from_secs(2);
    for (end, complete) in [(two_seconds, true), (two_seconds + Duration::from_nanos(1), false)] {
        let mut assembler = Assembler::new();
        assembler.push(0x1003_F20A, &frames[0], AT);
        let outcome = assembler.push(0x1003_F20A, &frames[1], end);
        assert_eq!(matches!(outcome, Outcome::Complete(_)), complete);
    }
}

#[test]
fn payloads_of_the_wrong_length_are_shown_as_bytes() {
    let vector = golden("1003F20A 01 00 00 C7");
    let message = Message::decode(&assemble(&vector));
    assert_eq!(message.to_string(), "ArrayCommand 010000");
    let vector = golden("18089901 AB C0");
    let message = Message::decode(&assemble(&vector));
    assert_eq!(message.to_string(), "message 2201 AB");
}

#[test]
fn seven_bytes_are_one_frame_and_eight_are_two() {
    assert_eq!(split(&[0; 7], TransferId::new(0), 0).len(), 1);
    assert_eq!(split(&[0; 8], TransferId::new(0), 0).len(), 2);
    assert_eq!(split(&[0; 12], TransferId::new(0), 0).len(), 2);
    assert_eq!(split(&[0; 13], TransferId::new(0), 0).len(), 3);
}

#[test]
fn transfer_ids_count_modulo_32() {
    let mut id = TransferId::new(31);
    assert_eq!(id.advance().get(), 31);
    assert_eq!(id.get(), 0);
}

proptest! {
    /// A decoded message without unused bits encodes to the same bytes.
    #[test]
    fn parameter_messages_survive_both_ways(
        payload in prop::collection::vec(any::<u8>(), 0..40),
        service in 0usize..3,
    ) {
        let id = [0x1E0B_F8FF, 0x1E0B_7FF8, 0x1E00_017F][service];
        let id = CanId::parse(id).unwrap();
        let transfer = Transfer { id, transfer_id: TransferId::new(0), payload, frames: 1 };
        let message = Message::decode(&transfer);
        if let Some((_, encoded)) = message.encode() {
            let again = Message::decode(&Transfer { payload: encoded, ..transfer });
            prop_assert_eq!(format!("{:?}", again), format!("{:?}", message));
        }
    }

    /// A terminal shows what nodes send.
    #[test]
    fn no_transfer_has_control_characters_as_text(
        id in 0u32..1 << 29,
        payload in prop::collection::vec(any::<u8>(), 0..80),
        known in 0usize..12,
    ) {
        let known = [
            0x1E0B_F8FF, 0x1E0B_7FF8, 0x1E01_7FF8, 0x1E28_FFF8, 0x1E28_7FF8, 0x183F_F22A,
            0x183F_FF2A,
            0x1807_DA2A, 0x180B_B92A, 0x1E04_7FF8, 0x1400_0000 | 1 << 8 | 42, id,
        ][known];
        // A service frame from or to node 0 is not allowed.
        let Some(id) = CanId::parse(known) else { return Err(TestCaseError::reject("not an ID")) };
        let transfer = Transfer { id, transfer_id: TransferId::new(0), payload, frames: 1 };
        let text = Message::decode(&transfer).to_string();
        prop_assert!(!text.contains(char::is_control), "{:?}", text);
    }

    /// No frame from the bus may cause a panic.
    #[test]
    fn no_frame_causes_a_panic(
        frames in prop::collection::vec(
            (0u32..1 << 29, prop::collection::vec(any::<u8>(), 0..=8)),
            0..64,
        ),
    ) {
        let mut assembler = Assembler::new();
        for (id, data) in frames {
            if let Outcome::Complete(transfer) = assembler.push(id, &data, AT) {
                let _ = Message::decode(&transfer).to_string();
            }
        }
    }

    /// Parsing and building an allowed identifier gives the same identifier.
    #[test]
    fn identifiers_survive_parse_and_build(raw in 0u32..1 << 29) {
        if let Some(id) = CanId::parse(raw) {
            prop_assert_eq!(id.build(), raw);
        }
    }

    /// Assembling the frames of a payload gives the payload, at any length.
    #[test]
    fn split_and_assembly_are_inverse(
        payload in prop::collection::vec(any::<u8>(), 0..300),
        number in 0u8..32,
    ) {
        let seed = types::GET_NODE_INFO.seed.unwrap();
        let frames = split(&payload, TransferId::new(number), seed);
        let mut assembler = Assembler::new();
        let mut whole = None;
        for frame in &frames {
            whole = Some(assembler.push(0x1E01_7FAA, frame, AT));
        }
        let Some(Outcome::Complete(transfer)) = whole else { panic!("not complete") };
        prop_assert_eq!(transfer.payload, payload);
        prop_assert_eq!(transfer.frames, frames.len());
    }
}
