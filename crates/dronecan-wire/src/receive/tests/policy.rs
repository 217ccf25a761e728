//! What a policy decides, what it hears of, and what the default does.

use super::*;

const A: u32 = 10;
const B: u32 = 110;

/// What a policy hears of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Heard {
    Completed(u8, u16),
    Lost(u8),
    Refused(u8),
}

/// Notes what it hears of. Each sender has the claim that is given.
#[derive(Default)]
struct Recorder {
    heard: Vec<Heard>,
    claims: Vec<(u32, u8)>,
}

impl Policy for Recorder {
    fn claim(&self, source: u8, _: u16) -> u8 {
        let claim = self.claims.iter().find(|(sender, _)| *sender == u32::from(source));
        claim.map_or(0, |&(_, claim)| claim)
    }

    fn completed(&mut self, source: u8, now_ms: u16) {
        self.heard.push(Heard::Completed(source, now_ms));
    }

    fn lost(&mut self, source: u8) {
        self.heard.push(Heard::Lost(source));
    }

    fn refused(&mut self, source: u8) {
        self.heard.push(Heard::Refused(source));
    }
}

type Recording<const LANES: usize> = Receiver<Kind, LANES, 1, KEPT, Recorder>;

/// Takes frames at this time. Returns the result of the last: true for a complete transfer.
fn takes<const LANES: usize, P: Policy>(
    receiver: &mut Receiver<Kind, LANES, 1, KEPT, P>,
    frames: &[Frame],
    now_ms: u16,
) -> Result<bool, Rejection> {
    let mut last = Ok(false);
    for frame in frames {
        last = match receiver.accept(read(frame, ME).unwrap(), ACTUATOR, now_ms) {
            Verdict::More => Ok(false),
            Verdict::Message(_) | Verdict::Request(_) => Ok(true),
            Verdict::Rejected(rejection) => Err(rejection),
        };
    }
    last
}

fn list(source: u32) -> [Frame; 2] {
    two(source, 1, 7)
}

fn heard(receiver: &mut Recording<1>) -> Vec<Heard> {
    core::mem::take(&mut receiver.policy_mut().heard)
}

#[test]
fn a_policy_hears_what_becomes_of_transfers_of_several_frames() {
    let mut receiver = Recording::<1>::default();
    assert_eq!(takes(&mut receiver, &list(A), 5), Ok(true));
    assert_eq!(heard(&mut receiver), [Heard::Completed(10, 5)]);
    // One frame, or no entry for this node.
    assert_eq!(takes(&mut receiver, &command(A, 1, &[(1, 0, 1)]), 6), Ok(true));
    assert_eq!(takes(&mut receiver, &command(A, 1, &[(9, 0, 1); 2]), 6), Ok(true));
    assert_eq!(heard(&mut receiver), []);
    // No list.
    assert_eq!(takes(&mut receiver, &frames(SET), 7), Ok(true));
    assert_eq!(heard(&mut receiver), [Heard::Completed(127, 7)]);
    receiver.refused(10);
    assert_eq!(heard(&mut receiver), [Heard::Refused(10)]);
}

#[test]
fn a_policy_hears_of_each_loss_once() {
    let mut receiver = Recording::<1>::default();
    // A wrong CRC.
    let mut damaged = list(A);
    damaged[1].data[0] ^= 1;
    assert_eq!(takes(&mut receiver, &damaged, 0), Err(Rejection::Broken));
    assert_eq!(heard(&mut receiver), [Heard::Lost(10)]);
    // Begun again, and expired.
    assert_eq!(takes(&mut receiver, &list(A)[..1], 0), Ok(false));
    assert_eq!(takes(&mut receiver, &list(A)[..1], 0), Err(Rejection::Broken));
    assert_eq!(heard(&mut receiver), [Heard::Lost(10)]);
    assert!(receiver.expire(51).is_some());
    assert_eq!(heard(&mut receiver), [Heard::Lost(10)]);
    // The next frame is late, and another sender gets the lane.
    assert_eq!(takes(&mut receiver, &list(A)[..1], 60), Ok(false));
    assert_eq!(takes(&mut receiver, &list(B)[..1], 64), Err(Rejection::Interleaved));
    assert_eq!(heard(&mut receiver), [Heard::Lost(10)]);
    // No loss that its sender caused: no lane for it, or a higher claim displaces it.
    assert_eq!(takes(&mut receiver, &list(A)[..1], 64), Err(Rejection::Interleaved));
    receiver.policy_mut().claims = std::vec![(A, 1)];
    assert_eq!(takes(&mut receiver, &list(A)[..1], 64), Err(Rejection::Interleaved));
    assert_eq!(heard(&mut receiver), []);
    assert_eq!(takes(&mut receiver, &list(A)[1..], 64), Ok(true));
}

