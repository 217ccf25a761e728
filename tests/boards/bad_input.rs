//! Invalid frames and transfers do not move the servo. The node counts them, and still answers.

use bench::can::{Frame, Id};
use rig::{ARRAY_COMMAND, NODE_STATUS, Rig, SERVO_COMMAND, array_command};

#[track_caller]
fn assert_rejects(mut rig: Rig, frames: usize, line: &str) {
    assert_eq!(rig.settled_pulse_us(), 1750.0);
    rig.run_ms(300);
    assert_eq!(rig.serial.matches(line).count(), frames, "{}", rig.serial);
    rig.board().avr_mut().serial_send(b"?");
    rig.wait_for_line(&format!("commands followed 1, frames refused {frames}"), 100);
    // The node still follows commands.
    rig.send_command(1, 0, -1.0);
    assert_eq!(rig.settled_pulse_us(), 1000.0);
}

/// Frames, the number of lines that tell so, and the line.
#[test]
fn invalid_frames_are_rejected() {
    let command = Id::Extended(ARRAY_COMMAND | 10);
    let all = |id: u32, data: &[&[u8]]| -> Vec<Frame> {
        data.iter().map(|data| Frame::extended(id, data)).collect()
    };
    let of_lengths = [1, 2, 3, 5, 6, 7].map(|len| {
        let mut data = [1, 0, 0, 0, 0, 0, 0, 0];
        data[len] = 0xC0;
        Frame::extended(ARRAY_COMMAND | 10, &data[..=len])
    });
    // A DLC above 8 means 8 bytes.
    let long = (9..=15).map(|dlc| Frame::with_dlc(command, dlc, [1, 0, 0, 0, 0, 0, 0, 0xC0]));
    // long_commands.rs tests complete transfers of several frames. Only the last of these can
    // belong to no transfer at all: it is a start of transfer with the toggle bit set.
    let pieces = [0x00, 0x20, 0x40, 0x60, 0xE0]
        .map(|tail| Frame::extended(ARRAY_COMMAND | 10, &[1, 0, 0, 0, tail]));
    let remote = [(ARRAY_COMMAND | 10, 5), (NODE_STATUS | 1, 8)]
        .map(|(id, dlc)| Frame::remote(Id::Extended(id), dlc));
    let of_wrong_senders = [
        (ARRAY_COMMAND, &[1, 0, 0, 0, 0xC0][..]),
        (ARRAY_COMMAND | 120, &[1, 0, 0, 0, 0xC0]),
        (SERVO_COMMAND, &[0, 0xC0]),
        (NODE_STATUS | 120, &[0, 0, 0, 0, 0, 0, 0, 0xC0]),
    ]
    .map(|(id, data)| Frame::extended(id, data));
    for (frames, lines, line) in [
        (of_lengths.to_vec(), 6, "refused: type 1010 from 10 tid 0, wrong length"),
        (long.collect(), 7, "refused: type 1010 from 10 tid 0, wrong length"),
        (all(ARRAY_COMMAND | 10, &[&[]]), 1, "refused: type 1010 from 10, malformed"),
        (pieces.to_vec(), 1, "refused: type 1010 from 10"),
        (of_wrong_senders.to_vec(), 4, "wrong sender"),
        (remote.to_vec(), 2, "refused: unknown type"),
        (
            all(NODE_STATUS | 1, &[&[0, 0, 0, 0, 0, 0, 0xC0], &[0xC0]]),
            2,
            "refused: type 341 from 1 tid 0, wrong length",
        ),
        (
            all(SERVO_COMMAND | 1, &[&[0xC0], &[0, 0, 0xC0]]),
            2,
            "refused: type 1111 from 1 tid 0, wrong length",
        ),
    ] {
        let mut rig = Rig::positioned();
        for frame in frames {
            rig.send_frame(frame);
            rig.run_ms(10);
        }
        assert_rejects(rig, lines, line);
    }
}

#[test]
fn an_incomplete_command_is_dropped_and_logged_after_50_ms() {
    after_an_incomplete_command(100);
}

/// When the node's 16-bit clock has wrapped.
#[test]
#[ignore = "takes long: make test-all"]
fn the_rest_of_a_command_does_not_complete_it_a_minute_later() {
    after_an_incomplete_command(65_536 + 100);
}

/// The remaining frames of a command come after this time.
fn after_an_incomplete_command(ms: u64) {
    let mut rig = Rig::positioned();
    rig.set("OUT1_TIMEOUT", 0);
    let frames = array_command(&[(1, 0, -1.0), (2, 0, 0.0), (3, 0, 0.0)], 7);
    rig.send(ARRAY_COMMAND | 10, &frames[0]);
    rig.run_ms(45);
    assert!(!rig.serial.contains("broken"), "{}", rig.serial);
    rig.wait_for_line("refused: type 1010 from 10, broken", 10);
    rig.run_ms(ms);
    for data in &frames[1..] {
        rig.send(ARRAY_COMMAND | 10, data);
    }
    assert_rejects(rig, 1, "refused: type 1010 from 10, broken");
}

#[test]
fn standard_frames_do_not_pass_the_filters() {
    let mut rig = Rig::positioned();
    for id in 0..0x800 {
        rig.send_frame(Frame::standard(id, &[1, 0, 0, 0, 0xC0]));
    }
    rig.run_ms(300);
    assert_rejects(rig, 0, "refused");
}

#[test]
fn a_bus_full_of_frames_for_others_does_not_disturb_the_node() {
    let mut rig = Rig::positioned();
    // The failsafe would restart the controller, which acknowledges nothing while it restarts.
    rig.set("OUT1_TIMEOUT", 0);
    let autopilot = [10, 0, 0, 0, 0, 0, 0, 0xC0];
    for _ in 0..2 {
        rig.send(NODE_STATUS | 10, &autopilot);
        rig.run_ms(600);
    }
    // The first frame that passes makes the node write narrower filters after the autopilot's next
    // message. For that the controller leaves the bus.
    rig.send(0x1804_562A, &[0xA5; 8]);
    rig.send(NODE_STATUS | 10, &autopilot);
    rig.run_ms(600);
    rig.forget();
    let others =
        [0x1804_562A, 0x1803_F32A, 0x1E01_AAFF, 0x1E97_4D00, 0x1804_2E0A, 0x1004_5801, 0x1803_F2AA];
    // About 2.6 s.
    let count = rig::board().fastest_bit_rate() as usize / 50;
    for n in 0..count {
        rig.send(others[n % others.len()], &[0xA5; 8]);
        if n % (count * 3 / 10) == count * 3 / 20 {
            rig.send(NODE_STATUS | 10, &autopilot);
        }
    }
    rig.run_ms(2500);
    assert_eq!(rig.statuses().len(), 3, "the node must send a status for each of the autopilot's");
    let from_node = |frame: &Frame| matches!(frame.id, Id::Extended(id) if id & 0xFF == rig::NODE);
    let of_others = rig.traffic.iter().filter(|(_, frame)| !from_node(frame)).count();
    assert_eq!(of_others, count + 3 - rig.peer.borrow().queued());
    rig.run_ms(1000);
    assert_eq!(rig.serial.matches("refused").count(), 0, "{}", rig.serial);
    rig.send_command(1, 0, -1.0);
    assert_eq!(rig.settled_pulse_us(), 1000.0);
}
