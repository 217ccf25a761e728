//! Faults of the CAN controller and its wires: the node detects and logs each within 100 ms and
//! restarts the controller. The servo holds its position or moves to its failsafe. The cases are in
//! `faults/chip.rs`, what they measure in docs/reliability.md.

use rig::faults::chip;

#[test]
fn a_reset_controller_is_restarted_before_the_failsafe() {
    chip::RESET.check();
}

#[test]
fn a_controller_with_garbage_in_its_registers_is_restarted() {
    chip::BROWN_OUT.check();
}

#[test]
fn a_controller_without_power_is_restarted_until_it_answers() {
    chip::NO_POWER.check();
}

#[test]
fn a_controller_stuck_in_configuration_mode_is_restarted_until_it_leaves_it() {
    chip::HELD.check();
}

#[test]
fn a_sleeping_controller_is_restarted() {
    chip::ASLEEP.check();
}

#[test]
fn an_spi_that_reads_all_zeros_or_all_ones_is_logged() {
    chip::MISO_LOW.check();
    chip::MISO_HIGH.check();
}

#[test]
fn an_spi_that_flips_bits_is_logged_and_the_servo_stays_in_its_travel() {
    chip::FLIPPING.check();
}

#[test]
fn a_flipped_bit_in_a_register_is_detected() {
    chip::REGISTER.check();
}

#[test]
fn a_flipped_bit_in_a_filter_is_corrected_by_the_failsafe() {
    chip::FILTER.check();
}

#[test]
fn an_int_line_stuck_high_is_detected() {
    chip::INT_HIGH.check();
}

#[test]
fn an_int_line_stuck_low_is_detected() {
    chip::INT_LOW.check();
}
