//! Tests of the live view, drawn into memory at the smallest size and at a large one.

use super::*;
use crate::ui::escs::Escs;
use crate::ui::keys::Popup;
use crate::ui::state::{AutopilotState, Event, Memory, battery_info};
use bench::avr::Chip;
use bench::budget::Budget;
use bench::can::{self, Record, RecordKind};
use bench::dronecan::{BatteryInfo, CircuitStatus, Rpm};
use half::f16;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

const SECOND: u64 = bench::F_CPU_HZ;

const SMALL: (u16, u16) = (COLUMNS_MIN, ROWS_MIN);
const LARGE: (u16, u16) = (140, 45);

/// Lets the node or another station send a frame.
fn add_frame(state: &mut State, start: Cycles, id: u32, data: &[u8], from_node: bool) {
    let kind = RecordKind::Frame { frame: can::Frame::extended(id, data), from: None, acked: true };
    state.add_record(&Record { start, end: start + 2_000, bits: 125, kind }, from_node, None);
}

/// State of a bench on which all stations work without errors.
fn at_work() -> State {
    let mut state = State::new(1_000_000);
    state.sensor_c = 25.0;
    state.autopilot = Some(AutopilotState {
        node_id: 1,
        deflection: 0.5,
        is_sweeping: true,
        is_armed: true,
        profile: String::from("autopilot"),
        command_type: String::from("unitless"),
        ..AutopilotState::default()
    });
    let limits = Some(Budget::of(Chip::Atmega168));
    state.memory = Memory { flash: 9_876, statics: Some(312), stack: Some(200), limits };
    state.controller.mode = String::from("Normal");
    state.controller.tec = 3;
    state.add_pulse(11 * SECOND, 28_000, None);
    state.add_pulse(11 * SECOND + 320_000, 28_000, Some(320_000));
    for byte in *b"node 0.1.0 id 42\n" {
        state.push_serial_byte(SECOND, byte);
    }
    let frames: [(u32, &[u8], bool); 3] = [
        (0x1003_F201, &[1, 0, 0, 0x38, 0xC7], false),
        (0x1801_552A, &[12, 0, 0, 0, 0, 0xEF, 0xBE, 0xC0], true),
        (0x1804_562A, &[1, 0, 0xA9, 0x5C, 0, 0xC2], true),
    ];
    for (id, data, from_node) in frames {
        add_frame(&mut state, 11 * SECOND, id, data, from_node);
    }
    state.add_latency(3_200);
    state.add_latency(1_360);
    state.advance_to(11 * SECOND + 400_000);
    state
}

fn drawn(state: &State, screen: &Screen, (columns, rows): (u16, u16)) -> String {
    let mut terminal = Terminal::new(TestBackend::new(columns, rows)).unwrap();
    terminal.draw(|frame| _ = draw(frame, state, screen)).unwrap();
    terminal.backend().to_string()
}

/// The picture on the smallest terminal, without a list.
fn small(state: &State) -> String {
    drawn(state, &Screen::default(), SMALL)
}

#[track_caller]
fn shows(picture: &str, expected: &[&str]) {
    for expected in expected {
        assert!(picture.contains(expected), "{expected} is not in\n{picture}");
    }
}

#[track_caller]
fn hides(picture: &str, unexpected: &str) {
    assert!(!picture.contains(unexpected), "{unexpected} is in\n{picture}");
}

/// Both sizes of the terminal show these texts.
#[track_caller]
fn both_show(state: &State, expected: &[&str]) {
    for size in [SMALL, LARGE] {
        shows(&drawn(state, &Screen::default(), size), expected);
    }
}

const TEMPERATURE: &str = "42 Temperature device 1 298.25 K";
const VALUES: &[&str] = &[
    "11.025 s",
    "pulse 1750.0 us",
    "period 20.000 ms",
    "angle +22.5 deg",
    "pulses 2",
    "sensor 25.0 C  node 25.1 C",
    "Servo (D10) and temperature (A0)",
    "Node 42 on diecimila (ATmega168)",
    "OK OPERATIONAL  uptime 12 s",
    "vendor code 0xBEEF",
    "flash 9,876 of 14,336 B",
    "statics 312/",
    ", RAM 512/",
    "Bus 1000 kbit/s",
    "3 frames/s",
    "error frames 0",
    "MCP2515: Normal, seeed, 16 MHz",
    "error active  TEC 3  REC 0  lost 0",
    "frame served in 85 us, worst 200 us",
    "1 ArrayCommand id 1 unitless +0.50",
    TEMPERATURE,
    "node 0.1.0 id 42",
    "autopilot 1 sweeps +0.50 unitless",
];

