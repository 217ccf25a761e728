//! Requests and their responses.

use super::*;
#[cfg(feature = "standard")]
use crate::eeprom::EEPROM_LEN;
use crate::hardware::{HARDWARE_MAJOR, HARDWARE_MINOR, NODE_NAME, OUTPUTS};
use crate::tables::{bit_rate, parameters};
use dronecan_wire::Id;

impl Rig {
    /// The frames of responses since the last call.
    fn replies(&mut self) -> Vec<Frame> {
        let replies = self
            .can
            .sent
            .iter()
            .map(|(_, frame)| *frame)
            .filter(|frame| Id::from_bytes(frame.id).is_service())
            .collect();
        self.can.sent.clear();
        replies
    }

    /// Sends a request. Returns the response, which must come within half a second.
    pub(super) fn ask(&mut self, text: &str) -> String {
        self.replies();
        self.text(text);
        self.run(500);
        golden::text(&self.replies())
    }

    fn ask_frames(&mut self, frames: &[Frame]) -> Vec<Frame> {
        self.replies();
        self.frames(frames);
        self.run(500);
        self.replies()
    }

    #[cfg(feature = "standard")]
    /// Sends a GetSet request with this payload from node 127. Returns the payload of the response.
    pub(super) fn get_set(&mut self, payload: &[u8]) -> Vec<u8> {
        let replies = self.ask_frames(&golden::transfer(0x1E0B_F8FF, golden::GET_SET, 11, payload));
        let (payload, transfer_id) = golden::payload(golden::GET_SET, &replies);
        assert_eq!(transfer_id, 11);
        payload
    }
}

#[cfg(feature = "standard")]
const NO_SUCH_PARAMETER: [u8; 4] = [0; 4];

#[cfg(feature = "standard")]
pub(super) fn set(index: u16, value: i64, name: &str) -> Vec<u8> {
    [&[index as u8, (index >> 8 << 3) as u8 | 1], &value.to_le_bytes()[..], name.as_bytes()]
        .concat()
}

#[cfg(feature = "standard")]
/// Value, default, maximum and minimum of a GetSet response, and the name.
fn response(payload: &[u8]) -> ([i64; 4], String) {
    let number = |n: usize| {
        assert_eq!(payload[9 * n], 1, "an integer");
        i64::from_le_bytes(payload[9 * n + 1..][..8].try_into().unwrap())
    };
    ([0, 1, 2, 3].map(number), String::from_utf8(payload[36..].to_vec()).unwrap())
}

#[test]
fn get_node_info_is_answered_with_the_status_of_the_moment() {
    let mut rig = Rig::start(Memory::with(&[]), ResetCause::WATCHDOG);
    rig.run(10_500);
    let replies = rig.ask_frames(&golden::frames("1E01F8FF C3"));
    assert!(replies.iter().all(|frame| golden::id(frame) == 0x1E01_7FF8));
    let (payload, transfer_id) = golden::payload(golden::GET_NODE_INFO, &replies);
    assert_eq!(transfer_id, 3);
    assert_eq!(payload[..7], [10, 0, 0, 0, 0x40, 1, 0]);
    assert_eq!(payload[22..24], [HARDWARE_MAJOR | 0x80, HARDWARE_MINOR], "it takes no updates");
    assert_eq!(payload[24..40], *rig.program.node.unique_id());
    assert_eq!(payload[40], 0, "no certificate");
    assert_eq!(&payload[41..], NODE_NAME.as_bytes());
}

/// A server has a file for the version of the board, and PX4 repeats a request that is refused.
#[cfg(feature = "update")]
#[test]
fn only_a_node_that_takes_updates_tells_the_hardware_version_of_the_board() {
    for (has_loader, major) in [(false, HARDWARE_MAJOR | 0x80), (true, HARDWARE_MAJOR)] {
        let mut rig = Rig::new();
        rig.program.node.update.start(has_loader);
        rig.run(1100);
        let replies = rig.ask_frames(&golden::frames("1E01F8FF C3"));
        let (payload, _) = golden::payload(golden::GET_NODE_INFO, &replies);
        assert_eq!(payload[22..24], [major, HARDWARE_MINOR]);
    }
}

