use super::*;
use crate::dialect::segment;
use crate::golden;
use crate::tables::wire::Receiver;
use dronecan_wire::Verdict;

const UNIQUE_ID: [u8; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

/// An Allocation message with this source (0 for anonymous), node ID, and bytes of a unique ID.
fn message(source: u8, node_id: u8, unique_id: &[u8]) -> Transfer {
    let payload = [&[node_id << 1], unique_id].concat();
    let mut receiver = Receiver::new();
    let mut done = None;
    for frame in golden::transfer(0x1E00_017F, golden::ALLOCATION, 0, &payload) {
        done = match receiver.accept(segment(&frame, 0).unwrap(), 0, 0) {
            Verdict::Message(transfer) => Some(*transfer),
            _ => None,
        };
    }
    let mut transfer = done.unwrap();
    transfer.source = source;
    transfer
}

/// Makes a request. Returns how many bytes of the unique ID it skips because the allocator has
/// them.
fn ask(allocation: &mut Allocation, unique_id: &[u8; 16], now_ms: u16) -> usize {
    let mut payload = vec![];
    allocation.request(unique_id, now_ms, |byte| payload.push(byte));
    let skipped = [0, 6, 12].into_iter().find(|&at| payload[1..] == unique_id[at..16.min(at + 6)]);
    let skipped = skipped.unwrap_or_else(|| panic!("{payload:02X?}"));
    assert_eq!(payload[0], u8::from(skipped == 0), "whether it is the first part");
    skipped
}

fn answer(confirmed: usize) -> Transfer {
    message(127, 0, &UNIQUE_ID[..confirmed])
}

/// Unique IDs that differ in one bit, in several, or in all.
fn unique_ids() -> impl Iterator<Item = [u8; 16]> {
    (0..2000u32).map(|n| {
        let mut id = UNIQUE_ID;
        if n < 1000 {
            id[(n % 16) as usize] ^= (n / 16) as u8;
        } else {
            let mut random = n;
            id = id.map(|byte| {
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                byte ^ (random >> 24) as u8
            });
        }
        id
    })
}

fn asking(unique_id: &[u8; 16], now_ms: u16) -> Allocation {
    let mut allocation = Allocation::new();
    allocation.start(unique_id, now_ms);
    allocation
}

/// Milliseconds from `now_ms` until a request is due.
fn waits(allocation: &Allocation, now_ms: u16) -> u16 {
    (0..5000).find(|&later| allocation.is_due(now_ms.wrapping_add(later))).unwrap()
}

/// The period of requests and the delay of a follow-up (DSDL 1.Allocation.uavcan). A period may
/// begin at the end of a millisecond, so 601 are 600 at least.
const PERIOD_MS: std::ops::RangeInclusive<u16> = 601..=1000;
const FOLLOW_UP_MS: std::ops::RangeInclusive<u16> = 0..=400;

#[test]
fn the_first_request_comes_after_600_to_1000_ms() {
    for now_ms in [0, 1, 40_000, u16::MAX] {
        for unique_id in unique_ids() {
            let waits = waits(&asking(&unique_id, now_ms), now_ms);
            assert!(PERIOD_MS.contains(&waits), "{waits} ms for {unique_id:02X?}");
        }
    }
}

#[test]
fn unanswered_requests_are_600_to_1000_ms_apart_and_not_all_the_same() {
    let mut allocation = asking(&UNIQUE_ID, 0);
    let mut now_ms = 0u16;
    let mut periods = std::collections::BTreeSet::new();
    for _ in 0..500 {
        let period = waits(&allocation, now_ms);
        assert!(PERIOD_MS.contains(&period), "{period} ms");
        periods.insert(period);
        now_ms = now_ms.wrapping_add(period);
        assert_eq!(ask(&mut allocation, &UNIQUE_ID, now_ms), 0, "from the beginning");
    }
    assert!(periods.len() > 50, "{periods:?}");
    assert!(periods.last().unwrap() - periods.first().unwrap() > 300, "{periods:?}");
}

#[test]
fn two_nodes_that_ask_at_the_same_time_soon_do_not() {
    let other = {
        let mut id = UNIQUE_ID;
        id[15] ^= 1;
        id
    };
    let next = |unique_id: &[u8; 16]| {
        let mut allocation = asking(unique_id, 0);
        let mut now_ms = 0u16;
        let mut times = vec![];
        for _ in 0..5 {
            now_ms = now_ms.wrapping_add(waits(&allocation, now_ms));
            ask(&mut allocation, unique_id, now_ms);
            times.push(now_ms);
        }
        times
    };
    assert_ne!(next(&UNIQUE_ID), next(&other));
}

#[test]
fn each_answer_asks_for_the_next_part_within_400_ms_and_the_last_gives_the_id() {
    for now_ms in [0, 65_000] {
        for unique_id in unique_ids() {
            let mut allocation = asking(&unique_id, now_ms);
            let mut now_ms = now_ms;
            for skipped in [0, 6, 12] {
                now_ms = now_ms.wrapping_add(waits(&allocation, now_ms));
                assert_eq!(ask(&mut allocation, &unique_id, now_ms), skipped);
                now_ms = now_ms.wrapping_add(3);
                let confirmed = skipped + if skipped == 12 { 4 } else { 6 };
                let node_id = if confirmed == 16 { 125 } else { 0 };
                let granted = allocation.act_on_message(
                    &message(127, node_id, &unique_id[..confirmed]),
                    &unique_id,
                    now_ms,
                );
                assert_eq!(granted, node_id);
                if confirmed != 16 {
                    let waits = waits(&allocation, now_ms);
                    assert!(FOLLOW_UP_MS.contains(&waits), "{waits} ms");
                }
            }
        }
    }
}

#[test]
fn follow_ups_do_not_all_come_at_the_same_time() {
    let delays: std::collections::BTreeSet<u16> = unique_ids()
        .map(|unique_id| {
            let mut allocation = asking(&unique_id, 0);
            allocation.act_on_message(&message(127, 0, &unique_id[..6]), &unique_id, 0);
            waits(&allocation, 0)
        })
        .collect();
    assert!(delays.len() > 100, "{}", delays.len());
}

#[test]
fn a_follow_up_that_is_not_answered_begins_all_over_after_600_ms_or_more() {
    let mut allocation = asking(&UNIQUE_ID, 0);
    assert_eq!(allocation.act_on_message(&answer(6), &UNIQUE_ID, 1000), 0);
    let asked_ms = 1000 + waits(&allocation, 1000);
    assert_eq!(ask(&mut allocation, &UNIQUE_ID, asked_ms), 6);
    let period = waits(&allocation, asked_ms);
    assert!(PERIOD_MS.contains(&period), "{period} ms");
    assert_eq!(ask(&mut allocation, &UNIQUE_ID, asked_ms + period), 0);
}

/// Asserts that after `transfer` the node waits and begins with the first part again, without an
/// ID, from every stage.
fn sends_back(transfer: &Transfer, what: &str) {
    for confirmed in [0, 6, 12] {
        let mut allocation = asking(&UNIQUE_ID, 0);
        if confirmed != 0 {
            allocation.act_on_message(&answer(confirmed), &UNIQUE_ID, 700);
        }
        assert_eq!(allocation.act_on_message(transfer, &UNIQUE_ID, 1000), 0, "{what}");
        let waits = waits(&allocation, 1000);
        assert!(PERIOD_MS.contains(&waits), "{what}: {waits} ms");
        assert_eq!(ask(&mut allocation, &UNIQUE_ID, 1000 + waits), 0, "{what}");
    }
}

#[test]
fn answers_to_other_nodes_send_it_back_to_waiting() {
    for len in [6, 12, 16] {
        for differs_at in 0..len {
            let mut id = UNIQUE_ID;
            id[differs_at] ^= 0x80;
            sends_back(&message(127, 125, &id[..len]), "another's unique ID");
        }
    }
}

#[test]
fn requests_of_other_nodes_send_it_back_to_waiting() {
    sends_back(&message(0, 0, &[0x44, 0xC0, 0x8B, 0x63, 0x5E, 0x05]), "an anonymous request");
    sends_back(&message(0, 0, &UNIQUE_ID[..6]), "an anonymous request that looks like an answer");
    sends_back(&message(0, 125, &UNIQUE_ID), "an anonymous grant");
}

#[test]
fn a_grant_of_node_id_0_is_none_and_it_asks_again() {
    sends_back(&message(127, 0, &UNIQUE_ID), "node ID 0");
}

#[test]
fn answers_with_no_or_too_much_of_a_unique_id_are_none() {
    sends_back(&message(127, 125, &[]), "nothing of it");
    let long: Vec<u8> = UNIQUE_ID.into_iter().chain([0]).collect();
    sends_back(&message(127, 125, &long), "17 bytes");
    let mut receiver = Receiver::new();
    let empty = golden::frame(0x1E00_017F, &[0xC0]);
    let Verdict::Message(empty) = receiver.accept(segment(&empty, 0).unwrap(), 0, 0) else {
        panic!()
    };
    sends_back(empty, "no payload");
}

#[test]
fn a_grant_is_taken_without_any_request_before_it() {
    // For example, the response to a repeated request comes late.
    for node_id in [1, 42, 125] {
        let mut allocation = asking(&UNIQUE_ID, 0);
        assert_eq!(
            allocation.act_on_message(&message(127, node_id, &UNIQUE_ID), &UNIQUE_ID, 5),
            node_id
        );
    }
}

#[test]
fn a_grant_of_126_or_127_which_are_for_tools_is_refused() {
    for node_id in [126, 127] {
        let mut allocation = asking(&UNIQUE_ID, 0);
        assert_eq!(allocation.act_on_message(&message(127, node_id, &UNIQUE_ID), &UNIQUE_ID, 5), 0);
    }
}

#[test]
fn nothing_is_due_half_a_minute_ahead() {
    let mut allocation = asking(&UNIQUE_ID, 0);
    ask(&mut allocation, &UNIQUE_ID, 10_000);
    for ahead in 0..600 {
        assert!(!allocation.is_due(10_000 + ahead));
    }
    for late in 1000..30_000 {
        assert!(allocation.is_due(10_000 + late));
    }
}
