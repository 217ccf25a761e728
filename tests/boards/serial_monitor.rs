//! The serial monitor logs events at 115200 baud, and never delays the node.

use bench::can::Frame;
use bench::dronecan::{Message, Opcode, ParameterRequest};
use rig::{MS, Rig, corner};

#[test]
fn the_banner_has_version_node_id_and_reset_cause() {
    let mut rig = Rig::powered();
    rig.wait_for_line("CAN: running", 100);
    let mut lines = rig.serial.lines();
    let version = env!("CARGO_PKG_VERSION");
    assert_eq!(
        lines.next().unwrap(),
        format!("DroneCAN servo node {version}, node ID 120, reset: power-on")
    );
    assert_eq!(lines.next().unwrap(), "CAN: running");
}

#[test]
fn the_preset_without_a_serial_monitor_works_and_sends_no_line() {
    let mut rig = Rig::with_features("remote");
    rig.wait_until_up();
    rig.send_command(1, 0, 0.5);
    assert_eq!((rig.settled_pulse_us(), &rig.serial[..]), (1750.0, ""));
}

#[test]
fn many_rejected_frames_drop_no_other_line() {
    let mut rig = Rig::running();
    rig.send_command(1, 0, 0.5);
    rig.run_ms(100);
    rig.overflows_expected = true;
    // A middle frame of a transfer that has no start, with the node's own ID.
    let refused = Frame::extended(rig::ARRAY_COMMAND | rig::NODE, &[0xA5; 8]);
    rig.peer.borrow_mut().babble(Some(refused));
    rig.wait_for_line("FAILSAFE: no commands", 1200);
    assert!(
        rig.serial.contains("refused") && rig.serial.contains("lines dropped"),
        "{}",
        rig.serial
    );
}

#[test]
fn each_command_and_status_is_logged() {
    let mut rig = Rig::running();
    rig.send_status_from(1);
    // Of commands that come while one is being followed the newest is followed.
    for (id, kind, value) in [(1, 0, 0.5), (1, 1, -0.5), (1, 4, 1234.0), (7, 4, 1234.0)] {
        rig.send_command(id, kind, value);
        rig.run_ms(2);
    }
    // A status can use one buffer only, in which a command may still wait.
    rig.run_ms(2);
    rig.send_servo_command(90);
    rig.run_ms(100);
    for line in [
        "rx NodeStatus from 1 tid 0: up 10 s, OK",
        "rx ArrayCommand from 10 tid 0: id 1, pulse 1750.0 us",
        "rx ArrayCommand from 10 tid 1: id 1, pulse 1181.5 us",
        "rx ArrayCommand from 10 tid 2: id 1, pulse 1234.0 us",
        "rx thesis.ServoCommand from 1 tid 4: 90, pulse 1353.0 us",
    ] {
        assert!(
            rig.serial.lines().any(|logged| logged == line),
            "{line:?} is missing in\n{}",
            rig.serial
        );
    }
}

/// Each after a line with another number.
#[test]
fn each_request_is_logged_with_the_number_of_its_service() {
    let mut rig = Rig::running();
    let read = Message::ParameterRequest(ParameterRequest::default());
    let save = Message::ExecuteOpcode(Opcode::SAVE);
    for (service, request) in [(1, Message::NodeInfoRequest), (11, read), (10, save)] {
        rig.send_status_from(1);
        rig.run_ms(50);
        rig.request(&request);
        rig.wait_for_line(&format!("rx request {service} from 127"), 100);
    }
}

#[test]
fn bytes_come_at_115200_baud_without_gaps() {
    let mut rig = Rig::powered();
    rig.bench.run_until((50 + corner().start_ms()) * MS);
    let bytes = rig.board().avr_mut().serial_take();
    assert!(bytes.len() > 60);
    // A byte has ten bits of 136 cycles: 117,647 baud, 2.1 % fast, like the Arduino core.
    let gaps: Vec<u64> = bytes.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    let byte = (1360.0 / corner().clock_rate()) as u64;
    assert_eq!(gaps.iter().min(), Some(&byte));
    // The line is idle for 1.5 ms in all, mostly while the node reads both copies of the parameters
    // from the EEPROM, and for less than a byte in a long turn. With all features there are more.
    let idle: u64 = gaps[..55].iter().map(|gap| gap - byte).sum();
    let most = if rig::has_all_features() { 28_000 } else { 24_000 };
    assert!(idle < most, "idle for {idle} cycles: {gaps:?}");
}

#[test]
fn lines_that_do_not_fit_are_dropped_and_counted_and_delay_no_frame() {
    let mut rig = Rig::running();
    // Sends five times as many lines as the line can carry, for a second.
    for n in 0..1000u16 {
        rig.send_command(1, 4, f32::from(1000 + n));
        let next = rig.now() + MS;
        rig.run_until(next);
    }
    rig.run_ms(300);
    let lines = rig.serial.matches("rx ArrayCommand").count();
    let dropped: usize = rig
        .serial
        .lines()
        .filter_map(|line| line.strip_suffix(" lines dropped")?.parse::<usize>().ok())
        .sum();
    assert!(dropped > 500);
    // Some temperatures are logged besides the commands.
    assert!((1000..=1003).contains(&(lines + dropped)), "{lines} logged and {dropped} dropped");
    assert_eq!(rig.pulses.last().unwrap().width_us(), 1999.0);
}
