//! Random traffic with random bit errors: no frame may be lost, doubled or corrupted.

use super::fault::Random;
use super::*;

/// A frame that no other call returns: `number` is in its identifier and, as far as it fits, in its
/// data.
fn random_frame(random: &mut Random, number: u32) -> Frame {
    let dlc = random.below(9) as usize;
    let mut data = random.next().to_be_bytes();
    data[0] = number as u8;
    let priority = random.below(32) as u32;
    match random.below(4) {
        0 => Frame::standard((priority << 6 | number & 0x3F) as u16, &data[..dlc.max(1)]),
        1 => Frame::remote(Id::Extended(priority << 24 | number << 1), dlc as u8),
        _ => Frame::extended(priority << 24 | number << 1 | 1, &data[..dlc]),
    }
}

/// Queues frames of the senders over about 0.1 s at random times, many at once.
fn load(rig: &Rig, random: &mut Random, frames: u32, senders: u64) {
    for number in 0..frames {
        let sender = random.below(senders) as usize;
        let at = 2_000 + random.below(1_000_000);
        let frame = random_frame(random, number);
        rig.nodes[sender].borrow_mut().send_at(at, frame);
    }
}

/// How often a receiver may receive the frame: once, and once more for each error that its sender
/// had in the last end-of-frame bit, one bit after the receivers had accepted it.
fn entitled(sender: &[(Cycles, Event)], receptions: &[Cycles]) -> usize {
    let repeated = receptions.iter().filter(|&&at| {
        let next_bit = at + BIT;
        sender.iter().any(|&(time, event)| {
            time == next_bit && matches!(event, Event::Error { transmitting: true, .. })
        })
    });
    1 + repeated.count()
}

#[test]
fn every_frame_is_received_once_and_unchanged_by_all_others() {
    let mut errors = 0;
    for seed in 0..40 {
        let mut random = Random(seed);
        let mut rig = Rig::of(4);
        load(&rig, &mut random, 60, 4);
        let per_million = [0, 100, 500, 1_000][seed as usize % 4];
        rig.bus.inject(Fault::BitErrorRate { per_million, seed });
        rig.run_bits(200_000);
        let received: Vec<_> =
            rig.nodes.iter().map(|node| node.borrow_mut().take_received()).collect();
        let events: Vec<_> = rig.nodes.iter().map(|node| node.borrow_mut().take_events()).collect();
        let mut expected = [0; 4];
        for (sender, events) in events.iter().enumerate() {
            assert_eq!(rig.nodes[sender].borrow().queued(), 0, "seed {seed}");
            for &(_, event) in events {
                assert!(event != Event::BusOff, "too much noise for this test");
                let Event::Transmitted(frame) = event else {
                    continue;
                };
                for receiver in (0..4).filter(|&receiver| receiver != sender) {
                    let copies = received[receiver].iter().filter(|entry| entry.1 == frame);
                    let times: Vec<_> = copies.map(|entry| entry.0).collect();
                    let entitled = entitled(events, &times);
                    assert_eq!(times.len(), entitled, "seed {seed}: {frame} at {receiver}");
                    expected[receiver] += entitled;
                }
            }
        }
        let counts: Vec<usize> = received.iter().map(Vec::len).collect();
        assert_eq!(counts, expected, "seed {seed}: receivers must receive no other frames");
        errors += rig.bus.stats().error_frames;
    }
    assert!(errors > 500, "too few errors for this test: {errors}");
}

/// The bus's record must agree with the stations' events.
#[test]
fn every_recorded_frame_has_its_sender() {
    for seed in 100..110 {
        let mut random = Random(seed);
        let mut rig = Rig::of(4);
        load(&rig, &mut random, 60, 4);
        rig.bus.inject(Fault::BitErrorRate { per_million: 300, seed });
        rig.run_bits(200_000);
        let mut recorded = rig.recorded_frames();
        recorded.dedup();
        for node in 0..4 {
            let sent = rig.events(node).into_iter().filter_map(|event| match event {
                Event::Transmitted(frame) => Some((frame, Some(node), true)),
                _ => None,
            });
            for entry in sent {
                assert!(recorded.contains(&entry), "seed {seed}: {entry:?}");
            }
        }
        assert_eq!(recorded.len(), 60, "seed {seed}");
    }
}

