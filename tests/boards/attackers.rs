//! Nodes that attack the commander of an output or a client's work: with commands that are refused,
//! with statuses of their own, with changes while commands come in. Most run on the Uno's program
//! with eight outputs.

use bench::avr::{Firmware, Pulse, ResetCause};
use bench::can::Frame;
use bench::dronecan::{Message, NumberAndText, ParameterRequest, TransferId, Value};
use bench::{Cycles, Noise, bootloader};
use rig::{
    ARMED, ARMING_STATUS, ARRAY_COMMAND, MS, NODE_STATUS, NOT_ARMED, NOT_SAFE, PWM, Program,
    RAW_COMMAND, Rig, SAFE, SAFETY_STATE, US, array_command,
};

/// The autopilot, and another node.
const AUTOPILOT: u32 = 10;
const OTHER: u32 = 13;

/// An Uno with eight outputs. The first are motors with indices from 0, the others servos whose ID
/// is their number.
struct Hub {
    rig: Rig,
    transfer_id: u8,
}

impl Hub {
    fn with_motors(motors: i64) -> Hub {
        let mut rig = Program::With("full").running();
        rig.set("OUT_COUNT", 8);
        for n in 1..=motors {
            rig.set(&format!("OUT{n}_TYPE"), 1);
            rig.set(&format!("OUT{n}_ID"), n - 1);
        }
        rig.save();
        rig.restart();
        Hub { rig, transfer_id: 0 }
    }

    fn next_transfer_id(&mut self) -> TransferId {
        self.transfer_id = (self.transfer_id + 1) % 32;
        TransferId::new(self.transfer_id)
    }

    /// Sends a message of one frame.
    fn send(&mut self, id: u32, payload: &[u8]) {
        let tail = 0xC0 | self.next_transfer_id().get();
        self.rig.send(id, &[payload, &[tail]].concat());
    }

    /// Commands the width of a servo's pulse.
    fn position(&mut self, source: u32, id: u8, us: f32) {
        let transfer_id = self.next_transfer_id().get();
        for data in array_command(&[(id, PWM, us)], transfer_id) {
            self.rig.send(ARRAY_COMMAND | source, &data);
        }
    }

    /// For this time the autopilot sends a command for four motors each 20 ms, and its statuses
    /// twice a second. `beside` does what others do in each 20 ms.
    fn fly(&mut self, ms: u64, mut beside: impl FnMut(&mut Hub)) {
        for slot in 0..ms / 20 {
            if slot % 25 == 0 {
                self.send(NODE_STATUS | AUTOPILOT, &[0; 7]);
                self.send(ARMING_STATUS | AUTOPILOT, &[ARMED]);
            }
            self.rig.send_raw_command(AUTOPILOT, &[4096; 4]);
            self.rig.run_ms(2);
            beside(self);
            self.rig.run_ms(18);
        }
    }

    /// The motors have run at half throttle all the time.
    #[track_caller]
    fn assert_motors_run(&mut self) {
        for (motor, pulses) in self.rig.take_pulses().iter().take(4).enumerate() {
            assert!(pulses.len() > 5, "motor {motor} has {} pulses", pulses.len());
            let other = pulses.iter().find(|pulse| pulse.width_us().round() != 1500.0);
            assert!(other.is_none(), "motor {motor}: {other:?}\n{}", self.rig.serial);
        }
    }
}

// ---- transfers of several frames ----

