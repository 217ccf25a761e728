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

#[test]
fn the_pulses_of_a_turn_and_the_greatest_id_are_those_of_the_parameters() {
    let mut rig = with_shaft(&[(Parameter::RpmId, 255), (Parameter::RpmPulses, 2)]);
    rig.pulse_us = 500;
    rig.run(110);
    assert_eq!(last(&rig), "18041578 FF 00 00 00 60 6A 47 C0");
}

#[test]
fn a_noisy_input_is_told_in_the_message_and_in_the_log() {
    let mut rig = with_shaft(&[]);
    rig.pulse_us = 10;
    rig.run(610);
    assert_eq!(last(&rig), "18041578 00 01 00 00 00 00 00 C5");
    #[cfg(feature = "monitor")]
    assert!(String::from_utf8_lossy(&rig.log).contains("rpm: too many pulses\r\n"));
}

#[test]
fn a_shaft_that_stands_still_has_the_speed_0() {
    let mut rig = with_shaft(&[]);
    rig.run(310);
    assert_eq!(last(&rig), "18041578 00 00 00 00 00 00 00 C2");
}

#[test]
fn with_rpm_rate_0_nothing_is_sent_and_nothing_is_counted() {
    let mut rig = with_shaft(&[(Parameter::RpmRate, 0)]);
    rig.pulse_us = 10_000;
    rig.run(2000);
    assert_eq!(rig.sent(RPM), []);
    assert!(!rig.program.node.counts_pulses());
    rig.set(Parameter::RpmRate, 50);
    rig.run(1000);
    let speeds: Vec<u8> = rig.sent(RPM).iter().map(|frame| frame.data()[6]).collect();
    assert!((49..=51).contains(&speeds.len()));
    // The first window has not ended at the first messages.
    assert!(speeds[6..].iter().all(|&high| high == 0x45), "{speeds:?}");
}
