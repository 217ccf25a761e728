//! Faults of the bus: the node detects and logs each, keeps the servo safe, and recovers within a
//! second of its end without flooding the bus. The cases are in `faults/bus.rs`, what they measure
//! in docs/reliability.md.

use rig::faults::bus;

#[test]
fn a_pulled_cable_is_logged_and_the_node_recovers() {
    bus::CABLE.check();
}

#[test]
fn a_node_alone_on_the_bus_recovers_when_another_joins() {
    bus::ALONE.check();
}

#[test]
fn a_shorted_bus_is_logged_and_the_node_recovers() {
    bus::SHORT.check();
}

#[test]
fn a_bus_shorted_during_the_start_delays_the_node() {
    bus::BROKEN_WHILE_STARTING.check();
}

#[test]
fn the_node_recovers_from_a_sender_at_another_bit_rate() {
    bus::WRONG_RATE.check();
}

#[test]
fn a_wrong_bit_rate_is_logged_and_can_be_corrected() {
    bus::OWN_RATE_WRONG.check();
}

#[test]
fn the_node_recovers_from_a_babbling_node() {
    bus::BABBLE.check();
}

#[test]
fn without_acknowledgement_the_node_is_error_passive_and_recovers() {
    bus::NO_ACKNOWLEDGE.check();
}

#[test]
fn bus_off_is_counted_and_logged_and_the_node_recovers() {
    bus::DESTROYED_ALONE.check();
}

#[test]
fn while_each_frame_is_destroyed_the_node_listens_and_then_it_recovers() {
    bus::DESTROYED.check();
}

#[test]
fn bit_errors_are_counted_and_the_node_recovers_at_each_error_rate() {
    for case in [&bus::NOISE_5, &bus::NOISE_4, &bus::NOISE_3, &bus::NOISE_2] {
        case.check();
    }
}
