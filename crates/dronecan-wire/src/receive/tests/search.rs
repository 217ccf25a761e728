//! The worst that attackers do to a commander whose lists they know beforehand. A search over all
//! states of the receiver finds how many of the commander's lists are lost in a row.
//!
//! The commander sends a list of nine frames each 20 ms. At each moment of [`MOMENTS`] one of the
//! attackers may send a list of two frames, the first frame of a longer one, or its next frame.
//! Each frame arrives. The search leaves out the lanes that a sender gets by chance.

use std::collections::HashMap;
use std::ops::Range;

use super::trusted::Each;
use super::*;
use crate::receive::trust::Trust;

const COMMANDER: u32 = 60;
const ATTACKERS: [u32; 2] = [10, 110];
const PERIOD_MS: u16 = 20;

/// When an attacker may send, in milliseconds, and the frames of the commander that follow then.
type Moments = [(u16, Range<usize>)];
const MOMENTS: &Moments =
    &[(0, 0..0), (8, 0..0), (13, 0..0), (15, 0..0), (15, 0..1), (15, 1..5), (16, 5..8), (17, 8..9)];

/// For the many states of two lanes.
const FEW: &Moments = &[(13, 0..0), (15, 0..0), (15, 0..1), (15, 1..9)];

/// The search ends at so many lost lists in a row.
const FOR_EVER: u8 = 30;

type Lane = super::super::Transfer<Each, KEPT>;

/// What the attackers are capable of.
#[derive(Clone, Copy)]
struct Attack {
    attackers: usize,
    /// Types of lists of each.
    types: usize,
    /// The longer lists never end. Else they have nine frames.
    is_endless: bool,
    moments: &'static Moments,
}

/// One of the lists that an attacker sends, again and again.
struct Lists {
    whole: Vec<Frame>,
    long: Vec<Frame>,
}

#[derive(Clone)]
struct State<const LANES: usize> {
    moments: &'static Moments,
    moment: usize,
    lanes: [Lane; LANES],
    trust: Trust,
    /// Frames that the attackers have sent of their longer lists.
    sent: Vec<usize>,
    /// Lists of the commander lost in a row.
    lost: u8,
}

impl<const LANES: usize> State<LANES> {
    /// What makes two states differ in what can follow, without `lost`.
    fn key(&self) -> Vec<u8> {
        let mut key = vec![self.moment as u8, self.trust.last];
        key.extend(self.trust.bits);
        key.extend(self.sent.iter().map(|&sent| sent as u8));
        for lane in &self.lanes {
            if lane.is_open {
                let kind = lane.kind.0 as u8;
                key.extend([lane.source, kind, lane.tail.0, lane.stamp]);
                key.extend(lane.expires_ms.to_le_bytes());
            } else {
                key.push(0);
            }
        }
        key
    }

    /// Receives frames. Returns true if a list is complete.
    fn receive(&mut self, frames: &[Frame]) -> bool {
        let mut is_complete = false;
        let now_ms = 1_000 + self.moments[self.moment].0;
        for frame in frames {
            let mut receiver = Receiver::<Each, LANES, 1, KEPT>::new();
            receiver.lists = self.lanes;
            receiver.trust = self.trust;
            receiver.trust.contenders = 1;
            let id = Id::from_bytes(frame.id.to_be_bytes());
            let segment = Segment::read(id, &frame.data, ME).unwrap();
            is_complete = matches!(receiver.accept(segment, ACTUATOR, now_ms), Verdict::Message(_));
            (self.lanes, self.trust) = (receiver.lists, receiver.trust);
        }
        is_complete
    }

    /// Lets the commander send, and time pass until the next moment.
    fn end_moment(&mut self, list: &[Frame]) {
        let frames = self.moments[self.moment].1.clone();
        let is_last = frames.end == list.len();
        let is_complete = self.receive(&list[frames]);
        if is_last {
            self.lost = if is_complete { 0 } else { self.lost + 1 };
        }
        self.moment = (self.moment + 1) % self.moments.len();
        let mut next_ms = 1_000 + self.moments[self.moment].0;
        if self.moment == 0 {
            next_ms += PERIOD_MS;
        }
        for lane in &mut self.lanes {
            // As `Receiver::expire`, each millisecond.
            lane.is_open &= lane.expires_ms >= next_ms;
            if self.moment == 0 {
                lane.expires_ms = lane.expires_ms.wrapping_sub(PERIOD_MS);
                if lane.stamp != 0 {
                    lane.stamp = lane.stamp.wrapping_sub(PERIOD_MS as u8);
                }
            }
        }
    }
}

