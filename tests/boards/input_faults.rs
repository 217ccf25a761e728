//! Faults of the sensor and invalid input from the bus: the servo follows valid commands and
//! nothing else. The cases are in `faults/input.rs`, what they measure in docs/reliability.md.

use rig::faults::input;

#[test]
fn an_open_or_shorted_sensor_does_not_affect_the_servo() {
    input::SENSOR_OPEN.check();
    input::SENSOR_SHORTED.check();
}

#[test]
fn a_noisy_sensor_is_averaged() {
    input::SENSOR_NOISY.check();
}

#[test]
fn nan_and_infinite_commands_do_not_move_the_servo() {
    input::NOT_FINITE.check();
}

#[test]
fn commands_out_of_range_move_the_servo_within_its_travel() {
    input::OUT_OF_RANGE.check();
}

#[test]
fn two_thousand_requests_a_second_delay_no_command() {
    input::REQUESTS.check();
}

#[test]
fn a_node_id_conflict_is_detected_and_logged() {
    input::SAME_ID.check();
}

#[test]
fn two_nodes_with_one_id_both_detect_it() {
    input::TWIN.check();
}
