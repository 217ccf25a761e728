//! Faults of the sensor and invalid input from the bus: the servo follows valid commands and nothing else. The cases are
//! in `faults/input.rs`, what they measure in docs/reliability.md.

use rig::faults::input;

#[test]
fn a_sensor_that_is_open_or_shorted_does_not_touch_the_servo() {
    input::SENSOR_OPEN.check();
    input::SENSOR_SHORTED.check();
}

#[test]
fn a_noisy_sensor_is_averaged() {
    input::SENSOR_NOISY.check();
}

#[test]
fn commands_that_are_no_numbers_move_nothing_at_any_rate() {
    input::NOT_FINITE.check();
}

#[test]
fn commands_out_of_range_keep_to_the_travel_at_any_rate() {
    input::OUT_OF_RANGE.check();
}

#[test]
fn two_thousand_requests_a_second_hold_no_command_up() {
    input::REQUESTS.check();
}

#[test]
fn a_node_id_conflict_is_noticed_and_told() {
    input::SAME_ID.check();
}

#[test]
fn two_nodes_with_one_id_both_notice_it() {
    input::TWIN.check();
}
