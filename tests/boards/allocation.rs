//! With CAN_NODE 0 the node requests its ID from an allocator (DroneCAN specification, chapter 6).
//! It sends nothing else and ignores all other messages until it has an ID. It generates its unique
//! ID at its first start.

use std::sync::OnceLock;

use bench::Cycles;
use bench::autopilot::Settings;
use bench::can::{Fault, Frame, Id};
use bench::dronecan::{Allocation, CanId, Message, NodeId, TransferId, split, types};
use rig::manage::ms_between;
use rig::{MS, NODE, NODE_STATUS, Program, Rig, SERVO_COMMAND};

const PROGRAM: Program = Program::Full;

/// Allocation message from node 127, the allocator.
const ALLOCATION_FROM_127: u32 = 0x1E00_017F;

/// A request of the node.
#[derive(Clone, Debug, PartialEq)]
struct Request {
    at: Cycles,
    first_part: bool,
    part: Vec<u8>,
}

/// EEPROM of a board with CAN_NODE 0 and a unique ID; and that ID.
fn allocatee() -> (&'static [u8], [u8; 16]) {
    static EEPROM: OnceLock<(Vec<u8>, [u8; 16])> = OnceLock::new();
    let (eeprom, unique_id) = EEPROM.get_or_init(|| another_allocatee(0));
    (eeprom, *unique_id)
}

/// Like [`allocatee`] for another board.
fn another_allocatee(seed: u64) -> (Vec<u8>, [u8; 16]) {
    let mut rig = PROGRAM.new_board();
    if seed > 0 {
        rig.board().avr_mut().seed(seed);
        rig.cut_power();
    }
    rig.wait_for("the first NodeStatus", 2000, |rig| !rig.statuses().is_empty());
    let unique_id = rig.information().unique_id;
    rig.set("CAN_NODE", 0);
    rig.save();
    (rig.board().avr().eeprom(), unique_id)
}

/// A board without an ID, just started; and its unique ID.
fn board_without_id() -> (Rig, [u8; 16]) {
    let (eeprom, unique_id) = allocatee();
    (PROGRAM.with_boards(&[eeprom]), unique_id)
}

/// The node's requests so far. Panics at any other frame of the node.
#[track_caller]
fn requests(rig: &Rig) -> Vec<Request> {
    let from_others = |id: u32| [10, 127].contains(&(id & 0x7F));
    let mut requests = Vec::new();
    for (at, frame) in &rig.traffic {
        let Id::Extended(id) = frame.id else { panic!("{frame}") };
        if from_others(id) {
            continue;
        }
        let Some(CanId::Anonymous { priority, type_id, .. }) = CanId::parse(id) else {
            panic!("{frame} of a board without an ID")
        };
        assert_eq!((priority, type_id), (30, 1), "{frame}");
        let (tail, payload) = frame.data().split_last().unwrap();
        assert_eq!(tail & 0xE0, 0xC0, "{frame}");
        assert_eq!(payload[0] >> 1, 0, "the node must accept any ID: {frame}");
        requests.push(Request {
            at: *at,
            first_part: payload[0] & 1 != 0,
            part: payload[1..].to_vec(),
        });
    }
    requests
}

/// The next request. Panics if it takes longer than `within_ms`.
#[track_caller]
fn next_request(rig: &mut Rig, within_ms: u64) -> Request {
    let seen = requests(rig).len();
    rig.wait_for("request for an ID", within_ms, |rig| requests(rig).len() > seen);
    requests(rig).remove(seen)
}

/// The allocator, node 127, sends an Allocation message.
fn allocate(rig: &mut Rig, node_id: u8, unique_id: &[u8]) {
    let message = Allocation { node_id, first_part: false, unique_id: unique_id.to_vec() };
    let parts = split(&message.encode(), TransferId::default(), types::ALLOCATION.seed.unwrap());
    for data in parts {
        rig.send(ALLOCATION_FROM_127, &data);
    }
}

/// Another node sends the first request for a unique ID that begins with 0xEE.
fn request_as_another_node(rig: &mut Rig) {
    rig.send(0x1E12_3500, &[1, 0xEE, 1, 2, 3, 4, 5, 0xC0]);
}

