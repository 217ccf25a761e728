//! Faults of the bus: the node detects and logs each, keeps the servo safe, and recovers within a second of its end without flooding
//! the bus. The cases are in `faults/bus.rs`, what they measure in docs/reliability.md.

use rig::faults::bus;

#[test]
fn a_pulled_cable_is_told_of_and_forgotten_when_it_is_back() {
    bus::CABLE.check();
}

#[test]
fn a_node_alone_on_its_bus_waits_for_the_others() {
    bus::ALONE.check();
}

#[test]
fn a_shorted_bus_is_told_of_and_survived() {
    bus::SHORT.check();
}

#[test]
fn a_bus_that_is_shorted_while_the_node_starts_only_delays_it() {
    bus::BROKEN_WHILE_STARTING.check();
}

#[test]
fn a_node_that_sends_at_another_rate_is_outlived() {
    bus::WRONG_RATE.check();
}

#[test]
fn a_node_set_to_the_wrong_rate_tells_so_and_works_when_it_is_set_right() {
    bus::OWN_RATE_WRONG.check();
}

#[test]
fn a_babbling_node_is_outlived() {
    bus::BABBLE.check();
}

#[test]
fn without_acknowledgement_the_node_is_error_passive_until_it_is_heard() {
    bus::NO_ACKNOWLEDGE.check();
}

#[test]
fn bus_off_through_transmit_errors_is_counted_and_told_of_and_the_node_comes_back() {
    bus::DESTROYED.check();
}

#[test]
fn bit_errors_are_counted_and_survived_at_each_rate() {
    for case in [&bus::NOISE_5, &bus::NOISE_4, &bus::NOISE_3, &bus::NOISE_2] {
        case.check();
    }
}
