//! Makes the first inputs of the corpus: `cargo run -p fuzz-harness --example seeds -- DIRECTORY
//! LOG...`. Each LOG is a file of `sim --log FILE` or candump. The inputs of a target go to the
//! folder with its name.

use std::error::Error;
use std::fs;
use std::path::Path;

use dronecan_host::mcast::datagram;
use dronecan_host::{CanId, Frame, Id, slcan};
use fuzz_harness::steps::{Damage, Input, Sent, Step, Type, bytes_of};

/// Number of a log's frames in an input.
const PIECE: usize = 40;

/// The node's ID. Other nodes do not send the node's own frames.
const NODE: u8 = 120;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let directory = arguments.next().ok_or("which directory?")?;
    let directory = Path::new(&directory);
    let write = |target: &str, name: &str, input: &[u8]| {
        let folder = directory.join(target);
        fs::create_dir_all(&folder)?;
        fs::write(folder.join(name), input)
    };
    for (name, steps) in lives() {
        write("node", name, &bytes_of(&steps))?;
    }
    for (name, input) in images() {
        write("eeprom", name, &input)?;
    }
    for (target, inputs) in [("host", host()), ("sim", sim()), ("bridge", bridge())] {
        for (name, input) in inputs {
            write(target, name, &input)?;
        }
    }
    for log in arguments {
        let frames = frames(&fs::read_to_string(&log)?);
        let stem = Path::new(&log)
            .file_stem()
            .ok_or("a log without a name")?
            .to_string_lossy()
            .into_owned();
        for (number, piece) in frames.chunks(PIECE).enumerate() {
            let name = format!("{stem}-{number:03}");
            write("node", &name, &bytes_of(&life(piece)))?;
            write("bridge", &name, &bus(piece))?;
            for (kind, input) in
                [(0, slcan_text(piece)), (1, slcan_text(piece)), (3, text(piece)), (4, raw(piece))]
            {
                write("host", &format!("{name}-{kind}"), &[&[kind], input.as_slice()].concat())?;
            }
        }
    }
    Ok(())
}

/// The frames of a log with their times in microseconds.
fn frames(log: &str) -> Vec<(u64, Frame)> {
    let line = |line: &str| {
        let mut words = line.split_whitespace();
        let (seconds, us) = words.next()?.trim_matches(['(', ')']).split_once('.')?;
        let frame = words.nth(1)?.parse().ok()?;
        Some((seconds.parse::<u64>().ok()? * 1_000_000 + us.parse::<u64>().ok()?, frame))
    };
    log.lines().filter_map(line).collect()
}

fn extended(frame: &Frame) -> Option<u32> {
    match frame.id {
        Id::Extended(id) if !frame.remote => Some(id),
        _ => None,
    }
}

/// Steps with the frames of other nodes, at the same times.
fn life(frames: &[(u64, Frame)]) -> Vec<Step> {
    let mut steps = Vec::new();
    let mut last_us = frames.first().map_or(0, |(at, _)| *at);
    for (at_us, frame) in frames {
        let ms = (at_us - last_us) / 1000;
        if ms != 0 {
            last_us += ms * 1000;
            steps.extend([Step::Wait(ms.min(10_000) as u16), Step::Leave(0)]);
        }
        let Some(id) = extended(frame) else { continue };
        if CanId::parse(id).and_then(CanId::source).is_none_or(|source| source.get() != NODE) {
            steps.push(Step::Frame { id: id.to_be_bytes(), data: frame.data().to_vec() });
        }
    }
    steps
}

fn slcan_text(frames: &[(u64, Frame)]) -> Vec<u8> {
    frames.iter().flat_map(|(_, frame)| slcan::line(frame, None)).collect()
}

fn text(frames: &[(u64, Frame)]) -> Vec<u8> {
    frames.iter().map(|(_, frame)| format!("{frame}\n")).collect::<String>().into_bytes()
}

