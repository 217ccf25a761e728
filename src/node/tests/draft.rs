//! The UAVCAN draft of 2014, beside DroneCAN v0.

use super::*;
use crate::hardware;
use crate::node::acceptance::Row;

/// In the draft, from node 1: actuator 1 to 0.5, and to -1.
const DRAFT_HALF: &str = "084C040A 01 00 38";
const DRAFT_LOW: &str = "084C040B 01 00 BC";

/// The thesis's command in the draft, from node 1: to the upper end.
const DRAFT_THESIS: &str = "17C40409 FF";

/// NodeStatus of node 1 in the draft.
const DRAFT_STATUS: &str = "1134040B 01 00 00 00 00 00";

/// Actuator 1 to 0.5, and a NodeStatus, in v0 from node 10.
const V0_HALF: &str = "1003F20A 01 00 00 38 C7";
const V0_STATUS: &str = "1001550A 01 00 00 00 00 00 00 C0";

/// NodeStatus of node 120 in the draft, without its transfer ID.
const OWN_STATUS: [u8; 3] = [0x11, 0x35, 0xE0];

/// True if the node sent its last status in the draft.
fn speaks_draft(rig: &mut Rig) -> bool {
    rig.can.sent.clear();
    rig.run(1100);
    let statuses: Vec<bool> = rig
        .can
        .sent
        .iter()
        .filter_map(|(_, frame)| {
            let is_draft = frame.id[..3] == OWN_STATUS;
            (is_draft || golden::id(frame) == NODE_STATUS).then_some(is_draft)
        })
        .collect();
    *statuses.last().expect("a status a second")
}

#[test]
fn commands_of_the_draft_move_the_servo_where_nobody_speaks_v0() {
    let mut rig = Rig::new();
    for (text, pulse) in [(DRAFT_HALF, 1750.0), (DRAFT_LOW, 1000.0), (DRAFT_THESIS, 2000.0)] {
        rig.text(text);
        assert_eq!(rig.node.pulse(0), us(pulse), "{text}");
    }
    assert!(speaks_draft(&mut rig));
    assert_eq!(rig.code() & Conditions::DRAFT.code(), Conditions::DRAFT.code());
}

#[test]
fn a_command_of_the_draft_in_two_frames_is_put_together() {
    // 0.5, -1, 0.25 and 1 for actuators 1 to 4, as pydronecan makes it
    // (tests/clients/test_draft.py).
    let first = golden::frame(0x084C_0403, &golden::bytes("BE 8D 01 00 38 02 00 BC"));
    let second = golden::frame(0x084C_041B, &golden::bytes("03 00 34 04 00 3C"));
    for (own_id, pulse) in [(1, 1750.0), (2, 1000.0), (3, 1625.0), (4, 2000.0)] {
        let mut rig = Rig::with(&[(Parameter::Out1Id, own_id)]);
        rig.frames(&[first, second]);
        assert_eq!(rig.node.pulse(0), us(pulse), "actuator {own_id}");
    }
}

#[test]
fn v0_wins_at_once_and_the_draft_is_followed_only_after_v0_has_been_silent_for_three_to_four_seconds()
 {
    for v0 in [V0_HALF, V0_STATUS] {
        for start in [2000, 2300, 2999, 64_990] {
            let mut rig = Rig::with(&[(Parameter::Out1Timeout, 0)]);
            rig.run(start);
            rig.text(DRAFT_LOW);
            assert_eq!(rig.node.pulse(0), us(1000.0));
            rig.text(v0);
            assert_eq!(
                rig.node.pulse(0),
                if v0 == V0_HALF { us(1750.0) } else { us(1000.0) },
                "at once"
            );
            let mut silent_ms = 0;
            while rig.node.pulse(0) != us(2000.0) {
                rig.run(1);
                silent_ms += 1;
                assert!(silent_ms <= 4000, "{v0}");
                rig.text(DRAFT_THESIS);
            }
            assert!(silent_ms >= 3000, "{silent_ms} ms after {v0}");
        }
    }
}

#[test]
fn no_flood_of_the_draft_keeps_v0_out() {
    let mut rig = Rig::new();
    for _ in 0..100 {
        for _ in 0..10 {
            rig.text(DRAFT_LOW);
            rig.text(DRAFT_STATUS);
            rig.run(1);
        }
        rig.text(V0_HALF);
        assert_eq!(rig.node.pulse(0), us(1750.0));
        rig.text(DRAFT_LOW);
        assert_eq!(rig.node.pulse(0), us(1750.0), "v0 is still there");
    }
    assert!(!speaks_draft(&mut rig));
}

