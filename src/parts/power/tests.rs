use super::*;
use crate::golden;

/// Gives each input 16 readings, as the board does.
fn measured(voltage: u16, current: u16, values: &[(Parameter, i32)]) -> Power {
    let parameters = golden::parameters(&[&[(Parameter::PwrRate, 10)], values].concat());
    let mut power = Power::new();
    let mut completed = 0;
    for _ in 0..16 {
        for _ in Input::ALL {
            let next = power.next_input(&parameters);
            let reading = match power.input {
                Input::Sensor => 51,
                Input::Voltage => voltage,
                Input::Current => current,
            };
            completed += usize::from(power.add(reading, next).1);
        }
    }
    // The first reading is the sensor's, so the last of the current is still to come.
    let next = power.next_input(&parameters);
    completed += usize::from(power.add(current, next).1);
    assert_eq!(completed, 1);
    power.measure(&parameters);
    power
}

fn volts(power: &Power) -> f32 {
    half::f16::from_bits(power.voltage()).to_f32()
}

fn amperes(power: &Power) -> f32 {
    half::f16::from_bits(power.current()).to_f32()
}

/// 10 and 1 kOhm make 12.6 V to 1.1455 V, which reads 234.4.
#[test]
fn a_divider_multiplies_the_voltage_at_the_pin() {
    let divider = [(Parameter::Pwr1VoltMult, 11_000)];
    assert!((volts(&measured(234, 0, &divider)) - 12.58).abs() < 0.02);
    assert!((volts(&measured(1023, 0, &divider)) - 54.95).abs() < 0.04);
    assert_eq!(volts(&measured(0, 0, &divider)), 0.0);
    // 100 mV too much, and 100 too little.
    for (offset, expected) in [(100, 11.48), (-100, 13.68)] {
        let values = [(Parameter::Pwr1VoltMult, 11_000), (Parameter::Pwr1VoltOfs, offset)];
        assert!((volts(&measured(234, 0, &values)) - expected).abs() < 0.02, "{offset}");
    }
}

#[cfg(feature = "sensors")]
#[test]
fn against_the_bandgap_full_scale_is_1_1_volts() {
    let values = [(Parameter::TempRef, 1), (Parameter::Pwr1VoltMult, 20_000)];
    assert!((volts(&measured(1023, 0, &values)) - 21.98).abs() < 0.02);
}

/// ACS712-30A: 2.5 V without a current, and 66 mV more for an ampere. INA180A1 with 10 mOhm: 0.2 V
/// for an ampere.
#[test]
fn sensors_of_the_current_have_a_slope_and_an_offset() {
    let acs712 = [(Parameter::Pwr1AmpPervlt, 1515), (Parameter::Pwr1AmpOffset, 2500)];
    for (reading, expected) in
        [(511, -0.07), (512, 0.0), (646, 9.91), (376, -10.06), (1023, 37.8), (0, -37.9)]
    {
        assert!((amperes(&measured(0, reading, &acs712)) - expected).abs() < 0.05, "{reading}");
    }
    let ina180 = [(Parameter::Pwr1AmpPervlt, 500)];
    assert!((amperes(&measured(0, 409, &ina180)) - 10.0).abs() < 0.05);
    // Beyond what 16 bits hold.
    assert!(amperes(&measured(0, 1023, &[(Parameter::Pwr1AmpPervlt, 65_535)])) > 327.0);
}

#[test]
fn each_limit_has_its_flag_and_0_is_no_limit() {
    let values = [(Parameter::Pwr1VoltMult, 10_000), (Parameter::Pwr1AmpPervlt, 1000)];
    // 1001 mV at each pin.
    let flags =
        |limits: &[(Parameter, i32)]| measured(205, 205, &[&values[..], limits].concat()).flags();
    assert_eq!(flags(&[]), 0);
    assert_eq!(flags(&[(Parameter::Pwr1VoltMax, 10_000)]), OVERVOLTAGE);
    assert_eq!(flags(&[(Parameter::Pwr1VoltMax, 10_010)]), 0);
    assert_eq!(flags(&[(Parameter::Pwr1VoltMin, 10_011)]), UNDERVOLTAGE);
    assert_eq!(flags(&[(Parameter::Pwr1VoltMin, 10_010)]), 0);
    assert_eq!(flags(&[(Parameter::Pwr1AmpMax, 1000)]), OVERCURRENT);
    assert_eq!(flags(&[(Parameter::Pwr1AmpMax, 1001)]), 0);
}
