//! The node's services: information, parameters, save, restart, statistics.
//!
//! pydronecan 1.0.27 made the quoted frames; tests/clients/test_golden.py checks that it still
//! makes the same.

use crate::support::update_bench::INVALID_MODE;
use bench::Cycles;
use bench::dronecan::{Message, ParameterRequest, ParameterResponse, Value};
use rig::documented::parameters;
use rig::manage::{ANSWER_TIMEOUT_MS, ms_between};
use rig::{MS, Rig, is_from_node, parse_frames};

const GET_NODE_INFO: &str = "1E01F8FF C3";

fn read(index: u16) -> Message {
    Message::ParameterRequest(ParameterRequest { index, ..ParameterRequest::default() })
}

// ---- GetNodeInfo ----

#[test]
fn node_info_has_every_field_at_its_place() {
    let mut rig = Rig::running();
    rig.run_ms(2000);
    rig.send_frame(parse_frames(GET_NODE_INFO)[0]);
    rig.run_ms(ANSWER_TIMEOUT_MS);
    let frames = rig.to_tool();
    // The response has two bytes of CRC, 41 bytes of fixed fields and the name, with seven bytes
    // and a tail byte in each frame.
    let (last, full) = frames.split_last().expect("an answer");
    let tails: Vec<u8> = frames.iter().map(|frame| *frame.data().last().unwrap()).collect();
    assert!(full.iter().all(|frame| frame.data().len() == 8) && !last.data().is_empty());
    for (number, tail) in tails.iter().enumerate() {
        let start = if number == 0 { 0x80 } else { 0 };
        let end = if number == full.len() { 0x40 } else { 0 };
        let toggle = if number % 2 == 1 { 0x20 } else { 0 };
        assert_eq!(*tail, start | end | toggle | 3, "frame {number}");
    }
    let stream: Vec<u8> =
        frames.iter().flat_map(|frame| frame.data().split_last().unwrap().1.to_vec()).collect();
    let payload = &stream[2..];
    // The simulator has checked the transfer's CRC.
    let (_, whole) = rig
        .transfers
        .iter()
        .rfind(|(_, transfer)| transfer.frames == frames.len())
        .expect("a transfer");
    assert_eq!(whole.payload, payload);

    let uptime = u32::from_le_bytes(payload[..4].try_into().unwrap());
    assert!((2..=3).contains(&uptime), "{uptime} s");
    assert_eq!(payload[4..7], [0, 0, 0], "OK, OPERATIONAL, vendor code 0");
    let [major, minor] = [env!("CARGO_PKG_VERSION_MAJOR"), env!("CARGO_PKG_VERSION_MINOR")];
    let version: [u8; 2] = [major.parse().unwrap(), minor.parse().unwrap()];
    assert_eq!(payload[7..9], version);
    let commit = u32::from_le_bytes(payload[10..14].try_into().unwrap());
    // A program that takes updates tells the CRC of its image, for Mission Planner.
    let has_crc = rig::has_all_features();
    assert_eq!(payload[9], u8::from(commit != 0) | u8::from(has_crc) << 1, "a commit, and a CRC");
    assert_eq!(payload[14..22] != [0; 8], has_crc);
    let unique_id = &payload[24..40];
    assert!(unique_id.iter().any(|byte| *byte != 0) && unique_id.iter().any(|byte| *byte != 0xFF));
    assert_eq!(payload[40], 0, "no certificate");
    let name = std::str::from_utf8(&payload[41..]).expect("ASCII");
    assert!(name.starts_with("org.") && name.len() <= 80, "{name}");
    assert!(
        name.bytes().all(|byte| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'.' | b'-' | b'_')),
        "{name}"
    );
}

// ---- GetSet ----