fn raw(frames: &[(u64, Frame)]) -> Vec<u8> {
    let mut input = Vec::new();
    for (_, frame) in frames {
        let Some(id) = extended(frame) else { continue };
        input.extend(id.to_be_bytes());
        input.extend([frame.data().len() as u8, 1]);
        input.extend(frame.data());
    }
    input
}

/// Input for the bridge with frames of the bus, a sixteenth of a second after each.
fn bus(frames: &[(u64, Frame)]) -> Vec<u8> {
    let mut input = Vec::new();
    for (_, frame) in frames {
        let Some(id) = extended(frame) else { continue };
        input.push((frame.data().len() as u8) << 2 | 1);
        input.extend(id.to_be_bytes());
        input.extend(frame.data());
        input.push(6 << 2 | 3);
    }
    input
}

fn sent(what: Type, number: u8, payload: &[u8]) -> Step {
    Step::Transfer {
        sent: Sent { what, source: 127, number, payload: payload.to_vec() },
        damage: None,
    }
}

/// A GetSet request that sets an integer by index.
fn set(number: u8, index: u8, value: i64) -> Step {
    let mut payload = vec![index, 1];
    payload.extend(value.to_le_bytes());
    sent(Type::GetSet, number, &payload)
}

/// Inputs with many kinds of events.
fn lives() -> Vec<(&'static str, Vec<Step>)> {
    const OUT1_FS: u8 = 10;
    const ARM_REQ: u8 = 12;
    const MAGIC: [u8; 5] = [0x1E, 0x1B, 0x55, 0xCE, 0xAC];
    let wait = |ms| [Step::Wait(ms), Step::Leave(0)];
    let half = [1, 0, 0, 0x38];
    let long: Vec<u8> = (0..8).flat_map(|actuator| [actuator, 0, 0, 0x34]).collect();
    // Each command has its own value, so that the test detects a command that must not be followed.
    let damaged = |damage, frame| {
        let value = 0x30 + damage as u8;
        let payload = (0..8).flat_map(|actuator| [actuator, 0, 0, value]).collect();
        let sent = Sent { what: Type::ArrayCommand, source: 10, number: 7, payload };
        Step::Transfer { sent, damage: Some((damage, frame)) }
    };
    let mut every_parameter = Vec::new();
    for index in 0..27 {
        every_parameter.extend([sent(Type::GetSet, index & 31, &[index, 0]), Step::Leave(0)]);
    }
    let by_name = |name: &[u8]| sent(Type::GetSet, 1, &[&[0, 0], name].concat());
    vec![
        (
            "services",
            [
                vec![
                    sent(Type::GetNodeInfo, 0, &[]),
                    sent(Type::GetTransportStats, 1, &[]),
                    sent(Type::FileRead, 2, &[0]),
                ],
                vec![
                    sent(Type::BeginFirmwareUpdate, 3, b"\x7Ffirmware.bin"),
                    by_name(b"OUT1_MIN"),
                    by_name(b"NONE"),
                ],
                wait(100).to_vec(),
            ]
            .concat(),
        ),
        ("parameters", every_parameter),
        (
            "save-and-restart",
            [
                vec![set(1, 2, 3), sent(Type::ExecuteOpcode, 2, &[0; 7])],
                wait(600).to_vec(),
                vec![sent(Type::RestartNode, 3, &MAGIC)],
                wait(200).to_vec(),
            ]
            .concat(),
        ),
        (
            "without-id",
            [
                vec![set(1, 0, 0), sent(Type::ExecuteOpcode, 2, &[0; 7])],
                wait(600).to_vec(),
                vec![sent(Type::RestartNode, 3, &MAGIC)],
                wait(1500).to_vec(),
                vec![sent(Type::Allocation, 0, &[0, 1, 2, 3, 4, 5, 6])],
                wait(1500).to_vec(),
            ]
            .concat(),
        ),
        (
            "failsafe",
            [
                vec![set(1, OUT1_FS, 1), sent(Type::ArrayCommand, 0, &half)],
                wait(1500).to_vec(),
                vec![sent(Type::ThesisCommand, 1, &[200])],
                wait(1500).to_vec(),
            ]
            .concat(),
        ),
        (
            "arming",
            [
                vec![
                    set(1, ARM_REQ, 1),
                    sent(Type::ArrayCommand, 0, &half),
                    sent(Type::ArmingStatus, 0, &[255]),
                ],
                vec![sent(Type::ArrayCommand, 1, &half)],
                wait(5000).to_vec(),
                vec![sent(Type::ArrayCommand, 2, &half), sent(Type::ArmingStatus, 1, &[0])],
            ]
            .concat(),
        ),
        (
            "long-commands",
            [
                vec![
                    sent(Type::ArrayCommand, 0, &long),
                    damaged(Damage::Lost, 1),
                    damaged(Damage::Twice, 1),
                ],
                vec![
                    damaged(Damage::First, 2),
                    damaged(Damage::Last, 0),
                    damaged(Damage::Short, 2),
                ],
                vec![
                    damaged(Damage::Toggle, 3),
                    damaged(Damage::Bit, 4),
                    damaged(Damage::Number, 1),
                ],
                wait(20).to_vec(),
                vec![sent(Type::LightsCommand, 0, &[0, 0xFF, 0xFF, 1, 0, 0, 2, 3, 4])],
            ]
            .concat(),
        ),
        ("draft", draft()),
        (
            "autopilot",
            (0..8)
                .flat_map(|second| {
                    let status = sent(Type::NodeStatus, second, &[second, 0, 0, 0, 0, 0, 0]);
                    [
                        status,
                        sent(Type::ThesisCommand, second, &[second * 30]),
                        Step::Wait(1000),
                        Step::Leave(0),
                    ]
                })
                .collect(),
        ),
        (
            "inputs",
            [
                vec![
                    Step::Input(Input::Pressed),
                    Step::Wait(60),
                    Step::Input(Input::Released),
                    Step::Wait(60),
                ],
                vec![
                    Step::Input(Input::Question),
                    Step::Input(Input::Sensor(1023)),
                    Step::Wait(1200),
                    Step::Leave(0),
                ],
                (0..7).map(|event| Step::Input(Input::Controller(event, 0xFF))).collect(),
                vec![
                    Step::Input(Input::Sensor(0)),
                    Step::Wait(1200),
                    Step::Leave(0),
                    Step::Input(Input::Reset),
                ],
            ]
            .concat(),
        ),
    ]
}

