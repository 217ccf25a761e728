//! Faults of the bus: the node detects and logs each, keeps the servo safe, and recovers within a
//! second of its end without flooding the bus. The cases are in `faults/bus.rs`, what they measure
//! in docs/reliability.md.

use bench::fault::{self, Fault};
use bench::inject::{Injector, Target};
use rig::{ARRAY_COMMAND, NODE, PWM, Rig, array_command};

rig::check_each! {
    bus:
    a_pulled_cable_is_logged_and_the_node_recovers: CABLE;
    #[ignore = "takes long: make test-all"]
    a_node_alone_on_the_bus_recovers_when_another_joins: ALONE;
    a_shorted_bus_is_logged_and_the_node_recovers: SHORT;
    a_bus_shorted_during_the_start_delays_the_node: BROKEN_WHILE_STARTING;
    #[ignore = "takes long: make test-all"]
    the_node_recovers_from_a_sender_at_another_bit_rate: WRONG_RATE;
    #[ignore = "takes long: make test-all"]
    a_wrong_bit_rate_is_logged_and_can_be_corrected: OWN_RATE_WRONG;
    the_node_recovers_from_a_babbling_node: BABBLE;
    without_acknowledgement_the_node_is_error_passive_and_recovers: NO_ACKNOWLEDGE;
    bus_off_is_counted_and_logged_and_the_node_recovers: DESTROYED_ALONE;
    #[ignore = "takes long: make test-all"]
    while_each_frame_is_destroyed_the_node_is_error_passive_and_then_it_recovers: DESTROYED;
    #[ignore = "takes long: make test-all"]
    bit_errors_are_counted_and_the_node_recovers_at_each_error_rate:
        NOISE_5, NOISE_4, NOISE_3, NOISE_2;
}

/// Faults in which the node cannot receive, whatever passes between others, and those of the
/// commander.
const CUTS_OFF: [Fault; 9] = [
    Fault::AckDestroyed,
    Fault::Cable,
    Fault::ChipHeld,
    Fault::ChipPower,
    Fault::Disarm,
    Fault::MisoHigh,
    Fault::MisoLow,
    Fault::OtherDialect,
    Fault::Silence,
];

/// Sends a command each 40 ms for so many seconds of the fault, each with a width of its own.
/// Returns the commands that passed, and those whose width a pulse had. Each line about the
/// controller comes once a second.
fn followed(fault: Fault, seconds: usize) -> (usize, usize) {
    let mut rig = Rig::running();
    let mut injector = Injector::new(&mut rig.bench);
    // After 1.2 s the driver knows that the bit rate is that of the bus.
    rig.run_ms(2000);
    rig.forget();
    rig.overflows_expected = true;
    rig.violations_expected = fault.disturbs_chip();
    let bench = &mut rig.bench;
    let target = Target { bench, node: 0, autopilot: None, node_id: NODE as u8, sensor_c: 25.0 };
    injector.inject(fault, &mut { target });
    let commands = 25 * seconds;
    for n in 0..commands {
        let [data] = &array_command(&[(1, PWM, width_us(n))], n as u8 & 31)[..] else { panic!() };
        rig.send(ARRAY_COMMAND | 10, data);
        rig.run_ms(40);
    }
    rig.run_ms(40);
    for line in rig.serial.lines().filter(|line| line.starts_with("CAN") || line.contains("5V?")) {
        let times = rig.serial.lines().filter(|other| *other == line).count();
        assert!(times <= seconds + 1, "{fault}: {line:?} {times} times in {seconds} s");
    }
    let widths: Vec<f64> = rig.pulses.iter().map(|pulse| pulse.width_us()).collect();
    let mut passed: Vec<&[u8]> = vec![];
    for (_, frame) in &rig.traffic {
        if frame.id == bench::can::Id::Extended(ARRAY_COMMAND | 10)
            && passed.last() != Some(&frame.data())
        {
            passed.push(frame.data());
        }
    }
    let is_followed = |n: &usize| widths.contains(&f64::from(width_us(*n)));
    (passed.len(), (0..commands).filter(is_followed).count())
}

/// A width that no other of 250 commands has.
fn width_us(n: usize) -> f32 {
    1100.0 + 3.0 * n as f32
}

#[test]
#[ignore = "takes long: make test-all"]
fn of_the_commands_that_pass_in_a_fault_the_node_follows_95_of_100() {
    for (fault, seconds) in fault::ALL.into_iter().flat_map(|fault| [(fault, 3), (fault, 10)]) {
        let (passed, followed) = followed(fault, seconds);
        println!("{fault}: {followed} of {passed}");
        assert!(
            CUTS_OFF.contains(&fault) || 100 * followed >= 95 * passed,
            "{fault}: {followed} of {passed} followed"
        );
    }
}
