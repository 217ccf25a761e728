//! The node's status follows the autopilot's, or comes each second without an autopilot.

use std::cell::RefCell;
use std::rc::Rc;

use bench::can::{Frame, SoftNode};
use rig::manage::ms_between;
use rig::status::{CONTROLLER, INITIALIZATION, OK, OPERATIONAL, WARNING};
use rig::{MS, Rig, STATUS_OF_NODE, corner, status_fields};

/// Milliseconds between consecutive frames.
fn gaps_ms(frames: &[(u64, Vec<u8>)]) -> Vec<f64> {
    frames.windows(2).map(|pair| ms_between(pair[0].0, pair[1].0)).collect()
}

#[test]
fn without_an_autopilot_a_status_comes_every_second() {
    let mut rig = Rig::running();
    rig.run_ms(10_500);
    let gaps = gaps_ms(&rig.statuses());
    assert!(gaps.len() >= 9, "{gaps:?}");
    assert!(gaps.iter().all(|gap| (999.0..1001.0).contains(gap)), "{gaps:?}");
}

#[test]
fn a_status_answers_the_autopilots_within_milliseconds() {
    let mut rig = Rig::running();
    rig.send_status_from(1);
    for _ in 0..10 {
        // Real autopilots are later than a second, too. The node waits for their status.
        rig.run_ms(1001);
        rig.forget();
        rig.send_status_from(1);
        rig.run_ms(5);
        assert_eq!(rig.statuses().len(), 1);
    }
}

#[test]
fn statuses_of_other_nodes_are_not_answered_while_there_is_an_autopilot() {
    let mut rig = Rig::running();
    rig.run_ms(500);
    for _ in 0..5 {
        rig.send_status_from(1);
        rig.run_ms(10);
        rig.forget();
        rig.run_ms(600);
        rig.send_status_from(42);
        rig.send_status_from(127);
        rig.run_ms(350);
        assert_eq!(rig.statuses(), []);
    }
}

#[test]
fn the_node_that_commands_the_servo_counts_as_the_autopilot() {
    let mut rig = Rig::running();
    rig.run_ms(500);
    rig.send_status_from(1);
    rig.run_ms(10);
    // Node 10 commands the servo. From now on the node follows its status and not that of node 1.
    rig.send_command(1, 0, 0.0);
    rig.run_ms(700);
    rig.forget();
    rig.send_status_from(1);
    rig.run_ms(20);
    assert_eq!(rig.statuses(), []);
    rig.send_status_from(10);
    rig.run_ms(5);
    assert_eq!(rig.statuses().len(), 1);
}

#[test]
#[ignore = "takes long: make test-all"]
fn uptime_counts_seconds_exactly_and_transfer_ids_count_to_31() {
    let mut rig = Rig::powered();
    rig.run_ms(70_400);
    let statuses = rig.statuses();
    for (n, (at, data)) in statuses.iter().enumerate() {
        let (uptime, _, _, vendor_code) = status_fields(data);
        let exact = *at as f64 / (1000 * MS) as f64;
        assert!((f64::from(uptime) - exact).abs() < 1.02, "uptime {uptime} at {exact:.3} s");
        assert_eq!(vendor_code, 0);
        assert_eq!(data[7], 0xC0 | (n % 32) as u8);
    }
    assert!(statuses.len() >= 70);
    assert_eq!(status_fields(&statuses.last().unwrap().1).0, 70);
}

#[test]
fn the_first_status_has_mode_initialization_and_the_next_operational() {
    let mut rig = Rig::powered();
    rig.run_ms(1500);
    let modes: Vec<u8> = rig.statuses().iter().map(|(_, data)| status_fields(data).2).collect();
    assert_eq!(modes, [INITIALIZATION, OPERATIONAL]);
    assert!(
        rig.statuses()[0].0 < (30 + corner().start_ms()) * MS,
        "the first status comes at once"
    );
}

#[test]
#[ignore = "takes long: make test-all"]
fn without_acknowledgement_the_node_is_error_passive_and_reports_it_later() {
    let mut rig = Rig::running();
    rig.connect_node(false);
    rig.run_ms(3000);
    assert_eq!(rig.statuses(), []);
    rig.connect_node(true);
    rig.run_ms(1500);
    let statuses = rig.statuses();
    assert!(
        gaps_ms(&statuses).iter().all(|gap| *gap >= 500.0),
        "the node must not send old statuses together: {:?}",
        gaps_ms(&statuses)
    );
    let (_, health, _, vendor_code) = status_fields(&statuses.last().expect("back on the bus").1);
    assert_eq!(health, WARNING);
    assert_ne!(vendor_code & CONTROLLER, 0, "dropped frames must be reported: {vendor_code:#06x}");
    assert!(rig.serial.contains("CAN H/L: error-passive"), "{}", rig.serial);
    assert!(rig.serial.contains("CAN H/L: not sent"), "{}", rig.serial);
    // The condition clears.
    rig.run_ms(20_000);
    rig.wait_for("another status", 1100, |rig| {
        rig.traffic
            .last()
            .is_some_and(|(_, frame)| frame.id == bench::can::Id::Extended(STATUS_OF_NODE))
    });
    let (_, health, _, vendor_code) = status_fields(&rig.statuses().last().unwrap().1);
    assert_eq!((health, vendor_code), (OK, 0));
}

/// In each hundred times that a frame takes, another node sends 99 of a higher priority, which the
/// node's filters do not accept.
#[test]
fn the_first_status_after_a_start_passes_on_a_bus_with_99_percent_of_a_higher_priority() {
    let frame = Frame::extended(0x0000_0A7F, &[0x55, 0x55, 0x55, 0x55, 0x55, 0x55, 0x55, 0xC0]);
    for begin_ms in [0, 3, 7, 10] {
        let mut rig = Rig::powered();
        let flood = Rc::new(RefCell::new(SoftNode::new(rig.bench.bus().bit_rate())));
        rig.bench.attach("flood", flood.clone());
        // The length of a frame and its pause.
        (0..2).for_each(|_| flood.borrow_mut().send(frame));
        rig.run_ms(1);
        let length = rig.traffic[1].0 - rig.traffic[0].0;
        let begin = rig.now() + begin_ms * MS;
        for n in 0..2000 * MS / length {
            if n % 100 != 99 {
                flood.borrow_mut().send_at(begin + n * length, frame);
            }
        }
        rig.run_ms(1100);
        let load = rig.traffic.len() as f64 * length as f64 / rig.now() as f64;
        assert!(load > 0.95, "{load}");
        assert!(!rig.statuses().is_empty(), "no status in {} ms", rig.now() / MS);
    }
}
