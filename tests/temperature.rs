//! The node measures a temperature and sends it.

use rig::{DEGREES_OF_NODE, MS, Rig, TEMPERATURE_OF_NODE};

/// Device ID, kelvin and flags in a Temperature.
fn fields(data: &[u8]) -> (u16, f32, u8) {
    assert_eq!(data.len(), 6, "a Temperature and its tail byte");
    let kelvin = half::f16::from_le_bytes([data[2], data[3]]).to_f32();
    (u16::from_le_bytes([data[0], data[1]]), kelvin, data[4])
}

#[test]
fn a_temperature_comes_every_second_in_kelvin() {
    let mut rig = Rig::running();
    // The flags of the first messages are not checked.
    rig.set("TEMP_MAX", 150);
    for celsius in [0.0, 4.0, 25.0, 36.6, 85.0, 150.0] {
        rig.board().set_temperature_c(celsius);
        rig.run_ms(1500);
        rig.forget();
        rig.run_ms(3000);
        let frames = rig.frames(TEMPERATURE_OF_NODE);
        assert_eq!(frames.len(), 3);
        assert!((frames[1].0 - frames[0].0).abs_diff(1000 * MS) < MS);
        for (_, data) in &frames {
            let (device_id, kelvin, flags) = fields(data);
            assert_eq!((device_id, flags), (1, 0));
            // Half a step of the ADC plus half a step of the float16.
            assert!(
                (f64::from(kelvin) - 273.15 - celsius).abs() < 0.4,
                "{kelvin} K at {celsius} C"
            );
        }
    }
}

#[test]
fn the_serial_monitor_shows_the_temperature() {
    let mut rig = Rig::running();
    rig.board().set_temperature_c(30.0);
    rig.run_ms(1500);
    rig.forget();
    rig.wait_for_line("temperature +", 1100);
    let line = rig.serial.lines().find(|line| line.starts_with("temperature")).unwrap();
    let shown: f64 =
        line.trim_start_matches("temperature +").trim_end_matches(" C").parse().unwrap();
    assert!((shown - 30.0).abs() < 0.5, "{line}");
}

#[test]
fn without_a_thesis_command_the_node_sends_no_whole_degrees() {
    let mut rig = Rig::running();
    for _ in 0..10 {
        rig.send_status_from(1);
        rig.send_command(1, 0, 0.0);
        rig.run_ms(600);
    }
    assert_eq!(rig.frames(DEGREES_OF_NODE), []);
    let unknown: Vec<_> =
        rig.traffic.iter().filter(|(_, frame)| frame.to_string().contains("0458")).collect();
    assert!(unknown.is_empty());
}

#[test]
fn after_a_thesis_command_the_node_sends_whole_degrees_at_every_third_autopilot_status() {
    let mut rig = Rig::running();
    rig.board().set_temperature_c(41.0);
    rig.run_ms(200);
    rig.send_servo_command(90);
    rig.run_ms(20);
    for n in 1..=9 {
        rig.send_status_from(1);
        rig.run_ms(20);
        assert_eq!(rig.frames(DEGREES_OF_NODE).len(), n / 3, "after {n} statuses");
        rig.run_ms(580);
    }
    let frames = rig.frames(DEGREES_OF_NODE);
    for (n, (_, data)) in frames.iter().enumerate() {
        assert_eq!(data.len(), 2);
        assert_eq!(data[0], 41, "the sum of the readings is a little less, so the node must round");
        assert_eq!(data[1], 0xC0 | n as u8);
    }
}

#[test]
fn whole_degrees_are_limited_to_the_range_of_a_byte() {
    let mut rig = Rig::running();
    // An LM35 cannot cause this; a short to the supply can.
    rig.board().set_sensor_millivolts(5000);
    rig.run_ms(200);
    rig.send_servo_command(90);
    for _ in 0..3 {
        rig.send_status_from(1);
        rig.run_ms(600);
    }
    assert_eq!(rig.frames(DEGREES_OF_NODE)[0].1[0], 255);
}
