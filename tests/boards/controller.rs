//! The node sets up the MCP2515, keeps the order of frames in both directions, and restarts the
//! MCP2515 after any fault.

use bench::board::WireEvent;
use bench::can::Fault;
use bench::mcp2515::Mode;
use rig::status::{CONTROLLER, FRAMES_LOST, WARNING};
use rig::{
    ARMING_STATUS, ARRAY_COMMAND, MS, NODE_STATUS, Program, Rig, SERVO_COMMAND, US, status_fields,
};

/// Register addresses (DS20001801J table 11-1).
const CNF1: u8 = 0x2A;
const CNF2: u8 = 0x29;
const CNF3: u8 = 0x28;
const CANCTRL: u8 = 0x0F;
const CANINTE: u8 = 0x2B;
const CANINTF: u8 = 0x2C;
const EFLG: u8 = 0x2D;
const TXB0CTRL: u8 = 0x30;

/// Bits of these registers.
const ABAT: u8 = 0x10;
const ERRIF: u8 = 0x20;
const MERRF: u8 = 0x80;
const RX0OVR: u8 = 0x40;
const RX1OVR: u8 = 0x80;

/// SPI instructions (DS20001801J table 12-1).
const WRITE: u8 = 0x02;
const BIT_MODIFY: u8 = 0x05;
const RESET: u8 = 0xC0;

#[test]
fn bit_timing_is_1_mbit_s_with_a_sample_point_of_75_percent() {
    let mut rig = Rig::running();
    let chip = rig.board().chip();
    let chip = chip.borrow();
    assert_eq!([chip.register(CNF1), chip.register(CNF2), chip.register(CNF3)], [0x00, 0x91, 0x01]);
    assert_eq!(chip.sample_point_permille(), 750);
    assert_eq!(chip.mode(), Mode::Normal);
}

/// The serial monitor logs each command that the node follows, in the order in which it read them.
/// It may follow only the newest of those that wait.
#[test]
fn frames_back_to_back_are_received_in_order() {
    let mut rig = Rig::running();
    for round in 0..40u8 {
        // Two frames fill both buffers. The others arrive while the node reads these.
        for n in 0..4 {
            rig.send(ARRAY_COMMAND | 10, &[1, 4, round, 0x64 + n, 0xC0 | ((round * 4 + n) % 32)]);
        }
        rig.run_ms(25);
    }
    let logged: Vec<u8> = rig
        .serial
        .lines()
        .filter_map(|line| line.strip_prefix("rx ArrayCommand from 10 tid "))
        .map(|rest| rest.split(':').next().unwrap().parse().unwrap())
        .collect();
    let mut sent = (0..160).map(|n| n % 32);
    for tid in &logged {
        assert!(sent.by_ref().take(4).any(|n| n == *tid), "{tid} out of order: {logged:?}");
    }
    let newest = logged.iter().filter(|&tid| tid % 4 == 3).count();
    assert_eq!(newest, 40, "{logged:?}");
}

/// INT falls late. Two frames of a type that one output keeps in one buffer.
#[test]
fn with_several_outputs_two_frames_of_each_type_have_room() {
    for outputs in [1, 2, 8] {
        let mut rig = Program::Full.running();
        rig.set("OUT_COUNT", outputs);
        rig.save();
        rig.restart();
        for (id, data) in [
            (ARMING_STATUS, &[0, 0xC0][..]),
            (SERVO_COMMAND, &[50, 0xC0]),
            (NODE_STATUS, &[1, 0, 0, 0, 0, 0, 0, 0xC0][..]),
        ] {
            rig.wait_for_supervision();
            rig.overflows_expected = outputs == 1;
            rig.board().set_stuck_int(Some(true));
            rig.send(id | 10, data);
            rig.send(id | 10, data);
            let bit = 1_000_000 * US / u64::from(rig::board().fastest_bit_rate());
            let end = rig.now() + 400 * bit;
            rig.run_until(end);
            let chip = rig.board().chip();
            let is_lost = chip.borrow().register(EFLG) & (RX0OVR | RX1OVR) != 0;
            assert_eq!(is_lost, outputs == 1, "{outputs} outputs, {id:08X}");
            rig.board().set_stuck_int(None);
            rig.run_ms(30);
        }
    }
}