/// Answers the node's requests up to the last one.
#[track_caller]
fn almost_allocated(rig: &mut Rig, unique_id: [u8; 16]) {
    assert!(next_request(rig, 1100).first_part);
    for confirmed in [6, 12] {
        allocate(rig, 0, &unique_id[..confirmed]);
        let request = next_request(rig, 450);
        assert_eq!(request.part, unique_id[confirmed..16.min(confirmed + 6)]);
    }
}

#[test]
fn the_three_stages_have_their_parts_and_their_times() {
    let (mut rig, unique_id) = board_without_id();
    let start = rig.now();
    let first = next_request(&mut rig, 1100);
    assert!(
        (600.0..=1050.0).contains(&ms_between(start, first.at)),
        "{} ms",
        ms_between(start, first.at)
    );
    assert_eq!((first.first_part, &first.part[..]), (true, &unique_id[..6]));
    for (confirmed, len) in [(6, 6), (12, 4)] {
        allocate(&mut rig, 0, &unique_id[..confirmed]);
        rig.run_ms(1);
        let heard = rig.now();
        let request = next_request(&mut rig, 420);
        assert!(ms_between(heard, request.at) <= 401.0, "{} ms", ms_between(heard, request.at));
        assert_eq!(
            (request.first_part, &request.part[..]),
            (false, &unique_id[confirmed..confirmed + len])
        );
    }
    let asked = requests(&rig).len();
    allocate(&mut rig, 55, &unique_id);
    rig.run_ms(1500);
    // With an ID the node sends no more requests, but a status at once and then each second, and
    // answers.
    let own = |rig: &Rig| rig.frames(NODE_STATUS | 55);
    assert!((2..=3).contains(&own(&rig).len()), "{}", own(&rig).len());
    let anonymous = rig
        .traffic
        .iter()
        .filter(|(_, frame)| matches!(frame.id, Id::Extended(id) if id & 0xFF == 0));
    assert_eq!(anonymous.count(), asked);
    rig.request_to(55, &Message::NodeInfoRequest);
    rig.run_ms(50);
    let Some((_, _, Message::NodeInfo(info))) = rig.answers().pop() else { panic!("no answer") };
    assert_eq!(info.unique_id, unique_id, "the unique ID of the requests");
    rig.send_command(1, 0, 0.5);
    assert_eq!(rig.settled_pulse_us(), 1750.0);
    assert!(rig.serial.contains("55"), "the serial monitor must show the ID: {}", rig.serial);
}

/// Two boards may send a request at the same moment. The identifiers must differ then; they depend
/// on the content.
#[test]
fn the_identifiers_of_requests_differ_with_their_content() {
    let (mut rig, unique_id) = board_without_id();
    almost_allocated(&mut rig, unique_id);
    let mut ids: Vec<String> = rig
        .traffic
        .iter()
        .map(|(_, frame)| frame.to_string())
        .filter(|text| text[6..8] == *"00")
        .collect();
    ids.dedup_by_key(|text| text[..8].to_owned());
    assert_eq!(ids.len(), 3, "{ids:?}");
}

/// Without an ID the node sends nothing and follows nothing, whatever other nodes send.
#[test]
fn without_an_id_it_accepts_only_allocation_messages() {
    let (mut rig, _) = board_without_id();
    for n in 0..40u8 {
        rig.send_status_from(10);
        rig.send_command(1, 0, 0.5);
        rig.send_commands(&[(1, 0, 0.5), (1, 0, 0.7), (1, 0, 0.6)]);
        rig.send(SERVO_COMMAND | 10, &[99, 0xC0]);
        rig.broadcast(&Message::ArmingStatus(255), n % 32);
        for destination in [0u32, NODE, 125, 127] {
            rig.send(0x1E01_8080 | destination << 8 | 10, &[0xC0]);
            rig.send(0x1E0B_8080 | destination << 8 | 10, &[0, 0, 0xC0]);
            rig.send(0x1E05_8080 | destination << 8 | 10, &[0x1E, 0x1B, 0x55, 0xCE, 0xAC, 0xC0]);
        }
        rig.run_ms(100);
    }
    let own = requests(&rig);
    assert!(own.len() >= 3, "the node must continue to request");
    assert_eq!(rig.pulses, []);
    assert!(!rig.serial.contains("pulse"), "{}", rig.serial);
    assert_eq!(rig.serial.matches("reset:").count(), 1, "{}", rig.serial);
}

