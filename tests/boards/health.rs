//! The node's health: each condition has a bit, the masks choose its health, and it clears with its
//! cause.

use bench::avr::ResetCause;
use bench::dronecan::Message;
use rig::status::{
    BROWN_OUT, CRITICAL, DISARMED, ERROR, FAILSAFE, OK, OPERATIONAL, TEMPERATURE, TRANSFER_ERRORS,
    WARNING,
};
use rig::{ARRAY_COMMAND, MS, Program, Rig};

/// Waits for a status with this health and code.
#[track_caller]
fn wait_for_status(rig: &mut Rig, health: u8, code: u16, within_ms: u64) {
    let seen = rig.statuses().len();
    let says = |rig: &Rig| {
        rig.statuses()[seen..].iter().any(|(_, data)| {
            let (_, reported, _, vendor_code) = rig::status_fields(data);
            (reported, vendor_code) == (health, code)
        })
    };
    rig.wait_for(&format!("status with health {health} and code {code:#06x}"), within_ms, says);
}

/// Kelvin and flags of the last Temperature.
fn temperature(rig: &Rig) -> Option<bench::dronecan::Temperature> {
    let reported = rig.node_messages(|message| match message {
        Message::Temperature(temperature) => Some(temperature),
        _ => None,
    });
    reported.last().map(|(_, temperature)| *temperature)
}

#[test]
fn a_temperature_out_of_range_is_a_warning_until_it_is_in_range() {
    let mut rig = Rig::running();
    rig.board().set_temperature_c(25.0);
    wait_for_status(&mut rig, OK, 0, 2500);
    rig.board().set_temperature_c(90.0);
    wait_for_status(&mut rig, WARNING, TEMPERATURE, 3000);
    rig.run_ms(1100);
    let reported = temperature(&rig).unwrap();
    assert!(
        reported.over && !reported.under && (reported.celsius() - 90.0).abs() < 0.6,
        "{reported}"
    );
    assert!(rig.serial.contains("temperature out of range"), "{}", rig.serial);
    rig.board().set_temperature_c(80.0);
    wait_for_status(&mut rig, OK, 0, 3000);
    rig.run_ms(1100);
    assert!(!temperature(&rig).unwrap().over);
    assert!(rig.serial.contains("over: temperature out of range"), "{}", rig.serial);
    rig.set("TEMP_MIN", 82);
    wait_for_status(&mut rig, WARNING, TEMPERATURE, 3000);
    rig.run_ms(1100);
    let reported = temperature(&rig).unwrap();
    assert!(reported.under && !reported.over, "{reported}");
    rig.set("TEMP_MIN", -40);
    wait_for_status(&mut rig, OK, 0, 3000);
}

/// A sensor of half the slope, with an offset, against the other ADC reference.
#[test]
fn other_sensors_need_only_other_parameters() {
    let mut rig = Program::Full.running();
    // TMP36: 500 mV at 0 degrees, 10 mV per degree.
    rig.set("TEMP_OFFSET", 500);
    for celsius in [-30.0, 0.0, 21.0, 60.0] {
        rig.board().set_sensor_millivolts((500.0 + 10.0 * celsius) as u32);
        rig.run_ms(2100);
        let reported = temperature(&rig).unwrap().celsius();
        assert!((reported - celsius).abs() < 0.6, "{reported} C at {celsius} C");
    }
    // 5 mV per degree against 1.1 V.
    rig.set("TEMP_OFFSET", 0);
    rig.set("TEMP_SLOPE", 50);
    rig.set("TEMP_REF", 1);
    rig.set("TEMP_ID", 513);
    for celsius in [10.0, 45.0, 85.0] {
        rig.board().set_sensor_millivolts((5.0 * celsius) as u32);
        rig.run_ms(2100);
        let reported = temperature(&rig).unwrap();
        assert!((reported.celsius() - celsius).abs() < 0.6, "{reported} at {celsius} C");
        assert_eq!(reported.device, 513);
    }
}

/// A servo without a sensor. ArduPilot does not arm with a node that is not OK.
#[test]
#[ignore = "takes long: make test-all"]
fn a_servo_without_a_sensor_is_ok_and_sends_no_temperature() {
    for (sensor, millivolts) in [(1, 0), (1, 5000), (0, 0), (0, 5000), (0, 250)] {
        let mut rig = Rig::powered();
        rig.board().set_sensor_millivolts(millivolts);
        rig.wait_until_up();
        rig.set("TEMP_SENSOR", sensor);
        rig.run_ms(100);
        rig.forget();
        rig.run_ms(3500);
        assert!(rig.statuses().len() >= 3);
        for (_, data) in rig.statuses() {
            let (_, health, mode, code) = rig::status_fields(&data);
            assert_eq!(
                (health, mode, code),
                (OK, OPERATIONAL, 0),
                "TEMP_SENSOR {sensor}, {millivolts} mV"
            );
        }
        assert!(
            temperature(&rig).is_none() && !rig.serial.contains("temperature"),
            "{}",
            rig.serial
        );
        // The messages return with a sensor that is detected, or required.
        if sensor == 0 {
            rig.set("TEMP_SENSOR", 1);
        }
        rig.board().set_temperature_c(30.0);
        rig.run_ms(2100);
        assert!((temperature(&rig).unwrap().celsius() - 30.0).abs() < 0.6);
    }
}

