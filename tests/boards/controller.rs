//! The node keeps the order of frames in both directions, and loses and drops none in silence.
//! `chip_faults.rs` and `bus_faults.rs` have the restarts of the MCP2515 after faults.

use bench::can::Fault;
use bench::mcp2515::Mode;
use rig::status::{CONTROLLER, FRAMES_LOST, WARNING};
use rig::{
    ARMING_STATUS, ARRAY_COMMAND, MS, NODE_STATUS, Program, Rig, SERVO_COMMAND, US, status_fields,
};

/// Register addresses (DS20001801J table 11-1).
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

/// Sends the chip an instruction over the SPI while the program does not use it.
fn access_chip(rig: &mut Rig, instruction: &[u8]) {
    let end = rig.now() + MS;
    let cs = rig.board().wiring().cs;
    while !rig.board().pin(cs) {
        assert!(rig.now() < end, "CS stays low");
        let next = rig.now() + 1;
        rig.bench.run_until(next);
    }
    let (chip, at) = (rig.board().chip(), rig.board().now());
    let mut chip = chip.borrow_mut();
    chip.select(at);
    for &byte in instruction {
        chip.end_byte(byte, at);
    }
    chip.deselect(at);
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
    // Enables that changed by themselves must not hold INT low either. The firmware compares all
    // readable registers every 10 ms, and the monitor tells a condition once in a second.
    access_chip(&mut rig, &[WRITE, CANINTE, 0xFF]);
    rig.forget();
    rig.wait_for_line("5V? MCP2515 settings lost", 1100);
    rig.wait_for("normal mode", 200, |_| chip.borrow().mode() == Mode::Normal);
    assert_eq!((chip.borrow().register(CANINTE), chip.borrow().sample_point_permille()), (3, 750));
    assert!(chip.borrow().int_pin());
    rig.send_command(1, 0, 0.25);
    assert_eq!(rig.settled_pulse_us(), 1625.0);
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
        access_chip(&mut rig, &[BIT_MODIFY, EFLG, flags, flags]);
        assert_eq!(chip.borrow().register(EFLG), flags);
        rig.wait_for("the cleared flags", 30, |_| chip.borrow().register(EFLG) == 0);
        rig.board().avr_mut().serial_send(b"?");
        rig.wait_for_line("overruns", 300);
    }
    assert!(rig.serial.contains("overruns 3, given up 0"), "{}", rig.serial);
}

/// Frames that nobody acknowledges are dropped after a second. While ABAT is set, the chip aborts
/// every request to send.
#[test]
fn after_dropped_frames_the_node_sends_again() {
    let mut rig = Rig::running();
    rig.connect_node(false);
    rig.wait_for_line("CAN H/L: not sent (1)", 2600);
    rig.run_ms(50);
    let chip = rig.board().chip();
    let waiting = (0..3).any(|n| chip.borrow().register(TXB0CTRL + 16 * n) & 0x08 != 0);
    assert!(!waiting || rig.serial.matches("not sent").count() == 1);
    assert_eq!(chip.borrow().register(CANCTRL) & ABAT, 0);
    rig.connect_node(true);
    rig.forget();
    rig.run_ms(2200);
    assert!(rig.statuses().len() >= 2, "{}", rig.serial);
}
