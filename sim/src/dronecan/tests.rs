//! The codec against bytes of another implementation: pydronecan 1.0.27, in both directions.

use super::*;
use half::f16;
use proptest::prelude::*;

/// Frames of one transfer: identifier, then the data fields as hexadecimal, separated by `|`.
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

/// Feeds the frames of a vector; the last must complete the transfer.
#[track_caller]
fn assemble(vector: &Golden) -> Transfer {
    let mut assembler = Assembler::new();
    let (last, parts) = vector.data.split_last().unwrap();
    for part in parts {
        assert_eq!(assembler.push(vector.id, part, 0), Outcome::Partial);
    }
    match assembler.push(vector.id, last, 0) {
        Outcome::Complete(transfer) => transfer,
        other => panic!("not complete: {other:?}"),
    }
}

/// A vector must decode to `message`, and `message` must encode to the vector.
#[track_caller]
fn both_ways(vector: &str, message: Message, text: &str) {
    let vector = golden(vector);
    let transfer = assemble(&vector);
    assert_eq!(Message::decode(&transfer), message);
    assert_eq!(message.to_string(), text);
    let (data_type, payload) = message.encode().unwrap();
    assert_eq!(transfer.id.build(), vector.id);
    assert_eq!(DataType::of(transfer.id), Some(data_type));
    let signature = data_type.signature.unwrap_or(0);
    assert_eq!(split(&payload, transfer.transfer_id, signature), vector.data);
}