#[test]
fn a_sensor_is_detected_by_16_consecutive_readings_within_the_range() {
    // The node reads once a millisecond. After the disconnection it needs a sum of 64 readings at
    // the end of the range.
    for (connected_ms, is_found) in [(10, false), (20, true)] {
        let mut rig = Rig::powered();
        rig.board().set_sensor_millivolts(0);
        rig.wait_until_up();
        for _ in 0..10 {
            rig.board().set_sensor_millivolts(250);
            rig.run_until(rig.now() + connected_ms * MS);
            rig.board().set_sensor_millivolts(0);
            rig.run_until(rig.now() + 30 * MS);
        }
        rig.forget();
        rig.run_ms(2500);
        let (_, health, _, code) = rig::status_fields(&rig.statuses().pop().expect("a status").1);
        let expected = if is_found { (WARNING, TEMPERATURE) } else { (OK, 0) };
        assert_eq!((health, code), expected, "{connected_ms} ms");
    }
}

#[test]
fn a_required_sensor_that_is_missing_is_a_warning() {
    let mut rig = Rig::powered();
    rig.board().set_sensor_millivolts(0);
    rig.wait_until_up();
    rig.set("TEMP_SENSOR", 2);
    wait_for_status(&mut rig, WARNING, TEMPERATURE, 2500);
    rig.wait_for_line("temperature sensor fault", 50);
}

/// An incomplete transfer is the sender's fault, or an attack. It must not prevent the vehicle from
/// arming.
#[test]
fn broken_transfers_are_reported_for_ten_seconds_and_leave_the_health_ok() {
    let mut rig = Rig::running();
    for _ in 0..2 {
        rig.send(ARRAY_COMMAND | 10, &[1, 0, 0, 0, 1, 0, 0, 0x80]);
    }
    wait_for_status(&mut rig, OK, TRANSFER_ERRORS, 1200);
    let began = rig.now();
    wait_for_status(&mut rig, OK, 0, 12_000);
    let lasted_ms = (rig.now() - began) / MS;
    assert!((8_500..11_500).contains(&lasted_ms), "{lasted_ms} ms");
}

/// A fault that is over stays in the status for a minute.
#[test]
#[ignore = "takes long: make test-all"]
fn the_cause_of_a_restart_is_a_warning_for_a_minute() {
    let mut rig = Rig::running();
    rig.board().reset(ResetCause::BrownOut);
    rig.wait_until_up();
    for (after_ms, expected) in
        [(0, (WARNING, BROWN_OUT)), (57_000, (WARNING, BROWN_OUT)), (4_000, (OK, 0))]
    {
        rig.run_ms(after_ms);
        assert_eq!(rig.next_status(), expected, "{after_ms} ms later");
    }
}

#[test]
fn the_masks_choose_the_health_of_a_condition() {
    let mut rig = Program::Full.running();
    rig.set("OUT1_TIMEOUT", 100);
    rig.send_command(1, 0, 0.0);
    wait_for_status(&mut rig, ERROR, FAILSAFE, 1500);
    let failsafe = i64::from(FAILSAFE);
    for (warning, error, critical, health) in [
        (0, 0, 0, OK),
        (failsafe, 0, 0, WARNING),
        (failsafe, failsafe, 0, ERROR),
        (0, failsafe, failsafe, CRITICAL),
        (failsafe, 0, failsafe, CRITICAL),
        (0xFFFF & !failsafe, 0xFFFF & !failsafe, 0xFFFF & !failsafe, OK),
    ] {
        rig.set("WARN_MASK", warning);
        rig.set("ERROR_MASK", error);
        rig.set("CRIT_MASK", critical);
        wait_for_status(&mut rig, health, FAILSAFE, 1500);
    }
}

#[test]
fn the_worst_of_several_conditions_is_the_health() {
    let mut rig = Rig::running();
    rig.set("ARM_REQ", 1);
    rig.board().set_temperature_c(120.0);
    wait_for_status(&mut rig, WARNING, DISARMED | TEMPERATURE, 3000);
    rig.set("ARM_REQ", 0);
    rig.set("OUT1_TIMEOUT", 100);
    rig.send_command(1, 0, 0.0);
    wait_for_status(&mut rig, ERROR, FAILSAFE | TEMPERATURE, 2000);
    rig.set("OUT1_TIMEOUT", 0);
    rig.send_command(1, 0, 0.0);
    wait_for_status(&mut rig, WARNING, TEMPERATURE, 2000);
}

#[test]
fn disarmed_is_reported_and_is_no_fault() {
    let mut rig = Rig::running();
    rig.set("ARM_REQ", 1);
    wait_for_status(&mut rig, OK, DISARMED, 1500);
    rig.broadcast(&Message::ArmingStatus(255), 0);
    wait_for_status(&mut rig, OK, 0, 1500);
    rig.run_ms(20);
    assert!(rig.serial.lines().any(|line| line == "over: disarmed"), "{}", rig.serial);
}