/// An anonymous frame must not be repeated after an error: another node without an ID may have sent
/// the same identifier.
#[test]
#[ignore = "takes long: make test-all"]
fn a_request_destroyed_by_an_error_is_not_repeated() {
    for bit in [12, 33, 45, 80, 100] {
        let (mut rig, _) = board_without_id();
        next_request(&mut rig, 1100);
        rig.forget();
        rig.bench.bus().inject(Fault::FlipBit { bit });
        rig.wait_for("error frame", 1100, |rig| rig.error_frames > 0);
        let error = rig.now();
        let next = next_request(&mut rig, 1100);
        let gap = ms_between(error, next.at);
        assert!((590.0..=1010.0).contains(&gap), "{gap} ms after an error in bit {bit}");
        assert_eq!(rig.error_frames, 1);
    }
}

#[test]
fn a_request_that_nobody_acknowledges_is_not_repeated() {
    let (mut rig, unique_id) = board_without_id();
    rig.connect_node(false);
    rig.run_ms(3500);
    // Each attempt adds eight to TEC. Repeated frames would add hundreds.
    let tec = rig.board().chip().borrow().tec();
    assert!((8..=64).contains(&tec), "{tec}");
    rig.connect_node(true);
    rig.forget();
    almost_allocated(&mut rig, unique_id);
    allocate(&mut rig, 9, &unique_id);
    rig.wait_for("status of node 9", 100, |rig| !rig.frames(NODE_STATUS | 9).is_empty());
}

/// A lost arbitration is not an error: the controller sends the request when the bus is idle.
#[test]
fn a_busy_bus_delays_a_request_and_loses_none() {
    let (mut rig, unique_id) = board_without_id();
    // It hears an allocation to another node, so the bus has its bit rate.
    allocate(&mut rig, 0, &[0x55; 6]);
    for _ in 0..30_000 {
        rig.send(0x1804_560A, &[0x55; 8]);
    }
    rig.run_ms(1000);
    rig.peer.borrow_mut().clear_queue();
    rig.forget();
    almost_allocated(&mut rig, unique_id);
}

/// A bus monitor sends GetNodeInfo as soon as it receives a frame of a node.
#[test]
fn it_answers_requests_from_its_first_status_on() {
    for id in [1, 125] {
        let (mut rig, unique_id) = board_without_id();
        almost_allocated(&mut rig, unique_id);
        allocate(&mut rig, id, &unique_id);
        rig.wait_for("status", 100, |rig| !rig.frames(NODE_STATUS | u32::from(id)).is_empty());
        rig.request_to(id, &Message::NodeInfoRequest);
        rig.run_ms(60);
        assert_eq!(rig.answers().len(), 1, "node {id}");
    }
}

#[test]
fn an_allocated_id_is_forgotten_at_a_restart() {
    let (mut rig, unique_id) = board_without_id();
    almost_allocated(&mut rig, unique_id);
    allocate(&mut rig, 66, &unique_id);
    rig.run_ms(300);
    assert!(!rig.frames(NODE_STATUS | 66).is_empty());
    rig.cut_power();
    rig.run_ms(2500);
    assert!(requests(&rig).len() >= 2);
}

