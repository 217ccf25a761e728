//! Tests of VCD files with sigrok's decoders. One sample is one cycle of the AVR, so the tests
//! compare times, too.

use crate::links::Scratch;
use crate::wire::{Rig, frames, lines, output, peer_frames, text};
use bench::avr::{Firmware, SpiByte};
use bench::board::{Board, WireEvent};
use bench::can::{Frame, Id, Record};
use bench::wiring::Wiring;
use bench::{Bench, Cycles};
use sim::links::Link;
use sim::links::vcd::Vcd;
use std::collections::HashMap;
use std::path::Path;

const RUN_MS: u64 = 80;
/// Input format for sigrok: one sample for 625 units of 100 ps, which is a cycle.
const INPUT: &str = "vcd:downsample=625";

/// What the simulator recorded of a run, to compare with the file.
#[derive(Default)]
struct Known {
    records: Vec<Record>,
    serial: Vec<(Cycles, u8)>,
}

fn recorded(path: &Path) -> Known {
    let mut rig = Rig::new();
    let node = rig.node;
    let mut vcd = Vcd::create(path, &[], &[], &mut rig.bench, node).unwrap();
    let mut known = Known::default();
    rig.run(RUN_MS, |bench, records| {
        vcd.serve(bench).unwrap();
        known.records.extend_from_slice(records);
        known.serial.extend(bench.board(node).avr_mut().serial_take());
    });
    known
}

/// The events of a probe in the same run, without a file.
fn probed() -> Vec<(Cycles, WireEvent)> {
    let mut rig = Rig::new();
    let node = rig.node;
    rig.bench.board(node).attach_probe();
    let mut events = Vec::new();
    rig.run(RUN_MS, |bench, _| events.extend(bench.board(node).take_wire_events()));
    events
}

/// sigrok's annotations as (first sample, last sample, text).
fn decoded(path: &Path, decoder: &str, annotations: &str) -> Vec<(Cycles, Cycles, String)> {
    let arguments = [
        "-i",
        text(path),
        "-I",
        INPUT,
        "-P",
        decoder,
        "-A",
        annotations,
        "--protocol-decoder-samplenum",
    ];
    let annotation = |line: &String| {
        let (samples, rest) = line.split_once(' ').unwrap();
        let (first, last) = samples.split_once('-').unwrap();
        let (_, text) = rest.split_once(": ").unwrap();
        (first.parse().unwrap(), last.parse().unwrap(), text.to_owned())
    };
    lines("sigrok-cli", &arguments).iter().map(annotation).collect()
}

/// sigrok's annotations for a frame.
fn as_annotations(frame: &Frame) -> Vec<String> {
    let mut texts = vec![String::from("Start of frame")];
    match frame.id {
        Id::Standard(id) => texts.push(format!("Identifier: {id} ({id:#x})")),
        Id::Extended(id) => texts.push(format!("Full Identifier: {id} ({id:#x})")),
    }
    texts.push(format!(
        "Remote transmission request: {} frame",
        if frame.remote { "remote" } else { "data" }
    ));
    texts.push(format!("Data length code: {}", frame.dlc));
    texts.extend(
        frame.data().iter().enumerate().map(|(at, byte)| format!("Data byte {at}: {byte:#04x}")),
    );
    texts.push(String::from("ACK slot: ACK"));
    texts
}

#[test]
fn sigrok_reads_every_frame_with_its_time() {
    let scratch = Scratch::new();
    let path = scratch.path("run.vcd");
    let passed = frames(&recorded(&path).records);
    assert!(passed.len() > peer_frames().len());
    let annotations = "can=sof:id:full-id:rtr:dlc:data:ack-slot:warnings";
    let found = decoded(&path, "can:can_rx=CAN:nominal_bitrate=1000000", annotations);
    let mut found = found.into_iter().peekable();
    for (start, frame) in passed {
        let (first, last, _) = found.peek().expect("one more frame").clone();
        assert_eq!((first, last), (start, start + 15), "{frame}");
        let mut texts = Vec::new();
        while let Some((_, _, text)) =
            found.next_if(|(_, _, text)| texts.is_empty() || text != "Start of frame")
        {
            // The first part of an extended identifier also has its own annotation.
            let half = frame.is_extended() && text.starts_with("Identifier: ");
            if !half {
                texts.push(text);
            }
        }
        let mut expected = as_annotations(&frame);
        if frame.remote && frame.dlc > 0 {
            // The decoder takes the next bits for data. A remote frame has no data, whatever its
            // DLC.
            expected.truncate(4);
            texts.truncate(4);
        }
        assert_eq!(texts, expected, "{frame}");
    }
    assert_eq!(found.next(), None);
}

