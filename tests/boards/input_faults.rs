//! Faults of the sensor and invalid input from the bus: the servo follows valid commands and
//! nothing else. The cases are in `faults/input.rs`, what they measure in docs/reliability.md.

rig::check_each! {
    input:
    an_open_or_shorted_sensor_does_not_affect_the_servo: SENSOR_OPEN, SENSOR_SHORTED;
    a_noisy_sensor_is_averaged: SENSOR_NOISY;
    nan_and_infinite_commands_do_not_move_the_servo: NOT_FINITE;
    commands_out_of_range_move_the_servo_within_its_travel: OUT_OF_RANGE;
    two_thousand_requests_a_second_delay_no_command: REQUESTS;
    a_node_id_conflict_is_detected_and_logged: SAME_ID;
    two_nodes_with_one_id_both_detect_it: TWIN;
}
