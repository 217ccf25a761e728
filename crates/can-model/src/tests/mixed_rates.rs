//! Stations at another bit rate than the bus.

use super::*;

const COMMAND: &str = "1003F20A#01000038C7";

/// Node 2 disturbs the bus until its counter makes it passive, and receives nothing.
#[test]
fn a_slower_station_causes_errors_and_the_others_communicate_when_it_is_passive() {
    for rate in [500_000, 250_000, 125_000] {
        let mut rig = Rig::with_rates(&[1_000_000, 1_000_000, rate]);
        for count in 0..40u8 {
            let at = rig.bus.now() + u64::from(count) * 8_000;
            let sent = Frame::extended(0x1003_F200 + u32::from(count), &[count; 8]);
            rig.nodes[usize::from(count % 2)].borrow_mut().send_at(at, sent);
        }
        rig.run_bits(100_000);
        assert!(rig.bus.stats().error_frames > 0, "{rate}");
        assert_eq!(rig.received(2), [], "{rate}");
        assert_eq!(rig.nodes[2].borrow().error_state(), ErrorState::Passive, "{rate}");
        for (receiver, parity) in [(1, 0), (0, 1)] {
            let received = rig.received(receiver);
            assert_eq!(received.len(), 20, "{rate}");
            assert!(received.iter().all(|frame| frame.data()[0] % 2 == parity), "{rate}");
        }
    }
}

#[test]
fn a_faster_station_cannot_communicate_either() {
    let mut rig = Rig::of(0);
    rig.bus = Bus::new(500_000);
    for rate in [500_000, 500_000, 1_000_000] {
        let node = Rc::new(RefCell::new(SoftNode::new(rate)));
        rig.ports.push(rig.bus.attach("node", node.clone()));
        rig.nodes.push(node);
    }
    rig.bus.run_until(10_000);
    rig.send(2, frame(COMMAND));
    rig.send(0, frame("123#01"));
    rig.bus.run_until(2_000_000);
    assert_eq!(rig.received(2), []);
    assert_eq!(rig.nodes[2].borrow().queued(), 1);
    assert!(rig.events(2).iter().any(|event| matches!(event, Event::Error { .. })));
    let received = rig.received(1);
    assert!(received.iter().all(|&other| other == frame("123#01")), "{received:?}");
}

#[test]
fn a_station_within_half_a_percent_of_the_rate_is_in_step() {
    let mut rig = Rig::with_rates(&[1_000_000, 995_500, 1_004_500]);
    rig.send(0, frame(COMMAND));
    rig.send(1, frame("123#01"));
    rig.send(2, frame("124#02"));
    rig.run_bits(1_000);
    assert_eq!(rig.bus.stats().frames, 3);
    assert_eq!(rig.bus.stats().error_frames, 0);
}

/// Two stations at the same other rate receive each other's frames; the bus's own recorder receives
/// neither.
#[test]
fn two_stations_at_another_rate_receive_each_other_s_frames() {
    let mut rig = Rig::with_rates(&[500_000, 500_000]);
    rig.send(0, frame(COMMAND));
    rig.run_bits(1_000);
    assert_eq!(rig.received(1), [frame(COMMAND)]);
    assert_eq!(rig.recorded_frames(), []);
}

/// The horizon must not let an AVR pass a bit of the faster station.
#[test]
fn the_horizon_follows_the_station_that_is_out_of_step() {
    let mut rig = Rig::of(0);
    rig.bus = Bus::new(125_000);
    let node = Rc::new(RefCell::new(SoftNode::new(1_000_000)));
    rig.bus.attach("fast", node.clone());
    let mut now = 0;
    let mut last = 0;
    node.borrow_mut().send_at(10_000, frame("123#"));
    while now < 20_000 {
        now = rig.bus.horizon();
        assert!(now > last, "no progress at {now}");
        // After the first idle period, in which the rate is not known yet, the station's bits are
        // 16 cycles.
        assert!(now - last <= 16 || last < 128 * 32, "{last} to {now}");
        rig.bus.run_until(now);
        last = now;
    }
    assert!(!node.borrow_mut().take_events().is_empty());
}

/// The same result in one step and in steps of one cycle.
#[test]
fn events_out_of_step_do_not_depend_on_the_steps_they_are_run_in() {
    let outcome = |step: u64| {
        let mut rig = Rig::with_rates(&[1_000_000, 1_000_000, 333_333]);
        let start = rig.bus.now();
        (0..3).for_each(|node| rig.send(node, frame(COMMAND)));
        let mut now = start;
        while now < start + 60_000 {
            now += step;
            rig.bus.run_until(now);
        }
        let events: Vec<_> = rig.nodes.iter().map(|node| node.borrow_mut().take_events()).collect();
        (rig.bus.take_records(), events)
    };
    assert!(outcome(1) == outcome(60_000));
}

/// A chip that is configured to the right rate later must join the bus then.
#[test]
fn a_station_can_get_in_step_later() {
    let mut rig = Rig::of(2);
    let late = Rc::new(RefCell::new(Watched {
        bit_time_ps: 3_700_000,
        ..Watched::new(SoftNode::new(1_000_000))
    }));
    rig.bus.attach("late", late.clone());
    rig.run_bits(500);
    late.borrow_mut().bit_time_ps = 1_000_000;
    rig.run_bits(100);
    rig.send(0, frame(COMMAND));
    rig.run_bits(500);
    let received = late.borrow_mut().node.take_received();
    assert_eq!(received.len(), 1);
    assert_eq!(rig.bus.stats().error_frames, 0);
}
