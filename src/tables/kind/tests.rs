use super::*;
use crate::golden;
use crate::tables::publication::Publication;

/// Services and their IDs (DSDL).
const REQUESTS: &[(Kind, u8)] = &[
    #[cfg(not(feature = "draft"))]
    (Kind::GetNodeInfo, 1),
    #[cfg(not(feature = "draft"))]
    (Kind::RestartNode, 5),
    #[cfg(feature = "stats")]
    (Kind::GetTransportStats, 4),
    #[cfg(feature = "standard")]
    (Kind::ExecuteOpcode, 10),
    #[cfg(feature = "standard")]
    (Kind::GetSet, 11),
    #[cfg(feature = "standard")]
    (Kind::BeginFirmwareUpdate, 40),
];

/// Messages of DroneCAN v0 and their IDs (DSDL).
const RECEIVED: &[(Kind, u16)] = &[
    #[cfg(feature = "allocation")]
    (Kind::Allocation, 1),
    (Kind::NodeStatus, 341),
    #[cfg(not(feature = "draft"))]
    (Kind::ArrayCommand, 1010),
    #[cfg(feature = "outputs")]
    (Kind::RawCommand, 1030),
    #[cfg(feature = "relay")]
    (Kind::HardpointCommand, 1070),
    #[cfg(feature = "lights")]
    (Kind::LightsCommand, 1081),
    #[cfg(feature = "standard")]
    (Kind::ArmingStatus, 1100),
    (Kind::ServoCommand, 1111),
    #[cfg(feature = "tunnel")]
    (Kind::Targetted, 3001),
    #[cfg(feature = "safety")]
    (Kind::SafetyState, 20_000),
];

#[test]
fn the_table_has_these_and_no_others() {
    let known: Vec<Kind> =
        REQUESTS.iter().map(|row| row.0).chain(RECEIVED.iter().map(|row| row.0)).collect();
    for kind in Kind::ALL {
        assert!(
            known.contains(kind),
            "{kind:?}, type {}, has no row above: docs/contributing.md, Add a message that the \
             node receives",
            kind.id()
        );
    }
    assert_eq!(Kind::ALL.len(), known.len(), "a row above is of no kind in this build");
}

#[test]
fn signatures_of_the_dsdl_amount_to_the_seeds_in_use() {
    let seeds: &[(u64, u16)] = &[
        (golden::ARRAY_COMMAND, Kind::ArrayCommand.seed()),
        (golden::GET_NODE_INFO, Kind::GetNodeInfo.seed()),
        #[cfg(feature = "outputs")]
        (golden::RAW_COMMAND, Kind::RawCommand.seed()),
        #[cfg(feature = "lights")]
        (golden::LIGHTS_COMMAND, Kind::LightsCommand.seed()),
        #[cfg(feature = "allocation")]
        (golden::ALLOCATION, Kind::Allocation.seed()),
        #[cfg(feature = "standard")]
        (golden::GET_SET, Kind::GetSet.seed()),
        #[cfg(feature = "standard")]
        (golden::BEGIN_FIRMWARE_UPDATE, Kind::BeginFirmwareUpdate.seed()),
        #[cfg(feature = "stats")]
        (golden::GET_TRANSPORT_STATS, Kind::GetTransportStats.seed()),
        #[cfg(feature = "standard")]
        (golden::ACTUATOR_STATUS, Publication::ActuatorStatus.seed()),
        #[cfg(feature = "stats")]
        (golden::CAN_STATS, Publication::CanStats.seed()),
    ];
    for &(signature, expected) in seeds {
        let seed = golden::crc(signature, &[]);
        assert_eq!(expected, seed, "the seed of the type with the signature {signature:016X}");
    }
}

#[test]
fn whatever_can_be_several_frames_has_a_seed() {
    for &kind in Kind::ALL {
        assert!(!kind.is_long() || kind.seed() != 0, "{kind:?}");
    }
}

/// The kind of the row with this ID.
fn kind_of<I: Copy + PartialEq>(rows: &[(Kind, I)], id: I) -> Kind {
    rows.iter().find(|row| row.1 == id).map_or(Kind::Unknown, |row| row.0)
}

#[test]
fn only_services_and_messages_in_use_are_known() {
    for service in 0..=u8::MAX {
        let expected = kind_of(REQUESTS, service);
        assert_eq!(Kind::of_request(service), expected, "service {service}");
    }
    for data_type in 0..=u16::MAX {
        let expected = kind_of(RECEIVED, data_type);
        assert_eq!(Kind::of_message(data_type), expected, "message {data_type}");
    }
}

#[test]
fn requests_are_requests_and_messages_are_none() {
    for &(kind, id) in REQUESTS {
        assert!(kind.is_request() && kind.id() == u16::from(id), "{kind:?}");
    }
    for &(kind, id) in RECEIVED {
        assert!(!kind.is_request() && kind.id() == id, "{kind:?}");
    }
}

#[test]
fn what_the_node_sends_has_the_ids_of_the_dsdl() {
    // A build has NONE for those that it leaves out.
    let sent = [
        (Publication::NodeStatus, if cfg!(feature = "draft") { 550 } else { 341 }),
        (Publication::DegreesCelsius, 761),
        (Publication::Presses, 761),
        (Publication::ActuatorStatus, 1011),
        (Publication::Temperature, 1110),
        (Publication::CanStats, 343),
        (Publication::KeyValue, 16370),
        (Publication::Button, 20001),
        (Publication::LogMessage, 16383),
        (Publication::Targetted, 3001),
        (Publication::FailsafeOutputs, 16370),
        (Publication::CircuitStatus, 1091),
        (Publication::HardpointStatus, 1071),
        (Publication::BatteryInfo, 1092),
        (Publication::Rpm, 1045),
        (Publication::Allocation, 1),
    ]
    .into_iter()
    .filter(|(publication, _)| *publication != Publication::NONE);
    for publication in Publication::all() {
        assert!(
            sent.clone().any(|(known, _)| known == publication),
            "{publication:?}, type {}, has no row above: docs/contributing.md, Add a message that \
             the node sends",
            publication.data_type()
        );
    }
    for (publication, data_type) in sent {
        let sent = publication.data_type();
        assert_eq!(sent, data_type, "{publication:?} is sent with another type than the DSDL's");
    }
}
