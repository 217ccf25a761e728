//! Voltage and current of a circuit (feature `power`): CircuitStatus, limits, and the load in
//! actuator.Status.

use bench::dronecan::CircuitStatus;
use bench::dronecan::Message;
use rig::status::{OK, POWER, WARNING};
use rig::{Program, Rig};

const PROGRAM: Program = Program::Full;

/// A node with a divider of 10 and 1 kOhm, and an ACS712 for 30 A: 2.5 V at 0 A, 66 mV more per
/// ampere.
fn measuring() -> Rig {
    let mut rig = PROGRAM.running();
    rig.set_all(&[
        ("PWR1_VOLT_MULT", 11_000),
        ("PWR1_AMP_PERVLT", 1515),
        ("PWR1_AMP_OFFSET", 2500),
        ("PWR1_ID", 40_000),
        ("PWR_RATE", 10),
    ]);
    rig
}

/// Applies this voltage and current to the circuit.
fn set(rig: &mut Rig, volts: f64, amperes: f64) {
    rig.board()
        .set_circuit_millivolts((volts * 1000.0 / 11.0) as u32, (2500.0 + 66.0 * amperes) as u32);
    rig.run_ms(150);
    rig.forget();
    rig.run_ms(1000);
}

fn statuses(rig: &mut Rig) -> Vec<CircuitStatus> {
    let heard = rig.node_messages(|message| match message {
        Message::CircuitStatus(status) => Some(status),
        _ => None,
    });
    heard.into_iter().map(|(_, status)| status).collect()
}

#[track_caller]
fn assert_near(status: &CircuitStatus, volts: f32, amperes: f32) {
    // An ADC step is 54 mV and 74 mA here, and a float16 has steps of 31 mV at 50 V.
    let (voltage, current) = (f32::from(status.voltage), f32::from(status.current));
    assert!(
        (voltage - volts).abs() < 0.08 && (current - amperes).abs() < 0.08,
        "{voltage} V, {current} A"
    );
}

#[test]
fn voltage_and_current_are_sent_ten_times_a_second() {
    let mut rig = measuring();
    for (volts, amperes) in [(12.6, 3.2), (50.0, -20.0), (0.0, 0.0), (7.4, 30.0)] {
        set(&mut rig, volts, amperes);
        let statuses = statuses(&mut rig);
        assert!((9..=11).contains(&statuses.len()), "{} in a second", statuses.len());
        for status in &statuses {
            assert_near(status, volts as f32, amperes as f32);
            assert_eq!((status.circuit, status.errors), (40_000, 0));
        }
    }
    rig.wait_for_line("circuit 7", 1100);
}

#[test]
fn the_temperature_is_measured_besides_the_circuit() {
    let mut rig = measuring();
    rig.board().set_temperature_c(36.0);
    set(&mut rig, 12.0, 1.0);
    let temperatures = rig.node_messages(|message| match message {
        Message::Temperature(temperature) => Some(f32::from(temperature.kelvin)),
        _ => None,
    });
    let (_, kelvin) = temperatures.last().expect("a Temperature");
    assert!((kelvin - 309.15).abs() < 0.6, "{kelvin} K");
}

#[test]
fn beyond_a_limit_the_circuit_status_has_a_flag_and_the_node_a_condition() {
    let mut rig = measuring();
    rig.set("PWR1_VOLT_MIN", 10_000);
    rig.set("PWR1_VOLT_MAX", 17_000);
    rig.set("PWR1_AMP_MAX", 1000);
    for (volts, amperes, flags) in [(18.0, 1.0, 1), (9.0, 1.0, 2), (12.0, 11.0, 4), (9.0, -11.0, 6)]
    {
        set(&mut rig, volts, amperes);
        assert_eq!(
            statuses(&mut rig).last().map(|status| status.errors),
            Some(flags),
            "{volts} V, {amperes} A"
        );
        assert_eq!(rig.next_status(), (WARNING, POWER));
        assert!(rig.serial.contains("circuit out of range"), "{}", rig.serial);
        set(&mut rig, 12.0, 9.5);
        assert_eq!(statuses(&mut rig).last().map(|status| status.errors), Some(0));
        assert_eq!(rig.next_status(), (OK, 0));
        assert!(rig.serial.contains("over: circuit out of range"), "{}", rig.serial);
    }
}

#[test]
fn actuator_status_has_the_load_of_the_output_that_the_circuit_feeds() {
    let mut rig = measuring();
    rig.set("PWR1_AMP_MAX", 2000);
    let ratings = |rig: &mut Rig| {
        let heard = rig.node_messages(|message| match message {
            Message::ActuatorStatus(status) => Some(status.power_percent),
            _ => None,
        });
        heard.into_iter().map(|(_, percent)| percent).collect::<Vec<_>>()
    };
    set(&mut rig, 12.0, 5.0);
    assert!(ratings(&mut rig).iter().all(|percent| *percent == 127), "unknown");
    rig.set("PWR1_OUT", 1);
    for (amperes, expected) in [(5.0, 24..=26), (20.0, 99..=101), (0.0, 0..=1)] {
        set(&mut rig, 12.0, amperes);
        let ratings = ratings(&mut rig);
        assert!(
            !ratings.is_empty() && ratings.iter().all(|percent| expected.contains(percent)),
            "{ratings:?}"
        );
    }
}

#[test]
fn with_rate_0_the_condition_clears() {
    let mut rig = measuring();
    rig.set("PWR1_VOLT_MAX", 10_000);
    set(&mut rig, 12.0, 0.0);
    assert_eq!(rig.next_status(), (WARNING, POWER));
    rig.set("PWR_RATE", 0);
    rig.run_ms(1100);
    assert_eq!(rig.next_status(), (OK, 0));
}
