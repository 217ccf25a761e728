//! The node measures a temperature and sends it.

use rig::manage::ms_between;
use rig::{Rig, TEMPERATURE_OF_NODE};

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
        assert!((ms_between(frames[0].0, frames[1].0) - 1000.0).abs() < 1.0);
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