/// A node completes a list and begins one of each of two types just before each list of the
/// autopilot. It could take both lanes for lists. Its RawCommands are of use to the node, so that
/// it is as trusted as the autopilot and precedes it half of the time.
#[test]
fn a_node_that_takes_both_lanes_before_each_list_breaks_at_most_three_in_a_row() {
    let mut hub = Hub::with_motors(1);
    let others = [(9, 0, 0.0); 15];
    let long_list = |hub: &mut Hub, us, transfer_id| {
        let entries: Vec<_> = (1..=15).map(|id| (id, PWM, us)).collect();
        for data in array_command(&entries, transfer_id) {
            hub.rig.send(ARRAY_COMMAND | AUTOPILOT, &data);
        }
    };
    long_list(&mut hub, 1_100.0, 31);
    hub.rig.run_ms(20);
    let (mut count, mut broken) = (0, 0);
    let widths = (0..150).map(|n| 1_100.0 + 5.0 * n as f32);
    for (us, transfer_id) in widths.zip((0..32).cycle()) {
        // These end what it began before.
        hub.rig.send_raw_command(OTHER, &[0; 8]);
        for data in array_command(&others[..2], transfer_id) {
            hub.rig.send(ARRAY_COMMAND | OTHER, &data);
        }
        let first = &array_command(&others, (transfer_id + 1) % 32)[0];
        hub.rig.send(ARRAY_COMMAND | OTHER, first);
        hub.rig.send(RAW_COMMAND | OTHER, &[0, 0, 1, 0, 0, 2, 0, 0x80 | transfer_id]);
        hub.rig.run_ms(2);
        long_list(&mut hub, us, transfer_id);
        hub.rig.run_ms(18);
        let pulses = hub.rig.take_pulses();
        if us < 1_200.0 {
            continue;
        }
        count += pulses[1..].iter().flatten().count();
        for pulse in pulses[1..].iter().flatten() {
            // A pulse may begin before the list of its period.
            let old_lists = (f64::from(us) - pulse.width_us()) / 5.0 - 1.0;
            assert!(old_lists < 3.2, "{} us after {us}", pulse.width_us());
            broken += usize::from(old_lists > 0.2);
        }
    }
    assert!(count > 7 * 120, "{count} pulses");
    assert!(broken * 2 < count && broken != 0, "{broken} of {count} pulses are old");
}

// ---- rights of nodes that do not command the output ----

#[test]
fn another_commander_s_statuses_do_not_stop_the_motors_of_the_autopilot() {
    let mut hub = Hub::with_motors(4);
    hub.fly(1000, |_| {});
    hub.position(11, 7, 1300.0);
    hub.rig.run_ms(5);
    hub.rig.take_pulses();
    let mut slot = 0;
    hub.fly(6000, |hub| {
        slot += 1;
        hub.position(11, 7, 1300.0);
        if slot % 25 == 0 {
            hub.send(ARMING_STATUS | 11, &[NOT_ARMED]);
        }
    });
    hub.assert_motors_run();
}

/// Each of them is the last commander when the autopilot arms.
#[test]
fn nodes_that_command_other_outputs_do_not_keep_the_autopilot_from_arming_its_motors() {
    for others in 1..=3 {
        let mut hub = Hub::with_motors(4);
        let others = |hub: &mut Hub| {
            for other in 0..others {
                hub.position(11 + other, 5 + other as u8, 1300.0);
            }
        };
        others(&mut hub);
        hub.fly(1000, others);
        hub.rig.take_pulses();
        hub.fly(6000, others);
        hub.assert_motors_run();
    }
}

/// Its commands are refused because its own vehicle is disarmed, as those of an autopilot on a
/// bench.
#[test]
fn a_node_whose_commands_are_refused_may_not_turn_the_safety_switch_on() {
    let mut hub = Hub::with_motors(4);
    hub.fly(1000, |_| {});
    hub.rig.take_pulses();
    hub.fly(1000, |hub| {
        hub.rig.send_raw_command(OTHER, &[8191; 4]);
        hub.send(SAFETY_STATE | OTHER, &[SAFE]);
        hub.rig.send_raw_command(OTHER, &[8191; 4]);
        hub.send(ARMING_STATUS | OTHER, &[NOT_ARMED]);
    });
    hub.assert_motors_run();
    // The autopilot may.
    hub.send(SAFETY_STATE | AUTOPILOT, &[SAFE]);
    assert_eq!(hub.rig.widths_us()[..4], [Some(1000.0); 4]);
}

