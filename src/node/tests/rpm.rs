//! Revolutions of a shaft: sensors.rpm.RPM.

use super::*;

const RPM: u32 = 0x1804_1578;

/// A node that sends RPM ten times a second.
fn with_shaft(values: &[(Parameter, i32)]) -> Rig {
    Rig::with(&[&[(Parameter::RpmRate, 10)], values].concat())
}

/// The last RPM, as text.
fn last(rig: &Rig) -> String {
    golden::text([rig.sent(RPM).last().unwrap()])
}

#[test]
fn the_golden_speed_is_sent() {
    let mut rig = with_shaft(&[(Parameter::RpmId, 3)]);
    rig.pulse_us = 10_000;
    rig.run(310);
    assert_eq!(last(&rig), "18041578 03 00 00 00 80 BB 45 C2");
}