/// INT falls late, so that two frames wait. A third may arrive while the node reads them.
#[test]
fn frames_that_waited_in_both_buffers_are_read_in_order() {
    for count in [2, 3] {
        let mut rig = Rig::running();
        rig.overflows_expected = true;
        let (mut complete, mut noticed) = (0, 0);
        for step in 0..100 {
            rig.forget();
            // Or else it may find that INT is wrong.
            rig.wait_for_supervision();
            rig.board().set_stuck_int(Some(true));
            for n in 0..count {
                rig.send(ARRAY_COMMAND | 10, &[1, 4, step as u8, 0x64 + n, 0xC0 | n]);
            }
            let moment = rig.now() + (150 + 2 * step) * US;
            rig.run_until(moment);
            rig.board().set_stuck_int(None);
            rig.run_ms(25);
            let logged: Vec<u8> = rig
                .serial
                .lines()
                .filter_map(|line| line.strip_prefix("rx ArrayCommand from 10 tid "))
                .map(|rest| rest.as_bytes()[0] - b'0')
                .collect();
            assert!(logged.is_sorted(), "{count}, after {} us: {logged:?}", 150 + 2 * step);
            // The node follows, and logs, only the newest of the commands that wait.
            complete += usize::from(logged.ends_with(&[count - 1]));
            // A supervision while INT is late trusts INT no more, as it should.
            if rig.serial.contains("INT open or shorted") {
                noticed += 1;
                rig = Rig::running();
                rig.overflows_expected = true;
            }
        }
        assert!(noticed <= 3, "{count}: {noticed}");
        // The buffers have no room for the third if INT falls after it.
        let least = if count == 2 { 100 } else { 51 };
        assert!(complete >= least, "{count}: {complete}");
    }
}

#[test]
fn messages_that_are_due_together_leave_in_order() {
    let mut rig = Rig::running();
    // Ten actuator.Status a second, and one Temperature, which is due with one of them. Another
    // node sends, too, so that several messages wait in the controller at once.
    rig.run_ms(500);
    rig.forget();
    for _ in 0..1000 {
        rig.send_status_from(1);
        rig.run_ms(10);
    }
    let sent: Vec<_> = rig
        .traffic
        .iter()
        .filter_map(|(at, frame)| {
            let text = frame.to_string();
            let is_telemetry = text.starts_with("1803F378");
            (is_telemetry || text.starts_with("18045678")).then_some((*at, is_telemetry))
        })
        .collect();
    let together: Vec<_> = sent.windows(2).filter(|pair| pair[1].0 - pair[0].0 < 2 * MS).collect();
    // actuator.Status has two frames, and the Temperature that was due with it follows them.
    let temperatures = sent.iter().filter(|(_, is_telemetry)| !is_telemetry).count();
    let after = together.iter().filter(|pair| pair[0].1 && !pair[1].1).count();
    let before = together.iter().filter(|pair| !pair[0].1 && pair[1].1).count();
    assert!(temperatures >= 9 && after >= temperatures - 1, "{after} of {temperatures}");
    assert_eq!(before, 0, "a Temperature left before the status that was due with it");
}

#[test]
fn a_silent_chip_is_logged_and_started_when_it_answers() {
    for floating in [0x00, 0xFF] {
        let mut rig = Rig::powered();
        rig.board().chip_power_off(floating);
        rig.run_ms(3000);
        let cs = &rig::board().cs;
        let line = format!("CS {cs} SI SO SCK 5V? ({floating})");
        let logged = rig.serial.lines().filter(|logged| *logged == line).count();
        assert!((3..=4).contains(&logged), "ten attempts a second, one told: {}", rig.serial);
        assert_eq!(rig.pulses, []);
        rig.board().chip_power_on();
        rig.wait_for_line("CAN: running", 300);
        rig.wait_for("a status", 600, |rig| !rig.statuses().is_empty());
        let (_, _, _, vendor_code) = status_fields(&rig.statuses()[0].1);
        assert_eq!(vendor_code, CONTROLLER);
        rig.send_command(1, 0, 0.0);
        assert_eq!(rig.settled_pulse_us(), 1500.0);
    }
}