#[cfg(feature = "standard")]
#[test]
fn golden_requests_for_parameters_get_golden_replies() {
    let mut rig = Rig::new();
    rig.run(1100);
    assert_eq!(
        rig.ask("1E0BF8FF 00 00 C0"),
        "1E0B7FF8 CE 06 01 78 00 00 00 80 | 00 00 00 00 01 78 00 20 | 00 00 00 00 00 00 01 00 | \
         7D 00 00 00 00 00 00 20 | 00 01 00 \
         00 00 00 00 00 | 00 00 00 43 41 4E 5F 20 | 4E 4F 44 45 40"
    );
    assert_eq!(
        rig.ask(
            "1E0BF8FF C5 16 00 01 2A 00 00 81 | 00 00 00 00 00 43 41 21 | 4E 5F 4E 4F 44 45 41"
        ),
        "1E0B7FF8 47 0A 01 2A 00 00 00 81 | 00 00 00 00 01 78 00 21 | 00 00 00 00 00 00 01 01 | \
         7D 00 00 00 00 00 00 21 | 00 01 00 \
         00 00 00 00 01 | 00 00 00 43 41 4E 5F 21 | 4E 4F 44 45 41"
    );
    assert_eq!(
        rig.ask(
            "1E0BF8FF C1 45 00 01 20 A1 07 82 | 00 00 00 00 00 43 41 22 | 4E 5F 42 41 55 44 \
         52 02 | 41 54 45 62"
        ),
        golden::BAUDRATE_IS_500_KBIT
    );
    #[cfg(feature = "sensors")]
    assert_eq!(
        rig.ask(
            "1E0BF8FF E3 42 00 01 CE FF FF 83 | FF FF FF FF FF 54 45 23 | 4D 50 5F 4F 46 46 \
         53 03 | 45 54 63"
        ),
        "1E0B7FF8 F5 05 01 CE FF FF FF 83 | FF FF FF FF 01 00 00 23 | 00 00 00 00 00 00 01 03 | \
         DC 05 00 00 00 00 00 23 | 00 01 0C \
         FE FF FF FF 03 | FF FF FF 54 45 4D 50 23 | 5F 4F 46 46 53 45 54 43"
    );
    #[cfg(feature = "masks")]
    assert_eq!(
        rig.ask("1E0BF8FF 9D BF 00 00 57 41 52 84 | 4E 5F 4D 41 53 4B 64"),
        "1E0B7FF8 EE 66 01 F7 1B 00 00 84 | 00 00 00 00 01 F7 1B 24 | 00 00 00 00 00 00 01 04 | \
         FF FF 00 00 00 00 00 24 | 00 01 00 \
         00 00 00 00 04 | 00 00 00 57 41 52 4E 24 | 5F 4D 41 53 4B 44"
    );
    // Index 300, and the name NO_SUCH.
    assert_eq!(rig.ask("1E0BF8FF 2C 08 C5"), "1E0B7FF8 00 00 00 00 C5");
    assert_eq!(
        rig.ask("1E0BF8FF 50 D7 00 00 4E 4F 5F 8A | 53 55 43 48 6A"),
        "1E0B7FF8 00 00 00 00 CA"
    );
}

#[cfg(feature = "standard")]
#[test]
fn all_parameters_are_found_by_index_and_by_name_and_no_more() {
    let mut rig = Rig::new();
    let mut names = std::collections::BTreeSet::new();
    for index in 0..parameters::COUNT as u8 {
        let by_index = rig.get_set(&[index, 0]);
        let ([value, default, max, min], name) = response(&by_index);
        assert!(min <= default && default <= max && value == default, "{name}");
        assert!(
            name.len() <= 16
                && name.bytes().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == b'_'),
            "{name}"
        );
        // The name takes precedence over the index.
        assert_eq!(
            rig.get_set(&[&[parameters::COUNT as u8 - 1 - index, 0], name.as_bytes()].concat()),
            by_index
        );
        assert!(names.insert(name));
    }
    for index in [parameters::COUNT as u16, 255, 256, 300, 0x1FFF] {
        assert_eq!(
            rig.get_set(&[index as u8, (index >> 8 << 3) as u8]),
            NO_SUCH_PARAMETER,
            "{index}"
        );
    }
    let long = "A".repeat(92);
    for name in ["CAN_NOD", "CAN_NODE_", "can_node", "OUT1_MIN\0", "ABCDEFGHIJKLMNOPQ", &long] {
        assert_eq!(rig.get_set(&[&[0, 0], name.as_bytes()].concat()), NO_SUCH_PARAMETER, "{name}");
        assert_eq!(rig.get_set(&set(0, 1, name)), NO_SUCH_PARAMETER, "{name}");
    }
}

/// The program with several outputs leaves the text out. The others keep 27 bytes of the request.
#[cfg(feature = "standard")]
#[test]
fn a_name_after_a_text_is_compared_whole_or_not_at_all() {
    let mut rig = Rig::new();
    let request = |len: u8, name: &str| {
        let text = vec![b'x'; len.into()];
        [&[0, 4, len], text.as_slice(), name.as_bytes()].concat()
    };
    for name in ["OUT1_FS", "OUT1_FS_PWM", "CAN_NODE"] {
        let by_name = rig.get_set(&[&[0, 0], name.as_bytes()].concat());
        for len in 0..=128 {
            let is_kept = OUTPUTS > 1 || 3 + usize::from(len) + name.len() <= 27;
            let expected: &[u8] = if is_kept { &by_name } else { &NO_SUCH_PARAMETER };
            assert_eq!(rig.get_set(&request(len, name)), expected, "{name} after {len}");
        }
        assert_eq!(rig.get_set(&request(0, &format!("{name}_"))), NO_SUCH_PARAMETER, "{name}");
    }
    // Without a name, by the index.
    let by_index = rig.get_set(&[0, 0]);
    assert_eq!(rig.get_set(&request(5, "")), by_index);
}

#[cfg(feature = "standard")]
#[test]
fn a_request_that_ends_within_its_text_has_no_answer() {
    let mut rig = Rig::new();
    rig.run(1100);
    for len in 4..60 {
        let payload = [&[0, 4, len][..], &vec![b'x'; usize::from(len) - 1]].concat();
        let request = golden::transfer(0x1E0B_F8FF, golden::GET_SET, 1, &payload);
        assert_eq!(rig.ask_frames(&request), [], "{len} bytes");
    }
}

#[cfg(feature = "standard")]
#[test]
fn every_parameter_takes_both_ends_of_its_range_and_nothing_beyond() {
    let mut rig = Rig::new();
    for index in 0..parameters::COUNT as u16 {
        let ([_, default, max, min], name) = response(&rig.get_set(&[index as u8, 0]));
        // A servo must not have the pulses of motors.
        let is_motor = i64::from(name.starts_with("ESC_"));
        if parameters::OutputParameter::Type.index(0) != parameters::NONE {
            let index = parameters::OutputParameter::Type.index(0).into();
            rig.get_set(&set(index, is_motor, ""));
        }
        let mut now = default;
        for value in [
            min - 1,
            min,
            max + 1,
            max,
            i64::MIN,
            i64::MAX,
            max + (1 << 16),
            max + (1 << 32),
            min - (1 << 16),
            default,
        ] {
            if (min..=max).contains(&value) {
                now = value;
            }
            let expected = ([now, default, max, min], name.clone());
            assert_eq!(
                response(&rig.get_set(&set(index, value, ""))),
                expected,
                "{value} by index"
            );
            assert_eq!(
                response(&rig.get_set(&set(0x1FFF, value, &name))),
                expected,
                "{value} by name"
            );
        }
    }
}

