//! The MCP2515 is set up right, keeps frames in order both ways, and is brought back whatever happens to it.

mod rig;

use rig::status::{CONTROLLER_LOST, FRAMES_LOST, WARNING};
use rig::{ARRAY_COMMAND, MS, NODE_STATUS, Rig, status_fields};
use sim::board::WireEvent;
use sim::can::Fault;
use sim::mcp2515::Mode;

/// Addresses of DS20001801J table 11-1.
const CNF1: u8 = 0x2A;
const CNF2: u8 = 0x29;
const CNF3: u8 = 0x28;
const TXB0CTRL: u8 = 0x30;

#[test]
fn bit_timing_is_1_mbit_s_with_a_sample_point_of_75_percent() {
    let mut rig = Rig::running();
    let chip = rig.board().chip();
    let chip = chip.borrow();
    assert_eq!([chip.register(CNF1), chip.register(CNF2), chip.register(CNF3)], [0x00, 0x91, 0x01]);
    assert_eq!(chip.sample_point_permille(), 750);
    assert_eq!(chip.mode(), Mode::Normal);
}

/// The serial monitor tells every accepted frame in the order in which it was read.
#[test]
fn frames_back_to_back_are_received_in_order() {
    let mut rig = Rig::running();
    for round in 0..40u8 {
        // Two frames fill both buffers, and the others follow while they are read.
        for n in 0..4 {
            rig.send(0x1003_F20A, &[1, 4, 0, 0x64 + n, 0xC0 | ((round * 4 + n) % 32)]);
        }
        rig.run_ms(25);
    }
    let told: Vec<u8> = rig
        .serial
        .lines()
        .filter_map(|line| line.strip_prefix("rx ArrayCommand from 10 tid "))
        .map(|rest| rest.split(':').next().unwrap().parse().unwrap())
        .collect();
    let expected: Vec<u8> = (0..160).map(|n| n % 32).collect();
    assert_eq!(told, expected);
}

#[test]
fn messages_that_are_due_together_leave_in_order() {
    let mut rig = Rig::running();
    rig.send_servo_command(0);
    rig.run_ms(5);
    let mut seen = 0;
    for n in 0..30 {
        rig.send_status_from(1);
        rig.run_ms(1000);
        // The bus is held by others when the messages fall due, so that several wait in the controller at once.
        if n % 3 == 2 {
            let at = rig.traffic.iter().rposition(|(_, frame)| frame.to_string().starts_with("18045878")).unwrap();
            let (degrees_at, _) = rig.traffic[at];
            let statuses = rig.statuses();
            let (status_at, _) = statuses.iter().rfind(|(at, _)| *at < degrees_at).unwrap();
            assert!(degrees_at - status_at < 2 * MS, "the status of the same occasion left first");
            seen += 1;
        }
    }
    assert_eq!(seen, 10);
}

#[test]
fn a_chip_that_does_not_answer_is_told_of_and_taken_on_when_it_does() {
    for floating in [0x00, 0xFF] {
        let mut rig = Rig::powered();
        rig.board().chip_power_off(floating);
        rig.run_ms(1000);
        let line = format!("CAN: MCP2515 does not answer (CANSTAT {floating:02X}), trying again");
        let told = rig.serial.lines().filter(|told| *told == line).count();
        assert!((5..=11).contains(&told), "about ten tries a second, each told: {}", rig.serial);
        assert_eq!(rig.pulses, []);
        rig.board().chip_power_on();
        rig.wait_for_line("CAN: running", 300);
        rig.wait_for("a status", 600, |rig| !rig.statuses().is_empty());
        let (_, _, _, vendor_code) = status_fields(&rig.statuses()[0].1);
        assert_eq!(vendor_code, CONTROLLER_LOST);
        rig.send_command(1, 0, 0.0);
        assert_eq!(rig.settled_pulse_us(), 1500.0);
    }
}

#[test]
fn a_chip_that_was_reset_by_a_glitch_is_noticed_and_set_up_again() {
    let mut rig = Rig::running();
    rig.send_command(1, 0, 0.5);
    rig.settled_pulse_us();
    rig.board().chip_reset();
    rig.wait_for_line("CAN: MCP2515 lost its configuration (CANSTAT 80), starting it over", 50);
    rig.wait_for_line("CAN: running", 200);
    rig.run_ms(50);
    assert!(rig.pulses.iter().all(|pulse| pulse.width_us() == 1750.0), "the servo holds meanwhile");
    rig.send_command(1, 0, -0.5);
    assert_eq!(rig.settled_pulse_us(), 1250.0);
}

#[test]
fn a_chip_that_dies_while_running_is_noticed_and_taken_on_again() {
    let mut rig = Rig::running();
    rig.board().chip_power_off(0xFF);
    rig.wait_for_line("CAN: MCP2515 does not answer (CANSTAT FF)", 400);
    rig.board().chip_power_on();
    rig.wait_for_line("CAN: running", 400);
    rig.send_command(1, 0, 0.0);
    assert_eq!(rig.settled_pulse_us(), 1500.0);
}

