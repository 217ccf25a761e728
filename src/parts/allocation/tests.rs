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
fn requests_are_600_to_1000_ms_apart_and_not_all_the_same() {
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
    // Half a minute later, too.
    assert!((1000..30_000).all(|late| allocation.is_due(now_ms.wrapping_add(late))));
}

/// The node waits and begins with the first part again, without an ID, from every stage.
#[test]
fn a_message_that_is_no_answer_to_it_sends_it_back_to_waiting() {
    let other = |len: usize, differs_at: usize| {
        let mut id = UNIQUE_ID;
        id[differs_at] ^= 0x80;
        message(127, 125, &id[..len])
    };
    let others = [6, 12, 16].into_iter().flat_map(|len| (0..len).map(move |at| (len, at)));
    let long: Vec<u8> = UNIQUE_ID.into_iter().chain([0]).collect();
    let named = [
        ("another node's request", message(0, 0, &[0x44, 0xC0, 0x8B, 0x63, 0x5E, 0x05])),
        ("a request like an answer", message(0, 0, &UNIQUE_ID[..6])),
        ("an anonymous grant", message(0, 125, &UNIQUE_ID)),
        ("a grant of 0", message(127, 0, &UNIQUE_ID)),
        ("a grant of 126, which is for tools", message(127, 126, &UNIQUE_ID)),
        ("a grant of 127, which is for tools", message(127, 127, &UNIQUE_ID)),
        ("nothing of a unique ID", message(127, 125, &[])),
        ("17 bytes of one", message(127, 125, &long)),
    ];
    let all = named.into_iter().chain(others.map(|(len, at)| ("another's ID", other(len, at))));
    for (what, transfer) in all {
        for confirmed in [0, 6, 12] {
            let mut allocation = asking(&UNIQUE_ID, 0);
            if confirmed != 0 {
                allocation.act_on_message(&answer(confirmed), &UNIQUE_ID, 700);
            }
            assert_eq!(allocation.act_on_message(&transfer, &UNIQUE_ID, 1000), 0, "{what}");
            let waits = waits(&allocation, 1000);
            assert!(PERIOD_MS.contains(&waits), "{what}: {waits} ms");
            assert_eq!(ask(&mut allocation, &UNIQUE_ID, 1000 + waits), 0, "{what}");
        }
    }
}