#[test]
fn a_parameter_is_read_by_index_and_by_name() {
    let mut rig = Rig::running();
    for (request, answer) in [
        (
            "1E0BF8FF 00 00 C0",
            "1E0B7FF8 CE 06 01 78 00 00 00 80 | 00 00 00 00 01 78 00 20 | 00 00 00 00 00 00 01 00 \
             | 7D 00 00 00 00 00 00 20 | 00 01 00 00 00 00 00 00 | 00 00 00 43 41 4E 5F 20 | 4E 4F \
             44 45 40",
        ),
        (
            "1E0BF8FF AC 76 00 00 43 41 4E 82 | 5F 4E 4F 44 45 62",
            "1E0B7FF8 CE 06 01 78 00 00 00 82 | 00 00 00 00 01 78 00 22 | 00 00 00 00 00 00 01 02 \
             | 7D 00 00 00 00 00 00 22 | 00 01 00 00 00 00 00 02 | 00 00 00 43 41 4E 5F 22 | 4E 4F \
             44 45 42",
        ),
    ] {
        let mut answer = answer.to_string();
        if !rig::has_all_features() {
            // Nobody is asked for an ID, so that CAN_NODE is at least 1.
            answer = answer.replace("CE 06", "EA AE").replace("| 00 01 00 00", "| 00 01 01 00");
        }
        rig.assert_answer(request, &answer);
    }
}

#[test]
fn a_parameter_is_set_and_the_answer_has_the_new_value() {
    let mut rig = Rig::running();
    rig.assert_answer(
        "1E0BF8FF 4C EE 00 01 4C 04 00 84 | 00 00 00 00 00 4F 55 24 | 54 31 5F 4D 49 4E 44",
        if rig::has_all_features() {
            "1E0B7FF8 59 DD 01 4C 04 00 00 84 | 00 00 00 00 01 E8 03 24 | 00 00 00 00 00 00 01 04 \
             | 60 09 00 00 00 00 00 24 | 00 01 F4 01 00 00 00 04 | 00 00 00 4F 55 54 31 24 | 5F \
             4D 49 4E 44"
        } else {
            "1E0B7FF8 00 32 01 4C 04 00 00 84 | 00 00 00 00 01 E8 03 24 | 00 00 00 00 00 00 01 04 \
             | C4 09 00 00 00 00 00 24 | 00 01 F4 01 00 00 00 04 | 00 00 00 4F 55 54 31 24 | 5F \
             4D 49 4E 44"
        },
    );
    assert_eq!(rig.get("OUT1_MIN"), 1100);
}

/// A client behind a slow radio link.
#[test]
fn a_request_whose_frames_come_a_second_apart_is_answered() {
    let mut rig = Rig::running();
    // GetSet: OUT1_MIN 1100
    let frames = parse_frames(
        "1E0BF8FF 4C EE 00 01 4C 04 00 84 | 00 00 00 00 00 4F 55 24 | 54 31 5F 4D 49 4E 44",
    );
    for frame in frames {
        assert_eq!(rig.answers(), []);
        rig.send_frame(frame);
        rig.run_ms(1000);
    }
    assert_eq!(rig.answers().len(), 1);
    assert_eq!((rig.get("OUT1_MIN"), rig.next_status()), (1100, (0, 0)));
}

#[test]
fn a_request_for_an_unknown_parameter_gets_an_empty_answer() {
    let mut rig = Rig::running();
    let count = rig.parameters().len() as u16;
    for index in [count, 255, 256, 0x1FFF] {
        let response = rig.parameter_at(index);
        assert_eq!(response, ParameterResponse::default(), "index {index}");
    }
    for name in [
        "OUT1_MI",
        "OUT1_MINI",
        "srv_min",
        "X",
        "A_NAME_OF_16_CHR",
        "A_NAME_OF_17_CHRS",
        &"N".repeat(92),
    ] {
        assert_eq!(rig.parameter(name), ParameterResponse::default(), "{name}");
    }
    rig.assert_answer("1E0BF8FF 2C 08 C2", "1E0B7FF8 00 00 00 00 C2");
}

