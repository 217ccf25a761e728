//! Requests and their responses.

use super::*;
#[cfg(feature = "standard")]
use crate::hardware::OUTPUTS;
#[cfg(feature = "standard")]
use crate::parts::update;
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
            let (payload, _) = golden::payload(golden::BEGIN_FIRMWARE_UPDATE, &replies);
            assert_eq!(payload, *b"\x01armed, or a command in the last 2 s");
        } else {
            assert_eq!(golden::text(&replies), "1E287FF8 00 C9");
        }
        let log = String::from_utf8(rig.log.clone()).unwrap();
        assert_eq!(log.contains("update called off"), is_armed && cfg!(feature = "monitor"));
    }
}

#[cfg(feature = "update")]
#[test]
fn a_restart_that_was_answered_comes_although_an_update_is_called_off() {
    let mut rig = Rig::new();
    rig.program.node.update.start(true);
    rig.run(1100);
    for request in ["1E05F8FF 1E 1B 55 CE AC C3", "1E28F8FF 00 66 77 2E 62 69 6E C9"] {
        rig.text(request);
        rig.run(5);
    }
    rig.text("18044C0A FF C0");
    rig.run(110);
    assert!(rig.is_to_restart && !rig.program.node.update.is_accepted());
}

/// uavcan/protocol/1.GetNodeInfo.uavcan: status, version, hardware with the unique ID, name.
#[cfg(feature = "standard")]
#[test]
fn node_info_has_the_unique_id_and_the_name_and_says_whether_updates_are_taken() {
    for has_loader in [false, true] {
        let mut rig = Rig::new();
        rig.program.node.update.start(has_loader);
        let replies = rig.ask_frames(&golden::frames("1E01F8FF C4"));
        let (payload, transfer_id) = golden::payload(golden::GET_NODE_INFO, &replies);
        assert_eq!((golden::id(&replies[0]), transfer_id), (0x1E01_7FF8, 4));
        // The highest bit of the hardware's version.
        let takes_updates = payload[22] & 0x80 == 0;
        assert_eq!(takes_updates, has_loader && update::IS_THERE);
        assert_eq!(payload[24..40], *rig.program.node.unique_id());
        assert_eq!(payload[40], 0, "no certificate");
        let name = String::from_utf8(payload[41..].to_vec()).unwrap();
        assert!(name.starts_with("org.dronecan.servo"), "{name}");
    }
}

/// Lengths that the DSDL does not allow, and vehicles that are not the node's.
#[cfg(feature = "safety")]
#[test]
fn states_of_a_wrong_length_or_of_a_node_that_is_no_autopilot_are_refused() {
    let mut rig = Rig::new();
    rig.status_of(10);
    let texts = [
        ("1001550A 01 00 00 00 00 00 C0", 1),
        ("18044C0A FF 00 C0", 1),
        ("18044C0B FF C0", 1),
        ("18044C0A FF C1", 0),
        ("184E200A FF 00 C0", 1),
        ("184E200B FF C0", 1),
        ("184E200A FF C1", 0),
        ("1E0BF8FF 00 C0", 1),
    ];
    for (text, refused) in texts {
        let before = rig.program.node.health().counts.refused;
        rig.text(text);
        let after = rig.program.node.health().counts.refused;
        assert_eq!(after - before, refused, "{text}");
    }
}

/// uavcan/protocol/4.GetTransportStats.uavcan: transfers sent, received and with errors.
#[cfg(feature = "stats")]
#[test]
fn transport_stats_count_what_was_received_and_what_was_broken() {
    let mut rig = Rig::new();
    let mut stats = || {
        let replies = rig.ask_frames(&golden::frames("1E04F8FF C4"));
        let (payload, _) = golden::payload(golden::GET_TRANSPORT_STATS, &replies);
        let number = |n: usize| {
            u64::from_le_bytes([&payload[6 * n..][..6], &[0; 2]].concat().try_into().unwrap())
        };
        let counted = [number(1), number(2)];
        rig.text("1003F20A 12 F3 01 00 00 38 02 88 | 00 00 BC 03 04 DC 66 68");
        counted
    };
    let [received, broken] = stats();
    assert_eq!(stats(), [received + 1, broken + 1]);
}

#[cfg(feature = "allocation")]
#[test]
fn a_node_without_an_id_takes_the_one_of_the_allocator_and_of_no_other_message() {
    let mut rig = Rig::with(&[(Parameter::CanNode, 0)]);
    let unique_id = *rig.program.node.unique_id();
    let mut answer = |node: u8, confirmed: usize| {
        rig.run(1000);
        let asked = rig.can.sent.len();
        let payload = [&[node << 1], &unique_id[..confirmed]].concat();
        rig.frames(&golden::transfer(0x1E00_017F, golden::ALLOCATION, 1, &payload));
        (asked > 0, rig.program.node.id())
    };
    // Its first six bytes, twelve, and all with an ID; before them an ID for another node.
    for (node, confirmed, expected) in
        [(42, 5, 0), (0, 6, 0), (0, 12, 0), (42, 16, 42), (43, 16, 42)]
    {
        assert_eq!(answer(node, confirmed), (true, expected), "{confirmed} bytes");
    }
}

