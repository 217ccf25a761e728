//! DroneCAN v0 and the UAVCAN draft of 2014: the node speaks what its autopilot speaks, and finds out by listening.
//!
//! Identifiers of the draft: type\[28:19\] transfer type\[18:17\] source\[16:10\] frame index\[9:4\] last\[3\] transfer ID\[2:0\].

mod rig;

use rig::load::{Meter, ocr1b};
use rig::manage::{PATIENCE_MS, TOOL, ms_between};
use rig::status::{DRAFT, TEMPERATURE};
use rig::{MS, NODE, NODE_STATUS, Rig, US, quoted};
use sim::Cycles;
use sim::autopilot::{Only, Profile, Settings};
use sim::can::Frame;
use sim::dronecan::draft::{Message, NodeStatus, Route, StatusCode, VendorCode};
use sim::dronecan::{Dialect, Message as V0Message, ParameterRequest, Value};

/// Statuses come once a second, and the second or third in a row is to be enough; with some time for the frames themselves.
const CHANGE_MS: u64 = 2050;
/// Within it a node that is up has said its status.
const STATUS_MS: u64 = 1100;
/// Of a message to all, of one frame.
const BROADCAST: u32 = 2 << 17;
const LAST: u32 = 1 << 3;

fn message_id(type_id: u32, source: u32, transfer_id: u32) -> u32 {
    type_id << 19 | BROADCAST | source << 10 | LAST | (transfer_id % 8)
}

/// An autopilot of the draft that commands with ArrayCommand, or as the thesis did.
fn in_draft(profile: Profile) -> Settings {
    Settings::of(profile).in_dialect(Dialect::Draft)
}

/// What the node has said in the draft, with its time and the number of the transfer.
fn said(rig: &Rig) -> Vec<(Cycles, u8, Message)> {
    let of_node = rig.drafts.iter().filter(|(_, transfer, _)| u32::from(transfer.source.get()) == NODE);
    of_node.map(|(at, transfer, message)| (*at, transfer.transfer_id.get(), message.clone())).collect()
}

fn statuses(rig: &Rig) -> Vec<(Cycles, NodeStatus)> {
    let status = |(at, _, message)| match message {
        Message::NodeStatus(status) => Some((at, status)),
        _ => None,
    };
    said(rig).into_iter().filter_map(status).collect()
}

fn measurements(rig: &Rig) -> Vec<(Cycles, u8)> {
    let number = |(at, _, message)| match message {
        Message::ThesisMeasurement(number) => Some((at, number)),
        _ => None,
    };
    said(rig).into_iter().filter_map(number).collect()
}

/// Transfers of the node in v0.
fn said_in_v0(rig: &Rig) -> usize {
    let of_node = |source: sim::dronecan::NodeId| u32::from(source.get()) == NODE;
    rig.transfers.iter().filter(|(_, transfer)| transfer.id.source().is_some_and(of_node)).count()
}

/// From now on the node speaks this dialect and nothing of the other.
#[track_caller]
fn assert_speaks(rig: &mut Rig, dialect: Dialect) {
    assert_speaks_after(rig, dialect, "");
}

/// The same; `what` has happened.
#[track_caller]
fn assert_speaks_after(rig: &mut Rig, dialect: Dialect, what: &str) {
    rig.forget();
    rig.run_ms(STATUS_MS);
    let (v0, draft) = (rig.statuses().len(), statuses(rig).len());
    let said =
        format!("{v0} statuses and {} messages of v0, {draft} and {} of the draft", said_in_v0(rig), said(rig).len());
    let (its_own, foreign) = match dialect {
        Dialect::V0 => (v0, self::said(rig).len()),
        Dialect::Draft => (draft, said_in_v0(rig)),
    };
    assert!(its_own > 0 && foreign == 0, "{what}: {said}");
    assert!(!rig.serial.contains("reset:"), "{what}: {}", rig.serial);
}

/// A node that speaks the draft, with this autopilot on the bus.
#[track_caller]
fn flying(settings: Settings) -> Rig {
    let mut rig = Rig::running();
    rig.replace_autopilot(settings);
    rig.autopilot().hold(0.5);
    rig.run_ms(CHANGE_MS);
    assert_speaks(&mut rig, Dialect::Draft);
    rig.forget();
    rig
}

