//! Each firmware of v0 that `make test` builds starts, and follows a command. That of the thesis has its own tests, `thesis.rs`.

use rig::Rig;

#[track_caller]
fn starts_and_follows_a_command(features: &str) {
    let mut rig = Rig::of(features);
    rig.wait_until_up();
    rig.send_command(1, 0, 0.5);
    assert_eq!(rig.settled_pulse_us(), 1750.0, "{features}");
}

#[test]
fn the_default_preset_works() {
    starts_and_follows_a_command("default");
}

#[test]
fn the_preset_without_any_feature_works() {
    starts_and_follows_a_command("none");
}