#[cfg(feature = "standard")]
#[test]
fn only_the_bit_rates_of_the_board_can_be_set() {
    let mut rig = Rig::new();
    let rates =
        &[125_000, 250_000, 500_000, 1_000_000][..if bit_rate::HIGHEST_RATE == 3 { 4 } else { 3 }];
    let search: &[_] = if bit_rate::LOWEST < 0 { &[0] } else { &[] };
    let mut now = rates[rates.len() - 1];
    for value in [
        125_000, 250_000, 500_000, 1_000_000, 0, 1, 8, 125_001, 375_000, 750_000, 875_000,
        2_000_000, 62_500,
    ] {
        if rates.contains(&value) || search.contains(&value) {
            now = value;
        }
        let ([value_now, ..], name) = response(&rig.get_set(&set(1, value, "")));
        assert_eq!((value_now, &name[..]), (now, "CAN_BAUDRATE"), "{value}");
    }
}

#[cfg(all(feature = "standard", feature = "monitor"))]
#[test]
fn every_number_that_is_set_is_logged_whole() {
    let mut rig = Rig::new();
    let mut of = |parameter: u8, value: i64| {
        rig.log.clear();
        rig.get_set(&set(parameter.into(), value, ""));
        let log = String::from_utf8(rig.log.clone()).unwrap();
        let line = log.lines().find_map(|line| line.split_once(": set "));
        line.unwrap_or_else(|| panic!("{value}: {log}")).1.to_string()
    };
    let search = (bit_rate::LOWEST < 0).then_some(0);
    let rates = (0..=bit_rate::HIGHEST_RATE).map(|doublings| 125_000 << doublings);
    for rate in search.into_iter().chain(rates) {
        assert_eq!(of(1, rate), format!("CAN_BAUDRATE = {rate}"));
    }
    for id in [0, 32_767, 32_768, 65_535] {
        assert_eq!(of(Parameter::TempId.index(), id), format!("TEMP_ID = {id}"));
    }
    for degrees in [-55, -1, 0, 100] {
        assert_eq!(of(Parameter::TempMin.index(), degrees), format!("TEMP_MIN = {degrees}"));
    }
}

#[cfg(all(feature = "standard", feature = "monitor"))]
#[test]
fn a_number_out_of_range_is_logged_with_the_parameter() {
    let mut rig = Rig::new();
    rig.get_set(&set(1, 2_000_000, ""));
    // Neither a number for a parameter that does not exist, nor a request that only reads.
    rig.get_set(&set(200, 5, ""));
    rig.get_set(&set(0x1FFF, 5, "NO_SUCH"));
    rig.get_set(&[2, 0, 0]);
    rig.run(100);
    let log = String::from_utf8(rig.log.clone()).unwrap();
    let lines: Vec<_> = log.lines().filter(|line| line.contains("out of range")).collect();
    assert_eq!(lines, ["rx GetSet from 127 tid 11: out of range for CAN_BAUDRATE"], "{log}");
}

#[cfg(feature = "standard")]
#[test]
fn values_of_other_types_change_nothing_and_are_answered_with_what_is_in_force() {
    let mut rig = Rig::new();
    // OUT1_TIMEOUT as 2.0.
    let replies = rig.ask_frames(&golden::frames(
        "1E0BF8FF 1C AE 00 02 00 00 00 86 | 40 4F 55 54 31 5F 54 26 | 49 4D 45 4F 55 54 46",
    ));
    assert_eq!(
        response(&golden::payload(golden::GET_SET, &replies).0),
        ([1000, 1000, 10_000, 0], "OUT1_TIMEOUT".into())
    );
    for value in [&[0, 3, 1][..], &[0, 4, 2, b'4', b'2'], &[0, 4, 0]] {
        let payload = [value, b"OUT1_TIMEOUT"].concat();
        assert_eq!(response(&rig.get_set(&payload)).0[0], 1000, "{value:?}");
    }
}

#[cfg(feature = "standard")]
#[test]
fn a_request_that_ends_too_early_sets_nothing() {
    let mut rig = Rig::new();
    for len in 2..10 {
        let refused = rig.program.node.health().counts.refused;
        let request = golden::transfer(0x1E0B_F8FF, golden::GET_SET, 11, &set(9, 77, "")[..len]);
        assert_eq!(rig.ask_frames(&request), [], "{len} bytes");
        assert_eq!(
            rig.program.node.parameters.get(OutputParameter::Timeout.of(0)),
            1000,
            "{len} bytes"
        );
        assert_eq!(rig.program.node.health().counts.refused, refused + 1, "{len} bytes");
    }
    rig.frames(&golden::transfer(0x1E0B_F8FF, golden::GET_SET, 0, &[0]));
    rig.frames(&golden::transfer(0x1E0B_F8FF, golden::GET_SET, 0, &[]));
    rig.run(100);
    assert_eq!(rig.replies().len(), 0, "no index");
}

