//! Faults of the processor: it restarts, reports the cause, makes no pulse without a command, and follows commands from its first status
//! on. Its counters wrap without an effect. The cases are in `faults/processor.rs`. restart.rs tests that nothing can panic, and pulses
//! across a restart; parameters.rs tests a power failure at each byte of a save.

use rig::faults::processor;

#[test]
fn a_main_loop_that_hangs_is_restarted_by_the_watchdog() {
    processor::HANG.check();
}

#[test]
fn each_fault_of_the_program_restarts_it_and_is_told() {
    processor::STRAY_INTERRUPT.check();
    processor::STACK.check();
}

#[test]
fn each_reset_from_outside_is_told_apart() {
    processor::BROWN_OUT.check();
    processor::RESET_PIN.check();
    processor::POWER_CUT.check();
}

#[test]
fn a_dip_of_the_supply_during_a_save_leaves_a_whole_set_of_parameters() {
    processor::BROWN_OUT_DURING_SAVE.check();
}

#[test]
#[ignore = "takes long: make test-all"]
fn the_wrap_of_the_millisecond_counter_is_not_to_be_seen() {
    processor::MILLISECONDS_WRAP.check();
}

#[test]
fn the_uptime_and_the_transfer_ids_wrap_without_a_trace() {
    processor::UPTIME_WRAPS.check();
}