/// A node that speaks the draft, and nobody else on the bus but the peer.
#[track_caller]
fn alone_in_draft() -> Rig {
    let mut rig = flying(in_draft(Profile::Plain));
    rig.detach_autopilot();
    rig.run_ms(100);
    assert_speaks(&mut rig, Dialect::Draft);
    rig.forget();
    rig
}

#[track_caller]
fn assert_obeys(rig: &mut Rig) {
    for deflection in [1.0, -1.0, 1.0] {
        rig.autopilot().hold(deflection);
        rig.run_ms(30);
        assert_eq!(rig.settled_pulse_us(), 1500.0 + 500.0 * deflection);
    }
}

// ---- finding out ----

#[test]
fn a_node_that_hears_nobody_speaks_v0() {
    let mut rig = Rig::powered();
    rig.run_ms(200);
    for _ in 0..4 {
        assert_speaks(&mut rig, Dialect::V0);
    }
}

/// With statuses, with commands, with both, and whichever commands they are.
#[test]
fn it_speaks_the_draft_two_seconds_after_the_autopilot_began_to() {
    for profile in [Profile::Plain, Profile::Thesis] {
        for only in [None, Some(Only::Status), Some(Only::Commands)] {
            let mut rig = Rig::running();
            rig.replace_autopilot(Settings { only, ..in_draft(profile) });
            rig.run_ms(CHANGE_MS);
            assert_speaks(&mut rig, Dialect::Draft);
            if only != Some(Only::Status) {
                assert_obeys(&mut rig);
            }
        }
    }
}

#[test]
fn it_finds_out_just_as_well_right_after_power_on() {
    for dialect in [Dialect::V0, Dialect::Draft] {
        let mut rig = Rig::powered();
        rig.replace_autopilot(Settings::default().in_dialect(dialect));
        rig.run_ms(200 + CHANGE_MS);
        assert_speaks(&mut rig, dialect);
        assert_obeys(&mut rig);
    }
}

/// Each autopilot has just got its power, as when somebody swaps flight controllers on a bench.
#[test]
fn it_changes_over_when_the_autopilot_is_replaced_by_one_of_the_other_kind() {
    for only in [None, Some(Only::Status), Some(Only::Commands)] {
        let mut rig = Rig::running();
        for (profile, dialect) in [
            (Profile::Plain, Dialect::V0),
            (Profile::Plain, Dialect::Draft),
            (Profile::Plain, Dialect::V0),
            (Profile::Thesis, Dialect::Draft),
            (Profile::Thesis, Dialect::V0),
        ] {
            rig.replace_autopilot(Settings { only, ..Settings::of(profile).in_dialect(dialect) });
            rig.run_ms(CHANGE_MS);
            assert_speaks_after(&mut rig, dialect, &format!("{profile} of {dialect}, only {only:?}"));
            if only != Some(Only::Status) {
                assert_obeys(&mut rig);
            }
        }
    }
}

/// The moment decides how old the last word of the first autopilot is when the node begins to doubt its dialect.
#[test]
fn it_changes_over_in_time_whenever_that_happens() {
    for only in [None, Some(Only::Status), Some(Only::Commands)] {
        for dialect in [Dialect::V0, Dialect::Draft] {
            for moment_ms in [100, 400, 700] {
                let mut rig = Rig::running();
                let settings = Settings { only, ..Settings::default() };
                rig.replace_autopilot(settings.clone().in_dialect(dialect));
                rig.run_ms(3000 + moment_ms);
                rig.replace_autopilot(settings.in_dialect(dialect.other()));
                rig.run_ms(CHANGE_MS);
                let what = format!("only {only:?}, no more {dialect} at {moment_ms} ms");
                assert_speaks_after(&mut rig, dialect.other(), &what);
            }
        }
    }
}

/// 4 bytes of 2014, 6 of March 2015, 8 in between, and the 7 of the thesis.
#[test]
fn a_status_of_the_draft_counts_in_each_of_its_lengths() {
    for length in [4, 6, 7, 8] {
        let mut rig = Rig::running();
        for transfer_id in 0..3 {
            rig.send(message_id(550, 9, transfer_id), &[10, 0, 0, 0, 0, 0, 0, 0][..length]);
            rig.run_ms(if transfer_id < 2 { 1000 } else { 50 });
        }
        assert_speaks(&mut rig, Dialect::Draft);
    }
}

