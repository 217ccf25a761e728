//! The battery of the circuit (feature `battery`): BatteryInfo through the pins and the bus.

use bench::dronecan::{BatteryInfo, Message};
use rig::{Program, Rig};

const PROGRAM: Program = Program::Full;

const IN_USE: u16 = 1;
const HOT: u16 = 8;
const COLD: u16 = 16;
const OVERLOAD: u16 = 32;
const UNKNOWN: u8 = 127;

/// A node with a divider of 10 and 1 kOhm, and an INA180A1 with 10 mOhm: 0.2 V for an ampere. The
/// battery has 100 mAh.
fn watching() -> Rig {
    let mut rig = PROGRAM.running();
    rig.set_all(&[
        ("PWR1_VOLT_MULT", 11_000),
        ("PWR1_AMP_PERVLT", 500),
        ("BATT_CAPACITY", 100),
        ("BATT_ID", 9),
        ("BATT_RATE", 10),
    ]);
    rig
}

/// Applies this voltage and current to the circuit, and runs for so many milliseconds.
fn draw(rig: &mut Rig, volts: f64, amperes: f64, ms: u64) {
    rig.board().set_circuit_millivolts((volts * 1000.0 / 11.0) as u32, (200.0 * amperes) as u32);
    rig.forget();
    rig.run_ms(ms);
}

fn infos(rig: &mut Rig) -> Vec<BatteryInfo> {
    let heard = rig.node_messages(|message| match message {
        Message::BatteryInfo(info) => Some(*info),
        _ => None,
    });
    heard.into_iter().map(|(_, info)| info).collect()
}

fn last(rig: &mut Rig) -> BatteryInfo {
    infos(rig).pop().expect("a BatteryInfo")
}

#[test]
#[ignore = "takes long: make test-all"]
fn the_charge_falls_with_the_current_that_is_drawn() {
    let mut rig = watching();
    draw(&mut rig, 12.0, 0.0, 1000);
    let full = last(&mut rig);
    assert_eq!((full.battery, full.charge, full.flags), (9, 100, IN_USE));
    assert!((f32::from(full.voltage) - 12.0).abs() < 0.08, "{full}");
    // 18 A for 4 s are 20 mAh.
    draw(&mut rig, 12.0, 18.0, 4000);
    let infos = infos(&mut rig);
    assert!((39..=41).contains(&infos.len()), "{} in 4 s", infos.len());
    let charges: Vec<u8> = infos.iter().map(|info| info.charge).collect();
    assert!(charges.is_sorted_by(|before, after| before >= after), "{charges:?}");
    let info = infos.last().unwrap();
    assert!((79..=81).contains(&info.charge), "{info}");
    assert!((f32::from(info.current) - 18.0).abs() < 0.08, "{info}");
    assert!((f32::from(info.remaining_wh) - 0.96).abs() < 0.07, "{info}");
    assert!((f32::from(info.full_wh) - 1.2).abs() < 0.07, "{info}");
    assert!(info.temperature.is_nan() && info.average_power.is_nan(), "{info}");
    assert_eq!((info.health, f32::from(info.hours_to_full)), (UNKNOWN, 0.0));
    // More than all.
    draw(&mut rig, 10.0, 24.0, 13_000);
    let empty = last(&mut rig);
    assert_eq!((empty.charge, f32::from(empty.remaining_wh)), (0, 0.0));
}

#[test]
fn without_a_capacity_the_charge_is_unknown() {
    let mut rig = watching();
    rig.set("BATT_CAPACITY", 0);
    draw(&mut rig, 12.0, 18.0, 1000);
    let info = last(&mut rig);
    assert_eq!(info.charge, UNKNOWN);
    assert!(info.remaining_wh.is_nan() && info.full_wh.is_nan(), "{info}");
}

#[test]
fn the_flags_are_those_of_the_current_and_of_the_sensor_at_the_battery() {
    let mut rig = watching();
    rig.set("PWR1_AMP_MAX", 1000);
    rig.set("TEMP_MIN", 5);
    rig.set("TEMP_MAX", 60);
    for (celsius, is_at_battery, amperes, flags) in [
        (25.0, 0, 9.0, IN_USE),
        (25.0, 0, 11.0, IN_USE | OVERLOAD),
        (70.0, 0, 9.0, IN_USE),
        (70.0, 1, 9.0, IN_USE | HOT),
        (2.0, 1, 11.0, IN_USE | COLD | OVERLOAD),
    ] {
        rig.board().set_temperature_c(celsius);
        rig.set("BATT_TEMP", is_at_battery);
        draw(&mut rig, 12.0, amperes, 1000);
        let info = last(&mut rig);
        assert_eq!(info.flags, flags, "{celsius} C, {amperes} A: {info}");
        let kelvin = f32::from(info.temperature);
        assert_eq!(kelvin.is_nan(), is_at_battery == 0, "{info}");
        assert!(kelvin.is_nan() || (f64::from(kelvin) - 273.15 - celsius).abs() < 0.6, "{info}");
    }
}

#[test]
fn circuit_status_and_battery_info_go_side_by_side() {
    let mut rig = watching();
    rig.set("PWR_RATE", 5);
    draw(&mut rig, 11.1, 3.0, 2000);
    let circuits = rig.node_messages(|message| match message {
        Message::CircuitStatus(status) => Some(status),
        _ => None,
    });
    assert!((9..=11).contains(&circuits.len()), "{} in 2 s", circuits.len());
    let (_, circuit) = circuits.last().unwrap();
    let info = last(&mut rig);
    assert_eq!((info.voltage, info.current), (circuit.voltage, circuit.current));
}
