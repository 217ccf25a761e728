//! The node without a node ID, and how it gets one.

use super::*;
use dronecan_wire::{Id, crc};

const UNIQUE_ID: [u8; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

/// Golden responses of an allocator on node 127.
const ANSWERS: [&str; 3] = [
    "1E00017F 00 00 01 02 03 04 05 C0",
    "1E00017F 58 5D 00 00 01 02 03 81 | 04 05 06 07 08 09 0A 21 | 0B 41",
    "1E00017F 8A 68 FA 00 01 02 03 82 | 04 05 06 07 08 09 0A 22 | 0B 0C 0D 0E 0F 42",
];

/// A node without an ID, with the unique ID of the golden frames.
fn anonymous() -> Rig {
    with_unique_id(&UNIQUE_ID, &[&rates(50, 1, 10)[..], &[(Parameter::CanNode, 0)]].concat())
}

/// A node whose EEPROM has this unique ID, as docs/parameters.md lays it out, and these parameters.
fn with_unique_id(unique_id: &[u8; 16], values: &[(Parameter, i32)]) -> Rig {
    let mut memory = Memory::with(values);
    let crc = unique_id.iter().fold(0x0100, |crc, &byte| crc::add(crc, byte));
    memory.cells[0x04..0x14].copy_from_slice(unique_id);
    memory.cells[0x14..0x16].copy_from_slice(&crc.to_be_bytes());
    memory.cells[0x16] = 0;
    let mut rig = Rig::start(memory, ResetCause::POWER_ON);
    rig.settle();
    rig
}

/// True if the controller got new filters since the last call.
fn takes_filters(rig: &mut Rig) -> bool {
    rig.idle();
    core::mem::take(&mut rig.can.filters_set) != 0
}

/// Runs until the node sends a frame. Returns the frame, and the milliseconds that it took.
fn next_frame(rig: &mut Rig) -> (String, u32) {
    let (before, start) = (rig.can.sent.len(), rig.ms);
    while rig.can.sent.len() == before {
        assert!(rig.ms < start + 2000, "nothing is sent");
        rig.run(1);
    }
    let (ms, frame) = rig.can.sent[before];
    assert_eq!(rig.can.sent.len(), before + 1);
    (golden::text(&[frame]), ms - start)
}

#[test]
fn the_golden_conversation_gives_it_a_node_id() {
    let mut rig = anonymous();
    assert_eq!(rig.program.node.acceptance(InMemory).node, None);
    for (request, answer) in [
        ("1E974D00 01 00 01 02 03 04 05 C0", ANSWERS[0]),
        ("1EBC1100 00 06 07 08 09 0A 0B C1", ANSWERS[1]),
        ("1E9D1D00 00 0C 0D 0E 0F C2", ANSWERS[2]),
    ] {
        let (frame, waited_ms) = next_frame(&mut rig);
        assert_eq!(frame, request);
        let expected = if rig.can.sent.len() == 1 { 600..=1000 } else { 0..=400 };
        assert!(expected.contains(&waited_ms), "{waited_ms} ms");
        assert!(!takes_filters(&mut rig));
        rig.text(answer);
    }
    assert_eq!(rig.program.node.id(), 125);
    assert!(takes_filters(&mut rig));
    assert!(!takes_filters(&mut rig), "once");
    assert_eq!(rig.program.node.acceptance(InMemory).node, NodeId::new(125));
    rig.can.sent.clear();
    rig.run(3000);
    assert!(
        rig.can.sent.iter().all(|(_, frame)| Id::from_bytes(frame.id).source() == 125),
        "all from its new ID"
    );
    assert!(rig.transfers(0x1801_557D, 0).len() >= 3, "statuses");
}

#[test]
fn without_an_id_it_sends_nothing_but_requests_600_to_1000_ms_apart() {
    let mut rig = anonymous();
    let mut times = vec![0];
    for n in 0..60u32 {
        // Events that must not make the node send anything else.
        rig.is_pressed = n % 2 == 0;
        rig.status_of(10);
        rig.command(PWM, 1500.0);
        rig.text("1E0180FF C3");
        rig.text("1E01F8FF C3");
        rig.run(1000);
    }
    for (n, (ms, frame)) in rig.can.sent.iter().enumerate() {
        let expected =
            golden::frames(&format!("1E974D00 01 00 01 02 03 04 05 {:02X}", 0xC0 | n & 31));
        assert_eq!(golden::text(&[*frame]), golden::text(&expected));
        times.push(*ms);
    }
    assert!(times.len() > 60);
    for gap in gaps(&times) {
        assert!((600..=1001).contains(&gap), "{gap} ms");
    }
}

#[test]
fn an_answer_to_another_node_makes_it_begin_again() {
    let mut rig = anonymous();
    next_frame(&mut rig);
    rig.text(ANSWERS[0]);
    rig.run(1);
    rig.can.sent.clear();
    let ms = rig.ms;
    // The response has another unique ID.
    rig.text("1E00017F 00 44 C0 8B 63 5E 05 C0");
    let (frame, _) = next_frame(&mut rig);
    assert!(frame.starts_with("1E974D00 01 00 01 02 03 04 05 "), "{frame}");
    assert!((600..=1000).contains(&(rig.can.sent[0].0 - ms)), "{} ms", rig.can.sent[0].0 - ms);
}

#[test]
fn a_request_of_another_node_makes_it_begin_again() {
    // Received before the follow-up is due.
    let mut rig = anonymous();
    next_frame(&mut rig);
    rig.text(ANSWERS[0]);
    let ms = rig.ms;
    rig.text("1EEE8100 01 44 C0 8B 63 5E 05 C0");
    let (frame, waited_ms) = next_frame(&mut rig);
    assert!(frame.starts_with("1E974D00 01 00 01 02 03 04 05 "), "{frame}");
    assert!((600..=1000).contains(&waited_ms), "{waited_ms} ms after {ms}");
}

#[test]
fn every_allocation_message_puts_its_next_request_off() {
    for text in ["1E00017F 00 44 C0 8B 63 5E 05 C0", "1EEE8100 01 44 C0 8B 63 5E 05 C0"] {
        let mut rig = anonymous();
        for _ in 0..40 {
            rig.text(text);
            rig.run(500);
        }
        assert_eq!(rig.can.sent, [], "{text}");
    }
}

#[test]
fn a_grant_for_another_node_is_not_taken() {
    let mut rig = anonymous();
    rig.text("1E000101 29 BA FA 44 C0 8B 63 82 | 5E 05 F4 BC 10 96 DF 22 | 11 A8 BA 54 47 42");
    assert_eq!((rig.program.node.id(), takes_filters(&mut rig)), (0, false));
    let unique_id = golden::bytes("44 C0 8B 63 5E 05 F4 BC 10 96 DF 11 A8 BA 54 47");
    let mut rig = with_unique_id(unique_id.first_chunk().unwrap(), &[(Parameter::CanNode, 0)]);
    rig.text("1E000101 29 BA FA 44 C0 8B 63 82 | 5E 05 F4 BC 10 96 DF 22 | 11 A8 BA 54 47 42");
    assert_eq!(
        (rig.program.node.id(), takes_filters(&mut rig)),
        (125, true),
        "the same for the right one"
    );
}

#[test]
fn with_an_id_of_its_own_it_never_asks_and_takes_no_grant() {
    let mut rig = with_unique_id(&UNIQUE_ID, &[]);
    for answer in ANSWERS {
        rig.text(answer);
        rig.run(1000);
    }
    assert_eq!((rig.program.node.id(), takes_filters(&mut rig)), (120, false));
    assert!(rig.can.sent.iter().all(|(_, frame)| Id::from_bytes(frame.id).source() == 120));
}

#[test]
fn the_id_that_was_granted_is_not_kept() {
    let mut rig = anonymous();
    rig.text(ANSWERS[2]);
    assert_eq!(rig.program.node.id(), 125);
    // ExecuteOpcode SAVE to node 125.
    rig.text("1E0AFDFF 00 00 00 00 00 00 00 C4");
    rig.run(3000);
    let rig = Rig::start(rig.board.memory, ResetCause::ASKED_FOR);
    assert_eq!(rig.program.node.id(), 0);
}

#[test]
fn its_unique_id_is_made_once_and_kept() {
    let first = Rig::start(Memory::blank(), ResetCause::POWER_ON);
    let unique_id = *first.program.node.unique_id();
    assert_ne!(unique_id, [0; 16]);
    let mut again = Node::new();
    let mut memory = first.board.memory;
    again.start(
        ResetCause::POWER_ON,
        false,
        &mut memory,
        || unreachable!(),
        InMemory,
        &mut Monitor::new(),
    );
    assert_eq!(*again.unique_id(), unique_id);
}
