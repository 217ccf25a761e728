//! The budgets of avr-specs/budget.toml: flash, variables, and variables with the stack at its
//! deepest.

use bench::budget::{Budget, PAINT};
use rig::{ARRAY_COMMAND, Rig};

fn budget() -> Budget {
    Budget::of(rig::board().chip)
}

#[test]
fn flash_and_variables_stay_within_their_budgets() {
    let mut rig = Rig::powered();
    let mut address = |name: &str| rig.bench.board(0).avr().symbol(name).unwrap().address;
    let flash = address("__data_load_end");
    let statics = address("__heap_start") - budget().ram_start;
    let (flash_limit, statics_limit) = (budget().flash, budget().statics);
    println!("flash {flash} of {flash_limit}, statics {statics} of {statics_limit}");
    assert!(flash > 4000 && flash <= flash_limit);
    assert!(statics > 50 && statics <= statics_limit);
}

#[test]
fn the_linker_checks_the_budgets_of_flash_and_variables() {
    let mut rig = Rig::powered();
    let mut value = |name: &str| rig.bench.board(0).avr().symbol(name).unwrap().address;
    assert_eq!(value("__TEXT_REGION_LENGTH__"), budget().flash);
    assert_eq!(value("__DATA_REGION_LENGTH__"), budget().statics);
}

/// Causes what makes the stack deep: all kinds of messages, rejections, errors, a chip without
/// power, counters on request.
#[test]
fn the_deepest_stack_stays_within_its_budget() {
    let mut rig = Rig::powered();
    rig.overflows_expected = true;
    // The driver does not know yet that the chip was reset, so the model reports its accesses.
    rig.violations_expected = true;
    for round in 0..60u8 {
        rig.send_status_from(1 + round);
        rig.send_command(1, round % 6, f32::from(round) / 7.0);
        rig.send_servo_command(round);
        rig.send(ARRAY_COMMAND | 10, &[round; 8]);
        rig.board().avr_mut().serial_send(b"?");
        if round % 20 == 10 {
            rig.board().chip_reset();
        }
        if round % 20 == 5 {
            rig.connect_node(false);
        }
        if round % 20 == 9 {
            rig.connect_node(true);
        }
        rig.run_ms(307);
    }
    let avr = rig.board().avr();
    let bottom = avr.symbol("__heap_start").unwrap().address as u16;
    let stack = avr.stack_high_water(PAINT, bottom);
    let statics = u32::from(bottom) - budget().ram_start;
    let (used, limit) = (statics + u32::from(stack), budget().statics_and_stack);
    println!("statics {statics} and stack {stack}: {used} of {limit}");
    assert!(stack > 10, "the paint is where the test looks for it");
    assert!(used <= limit);
}