#[test]
fn a_safety_switch_that_two_nodes_turned_on_is_not_turned_off_by_one() {
    let mut hub = Hub::with_motors(0);
    hub.rig.set("SAFE_MODE", 0);
    for (source, id) in [(AUTOPILOT, 5), (11, 7)] {
        hub.position(source, id, 1200.0);
        hub.rig.run_ms(5);
    }
    for (source, state) in [(11, SAFE), (AUTOPILOT, SAFE), (11, NOT_SAFE)] {
        hub.send(SAFETY_STATE | source, &[state]);
        hub.rig.run_ms(5);
    }
    hub.position(AUTOPILOT, 5, 1900.0);
    assert_eq!(hub.rig.widths_us()[4], Some(1200.0), "the autopilot's is still on");
    hub.rig.run_ms(5000);
    hub.position(AUTOPILOT, 5, 1900.0);
    assert_eq!(hub.rig.widths_us()[4], Some(1900.0), "neither says that it is on");
}

/// A node may turn the switch on as long as an output followed its command last.
#[test]
fn a_node_whose_output_another_commands_since_then_may_not_turn_the_safety_switch_on() {
    let mut hub = Hub::with_motors(0);
    for (taken, expected_us) in [(5, None), (7, Some(1900.0))] {
        hub.position(OTHER, 7, 1200.0);
        hub.rig.run_ms(5);
        // Longer than any failsafe and MOT_TIMEOUT.
        hub.rig.run_ms(5_000);
        hub.position(AUTOPILOT, taken, 1300.0);
        hub.rig.run_ms(5);
        hub.send(SAFETY_STATE | OTHER, &[SAFE]);
        hub.rig.run_ms(5);
        hub.position(AUTOPILOT, taken, 1900.0);
        let widths = hub.rig.widths_us();
        assert_eq!(widths[usize::from(taken) - 1], expected_us, "{}", hub.rig.serial);
        // What the switch says counts for four to five seconds.
        hub.rig.run_ms(5_500);
    }
}

#[test]
fn a_servo_follows_a_commander_with_another_node_id_at_once_and_motors_follow_once_it_is_armed() {
    let mut hub = Hub::with_motors(4);
    hub.fly(1000, |hub| hub.position(AUTOPILOT, 5, 1200.0));
    let begin = hub.rig.now();
    hub.rig.take_pulses();
    for slot in 0..50 {
        if slot == 20 {
            hub.send(ARMING_STATUS | 20, &[ARMED]);
        }
        hub.rig.send_raw_command(20, &[4096; 4]);
        hub.position(20, 5, 1300.0);
        hub.rig.run_ms(20);
    }
    let pulses = hub.rig.take_pulses();
    let first_ms = |output: usize, us: f64, after_ms: u64| {
        let is_it =
            |pulse: &&Pulse| pulse.width_us().round() == us && pulse.start >= begin + after_ms * MS;
        let first = pulses[output].iter().find(is_it).expect("such a pulse");
        (first.start - begin) / MS
    };
    assert!(first_ms(4, 1300.0, 0) <= 25, "the servo");
    let stops_ms = first_ms(0, 1000.0, 0);
    // The last command came up to a slot before.
    assert!((180..=240).contains(&stops_ms), "MOT_TIMEOUT: {stops_ms} ms");
    let runs_ms = first_ms(0, 1500.0, stops_ms);
    assert!((400..=430).contains(&runs_ms), "armed again: {runs_ms} ms");
}

#[test]
fn anonymous_frames_with_any_discriminator_move_nothing() {
    for program in [Program::Preset, Program::With("full")] {
        let mut rig = program.running();
        rig.send_command(1, PWM, 1234.0);
        assert_eq!(rig.settled_pulse_us(), 1234.0);
        let mut random = Noise::new(7);
        rig.pulses.clear();
        for _ in 0..2000 {
            let discriminator = (random.below(1 << 14) as u32) << 10;
            let data_type = [random.below(4) as u32, 1010][random.below(2) as usize];
            let priority = (random.below(32) as u32) << 24;
            let tail = [0xC0, 0x80, 0x60, 0x20, 0x40][random.below(5) as usize];
            let id = priority | (discriminator | data_type << 8) & 0x00FF_FF00;
            rig.send(id, &[1, PWM, 0x00, 0x64, tail | random.below(32) as u8]);
        }
        rig.run_ms(500);
        assert!(rig.pulses.len() > 20);
        assert!(rig.pulses.iter().all(|pulse| pulse.width_us() == 1234.0));
    }
}