#[test]
fn a_node_with_an_id_ignores_allocation() {
    let mut rig = PROGRAM.running();
    let unique_id = rig.information().unique_id;
    for n in 0..10 {
        request_as_another_node(&mut rig);
        allocate(&mut rig, 0, &unique_id[..6]);
        allocate(&mut rig, 77, &unique_id);
        rig.run_ms(100 + n);
    }
    rig.run_ms(1000);
    let sent = |id: u32| {
        let is_its = |frame: &Frame| matches!(frame.id, Id::Extended(other) if other & 0x7F == id);
        rig.traffic.iter().filter(|(_, frame)| is_its(frame)).count()
    };
    assert_eq!(
        (sent(77), sent(0)),
        (0, 10),
        "frames as node 77, and requests of the other node only"
    );
    assert!(rig.statuses().len() >= 2);
}

/// Two boards start at the same moment, with the simulator's allocator.
#[test]
#[ignore = "takes long: make test-all"]
fn two_boards_that_start_together_get_different_ids() {
    let (first, second) = (allocatee(), another_allocatee(5));
    assert_ne!(first.1, second.1);
    let mut rig = PROGRAM.with_boards(&[first.0, &second.0]);
    rig.attach_autopilot(Settings { allocates: true, ..Settings::default() });
    let statuses = |rig: &Rig, id: u32| rig.frames(NODE_STATUS | id).len();
    rig.wait_for("status of both", 15_000, |rig| statuses(rig, 125) > 0 && statuses(rig, 124) > 0);
    let events: Vec<String> =
        rig.autopilot().take_events().into_iter().map(|(_, text)| text).collect();
    for (_, unique_id) in [(first.0, first.1), (&second.0, second.1)] {
        let digits: String = unique_id.iter().map(|byte| format!("{byte:02X}")).collect();
        assert!(events.iter().any(|text| text.ends_with(&digits)), "{digits}: {events:?}");
    }
    rig.forget();
    rig.run_ms(3000);
    for id in [124, 125] {
        assert!((2..=4).contains(&statuses(&rig, id)), "node {id} must keep its ID");
        let node = NodeId::new(id as u8).unwrap().get();
        rig.request_to(node, &Message::NodeInfoRequest);
        rig.run_ms(50);
    }
    let ids: Vec<_> = rig
        .answers()
        .into_iter()
        .filter_map(|(_, _, answer)| match answer {
            Message::NodeInfo(info) => Some(info.unique_id),
            _ => None,
        })
        .collect();
    assert!(ids.contains(&first.1) && ids.contains(&second.1), "{ids:02X?}");
}

// ---- the unique ID ----

/// The simulated watchdog's jitter follows from a seed, which differs between boards.
#[test]
fn two_new_boards_generate_different_unique_ids_and_keep_them() {
    let ids: Vec<[u8; 16]> = (1..=4)
        .map(|seed| {
            let (eeprom, unique_id) = another_allocatee(seed);
            let mut rig = PROGRAM.with_boards(&[&eeprom]);
            let request = next_request(&mut rig, 1100);
            assert_eq!(request.part, unique_id[..6]);
            unique_id
        })
        .collect();
    for (n, a) in ids.iter().enumerate() {
        for b in &ids[..n] {
            let bits: u32 = a.iter().zip(b).map(|(a, b)| (a ^ b).count_ones()).sum();
            assert!((30..=98).contains(&bits), "{bits} of 128 bits differ: {ids:02X?}");
        }
    }
}

#[test]
fn after_a_power_cut_during_the_write_the_unique_id_is_valid() {
    for cut_ms in (0..80).step_by(7) {
        let mut rig = PROGRAM.new_board();
        // Runs to the first write to the EEPROM.
        while rig.board().avr().eeprom().iter().all(|byte| *byte == 0xFF) {
            rig.run_ms(1);
            assert!(rig.now() < 2000 * MS, "the node must write its unique ID");
        }
        rig.run_ms(cut_ms);
        rig.cut_power();
        rig.wait_for("the first NodeStatus", 2000, |rig| !rig.statuses().is_empty());
        rig.run_ms(20);
        let unique_id = rig.information().unique_id;
        rig.cut_power();
        rig.wait_until_up();
        assert_eq!(rig.information().unique_id, unique_id, "cut {cut_ms} ms later");
        assert!(
            unique_id.iter().any(|byte| *byte != 0xFF) && unique_id.iter().any(|byte| *byte != 0)
        );
    }
}
