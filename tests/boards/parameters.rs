//! Parameters: their names and ranges, the time when they take effect, and that the EEPROM always
//! has the complete old or new set.

use bench::corner::Corner;
use bench::dronecan::{Message, Opcode, ParameterRequest, Value};
use rig::documented::parameters;
use rig::manage::{SAVE_TIMEOUT_MS, integer, ms_between};
use rig::status::{CRITICAL, OK, PARAMETERS_LOST};
use rig::{MS, Program, Rig, started};

/// Parameters that the tests mark with other values in each generation, from all parts of the
/// table. They do not affect the tests.
const MARKED: [&str; 6] =
    ["OUT1_ID", "OUT1_TRIM", "OUT1_FS_PWM", "TEMP_ID", "TEMP_MIN", "OUT1_RANGE"];

fn mark(generation: i64) -> [i64; 6] {
    let g = generation % 200;
    [g + 3, 1300 + g, 1700 + g, 0x5A00 ^ ((g * 257) & 0xFFFF), -(g % 50) - 5, 250 - g]
}

fn set_marks(rig: &mut Rig, generation: i64) {
    for (name, value) in MARKED.into_iter().zip(mark(generation)) {
        rig.set(name, value);
    }
}

#[track_caller]
fn marks(rig: &mut Rig) -> [i64; 6] {
    MARKED.map(|name| rig.get(name))
}

#[track_caller]
fn assert_defaults(rig: &mut Rig) {
    let expected: Vec<(String, i64)> =
        parameters().iter().map(|(name, default, ..)| (String::from(*name), *default)).collect();
    assert_eq!(rig.parameters(), expected);
}

#[test]
fn parameters_have_the_documented_names_ranges_and_defaults() {
    let mut rig = Rig::running();
    for (index, &(name, default, min, max)) in parameters().iter().enumerate() {
        let reported = rig.parameter_at(index as u16);
        assert!(name.len() <= 16);
        assert_eq!(reported.name(), name);
        let numbers =
            [&reported.value, &reported.default, &reported.min, &reported.max].map(integer);
        assert_eq!(numbers, [default, default, min, max], "{name}");
    }
    assert!(rig.parameter_at(parameters().len() as u16).name.is_empty());
}

#[test]
fn saved_parameters_survive_a_restart_and_a_power_cut() {
    let mut rig = Rig::running();
    set_marks(&mut rig, 1);
    rig.save();
    rig.restart();
    assert_eq!(marks(&mut rig), mark(1));
    rig.cut_power();
    rig.wait_until_up();
    assert_eq!(marks(&mut rig), mark(1));
    let ends = other_values();
    rig.set_all(&ends);
    rig.save();
    rig.restart();
    for (name, end) in ends {
        assert_eq!(rig.get(name), end, "{name}");
    }
}

#[test]
fn unsaved_parameters_are_lost_at_a_restart() {
    let mut rig = Rig::running();
    set_marks(&mut rig, 1);
    rig.save();
    set_marks(&mut rig, 2);
    rig.restart();
    assert_eq!(marks(&mut rig), mark(1));
}

#[test]
fn erasing_restores_the_defaults_at_once_and_after_a_restart() {
    let mut rig = Rig::running();
    set_marks(&mut rig, 1);
    rig.save();
    assert!(rig.execute(Opcode::ERASE));
    assert_defaults(&mut rig);
    rig.restart();
    assert_defaults(&mut rig);
    assert_eq!(rig.next_status(), (OK, 0), "an erased EEPROM is not reported as lost");
}

#[test]
fn a_node_id_takes_effect_at_the_next_start() {
    let mut rig = Rig::running();
    rig.set("CAN_NODE", 42);
    rig.save();
    rig.run_ms(1500);
    assert!(!rig.statuses().is_empty(), "the node must keep ID 120 until the restart");
    rig.cut_power();
    rig.run_ms(1500);
    assert!(rig.statuses().is_empty());
    assert!(!rig.frames(rig::STATUS_OF_NODE & !0x7F | 42).is_empty());
    rig.request_to(42, &Message::NodeInfoRequest);
    rig.run_ms(50);
    assert!(matches!(rig.answers().pop(), Some((_, _, Message::NodeInfo(_)))));
    rig.send_command(1, 0, 0.5);
    assert_eq!(rig.settled_pulse_us(), 1750.0);
}