/// An autopilot of the draft, which the node must not follow: statuses, commands, requests.
fn draft() -> Vec<Step> {
    let frame = |id: u32, data: &[u8]| Step::Frame { id: id.to_be_bytes(), data: data.to_vec() };
    let mut steps = Vec::new();
    for number in 0..6 {
        steps.push(frame(0x1134_0408 | number, &[0xEF, 0xCD, 0xAB, 0x02, 0xEF, 0xBE]));
        steps.push(frame(0x17C4_0408 | number, &[0x5A + number as u8]));
        steps.push(frame(0x084C_0408 | number, &[1, 0, 0x38 + number as u8, 2, 0, 0xBC]));
        steps.extend([Step::Wait(500), Step::Leave(0)]);
    }
    steps.push(frame(0x113B_FC08, &[120]));
    steps.push(frame(0x1183_FC09, &[120, 0x1E, 0x1B, 0x55, 0xCE, 0xAC]));
    steps.extend([Step::Leave(0), Step::Wait(200), Step::Leave(0)]);
    steps
}

/// EEPROMs: new ones, empty records with a valid CRC, and values out of range.
fn images() -> Vec<(&'static str, Vec<u8>)> {
    let image = |right: u8, byte: u8| {
        let mut input = vec![right, 3, 0xE8, 3, 0xD0, 7, 5, 0xA5];
        let mut cells = vec![byte; 256];
        // The selector means the first copy.
        (cells[0x04 + 18], cells[0x1E], cells[0x1F]) = (0, 0x3C, 0x3C);
        input.extend(cells);
        input
    };
    let defaults: [u16; 29] = [
        120, 3, 1, 1000, 1500, 2000, 0, 50, 90, 1000, 0, 1500, 0, 10, 1, 1, 1, 0, 0, 100, 0xFFD8,
        85, 0x1BF7, 0x0400, 0x2000, 0, 0, 0, 1,
    ];
    let mut good = image(7, 0xFF);
    for start in [0x20, 0xA0] {
        for (cells, value) in good[8 + start..].chunks_exact_mut(2).zip(defaults) {
            cells.copy_from_slice(&value.to_le_bytes());
        }
    }
    vec![
        ("new", vec![0, 2, 7, 0, 9, 0, 20, 0]),
        ("good", good),
        ("zeros", image(0, 0)),
        ("out-of-range", image(7, 0x55)),
        ("lost", image(1, 0x11)),
    ]
}

