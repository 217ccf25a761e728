//! Faults of the CAN controller and its wires: the node detects and logs each within 100 ms and restarts the controller. The servo
//! holds its position or moves to its failsafe. The cases are in `faults/chip.rs`, what they measure in docs/reliability.md.

use rig::faults::chip;

#[test]
fn a_controller_that_was_reset_is_set_up_again_before_the_servo_feels_it() {
    chip::RESET.check();
}

#[test]
fn a_controller_with_garbage_in_its_registers_is_set_up_again() {
    chip::BROWN_OUT.check();
}

#[test]
fn a_controller_without_power_is_tried_until_it_has_some() {
    chip::NO_POWER.check();
}

#[test]
fn a_controller_that_stays_in_configuration_mode_is_tried_until_it_leaves_it() {
    chip::HELD.check();
}

#[test]
fn a_controller_that_fell_asleep_is_woken() {
    chip::ASLEEP.check();
}

#[test]
fn an_spi_that_reads_all_zeros_or_all_ones_is_told_of() {
    chip::MISO_LOW.check();
    chip::MISO_HIGH.check();
}

#[test]
fn an_spi_that_flips_bits_is_told_of_and_moves_the_servo_no_further_than_its_travel() {
    chip::FLIPPING.check();
}

#[test]
fn a_register_that_changed_by_itself_is_noticed() {
    chip::REGISTER.check();
}

#[test]
fn a_filter_that_changed_by_itself_is_put_right_by_the_failsafe() {
    chip::FILTER.check();
}

#[test]
fn an_int_line_stuck_high_is_noticed() {
    chip::INT_HIGH.check();
}

#[test]
fn an_int_line_stuck_low_is_noticed() {
    chip::INT_LOW.check();
}