#[test]
fn in_a_request_with_name_and_index_the_name_is_used() {
    let mut rig = Rig::running();
    let request = ParameterRequest { index: 3, value: Value::Empty, name: b"OUT1_ID".to_vec() };
    let Message::ParameterResponse(response) = rig.ask(&Message::ParameterRequest(request)) else {
        panic!()
    };
    assert_eq!(response.name(), "OUT1_ID");
}

#[test]
fn a_value_out_of_range_is_answered_with_the_current_value() {
    let mut rig = Rig::running();
    rig.set("OUT1_MIN", 1100);
    for wrong in [
        499,
        2501,
        0,
        -1,
        -1100,
        1 << 16 | 1100,
        1 << 32 | 1100,
        1 << 56 | 1100,
        i64::MAX,
        i64::MIN,
    ] {
        assert_eq!(
            rig.request_value("OUT1_MIN", Value::Integer(wrong)),
            Value::Integer(1100),
            "{wrong}"
        );
    }
    // With eight outputs a pulse ends 100 us before the next one begins.
    let longest = if rig::has_all_features() { 2400 } else { 2500 };
    for (name, min, max) in [
        ("OUT1_MIN", 500, longest),
        ("TEMP_MIN", -55, 150),
        ("TEMP_ID", 0, 65_535),
        ("ARM_REQ", 0, 1),
    ] {
        for (value, in_force) in [(min, min), (min - 1, min), (max, max), (max + 1, max)] {
            assert_eq!(
                rig.request_value(name, Value::Integer(value)),
                Value::Integer(in_force),
                "{name} {value}"
            );
        }
    }
}

#[test]
fn the_node_accepts_only_the_bit_rates_of_dronecan() {
    let mut rig = Rig::running();
    let highest = rig::board().fastest_bit_rate().into();
    // With all features 0 finds the rate.
    let lowest = if rig::has_all_features() { 0 } else { 125_000 };
    let [value, max, min] = [highest, highest, lowest].map(Value::Integer);
    let response = rig.parameter("CAN_BAUDRATE");
    assert_eq!(
        (&response.value, &response.default, &response.max, &response.min),
        (&value, &value, &max, &min)
    );
    for rate in [lowest, 125_000, 250_000, 500_000, highest] {
        rig.set("CAN_BAUDRATE", rate);
    }
    // At 1 Mbit/s the MCP2515 needs a crystal of 16 MHz.
    assert_eq!(rig.request_value("CAN_BAUDRATE", Value::Integer(2 * highest)), value);
    for wrong in [
        lowest - 125_000,
        8,
        1,
        100_000,
        375_000,
        800_000,
        2_000_000,
        1_000_001,
        1 << 32 | 500_000,
        -125_000,
    ] {
        assert_eq!(rig.request_value("CAN_BAUDRATE", Value::Integer(wrong)), value, "{wrong}");
    }
}

#[test]
fn values_of_another_type_change_nothing() {
    let mut rig = Rig::running();
    for (name, in_force) in [("OUT1_MIN", 1000), ("ARM_REQ", 0), ("OUT1_ID", 1)] {
        for wrong in [Value::Real(1100.0), Value::Boolean(true), Value::Text(b"1100".to_vec())] {
            assert_eq!(
                rig.request_value(name, wrong.clone()),
                Value::Integer(in_force),
                "{name} {wrong}"
            );
        }
    }
    rig.assert_answer(
        "1E0BF8FF 3A DA 00 02 00 80 89 85 | 44 4F 55 54 31 5F 4D 25 | 49 4E 45",
        if rig::has_all_features() {
            "1E0B7FF8 30 B4 01 E8 03 00 00 85 | 00 00 00 00 01 E8 03 25 | 00 00 00 00 00 00 01 05 \
             | 60 09 00 00 00 00 00 25 | 00 01 F4 01 00 00 00 05 | 00 00 00 4F 55 54 31 25 | 5F \
             4D 49 4E 45"
        } else {
            "1E0B7FF8 69 5B 01 E8 03 00 00 85 | 00 00 00 00 01 E8 03 25 | 00 00 00 00 00 00 01 05 \
             | C4 09 00 00 00 00 00 25 | 00 01 F4 01 00 00 00 05 | 00 00 00 4F 55 54 31 25 | 5F \
             4D 49 4E 45"
        },
    );
}