fn host() -> Vec<(&'static str, Vec<u8>)> {
    let frame = Frame::extended(0x1404_562A, &[0x01, 0x00, 0xA9, 0x5C, 0x00, 0xC0]);
    let datagram = datagram::encode(&frame).unwrap_or_default();
    vec![
        (
            "slcan-commands",
            b"\x00\rC\rS8\rO\rF\rV\rN\rZ1\rM00000000\rmFFFFFFFF\rT1404562A60100a95c00c0\r\
              t1232AABB\rr1234\rR000001230\r"
                .to_vec(),
        ),
        (
            "slcan-replies",
            b"\x01\r\x07z\rZ\rV1013\rT1404562A60100A95C00C0EA5F\rt1231ABEA5F\r".to_vec(),
        ),
        ("datagram", [&[2], datagram.as_slice()].concat()),
        (
            "candump",
            b"\x031003F20A#01000038C7\n123#R4\n123#1122334455667788_C\n00000123#R\n".to_vec(),
        ),
        ("name", b"\x06uavcan.equipment.actuator.ArrayCommand".to_vec()),
        ("short-name", b"\x06Status".to_vec()),
    ]
}

fn sim() -> Vec<(&'static str, Vec<u8>)> {
    const SCRIPT: &str = "# warm up\n(0.5) can0 1404562A#0100A95C00C0\n(2.5) temperature 60\n(3) \
                          button press\n(3.1) button release\n(4.0) fault no-ack\n(5.0) serial \
                          help\\r\\x1b\n(6) vcan1 00000001#R R\n(7) can0 20000008#00\n";
    let mut script = vec![2];
    script.extend(SCRIPT.bytes());
    vec![
        ("hex", b"\x00:020000020100FB\n:0100000055AA\n:0400000300003800C1\n:00000001FF\n".to_vec()),
        ("script", script),
        (
            "wall-clock",
            b"\x02(1700000000.000001) can0 123#0102\n(1700000001.5) can0 123#\n".to_vec(),
        ),
        ("faults", b"\x03chip-reset@1.5s\nno-ack@250us\nerror-rate@1h\n2m\n".to_vec()),
        ("plan", b"\x044x esc.Status@50\nArrayCommand[8]@50\n20100:12@5\nGetNodeInfo@1".to_vec()),
        ("payload", b"\x04NodeStatus=00112233445566@1\n".to_vec()),
        ("wire", [vec![5], [0x00, 0xFE, 0x03, 0x55, 0xFF, 0xC2].repeat(8)].concat()),
        ("elf", [vec![1], elf()].concat()),
        // Configuration, normal mode, a frame to send, and bits on the bus.
        (
            "chip",
            [
                [6, 5, 0xFF, 2, 0x28, 0x05, 0x09, 0x00].as_slice(),
                &[4, 0xFF, 2, 0x0F, 0, 0],
                &[14, 0xFF, 0x40, 1, 2, 3, 4, 8, 1, 2, 3, 4, 5, 6, 7, 8],
                &[1, 0xFF, 0x81],
                &[2, 0x00, 0xA0, 0, 2, 0x55, 0xB0, 0, 3, 0xFF, 0x90, 1, 2, 4, 0, 5, 0x2C, 1, 0],
            ]
            .concat(),
        ),
    ]
}

