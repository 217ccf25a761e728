//! The builds for the two chips behave the same. They differ in compiler flags, addresses of
//! registers, and limits of memory.

use std::collections::BTreeMap;

use bench::can::{Frame, Id};
use bench::dronecan::{Message, Opcode, ParameterRequest, Value};
use bench::firmware_for;
use rig::{ARRAY_COMMAND, MS, NODE, NODE_STATUS, Rig, is_from_node, started_with};

/// CAN identifier of a GetNodeInfo response of the node, without its priority.
const NODE_INFO: u32 = 0x0001_7F80 | NODE;

/// The recorded frames and pulses of the node.
struct Seen {
    /// For each identifier, the data of its frames in order.
    frames: BTreeMap<u32, Vec<Vec<u8>>>,
    /// Widths of the pulses in order, in microseconds, repeated widths once.
    pulses_us: Vec<f64>,
    lines: Vec<String>,
    lost: u32,
}

fn request(name: &str, value: Value) -> Message {
    Message::ParameterRequest(ParameterRequest { index: 0, name: name.as_bytes().to_vec(), value })
}

/// Runs two seconds of commands of each kind, requests and invalid frames, and then the failsafe.
fn traffic_through(board: &str) -> Seen {
    let elf = firmware_for(board, "seeed", "default").unwrap_or_else(|error| panic!("{error:#}"));
    // Both boards have the same unique ID and parameters.
    let diecimila =
        firmware_for("diecimila", "seeed", "default").unwrap_or_else(|error| panic!("{error:#}"));
    let mut rig = Rig::with_boards_of(&elf, &[started_with(&diecimila)]);
    rig.wait_until_up();
    rig.run_until(400 * MS);
    rig.forget();
    for n in 0..60u8 {
        let part = f32::from(n) / 30.0 - 1.0;
        match n % 8 {
            0 => rig.send_command(1, 0, part),
            1 => rig.send_command(1, 1, part * 0.7),
            2 => rig.send_command(1, 4, 1500.0 + 400.0 * part),
            3 => rig.send_servo_command(n * 4),
            4 => rig.send_commands(&[(2, 0, 0.1), (1, 0, part), (3, 0, 0.2), (9, 0, -0.3)]),
            // A command for another actuator, one of an unknown type, and one that is NaN.
            5 => rig.send_command(2, 0, part),
            6 => rig.send_command(1, 77, part),
            _ => rig.send_command(1, 0, f32::NAN),
        }
        rig.run_ms(7);
        let asked = match n {
            5 => Some(Message::NodeInfoRequest),
            10 => Some(request("", Value::Empty)),
            15 => Some(request("OUT1_MIN", Value::Integer(1100))),
            20 => Some(request("OUT1_MIN", Value::Integer(1_000_000))),
            25 => Some(Message::ExecuteOpcode(Opcode::SAVE)),
            30 => Some(request("NO_SUCH", Value::Integer(1))),
            35 => Some(Message::ExecuteOpcode(Opcode::ERASE)),
            _ => None,
        };
        if let Some(asked) = asked {
            rig.request(&asked);
        }
        match n {
            40 => rig.send_frame(Frame::remote(Id::Extended(ARRAY_COMMAND | 10), 5)),
            // A frame with the node's own ID, a piece of a transfer, and a status of the autopilot.
            45 => rig.send(ARRAY_COMMAND | NODE, &[1, 0, 0, 0, 0xC0]),
            50 => rig.send(ARRAY_COMMAND | 10, &[1, 2, 3, 4, 5, 6, 7, 0x80]),
            55 => rig.send_status_from(1),
            _ => {}
        }
        rig.run_ms(33);
    }
    rig.run_ms(1500);
    let mut frames = BTreeMap::<u32, Vec<Vec<u8>>>::new();
    for (_, frame) in rig.traffic.iter().filter(|(_, frame)| is_from_node(frame)) {
        let Id::Extended(id) = frame.id else { panic!("{frame} is no frame of DroneCAN") };
        frames.entry(id).or_default().push(frame.data().to_vec());
    }
    let mut pulses_us: Vec<f64> = rig.pulses.iter().map(|pulse| pulse.width_us()).collect();
    pulses_us.dedup();
    let lines = rig.serial.lines().map(str::to_owned).collect();
    Seen { frames, pulses_us, lines, lost: rig.board().chip().borrow().rx_overflows() }
}

#[test]
fn both_chips_answer_the_same_traffic_with_the_same_frames_pulses_and_lines() {
    let (small, large) = (traffic_through("diecimila"), traffic_through("uno"));
    assert_eq!((small.lost, large.lost), (0, 0));
    assert_eq!(small.pulses_us, large.pulses_us);
    assert_eq!(small.lines, large.lines);
    assert!(small.pulses_us.len() > 20 && small.lines.len() > 60 && small.frames.len() >= 6);
    assert_eq!(small.frames.keys().collect::<Vec<_>>(), large.frames.keys().collect::<Vec<_>>());
    for (&id, frames) in &small.frames {
        let other = &large.frames[&id];
        assert_eq!(frames.len(), other.len(), "{id:08X}");
        // Name and hardware version differ between the boards.
        if id & !(0x1F << 24) != NODE_INFO {
            assert_eq!(frames, other, "{id:08X}");
        }
    }
    assert!(small.frames[&(NODE_STATUS | NODE)].len() >= 4);
}