#[cfg(feature = "standard")]
#[test]
fn what_is_set_is_in_force_at_once() {
    let mut rig = Rig::new();
    rig.command(UNITLESS, 1.0);
    assert_eq!(rig.program.node.pulse(0), us(2000.0));
    rig.get_set(&set(0, 2200, "OUT1_MAX"));
    rig.command(UNITLESS, 1.0);
    assert_eq!(rig.program.node.pulse(0), us(2200.0));
    rig.get_set(&set(0, 1, "OUT1_REVERSED"));
    rig.command(UNITLESS, 1.0);
    assert_eq!(rig.program.node.pulse(0), us(1000.0));
    rig.get_set(&set(0, 7, "OUT1_ID"));
    rig.command(UNITLESS, 0.0);
    // It is actuator 7 now. One of several outputs has no pulse until actuator 7 is commanded.
    let held = if OUTPUTS == 1 { us(1000.0) } else { 0 };
    assert_eq!(rig.program.node.pulse(0), held);
}

#[cfg(feature = "standard")]
#[test]
fn a_reply_has_the_value_that_the_request_left_even_when_the_next_has_come() {
    let mut rig = Rig::new();
    rig.replies();
    for (transfer_id, value) in [(1, 100), (2, 200), (3, 300)] {
        rig.frames(&golden::transfer(
            0x1E0B_F8FF,
            golden::GET_SET,
            transfer_id,
            &set(OutputParameter::Timeout.index(0).into(), value, ""),
        ));
    }
    rig.run(100);
    let replies = rig.replies();
    let values: Vec<i64> = replies
        .chunks(replies.len() / 3)
        .map(|frames| response(&golden::payload(golden::GET_SET, frames).0).0[0])
        .collect();
    assert_eq!(values, [100, 200, 300]);
}

#[cfg(feature = "standard")]
#[test]
fn save_keeps_the_parameters_over_a_restart() {
    let mut rig = Rig::new();
    rig.get_set(&set(0, 42, "CAN_NODE"));
    rig.get_set(&set(0, -50, "TEMP_MIN"));
    assert_eq!(rig.program.node.id(), 120, "the new ID is for the next start");
    rig.run(1000);
    rig.replies();
    rig.text("1E0AF8FF 00 00 00 00 00 00 00 C4");
    let mut waited_ms = 0;
    while rig.replies().is_empty() {
        rig.run(1);
        waited_ms += 1;
        assert!(waited_ms < 2000);
    }
    let rig = Rig::start(rig.board.memory, ResetCause::POWER_ON);
    assert_eq!(rig.program.node.id(), 42);
    assert_eq!(rig.program.node.parameters.get(Parameter::TempMin) as i16, -50);
}

#[cfg(feature = "standard")]
impl Rig {
    /// Saves. Returns the EEPROM then.
    #[track_caller]
    fn save(&mut self) -> [u8; EEPROM_LEN] {
        self.replies();
        self.text("1E0AF8FF 00 00 00 00 00 00 00 C4");
        self.run(1000);
        assert_eq!(golden::text(&self.replies()), "1E0A7FF8 00 00 00 00 00 00 80 C4");
        self.memory.cells
    }
}

#[cfg(feature = "standard")]
#[test]
fn a_save_of_what_is_saved_writes_no_cell() {
    let mut rig = Rig::new();
    rig.get_set(&set(0, 1200, "OUT1_MIN"));
    let saved = rig.save();
    assert_eq!(rig.save(), saved);
    rig.get_set(&set(0, 1200, "OUT1_MIN"));
    assert_eq!(rig.save(), saved, "the same value was set");
    rig.get_set(&set(0, 1300, "OUT1_MIN"));
    rig.get_set(&set(0, 1200, "OUT1_MIN"));
    assert_eq!(rig.save(), saved, "changed, and changed back");
    let mut rig = Rig::start(rig.board.memory, ResetCause::POWER_ON);
    rig.run(100);
    assert_eq!(rig.save(), saved, "after a start");
    rig.get_set(&set(0, 1300, "OUT1_MIN"));
    assert_ne!(rig.save(), saved);
    let rig = Rig::start(rig.board.memory, ResetCause::POWER_ON);
    assert_eq!(rig.program.node.parameters.get(OutputParameter::Min.of(0)), 1300);
}

/// The next start would find the broken copy again.
#[cfg(feature = "standard")]
#[test]
fn a_save_replaces_a_broken_copy() {
    let mut rig = Rig::new();
    for width in [1200, 1300] {
        rig.get_set(&set(0, width, "OUT1_MIN"));
        rig.save();
    }
    // The first copy is in force after three saves.
    rig.board.memory.cells[0x20] ^= 1;
    let mut rig = Rig::start(rig.board.memory, ResetCause::POWER_ON);
    rig.run(1100);
    assert_eq!(rig.program.node.parameters.get(OutputParameter::Min.of(0)), 1300);
    assert_eq!(rig.code() & 1 << 13, 1 << 13);
    rig.save();
    let mut rig = Rig::start(rig.board.memory, ResetCause::POWER_ON);
    rig.run(1100);
    assert_eq!(rig.program.node.parameters.get(OutputParameter::Min.of(0)), 1300);
    assert_eq!(rig.code() & 1 << 13, 0);
}

/// A SAVE that failed is tried again by the next one.
#[cfg(feature = "standard")]
#[test]
fn after_a_save_that_failed_the_next_one_writes() {
    let mut rig = Rig::new();
    rig.get_set(&set(0, 1200, "OUT1_MIN"));
    rig.board.memory.is_broken = true;
    assert_eq!(rig.ask("1E0AF8FF 00 00 00 00 00 00 00 C4"), "1E0A7FF8 00 00 00 00 00 00 00 C4");
    rig.board.memory.is_broken = false;
    rig.save();
    let rig = Rig::start(rig.board.memory, ResetCause::POWER_ON);
    assert_eq!(rig.program.node.parameters.get(OutputParameter::Min.of(0)), 1200);
}

