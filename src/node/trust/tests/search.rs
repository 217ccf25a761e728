//! All that attackers can do to a commander whose lists they know beforehand, while the order of
//! precedence stays. A search over all states of the receiver finds how many of the commander's
//! lists are lost in a row.
//!
//! The commander sends a list of nine frames each 20 ms. At each moment of [`MOMENTS`] one of the
//! attackers may send a list of two frames, the first frame of a longer one, its next frame, or
//! the last frame of a list of which nothing else came.

use std::collections::HashMap;
use std::ops::Range;
use std::vec;

use super::*;

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

/// The node's policy at a time of its own, so that each period sees the same order of precedence.
#[derive(Clone)]
struct Still {
    trust: Trust,
    now_ms: u16,
}

impl Policy for Still {
    fn claim(&self, source: u8, _: u16) -> u8 {
        self.trust.claim(source, self.now_ms)
    }

    fn completed(&mut self, source: u8, _: u16) {
        self.trust.completed(source, self.now_ms);
    }

    fn lost(&mut self, source: u8) {
        self.trust.lost(source);
    }
}

/// What the attackers are capable of.
#[derive(Clone, Copy)]
struct Attack {
    /// The attackers that precede the commander while it sends its lists.
    preceding: [bool; 2],
    attackers: usize,
    /// Their short lists have an entry for the node, so that they are trusted.
    command: bool,
    /// Types of lists of each.
    types: usize,
    /// The longer lists never end. Else they have nine frames.
    is_endless: bool,
    /// The node may lose a frame of each of the commander's lists.
    loses_frames: bool,
    moments: &'static Moments,
}

impl Attack {
    /// When the first period begins, in milliseconds: the commander's list comes in the first
    /// milliseconds of an order in which the right attackers precede it.
    fn start_ms(&self) -> u16 {
        let precedes =
            |attacker: u32, now_ms| place(attacker as u8, now_ms) > place(COMMANDER as u8, now_ms);
        // Other commanders may become trusted just before the list, or while it comes.
        let mut orders = (1..).map(|n| 4 * n * ORDER_MS + 1);
        let sends_ms = orders
            .find(|&now_ms| ATTACKERS.map(|source| precedes(source, now_ms)) == self.preceding);
        sends_ms.unwrap() - 15
    }
}

/// One of the lists that an attacker sends, again and again.
struct Lists {
    whole: Vec<Frame>,
    long: Vec<Frame>,
}

#[derive(Clone)]
struct State<const LANES: usize> {
    moments: &'static Moments,
    start_ms: u16,
    moment: usize,
    /// When the period began.
    period_ms: u16,
    receiver: Receiver<Each, LANES, 1, KEPT, Still>,
    /// Frames that the attackers have sent of their longer lists.
    sent: Vec<usize>,
    /// The node lost a frame of the commander's list.
    is_damaged: bool,
    /// Lists of the commander lost in a row, of which the node lost no frame.
    lost: u8,
}

impl<const LANES: usize> State<LANES> {
    /// What makes two states differ in what can follow, without `lost`.
    fn key(&self) -> Vec<u8> {
        let mut key = vec![self.moment as u8, u8::from(self.is_damaged)];
        let Trust { trusted, lost } = self.receiver.policy().trust;
        key.extend(trusted);
        key.push(lost);
        key.extend(self.sent.iter().map(|&sent| sent as u8));
        for lane in self.receiver.lists() {
            if lane.is_open() {
                let kind = lane.kind.0 as u8;
                key.extend([lane.source, kind, lane.tail().0]);
                key.extend(lane.expires_ms().wrapping_sub(self.period_ms).to_le_bytes());
            } else {
                key.push(0);
            }
        }
        key
    }

    /// Receives frames. Returns true if a list is complete.
    fn receive(&mut self, frames: &[Frame]) -> bool {
        let mut is_complete = false;
        let moment_ms = self.moments[self.moment].0;
        self.receiver.policy_mut().now_ms = self.start_ms + moment_ms;
        let now_ms = self.period_ms.wrapping_add(moment_ms);
        for frame in frames {
            let verdict = self.receiver.accept(read(frame), ACTUATOR, now_ms);
            is_complete = matches!(verdict, Verdict::Message(_));
        }
        is_complete
    }

    /// Lets the commander send all of its frames of this moment but `lost`, and time pass until the
    /// next moment.
    fn end_moment(&mut self, list: &[Frame], lost: Option<usize>) {
        let frames = self.moments[self.moment].1.clone();
        let is_last = frames.end == list.len();
        self.is_damaged |= lost.is_some();
        let mut is_complete = false;
        for n in frames.filter(|&n| Some(n) != lost) {
            is_complete = self.receive(&list[n..=n]);
        }
        if is_last {
            self.lost = if is_complete || self.is_damaged { 0 } else { self.lost + 1 };
            self.is_damaged = false;
        }
        self.moment = (self.moment + 1) % self.moments.len();
        if self.moment == 0 {
            self.period_ms = self.period_ms.wrapping_add(PERIOD_MS);
        }
        let next_ms = self.period_ms.wrapping_add(self.moments[self.moment].0);
        while self.receiver.expire(next_ms).is_some() {}
    }
}

