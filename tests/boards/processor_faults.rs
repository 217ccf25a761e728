//! Faults of the processor: it restarts, reports the cause, makes no pulse without a command, and
//! follows commands from its first status on. Wraps of its counters have no effect. The cases are
//! in `faults/processor.rs`. restart.rs tests that nothing can panic, and pulses during a restart;
//! parameters.rs tests a power failure at each byte of a save.

rig::check_each! {
    processor:
    a_main_loop_that_hangs_is_restarted_by_the_watchdog: HANG;
    each_fault_of_the_program_restarts_it_and_is_reported: STRAY_INTERRUPT, STACK;
    each_external_reset_is_reported_with_its_cause: BROWN_OUT, RESET_PIN, POWER_CUT;
    a_brown_out_during_a_save_leaves_a_complete_set_of_parameters: BROWN_OUT_DURING_SAVE;
    #[ignore = "takes long: make test-all"]
    the_wrap_of_the_millisecond_counter_has_no_effect: MILLISECONDS_WRAP;
    #[ignore = "takes long: make test-all"]
    the_wraps_of_the_uptime_and_the_transfer_ids_have_no_effect: UPTIME_WRAPS;
}
