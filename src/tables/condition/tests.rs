use super::*;
use crate::golden::CONDITIONS;

#[test]
fn each_fault_that_resets_has_its_number_in_the_lowest_bits_and_a_clean_start_has_none() {
    let faults = [
        ResetCause::WATCHDOG,
        ResetCause::BROWN_OUT,
        ResetCause::PANIC,
        ResetCause::STRAY_INTERRUPT,
        ResetCause::STACK_COLLISION,
    ];
    for (cause, number) in faults.into_iter().zip(1..) {
        assert_eq!(Conditions::after(cause).map(Conditions::code), Some(number));
        assert!(Conditions::RESET.code() >= number);
    }
    for cause in [ResetCause::POWER_ON, ResetCause::EXTERNAL, ResetCause::ASKED_FOR] {
        assert_eq!(Conditions::after(cause), None);
    }
}

#[test]
fn every_condition_has_a_bit_of_its_own_and_all_bits_are_used() {
    let mut conditions = Conditions::NONE;
    for (bit, condition) in CONDITIONS.into_iter().enumerate() {
        assert_eq!(condition.code(), if bit == 0 { 7 } else { 4 << bit });
        assert!(!conditions.has(condition));
        conditions.set(condition, true);
        assert!(conditions.has(condition));
    }
    assert_eq!(conditions.code(), 0xFFFF);
}

#[test]
fn temporary_conditions_are_cleared_and_others_stay() {
    let mut conditions = Conditions::NONE;
    for bit in 0..16 {
        conditions.set(Conditions(1 << bit), true);
    }
    conditions.pass();
    // Cleared: the reset (0 to 2), transfer errors (3), ID conflict (4), frames lost (5), bus-off
    // (7), controller (8), two commanders (9).
    assert_eq!(conditions.code(), 0b1111_1100_0100_0000);
    conditions.set(Conditions::ERROR_PASSIVE, false);
    assert_eq!(conditions.code(), 0b1111_1100_0000_0000);
}