#[test]
fn one_frame_of_the_other_dialect_changes_nothing() {
    let mut rig = Rig::running();
    for (id, data) in [
        (message_id(550, 9, 0), &[10, 0, 0, 0, 0, 0][..]),
        (message_id(760, 9, 0), &[255][..]),
        (message_id(265, 9, 0), &[1, 0x00, 0x3C][..]),
    ] {
        rig.send(id, data);
        rig.run_ms(1500);
        // One of its own, so that the next begins from nothing.
        rig.send_status_from(10);
        rig.run_ms(10);
        assert_speaks(&mut rig, Dialect::V0);
    }
    let mut rig = alone_in_draft();
    rig.send_status_from(10);
    rig.run_ms(1500);
    assert_speaks(&mut rig, Dialect::Draft);
    rig.send(message_id(550, 9, 0), &[10, 0, 0, 0]);
    rig.run_ms(10);
    rig.send_command(1, 0, 1.0);
    rig.run_ms(1500);
    assert_speaks(&mut rig, Dialect::Draft);
}

/// Wrong in one thing each: sender, frame index, last frame, length, direction, type.
#[test]
fn what_is_not_quite_a_status_is_no_evidence() {
    let mut rig = Rig::running();
    let status = message_id(550, 9, 0);
    for (id, length) in [
        (message_id(550, 0, 0), 6),
        (status | 1 << 4, 6),
        (status & !LAST, 8),
        (status, 0),
        (status, 3),
        (status, 5),
        (status | 1 << 17, 6),
        (status & !BROADCAST | 1 << 17, 6),
        (message_id(551, 9, 0), 6),
        (message_id(549, 9, 0), 6),
    ] {
        for _ in 0..6 {
            rig.send(id, &[10, 0, 0, 0, 0, 0, 0, 0][..length]);
            rig.run_ms(100);
        }
        assert_speaks_after(&mut rig, Dialect::V0, &format!("{id:08X} with {length} bytes"));
    }
    let mut rig = alone_in_draft();
    let status = NODE_STATUS | 9;
    for (id, data) in [
        (status, &[10, 0, 0, 0, 0, 0, 0xC0][..]),
        (status, &[10, 0, 0, 0, 0, 0, 0, 0x80][..]),
        (status, &[10, 0, 0, 0, 0, 0, 0, 0x40][..]),
        (status, &[10, 0, 0, 0, 0, 0, 0, 0xE0][..]),
        (NODE_STATUS, &[10, 0, 0, 0, 0, 0, 0, 0xC0][..]),
        (status + 0x100, &[10, 0, 0, 0, 0, 0, 0, 0xC0][..]),
    ] {
        for _ in 0..6 {
            rig.send(id, data);
            rig.run_ms(100);
        }
        assert_speaks_after(&mut rig, Dialect::Draft, &Frame::extended(id, data).to_string());
    }
}

/// Both kinds of autopilot on one bus, which nobody should have: who was first stays the master, and the other is not obeyed.
#[test]
fn while_both_dialects_are_heard_the_node_keeps_to_its_own() {
    for dialect in [Dialect::V0, Dialect::Draft] {
        for only in [None, Some(Only::Status), Some(Only::Commands)] {
            let mut rig = Rig::running();
            rig.replace_autopilot(Settings { only, ..Settings::default().in_dialect(dialect) });
            rig.autopilot().hold(0.5);
            rig.run_ms(CHANGE_MS);
            for round in 0..200 {
                let (transfer_id, other) = (round % 32, dialect.other());
                match (other, only != Some(Only::Commands) && round % 40 == 0, only != Some(Only::Status)) {
                    (Dialect::V0, true, _) => rig.send_status_from(9),
                    (Dialect::Draft, true, _) => rig.send(message_id(550, 9, transfer_id), &[10, 0, 0, 0, 0, 0]),
                    (Dialect::V0, false, true) => rig.send_command(1, 0, -1.0),
                    (Dialect::Draft, false, true) => rig.send(message_id(760, 9, transfer_id), &[0]),
                    (_, false, false) => {}
                }
                rig.run_ms(25);
            }
            assert_speaks(&mut rig, dialect);
            if only != Some(Only::Status) {
                assert!(rig.pulses.iter().all(|pulse| pulse.width_us() == 1750.0), "{dialect}: {:?}", rig.pulses);
            }
        }
    }
}