/// Value tags 5 to 7 do not exist, and a request may end at any byte.
#[test]
fn malformed_requests_set_no_parameter_and_block_nothing() {
    let mut rig = Rig::running();
    let before = rig.parameters();
    let payloads: &[&[u8]] = &[
        &[],
        &[0],
        &[3, 5],
        &[3, 7, 1, 2, 3],
        &[3, 1],
        &[3, 1, 0x4C],
        &[3, 1, 0x4C, 4, 0, 0, 0],
        &[3, 4, 200, 1],
    ];
    for payload in payloads {
        let mut data = payload.to_vec();
        data.push(0xC9);
        rig.send(0x1E0B_F8FF, &data);
        rig.run_ms(20);
    }
    rig.forget();
    assert_eq!(rig.parameters(), before);
}

// ---- ExecuteOpcode ----

#[test]
fn an_unknown_opcode_is_answered_with_an_error() {
    let mut rig = Rig::running();
    rig.assert_answer("1E0AF8FF 02 00 00 00 00 00 00 C6", "1E0A7FF8 00 00 00 00 00 00 00 C6");
    rig.assert_answer("1E0AF8FF FF 00 00 00 00 00 00 C7", "1E0A7FF8 00 00 00 00 00 00 00 C7");
}

// ---- RestartNode ----

#[test]
fn a_restart_needs_its_magic_number() {
    let mut rig = Rig::running();
    rig.assert_answer("1E05F8FF 1E 1B 55 CE AD C7", "1E057FF8 00 C7");
    rig.assert_answer("1E05F8FF 00 00 00 00 00 C8", "1E057FF8 00 C8");
    rig.run_ms(500);
    assert!(!rig.serial.contains("reset:"), "{}", rig.serial);
}

#[test]
fn a_restart_is_answered_and_happens_within_200_ms() {
    let mut rig = Rig::running();
    rig.run_ms(1500);
    rig.assert_answer("1E05F8FF 1E 1B 55 CE AC C6", "1E057FF8 80 C6");
    let asked = rig.now();
    rig.wait_for("the first NodeStatus", 250, |rig| {
        rig.statuses().iter().any(|(_, data)| data[..4] == [0; 4] && data[4] >> 3 & 7 == 1)
    });
    assert!(ms_between(asked, rig.now()) < 230.0);
    rig.wait_for_line("reset:", 50);
    let (_, code) = rig.next_status();
    assert_eq!(code, 0, "a requested restart is no fault");
}

#[test]
fn a_restart_on_a_full_bus_comes_after_its_answer() {
    let mut rig = Rig::running();
    rig.run_ms(1500);
    rig.send(0x1E05_F8FF, &[0x1E, 0x1B, 0x55, 0xCE, 0xAC, 0xC6]);
    // Frames of 130 us or more at 1 Mbit/s, for half a second.
    let asked = rig.now();
    for n in 0..rig::board().fastest_bit_rate() / 250 {
        rig.send(0x0003_F20A, &[9, 4, 0, 0x66, n as u8, 0, 0, 0xC0 | n as u8 & 0x1F]);
    }
    rig.wait_for("the answer", 1000, |rig| !rig.frames(0x1E05_7FF8).is_empty());
    assert_eq!(rig.frames(0x1E05_7FF8)[0].1, [0x80, 0xC6]);
    assert!(ms_between(asked, rig.now()) > 450.0, "the bus was not full");
    rig.wait_for_line("reset: on request", 300);
}