/// uavcan/equipment/indication/1081.LightsCommand.uavcan
#[cfg(feature = "lights")]
#[test]
fn the_light_has_the_brightest_colour_of_its_own_entry() {
    let mut rig = Rig::with(&[(Parameter::LightId, 3)]);
    for (entries, expected) in
        [("04 FF FF", 0), ("03 80 00", 132), ("03 07 E0", 255), ("03 00 1F", 255), ("03 00 00", 0)]
    {
        rig.text(&format!("1804390A {entries} C0"));
        rig.run(2);
        assert_eq!(rig.light, expected, "{entries}");
    }
}

/// ardupilot/indication/20001.Button.uavcan, and KeyValue, whose number is that of the presses.
#[cfg(feature = "button")]
#[test]
fn a_press_is_told_ten_times_a_second_and_counted() {
    let mut rig = Rig::new();
    rig.run(1500);
    rig.can.sent.clear();
    rig.is_pressed = true;
    rig.run(550);
    rig.is_pressed = false;
    rig.run(500);
    let of = |rig: &Rig, data_type: u32| -> Vec<Vec<u8>> {
        let is_its = |frame: &Frame| golden::id(frame) >> 8 & 0xFFFF == data_type;
        let sent = rig.can.sent.iter().map(|(_, frame)| frame).filter(|frame| is_its(frame));
        sent.map(|frame| frame.data()[..frame.data().len() - 1].to_vec()).collect()
    };
    assert_eq!(of(&rig, 20_001), [1, 2, 3, 4, 5].map(|tenths| vec![1, tenths]));
    assert_eq!(of(&rig, 16_370), [[&1.0_f32.to_le_bytes()[..], b"btn"].concat()]);
}

/// A motor would stop.
#[cfg(feature = "outputs")]
#[test]
fn while_it_is_armed_the_number_the_ids_and_the_types_of_the_outputs_stay() {
    let fixed = [
        (Parameter::OutCount.index(), 2),
        (OutputParameter::Type.index(0), 1),
        (OutputParameter::Id.index(0), 9),
    ];
    let changes = |status: u8| {
        let mut rig = Rig::new();
        rig.status_of(10);
        rig.hear(&golden::frame(0x1804_4C0A, &[status, 0xC0]));
        fixed.map(|(index, value)| {
            let before = rig.program.node.parameters.value(index);
            response(&rig.get_set(&set(index.into(), value, "")));
            rig.program.node.parameters.value(index) != before
        })
    };
    assert_eq!(changes(255), fixed.map(|_| false));
    assert_eq!(changes(0), fixed.map(|_| true));
}

/// uavcan/protocol/file/40.BeginFirmwareUpdate.uavcan: error 0 is OK.
#[cfg(feature = "update")]
#[test]
fn an_update_is_refused_without_a_loader_while_outputs_are_in_use_and_for_a_long_path() {
    for (has_loader, is_commanded, path_len, is_refused) in [
        (true, false, 24, false),
        (false, false, 24, true),
        (true, true, 24, true),
        (true, false, 25, true),
    ] {
        let mut rig = Rig::new();
        rig.program.node.update.start(has_loader);
        if is_commanded {
            rig.command(1500.0);
        }
        let payload = [vec![0], vec![b'a'; path_len]].concat();
        let replies = rig.ask_frames(&golden::transfer(
            0x1E28_F8FF,
            golden::BEGIN_FIRMWARE_UPDATE,
            9,
            &payload,
        ));
        let (answer, _) = golden::payload(golden::BEGIN_FIRMWARE_UPDATE, &replies);
        assert_eq!(answer[0] != 0, is_refused, "{}", String::from_utf8_lossy(&answer[1..]));
    }
}

/// uavcan/protocol/param/11.GetSet.uavcan: all parameters are integers.
#[cfg(feature = "standard")]
#[test]
fn a_float_or_a_truth_value_sets_nothing_and_the_name_behind_it_is_read() {
    let mut rig = Rig::new();
    let by_name = rig.get_set(b"\0\0CAN_NODE");
    for value in [&[2, 0, 0, 0x80, 0x3F][..], &[3, 1]] {
        let answer = rig.get_set(&[&[0], value, b"CAN_NODE"].concat());
        assert_eq!(answer, by_name, "{value:?}");
    }
}