#[cfg(feature = "standard")]
#[test]
fn what_is_not_saved_is_gone_after_a_restart() {
    let mut rig = Rig::new();
    rig.get_set(&set(0, 42, "CAN_NODE"));
    rig.run(5000);
    assert_eq!(Rig::start(rig.board.memory, ResetCause::POWER_ON).program.node.id(), 120);
}

#[cfg(feature = "standard")]
/// Sends ExecuteOpcode and waits. Returns the response.
fn execute(rig: &mut Rig, opcode: u8) -> String {
    rig.replies();
    rig.frames(&[golden::frame(0x1E0A_F8FF, &[opcode, 0, 0, 0, 0, 0, 0, 0xC4])]);
    rig.run(2000);
    golden::text(&rig.replies())
}

#[cfg(feature = "standard")]
#[test]
fn opcodes_get_golden_replies() {
    let mut rig = Rig::new();
    assert_eq!(execute(&mut rig, 0), "1E0A7FF8 00 00 00 00 00 00 80 C4");
    assert_eq!(execute(&mut rig, 1), "1E0A7FF8 00 00 00 00 00 00 80 C4");
    assert_eq!(execute(&mut rig, 2), "1E0A7FF8 00 00 00 00 00 00 00 C4");
    assert_eq!(execute(&mut rig, 255), "1E0A7FF8 00 00 00 00 00 00 00 C4");
    rig.memory.is_broken = true;
    rig.get_set(&set(0, 77, "OUT1_TIMEOUT"));
    assert_eq!(
        execute(&mut rig, 0),
        "1E0A7FF8 00 00 00 00 00 00 00 C4",
        "an EEPROM that keeps nothing"
    );
    rig.memory.is_broken = false;
    assert_eq!(execute(&mut rig, 0), "1E0A7FF8 00 00 00 00 00 00 80 C4", "and one that does again");
}

#[cfg(feature = "standard")]
#[test]
fn a_failed_save_leaves_the_parameters_that_were_saved_before() {
    let mut rig = Rig::with(&[(OutputParameter::Timeout.of(0), 55)]);
    rig.memory.is_broken = true;
    rig.get_set(&set(0, 77, "OUT1_TIMEOUT"));
    execute(&mut rig, 0);
    rig.memory.is_broken = false;
    let rig = Rig::start(rig.board.memory, ResetCause::POWER_ON);
    assert_eq!(rig.program.node.parameters.get(OutputParameter::Timeout.of(0)), 55);
    assert!(rig.code() & Conditions::PARAMETERS_LOST.code() == 0);
}

#[cfg(feature = "standard")]
#[test]
fn erase_sets_the_defaults_and_keeps_them() {
    let mut rig =
        Rig::with(&[(OutputParameter::Max.of(0), 2400), (OutputParameter::Timeout.of(0), 0)]);
    rig.command(UNITLESS, 1.0);
    assert_eq!(rig.program.node.pulse(0), us(2400.0));
    execute(&mut rig, 1);
    rig.command(UNITLESS, 1.0);
    assert_eq!(rig.program.node.pulse(0), us(2000.0));
    let rig = Rig::start(rig.board.memory, ResetCause::POWER_ON);
    assert_eq!(rig.program.node.parameters.get(OutputParameter::Max.of(0)), 2000);
    assert!(rig.code() & Conditions::PARAMETERS_LOST.code() == 0);
}

#[cfg(feature = "standard")]
#[test]
fn an_opcode_of_another_length_is_not_executed() {
    let mut rig = Rig::with(&[(OutputParameter::Max.of(0), 2400)]);
    for text in ["1E0AF8FF 01 00 00 00 00 00 C4", "1E0AF8FF C4", "1E0AF8FF 01 C4"] {
        assert_eq!(rig.ask(text), "");
    }
    assert_eq!(rig.program.node.parameters.get(OutputParameter::Max.of(0)), 2400);
}

#[cfg(feature = "standard")]
#[test]
fn the_golden_refusal_of_an_update_is_sent() {
    let mut rig = Rig::new();
    let golden = if cfg!(feature = "update") {
        "1E287FF8 07 C4 01 75 70 64 61 89 | 74 65 20 6F 76 65 72 29 | 20 55 53 42 20 73 65 09 | \
         72 69 61 6C 69"
    } else {
        "1E287FF8 01 C9"
    };
    assert_eq!(rig.ask("1E28F8FF 7F 66 77 2E 62 69 6E C9"), golden);
    // The longest possible path.
    let long = golden::transfer(0x1E28_F8FF, golden::BEGIN_FIRMWARE_UPDATE, 9, &[b'a'; 202]);
    assert_eq!(rig.ask_frames(&long).len(), if cfg!(feature = "update") { 4 } else { 1 });
}

#[cfg(feature = "stats")]
#[test]
fn transport_stats_count_transfers_and_frames() {
    let mut rig = Rig::with(&rates(0, 0, 0));
    rig.can.counters.0 = [0x1234, 1, 9, 9, 9, 9, 9, 0x5678, 2, 9, 0x9ABC, 9, 3];
    rig.run(1);
    rig.command(UNITLESS, 0.0);
    for _ in 0..3 {
        rig.text("1003F20A 12 F3 01 00 00 38 02 88 | 00 00 BC 03 04 DC 64 68");
    }
    // One transfer sent, two received including this request, three broken.
    assert_eq!(
        rig.ask("1E04F8FF C5"),
        "1E047FF8 FE 5C 01 00 00 00 00 85 | 00 02 00 00 00 00 00 25 | 03 00 00 00 00 00 34 05 | \
         12 01 00 00 00 78 56 25 | 02 00 00 \
         00 BC 9A 03 05 | 00 00 00 65"
    );
}