/// Before the restart the servo moves to OUT1_FS, and every pulse is complete.
#[test]
fn before_a_restart_the_servo_moves_to_its_failsafe() {
    for (mode, expected) in
        [(0, vec![1750.0]), (1, vec![1750.0, 1500.0]), (2, vec![1750.0, 1900.0]), (3, vec![1750.0])]
    {
        let mut rig = Rig::running();
        rig.set("OUT1_FS_PWM", 1900);
        rig.set("OUT1_FS", mode);
        rig.send_command(1, 0, 0.5);
        assert_eq!(rig.settled_pulse_us(), 1750.0);
        rig.pulses.clear();
        rig.request(&Message::RestartNode(0xAC_CE55_1B1E));
        rig.run_ms(400);
        let mut widths: Vec<f64> = rig.pulses.iter().map(|pulse| pulse.width_us()).collect();
        if expected.len() > 1 {
            assert_eq!(widths.last(), Some(&expected[1]), "mode {mode}: {widths:?}");
        }
        widths.dedup();
        assert!(widths == expected || widths == expected[1..], "mode {mode}: {widths:?}");
        let last = rig.pulses.last().map_or(0, |pulse| pulse.start);
        assert!(
            rig.now() - last > 100 * MS,
            "after the start there are no pulses before the first command"
        );
    }
}

// ---- the others ----

#[test]
fn a_firmware_update_is_rejected() {
    let mut rig = Rig::running();
    rig.send_frame(parse_frames("1E28F8FF 7F 66 77 2E 62 69 6E C9")[0]);
    rig.run_ms(ANSWER_TIMEOUT_MS);
    let (_, number, answer) = rig.answers().remove(0);
    let Message::UpdateBegun(answer) = answer else { panic!("{answer}") };
    assert_eq!((number.get(), answer.number), (9, INVALID_MODE));
    // The reason is a text where there is room for it.
    assert_eq!(answer.text.is_empty(), !rig::has_all_features() && !rig::has_preset_remote());
    assert!(answer.text.iter().all(|byte| matches!(byte, b' '..=b'~')), "{}", answer.text());
    // A long path makes the request a transfer of many frames.
    let path = Message::BeginUpdate(bench::dronecan::management::NumberAndText {
        number: 0,
        text: vec![b'x'; 200],
    });
    assert!(
        matches!(rig.ask(&path), Message::UpdateBegun(answer) if answer.number == INVALID_MODE)
    );
}

#[test]
fn answers_have_the_priority_and_the_transfer_id_of_their_requests() {
    let mut rig = Rig::running();
    for (priority, number) in [(0u32, 31u8), (8, 0), (31, 17)] {
        rig.forget();
        rig.send(priority << 24 | 0x0B_F8FF, &[1, 0, 0xC0 | number]);
        rig.run_ms(ANSWER_TIMEOUT_MS);
        let frames = rig.to_tool();
        assert!(
            frames
                .iter()
                .all(|frame| frame.id == bench::can::Id::Extended(priority << 24 | 0x0B_7FF8))
        );
        assert_eq!(frames.first().map(|frame| frame.data()[7]), Some(0x80 | number));
    }
}

#[test]
fn requests_for_others_and_of_other_kinds_are_not_answered() {
    let mut rig = Rig::running();
    // Requests to node 121 and to node 0; a response; a request with the node's own ID; services
    // that the node does not have.
    for text in [
        "1E01F9FF C0",
        "1E0180FF C0",
        "1E0178FF C0",
        "1E01F8F8 C0",
        "1E30F8FF 00 C0",
        "1E63F8FF C0",
    ] {
        rig.send_frame(parse_frames(text)[0]);
        rig.run_ms(20);
    }
    let services =
        rig.traffic.iter().filter(|(_, frame)| is_from_node(frame)).filter(|(_, frame)| {
            matches!(frame.id, bench::can::Id::Extended(id) if id & 0x80 != 0)
                && frame.id != parse_frames("1E01F8F8 C0")[0].id
        });
    assert_eq!(services.count(), 0);
}