#[test]
fn a_bit_rate_takes_effect_at_the_next_start() {
    // CNF1 to CNF3, and the sample point in thousandths of a bit, as in docs/wiring.md.
    const LONG_BIT: ([u8; 2], u32) = ([0xBC, 0x01], 875);
    const SHORT_BIT: ([u8; 2], u32) = ([0x91, 0x01], 750);
    let of_crystal = match rig::board().crystal_mhz {
        16 => [(500_000, 0x00, LONG_BIT), (250_000, 0x01, LONG_BIT), (125_000, 0x03, LONG_BIT)],
        _ => [(500_000, 0x00, SHORT_BIT), (250_000, 0x00, LONG_BIT), (125_000, 0x01, LONG_BIT)],
    };
    for (rate, cnf1, (cnf2_and_3, sample_point)) in of_crystal {
        let mut rig = Rig::running();
        rig.set("CAN_BAUDRATE", rate);
        rig.save();
        rig.run_ms(1200);
        assert!(!rig.statuses().is_empty(), "the node must keep its rate until the restart");
        // Other nodes see its frames at another rate as errors.
        rig.connect_node(false);
        rig.cut_power();
        rig.run_ms(300);
        let chip = rig.board().chip();
        let chip = chip.borrow();
        assert_eq!(chip.register(0x2A), cnf1, "{rate} bit/s");
        assert_eq!([0x29, 0x28].map(|address| chip.register(address)), cnf2_and_3, "{rate} bit/s");
        assert_eq!(chip.sample_point_permille(), sample_point, "{rate} bit/s");
    }
}

/// During the save the node follows commands, its pulses are complete, and other requests wait.
#[test]
fn saving_does_not_delay_commands_or_pulses() {
    let mut rig = Rig::running();
    set_marks(&mut rig, 7);
    rig.set("OUT1_ID", 1);
    rig.send_command(1, 4, 1500.0);
    rig.run_ms(60);
    rig.forget();
    let begun = rig.now();
    rig.request(&Message::ExecuteOpcode(Opcode::SAVE));
    // The program with all features has three times as many parameters.
    let (commands, limit_ms) =
        if rig::has_all_features() { (400u16, 800.0) } else { (200u16, 500.0) };
    for n in 0..commands {
        rig.send_command(1, 4, f32::from(1200 + n));
        let next = rig.now() + 5 * MS / 2;
        rig.run_until(next);
    }
    let answers = rig.answers();
    assert!(matches!(answers[..], [(_, _, Message::OpcodeExecuted(true))]), "{answers:?}");
    assert!(ms_between(begun, answers[0].0) < limit_ms, "{} ms", ms_between(begun, answers[0].0));
    assert!(
        rig.pulses.len() >= usize::from(commands) / 8 - 1
            && rig.pulses.is_sorted_by_key(|pulse| pulse.width_cycles)
    );
    assert!(rig.pulses.iter().all(|pulse| pulse.period_cycles.unwrap_or(20 * MS) == 20 * MS));
    // The serial monitor cannot log that many commands.
    rig.run_ms(300);
    rig.board().avr_mut().serial_send(b"?");
    rig.wait_for_line(&format!("commands followed {}, frames refused 0", commands + 1), 300);
}