// ---- the parameter ----

#[test]
fn the_parameter_dialect_is_the_last_one_and_finds_out_by_default() {
    let mut rig = Rig::running();
    let parameter = rig.parameter_at(26);
    assert_eq!(parameter.to_string(), "DIALECT = 0 (0 to 2, default 0)");
    assert_eq!(rig.parameter_at(27).to_string(), "no such parameter");
}

#[test]
fn a_node_that_is_set_to_v0_does_not_follow_an_autopilot_of_the_draft() {
    let mut rig = Rig::running();
    rig.set("DIALECT", 1);
    rig.replace_autopilot(in_draft(Profile::Thesis));
    for _ in 0..3 {
        assert_speaks(&mut rig, Dialect::V0);
    }
    assert_eq!(rig.pulses, []);
    rig.replace_autopilot(Settings::default());
    assert_obeys(&mut rig);
}

#[test]
fn a_node_that_is_set_to_the_draft_speaks_it_whoever_is_there() {
    let mut rig = Rig::running();
    rig.request(&V0Message::ParameterRequest(ParameterRequest {
        value: Value::Integer(2),
        name: b"DIALECT".to_vec(),
        ..ParameterRequest::default()
    }));
    rig.run_ms(CHANGE_MS);
    assert_speaks(&mut rig, Dialect::Draft);
    rig.replace_autopilot(Settings::default());
    for _ in 0..3 {
        assert_speaks(&mut rig, Dialect::Draft);
    }
    assert_eq!(rig.pulses, [], "commands of v0");
    rig.replace_autopilot(in_draft(Profile::Plain));
    assert_obeys(&mut rig);
}

// ---- in the draft ----

/// Uptime in 28 bits, OK in the four above, and sixteen bits of its own; numbers of transfers are counted to 7.
#[test]
fn its_status_is_that_of_march_2015() {
    let mut rig = flying(in_draft(Profile::Plain));
    rig.run_ms(9_500);
    let numbers: Vec<u8> = said(&rig)
        .into_iter()
        .filter_map(|(_, number, message)| matches!(message, Message::NodeStatus(_)).then_some(number))
        .collect();
    assert!(numbers.len() >= 9, "{numbers:?}");
    assert!(numbers.windows(2).all(|pair| pair[1] == (pair[0] + 1) % 8), "{numbers:?}");
    for (at, status) in statuses(&rig) {
        let up_s = sim::elapsed(at).as_secs_f64();
        assert!((f64::from(status.uptime_s) - up_s).abs() < 1.02, "{status} at {up_s:.3} s");
        assert_eq!((status.code, status.vendor_code), (StatusCode::Ok, VendorCode::Short(DRAFT)));
    }
    assert!(rig.broken.is_empty(), "{:?}", rig.broken);
}

#[test]
fn what_is_wrong_is_in_its_status() {
    let mut rig = flying(in_draft(Profile::Plain));
    let is = |code, vendor| {
        move |rig: &Rig| {
            let last = statuses(rig).pop().map(|(_, status)| (status.code, status.vendor_code));
            last == Some((code, VendorCode::Short(vendor)))
        }
    };
    rig.board().set_temperature_c(90.0);
    rig.wait_for("status with a warning", 3000, is(StatusCode::Warning, DRAFT | TEMPERATURE));
    rig.board().set_temperature_c(25.0);
    rig.wait_for("status without", 3000, is(StatusCode::Ok, DRAFT));
}