// ---- changes while commands come in ----

#[test]
fn an_output_whose_id_changes_while_a_command_comes_in_does_not_follow_it() {
    let mut hub = Hub::with_motors(0);
    let list: Vec<_> = (1..=8).map(|id| (id, PWM, 1000.0 + 100.0 * f32::from(id))).collect();
    // To an ID that no command has, and to that of another output.
    for id in [60, 5] {
        let frames = array_command(&list, id);
        let (last, first) = frames.split_last().expect("several frames");
        for data in first {
            hub.rig.send(ARRAY_COMMAND | AUTOPILOT, data);
        }
        hub.rig.set("OUT3_ID", id.into());
        hub.rig.send(ARRAY_COMMAND | AUTOPILOT, last);
        let widths = hub.rig.widths_us();
        assert_eq!((widths[1], widths[2], widths[3]), (Some(1200.0), None, Some(1400.0)), "{id}");
        hub.rig.set("OUT3_ID", 3);
    }
}

/// Another node's invalid commands for the same outputs come while the autopilot's entries wait to
/// be followed.
#[test]
fn invalid_commands_right_after_a_list_replace_none_of_its_entries() {
    let mut hub = Hub::with_motors(0);
    let mut random = Noise::new(11);
    for round in 0..20u8 {
        let width = |output: u8| f64::from(1000 + 100 * u16::from(output) + 10 * u16::from(round));
        let list: Vec<_> = (1..=8).map(|id| (id, PWM, width(id) as f32)).collect();
        for data in array_command(&list, round) {
            hub.rig.send(ARRAY_COMMAND | AUTOPILOT, &data);
        }
        let first = random.below(8) as u8;
        for n in 0..8 {
            let id = 1 + (first + n) % 8;
            let data = &array_command(&[(id, PWM, f32::NAN)], (8 * round + n) % 32)[0];
            hub.rig.send(ARRAY_COMMAND | OTHER, data);
        }
        let expected: Vec<_> = (1..=8).map(|id| Some(width(id))).collect();
        assert_eq!(hub.rig.widths_us(), expected, "round {round}, from output {}", first + 1);
    }
}

/// To apply parameters the node takes a turn for each output, and commands come in between.
#[test]
fn while_a_parameter_is_set_each_output_follows_its_commands() {
    let mut hub = Hub::with_motors(0);
    let mut random = Noise::new(3);
    for round in 0..60 {
        let (id, us) = (2 + random.below(7) as u8, 1000.0 + 10.0 * round as f32);
        hub.rig.request(&Message::ParameterRequest(ParameterRequest {
            index: 0,
            value: Value::Integer(round),
            name: b"TEMP_ID".to_vec(),
        }));
        // The request has three frames, 400 us or so.
        let at = hub.rig.now() + (350 + random.below(800)) * US;
        let data = &array_command(&[(id, PWM, us)], round as u8 % 32)[0];
        let frame = Frame::extended(ARRAY_COMMAND | AUTOPILOT, data);
        hub.rig.peer.borrow_mut().send_at(at, frame);
        let width = hub.rig.widths_us()[usize::from(id) - 1];
        assert_eq!(width, Some(us.into()), "round {round}, ID {id}");
    }
}

#[test]
fn a_change_of_type_or_id_ends_the_pulse_and_is_refused_while_armed() {
    for (name, value) in [("OUT5_TYPE", 1), ("OUT5_ID", 60)] {
        let mut hub = Hub::with_motors(4);
        hub.fly(500, |hub| hub.position(AUTOPILOT, 5, 1200.0));
        let before = hub.rig.get(name);
        let answer = hub.rig.request_value(name, Value::Integer(value));
        assert_eq!(answer, Value::Integer(before), "{name} while armed");
        hub.send(ARMING_STATUS | AUTOPILOT, &[NOT_ARMED]);
        assert_eq!(hub.rig.widths_us()[4], Some(1200.0), "{name}");
        hub.rig.set(name, value);
        assert_eq!(hub.rig.widths_us()[4], None, "{name}");
    }
}