pub(super) const RESTART: &str = "1E05F8FF 1E 1B 55 CE AC C6";

#[test]
fn the_golden_request_restarts_it_a_moment_after_the_reply() {
    for start in [0, 65_400, 65_500] {
        let mut rig =
            Rig::with(&[(OutputParameter::Fs.of(0), 1), (OutputParameter::Timeout.of(0), 0)]);
        rig.run(start);
        rig.command(PWM, 1900.0);
        rig.replies();
        rig.text(RESTART);
        assert!(!rig.is_to_restart, "the reply comes first");
        rig.run(1);
        assert_eq!(golden::text(&rig.replies()), "1E057FF8 80 C6");
        assert_eq!(rig.program.node.pulse(0), us(1500.0), "failsafe");
        let mut waited_ms = 1;
        while !rig.is_to_restart {
            rig.run(1);
            waited_ms += 1;
            assert!(waited_ms < 300);
        }
        assert!((50..=150).contains(&waited_ms), "{waited_ms} ms");
    }
}

#[test]
fn on_a_full_bus_it_restarts_when_the_reply_is_sent_and_after_a_second_in_any_case() {
    for (sent_after_ms, expected_ms) in [(300, 300..=302), (5000, 1000..=1010)] {
        let mut rig = Rig::new();
        rig.run(1100);
        rig.can.is_held = true;
        rig.text(RESTART);
        let mut waited_ms = 0;
        while !rig.is_to_restart {
            rig.can.is_held = waited_ms < sent_after_ms;
            rig.run(1);
            waited_ms += 1;
            assert!(waited_ms < 3000);
        }
        assert!(expected_ms.contains(&waited_ms), "{waited_ms} ms");
    }
}

/// Messages of the node go before the reply, and each waits for a second.
#[test]
fn it_restarts_within_a_second_though_the_bus_takes_no_reply() {
    let mut rig = Rig::new();
    rig.run(1100);
    rig.can.room = 0;
    rig.text(RESTART);
    let mut waited_ms = 0;
    while !rig.is_to_restart {
        rig.run(1);
        waited_ms += 1;
        assert!(waited_ms < 3000);
    }
    assert!((1000..=1010).contains(&waited_ms), "{waited_ms} ms");
}

#[test]
fn it_restarts_only_for_the_magic_number() {
    for text in [
        "1E05F8FF 01 00 00 00 00 C6",
        "1E05F8FF 1F 1B 55 CE AC C6",
        "1E05F8FF 1E 1A 55 CE AC C6",
        "1E05F8FF 1E 1B 54 CE AC C6",
        "1E05F8FF 1E 1B 55 CF AC C6",
        "1E05F8FF 1E 1B 55 CE AD C6",
        "1E05F8FF 1E 1B 55 CE C6",
        "1E05F8FF 1E 1B 55 CE AC 00 C6",
        "1E05F8FF C6",
    ] {
        let mut rig =
            Rig::with(&[(OutputParameter::Fs.of(0), 3), (OutputParameter::Timeout.of(0), 0)]);
        // Bytes that an earlier, longer request left in the buffer must not count either.
        rig.text("1E0AF8FF 1E 1B 55 CE AC CE AC C0");
        rig.command(PWM, 1900.0);
        rig.run(10);
        assert_eq!(rig.ask(text), "1E057FF8 00 C6", "{text}");
        for _ in 0..70_000 {
            assert!(!rig.is_to_restart, "{text}");
            rig.run(1);
        }
        assert_eq!(rig.program.node.pulse(0), us(1900.0));
    }
}

#[test]
fn a_wrong_request_does_not_call_a_restart_off() {
    let mut rig = Rig::new();
    rig.text(RESTART);
    rig.run(10);
    rig.text("1E05F8FE 01 00 00 00 00 C6");
    rig.run(200);
    assert!(rig.is_to_restart);
}

#[test]
fn it_restarts_though_others_go_on_asking() {
    let mut rig = Rig::new();
    rig.text(RESTART);
    for _ in 0..40 {
        rig.run(20);
        rig.text("1E01F8FE C3");
        if rig.is_to_restart {
            return;
        }
    }
    panic!("never");
}

/// Requests of every form, sent at once as GUI tools do: with the service and the transfer ID of
/// each.
const PIPELINED: &[(&str, u8, u8)] = &[
    ("1E01F8FF C0", 1, 0),
    #[cfg(feature = "standard")]
    ("1E0BF8FF 00 00 C1", 11, 1),
    #[cfg(feature = "standard")]
    ("1E28F8FF 7F 66 77 2E 62 69 6E C2", 40, 2),
    #[cfg(feature = "standard")]
    ("1E0AF8FF 00 00 00 00 00 00 00 C3", 10, 3),
    #[cfg(feature = "stats")]
    ("1E04F8FF C4", 4, 4),
    ("1E05F8FF 00 00 00 00 00 C5", 5, 5),
];

/// Service, transfer ID and destination of each response, in the order in which they end.
fn replied(frames: &[Frame]) -> Vec<(u8, u8, u8)> {
    let mut open = None;
    let mut replied = vec![];
    for frame in frames {
        let tail = frame.data().last().unwrap();
        let id = Id::from_bytes(frame.id);
        let key = (id.service(), tail & 31, id.destination());
        if tail & 0x80 != 0 {
            assert_eq!(open, None, "one after the other");
            open = Some(key);
        }
        assert_eq!(open, Some(key));
        if tail & 0x40 != 0 {
            replied.push(open.take().unwrap());
        }
    }
    replied
}