#[test]
fn eighty_by_twenty_four_shows_every_value() {
    let picture = small(&at_work());
    shows(&picture, VALUES);
    shows(&picture, &["500 ├", "h help", "q quit"]);
}

#[test]
fn a_large_terminal_shows_every_value_and_the_dial() {
    let picture = drawn(&at_work(), &Screen::default(), LARGE);
    shows(&picture, VALUES);
    let is_braille = |c: char| ('\u{2801}'..='\u{28FF}').contains(&c);
    assert!(picture.chars().filter(|c| is_braille(*c)).count() > 40, "{picture}");
}

/// What a change of the state at work makes of the picture on the smallest terminal, and what the
/// picture did not show before.
#[test]
fn each_state_has_its_words() {
    type Change = fn(&mut State);
    let cases: [(&str, Change, &[&str], &str); 9] = [
        (
            "the draft, at the autopilot and at the node",
            |state| {
                state.autopilot.as_mut().unwrap().dialect = Dialect::Draft;
                let now = state.now;
                let status = [0xEF, 0xCD, 0xAB, 0x02, 0xEF, 0xBE];
                add_frame(state, now, 0x1135_E00B, &status, true);
                add_frame(state, now, 0x17CD_E008, &[23], true);
            },
            &[
                "autopilot 1 (draft) sweeps +0.50 unitless",
                "Node 120 (draft) on diecimila",
                "WARNING OPERATIONAL",
                "vendor code 0xBEEF",
                "node sends 23",
                "120 draft.NodeStatus WARNING up 11259375 s",
            ],
            "draft",
        ),
        (
            "another board and its pins",
            |state| {
                state.wiring = Wiring::of("uno", "module").unwrap();
                state.memory.limits = None;
                state.set_light(SECOND, 0.5);
            },
            &[
                "Servo (D9) and temperature (A0)",
                "on uno (ATmega328P)",
                "MCP2515: Normal, module, 8 MHz",
                "light (D3) 50 %",
                "flash 9,876 B ",
                "statics 312, RAM 512 B",
            ],
            "light",
        ),
        (
            "a driver mistake and a crash",
            |state| {
                state.add_mistake(SECOND, String::from("SPI byte with CS high"));
                state.set_crash(SECOND, String::from("invalid instruction"));
            },
            &["1 DRIVER MISTAKE", "SPI byte with CS high", "CRASHED: invalid"],
            "CRASHED",
        ),
        (
            "a node that has sent nothing",
            |state| *state = State::new(500_000),
            &["no pulse", "no NodeStatus yet", "node sends none", "Bus 500 kbit/s"],
            "no pulse",
        ),
        (
            "a bench without autopilot",
            |state| state.autopilot = None,
            &["no autopilot"],
            "no autopilot",
        ),
        (
            "a lit light",
            |state| state.set_light(SECOND, 0.5),
            &["angle +22.5 deg  light (D3) 50 %"],
            "light",
        ),
        (
            "a disarmed vehicle",
            |state| state.autopilot.as_mut().unwrap().is_armed = false,
            &["autopilot 1 sweeps", "disarmed"],
            "disarmed",
        ),
        (
            "all actuators and motors",
            |state| {
                let autopilot = state.autopilot.as_mut().unwrap();
                (autopilot.moves_all, autopilot.motors) = (true, 20);
            },
            &["autopilot 1 sweeps all unitless, 20 motors"],
            "motors",
        ),
        (
            "a node that has fallen silent",
            |state| state.advance_to(19 * SECOND + 2_000),
            &["SILENT for 8.0 s", "before: OK OPERATIONAL 0xBEEF"],
            "SILENT",
        ),
    ];
    for (name, change, expected, absent) in cases {
        let mut state = at_work();
        hides(&small(&state), absent);
        change(&mut state);
        let picture = small(&state);
        for text in expected {
            assert!(picture.contains(text), "{name}: {text} is not in\n{picture}");
        }
        assert!(!picture.contains("SILENT") || !picture.contains("│OK"), "{name}:\n{picture}");
    }
}