#[test]
fn its_status_follows_that_of_the_autopilot_and_comes_by_itself_if_there_is_none() {
    let mut rig = flying(in_draft(Profile::Plain));
    rig.run_ms(5_000);
    let from_autopilot = |(at, transfer, message): &(Cycles, sim::dronecan::draft::Transfer, Message)| {
        let is_call = u32::from(transfer.source.get()) != NODE && matches!(message, Message::NodeStatus(_));
        is_call.then_some(*at)
    };
    let calls: Vec<Cycles> = rig.drafts.iter().filter_map(from_autopilot).collect();
    assert!(calls.len() >= 5);
    for call in calls {
        let soon = |(at, _): &(Cycles, NodeStatus)| (call..call + 10 * MS).contains(at);
        assert!(statuses(&rig).iter().any(soon), "no status within 10 ms of the autopilot's");
    }
    rig.detach_autopilot();
    rig.run_ms(100);
    rig.forget();
    rig.run_ms(4_500);
    let times: Vec<Cycles> = statuses(&rig).into_iter().map(|(at, _)| at).collect();
    assert!((4..=5).contains(&times.len()), "{} statuses in 4.5 s", times.len());
    for pair in times.windows(2) {
        let gap = ms_between(pair[0], pair[1]);
        assert!((995.0..1030.0).contains(&gap), "{gap} ms between two statuses");
    }
}

#[test]
fn it_says_its_temperature_in_whole_degrees_at_every_third_status() {
    let mut rig = flying(in_draft(Profile::Thesis));
    // The last is a short to the supply: no sensor is so warm, and a byte has no room for it.
    for (millivolts, expected) in [(250, 25), (800, 80), (5000, 255)] {
        rig.board().set_sensor_millivolts(millivolts);
        rig.run_ms(3_000);
        rig.forget();
        rig.run_ms(12_000);
        let measured: Vec<u8> = measurements(&rig).into_iter().map(|(_, number)| number).collect();
        assert_eq!(measured.len(), 4, "at {millivolts} mV {measured:?}");
        assert!(measured.iter().all(|number| number.abs_diff(expected) <= 1), "at {millivolts} mV {measured:?}");
    }
}

#[test]
fn a_press_of_the_button_publishes_the_count() {
    let mut rig = flying(in_draft(Profile::Plain));
    for count in 1..=3 {
        rig.run_ms(300);
        let before = measurements(&rig).into_iter().filter(|(_, number)| *number == count).count();
        rig.board().press_button(true);
        rig.run_ms(200);
        let after = measurements(&rig).into_iter().filter(|(_, number)| *number == count).count();
        assert_eq!((before, after), (0, 1), "press {count}: {:?}", measurements(&rig));
        rig.board().press_button(false);
    }
}

/// Of the draft's commands, three bytes each: the first of a frame, the second, and the third, which is in the second frame.
#[test]
fn it_finds_its_command_among_those_for_others() {
    for (srv_id, pulse_us) in [(1, 1750.0), (2, 1000.0), (3, 1625.0), (4, 2000.0)] {
        let mut rig = Rig::running();
        rig.set("OUT1_ID", srv_id);
        rig.replace_autopilot(Settings { only: Some(Only::Status), ..in_draft(Profile::Plain) });
        rig.run_ms(CHANGE_MS);
        for frame in quoted("084C2403 BE 8D 01 00 38 02 00 BC").into_iter().chain(quoted("084C241B 03 00 34 04 00 3C"))
        {
            rig.send_frame(frame);
        }
        assert_eq!(rig.settled_pulse_us(), pulse_us, "actuator {srv_id}");
    }
}

/// A step of something else can be before it.
#[test]
fn a_command_of_the_draft_is_in_the_servo_s_register_within_100_us_of_its_end() {
    let mut rig = alone_in_draft();
    let mut cycles: Vec<Cycles> = Vec::new();
    for n in 0..500u32 {
        let pause = rig.now() + MS / 4 + Cycles::from(n * 7919 % 3001) * MS / 1000;
        rig.run_until(pause);
        rig.forget();
        let before = ocr1b(rig.board());
        let [low, high] = half::f16::from_f32((1 + n * 37 % 101) as f32 / 102.0).to_le_bytes();
        rig.send(message_id(265, 9, n), &[1, low, high]);
        while ocr1b(rig.board()) == before && rig.now() < pause + MS {
            rig.run_until(rig.now() + US / 2);
        }
        let written = rig.now();
        rig.run_until(written + US);
        let ended = rig.traffic.iter().rfind(|(_, frame)| frame.data() == [1, low, high]).expect("the command").0;
        cycles.push(written - ended);
    }
    cycles.sort();
    let (median, max) = (cycles[250] / US, cycles[499] / US);
    assert!(median <= 75 && max <= 100, "half within {median} us, the slowest after {max} us");
}