/// Returns the largest number of lists that the commander loses in a row.
fn most_lost<const LANES: usize>(attack: Attack) -> u8 {
    let list = command(COMMANDER, 1, &[(ACTUATOR, 0, 1); 15]);
    let mut lists = Vec::new();
    for source in &ATTACKERS[..attack.attackers] {
        for kind in 0..attack.types {
            let make = |id: u32, message, entries: &[u8], count| {
                golden::transfer(id | source, message, kind as u8, &entries.repeat(count))
            };
            let (whole, long) = match kind {
                0 => {
                    let make = |count| make(0x1003_F200, golden::ARRAY_COMMAND, &[9; 4], count);
                    (make(2), make(15))
                }
                _ => {
                    let make = |count| make(0x1804_3900, golden::LIGHTS_COMMAND, &[9; 3], count);
                    (make(3), make(20))
                }
            };
            assert_eq!((whole.len(), long.len()), (2, 9));
            lists.push(Lists { whole, long });
        }
    }
    let mut first = State::<LANES> {
        moments: attack.moments,
        moment: 0,
        lanes: [Lane::NONE; LANES],
        trust: Trust::NONE,
        sent: vec![0; lists.len()],
        lost: 0,
    };
    assert!(first.receive(&list));
    let mut reached: HashMap<Vec<u8>, u8> = HashMap::new();
    let mut waiting = vec![first];
    let mut most = 0;
    while let Some(state) = waiting.pop() {
        most = most.max(state.lost);
        if most == FOR_EVER {
            break;
        }
        let mut add = |mut next: State<LANES>| {
            next.end_moment(&list);
            let lost = reached.entry(next.key()).or_insert(u8::MAX);
            if *lost == u8::MAX || *lost < next.lost {
                *lost = next.lost;
                waiting.push(next);
            }
        };
        add(state.clone());
        for (n, Lists { whole, long }) in lists.iter().enumerate() {
            let mut next = state.clone();
            next.receive(whole);
            next.sent[n] = 0;
            add(next.clone());
            // And a longer one at once.
            next.receive(&long[..1]);
            next.sent[n] = 1;
            add(next);
            let mut next = state.clone();
            next.receive(&long[..1]);
            next.sent[n] = 1;
            add(next);
            let sent = state.sent[n];
            if sent != 0 {
                let mut next = state.clone();
                next.receive(&long[sent..=sent]);
                next.sent[n] = match (sent, attack.is_endless) {
                    (1, _) => 2,
                    (_, true) => 1,
                    (8, false) => 0,
                    (_, false) => sent + 1,
                };
                add(next);
            }
        }
    }
    println!("{} states, {most} lists lost in a row", reached.len());
    most
}

#[test]
fn one_attacker_breaks_at_most_every_other_list() {
    for is_endless in [true, false] {
        let one = Attack { attackers: 1, types: 1, is_endless, moments: MOMENTS };
        assert_eq!(most_lost::<1>(one), 1);
    }
    // Lists of nine frames of two types have 1.9 million states, with the same result.
    let two_types = Attack { attackers: 1, types: 2, is_endless: true, moments: FEW };
    assert_eq!(most_lost::<2>(two_types), 1);
}

#[test]
fn one_attacker_with_one_type_breaks_no_list_of_a_receiver_with_two_lanes() {
    for is_endless in [true, false] {
        let one = Attack { attackers: 1, types: 1, is_endless, moments: FEW };
        assert_eq!(most_lost::<2>(one), 0);
    }
}

/// Two attackers need two lanes: one keeps its lane because the other completes a list last.
#[test]
fn two_attackers_keep_a_commander_out() {
    for is_endless in [true, false] {
        let two = Attack { attackers: 2, types: 1, is_endless, moments: FEW };
        assert_eq!(most_lost::<1>(two), FOR_EVER);
    }
}