#[test]
fn the_vendor_code_of_this_projects_program_is_in_words() {
    let mut state = at_work();
    hides(&small(&state), "says");
    state.knows_vendor_code = true;
    let set = |state: &mut State, code| state.status.as_mut().unwrap().2.vendor_code = code;
    set(&mut state, 0x0401);
    let line = " Node 42 says 0x0401: restarted by the watchdog, failsafe ";
    shows(&small(&state), &["vendor code 0x0401", line]);
    // A large terminal shows each condition. A small one counts those that do not fit, and shows
    // all other values.
    set(&mut state, 0xFFF9);
    both_show(&state, &["restarted by the watchdog, transfer errors,", TEMPERATURE]);
    shows(&drawn(&state, &Screen::default(), LARGE), &["speaks the draft"]);
    shows(&small(&state), &[" more "]);
    set(&mut state, 0);
    hides(&small(&state), "says");
}

#[test]
fn no_size_of_the_terminal_panics() {
    let state = at_work();
    for popup in [Popup::Faults, Popup::Types, Popup::Help] {
        let screen = Screen { popup: Some(popup), ..Screen::default() };
        for size in [(1, 1), (10, 3), (79, 24), (80, 23), (80, 24), (120, 40), (300, 100)] {
            drawn(&state, &screen, size);
        }
    }
}

#[test]
fn a_small_terminal_shows_the_size_that_is_needed() {
    shows(&drawn(&at_work(), &Screen::default(), (60, 20)), &["80x24"]);
}

#[test]
fn help_lists_every_key() {
    let screen = Screen { popup: Some(Popup::Help), ..Screen::default() };
    let picture = drawn(&at_work(), &screen, SMALL);
    for (keys, text) in keys::HELP {
        shows(&picture, &[keys, text]);
    }
}

#[test]
fn the_menu_has_every_fault_with_its_key_and_marks_those_that_are_on() {
    let mut state = at_work();
    state.active_faults.push(Fault::NoAck);
    let screen = Screen { popup: Some(Popup::Faults), is_paused: true, ..Screen::default() };
    let picture = drawn(&state, &screen, SMALL);
    let lines = ["1     bit-error", "4 on  no-ack", "8 off spi-noise"];
    shows(&picture, &lines);
    shows(&picture, &["as in listen-only mode     │", "PAUSED"]);
    for fault in crate::fault::ALL {
        let key = keys::key_of(fault).unwrap();
        let marks = ["   ", "off", "on "].map(|mark| format!(" {key} {mark} {fault} "));
        assert!(marks.iter().any(|cell| picture.contains(cell)), "{fault} {key}\n{picture}");
    }
}

#[test]
fn the_faults_that_are_on_are_listed_with_the_keys_that_end_them() {
    let mut state = at_work();
    let line = "Faults on (x ends all):";
    hides(&small(&state), line);
    state.active_faults =
        vec![Fault::Cable, Fault::Silence, Fault::StuckDominant, Fault::ErrorStorm];
    let faults = [line, " c cable ", " a silence ", " 5 stuck-dominant ", " error-storm "];
    shows(&small(&state), &faults);
    // Even with all faults, conditions and links, each line of traffic and of the serial monitor
    // stays.
    state.active_faults = crate::fault::ALL.into_iter().filter(|fault| fault.lasts()).collect();
    state.knows_vendor_code = true;
    state.links = (1..=10).map(|number| format!("slcan /tmp/can{number}: open")).collect();
    let rest = [TEMPERATURE, "node 0.1.0 id 42", "and 10 more"];
    shows(&small(&state), &[&[line, " more"], &rest[..]].concat());
}

