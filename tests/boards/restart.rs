//! A fault of the program restarts it; the next status and the next banner report the cause.

use bench::avr::ResetCause;
use rig::status::{BROWN_OUT, INITIALIZATION, STACK_COLLISION, STRAY_INTERRUPT, WATCHDOG};
use rig::{Rig, status_fields};

/// Waits for the banner of a restart and checks the reported cause.
#[track_caller]
fn assert_restarts(rig: &mut Rig, within_ms: u64, cause: &str, bit: u16) {
    rig.wait_for_line(&format!("reset: {cause}"), within_ms);
    rig.run_ms(50);
    let (uptime, health, mode, vendor_code) =
        status_fields(&rig.statuses().last().expect("a status at once").1);
    assert_eq!(
        (uptime, mode),
        (0, INITIALIZATION),
        "the first status must say that the node initializes"
    );
    assert_eq!((health, vendor_code), (u8::from(bit != 0), bit));
    // The node works again; the servo has no pulse before a command.
    rig.run_ms(100);
    rig.forget();
    rig.run_ms(100);
    assert_eq!(rig.pulses, []);
    rig.send_command(1, 0, 0.5);
    assert_eq!(rig.settled_pulse_us(), 1750.0);
}

/// A running node whose servo moves.
fn moving() -> Rig {
    let mut rig = Rig::running();
    rig.send_command(1, 0, 0.0);
    rig.settled_pulse_us();
    rig.run_ms(1000);
    rig.forget();
    rig
}

/// Overwrites the instructions where the main loop resets the watchdog. Returns the unchanged
/// program.
fn patch_the_main_loop(rig: &mut Rig, instructions: [u8; 4]) -> Vec<u8> {
    let flash = rig.board().avr().flash().to_vec();
    // WDR is 0x95A8. The last one of the program is in the main loop.
    let wdr =
        (0x68..flash.len() - 2).step_by(2).rfind(|&at| flash[at..at + 2] == [0xA8, 0x95]).unwrap();
    rig.board().avr_mut().load_flash(wdr, &instructions);
    flash
}

/// RJMP to itself.
const HANG: [u8; 2] = [0xFF, 0xCF];

#[test]
fn a_hung_program_is_restarted_by_the_watchdog() {
    let mut rig = moving();
    let program = patch_the_main_loop(&mut rig, [HANG, HANG].concat().try_into().unwrap());
    // By now the node has restarted and hangs again.
    rig.run_ms(300);
    rig.board().avr_mut().load_flash(0, &program);
    assert_restarts(&mut rig, 50, "WATCHDOG", WATCHDOG);
    assert_eq!(
        rig.board().avr().resets().len(),
        1,
        "the program must restart without a reset of the chip, which would start the bootloader"
    );
}

/// The compiler removes every check that cannot fail, so the linker drops the panic handler.
#[test]
fn nothing_in_the_programs_can_panic() {
    // For the ATmega328P one program has all features.
    let of_board = if rig::has_all_features() { &["full"][..] } else { &["default", "thesis"] };
    for features in of_board {
        let mut rig = Rig::with_features(features);
        let avr = rig.board().avr();
        assert!(avr.symbol("main").is_some() && avr.symbol_with("panic").is_none(), "{features}");
    }
}

#[test]
fn an_interrupt_without_a_handler_restarts_the_node() {
    let mut rig = moving();
    // TIMSK1.TOIE1: Timer1 overflows at the end of every servo period. The program has no handler
    // for that.
    rig.board().avr_mut().poke_sram(0x6F, 1);
    assert_restarts(&mut rig, 100, "STRAY INTERRUPT", STRAY_INTERRUPT);
}

#[test]
fn a_stack_that_reaches_the_variables_restarts_the_node() {
    let mut rig = moving();
    let bottom = rig.board().avr().symbol("__heap_start").unwrap().address as u16;
    rig.board().avr_mut().poke_sram(bottom, 0);
    assert_restarts(&mut rig, 50, "STACK COLLISION", STACK_COLLISION);
}

#[test]
fn external_resets_are_reported_with_their_cause() {
    for (cause, logged, bit) in [
        (ResetCause::PowerOn, "power-on", 0),
        (ResetCause::External, "reset pin", 0),
        (ResetCause::Watchdog, "WATCHDOG", WATCHDOG),
        (ResetCause::BrownOut, "BROWN-OUT", BROWN_OUT),
    ] {
        let mut rig = moving();
        rig.board().reset(cause);
        assert_restarts(&mut rig, 100, logged, bit);
    }
}

#[test]
fn a_restart_does_not_shorten_a_pulse() {
    for delay in 0..40u64 {
        let mut rig = Rig::running();
        rig.send_command(1, 0, 1.0);
        rig.settled_pulse_us();
        rig.forget();
        // At all phases of the servo period, also during a pulse.
        let at = rig.now() + delay * 8_011;
        rig.run_until(at);
        let bottom = rig.board().avr().symbol("__heap_start").unwrap().address as u16;
        rig.board().avr_mut().poke_sram(bottom, 0);
        rig.run_ms(100);
        assert!(rig.serial.contains("STACK COLLISION"));
        assert!(rig.pulses.iter().all(|pulse| pulse.width_us() == 2000.0), "{:?}", rig.pulses);
    }
}
