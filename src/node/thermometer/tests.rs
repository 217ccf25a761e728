use super::*;
use crate::golden::parameters;

/// The build has other sensors than an LM35.
const HAS_SENSORS: bool = cfg!(feature = "sensors");

/// A sensor at an ADC: TEMP_REF, TEMP_OFFSET and TEMP_SLOPE.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Setting {
    reference: i32,
    offset_mv: i32,
    slope: i32,
}

const LM35: Setting = Setting { reference: 0, offset_mv: 0, slope: 100 };
const LM35_AT_BANDGAP: Setting = Setting { reference: 1, offset_mv: 0, slope: 100 };
const TMP36: Setting = Setting { reference: 0, offset_mv: 500, slope: 100 };
const TMP36_AT_BANDGAP: Setting = Setting { reference: 1, offset_mv: 500, slope: 100 };
const MCP9701: Setting = Setting { reference: 0, offset_mv: 400, slope: 195 };
const BELOW_ZERO: Setting = Setting { reference: 1, offset_mv: -500, slope: 100 };

impl Setting {
    fn parameters(self) -> Parameters {
        let values = [
            (Parameter::TempRef, self.reference),
            (Parameter::TempOffset, self.offset_mv),
            (Parameter::TempSlope, self.slope),
        ];
        parameters(if HAS_SENSORS { &values } else { &[] })
    }

    /// True if the build can have this sensor.
    fn is_possible(&self) -> bool {
        HAS_SENSORS || *self == LM35
    }

    /// The exact temperature for 64 readings with this sum, in kelvin.
    fn kelvin(self, sum: u16) -> f64 {
        let full_scale_mv = if self.reference == 0 { 5000.0 } else { 1100.0 };
        let mv = f64::from(sum) / 65_536.0 * full_scale_mv;
        (mv - f64::from(self.offset_mv)) * 10.0 / f64::from(self.slope) + 273.15
    }
}

/// A thermometer after 64 readings with this sum.
fn measured(sum: u16) -> Thermometer {
    let mut thermometer = Thermometer::new();
    for n in 0..64 {
        assert!(!thermometer.has_measured());
        thermometer.add(sum / 64 + u16::from(n < sum % 64));
    }
    assert!(thermometer.has_measured());
    thermometer
}

/// The temperature, computed in the two steps that the node uses.
fn kelvin_64ths(thermometer: &Thermometer, parameters: &Parameters) -> u16 {
    corrected(thermometer.uncorrected(parameters), parameters)
}

/// The largest sum.
const MAX_SUM: u16 = 64 * 1023;

#[test]
fn every_sum_is_right_to_a_tenth_of_a_kelvin_for_the_sensors_that_people_use() {
    let all = [LM35, LM35_AT_BANDGAP, TMP36, TMP36_AT_BANDGAP, MCP9701, BELOW_ZERO];
    for setting in all.into_iter().filter(Setting::is_possible) {
        let parameters = setting.parameters();
        for sum in 0..=MAX_SUM {
            let kelvin = f64::from(kelvin_64ths(&measured(sum), &parameters)) / 64.0;
            let exact = setting.kelvin(sum).clamp(0.0, 784.64);
            assert!((kelvin - exact).abs() < 0.1, "{kelvin} K is not {exact} K: {sum} {setting:?}");
        }
    }
}

/// Settings over the ranges of the parameters, in steps.
fn settings() -> impl Iterator<Item = Setting> {
    [0, 1].into_iter().flat_map(|reference| {
        [-500, -1, 0, 1, 500, 1500].into_iter().flat_map(move |offset_mv| {
            [10, 11, 20, 50, 67, 100, 200, 500].map(|slope| Setting { reference, offset_mv, slope })
        })
    })
}

#[test]
fn any_settings_give_the_temperature_or_the_limit_that_it_exceeds() {
    for setting in settings().filter(Setting::is_possible) {
        let parameters = setting.parameters();
        for sum in (0..=MAX_SUM).step_by(31).chain([MAX_SUM]) {
            // For a sensor with a small slope the range ends 750 K above the temperature at which
            // it gives 0 V.
            if (Setting { offset_mv: 0, ..setting }).kelvin(sum) > 273.0 + 750.0 {
                continue;
            }
            let kelvin = f64::from(kelvin_64ths(&measured(sum), &parameters)) / 64.0;
            let exact = setting.kelvin(sum).clamp(0.0, 784.64);
            assert!((kelvin - exact).abs() < 0.1, "{kelvin} K is not {exact} K: {sum} {setting:?}");
        }
    }
}

#[test]
fn readings_at_the_ends_of_the_range_are_a_faulty_sensor() {
    for (sum, is_faulty) in [
        (0, true),
        (63, true),
        (64, false),
        (64 * 51, false),
        (64 * 1022, false),
        (64 * 1022 + 1, true),
        (MAX_SUM, true),
    ] {
        assert_eq!(measured(sum).is_sensor_faulty(), is_faulty, "{sum}");
    }
}

#[test]
fn whole_degrees_are_rounded_to_the_nearest_below_zero_too() {
    for kelvin_64ths in 0..=DEGREE_ZERO + 32_767 {
        let exact = f64::from(i32::from(kelvin_64ths) - i32::from(ZERO_CELSIUS)) / 64.0;
        assert_eq!(f64::from(celsius(kelvin_64ths)), (exact + 0.5).floor(), "{kelvin_64ths}");
    }
}

#[test]
fn zero_degrees_are_273_15_kelvin_to_the_nearest_64th() {
    assert!((f64::from(ZERO_CELSIUS) / 64.0 - 273.15).abs() <= 1.0 / 128.0);
}