#[test]
fn a_chip_reset_by_a_glitch_is_detected_and_restarted() {
    let mut rig = Rig::running();
    rig.send_command(1, 0, 0.5);
    rig.settled_pulse_us();
    // The driver does not know yet that the chip was reset, so the model reports its accesses.
    rig.violations_expected = true;
    rig.board().chip_reset();
    rig.wait_for_line("5V? MCP2515 settings lost", 50);
    wait_for_normal_mode(&mut rig, 200);
    rig.wait_for_line("CAN: running", SECOND_MS);
    rig.run_ms(50);
    assert!(
        rig.pulses.iter().all(|pulse| pulse.width_us() == 1750.0),
        "the servo must hold its position"
    );
    rig.send_command(1, 0, -0.5);
    assert_eq!(rig.settled_pulse_us(), 1250.0);
}

#[test]
fn a_chip_that_stops_answering_is_detected_and_restarted() {
    let mut rig = Rig::running();
    rig.board().chip_power_off(0xFF);
    // It has told in this second that the settings are lost.
    rig.wait_for_line("SI SO SCK 5V? (255)", 400 + SECOND_MS);
    rig.board().chip_power_on();
    wait_for_normal_mode(&mut rig, 400);
    rig.send_command(1, 0, 0.0);
    assert_eq!(rig.settled_pulse_us(), 1500.0);
}

#[test]
fn a_bus_held_dominant_is_logged_and_the_node_recovers() {
    let mut rig = Rig::powered();
    rig.bench.bus().inject(Fault::StuckDominant(true));
    rig.run_ms(1000);
    assert!(rig.serial.contains("CAN H/L: never idle (128)"), "{}", rig.serial);
    rig.bench.bus().inject(Fault::StuckDominant(false));
    rig.wait_for_line("CAN: running", 400);
    rig.wait_for("a status", 600, |rig| !rig.statuses().is_empty());
}