/// Sets parameters, and says how long the save takes, at the typical time of the EEPROM.
fn ms_of_save(rig: &mut Rig, values: &[(&'static str, i64)]) -> f64 {
    rig.set_all(values);
    rig.forget();
    let begun = rig.now();
    rig.request(&Message::ExecuteOpcode(Opcode::SAVE));
    rig.wait_for("the response to a SAVE", 2000, |rig| !rig.answers().is_empty());
    ms_between(begun, rig.answers()[0].0)
}

/// A value for each parameter that differs from its default. With these changed the node would
/// answer under another ID, at another bit rate or in another dialect; and eight outputs do not
/// fit.
fn other_values() -> Vec<(&'static str, i64)> {
    let mut values: Vec<_> = parameters()
        .iter()
        .filter(|(name, ..)| !["CAN_NODE", "CAN_BAUDRATE", "OUT_COUNT"].contains(name))
        .map(|&(name, default, min, max)| (name, if default == max { min } else { max }))
        .collect();
    // After OUT1_TYPE, which they need.
    values.sort_by_key(|(name, _)| name.starts_with("ESC_"));
    values
}

/// libuavcan, which PX4 has, waits for a second. An EEPROM may take longer than the typical 3.4 ms
/// a byte.
#[test]
fn the_longest_save_ends_long_before_a_client_gives_up() {
    let typical_ms = if rig::has_all_features() { 700.0 } else { 300.0 };
    let limit_ms = typical_ms * rig::corner().eeprom_ms() / Corner::default().eeprom_ms();
    let mut rig = Rig::running();
    let values = other_values();
    let took_ms = ms_of_save(&mut rig, &values);
    let count = values.len();
    println!("{took_ms} ms");
    assert!(
        took_ms < limit_ms,
        "a SAVE of {count} changed parameters took {took_ms:.1} ms, and the limit is {limit_ms}: \
         docs/contributing.md, Add a parameter"
    );
    // The next one while the older copy is still being made equal.
    let defaults: Vec<_> =
        parameters().iter().map(|&(name, default, ..)| (name, default)).collect();
    let again_ms = ms_of_save(&mut rig, &defaults);
    println!("{again_ms} ms");
    assert!(
        again_ms < limit_ms,
        "a SAVE at once after another one took {again_ms:.1} ms, and the limit is {limit_ms}"
    );
}

#[test]
fn a_save_of_up_to_three_parameters_takes_a_tenth_of_a_second_at_most() {
    let mut rig = Rig::running();
    rig.save();
    rig.run_ms(1000);
    for count in 1..=3 {
        // Both bytes of each differ from those of the round before.
        let n = 0x0101 * count as i64;
        let values = [("OUT1_MAX", 1000 + n), ("OUT1_TIMEOUT", 9000 - n), ("TEMP_ID", 0x5A5A + n)];
        let took_ms = ms_of_save(&mut rig, &values[..count]);
        println!("{took_ms} ms");
        assert!(
            took_ms < 100.0,
            "a SAVE of {count} changed parameters took {took_ms} ms, and the limit is 100"
        );
        rig.run_ms(REST_MS);
    }
}

#[test]
fn a_parameter_set_during_a_save_is_saved_completely_or_not_at_all() {
    for delay_ms in [1, 20, 60, 100, 140] {
        let mut rig = Rig::running();
        set_marks(&mut rig, 1);
        rig.save();
        set_marks(&mut rig, 2);
        rig.request(&Message::ExecuteOpcode(Opcode::SAVE));
        rig.run_ms(delay_ms);
        let request =
            ParameterRequest { index: 0, value: Value::Integer(99), name: b"OUT1_ID".to_vec() };
        rig.request(&Message::ParameterRequest(request));
        rig.run_ms(SAVE_TIMEOUT_MS);
        rig.cut_power();
        rig.wait_until_up();
        let mut reported = marks(&mut rig);
        assert!([mark(2)[0], 99].contains(&reported[0]), "{reported:?}");
        reported[0] = mark(2)[0];
        assert_eq!(reported, mark(2), "after {delay_ms} ms");
    }
}

/// Cuts the power during a save: at the beginning and at the end of each byte's write. Afterwards
/// the node has the complete old or the complete new set, and reports no loss.
#[test]
fn a_power_cut_at_any_byte_of_a_save_leaves_the_old_or_the_new_set() {
    // The write of a byte takes 3.4 ms.
    const STEP: u64 = 17 * MS / 10;
    let mut rig = Rig::running();
    set_marks(&mut rig, 0);
    rig.save();
    let (mut generation, mut in_force, mut delay) = (0, 0, 0);
    let (mut old, mut new) = (0, 0);
    loop {
        generation += 1;
        set_marks(&mut rig, generation);
        rig.forget();
        rig.request(&Message::ExecuteOpcode(Opcode::SAVE));
        // Waits until the node has received the request, because otherwise the peer would repeat it
        // after the cut.
        let soon = rig.now() + MS / 2;
        rig.run_until(soon);
        let cut = soon + delay;
        rig.run_until(cut);
        let answered = !rig.answers().is_empty();
        rig.cut_power();
        rig.wait_until_up();
        let (health, code) = rig.status_now();
        assert_eq!((health, code & PARAMETERS_LOST), (OK, 0), "cut after {} us", delay / 16);
        let reported = marks(&mut rig);
        if reported == mark(generation) {
            in_force = generation;
            new += 1;
        } else {
            assert!(
                !answered,
                "the answer reported success, but the old set is in force, cut after {} us",
                delay / 16
            );
            assert_eq!(
                reported,
                mark(in_force),
                "not one complete set, cut after {} us",
                delay / 16
            );
            old += 1;
        }
        if answered {
            break;
        }
        delay += STEP;
    }
    println!("{old} cuts left the old set, {new} the new one");
    assert!(
        old > 20 && new >= 1,
        "the cuts must cover the whole save: {old} left the old set, {new} the new one"
    );
}

/// Positions at which two EEPROMs differ.
fn difference(a: &[u8], b: &[u8]) -> Vec<usize> {
    (0..a.len()).filter(|&at| a[at] != b[at]).collect()
}

/// Longer than the older copy needs to become equal to the one in force.
const REST_MS: u64 = 1000;

/// The EEPROMs of a node that saves twice: before, between, after, and right after the second
/// response.
fn saved_twice() -> [Vec<u8>; 4] {
    let mut rig = Rig::running();
    let eeprom = |rig: &mut Rig| rig.board().avr().eeprom();
    let before = eeprom(&mut rig);
    set_marks(&mut rig, 1);
    rig.save();
    rig.run_ms(REST_MS);
    let between = eeprom(&mut rig);
    set_marks(&mut rig, 2);
    rig.save();
    let saved = eeprom(&mut rig);
    rig.run_ms(REST_MS);
    [before, between, eeprom(&mut rig), saved]
}

/// Addresses in the EEPROM: docs/parameters.md.
const SELECTOR: [usize; 2] = [0x1E, 0x1F];
const COPIES: [usize; 2] = [0x20, 0xA0];
const COPIES_OF_OUTPUTS: [usize; 2] = [0x20, 0x220];

fn copies() -> [usize; 2] {
    if is_packed() { COPIES_OF_OUTPUTS } else { COPIES }
}

/// True if the EEPROM has one byte of a value whose upper byte is always zero.
fn is_packed() -> bool {
    parameters().iter().any(|(name, ..)| *name == "OUT2_ID")
}

/// The response has just left, and the older copy is still complete.
#[test]
fn no_broken_bit_of_the_selector_right_after_a_save_restores_older_values() {
    let [.., saved] = saved_twice();
    for at in SELECTOR {
        for bit in 0..8 {
            let mut broken = saved.clone();
            broken[at] ^= 1 << bit;
            let mut rig = Rig::running_with(&broken);
            assert_eq!(marks(&mut rig), mark(2), "byte {at:#x}, bit {bit}");
        }
    }
    // With neither cell the node says that it may have the older copy.
    let mut broken = saved;
    broken[SELECTOR[0]] ^= 1;
    broken[SELECTOR[1]] ^= 1;
    let mut rig = Rig::running_with(&broken);
    assert!([mark(1), mark(2)].contains(&marks(&mut rig)));
    assert_eq!(rig.next_status(), (CRITICAL, PARAMETERS_LOST));
}

/// The CRC of the EEPROM's records: CRC-16-CCITT, bit by bit.
fn crc(start: u16, bytes: &[u8]) -> u16 {
    bytes.iter().fold(start, |crc, &byte| {
        (0..8).fold(crc ^ u16::from(byte) << 8, |crc, _| {
            crc << 1 ^ if crc & 0x8000 == 0 { 0 } else { 0x1021 }
        })
    })
}

/// Bytes of a value in the EEPROM.
fn cells(&(name, _, min, max): &(&str, i64, i64, i64)) -> usize {
    // The EEPROM has the bit rate as a number from 0 to 3, or -1 where it is found.
    let is_byte = if name == "CAN_BAUDRATE" { min != 0 } else { min >= 0 && max < 0x100 };
    if is_packed() && is_byte { 1 } else { 2 }
}

/// Another program or a faulty build may have written such a copy. Unchecked, the values would
/// cause wrong pulses and bit rates.
#[test]
fn values_out_of_range_in_a_valid_copy_become_the_defaults_and_are_reported() {
    let len: usize = parameters().iter().map(cells).sum();
    let [_, saved, ..] = saved_twice();
    let first = copies()[0];
    let right = u16::from_be_bytes([saved[first + len], saved[first + len + 1]]);
    let start = (0..=u16::MAX)
        .find(|&start| crc(start, &saved[first..first + len]) == right)
        .expect("the start value of the CRC: docs/parameters.md says what a copy has");
    let with = |value: Option<u16>| {
        let mut eeprom = saved.clone();
        for copy in copies() {
            if let Some(value) = value {
                let mut at = copy;
                for parameter in parameters() {
                    let bytes = &value.to_le_bytes()[..cells(parameter)];
                    eeprom[at..at + bytes.len()].copy_from_slice(bytes);
                    at += bytes.len();
                }
            }
            let sum = crc(start, &eeprom[copy..copy + len]).to_be_bytes();
            eeprom[copy + len..][..2].copy_from_slice(&sum);
        }
        eeprom
    };
    let mut rig = Rig::running_with(&with(None));
    assert_eq!(
        (marks(&mut rig), rig.next_status()),
        (mark(1), (OK, 0)),
        "the node must accept a copy with this CRC"
    );
    for value in [0xFFFF, 0x80F0, 35_968, 200] {
        let mut rig = Rig::running_with(&with(Some(value)));
        rig.wait_for("a status", 1100, |rig| !rig.statuses().is_empty());
        for (index, parameter) in parameters().iter().enumerate() {
            let &(name, default, min, max) = parameter;
            let stored = if cells(parameter) == 1 { value & 0xFF } else { value };
            let number = if min < 0 { i64::from(stored as i16) } else { i64::from(stored) };
            let expected = match (name, stored) {
                // The bit rate that is found.
                ("CAN_BAUDRATE", 0xFFFF) if min == 0 => 0,
                ("CAN_BAUDRATE", _) => default,
                _ if (min..=max).contains(&number) => number,
                _ => default,
            };
            let found = integer(&rig.parameter_at(index as u16).value);
            assert_eq!(found, expected, "{name} of {value:#06x} in the EEPROM");
        }
        let (_, code) = rig.next_status();
        assert_eq!(code & PARAMETERS_LOST, PARAMETERS_LOST, "{value}");
        rig.send_command(1, 0, 0.5);
        rig.run_ms(100);
        assert!(
            rig.pulses.iter().all(|pulse| (500.0..=2500.0).contains(&pulse.width_us())),
            "{:?}",
            rig.pulses
        );
    }
}

#[test]
fn without_a_valid_copy_the_defaults_are_in_force_and_the_node_is_critical() {
    let [before, between, after, _] = saved_twice();
    let mut broken = after.clone();
    for at in difference(&before, &between).into_iter().chain(difference(&between, &after)) {
        broken[at] = after[at] ^ 0x40;
    }
    let mut rig = Program::Preset.with_boards(&[&broken]);
    rig.wait_for("the first NodeStatus", 100, |rig| !rig.statuses().is_empty());
    rig.wait_for_line("parameters lost", 100);
    assert_eq!(rig.next_status(), (CRITICAL, PARAMETERS_LOST));
    assert_defaults(&mut rig);
    // The node works with the defaults, and a save repairs the EEPROM.
    rig.send_command(1, 0, 0.5);
    assert_eq!(rig.settled_pulse_us(), 1750.0);
    set_marks(&mut rig, 3);
    rig.save();
    rig.restart();
    assert_eq!(marks(&mut rig), mark(3));
    assert_eq!(rig.next_status(), (OK, 0));
}

#[test]
fn an_erased_eeprom_is_not_reported_as_lost() {
    let mut rig = Rig::running();
    assert_eq!(rig.next_status(), (OK, 0));
    assert_defaults(&mut rig);
    let mut eeprom = started().to_vec();
    eeprom.fill(0xFF);
    let mut rig = Program::Preset.with_boards(&[&eeprom]);
    rig.run_ms(2500);
    assert_eq!(rig.next_status(), (OK, 0));
}
