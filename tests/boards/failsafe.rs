//! The output goes to its failsafe when, and only when, commands for it stop. With ARM_REQ the
//! output follows commands only while the vehicle is armed.

use bench::dronecan::{Message, ParameterRequest};
use rig::manage::ms_between;
use rig::status::{DISARMED, ERROR, FAILSAFE, OK};
use rig::{ARMED, ARRAY_COMMAND, MS, Rig};

const HOLD: i64 = 0;
const TRIM: i64 = 1;
const PULSE: i64 = 2;
const OFF: i64 = 3;

/// A node with this failsafe, whose servo is at 1750 us.
fn moving(mode: i64, timeout_ms: i64) -> Rig {
    let mut rig = Rig::running();
    rig.set("OUT1_TRIM", 1450);
    rig.set("OUT1_FS_PWM", 1900);
    rig.set("OUT1_FS", mode);
    rig.set("OUT1_TIMEOUT", timeout_ms);
    // A unitless 0.5 is halfway between trim and maximum.
    command(&mut rig);
    rig.run_ms(45);
    rig
}

fn command(rig: &mut Rig) {
    rig.send_command(1, 4, 1750.0);
}

fn arm(rig: &mut Rig, status: u8) {
    rig.broadcast(&Message::ArmingStatus(status), 0);
}

#[test]
fn hold_keeps_the_last_pulse_and_is_logged() {
    let mut rig = moving(HOLD, 1000);
    rig.run_ms(3000);
    assert_eq!(rig.settled_pulse_us(), 1750.0);
    assert_eq!(rig.next_status(), (ERROR, FAILSAFE));
}

#[test]
fn trim_pulse_and_off_begin_at_the_timeout_and_not_before() {
    for (mode, expected) in [(TRIM, Some(1450.0)), (PULSE, Some(1900.0)), (OFF, None)] {
        for timeout_ms in [100, 1000] {
            let mut rig = moving(mode, timeout_ms);
            command(&mut rig);
            rig.run_ms(1);
            let commanded = rig.now();
            rig.run_ms(timeout_ms as u64 + 200);
            let old = rig.pulses.iter().rfind(|pulse| pulse.width_us() == 1750.0).unwrap().start;
            // The new width begins with a servo period, so the last old pulse may have begun up to
            // 20 ms before the timeout.
            let held_ms = ms_between(commanded, old);
            let limits = timeout_ms as f64 - 22.0..timeout_ms as f64 + 3.0;
            assert!(
                limits.contains(&held_ms),
                "mode {mode}: held for {held_ms} of {timeout_ms} ms"
            );
            let after: Vec<f64> =
                rig.pulses.iter().filter(|p| p.start > old).map(|p| p.width_us()).collect();
            match expected {
                Some(width) => {
                    assert!(
                        after.len() > 5 && after.iter().all(|us| *us == width),
                        "mode {mode}: {after:?}"
                    )
                }
                None => assert!(after.is_empty(), "mode {mode}: {after:?}"),
            }
            assert_eq!(rig.next_status(), (ERROR, FAILSAFE));
        }
    }
}

#[test]
fn the_next_command_ends_the_failsafe_at_once_and_both_are_logged() {
    for mode in [HOLD, TRIM, PULSE, OFF] {
        let mut rig = moving(mode, 300);
        rig.wait_for_line("FAILSAFE", 400);
        assert_eq!(rig.next_status(), (ERROR, FAILSAFE));
        rig.run_ms(50);
        let seen = rig.serial.lines().count();
        command(&mut rig);
        assert_eq!(rig.settled_pulse_us(), 1750.0);
        rig.set("OUT1_TIMEOUT", 0);
        assert_eq!(rig.next_status(), (OK, 0));
        // Besides the log line of the command, a line must say that commands arrive again.
        let logged: Vec<&str> =
            rig.serial.lines().skip(seen).filter(|line| !line.contains("rx ")).collect();
        assert!(logged.iter().any(|line| line.contains("command")), "mode {mode}: {logged:?}");
    }
}

/// Other nodes and the autopilot send messages, but no commands.
#[test]
fn other_messages_do_not_prevent_the_failsafe() {
    let mut rig = moving(TRIM, 500);
    for n in 0..60u8 {
        rig.send_status_from(10);
        rig.send_command(2, 0, 0.5);
        rig.run_ms(2);
        rig.send(ARRAY_COMMAND | 10, &[0xC0]);
        rig.send_commands(&[(2, 0, 0.5), (3, 0, 0.5)]);
        rig.run_ms(2);
        rig.send_command(1, 0, f32::NAN);
        rig.send_command(1, 2, 0.0);
        rig.run_ms(2);
        arm(&mut rig, ARMED);
        rig.run_ms(2);
        rig.request(&Message::ParameterRequest(ParameterRequest {
            index: n.into(),
            ..ParameterRequest::default()
        }));
        rig.run_ms(2);
    }
    assert_eq!(rig.settled_pulse_us(), 1450.0);
    assert_eq!(rig.next_status().1 & FAILSAFE, FAILSAFE);
}

