use super::super::crc;
use super::*;
use crate::progmem::InMemory;

const REQUESTS: [(Kind, u8); 6] = [
    (Kind::GET_NODE_INFO, 1),
    (Kind::GET_TRANSPORT_STATS, 4),
    (Kind::RESTART_NODE, 5),
    (Kind::EXECUTE_OPCODE, 10),
    (Kind::GET_SET, 11),
    (Kind::BEGIN_FIRMWARE_UPDATE, 40),
];

const RECEIVED: [(Kind, u16); 6] = [
    (Kind::ALLOCATION, 1),
    (Kind::NODE_STATUS, 341),
    (Kind::ARRAY_COMMAND, 1010),
    (Kind::LIGHTS_COMMAND, 1081),
    (Kind::ARMING_STATUS, 1100),
    (Kind::SERVO_COMMAND, 1111),
];

#[test]
fn signatures_of_the_dsdl_amount_to_the_seeds_in_use() {
    for (signature, kind) in [
        (0xEE46_8A81_21C4_6A9Eu64, Kind::GET_NODE_INFO),
        (0xA7B6_22F9_39D1_A4D5, Kind::GET_SET),
        (0xBE6F_76A7_EC31_2B04, Kind::GET_TRANSPORT_STATS),
        (0xB7D7_25DF_7272_4126, Kind::BEGIN_FIRMWARE_UPDATE),
        (0x0B2A_8126_20A1_1D40, Kind::ALLOCATION),
        (0xD8A7_4862_38EC_3AF3, Kind::ARRAY_COMMAND),
        (0x2031_D93C_8BDD_1EC4, Kind::LIGHTS_COMMAND),
        (0x5E9B_BA44_FAF1_EA04, Kind::ACTUATOR_STATUS),
        (0xCE08_0CAE_3CA3_3C75, Kind::CAN_STATS),
    ] {
        let seed = signature.to_le_bytes().iter().fold(0xFFFF, |sum, &byte| crc::add(sum, byte));
        assert_eq!(seed, kind.seed(InMemory), "{signature:016X}");
    }
}

#[test]
fn messages_and_services_of_the_same_number_are_told_apart() {
    assert_eq!(Kind::of_message([0, 1], InMemory), Kind::ALLOCATION);
    assert_eq!(Kind::of_service(1, InMemory), Kind::GET_NODE_INFO);
    assert_eq!(Kind::of_message([0x03, 0xF2], InMemory), Kind::ARRAY_COMMAND);
    assert_eq!(Kind::of_message([0x02, 0xF2], InMemory), Kind::UNKNOWN, "the same low byte");
    assert_eq!(Kind::of_service(48, InMemory), Kind::UNKNOWN);
}

#[test]
fn of_all_services_only_the_six_that_are_served_are_known() {
    for data_type in 0..=u8::MAX {
        let expected = REQUESTS.iter().find(|&&(_, id)| id == data_type).map_or(Kind::UNKNOWN, |&(kind, _)| kind);
        assert_eq!(Kind::of_service(data_type, InMemory), expected, "service {data_type}");
    }
}

#[test]
fn of_all_messages_that_a_bus_may_carry_only_the_six_in_use_are_known() {
    // Standard and vendor-specific types (specification, chapter 5).
    for data_type in 0..=20_999u16 {
        let expected = RECEIVED.iter().find(|&&(_, id)| id == data_type).map_or(Kind::UNKNOWN, |&(kind, _)| kind);
        assert_eq!(Kind::of_message(data_type.to_be_bytes(), InMemory), expected, "message {data_type}");
    }
}

#[test]
fn requests_are_requests_and_messages_are_none() {
    for (kind, _) in REQUESTS {
        assert!(kind.is_request(), "{kind:?}");
    }
    for (kind, _) in RECEIVED {
        assert!(!kind.is_request(), "{kind:?}");
    }
}

#[test]
fn what_the_node_sends_has_the_ids_of_the_dsdl() {
    for (kind, data_type) in [
        (Kind::OWN_STATUS, 341),
        (Kind::DEGREES_CELSIUS, 1112),
        (Kind::ACTUATOR_STATUS, 1011),
        (Kind::TEMPERATURE, 1110),
        (Kind::CAN_STATS, 343),
        (Kind::KEY_VALUE, 16370),
    ] {
        assert_eq!(u16::from_be_bytes([kind.id_high(InMemory), kind.id_low(InMemory)]), data_type);
    }
}