#[test]
fn motors_follow_raw_commands_whose_length_changes_each_time() {
    let mut hub = Hub::with_motors(4);
    hub.fly(500, |_| {});
    let mut random = Noise::new(4);
    for round in 0..60 {
        let mut expected = [0.0; 4];
        for _ in 0..1 + random.below(4) {
            let (len, throttle) = (random.below(21) as usize, random.below(8000) as i16);
            hub.rig.send_raw_command(AUTOPILOT, &vec![throttle; len]);
            for (motor, us) in expected.iter_mut().enumerate() {
                let throttle = if motor < len { throttle } else { 0 };
                *us = 1000.0 + f64::from(throttle) * 1000.0 / 8191.0;
            }
            let pause_us = [0, random.below(1500)][random.below(2) as usize];
            hub.rig.run_until(hub.rig.now() + pause_us * US);
        }
        if round % 5 == 0 {
            hub.send(ARMING_STATUS | AUTOPILOT, &[ARMED]);
        }
        for (motor, (us, expected)) in hub.rig.widths_us().iter().zip(expected).enumerate() {
            let us = us.expect("a pulse");
            assert!((us - expected).abs() <= 1.5, "round {round}, motor {motor}: {us} {expected}");
        }
    }
}

/// OUTn_FS 2 would give a pulse, which may open a parachute.
#[test]
fn a_restart_gives_no_pulse_to_outputs_that_were_never_commanded() {
    let mut hub = Hub::with_motors(0);
    for output in 1..=8 {
        hub.rig.set(&format!("OUT{output}_FS"), 2);
    }
    hub.rig.save();
    hub.rig.take_pulses();
    hub.rig.restart();
    assert!(hub.rig.take_pulses().iter().all(Vec::is_empty));
}

#[test]
fn the_failsafe_of_one_output_leaves_the_node_on_the_bus_while_another_is_commanded() {
    let mut hub = Hub::with_motors(0);
    hub.position(AUTOPILOT, 6, 1200.0);
    hub.rig.run_ms(5);
    hub.rig.forget();
    for _ in 0..100 {
        hub.position(AUTOPILOT, 5, 1200.0);
        hub.rig.run_ms(20);
    }
    assert!(hub.rig.serial.contains("FAILSAFE"), "{}", hub.rig.serial);
    // What the node logs when it has left the bus for new filters.
    assert!(!hub.rig.serial.contains("CAN: running"), "{}", hub.rig.serial);
}

// ---- updates while commands begin ----

/// The board gets the bootloader, too. Each reset starts the program, so that the hand-over is a
/// restart.
fn hub_with_bootloader() -> Hub {
    let mut hub = Hub::with_motors(0);
    let loader = bootloader(hub.rig.board().wiring())
        .and_then(|hex| Firmware::read_hex(&hex))
        .unwrap_or_else(|error| panic!("{error:#}"));
    for (address, bytes) in &loader.flash {
        hub.rig.board().avr_mut().load_flash(*address, bytes);
    }
    hub.rig.board().reset(ResetCause::PowerOn);
    hub.rig.run_ms(200);
    hub
}

#[test]
fn the_bootloader_s_record_of_the_bus_follows_the_saved_bit_rate() {
    /// The record in EEPROM: node ID, three registers, CRC.
    const BUS: std::ops::Range<usize> = 0x18..0x1E;
    let mut hub = hub_with_bootloader();
    let record = |hub: &mut Hub| {
        hub.rig.run_ms(300);
        hub.rig.board().avr().eeprom()[BUS].to_vec()
    };
    let first = record(&mut hub);
    assert_eq!(first[0], 120);
    hub.rig.set("CAN_BAUDRATE", 125_000);
    assert_eq!(record(&mut hub), first, "not saved");
    hub.rig.save();
    let second = record(&mut hub);
    assert!(second[0] == 120 && second[1..] != first[1..], "{first:02X?}, {second:02X?}");
    hub.rig.set("CAN_BAUDRATE", 1_000_000);
    hub.rig.save();
    assert_eq!(record(&mut hub), first);
}

