//! Tests of requests, windows and timeouts.

use super::*;
use dronecan_host::types::GET_SET;

const OWN: NodeId = NodeId::new(126).unwrap();
const NODE: NodeId = NodeId::new(42).unwrap();

fn calls(count: u32) -> Calls<u32> {
    let mut calls = Calls::new(OWN);
    (0..count).for_each(|purpose| ask(&mut calls, NODE, Urgency::Background, purpose));
    calls
}

fn ask(calls: &mut Calls<u32>, node: NodeId, urgency: Urgency, purpose: u32) {
    let (payload, timeouts) = (vec![purpose as u8, 0], Timeouts::from_ms(100, 400));
    calls.request(node, GET_SET, payload, timeouts, urgency, purpose);
}

fn at(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn sent(calls: &mut Calls<u32>, now: u64) -> Vec<Frame> {
    let mut frames = Vec::new();
    calls.poll(at(now), &mut frames);
    frames
}

fn answer(frame: &Frame) -> Transfer {
    let id = CanId::Service {
        priority: 30,
        service_id: 11,
        request: false,
        destination: OWN,
        source: NODE,
    };
    Transfer {
        id,
        transfer_id: TransferId::new(*frame.data().last().unwrap()),
        payload: vec![7],
        frames: 1,
    }
}

#[test]
fn five_requests_are_sent_at_once_and_each_answer_allows_another() {
    let mut calls = calls(12);
    let frames = sent(&mut calls, 0);
    assert_eq!(frames.len(), 5);
    assert!(sent(&mut calls, 50).is_empty());
    assert_eq!(calls.answered(at(50), &answer(&frames[3])), Some((NODE, 3, Some(vec![7]))));
    assert_eq!(sent(&mut calls, 60).len(), 1);
}

#[test]
fn an_answer_counts_once_and_only_with_a_request() {
    let mut calls = calls(1);
    let frames = sent(&mut calls, 0);
    let other = CanId::Service {
        priority: 30,
        service_id: 11,
        request: false,
        destination: NodeId::new(1).unwrap(),
        source: NODE,
    };
    assert_eq!(calls.answered(at(50), &Transfer { id: other, ..answer(&frames[0]) }), None);
    assert!(calls.answered(at(50), &answer(&frames[0])).is_some());
    assert_eq!(calls.answered(at(50), &answer(&frames[0])), None);
}

#[test]
fn an_unanswered_request_is_repeated_with_another_transfer_id_and_then_fails() {
    let mut calls = calls(1);
    let first = sent(&mut calls, 0);
    assert_eq!(calls.deadline(), Some(at(100)));
    let second = sent(&mut calls, 100);
    assert_eq!((first[0].id, second.len()), (second[0].id, 1));
    assert_ne!(first[0].data(), second[0].data());
    // The timeout has doubled.
    assert!(sent(&mut calls, 299).is_empty());
    assert_eq!(sent(&mut calls, 300).len(), 1);
    assert_eq!(calls.poll(at(400), &mut Vec::new()), [(NODE, 0, None)]);
    assert_eq!(calls.deadline(), None);
    assert_eq!(calls.answered(at(401), &answer(&first[0])), None, "the request had failed");
}

#[test]
fn a_timeout_narrows_the_window_of_the_node() {
    let mut calls = calls(12);
    assert_eq!(sent(&mut calls, 0).len(), 5);
    assert_eq!(sent(&mut calls, 100).len(), 2);
    assert_eq!(sent(&mut calls, 300).len(), 1);
}

#[test]
fn a_full_queue_rejects_requests() {
    let mut calls = calls(QUEUE_LIMIT as u32 + 3);
    assert_eq!(calls.poll(at(0), &mut Vec::new()).len(), 3);
}

#[test]
fn a_late_answer_to_an_earlier_attempt_counts() {
    let mut calls = calls(1);
    let first = sent(&mut calls, 0);
    let second = sent(&mut calls, 100);
    assert_eq!(calls.answered(at(150), &answer(&first[0])), Some((NODE, 0, Some(vec![7]))));
    assert_eq!(calls.answered(at(160), &answer(&second[0])), None, "the request is done");
}

#[test]
fn an_answer_counts_while_the_request_waits_for_its_repetition() {
    let mut calls = calls(5);
    let first = sent(&mut calls, 0);
    // The window is two now, so three requests wait.
    assert_eq!(sent(&mut calls, 100).len(), 2);
    assert_eq!(calls.answered(at(150), &answer(&first[4])), Some((NODE, 4, Some(vec![7]))));
}

#[test]
fn a_transfer_id_is_not_reused_while_its_answer_may_arrive() {
    let mut calls = calls(80);
    let mut frames = sent(&mut calls, 0);
    let slow = frames.remove(0);
    for round in 1..60 {
        let now = round * 20;
        for frame in std::mem::take(&mut frames) {
            assert_ne!(frame.data().last(), slow.data().last());
            calls.answered(at(now), &answer(&frame));
        }
        frames = sent(&mut calls, now);
    }
}

#[test]
fn nodes_share_the_common_window_in_turns() {
    let mut calls = Calls::new(OWN);
    let node = |id: u8| NodeId::new(id).unwrap();
    for id in 1..=30 {
        for purpose in 0..20 {
            ask(&mut calls, node(id), Urgency::Background, purpose);
        }
    }
    let frames = sent(&mut calls, 0);
    let destinations: std::collections::BTreeSet<String> =
        frames.iter().map(|frame| format!("{:?}", frame.id)).collect();
    assert_eq!(
        (frames.len(), destinations.len()),
        (TOTAL_WINDOW_AT_FIRST as usize, TOTAL_WINDOW_AT_FIRST as usize)
    );
    ask(&mut calls, node(1), Urgency::Now, 99);
    assert_eq!(sent(&mut calls, 1).len(), 1, "an urgent request ignores the window");
}