/// Frames of the draft that the node takes, one of each kind.
fn some_of_the_draft(n: u32) -> [(u32, Vec<u8>); 4] {
    let [low, high] = half::f16::from_f32((1 + n * 37 % 101) as f32 / 102.0).to_le_bytes();
    [
        (message_id(265, 9, n), vec![1, low, high]),
        (message_id(265, 9, n), vec![2, low, high, 1, low, high]),
        (message_id(760, 9, n), vec![n as u8]),
        (message_id(550, 9, n), vec![n as u8, 0, 0, 0, 0, 0]),
    ]
}

#[test]
fn frames_of_the_draft_back_to_back_are_all_read_in_order() {
    for only in [Some(0), Some(3), None] {
        let mut rig = alone_in_draft();
        rig.overflows_expected = true;
        let mut meter = Meter::attach(rig.board());
        for n in 0..12_000u32 {
            let mut kinds = some_of_the_draft(n);
            let (id, data) = std::mem::take(&mut kinds[only.unwrap_or((n * 7919 / 16) as usize % 4)]);
            rig.send(id, &data);
        }
        let mut silent_ms = 0;
        while silent_ms < 20 {
            let before = meter.frames;
            rig.run_ms(1);
            meter.collect(rig.board());
            rig.forget();
            silent_ms = if meter.frames == before { silent_ms + 1 } else { 0 };
        }
        // But for those that pass while the controller gets other filters.
        assert!(meter.frames > 11_800, "{only:?}: {}", meter.frames);
        assert_eq!((meter.lost, meter.out_of_order, meter.garbled), (0, 0, 0), "{only:?}: of {}", meter.frames);
    }
}

#[test]
fn a_command_that_cannot_be_followed_leaves_the_servo_where_it_is() {
    let mut rig = alone_in_draft();
    rig.send(message_id(265, 9, 0), &[1, 0x00, 0x38]);
    assert_eq!(rig.settled_pulse_us(), 1750.0);
    let refused: [(u32, &[u8]); 9] = [
        // NaN, infinity, another actuator, no whole command, and for one node only.
        (message_id(265, 9, 1), &[1, 0x00, 0x7E]),
        (message_id(265, 9, 2), &[1, 0x00, 0x7C]),
        (message_id(265, 9, 3), &[2, 0x00, 0x3C]),
        (message_id(265, 9, 4), &[1, 0x00]),
        (message_id(265, 9, 5) | 1 << 17, &[NODE as u8, 1, 0x00, 0x3C]),
        // No byte, two bytes, from nobody, and not the whole of it.
        (message_id(760, 9, 6), &[]),
        (message_id(760, 9, 7), &[255, 255]),
        (message_id(760, 0, 0), &[255]),
        (message_id(760, 9, 1) & !LAST, &[255]),
    ];
    for (id, data) in refused {
        rig.send(id, data);
        assert_eq!(rig.settled_pulse_us(), 1750.0, "{}", Frame::extended(id, data));
    }
    // Four commands with a wrong CRC.
    for frame in quoted("084C2403 BE 8D 01 00 3C 02 00 BC").into_iter().chain(quoted("084C241B 03 00 34 04 00 3C")) {
        rig.send_frame(frame);
    }
    assert_eq!(rig.settled_pulse_us(), 1750.0, "wrong CRC");
    rig.send(message_id(760, 9, 2), &[255]);
    assert_eq!(rig.settled_pulse_us(), 2000.0);
}