/// Asks for an update and commands an output a new width `delay` later. Returns the time of the
/// restart, if there is one, and that of the first pulse of this width, both after the request.
fn update_and_command(hub: &mut Hub, delay: Cycles, us: f32) -> (Option<Cycles>, Option<Cycles>) {
    let resets = hub.rig.board().avr().resets().len();
    hub.rig.take_pulses();
    let request = NumberAndText { number: 0, text: b"fw.bin".to_vec() };
    let begin = hub.rig.now();
    hub.rig.request(&Message::BeginUpdate(request));
    hub.rig.run_until(begin + delay);
    let mut first = None;
    for _ in 0..60 {
        hub.position(AUTOPILOT, 5, us);
        hub.rig.run_ms(20);
        let pulses = hub.rig.take_pulses().swap_remove(4);
        let is_new = |pulse: &&Pulse| pulse.width_us().round() == f64::from(us);
        first = first.or(pulses.iter().find(is_new).map(|pulse| pulse.start - begin));
    }
    let reset = hub.rig.board().avr().resets_after(resets).first().map(|reset| reset.at - begin);
    (reset, first)
}

#[test]
fn the_bootloader_does_not_run_once_an_output_follows_commands() {
    let mut hub = hub_with_bootloader();
    let (mut restarts, mut random) = (0, Noise::new(5));
    for round in 0..9 {
        // The first commands come with the answer, with the restart or between.
        let delay = random.below([3, 60, 600][round % 3] * MS);
        let (reset, pulse) = update_and_command(&mut hub, delay, 1200.0 + 30.0 * round as f32);
        restarts += usize::from(reset.is_some());
        // The restarted program follows the next command.
        let is_safe = reset.is_none_or(|reset| pulse.is_none_or(|pulse| reset < pulse));
        assert!(is_safe, "{delay} cycles: restart at {reset:?}, pulse at {pulse:?}");
        hub.rig.run_ms(4000);
    }
    println!("{restarts} of 9 began");
    assert!((1..9).contains(&restarts), "both occur: {restarts}");
}

// ---- commands in step with the pulses ----

/// The node hands new widths over to the interrupt of the pulses, which takes them shortly before
/// the period ends. A command for each period that comes at that very moment must not hold the
/// widths of the commands before it back, however often that happens.
#[test]
fn at_any_phase_of_the_period_commands_of_50_hz_are_in_the_pulses_of_the_next() {
    let mut hub = Hub::with_motors(0);
    hub.position(AUTOPILOT, 1, 1000.0);
    hub.rig.run_ms(100);
    let start = hub.rig.take_pulses()[0].last().expect("a pulse").start;
    let mut commanded = vec![];
    let mut n = 0u16;
    for phase_us in (900..1500).step_by(10) {
        let periods = (hub.rig.now() - start) / (20 * MS) + 2;
        let begin = start + periods * 20 * MS - phase_us * US;
        for at in (0..8).map(|period| begin + period * 20 * MS) {
            n += 1;
            let us = 1000.0 + f32::from(n);
            let entries: Vec<_> = (1..=8).map(|id| (id, PWM, us)).collect();
            for data in array_command(&entries, n as u8 % 32) {
                let frame = Frame::extended(ARRAY_COMMAND | AUTOPILOT, &data);
                hub.rig.peer.borrow_mut().send_at(at, frame);
            }
            commanded.push((at, f64::from(us)));
            hub.rig.run_until(at + 15 * MS);
        }
        for pulse in &hub.rig.take_pulses()[0] {
            // A command has five frames, and the outputs take a turn each.
            let before = commanded.iter().rfind(|(at, _)| at + 23 * MS < pulse.start);
            let (us, oldest_us) = (pulse.width_us(), before.map_or(1000.0, |before| before.1));
            assert!(us >= oldest_us, "{phase_us} us before the period: {us}, not {oldest_us} us");
        }
    }
}