#[test]
fn bus_off_is_logged_and_the_node_recovers() {
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
fn noise_on_the_bus_never_causes_a_wrong_pulse() {
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
fn the_node_recovers_from_noise_on_the_spi() {
    let mut rig = Rig::running();
    // Flipped bits turn instructions into illegal ones, so the model reports many violations.
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
fn frames_that_nobody_acknowledges_are_dropped_after_a_second() {
    let mut rig = Rig::running();
    let port = rig.bench.port(0);
    rig.bench.bus().connect(port, false);
    rig.wait_for_line("CAN H/L: not sent (1)", 2600);
    let chip = rig.board().chip();
    rig.run_ms(30);
    let waiting = (0..3).any(|n| chip.borrow().register(TXB0CTRL + 16 * n) & 0x08 != 0);
    assert!(!waiting || rig.serial.matches("not sent").count() == 1);
}

#[test]
fn receive_overflows_are_counted_and_reported_in_the_status() {
    let mut rig = Rig::running();
    rig.overflows_expected = true;
    let lost = rig.lose_frames();
    assert!(lost > 5, "only {lost} frames lost: too few for this test");
    rig.run_ms(1100);
    let (_, health, _, vendor_code) = status_fields(&rig.statuses().last().unwrap().1);
    assert_eq!((health, vendor_code), (WARNING, FRAMES_LOST));
    rig.board().avr_mut().serial_send(b"?");
    rig.wait_for_line("overruns", 300);
    assert!(!rig.serial.contains("overruns 0"), "{}", rig.serial);
}

/// Time from the chip select of the first status read to the end of the instruction that reads the
/// frame and clears RXnIF.
#[test]
fn a_frame_is_read_within_450_cycles_of_the_first_chip_select() {
    let mut rig = Rig::running();
    rig.board().attach_probe();
    for n in 0..20u8 {
        rig.send(ARRAY_COMMAND | 10, &[1, 0, 0, n, 0, 0, 0, 0xC0 | n]);
        rig.run_ms(3);
        let events = rig.board().take_wire_events();
        let at_read = |event: &(_, WireEvent)| {
            matches!(
                event.1,
                WireEvent::Spi { byte, .. } if byte.mosi == 0x90
            )
        };
        let read = events.iter().position(at_read).expect("READ RX BUFFER");
        let edges = |level| move |event: &&(_, WireEvent)| event.1 == WireEvent::Cs(level);
        let (begun, _) =
            events[..read].iter().rev().filter(edges(false)).nth(1).expect("READ STATUS before");
        let (done, _) = events[read..].iter().find(edges(true)).expect("the end");
        assert!(done - begun <= 450, "{} cycles", done - begun);
    }
}

/// Accesses the chip over the SPI while the program does not use it.
fn access_chip(rig: &mut Rig, instructions: &[&[u8]]) {
    let end = rig.now() + MS;
    let cs = rig.board().wiring().cs;
    while !rig.board().pin(cs) {
        assert!(rig.now() < end, "CS stays low");
        let next = rig.now() + 1;
        rig.bench.run_until(next);
    }
    let (chip, at) = (rig.board().chip(), rig.board().now());
    let mut chip = chip.borrow_mut();
    for instruction in instructions {
        chip.select(at);
        for &byte in *instruction {
            chip.end_byte(byte, at);
        }
        chip.deselect(at);
    }
}

/// The monitor tells a condition, or that the controller runs, once in a second.
const SECOND_MS: u64 = 1000;

#[track_caller]
fn wait_for_normal_mode(rig: &mut Rig, ms: u64) {
    let chip = rig.board().chip();
    rig.wait_for("normal mode", ms, |_| chip.borrow().mode() == Mode::Normal);
}

/// Checks the recovery after a register changed. The firmware compares all readable registers every
/// 10 ms.
#[track_caller]
fn assert_restarted_within_100_ms(rig: &mut Rig) {
    rig.forget();
    rig.wait_for_line("5V? MCP2515 settings lost", 100 + SECOND_MS);
    wait_for_normal_mode(rig, 200);
    let chip = rig.board().chip();
    assert_eq!(
        [CNF1, CNF2, CNF3].map(|address| chip.borrow().register(address)),
        [0x00, 0x91, 0x01]
    );
    assert_eq!((chip.borrow().mode(), chip.borrow().register(CANINTE)), (Mode::Normal, 0x03));
    rig.send_command(1, 0, 0.25);
    assert_eq!(rig.settled_pulse_us(), 1625.0);
}

#[test]
fn a_changed_bit_timing_is_detected_and_corrected() {
    for (address, value) in [(CNF1, 0x01), (CNF2, 0x99), (CNF3, 0x02)] {
        let mut rig = Rig::running();
        access_chip(
            &mut rig,
            &[&[WRITE, CANCTRL, 0x80], &[WRITE, address, value], &[WRITE, CANCTRL, 0x00]],
        );
        assert_restarted_within_100_ms(&mut rig);
    }
}

#[test]
fn a_changed_mode_is_detected_and_corrected() {
    // Sleep, loopback, listen-only and configuration mode, and one-shot, which is a bit of CANCTRL
    // besides the mode.
    for control in [0x20, 0x40, 0x60, 0x80, 0x08] {
        let mut rig = Rig::running();
        access_chip(&mut rig, &[&[WRITE, CANCTRL, control]]);
        assert_restarted_within_100_ms(&mut rig);
    }
}

/// An enabled error interrupt whose flag is never cleared would hold INT low for ever, as if a
/// frame waited.
#[test]
fn errors_on_the_bus_never_hold_the_int_pin_low() {
    let mut rig = Rig::running();
    rig.bench.bus().inject(Fault::BitErrorRate { per_million: 5000, seed: 3 });
    for _ in 0..100 {
        rig.send_status_from(1);
        rig.run_ms(10);
    }
    rig.bench.bus().inject(Fault::BitErrorRate { per_million: 0, seed: 3 });
    rig.run_ms(30);
    let chip = rig.board().chip();
    assert!(
        rig.error_frames > 20 && chip.borrow().register(CANINTF) & (MERRF | ERRIF) != 0,
        "the errors must set their flags"
    );
    assert!(chip.borrow().int_pin(), "INT must be high");
    // Enables that changed by themselves must not hold INT low either.
    access_chip(&mut rig, &[&[WRITE, CANINTE, 0xFF]]);
    assert_restarted_within_100_ms(&mut rig);
    assert!(chip.borrow().int_pin());
}

/// The edge may come while the program waits for the interrupt, or while it polls the line.
#[test]
#[ignore = "takes long: make test-all"]
fn an_int_line_that_falls_at_any_moment_and_stays_low_does_not_stop_the_program() {
    for n in 0..20 {
        let mut rig = Rig::running();
        rig.send_command(1, 0, 0.25);
        let moment = rig.now() + MS + n * 37 * US;
        rig.run_until(moment);
        rig.board().set_stuck_int(Some(false));
        rig.run_ms(300);
        rig.board().set_stuck_int(None);
        rig.run_ms(200);
        assert!(!rig.serial.contains("reset:"), "at moment {n}\n{}", rig.serial);
        assert!(rig.serial.contains("INT open or shorted"), "{}", rig.serial);
        rig.send_command(1, 0, 0.5);
        assert_eq!(rig.settled_pulse_us(), 1750.0, "at moment {n}");
    }
}

/// RXnOVR stays set until the program clears it, and would hide the next overflow.
#[test]
fn overflow_flags_are_cleared_and_each_overflow_is_logged() {
    let mut rig = Rig::running();
    let chip = rig.board().chip();
    for flags in [RX0OVR, RX1OVR, RX0OVR | RX1OVR] {
        rig.forget();
        access_chip(&mut rig, &[&[BIT_MODIFY, EFLG, flags, flags]]);
        assert_eq!(chip.borrow().register(EFLG), flags);
        rig.wait_for("the cleared flags", 30, |_| chip.borrow().register(EFLG) == 0);
        rig.board().avr_mut().serial_send(b"?");
        rig.wait_for_line("overruns", 300);
    }
    assert!(rig.serial.contains("overruns 3"), "{}", rig.serial);
}

/// While ABAT is set, the chip aborts every request to send.
#[test]
fn after_dropped_frames_the_node_sends_again() {
    let mut rig = Rig::running();
    let port = rig.bench.port(0);
    rig.bench.bus().connect(port, false);
    rig.wait_for_line("not sent", 2600);
    rig.run_ms(50);
    let chip = rig.board().chip();
    assert_eq!(chip.borrow().register(CANCTRL) & ABAT, 0);
    rig.bench.bus().connect(port, true);
    rig.forget();
    rig.run_ms(2200);
    assert!(rig.statuses().len() >= 2, "{}", rig.serial);
}

/// DS20001801J 8.1: after power-on and after a reset the chip ignores the SPI for 128 periods of
/// its 16 MHz oscillator.
#[test]
fn the_node_does_not_access_the_chip_for_128_oscillator_periods_after_a_reset() {
    let mut rig = Rig::powered();
    rig.board().attach_probe();
    let begun = rig.now();
    rig.run_ms(150);
    // After a glitch resets the chip, the program resets it by the instruction.
    rig.board().chip_reset();
    rig.run_ms(300);
    let events = rig.board().take_wire_events();
    let mut instructions: Vec<(u64, u8)> = Vec::new();
    let mut selected = false;
    for (at, event) in events {
        match event {
            WireEvent::Cs(level) => selected = !level,
            WireEvent::Spi { byte, .. } if std::mem::take(&mut selected) => {
                instructions.push((at, byte.mosi))
            }
            _ => {}
        }
    }
    assert!(
        instructions[0].0 - begun >= 128,
        "the first one after {} cycles",
        instructions[0].0 - begun
    );
    let resets = instructions.windows(2).filter(|pair| pair[0].1 == RESET);
    let pauses: Vec<u64> = resets.map(|pair| pair[1].0 - pair[0].0).collect();
    assert!(pauses.len() >= 2 && pauses.iter().all(|pause| *pause >= 128 + 16), "{pauses:?}");
}