#[test]
fn with_dialect_1_nothing_of_the_draft_is_followed() {
    let mut rig = Rig::with(&[(Parameter::Dialect, 1)]);
    for _ in 0..10 {
        rig.text(DRAFT_HALF);
        rig.text(DRAFT_STATUS);
        rig.run(1000);
    }
    assert_eq!(rig.node.pulse(0), 0);
    assert!(!speaks_draft(&mut rig));
    rig.text(V0_HALF);
    assert_eq!(rig.node.pulse(0), us(1750.0));
}

#[test]
fn with_dialect_2_nothing_of_v0_is_followed_and_all_is_sent_in_the_draft() {
    let mut rig = Rig::with(&[(Parameter::Dialect, 2)]);
    for _ in 0..10 {
        rig.text(V0_HALF);
        rig.text(V0_STATUS);
        rig.run(1000);
    }
    assert_eq!(rig.node.pulse(0), 0);
    assert!(speaks_draft(&mut rig));
    assert!(
        rig.can.sent.iter().all(|(_, frame)| golden::id(frame) & 0x0001_FC00 == 0x0001_E000),
        "{:?}",
        rig.can.sent
    );
    rig.text(DRAFT_HALF);
    assert_eq!(rig.node.pulse(0), us(1750.0));
}

#[test]
fn dialect_selects_the_filters() {
    let draft_row = if cfg!(feature = "standard") { Row::Either } else { Row::Thesis };
    for (dialect, row) in [(0, Row::Either), (1, Row::V0), (2, draft_row)] {
        let mut rig = Rig::with(&[(Parameter::Dialect, dialect)]);
        assert_eq!(rig.node.acceptance(InMemory).row, row, "{dialect}");
        rig.run(5000);
        assert_eq!(rig.can.filters_set, 0, "from the start on");
    }
}

#[test]
fn with_another_dialect_the_controller_gets_other_filters() {
    let mut rig = Rig::with(&[(Parameter::Dialect, 1)]);
    rig.run(1000);
    rig.set(Parameter::Dialect, 0);
    rig.run(1);
    assert_eq!(
        (rig.can.filters_set, rig.can.filters.map(|filters| filters.row)),
        (1, Some(Row::Either))
    );
    rig.set(Parameter::Out1Id, 2);
    rig.run(1000);
    assert_eq!(rig.can.filters_set, 1, "another parameter");
    rig.set(Parameter::Dialect, 1);
    rig.run(1);
    assert_eq!(
        (rig.can.filters_set, rig.can.filters.map(|filters| filters.row)),
        (2, Some(Row::V0))
    );
}

#[test]
fn requests_of_the_draft_are_answered_in_it() {
    let mut rig = Rig::new();
    rig.run(100);
    rig.can.sent.clear();
    // GetNodeInfo from node 127 to node 120.
    rig.text("113BFC0D 78");
    rig.run(10);
    let reply: Vec<Frame> = rig
        .can
        .sent
        .iter()
        .map(|(_, frame)| *frame)
        .filter(|frame| golden::id(frame) & !0xFF == 0x1139_E000)
        .collect();
    // Each frame has the destination, the index, the transfer ID, and the last-frame bit.
    for (n, frame) in reply.iter().enumerate() {
        let last = if n + 1 == reply.len() { 8 } else { 0 };
        assert_eq!(
            (frame.data[0], golden::id(frame) & 0xFF),
            (127, (n as u32) << 4 | last | 5),
            "{reply:?}"
        );
    }
    let stream: Vec<u8> = reply.iter().flat_map(|frame| frame.data()[1..].to_vec()).collect();
    let (crc, payload) = stream.split_at(2);
    // The CRC is over the signature of GetNodeInfo as pydronecan makes it
    // (tests/clients/test_draft.py), and then the payload.
    let summed = 0x1CC6_F807_395C_AE42u64.to_le_bytes();
    let sum =
        summed.iter().chain(payload).fold(0xFFFF, |sum, &byte| dronecan_wire::crc::add(sum, byte));
    assert_eq!(crc, sum.to_le_bytes());
    // A status of six bytes, then the versions, the unique ID and the name.
    assert_eq!(payload.len(), usize::from(information::NODE_INFO_LEN) - 1);
    assert_eq!(payload[23..39], *rig.node.unique_id());
    assert!(payload.ends_with(hardware::NODE_NAME.as_bytes()));
    // RestartNode with its magic number.
    rig.can.sent.clear();
    rig.text("1183FC0E 78 1E 1B 55 CE AC");
    rig.run(5);
    let restarted = rig.can.sent.iter().find(|(_, frame)| frame.id == [0x11, 0x81, 0xE0, 0x0E]);
    assert_eq!(restarted.map(|(_, frame)| frame.data().to_vec()), Some(vec![127, 0x80]));
    rig.run(150);
    assert!(rig.is_to_restart);
}
