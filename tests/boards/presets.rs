//! Each v0 firmware that `make test` builds starts and follows a command. `thesis.rs` tests the
//! firmware of the thesis.

use rig::Rig;

#[track_caller]
fn starts_and_follows_a_command(features: &str) -> Rig {
    let mut rig = Rig::with_features(features);
    rig.wait_until_up();
    rig.send_command(1, 0, 0.5);
    assert_eq!(rig.settled_pulse_us(), 1750.0, "{features}");
    rig
}

#[test]
fn the_default_preset_works() {
    assert_ne!(starts_and_follows_a_command("default").serial, "");
}

#[test]
fn the_preset_without_a_serial_monitor_works_and_sends_no_line() {
    assert_eq!(starts_and_follows_a_command("remote").serial, "");
}