#[test]
fn regular_commands_of_each_kind_prevent_the_failsafe() {
    let mut rig = moving(OFF, 100);
    rig.forget();
    for n in 0..30 {
        match n % 3 {
            0 => command(&mut rig),
            1 => rig.send_commands(&[(2, 0, 0.5), (3, 0, 0.5), (1, 4, 1750.0)]),
            _ => rig.send_servo_command(200),
        }
        rig.run_ms(90);
    }
    assert!(rig.statuses().iter().all(|(_, data)| rig::status_fields(data).3 & FAILSAFE == 0));
    let gap = rig.pulses.windows(2).map(|pair| pair[1].start - pair[0].start).max().unwrap();
    assert!(gap < 21 * MS, "{} ms without a pulse", gap / MS);
}

#[test]
fn a_timeout_of_zero_disables_the_failsafe() {
    let mut rig = moving(OFF, 0);
    rig.run_ms(12_000);
    assert_eq!(rig.settled_pulse_us(), 1750.0);
    assert_eq!(rig.next_status(), (OK, 0));
}

#[test]
fn the_failsafe_pulse_stays_within_the_travel() {
    let mut rig = moving(PULSE, 200);
    rig.set("OUT1_FS_PWM", 2400);
    rig.run_ms(300);
    assert_eq!(rig.settled_pulse_us(), 2000.0);
    command(&mut rig);
    rig.set("OUT1_FS_PWM", 500);
    rig.run_ms(300);
    assert_eq!(rig.settled_pulse_us(), 1000.0);
}

// ---- the gate ----

#[test]
fn with_arm_req_the_arming_status_starts_and_stops_the_output() {
    let mut rig = Rig::running();
    rig.set("OUT1_FS", OFF);
    rig.set("ARM_REQ", 1);
    rig.forget();
    let obeys = |rig: &mut Rig, status: Option<u8>| {
        rig.forget();
        for _ in 0..10 {
            if let Some(status) = status {
                arm(rig, status);
            }
            command(rig);
            rig.run_ms(20);
        }
        // Skips the pulse that was in progress when the gate closed.
        rig.pulses.iter().any(|pulse| pulse.start + 50 * MS > rig.now())
    };
    assert!(!obeys(&mut rig, None), "without an ArmingStatus the vehicle is not armed");
    assert_eq!(rig.next_status().1 & DISARMED, DISARMED);
    assert!(!obeys(&mut rig, Some(0)));
    assert!(obeys(&mut rig, Some(ARMED)));
    assert_eq!(rig.next_status().1 & DISARMED, 0);
    assert!(obeys(&mut rig, None), "the vehicle must count as armed for some seconds");
    assert!(!obeys(&mut rig, Some(0)));
    assert_eq!(rig.next_status().1 & DISARMED, DISARMED);
    // Only 255 is fully armed.
    for status in [1, 100, 254] {
        assert!(!obeys(&mut rig, Some(status)), "{status}");
    }
    // Without ARM_REQ the arming status has no effect.
    rig.set("ARM_REQ", 0);
    assert!(obeys(&mut rig, Some(0)));
    assert_eq!(rig.next_status().1 & DISARMED, 0);
}

#[test]
fn disarming_starts_the_failsafe() {
    for (mode, expected) in
        [(HOLD, Some(1750.0)), (TRIM, Some(1450.0)), (PULSE, Some(1900.0)), (OFF, None)]
    {
        let mut rig = moving(mode, 1000);
        arm(&mut rig, ARMED);
        rig.run_ms(5);
        rig.set("ARM_REQ", 1);
        for _ in 0..5 {
            command(&mut rig);
            rig.run_ms(20);
        }
        assert_eq!(rig.settled_pulse_us(), 1750.0);
        arm(&mut rig, 0);
        rig.run_ms(30);
        rig.forget();
        rig.run_ms(100);
        let widths: Vec<f64> = rig.pulses.iter().map(|pulse| pulse.width_us()).collect();
        assert_eq!(widths.first().copied(), expected, "mode {mode}");
    }
}

#[test]
fn a_vehicle_whose_arming_status_stops_counts_as_disarmed() {
    let mut rig = moving(OFF, 1000);
    rig.set("ARM_REQ", 1);
    // Twice a second, like ArduPilot.
    for n in 0..440u32 {
        if n % 25 == 0 && n < 200 {
            arm(&mut rig, ARMED);
        }
        command(&mut rig);
        rig.run_ms(20);
        if (30..=375).contains(&n) {
            assert!(rig.now() - rig.pulses.last().unwrap().start < 45 * MS, "armed at {n}");
        }
    }
    assert!(rig.now() - rig.pulses.last().unwrap().start > 100 * MS, "not armed");
    assert_eq!(rig.next_status().1 & DISARMED, DISARMED);
}

#[test]
fn a_pulse_held_by_the_failsafe_stays_within_a_reduced_travel() {
    let mut rig = Rig::running();
    rig.send_command(1, 4, 1950.0);
    assert_eq!(rig.settled_pulse_us(), 1950.0);
    rig.wait_for_line("FAILSAFE", 1100);
    assert_eq!(rig.settled_pulse_us(), 1950.0);
    rig.set("OUT1_MAX", 1700);
    assert_eq!(rig.settled_pulse_us(), 1700.0);
    rig.set("OUT1_MIN", 1600);
    rig.set("OUT1_MAX", 2000);
    assert_eq!(rig.settled_pulse_us(), 1700.0);
}