#[test]
fn several_requests_at_once_are_answered_in_order() {
    let mut rig = Rig::new();
    // Goes around the ring of pending requests many times.
    for round in 0..20 {
        rig.replies();
        for (text, ..) in PIPELINED {
            rig.text(text);
        }
        rig.run(1500);
        let expected: Vec<_> = PIPELINED
            .iter()
            .map(|&(_, service, transfer_id)| (service, transfer_id, 127))
            .collect();
        let mut answers = replied(&rig.replies());
        if cfg!(feature = "save-answers") {
            // That to the SAVE, which waits, comes later than others.
            answers.sort_by_key(|&(_, transfer_id, _)| transfer_id);
        }
        assert_eq!(answers, expected, "round {round}");
    }
}

#[test]
fn requests_of_several_clients_are_answered_in_order_to_each() {
    let mut rig = Rig::new();
    rig.replies();
    for client in [127u32, 126, 1, 127] {
        rig.frames(&[golden::frame(0x1E01_F880 | client, &[0xC0 | (client & 31) as u8])]);
    }
    rig.run(50);
    assert_eq!(replied(&rig.replies()), [(1, 31, 127), (1, 30, 126), (1, 1, 1), (1, 31, 127)]);
}

#[test]
fn more_requests_than_can_wait_are_refused_and_later_ones_are_answered_again() {
    let mut rig = Rig::new();
    rig.can.room = 0;
    rig.run(1);
    let refused = rig.program.node.health().counts.refused;
    for transfer_id in 0..10 {
        rig.frames(&[golden::frame(0x1E01_F8FF, &[0xC0 | transfer_id])]);
    }
    let answered = 10 - (rig.program.node.health().counts.refused - refused) as u8;
    assert!((5..10).contains(&answered));
    rig.can.room = u32::MAX;
    rig.run(50);
    let expected: Vec<_> = (0..answered).map(|transfer_id| (1, transfer_id, 127)).collect();
    assert_eq!(replied(&rig.replies()), expected);
    rig.text("1E01F8FF D0");
    rig.run(50);
    assert_eq!(replied(&rig.replies()), [(1, 16, 127)]);
}

/// The node rejects the request once, and does not count a broken transfer when the client sends it
/// again.
#[cfg(feature = "standard")]
#[test]
fn a_request_of_several_frames_that_is_refused_for_want_of_room_is_over() {
    let mut rig = Rig::new();
    rig.can.room = 0;
    rig.run(1);
    for _ in 0..8 {
        rig.text("1E01F8FF C0");
    }
    let refused = rig.program.node.health().counts.refused;
    for transfer_id in 0..3 {
        rig.frames(&golden::transfer(0x1E0B_F8FF, golden::GET_SET, transfer_id, &set(9, 77, "")));
    }
    assert_eq!((rig.program.node.health().counts.refused, rig.code()), (refused + 3, 0));
    assert_eq!(rig.program.node.parameters.get(OutputParameter::Timeout.of(0)), 1000);
}

#[cfg(feature = "standard")]
#[test]
fn a_request_that_is_refused_for_want_of_room_changes_nothing() {
    let fill = |rig: &mut Rig| {
        rig.can.room = 0;
        rig.run(1);
        for _ in 0..10 {
            rig.text("1E01F8FF C0");
        }
    };
    let mut rig = Rig::with(&[(OutputParameter::Fs.of(0), 3), (OutputParameter::Max.of(0), 2400)]);
    rig.command(PWM, 1900.0);
    fill(&mut rig);
    rig.text(RESTART);
    assert_eq!(rig.program.node.pulse(0), us(1900.0), "RestartNode");
    rig.text("1E0AF8FF 01 00 00 00 00 00 00 C3");
    assert_eq!(rig.program.node.parameters.get(OutputParameter::Max.of(0)), 2400, "ExecuteOpcode");
    rig.frames(&golden::transfer(0x1E0B_F8FF, golden::GET_SET, 0, &set(5, 2000, "")));
    assert_eq!(rig.program.node.parameters.get(OutputParameter::Max.of(0)), 2400, "GetSet");
}

#[test]
fn replies_have_the_priority_of_their_requests() {
    let mut rig = Rig::new();
    for priority in 0..32u32 {
        let replies = rig.ask_frames(&[golden::frame(priority << 24 | 0x01_F8FF, &[0xC3])]);
        assert!(replies.len() > 1);
        assert!(replies.iter().all(|frame| golden::id(frame) == priority << 24 | 0x01_7FF8));
    }
}

#[test]
fn requests_to_other_nodes_and_unknown_services_are_not_answered() {
    let mut rig = Rig::new();
    for text in ["1E01AAFF C3", "1E30F8FF 00 00 00 00 00 C3", "1E0178FF C3", "1E01F8F8 C3"] {
        assert_eq!(rig.ask(text), "", "{text}");
    }
}

#[test]
fn statuses_go_on_while_a_client_keeps_asking_and_saving() {
    let mut rig = Rig::new();
    for n in 0..2000 {
        rig.text(PIPELINED[n % PIPELINED.len()].0);
        rig.run(7);
    }
    for gap in gaps(&rig.status_times()) {
        assert!((500..=1025).contains(&gap), "{gap} ms");
    }
}

/// The timing for a rate in bit/s.
#[cfg(feature = "update")]
fn timing(rate: u32) -> mcp2515_ordered::BitTiming {
    mcp2515_ordered::BitTiming::new(crate::hardware::CAN_CRYSTAL_HZ, rate)
}

