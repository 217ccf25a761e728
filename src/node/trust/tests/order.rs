//! How long it takes until a sender precedes the others, and that it is received then.

use super::*;

const COMMANDER: u8 = 60;

/// True if this sender has precedence over each of the others at this time.
fn precedes(source: u8, others: &[u8], time_ms: u16) -> bool {
    others.iter().all(|&other| place(source, time_ms) > place(other, time_ms))
}

/// All times of the clock, a time of each order.
fn orders() -> impl Iterator<Item = u16> {
    (0..=u16::MAX).step_by(usize::from(ORDER_MS))
}

/// Others of which each is told from the commander by another bit, so that their orders do not
/// depend on one another. Those by higher bits come first.
fn others() -> [u8; 7] {
    [6, 5, 4, 3, 2, 1, 0].map(|bit| COMMANDER ^ 1 << bit)
}

#[test]
fn each_id_has_its_own_place() {
    for time_ms in orders() {
        let mut places: Vec<u8> = (1..=127).map(|source| place(source, time_ms)).collect();
        places.sort_unstable();
        places.dedup();
        assert_eq!(places.len(), 127);
        assert!(places[126] < 128);
        for later_ms in 0..ORDER_MS {
            assert_eq!(place(COMMANDER, time_ms), place(COMMANDER, time_ms + later_ms));
        }
    }
}

#[test]
fn each_of_two_senders_precedes_the_other_half_of_the_time() {
    for (a, b) in (1..=127).flat_map(|a| (1..a).map(move |b| (a, b))) {
        assert_eq!(orders().filter(|&time_ms| precedes(a, &[b], time_ms)).count(), 2048);
    }
}

/// Returns the most lists in a row, of one each `period_us`, in which the commander does not
/// precede these others.
fn longest_row(others: &[u8], period_us: u64) -> usize {
    let precedes: Vec<bool> = orders().map(|time| precedes(COMMANDER, others, time)).collect();
    let order = |time_us: u64| (time_us / 1000 / u64::from(ORDER_MS)) as usize % precedes.len();
    let rows = (0..u64::from(ORDER_MS)).map(|phase_ms| {
        let lists = (0..65_536_000 / period_us).map(|n| {
            let begin_us = 1000 * phase_ms + n * period_us;
            // A list takes up to 1.4 ms at 1 Mbit/s.
            precedes[order(begin_us)] && precedes[order(begin_us + 1_400)]
        });
        let lists: Vec<bool> = lists.collect();
        lists.split(|&is_received| is_received).map(<[bool]>::len).max().unwrap()
    });
    rows.max().unwrap()
}

/// One other sender: it takes at most 160 ms at 50 Hz.
#[test]
fn a_sender_precedes_one_other_soon() {
    let limits = [(2_500, 26), (10_000, 7), (16_000, 31), (20_000, 7), (40_000, 11), (100_000, 10)];
    for (period_us, longest) in limits {
        let most = others().map(|other| longest_row(&[other], period_us));
        println!("{period_us} us: {most:?}");
        assert!(most.iter().all(|&row| row <= longest), "{period_us} us: {most:?}");
    }
}

/// Two others: it takes at most 500 ms at 50 Hz.
#[test]
fn a_sender_precedes_two_others_soon() {
    let pairs = others().map(|a| others().map(|b| longest_row(&[a, b], 20_000)));
    println!("{pairs:?}");
    assert!(pairs.as_flattened().iter().all(|&row| row <= 24), "{pairs:?}");
}

/// Each attacker sends, before the commander's first frame and in each gap of its list, a list of
/// two frames with an entry for the node, and the first frame of another.
fn is_received<const LANES: usize>(
    receiver: &mut Many<Shared, LANES>,
    attackers: &[u8],
    now_ms: u16,
) -> bool {
    let mut is_received = false;
    let mut take = |frame: &Frame| {
        matches!(receiver.accept(read(frame), ACTUATOR, now_ms), Verdict::Message(_))
    };
    for frame in command(u32::from(COMMANDER), 1, &[(ACTUATOR, 0, 1); 15]) {
        for &source in attackers {
            let [first, last] = two(u32::from(source), 1, 1);
            take(&first);
            take(&last);
            take(&first);
        }
        is_received = take(&frame);
    }
    is_received
}

/// The commander begins after the attackers. Returns in how many of 3,000 lists at 50 Hz it
/// precedes them, how many are received, and the longest row of those that are not.
fn attack<const LANES: usize>(attackers: &[u8]) -> (usize, usize, usize) {
    let mut receiver = receiver::<Shared, LANES>();
    let (mut precede, mut received) = (0, Vec::new());
    is_received(&mut receiver, attackers, u16::MAX);
    receiver.policy_mut().lost(COMMANDER);
    for n in 0..3_000u16 {
        let now_ms = n.wrapping_mul(20);
        let precedes = precedes(COMMANDER, attackers, now_ms);
        let are_trusted = attackers.iter().any(|&source| receiver.policy().is_trusted(source))
            || (now_ms / ORDER_MS).is_multiple_of(4);
        let is_received = is_received(&mut receiver, attackers, now_ms);
        let is_trusted = receiver.policy().is_trusted(COMMANDER);
        if precedes && (is_trusted || !are_trusted) {
            assert!(is_received, "{attackers:?}, {now_ms} ms");
        }
        precede += usize::from(precedes);
        received.push(is_received);
    }
    let longest = received.split(|&is_received| is_received).map(<[bool]>::len).max().unwrap();
    (precede, received.iter().filter(|&&is_received| is_received).count(), longest)
}

#[test]
fn a_commander_is_received_whenever_it_precedes_other_commanders() {
    for count in 1..=7 {
        let attackers = &others()[..count];
        let (precede, one, longest) = attack::<1>(attackers);
        let (_, two, _) = attack::<2>(attackers);
        println!("{count} attackers: precedes {precede} times, received {one} and {two}");
        println!("    at most {longest} lists in a row are not received");
        assert!(one > 3_000 >> (count + 1), "{one} of 3,000");
    }
    assert!(attack::<1>(&others()[..1]).2 <= 7);
    assert!(attack::<1>(&others()[..2]).2 <= 24);
}