/// An ELF for the AVR with a segment of two bytes and an empty table of symbols.
fn elf() -> Vec<u8> {
    let mut elf = b"\x7FELF\x01\x01\x01\0\0\0\0\0\0\0\0\0".to_vec();
    let words16 = |elf: &mut Vec<u8>, words: &[u16]| {
        elf.extend(words.iter().flat_map(|word| word.to_le_bytes()))
    };
    let words32 = |elf: &mut Vec<u8>, words: &[u32]| {
        elf.extend(words.iter().flat_map(|word| word.to_le_bytes()))
    };
    // An executable for the AVR. Its headers follow: one of 32 bytes, and two of 40 bytes at 88.
    words16(&mut elf, &[2, 83]);
    words32(&mut elf, &[1, 0, 52, 88, 0]);
    words16(&mut elf, &[52, 32, 1, 40, 2, 0]);
    words32(&mut elf, &[1, 84, 0, 0, 2, 2, 5, 1]);
    elf.extend([0x0C, 0x94, 0, 0]);
    words32(&mut elf, &[0; 10]);
    words32(&mut elf, &[0, 2, 0, 0, 88, 16, 0, 0, 4, 16]);
    elf
}

fn bridge() -> Vec<(&'static str, Vec<u8>)> {
    // Numbers of messages in the harness: HEARTBEAT, PARAM_REQUEST_READ, PARAM_REQUEST_LIST,
    // PARAM_SET, COMMAND_INT, COMMAND_LONG, CAN_FRAME, CAN_FILTER_MODIFY.
    let message = |which: u8, payload: &[u8]| {
        [&[(payload.len() as u8 + 1) << 2 | 2, which], payload].concat()
    };
    let status = [7 << 2 | 1 | 1 << 2, 0x18, 0x01, 0x55, 0x78, 1, 0, 0, 0, 0, 0, 0, 0xC0];
    let command = |number: u16, first: f32, to: u8| {
        let mut payload = first.to_le_bytes().to_vec();
        payload.extend([0; 24]);
        payload.extend(number.to_le_bytes());
        payload.extend([1, to, 0]);
        message(5, &payload)
    };
    let wait = [8 << 2 | 3];
    let commands: Vec<u8> =
        [(245, 1.0), (246, 3.0), (512, 0.0), (519, 1.0), (520, 1.0), (5200, 0.0), (32000, 1.0)]
            .into_iter()
            .flat_map(|(number, first)| [command(number, first, 120), wait.to_vec()].concat())
            .collect();
    let set =
        [&1.5f32.to_le_bytes(), [1, 120].as_slice(), b"OUT1_MIN\0\0\0\0\0\0\0\0\0\x06"].concat();
    let read = [&[0, 0, 1, 120], b"OUT1_MIN\0\0\0\0\0\0\0\0\0".as_slice()].concat();
    let frame =
        [&0x9404_562Au32.to_le_bytes(), [1, 0, 0, 8].as_slice(), &[1, 2, 3, 4, 5, 6, 7, 0xC0]]
            .concat();
    vec![
        ("commands", [status.as_slice(), &commands].concat()),
        (
            "parameters",
            [
                &message(2, &[1, 120]),
                status.as_slice(),
                &message(1, &read),
                &message(3, &set),
                &wait,
                &message(2, &[1, 0]),
            ]
            .concat(),
        ),
        (
            "forward",
            [
                &command(32000, 1.0, 0),
                message(7, &[0x55, 1, 0, 0]).as_slice(),
                &message(6, &frame),
                &status,
                &message(0, &[6, 0, 0, 0, 6, 8, 0, 4, 3]),
            ]
            .concat(),
        ),
        // A HEARTBEAT of version 1, and random bytes.
        (
            "stream",
            [
                &[17 << 2],
                b"\xFE\x09\x00\xFF\xBE\x00\0\0\0\0\x06\x08\x00\x04\x03\x12\x34".as_slice(),
            ]
            .concat(),
        ),
    ]
}
