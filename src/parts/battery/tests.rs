use super::*;
use crate::golden;
use crate::hardware::Input;

const HOUR_MS: u32 = 3_600_000;

/// A circuit with an ACS712-30A: 2.5 V without a current, and 66 mV more for an ampere.
const ACS712: [(Parameter, i32); 3] =
    [(Parameter::BattRate, 1), (Parameter::Pwr1AmpPervlt, 1515), (Parameter::Pwr1AmpOffset, 2500)];

/// The reading of the ADC for a current, with noise of one step from end to end, as a real sensor
/// has it. Without any noise the error of the ADC, half a step at most, would stay.
fn reading(amperes: f64, seed: &mut u32) -> u16 {
    *seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    let noise = f64::from(*seed >> 16) / 65_536.0 - 0.5;
    ((2.5 + 0.066 * amperes) / 5.0 * 1024.0 + noise).round() as u16
}

/// Measures for an hour, each `tick_ms` one input. Returns the battery, the charge that the
/// currents give, and the charge that the measured currents give, in mAh.
fn hour(tick_ms: impl Fn(u32) -> u32, amperes: impl Fn(f64) -> f64) -> (Battery, f64, f64) {
    let parameters = golden::parameters(&ACS712);
    let (mut power, mut battery) = (Power::new(), Battery::new());
    let (mut exact, mut measured, mut seed, mut is_at) = (0.0, 0.0, 1, Input::Sensor);
    let (mut now_ms, mut tick, mut last_ms) = (0, 0, 0);
    while now_ms < HOUR_MS {
        let passed_ms = tick_ms(tick);
        (now_ms, tick) = (now_ms + passed_ms, tick + 1);
        let now = amperes(f64::from(now_ms) / 1000.0);
        exact += now * f64::from(passed_ms) / 3600.0;
        let next = power.next_input(&parameters);
        let of_current = if is_at == Input::Current { reading(now, &mut seed) } else { 0 };
        is_at = next;
        if power.add(of_current, next).1 {
            power.measure(&parameters);
            battery.add(power.centiamperes(), now_ms as u16);
            measured += f64::from(power.centiamperes()) * f64::from(now_ms - last_ms) / 360_000.0;
            last_ms = now_ms;
        }
    }
    (battery, exact, measured)
}

/// A motor's current: it swings in seven seconds, and has bursts.
fn flight(seconds: f64) -> f64 {
    let burst = if seconds % 61.0 < 3.0 { 9.0 } else { 0.0 };
    11.0 + 6.0 * (seconds * core::f64::consts::TAU / 7.0).sin() + burst
}

#[test]
fn after_an_hour_the_charge_is_that_of_the_measured_currents() {
    // A reading each millisecond, as on a quiet bus; or up to 4 ms apart, as on a full one.
    let uneven = |tick: u32| 1 + tick % 4;
    for (name, amperes) in [("flight", flight as fn(f64) -> f64), ("idle", |_| 0.13)] {
        for (battery, exact, measured) in [hour(|_| 1, amperes), hour(uneven, amperes)] {
            let used = f64::from(battery.used_mah());
            println!("{name}: used {used} mAh, measured {measured:.1}, exact {exact:.1}");
            // A tick of the charge is 1.5 mAh, and the result is rounded.
            assert!((used - measured).abs() < 2.5, "{used} of {measured} mAh");
            // 0.1 %, and 2 mA for the rounding of 15 mA to whole millivolts at the pin.
            assert!((used - exact).abs() < exact * 0.001 + 4.5, "{used} of {exact} mAh");
        }
    }
}

/// A battery that gave a charge, in steps of a second at 36 A, 10 mAh each.
fn used(mah: u32) -> Battery {
    let mut battery = Battery::new();
    for second in 1..=mah / 10 {
        battery.add(3600, (second * 1000) as u16);
    }
    battery
}

#[test]
fn charging_takes_from_the_charge_and_a_full_battery_takes_no_more() {
    let mut battery = used(100);
    battery.add(-1800, 11_000);
    assert!((94..=96).contains(&battery.used_mah()), "{}", battery.used_mah());
    for second in 12..=60u16 {
        battery.add(-3600, second * 1000);
    }
    assert_eq!(battery.used_mah(), 0);
    battery.add(3600, 61_000);
    assert!((9..=11).contains(&battery.used_mah()), "{}", battery.used_mah());
}

#[test]
fn the_charge_stops_at_its_greatest_value() {
    assert!((65_530..).contains(&used(66_000).used_mah()));
    let battery = used(200_000);
    assert_eq!(battery.used_mah(), u16::MAX);
    assert!(battery.charge > i32::MAX - 3600 * 63, "95 Ah, and it does not begin again");
}

/// Remaining and full energy, flags, and state of charge of a BatteryInfo.
fn info(battery: &Battery, millivolts: u16, capacity: i32) -> (f32, f32, u8, u8) {
    let values = [(Parameter::BattRate, 1), (Parameter::BattCapacity, capacity)];
    let power = Power::at(millivolts, 0);
    let mut bytes = vec![];
    battery.put(&power, None, &golden::parameters(&values), |word| {
        bytes.extend(word.to_le_bytes());
    });
    assert_eq!(bytes.len(), 18);
    let number = |at: usize| half::f16::from_le_bytes([bytes[at], bytes[at + 1]]).to_f32();
    assert!(number(0).is_nan() && number(6).is_nan(), "temperature and average power");
    assert_eq!((number(12), bytes[15]), (0.0, 0x1F), "hours, and the health");
    (number(8), number(10), bytes[14], (bytes[16] & 0x3F) << 1 | bytes[17] >> 7)
}

#[test]
fn the_charge_that_is_left_is_that_of_the_capacity() {
    for (used_mah, percent) in [(0, 100), (330, 75), (660, 50), (1320, 0), (5000, 0)] {
        let (left, full, flags, charge) = info(&used(used_mah), 12_000, 1320);
        assert_eq!((flags, charge), (IN_USE, percent), "{used_mah} mAh");
        // Sixteenths of a watt-hour.
        assert!((full - 15.84).abs() < 0.04, "{full} Wh");
        assert!((left - 15.84 * f32::from(percent) / 100.0).abs() < 0.07, "{left} Wh");
    }
}

#[test]
fn large_and_small_batteries_have_their_energy() {
    let (_, full, _, _) = info(&used(0), 50_400, 65_535);
    assert!((full - 3303.0).abs() < 2.0, "{full} Wh");
    let (_, full, _, charge) = info(&used(0), 3700, 150);
    assert!((full - 0.555).abs() < 0.04, "{full} Wh");
    assert_eq!(charge, 100);
}