/// A vector of a type that is only named: it must assemble with a right CRC and split into the same frames.
#[track_caller]
fn carried(vector: &str, name: &str) {
    let vector = golden(vector);
    let transfer = assemble(&vector);
    assert_eq!(transfer.id.build(), vector.id);
    let data_type = DataType::of(transfer.id).unwrap();
    let message = Message::decode(&transfer).to_string();
    assert!(message.starts_with(name), "{message}");
    let signature = data_type.signature.unwrap();
    assert_eq!(split(&transfer.payload, transfer.transfer_id, signature), vector.data);
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
        Message::NodeStatus(NodeStatus { uptime_s: 1, mode: Mode::Initialization, ..NodeStatus::default() }),
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

/// NaN is not equal to itself, so the decoded form is compared by its text; the bytes must still survive.
#[test]
fn actuator_status_equals_pydronecan() {
    let vector = golden("1803F32A 67 C0 01 00 34 FF 7F 81 | FF 7F 7F 61");
    let transfer = assemble(&vector);
    let message = Message::decode(&transfer);
    let (data_type, payload) = message.encode().unwrap();
    assert_eq!(message.to_string(), "actuator.Status id 1 position +0.25");
    let signature = data_type.signature.unwrap();
    assert_eq!(split(&payload, TransferId::new(1), signature), vector.data);
}

#[test]
fn temperature_equals_pydronecan() {
    both_ways(
        "1804562A 01 00 A9 5C 00 C2",
        Message::Temperature(Temperature { device: 1, kelvin: f16::from_f32(298.25), over: false, under: false }),
        "Temperature device 1 298.25 K (25.1 C)",
    );
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
fn services_and_long_transfers_equal_pydronecan() {
    carried("1E01AAFF C3", "GetNodeInfo request");
    carried(
        "1E017FAA 4B 03 0A 00 00 00 00 83 | 00 00 01 02 01 EF BE 23 | AD DE 00 00 00 00 00 03 | \
         00 00 00 01 00 00 01 23 | 02 03 04 05 06 07 08 03 | 09 0A 0B 0C 0D 0E 0F 23 | \
         00 6F 72 67 2E 65 78 03 | 61 6D 70 6C 65 2E 73 23 | 65 72 76 6F 43",
        "GetNodeInfo response",
    );
    carried("1E0BAAFF 00 00 C0", "param.GetSet request");
    carried(
        "1E0BAAFF C5 16 00 01 2A 00 00 81 | 00 00 00 00 00 43 41 21 | 4E 5F 4E 4F 44 45 41",
        "param.GetSet request",
    );
    carried(
        "1E0B7FAA CD 88 01 2A 00 00 00 81 | 00 00 00 00 01 00 00 21 | 00 00 00 00 00 00 01 01 | \
         7F 00 00 00 00 00 00 21 | 00 01 00 00 00 00 00 01 | 00 00 00 43 41 4E 5F 21 | 4E 4F 44 45 41",
        "param.GetSet response",
    );
    carried("1E0AAAFF 00 00 00 00 00 00 00 C4", "param.ExecuteOpcode request");
    carried("1E05AAFF 1E 1B 55 CE AC C6", "RestartNode request");
    carried("1E28AAFF 7F 66 77 2E 62 69 6E C9", "BeginFirmwareUpdate request");
    carried("1E30FFAA 7E F0 00 01 00 00 00 80 | 66 77 2E 62 69 6E 60", "file.Read request");
    carried("1804390A 05 F8 00 C0", "LightsCommand");
    carried("18042E0A 01 01 00 C0", "hardpoint.Command");
    carried("1E00017F 8A 68 FA 00 01 02 03 82 | 04 05 06 07 08 09 0A 22 | 0B 0C 0D 0E 0F 42", "Allocation");
}

/// The discriminator is the CRC of the payload, shifted (specification, "Anonymous transfers").
#[test]
fn anonymous_identifiers_equal_pydronecan() {
    for vector in ["1E974D00 01 00 01 02 03 04 05 C0", "1EBC1100 00 06 07 08 09 0A 0B C1", "1E9D1D00 00 0C 0D 0E 0F C2"]
    {
        let vector = golden(vector);
        let transfer = assemble(&vector);
        let discriminator = (crc::feed(crc::INITIAL, &transfer.payload) >> 1) & 0x3FFF;
        let expected = CanId::Anonymous { priority: 30, type_id: 1, discriminator };
        assert_eq!(transfer.id, expected);
        assert_eq!(transfer.id.build(), vector.id);
        assert!(Message::decode(&transfer).to_string().starts_with("Allocation"));
    }
}

#[test]
fn a_wrong_byte_in_a_long_transfer_is_noticed() {
    let mut vector = golden("1003F20A 12 F3 01 00 00 38 02 88 | 00 00 BC 03 04 DC 65 68");
    vector.data[1][3] ^= 0x10;
    let mut assembler = Assembler::new();
    assembler.push(vector.id, &vector.data[0], 0);
    let outcome = assembler.push(vector.id, &vector.data[1], 0);
    assert_eq!(outcome, Outcome::Invalid("wrong transfer CRC"));
}

#[test]
fn a_missing_frame_spoils_only_its_own_transfer() {
    let payload: Vec<u8> = (0..20).collect();
    let frames = split(&payload, TransferId::new(4), types::ARRAY_COMMAND.signature.unwrap());
    let id = 0x1003_F20A;
    let mut assembler = Assembler::new();
    assert_eq!(assembler.push(id, &frames[0], 0), Outcome::Partial);
    let missing = Outcome::Invalid("a frame of the transfer is missing");
    assert_eq!(assembler.push(id, &frames[2], 0), missing);
    let orphan = Outcome::Invalid("continues a transfer that did not start");
    assert_eq!(assembler.push(id, &frames[3], 0), orphan);
    for frame in &frames[..3] {
        assert_eq!(assembler.push(id, frame, 0), Outcome::Partial);
    }
    assert!(matches!(assembler.push(id, &frames[3], 0), Outcome::Complete(_)));
}

#[test]
fn transfers_of_two_nodes_may_interleave() {
    let payload: Vec<u8> = (0..8).collect();
    let frames = split(&payload, TransferId::new(0), types::ARRAY_COMMAND.signature.unwrap());
    let mut assembler = Assembler::new();
    assert_eq!(assembler.push(0x1003_F20A, &frames[0], 0), Outcome::Partial);
    assert_eq!(assembler.push(0x1003_F20B, &frames[0], 0), Outcome::Partial);
    assert!(matches!(assembler.push(0x1003_F20A, &frames[1], 0), Outcome::Complete(_)));
    assert!(matches!(assembler.push(0x1003_F20B, &frames[1], 0), Outcome::Complete(_)));
}

#[test]
fn a_transfer_is_given_up_after_two_seconds() {
    let frames = split(&[0; 8], TransferId::new(0), types::ARRAY_COMMAND.signature.unwrap());
    let two_seconds = 2 * crate::F_CPU_HZ;
    for (end, complete) in [(two_seconds, true), (two_seconds + 1, false)] {
        let mut assembler = Assembler::new();
        assembler.push(0x1003_F20A, &frames[0], 0);
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
    /// Bus input never panics, whatever is in it.
    #[test]
    fn any_frame_is_taken(frames in prop::collection::vec((0u32..1 << 29, prop::collection::vec(any::<u8>(), 0..=8)), 0..64)) {
        let mut assembler = Assembler::new();
        for (id, data) in frames {
            if let Outcome::Complete(transfer) = assembler.push(id, &data, 0) {
                let _ = Message::decode(&transfer).to_string();
            }
        }
    }

    /// Parsing loses nothing of an identifier that the dialect allows.
    #[test]
    fn identifiers_survive_parse_and_build(raw in 0u32..1 << 29) {
        if let Some(id) = CanId::parse(raw) {
            prop_assert_eq!(id.build(), raw);
        }
    }

    /// What is split comes together again, at any length.
    #[test]
    fn split_and_assembly_are_inverse(payload in prop::collection::vec(any::<u8>(), 0..300), number in 0u8..32) {
        let frames = split(&payload, TransferId::new(number), types::GET_NODE_INFO.signature.unwrap());
        let mut assembler = Assembler::new();
        let mut whole = None;
        for frame in &frames {
            whole = Some(assembler.push(0x1E01_7FAA, frame, 0));
        }
        let Some(Outcome::Complete(transfer)) = whole else { panic!("not complete") };
        prop_assert_eq!(transfer.payload, payload);
        prop_assert_eq!(transfer.frames, frames.len());
    }
}
