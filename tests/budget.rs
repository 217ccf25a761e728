//! The budgets: flash, variables, and variables with the stack at its deepest.

mod rig;

use rig::Rig;

const FLASH_LIMIT: u64 = 14_336;
const STATICS_LIMIT: u64 = 640;
const STATICS_AND_STACK_LIMIT: u16 = 960;

/// What the program paints unused RAM with at its start.
const PAINT: u8 = 0xC5;

#[test]
fn flash_and_variables_keep_to_their_budgets() {
    let mut rig = Rig::powered();
    let mut end = |name: &str| u64::from(rig.bench.board(0).avr().symbol(name).unwrap().address);
    let flash = end("__data_load_end");
    let statics = end("__heap_start") - 0x100;
    println!("flash {flash} of {FLASH_LIMIT}, statics {statics} of {STATICS_LIMIT}");
    assert!(flash > 4000 && flash <= FLASH_LIMIT);
    assert!(statics > 50 && statics <= STATICS_LIMIT);
}

/// Everything that makes the stack deep: all kinds of messages, refusals, errors, a lost chip, counters on request.
#[test]
fn the_stack_at_its_deepest_stays_within_its_budget() {
    let mut rig = Rig::powered();
    rig.overflows_expected = true;
    for round in 0..60u8 {
        rig.send_status_from(1 + round);
        rig.send_command(1, round % 6, f32::from(round) / 7.0);
        rig.send_servo_command(round);
        rig.send(0x1003_F20A, &[round; 8]);
        rig.board().avr_mut().serial_send(b"?");
        if round % 20 == 10 {
            rig.board().chip_reset();
        }
        if round % 20 == 5 {
            let port = rig.bench.port(0);
            rig.bench.bus().connect(port, false);
        }
        if round % 20 == 9 {
            let port = rig.bench.port(0);
            rig.bench.bus().connect(port, true);
        }
        rig.run_ms(307);
    }
    let avr = rig.board().avr();
    let bottom = avr.symbol("__heap_start").unwrap().address as u16;
    let stack = avr.stack_high_water(PAINT, bottom);
    let used = bottom - 0x100 + stack;
    println!("statics {} and stack {stack}: {used} of {STATICS_AND_STACK_LIMIT}", bottom - 0x100);
    assert!(stack > 10, "the paint is where the test looks for it");
    assert!(used <= STATICS_AND_STACK_LIMIT);
}
