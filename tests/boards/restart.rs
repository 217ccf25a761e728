//! What a restart reports, and the pulses of the servo meanwhile. `processor_faults.rs` has the
//! faults of the program.

use bench::avr::ResetCause;
use rig::status::{BROWN_OUT, INITIALIZATION, WATCHDOG};
use rig::{Rig, status_fields};

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
fn external_resets_are_reported_with_their_cause() {
    for (cause, logged, bit) in [
        (ResetCause::PowerOn, "power-on", 0),
        (ResetCause::External, "reset pin", 0),
        (ResetCause::Watchdog, "WATCHDOG", WATCHDOG),
        (ResetCause::BrownOut, "BROWN-OUT", BROWN_OUT),
    ] {
        let mut rig = Rig::positioned();
        rig.run_ms(1000);
        rig.forget();
        rig.board().reset(cause);
        rig.wait_for_line(&format!("reset: {logged}"), 100);
        rig.run_ms(50);
        let status = status_fields(&rig.statuses().last().expect("a status at once").1);
        // Uptime, health, mode and vendor code.
        assert_eq!(status, (0, u8::from(bit != 0), INITIALIZATION, bit), "{logged}");
        // The node works again; the servo has no pulse before a command.
        rig.run_ms(100);
        rig.forget();
        rig.run_ms(100);
        assert_eq!(rig.pulses, []);
        rig.send_command(1, 0, 0.5);
        assert_eq!(rig.settled_pulse_us(), 1750.0);
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