#[test]
fn a_bus_that_is_held_dominant_is_told_of_and_survived() {
    let mut rig = Rig::powered();
    rig.bench.bus().inject(Fault::StuckDominant(true));
    rig.run_ms(1000);
    assert!(rig.serial.contains("CAN: bus never idle, MCP2515 not on it (CANSTAT 80), trying again"), "{}", rig.serial);
    rig.bench.bus().inject(Fault::StuckDominant(false));
    rig.wait_for_line("CAN: running", 400);
    rig.wait_for("a status", 600, |rig| !rig.statuses().is_empty());
}

#[test]
fn bus_off_is_told_of_and_the_node_comes_back() {
    let mut rig = Rig::running();
    rig.bench.bus().inject(Fault::BitErrorRate { per_million: 60_000, seed: 1 });
    rig.run_ms(4000);
    rig.bench.bus().inject(Fault::BitErrorRate { per_million: 0, seed: 1 });
    rig.forget();
    rig.run_ms(2500);
    assert!(rig.statuses().len() >= 2, "{}", rig.serial);
    rig.send_command(1, 0, 0.0);
    assert_eq!(rig.settled_pulse_us(), 1500.0);
}

#[test]
fn noise_on_the_bus_never_moves_the_servo_wrongly() {
    let mut rig = Rig::running();
    rig.bench.bus().inject(Fault::BitErrorRate { per_million: 2_000, seed: 7 });
    for n in 0..500u16 {
        rig.send_command(1, 4, if n % 2 == 0 { 1200.0 } else { 1800.0 });
        rig.run_ms(10);
    }
    assert!(rig.error_frames > 50, "{} errors are too few to prove anything", rig.error_frames);
    assert!(rig.pulses.iter().all(|pulse| [1200.0, 1800.0].contains(&pulse.width_us())));
}

#[test]
fn noise_on_the_spi_is_survived() {
    let mut rig = Rig::running();
    // Flipped bits make any nonsense of the instructions, so the model has much to complain of.
    rig.violations_expected = true;
    rig.overflows_expected = true;
    rig.board().set_spi_noise(200, 3);
    for _ in 0..100 {
        rig.send_command(1, 0, 0.0);
        rig.send_status_from(1);
        rig.run_ms(40);
    }
    rig.board().set_spi_noise(0, 3);
    rig.run_ms(1500);
    rig.forget();
    rig.send_command(1, 0, 0.25);
    assert_eq!(rig.settled_pulse_us(), 1625.0);
    rig.run_ms(1100);
    assert!(!rig.statuses().is_empty());
    assert_eq!(rig.board().avr().resets().len(), 1, "only the power-on");
}

#[test]
fn frames_that_nobody_acknowledges_are_given_up_after_a_second() {
    let mut rig = Rig::running();
    let port = rig.bench.port(0);
    rig.bench.bus().connect(port, false);
    rig.wait_for_line("CAN: nothing could be sent for 1 s, frames given up (1 times)", 2600);
    let chip = rig.board().chip();
    rig.run_ms(30);
    let waiting = (0..3).any(|n| chip.borrow().register(TXB0CTRL + 16 * n) & 0x08 != 0);
    assert!(!waiting || rig.serial.matches("given up").count() == 1);
}

#[test]
fn a_burst_of_frames_that_cannot_be_followed_is_counted_and_shown_in_the_status() {
    let mut rig = Rig::running();
    rig.overflows_expected = true;
    // Statuses have the second buffer alone, and these are broken ones without a byte: 64 us each, back to back.
    for _ in 0..2000 {
        rig.send(NODE_STATUS | 1, &[]);
    }
    rig.run_ms(1100);
    let lost = rig.board().chip().borrow().rx_overflows();
    assert!(lost > 5, "only {lost} frames lost: the test asks too little");
    let (_, health, _, vendor_code) = status_fields(&rig.statuses().last().unwrap().1);
    assert_eq!((health, vendor_code), (WARNING, FRAMES_LOST));
    rig.board().avr_mut().serial_send(b"?");
    rig.wait_for_line("receive overruns", 300);
    assert!(!rig.serial.contains("receive overruns 0"), "{}", rig.serial);
}

/// From CS low for the first look to CS high behind the frame, which clears RXnIF.
#[test]
fn a_frame_is_out_of_the_controller_within_450_cycles_of_the_first_chip_select() {
    let mut rig = Rig::running();
    rig.board().attach_probe();
    for n in 0..20u8 {
        rig.send(ARRAY_COMMAND | 10, &[1, 0, 0, n, 0, 0, 0, 0xC0 | n]);
        rig.run_ms(3);
        let events = rig.board().take_wire_events();
        let at_read = |event: &(_, WireEvent)| matches!(event.1, WireEvent::Spi { byte, .. } if byte.mosi == 0x90);
        let read = events.iter().position(at_read).expect("READ RX BUFFER");
        let edges = |level| move |event: &&(_, WireEvent)| event.1 == WireEvent::Cs(level);
        let (begun, _) = events[..read].iter().rev().filter(edges(false)).nth(1).expect("READ STATUS before");
        let (done, _) = events[read..].iter().find(edges(true)).expect("the end");
        assert!(done - begun <= 450, "{} cycles", done - begun);
    }
}