#[test]
fn sigrok_reads_every_byte_on_the_spi_and_the_commands_between_edges_of_cs() {
    let scratch = Scratch::new();
    let path = scratch.path("run.vcd");
    recorded(&path);
    let mut commands: Vec<Vec<(SpiByte, u8)>> = Vec::new();
    let mut events = probed();
    events.sort_by_key(|(at, _)| *at);
    for (_, event) in events {
        match event {
            WireEvent::Cs(false) => commands.push(Vec::new()),
            WireEvent::Spi { byte, miso } => {
                commands.last_mut().expect("CS is low").push((byte, miso))
            }
            _ => {}
        }
    }
    assert!(commands.len() > 50, "{}", commands.len());
    let decoder = "spi:clk=SCK:mosi=MOSI:miso=MISO:cs=CS";
    let hex = |bytes: Vec<u8>| {
        bytes.iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" ")
    };
    let texts = |annotations: &str| -> Vec<_> {
        decoded(&path, decoder, annotations).into_iter().map(|(_, _, text)| text).collect()
    };
    let side = |pick: fn(&(SpiByte, u8)) -> u8| -> Vec<_> {
        commands.iter().map(|command| hex(command.iter().map(pick).collect())).collect()
    };
    assert_eq!(texts("spi=mosi-transfer"), side(|(byte, _)| byte.mosi));
    assert_eq!(texts("spi=miso-transfer"), side(|(_, miso)| *miso));
    // The decoder begins a byte at its first sampling edge, half a bit after the start.
    let starts: Vec<_> =
        decoded(&path, decoder, "spi=mosi-data").iter().map(|(first, _, _)| *first).collect();
    let expected = commands.iter().flatten().map(|(byte, _)| byte.start + byte.cycles_per_bit / 2);
    assert_eq!(starts, expected.collect::<Vec<_>>());
}

#[test]
fn sigrok_reads_the_serial_text_at_the_nominal_and_the_true_rate() {
    let scratch = Scratch::new();
    let path = scratch.path("run.vcd");
    let known = recorded(&path);
    let expected: Vec<u8> = known.serial.iter().map(|(_, byte)| *byte).collect();
    assert!(expected.starts_with(b"DroneCAN"), "{}", String::from_utf8_lossy(&expected));
    for rate in ["115200", "117647"] {
        let decoder = format!("uart:tx=TXD:baudrate={rate}");
        let found = output(
            "sigrok-cli",
            &["-i", text(&path), "-I", INPUT, "-P", &decoder, "-B", "uart=tx"],
        );
        let (found, last) = found.split_at(expected.len());
        assert_eq!(String::from_utf8_lossy(found), String::from_utf8_lossy(&expected));
        assert!(last.len() <= 1, "more than the byte on the line at the end: {last:?}");
    }
    let found = decoded(&path, "uart:tx=TXD:baudrate=117647", "uart=tx-warnings");
    assert_eq!(found, []);
}

/// Changes of the wires in a file by the wire's name, without the initial levels.
fn changes(path: &Path) -> HashMap<String, Vec<(Cycles, bool)>> {
    let text = std::fs::read_to_string(path).unwrap();
    let (header, body) = text.split_once("$dumpvars").unwrap();
    let (_, body) = body.split_once("$end\n").unwrap();
    let mut names = HashMap::new();
    for line in header.lines().filter(|line| line.starts_with("$var wire 1 ")) {
        let words: Vec<_> = line.split(' ').collect();
        names.insert(words[3].to_owned(), words[4].to_owned());
    }
    let (mut at, mut changes) = (0, HashMap::<_, Vec<_>>::new());
    for line in body.lines() {
        match line.split_at(1) {
            ("#", time) => at = time.parse::<u64>().unwrap(),
            (level, code) => {
                changes.entry(names[code].clone()).or_default().push((at / 625, level == "1"))
            }
        }
        assert_eq!(at % 625, 0);
    }
    changes
}

#[test]
fn cs_int_and_servo_have_the_edges_of_the_board() {
    let scratch = Scratch::new();
    let path = scratch.path("run.vcd");
    recorded(&path);
    let mut found = changes(&path);
    let events = probed();
    type Pick = fn(&WireEvent) -> Option<bool>;
    let picks: [(&str, Pick); 3] = [
        ("CS", |event| if let WireEvent::Cs(level) = event { Some(*level) } else { None }),
        ("INT", |event| if let WireEvent::Int(level) = event { Some(*level) } else { None }),
        ("SERVO", |event| if let WireEvent::Servo(level) = event { Some(*level) } else { None }),
    ];
    for (name, pick) in picks {
        let expected: Vec<_> =
            events.iter().filter_map(|(at, event)| Some((*at, pick(event)?))).collect();
        assert!(expected.len() > 4, "{name} {expected:?}");
        assert_eq!(found.remove(name).unwrap(), expected, "{name}");
    }
}

/// I/O address of DDRx and bit of D5 to D8 and A1 to A3 (datasheet section 31). PORTx is at the
/// next address.
const OUTPUT_PINS: [(u16, u16); 7] =
    [(0x0A, 5), (0x0A, 6), (0x0A, 7), (0x04, 0), (0x07, 1), (0x07, 2), (0x07, 3)];
/// Cycles of SBI, CBI and RJMP.
const INSTRUCTION: u64 = 2;

