use super::*;
use crate::golden::CONDITIONS;

const FAULTS: [ResetCause; 5] = [
    ResetCause::WATCHDOG,
    ResetCause::BROWN_OUT,
    ResetCause::PANIC,
    ResetCause::STRAY_INTERRUPT,
    ResetCause::STACK_COLLISION,
];

#[test]
fn a_clean_start_leaves_nothing_behind() {
    for cause in [ResetCause::POWER_ON, ResetCause::EXTERNAL, ResetCause::ASKED_FOR] {
        assert_eq!(Conditions::after(cause), Conditions::NONE);
    }
}

#[test]
fn each_fault_that_resets_has_its_bit() {
    // The last two faults share a bit.
    for (bit, cause) in FAULTS.into_iter().enumerate() {
        assert_eq!(Conditions::after(cause).code(), 1 << bit.min(3));
    }
}

#[test]
fn every_condition_has_a_bit_of_its_own_and_all_bits_are_used() {
    let mut conditions = Conditions::NONE;
    for (bit, condition) in CONDITIONS.into_iter().enumerate() {
        assert_eq!(condition.code(), 1 << bit);
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
    // Cleared: transfer errors (4), frames lost (5), bus-off (7), gave up sending (8) and controller lost (9).
    assert_eq!(conditions.code(), 0b1111_1100_0100_1111);
    conditions.set(Conditions::ERROR_PASSIVE, false);
    assert_eq!(conditions.code(), 0b1111_1100_0000_1111);
}
