//! Requests and their responses.

use super::*;
#[cfg(feature = "standard")]
use crate::hardware::OUTPUTS;
#[cfg(all(feature = "standard", feature = "monitor"))]
use crate::tables::bit_rate;
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
    fn ask(&mut self, text: &str) -> String {
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
    fn get_set(&mut self, payload: &[u8]) -> Vec<u8> {
        let replies = self.ask_frames(&golden::transfer(0x1E0B_F8FF, golden::GET_SET, 11, payload));
        let (payload, transfer_id) = golden::payload(golden::GET_SET, &replies);
        assert_eq!(transfer_id, 11);
        payload
    }
}

#[cfg(feature = "standard")]
const NO_SUCH_PARAMETER: [u8; 4] = [0; 4];

#[cfg(feature = "standard")]
fn set(index: u16, value: i64, name: &str) -> Vec<u8> {
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
fn a_save_that_the_eeprom_does_not_keep_fails_and_the_next_one_writes() {
    let mut rig = Rig::new();
    rig.get_set(&set(0, 77, "OUT1_TIMEOUT"));
    for (is_broken, code) in [(true, "00"), (false, "80")] {
        rig.memory.is_broken = is_broken;
        let answer = rig.ask("1E0AF8FF 00 00 00 00 00 00 00 C4");
        assert_eq!(answer, format!("1E0A7FF8 00 00 00 00 00 00 {code} C4"), "{is_broken}");
    }
    let rig = Rig::start(rig.board.memory, ResetCause::POWER_ON);
    assert_eq!(rig.program.node.parameters.get(OutputParameter::Timeout.of(0)), 77);
}

const RESTART: &str = "1E05F8FF 1E 1B 55 CE AC C6";

/// The controller has no room for the reply, or has it and does not send it for a time.
#[test]
fn on_a_full_bus_it_restarts_when_the_reply_is_sent_and_after_a_second_in_any_case() {
    for (room, sent_after_ms, expected_ms) in
        [(u32::MAX, 300, 300..=302), (u32::MAX, 5000, 1000..=1010), (0, 0, 1000..=1010)]
    {
        let mut rig = Rig::new();
        rig.run(1100);
        rig.can.room = room;
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

#[test]
fn a_wrong_request_does_not_call_a_restart_off() {
    let mut rig = Rig::new();
    rig.text(RESTART);
    rig.run(10);
    rig.text("1E05F8FE 01 00 00 00 00 C6");
    rig.run(200);
    assert!(rig.is_to_restart);
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
    rig.command(1900.0);
    fill(&mut rig);
    rig.text(RESTART);
    assert_eq!(rig.program.node.pulse(0), us(1900.0), "RestartNode");
    rig.text("1E0AF8FF 01 00 00 00 00 00 00 C3");
    assert_eq!(rig.program.node.parameters.get(OutputParameter::Max.of(0)), 2400, "ExecuteOpcode");
    rig.frames(&golden::transfer(0x1E0B_F8FF, golden::GET_SET, 0, &set(5, 2000, "")));
    assert_eq!(rig.program.node.parameters.get(OutputParameter::Max.of(0)), 2400, "GetSet");
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