/// Returns the largest number of lists that the commander loses in a row.
fn most_lost<const LANES: usize>(attack: Attack) -> u8 {
    let list = command(COMMANDER, 1, &[(ACTUATOR, 0, 1); 15]);
    let mut lists = Vec::new();
    for source in &ATTACKERS[..attack.attackers] {
        for kind in 0..attack.types {
            let make = |id: u32, message, entries: &[u8], count| {
                let mut payload = entries.repeat(count);
                if attack.command && count < 4 {
                    payload[0] = ACTUATOR;
                }
                golden::transfer(id | source, message, kind as u8, &payload)
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
        start_ms: attack.start_ms(),
        moment: 0,
        period_ms: 0,
        receiver: Receiver::with_policy(Still { trust: Trust::NONE, now_ms: 0 }),
        sent: vec![0; lists.len()],
        is_damaged: false,
        lost: 0,
    };
    first.receiver.policy_mut().trust.completed(COMMANDER as u8, 0);
    let mut reached: HashMap<Vec<u8>, u8> = HashMap::new();
    let mut waiting = vec![first];
    let mut most = 0;
    while let Some(state) = waiting.pop() {
        most = most.max(state.lost);
        if most == FOR_EVER {
            break;
        }
        let mut add = |state: State<LANES>| {
            let frames = state.moments[state.moment].1.clone();
            let losses = frames.filter(|_| attack.loses_frames && !state.is_damaged).map(Some);
            for loss in losses.chain([None]) {
                let mut next = state.clone();
                next.end_moment(&list, loss);
                let lost = reached.entry(next.key()).or_insert(u8::MAX);
                if *lost == u8::MAX || *lost < next.lost {
                    *lost = next.lost;
                    waiting.push(next);
                }
            }
        };
        add(state.clone());
        for (n, Lists { whole, long }) in lists.iter().enumerate() {
            let (begin, last, sent) = (&long[..1], &whole[1..], state.sent[n]);
            // Frames, and how many of a longer list have been sent then: a short list, or its last
            // frame alone, and a longer one at once.
            let mut moves = vec![
                (vec![whole.as_slice()], 0),
                (vec![whole.as_slice(), begin], 1),
                (vec![begin], 1),
                (vec![last], 0),
                (vec![last, begin], 1),
            ];
            if sent != 0 {
                let then = match (sent, attack.is_endless) {
                    (1, _) => 2,
                    (_, true) => 1,
                    (8, false) => 0,
                    (_, false) => sent + 1,
                };
                moves.push((vec![&long[sent..=sent]], then));
            }
            for (frames, sent) in moves {
                let mut next = state.clone();
                frames.into_iter().for_each(|frames| _ = next.receive(frames));
                next.sent[n] = sent;
                add(next);
            }
        }
    }
    println!("{} states, {most} lists lost in a row", reached.len());
    most
}

const ONE: Attack = Attack {
    preceding: [false, false],
    attackers: 1,
    command: true,
    types: 1,
    is_endless: true,
    loses_frames: false,
    moments: MOMENTS,
};
const TWO: Attack = Attack { attackers: 2, moments: FEW, ..ONE };
const EACH_ORDER: [[bool; 2]; 4] = [[false, false], [false, true], [true, false], [true, true]];

#[test]
fn nodes_that_command_others_break_no_list_of_a_trusted_commander() {
    for preceding in EACH_ORDER {
        for is_endless in [true, false] {
            let others = Attack { preceding, command: false, is_endless, ..ONE };
            assert_eq!(most_lost::<1>(others), 0);
            assert_eq!(most_lost::<1>(Attack { attackers: 2, moments: FEW, ..others }), 0);
        }
        let types = Attack { preceding, command: false, types: 2, moments: FEW, ..ONE };
        assert_eq!(most_lost::<2>(types), 0);
    }
}

#[test]
fn a_trusted_commander_that_precedes_other_commanders_loses_no_list() {
    for is_endless in [true, false] {
        assert_eq!(most_lost::<1>(Attack { is_endless, ..ONE }), 0);
        assert_eq!(most_lost::<1>(Attack { is_endless, ..TWO }), 0);
    }
    assert_eq!(most_lost::<2>(Attack { types: 2, moments: FEW, ..ONE }), 0);
}

#[test]
fn a_lost_frame_of_a_commander_that_precedes_the_others_costs_no_other_list() {
    for attack in [ONE, TWO] {
        let attack = Attack { command: false, loses_frames: true, ..attack };
        assert_eq!(most_lost::<1>(attack), 0);
    }
}

#[test]
fn another_commander_keeps_out_one_that_it_precedes() {
    let one = Attack { preceding: [true, false], ..ONE };
    assert_eq!(most_lost::<1>(one), FOR_EVER);
    assert_eq!(most_lost::<2>(Attack { types: 2, moments: FEW, ..one }), FOR_EVER);
    for preceding in &EACH_ORDER[1..] {
        assert_eq!(most_lost::<1>(Attack { preceding: *preceding, ..TWO }), FOR_EVER);
    }
}

#[test]
fn one_attacker_with_one_type_breaks_no_list_of_a_receiver_with_two_lanes() {
    for (is_endless, precedes) in [(true, true), (false, true), (true, false)] {
        let preceding = [precedes, false];
        let one = Attack { preceding, is_endless, moments: FEW, ..ONE };
        assert_eq!(most_lost::<2>(one), 0);
    }
}