/// A GUI tool sends five requests at once, again and again, while an autopilot commands at 400 Hz.
#[test]
fn five_requests_at_once_are_answered_in_order_while_commands_arrive() {
    let mut rig = Rig::running();
    for round in 0..5u16 {
        rig.forget();
        let begun = rig.now();
        let numbers: Vec<_> = (0..5)
            .map(|n| rig.request(&read((round * 5 + n) % parameters().len() as u16)))
            .collect();
        command_for(&mut rig, 100);
        let answers = rig.answers();
        let heard: Vec<_> = answers.iter().map(|(_, number, _)| *number).collect();
        assert_eq!(heard, numbers);
        let names = answers.iter().map(|(_, _, answer)| match answer {
            Message::ParameterResponse(response) => response.name(),
            other => panic!("{other}"),
        });
        let expected = ["CAN_NODE", "CAN_BAUDRATE", "OUT_RATE", "TEMP_RATE", "TEMP_ID"];
        if round == 0 {
            assert_eq!(names.collect::<Vec<_>>(), expected);
        } else {
            assert!(names.into_iter().all(|name| !name.is_empty()));
        }
        let last = answers.last().unwrap().0;
        assert!(ms_between(begun, last) < 80.0, "{} ms", ms_between(begun, last));
        assert!(rig.broken.is_empty(), "{:?}", rig.broken);
    }
}

/// The node answers each request of a burst, or rejects, counts and logs it.
#[test]
fn requests_beyond_the_queue_are_rejected() {
    const BURST: usize = 30;
    for request in [Message::NodeInfoRequest, read(0)] {
        let mut rig = Rig::running();
        for _ in 0..BURST {
            rig.request(&request);
        }
        rig.run_ms(300);
        let answered = rig.answers().len();
        assert!((8..BURST).contains(&answered), "{answered}");
        // The serial monitor has no room for the lines of all rejected requests.
        rig.wait_for_line(" lines dropped", 300);
        rig.board().avr_mut().serial_send(b"?");
        rig.wait_for_line(
            &format!("commands followed 0, frames refused {}", BURST - answered),
            300,
        );
        assert_eq!(rig.board().chip().borrow().rx_overflows(), 0);
    }
}

/// Sends commands at 400 Hz for `ms` milliseconds. The node must follow each: the pulse always has
/// one of the last two widths.
fn command_for(rig: &mut Rig, ms: u64) {
    let seen = rig.pulses.len();
    let mut given: Vec<(Cycles, f64)> = Vec::new();
    for n in 0..ms * 2 / 5 {
        let width = 1100.0 + (n * 7 % 800) as f32;
        rig.send_command(1, 4, width);
        given.push((rig.now(), f64::from(width)));
        let next = rig.now() + 5 * MS / 2;
        rig.run_until(next);
    }
    for pulse in &rig.pulses[seen..] {
        // When the pulse began, the newest command could be one or two of the loop's steps old.
        let candidates: Vec<f64> = given
            .iter()
            .filter(|(at, _)| *at <= pulse.start)
            .rev()
            .take(3)
            .map(|(_, width)| *width)
            .collect();
        let is_old = candidates.len() < 3;
        assert!(
            is_old || candidates.contains(&pulse.width_us()),
            "{} us, not one of {candidates:?}",
            pulse.width_us()
        );
    }
}

/// A client that sends nine requests at once gets no answer to the ninth, and repeats it:
/// pydronecan after 1 s, ArduPilot after 100 ms. At 1 Mbit/s the queue is empty after 16 ms.
#[test]
fn the_queue_of_eight_requests_is_empty_in_time_for_repeated_requests() {
    for request in [Message::NodeInfoRequest, read(0)] {
        let mut rig = Rig::running();
        let began = rig.now();
        for _ in 0..8 {
            rig.request(&request);
        }
        rig.wait_for("eight answers", 100, |rig| rig.answers().len() == 8);
        let took_ms = (rig.now() - began) / MS;
        let most_ms = 30_000_000 / u64::from(rig::board().fastest_bit_rate());
        assert!(took_ms <= most_ms, "{request}: {took_ms} ms");
        rig.ask(&request);
    }
}