#[cfg(feature = "update")]
#[test]
fn an_accepted_update_is_handed_over_with_server_path_node_id_and_bit_rate() {
    use crate::handover::{BUS, PATH_LEN, REQUEST_LEN};
    let mut rig = Rig::new();
    rig.program.node.update.start(true);
    assert!(rig.program.node.hand_over(&mut Memory::blank()).is_none(), "nobody has asked");
    assert_eq!(rig.ask("1E28F8FF 00 66 77 2E 62 69 6E C9"), "1E287FF8 00 C9");
    let mut eeprom = Memory::blank();
    let request = *rig.program.node.hand_over(&mut eeprom).expect("a request");
    assert_eq!(request[..6], *b"fw.bin");
    assert_eq!(request[PATH_LEN..REQUEST_LEN - 2], [6, 127], "the sender is the server");
    let crc =
        |bytes: &[u8]| bytes.iter().fold(0xFFFF, |crc, &byte| dronecan_wire::crc::add(crc, byte));
    assert_eq!(crc(&request), 0);
    let bus = &eeprom.cells[usize::from(BUS)..usize::from(BUS) + 6];
    let timing = timing(125_000 << bit_rate::HIGHEST_RATE);
    assert_eq!(bus[..4], [120, timing.cnf3(), timing.cnf2(), timing.cnf1()]);
    assert_eq!(crc(bus), 0);
    // The same record is not written again: a worn EEPROM keeps it.
    eeprom.is_broken = true;
    assert!(rig.program.node.hand_over(&mut eeprom).is_some());
}

/// The mode of a NodeStatus.
#[cfg(feature = "update")]
fn mode(status: &Frame) -> u8 {
    status.data()[4] >> 3 & 7
}

/// The reply waits for the save. Meanwhile the vehicle may be armed. No status says that the node
/// updates itself unless it will.
#[cfg(feature = "update")]
#[test]
fn an_update_that_is_called_off_during_a_save_is_rejected_in_the_reply() {
    for is_armed in [false, true] {
        let mut rig = Rig::new();
        rig.program.node.update.start(true);
        rig.run(1100);
        rig.get_set(&set(0, 1200, "OUT1_MIN"));
        rig.replies();
        rig.text("1E0AF8FF 00 00 00 00 00 00 00 C4");
        rig.text("1E28F8FF 00 66 77 2E 62 69 6E C9");
        rig.run(10);
        assert_eq!(rig.replies(), [], "the save goes on");
        if is_armed {
            rig.text("18044C0A FF C0");
        }
        rig.run(80);
        let mut waited_ms = 0;
        let (mut replies, mut modes) = (Vec::new(), Vec::new());
        while waited_ms < 1500 && !rig.is_to_restart {
            rig.run(1);
            waited_ms += 1;
            let sent = rig.can.sent.iter().map(|(_, frame)| frame);
            modes.extend(sent.filter(|sent| golden::id(sent) == NODE_STATUS).map(mode));
            replies.extend(rig.replies());
        }
        assert_eq!(rig.is_to_restart, !is_armed);
        assert_eq!(modes.contains(&3), !is_armed, "{modes:?}");
        replies.retain(|frame| golden::id(frame) == 0x1E28_7FF8);
        if is_armed {
            let (payload, _) = golden::payload(0xB7D7_25DF_7272_4126, &replies);
            assert_eq!(payload, *b"\x01armed, or a command in the last 2 s");
        } else {
            assert_eq!(golden::text(&replies), "1E287FF8 00 C9");
        }
        let log = String::from_utf8(rig.log.clone()).unwrap();
        assert_eq!(log.contains("update called off"), is_armed && cfg!(feature = "monitor"));
    }
}

/// A loader that starts after a program that hangs reads it.
#[cfg(feature = "update")]
#[test]
fn the_record_of_the_bus_follows_the_parameters_at_the_start_and_at_each_save() {
    use crate::handover::{BUS, BUS_LEN};
    let record = |rig: &Rig| rig.memory.cells[usize::from(BUS)..][..usize::from(BUS_LEN)].to_vec();
    let expected = |rate: u32| {
        let timing = timing(rate);
        let bytes = [120, timing.cnf3(), timing.cnf2(), timing.cnf1()];
        let crc = bytes.iter().fold(0xFFFF, |crc, &byte| dronecan_wire::crc::add(crc, byte));
        [bytes.as_slice(), &crc.to_be_bytes()].concat()
    };
    let mut rig = Rig::new();
    rig.program.node.update.start(true);
    rig.run(100);
    assert_eq!(record(&rig), expected(125_000 << bit_rate::HIGHEST_RATE));
    rig.get_set(&set(1, 250_000, ""));
    rig.run(500);
    assert_eq!(record(&rig), expected(125_000 << bit_rate::HIGHEST_RATE), "it is not saved");
    rig.ask("1E0AF8FF 00 00 00 00 00 00 00 C4");
    rig.run(500);
    assert_eq!(record(&rig), expected(250_000));
    // Without a loader of this project the EEPROM is left alone.
    let mut rig = Rig::new();
    rig.run(100);
    assert_eq!(record(&rig), [0xFF; 6]);
}

#[cfg(feature = "update")]
#[test]
fn a_server_of_its_own_is_handed_over() {
    let mut rig = Rig::new();
    rig.program.node.update.start(true);
    assert_eq!(rig.ask("1E28F8FF 2A 66 77 2E 62 69 6E C9"), "1E287FF8 00 C9");
    assert_eq!(rig.program.node.hand_over(&mut Memory::blank()).expect("a request")[25], 42);
}