#[test]
fn a_new_transfer_gets_a_lane_only_with_a_higher_claim_or_when_the_next_frame_is_late() {
    for (of_a, of_b, after_ms, gets_it) in [
        (0, 0, 0, false),
        (1, 0, 3, false),
        (5, 5, 3, false),
        (254, 255, 0, true),
        (0, 1, 3, true),
        (255, 0, 4, true),
    ] {
        let claims = std::vec![(A, of_a), (B, of_b)];
        let mut receiver = Recording::<1>::with_policy(Recorder { claims, ..Recorder::default() });
        assert_eq!(takes(&mut receiver, &list(A)[..1], u16::MAX), Ok(false));
        let now_ms = u16::MAX.wrapping_add(after_ms);
        let begins = takes(&mut receiver, &list(B)[..1], now_ms);
        assert_eq!(begins, Err(Rejection::Interleaved), "one of the two is lost");
        let what = std::format!("{of_a} {of_b} {after_ms}");
        assert_eq!(takes(&mut receiver, &list(B)[1..], now_ms), Ok(gets_it), "{what}");
        assert_eq!(takes(&mut receiver, &list(A)[1..], now_ms), Ok(!gets_it), "{what}");
    }
}

#[test]
fn of_several_lanes_a_free_one_is_taken_then_a_late_one_then_the_one_of_the_lowest_claim() {
    let claims = std::vec![(20, 0), (21, 2), (22, 1), (23, 3)];
    let mut receiver = Recording::<3>::with_policy(Recorder { claims, ..Recorder::default() });
    for (source, at_ms) in [(20, 0), (21, 2), (22, 2)] {
        assert_eq!(takes(&mut receiver, &list(source)[..1], at_ms), Ok(false));
    }
    let sources = |receiver: &Recording<3>| receiver.lists().map(|lane| lane.source);
    assert_eq!(sources(&receiver), [20, 21, 22]);
    assert_eq!(takes(&mut receiver, &list(23)[..1], 4), Err(Rejection::Interleaved));
    assert_eq!(sources(&receiver), [23, 21, 22], "the frame of 20 is late");
    receiver.policy_mut().claims.push((24, 2));
    assert_eq!(takes(&mut receiver, &list(24)[..1], 4), Err(Rejection::Interleaved));
    assert_eq!(sources(&receiver), [23, 21, 24], "22 has the lowest claim");
    assert_eq!(takes(&mut receiver, &list(25)[..1], 4), Err(Rejection::Interleaved));
    assert_eq!(sources(&receiver), [23, 21, 24], "none has a lower claim");
    assert_eq!(takes(&mut receiver, &list(23)[1..], 4), Ok(true));
    assert_eq!(takes(&mut receiver, &list(25)[..1], 4), Ok(false));
    assert_eq!(sources(&receiver), [25, 21, 24], "a lane was free");
}

#[test]
fn a_policy_may_leave_out_all_but_the_claim() {
    struct LowerFirst;

    impl Policy for LowerFirst {
        fn claim(&self, source: u8, _: u16) -> u8 {
            127 - source
        }
    }

    for (first, second) in [(A, B), (B, A)] {
        let mut receiver = Receiver::<Kind, 1, 1, KEPT, _>::with_policy(LowerFirst);
        receiver.refused(first as u8);
        assert_eq!(takes(&mut receiver, &list(first)[..1], 0), Ok(false));
        assert!(takes(&mut receiver, &list(second)[..1], 0).is_err());
        assert_eq!(takes(&mut receiver, &list(B)[1..], 0), Ok(false));
        assert_eq!(takes(&mut receiver, &list(A)[1..], 0), Ok(true));
    }
}

#[test]
fn by_default_a_sender_that_completes_its_transfers_goes_first() {
    for other in (1..=127).filter(|&id| ![A, u32::from(ME)].contains(&id)) {
        let mut receiver = Receiver::<Kind, 1, 1, KEPT>::default();
        assert_eq!(takes(&mut receiver, &list(A), 0), Ok(true));
        // It keeps its lane, and displaces the other.
        assert_eq!(takes(&mut receiver, &list(A)[..1], 1), Ok(false));
        assert_eq!(takes(&mut receiver, &list(other)[..1], 1), Err(Rejection::Interleaved));
        assert_eq!(takes(&mut receiver, &list(A)[1..], 1), Ok(true));
        assert_eq!(takes(&mut receiver, &list(other)[..1], 1), Ok(false));
        assert_eq!(takes(&mut receiver, &list(A)[..1], 1), Err(Rejection::Interleaved));
        assert_eq!(takes(&mut receiver, &list(A)[1..], 1), Ok(true), "{other}");
        // After a loss or a refusal it has no better claim.
        receiver.refused(A as u8);
        assert_eq!(takes(&mut receiver, &list(other)[..1], 2), Ok(false));
        assert_eq!(takes(&mut receiver, &list(A)[..1], 2), Err(Rejection::Interleaved));
        assert_eq!(takes(&mut receiver, &list(other)[1..], 2), Ok(true), "{other}");
    }
}