#[test]
fn an_autopilot_of_the_draft_that_falls_silent_is_a_failsafe() {
    let mut rig = Rig::running();
    rig.set("OUT1_FS", 1);
    rig.set("OUT1_TIMEOUT", 200);
    rig.replace_autopilot(in_draft(Profile::Thesis));
    rig.autopilot().hold(1.0);
    rig.run_ms(CHANGE_MS);
    assert_eq!(rig.settled_pulse_us(), 2000.0);
    rig.autopilot().set_silent(true);
    rig.run_ms(400);
    assert_eq!(rig.settled_pulse_us(), 1500.0);
    rig.autopilot().set_silent(false);
    rig.run_ms(60);
    assert_eq!(rig.settled_pulse_us(), 2000.0);
}

/// What the node has answered the tool in the draft, with the number of the transfer.
fn answers(rig: &Rig) -> Vec<(u8, Message)> {
    let to_tool = |route| matches!(route, Route::Response(node) if node.get() == TOOL);
    let answers = rig.drafts.iter().filter(|(_, transfer, _)| to_tool(transfer.route));
    answers.map(|(_, transfer, message)| (transfer.transfer_id.get(), message.clone())).collect()
}

#[test]
fn it_says_who_it_is_in_either_dialect() {
    let mut rig = Rig::running();
    let v0 = rig.information();
    rig.replace_autopilot(in_draft(Profile::Plain));
    rig.run_ms(CHANGE_MS);
    for number in 0..8u8 {
        rig.forget();
        rig.send(0x113B_FC08 | u32::from(number), &[NODE as u8]);
        rig.wait_for("answer", PATIENCE_MS, |rig| !answers(rig).is_empty());
        let (answered, Message::NodeInfo(info)) = answers(&rig).remove(0) else { panic!("{:?}", answers(&rig)) };
        assert_eq!(answered, number);
        assert_eq!((&info.name, info.unique_id, info.software), (&v0.name, v0.unique_id, v0.software));
        assert_eq!((info.commit, info.hardware), (v0.commit, v0.hardware));
        assert_eq!(info.status.code, StatusCode::Ok);
        assert!(rig.broken.is_empty(), "{:?}", rig.broken);
    }
    rig.forget();
    rig.send(0x113B_FC08, &[121]);
    rig.send(0x113B_FC09, &[]);
    rig.run_ms(100);
    assert_eq!(answers(&rig), [], "another was asked, and nobody");
}

#[test]
fn it_restarts_when_told_to_with_the_right_number_and_finds_the_draft_again() {
    let mut rig = flying(in_draft(Profile::Plain));
    rig.send_frame(quoted("1183FC0D 78 1F 1B 55 CE AC")[0]);
    rig.run_ms(400);
    assert_eq!(answers(&rig), [(5, Message::Restarting(false))]);
    assert!(!rig.serial.contains("reset:"), "{}", rig.serial);
    rig.forget();
    rig.send_frame(quoted("1183FC0E 78 1E 1B 55 CE AC")[0]);
    rig.wait_for_line("reset:", 400);
    assert_eq!(answers(&rig), [(6, Message::Restarting(true))]);
    rig.run_ms(200 + CHANGE_MS);
    assert_speaks(&mut rig, Dialect::Draft);
    assert_obeys(&mut rig);
}

/// The session that the thesis prints: identifier 398722057 is type 760 of node 1, transfer 1, with the value 1; a byte is 0 to 180
/// degrees. Its filters were 0x11340408 and 0x17C40408, for statuses and commands of node 1; here any node will do.
#[test]
fn the_session_that_the_thesis_prints_goes_as_it_says() {
    let mut rig = flying(in_draft(Profile::Thesis));
    rig.detach_autopilot();
    let degrees = |rig: &mut Rig, id: u32, value: u8| {
        rig.send(id, &[value]);
        rig.run_ms(45);
        (rig.settled_pulse_us() - 1000.0) * 180.0 / 1000.0
    };
    assert!((degrees(&mut rig, 398_722_057, 1) - 180.0 / 255.0).abs() < 0.1);
    for value in 0..=255u8 {
        let id = message_id(760, if value % 2 == 0 { 1 } else { 77 }, value.into());
        let seen = degrees(&mut rig, id, value);
        assert!((seen - f64::from(value) * 180.0 / 255.0).abs() < 0.1, "{value}: {seen} degrees");
    }
    assert!(rig.serial.contains("rx thesis.ServoCommand from 1 tid 1: 1, pulse 1004.0 us"), "{}", rig.serial);
}