#[test]
fn hidden_types_are_named_and_their_lines_are_not_shown() {
    let state = at_work();
    let hide = |names: &[&str]| {
        let hidden = names.iter().map(|name| name.to_string()).collect();
        drawn(&state, &Screen { hidden, ..Screen::default() }, SMALL)
    };
    shows(&hide(&[]), &["┌ Traffic ─", "1 ArrayCommand id"]);
    let picture = hide(&["ArrayCommand"]);
    shows(&picture, &["┌ Traffic without ArrayCommand ─", "42 Temperature device 1"]);
    hides(&picture, "1 ArrayCommand id");
    let names: Vec<String> = (0..9).map(|number| format!("message {number}000")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    shows(&hide(&names), &["┌ Traffic without 9 types ─"]);
}

#[test]
fn the_list_of_types_marks_hidden_ones_and_scrolls_to_the_cursor() {
    let mut state = at_work();
    let hidden = [String::from("ArrayCommand")].into();
    let screen = Screen { popup: Some(Popup::Types), hidden, ..Screen::default() };
    let expected = ["hidden ArrayCommand ", "       NodeStatus ", "Esc closes"];
    shows(&drawn(&state, &screen, SMALL), &expected);
    for number in 0..40 {
        let name = format!("message {number}");
        state.traffic.push(TrafficLine::sample(0, &name, &name));
    }
    let selected = state.traffic.types().len() - 1;
    shows(&drawn(&state, &Screen { selected, ..screen.clone() }, SMALL), &["further types "]);
    shows(&drawn(&State::new(1_000_000), &screen, SMALL), &["no traffic yet"]);
}

/// The footer names the keys that fit. It always names the help, which has them all.
#[test]
fn the_footer_of_a_wide_terminal_names_every_key() {
    let foot = |columns| {
        let picture = drawn(&at_work(), &Screen::default(), (columns, ROWS_MIN));
        picture.lines().last().unwrap().to_owned()
    };
    let wide = foot(160);
    let aliases = [("left", "←"), ("right", "→"), ("t", "tT"), ("T", "tT")];
    // Keys that the lists themselves name, and second names of keys.
    let elsewhere = "1..9 A..P up down space Enter PgDn End ? Ctrl-C Ctrl-Z k";
    let keys = keys::HELP.iter().flat_map(|(keys, _)| keys.split(' '));
    for key in keys.filter(|key| !elsewhere.split(' ').any(|other| other == *key)) {
        let shown = aliases.iter().find(|(name, _)| *name == key).map_or(key, |(_, shown)| shown);
        assert!(wide.split([' ', '"']).any(|word| word.contains(shown)), "{key} is not in {wide}");
    }
    for columns in [80, 120] {
        shows(&foot(columns), &["f faults", "/ filter", "h help", "q quit"]);
    }
}

#[test]
fn the_links_are_shown_and_leave_room_for_the_rest() {
    let mut state = at_work();
    state.links = (1..=10).map(|number| format!("slcan /tmp/can{number}: open")).collect();
    let rest = [TEMPERATURE, "node 0.1.0 id 42"];
    both_show(&state, &[&["slcan /tmp/can1: open"], &rest[..]].concat());
    shows(&small(&state), &["and 8 more"]);
    shows(&drawn(&state, &Screen::default(), LARGE), &["slcan /tmp/can10: open"]);
}

#[test]
fn scrolled_traffic_shows_older_lines() {
    let mut state = State::new(1_000_000);
    (0..100).for_each(|number| add_frame(&mut state, 0, 0x1004_5701, &[number, 0xC0], false));
    assert!(matches!(state.take_events()[0].1, Event::Traffic(_)));
    shows(&small(&state), &["thesis.ServoCommand 99"]);
    let older = drawn(&state, &Screen { until: Some(49), ..Screen::default() }, SMALL);
    shows(&older, &["thesis.ServoCommand 49", "50 lines back"]);
    hides(&older, "thesis.ServoCommand 50");
}

#[test]
fn further_outputs_are_drawn_with_their_names_while_they_give_pulses() {
    let mut state = at_work();
    let now = state.now;
    state.set_output_pulses([Some((now, 16_000)), None]);
    shows(&small(&state), &["OUT2 ├─█─┼──┤ 1000 "]);
    let pulse = |n: u64| (n != 2).then_some((now, (800 + 200 * n) * 16));
    state.set_output_pulses((0..7).map(pulse));
    for size in [SMALL, (110, ROWS_MIN), (160, 45)] {
        let picture = drawn(&state, &Screen::default(), size);
        shows(&picture, &[" OUT1 (D10) and temperature (A0) ", "pulse 1750.0 us"]);
        shows(&picture, &[" OUT2 ├█──┼──┤  800 ", " OUT3 ├─█─┼──┤ 1000 "]);
        shows(&picture, &[" OUT4 ├───┼──┤    - ", " OUT8 ├───┼█─┤ 2000 "]);
    }
    let others: Vec<&str> =
        VALUES.iter().copied().filter(|value| !value.starts_with("Servo")).collect();
    shows(&small(&state), &others);
    state.advance_to(now + SECOND);
    hides(&drawn(&state, &Screen::default(), (120, 40)), "OUT");
}

#[test]
fn motors_are_drawn_with_their_throttle_and_without_an_arm() {
    let mut state = at_work();
    let now = state.now;
    // OneShot125: 40 % and, of OUT2 and OUT3, 0 and 100 %.
    state.add_pulse(now, 175 * 16, Some(SECOND / 400));
    state.set_output_pulses([Some((now, 125 * 16)), Some((now, 250 * 16))]);
    both_show(&state, &["pulse 175.0 us", "throttle 40.0 % (OneShot125)", " 100 %"]);
    both_show(&state, &[" OUT2 ────────   0% ", " OUT3 ████████ 100% "]);
    for size in [SMALL, LARGE] {
        hides(&drawn(&state, &Screen::default(), size), "deg");
    }
    // Normal pulses of a single output that --escs names.
    let mut state = at_work();
    state.escs = Escs::new(&[1]);
    both_show(&state, &[" Motor (D10) ", "pulse 1750.0 us", "throttle 75.0 %  pulses"]);
    state.advance_to(now + SECOND);
    shows(&small(&state), &["no pulse: the motor is off", "throttle -"]);
}

#[test]
fn eighty_by_twenty_four_cuts_no_amount_and_marks_what_is_cut() {
    let mut state = at_work();
    let limits = Some(Budget::of(Chip::Atmega328p));
    state.memory = Memory { flash: 28_370, statics: Some(1_368), stack: Some(227), limits };
    state.add_mistake(SECOND, format!("mistake {} end", "with a long text ".repeat(6).trim()));
    for byte in "a line of the serial monitor ".repeat(4).bytes().chain(*b"\n") {
        state.push_serial_byte(11 * SECOND, byte);
    }
    let amounts = ["│statics 1,368/1,", ", RAM 1,595/1,792 B│"];
    shows(&small(&state), &[&amounts[..], &[" text end ", "a line of the seria…│"]].concat());
}

/// Each measurement that only some programs send, on both sizes; the amount of flash stays.
#[test]
fn what_the_node_measures_is_shown_after_its_first_message() {
    let mut state = at_work();
    let circuit = |state: &mut State, current: [u8; 2], errors: u8| {
        let data = [120, 0, 0x4D, 0x4A, current[0], current[1], errors, 0xC5];
        let now = state.now;
        add_frame(state, now, 0x1804_432A, &data, true);
    };
    hides(&small(&state), "circuit");
    circuit(&mut state, [0x66, 0x42], 4);
    let expected = ["circuit 12.60 V  3.20 A OVERCURRENT", "CircuitStatus circuit 120 12.60 V"];
    both_show(&state, &[&expected[..], &["flash 9,876 of 14,336 B"]].concat());
    circuit(&mut state, [0xFF, 0x7F], 0);
    shows(&small(&state), &["circuit 12.60 V  - A "]);

    let mut state = at_work();
    state.measured.battery = Some(BatteryInfo { flags: 0x21, ..battery_info(40.0, 80) });
    both_show(&state, &["battery 3 12.60 V 3.20 A 80 % 40.0 Wh"]);
    let picture = drawn(&state, &Screen::default(), LARGE);
    shows(&picture, &["40.0 Wh OVERLOAD", "flash 9,876"]);
    let (voltage, current) = (f16::from_f32(12.6), f16::from_f32(3.2));
    state.measured.circuit = Some(CircuitStatus { circuit: 1, voltage, current, errors: 0 });
    let both = ["circuit 12.60 V  3.20 A", "battery 3 80 % 40.0 Wh OVERLOAD", "flash 9,876"];
    shows(&small(&state), &both);

    let mut state = at_work();
    state.measured.hardpoints = [(5, 0), (6, 1)].into();
    both_show(&state, &["hardpoint 5 release, 6 hold", "flash 9,876"]);

    let mut state = at_work();
    state.wiring.rpm = state.wiring.light.take();
    state.shaft_rpm = 6000;
    let rpm = |flags, rpm| Some(Rpm { sensor: 0, flags, rpm });
    for (rpm, text) in
        [(None, "sends none"), (rpm(0, 5999.8), "6000 rpm"), (rpm(1, 0.0), "UNHEALTHY")]
    {
        state.measured.rpm = rpm;
        both_show(&state, &[&format!("shaft (D3) 6000 rpm  node {text}"), "flash 9,876"]);
    }
}

#[test]
fn a_hint_stays_on_the_screen_until_it_is_acknowledged() {
    let mut state = at_work();
    let hint = "the node is at 500 kbit/s, the bus at 1000 kbit/s: each gets only errors from \
                the other. Set the program's bit rate, its crystal (--crystal), or the bus \
                (--bit-rate)";
    state.add_hint(0, String::from(hint));
    state.add_unmodelled(0, "the TWI (I2C): no device is on its bus");
    for size in [SMALL, LARGE] {
        let after =
            |acknowledged| drawn(&state, &Screen { acknowledged, ..Screen::default() }, size);
        shows(&after(0), &["HINT (k: seen, 1 more): the node is at 500 kbit/s", "(--bit-rate)"]);
        shows(&after(0), VALUES);
        shows(&after(1), &["HINT (k: seen): not modelled exactly: the TWI (I2C)"]);
        hides(&after(2), "HINT");
    }
}