#[test]
fn a_listen_only_node_never_drives_dominant_whatever_happens() {
    for seed in 0..20 {
        let mut random = Random(seed);
        let mut rig = Rig::of(3);
        let mut node = SoftNode::new(1_000_000);
        node.set_listen_only(true);
        node.send(frame("000#"));
        let listener = Rc::new(RefCell::new(Watched::new(node)));
        let port = rig.bus.attach("listener", listener.clone());
        load(&rig, &mut random, 60, 3);
        rig.bus.inject(Fault::BitErrorRate { per_million: 2_000, seed });
        for bit in 0..40 {
            rig.bus.inject(Fault::FlipBitSeenBy { port, bit: bit * 3 });
            rig.run_bits(2_000);
        }
        let listener = &mut *listener.borrow_mut();
        assert!(!listener.drove_dominant, "seed {seed}");
        assert!(!listener.node.take_received().is_empty());
        assert_eq!((listener.node.tec(), listener.node.rec()), (0, 0));
    }
}

/// Continuous errors that only one station receives: frames may be doubled (see `faults.rs`) but
/// not changed, and the bus must become idle.
#[test]
fn errors_seen_by_one_station_never_change_a_frame() {
    for seed in 0..20 {
        let mut random = Random(seed);
        let mut rig = Rig::of(4);
        load(&rig, &mut random, 60, 4);
        for _ in 0..100 {
            let port = rig.ports[random.below(4) as usize];
            let bit = random.below(130) as u32;
            rig.bus.inject(Fault::FlipBitSeenBy { port, bit });
            rig.run_bits(1_000);
        }
        rig.bus.clear_faults();
        rig.run_bits(100_000);
        let mut sent = Vec::new();
        for node in 0..4 {
            sent.extend(rig.events(node).into_iter().filter_map(|event| match event {
                Event::Transmitted(frame) => Some(frame),
                _ => None,
            }));
        }
        assert_eq!(sent.len(), 60, "seed {seed}");
        for node in 0..4 {
            let strange = rig.received(node).into_iter().find(|frame| !sent.contains(frame));
            assert_eq!(strange, None, "seed {seed}");
        }
    }
}

/// What the owners and the wire saw of some traffic in which now and then a bit is wrong or a cable
/// is pulled. With a watched node each bit is stepped.
fn outcome(watched: bool, step: Option<Cycles>, seed: u64) -> impl PartialEq + std::fmt::Debug {
    let mut random = Random(seed);
    let mut rig = Rig::with_rates(&[1_000_000; 4]);
    if watched {
        let mut node = SoftNode::new(1_000_000);
        node.set_listen_only(true);
        rig.bus.attach("watched", Rc::new(RefCell::new(Watched::new(node))));
    }
    load(&rig, &mut random, 60, 4);
    let edges = Rc::new(RefCell::new(Vec::new()));
    let tapped = Rc::clone(&edges);
    rig.bus.set_wire_tap(Some(Box::new(move |at, level| tapped.borrow_mut().push((at, level)))));
    for change in 0..40 {
        let until = rig.bus.now() + 50_000;
        let mut now = rig.bus.now();
        while now < until {
            now = step.map_or_else(|| rig.bus.horizon(), |step| now + step).min(until);
            rig.bus.run_until(now);
        }
        match change % 5 {
            0 => rig.bus.inject(Fault::FlipBit { bit: random.below(100) as u32 }),
            1 => rig.bus.connect(PortId(random.below(4) as usize), false),
            2 => (0..4).for_each(|port| rig.bus.connect(PortId(port), true)),
            3 => rig.bus.inject(Fault::BitErrorRate { per_million: 2_000, seed }),
            _ => rig.bus.clear_faults(),
        }
    }
    let received: Vec<_> = rig.nodes.iter().map(|node| node.borrow_mut().take_received()).collect();
    let events: Vec<_> = rig.nodes.iter().map(|node| node.borrow_mut().take_events()).collect();
    let mut stats = rig.bus.stats();
    stats.ports.truncate(4);
    assert!(stats.frames > 50 && stats.error_frames > 0, "{stats:?}");
    (rig.bus.take_records(), stats, received, events, edges.take())
}

#[test]
fn bits_that_are_stepped_at_once_give_what_single_ones_give() {
    for seed in 0..20 {
        let reference = outcome(true, Some(BIT), seed);
        for step in [None, Some(BIT), Some(7 * BIT + 3), Some(10_000)] {
            assert!(outcome(false, step, seed) == reference, "seed {seed}, steps of {step:?}");
        }
    }
}