/// A program that gives a pulse on each pin in turn, for ever. A pulse has `nops` NOPs for the
/// index of its pin.
fn pulsing(nops: impl Fn(usize) -> usize) -> Firmware {
    let set = |register: u16, bit: u16| 0x9A00 | register << 3 | bit;
    let clear = |register: u16, bit: u16| 0x9800 | register << 3 | bit;
    let mut program: Vec<u16> =
        OUTPUT_PINS.iter().map(|&(direction, bit)| set(direction, bit)).collect();
    let start = program.len();
    for (index, &(direction, bit)) in OUTPUT_PINS.iter().enumerate() {
        program.push(set(direction + 1, bit));
        program.extend(vec![0; nops(index)]);
        program.push(clear(direction + 1, bit));
    }
    let back = start as i16 - (program.len() as i16 + 1);
    program.push(0xC000 | back as u16 & 0xFFF);
    Firmware {
        flash: vec![(0, program.into_iter().flat_map(u16::to_le_bytes).collect())],
        ..Firmware::default()
    }
}

/// The file and the board's own meters get the same pulses, in whatever order they are read.
#[test]
fn sigrok_measures_the_pulses_of_the_outputs_2_to_8() {
    let section =
        b"board=uno\nshield=seeed\nmcu=atmega328p\ncs=D9\nint=D2\ncrystal_mhz=16\nservo=D10\n\
                    outputs=D5,D6,D7,D8,A1,A2,A3\nsensor=A0\n";
    let nops = |index: usize| 100 + 20 * index;
    let width = |index: usize| nops(index) as u64 + INSTRUCTION;
    let period =
        (0..OUTPUT_PINS.len()).map(|index| width(index) + INSTRUCTION).sum::<u64>() + INSTRUCTION;
    let scratch = Scratch::new();
    let path = scratch.path("run.vcd");
    let mut bench = Bench::new(crate::wire::BIT_RATE);
    let board = Board::programmed(&Wiring::parse(section).unwrap(), &pulsing(nops)).unwrap();
    let node = bench.add_board(board, "node");
    let mut vcd = Vcd::create(&path, &[], &[], &mut bench, node).unwrap();
    let mut metered = vec![Vec::new(); OUTPUT_PINS.len()];
    for turn in 0..10 {
        bench.run_for_ms(1);
        let mut look = |bench: &mut Bench| {
            let pulses = bench.board(node).take_output_pulses();
            metered.iter_mut().zip(pulses).for_each(|(all, pulses)| all.extend(pulses));
        };
        if turn % 2 == 0 {
            look(&mut bench);
        }
        vcd.serve(&mut bench).unwrap();
        look(&mut bench);
    }
    vcd.finish(&mut bench).unwrap();
    let mut found = changes(&path);
    for (index, pulses) in metered.iter().enumerate() {
        let name = format!("OUT{}", index + 2);
        assert!(
            pulses.len() > 100 && pulses.iter().all(|pulse| pulse.width_cycles == width(index)),
            "{name}"
        );
        let edges = found.remove(&name).unwrap();
        let rises: Vec<_> = edges.iter().filter(|(_, high)| *high).map(|(at, _)| *at).collect();
        assert_eq!(
            rises[..pulses.len()],
            pulses.iter().map(|pulse| pulse.start).collect::<Vec<_>>(),
            "{name}"
        );
        let duty = decoded(&path, &format!("pwm:data={name}"), "pwm=duty-cycle");
        let expected = format!("{:.6}%", 100.0 * width(index) as f64 / period as f64);
        assert!(
            duty.len() > 100 && duty.iter().all(|(_, _, text)| *text == expected),
            "{name} {expected} {:?}",
            duty[0]
        );
    }
}

/// The file of a run that is killed ends with a whole line, and lacks only the last 10 ms.
#[test]
fn the_file_can_be_read_while_it_is_being_written() {
    let scratch = Scratch::new();
    let path = scratch.path("run.vcd");
    let mut rig = Rig::new();
    let node = rig.node;
    let mut vcd = Vcd::create(&path, &[], &[], &mut rig.bench, node).unwrap();
    let mut seen = Vec::new();
    rig.run(42, |bench, records| {
        seen.extend_from_slice(records);
        vcd.serve(bench).unwrap();
    });
    assert!(std::fs::read(&path).unwrap().ends_with(b"\n"));
    let found = decoded(&path, "can:can_rx=CAN:nominal_bitrate=1000000", "can=sof");
    let before = seen.iter().filter(|record| record.end < 30 * crate::avr::MS).count();
    assert!(before > 20 && found.len() >= before, "{before} {}", found.len());
    drop(vcd);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_error_that_names_the_file() {
    let mut rig = Rig::new();
    let error = Vcd::create(Path::new("/dev/full"), &[], &[], &mut rig.bench, 0).err().unwrap();
    let error = format!("{error:#}");
    assert!(error.starts_with("--vcd: cannot write /dev/full: No space left"), "{error}");
}
