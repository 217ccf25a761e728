//! Tests of the live view, drawn into memory at the smallest size and at a large one.

use super::*;
use crate::ui::escs::Escs;
use crate::ui::keys::Popup;
use crate::ui::state::{AutopilotState, Event, Memory, battery_info};
use bench::avr::Chip;
use bench::can::{self, Record, RecordKind};
use bench::dronecan::{CircuitStatus, Rpm};
use half::f16;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

const SECOND: u64 = bench::F_CPU_HZ;

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
        let record = Record {
            start: 11 * SECOND,
            end: 11 * SECOND + 2_000,
            bits: 125,
            kind: RecordKind::Frame {
                frame: can::Frame::extended(id, data),
                from: None,
                acked: true,
            },
        };
        state.add_record(&record, from_node, None);
    }
    state.add_latency(1_360);
    state.advance_to(11 * SECOND + 400_000);
    state
}

fn drawn(state: &State, screen: &Screen, columns: u16, rows: u16) -> String {
    let mut terminal = Terminal::new(TestBackend::new(columns, rows)).unwrap();
    terminal.draw(|frame| _ = draw(frame, state, screen)).unwrap();
    terminal.backend().to_string()
}

#[track_caller]
fn shows(picture: &str, expected: &[&str]) {
    for expected in expected {
        assert!(picture.contains(expected), "{expected} is not in\n{picture}");
    }
}

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
    "frame served in 85 us, worst 85 us",
    "1 ArrayCommand id 1 unitless +0.50",
    "42 Temperature device 1 298.25 K",
    "node 0.1.0 id 42",
    "autopilot 1 sweeps +0.50 unitless",
];

#[test]
fn eighty_by_twenty_four_shows_every_value() {
    let picture = drawn(&at_work(), &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    shows(&picture, VALUES);
    shows(&picture, &["500 ├", "h help", "q quit"]);
}

#[test]
fn a_large_terminal_shows_every_value_and_the_dial() {
    let picture = drawn(&at_work(), &Screen::default(), 140, 45);
    shows(&picture, VALUES);
    let is_braille = |c: char| ('\u{2801}'..='\u{28FF}').contains(&c);
    assert!(picture.chars().filter(|c| is_braille(*c)).count() > 40, "{picture}");
}

#[test]
fn the_draft_is_noted_at_the_autopilot_and_at_the_node() {
    let mut state = at_work();
    state.autopilot =
        state.autopilot.map(|autopilot| AutopilotState { dialect: Dialect::Draft, ..autopilot });
    let frames: [(u32, &[u8]); 2] =
        [(0x1135_E00B, &[0xEF, 0xCD, 0xAB, 0x02, 0xEF, 0xBE]), (0x17CD_E008, &[23])];
    for (id, data) in frames {
        let (start, end) = (state.now, state.now + 2_000);
        let kind =
            RecordKind::Frame { frame: can::Frame::extended(id, data), from: None, acked: true };
        state.add_record(&Record { start, end, bits: 125, kind }, true, None);
    }
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    let expected = [
        "autopilot 1 (draft) sweeps +0.50 unitless",
        "Node 120 (draft) on diecimila",
        "WARNING OPERATIONAL",
        "vendor code 0xBEEF",
        "node sends 23",
        "120 draft.NodeStatus WARNING up 11259375 s",
    ];
    shows(&picture, &expected);
}

#[test]
fn the_titles_name_the_board_and_its_pins() {
    let mut state = at_work();
    state.wiring = Wiring::of("uno", "module").unwrap();
    state.memory.limits = None;
    state.set_light(SECOND, 0.5);
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    let expected = [
        "Servo (D9) and temperature (A0)",
        "on uno (ATmega328P)",
        "MCP2515: Normal, module, 8 MHz",
        "light (D3) 50 %",
    ];
    shows(&picture, &expected);
    shows(&picture, &["flash 9,876 B ", "statics 312, RAM 512 B"]);
}

#[test]
fn the_vendor_code_of_this_projects_program_is_in_words() {
    let mut state = at_work();
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    assert!(!picture.contains("says"), "a foreign program's code is a number:\n{picture}");
    state.knows_vendor_code = true;
    let set = |state: &mut State, code| state.status.as_mut().unwrap().2.vendor_code = code;
    set(&mut state, 0x0401);
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    shows(
        &picture,
        &["vendor code 0x0401", " Node 42 says 0x0401: restarted by the watchdog, failsafe "],
    );
    // A large terminal shows each condition. A small one counts those that do not fit, and shows
    // all other values.
    set(&mut state, 0xFFF9);
    let picture = drawn(&state, &Screen::default(), 140, 45);
    shows(&picture, &["speaks the draft", "42 Temperature device 1 298.25 K"]);
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    shows(
        &picture,
        &[
            "restarted by the watchdog, transfer errors,",
            " more ",
            "42 Temperature device 1 298.25 K",
        ],
    );
    set(&mut state, 0);
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    assert!(!picture.contains("says"), "{picture}");
}

#[test]
fn no_size_of_the_terminal_panics() {
    let state = at_work();
    for popup in [Popup::Faults, Popup::Types, Popup::Help] {
        let screen = Screen { popup: Some(popup), ..Screen::default() };
        for (columns, rows) in
            [(1, 1), (10, 3), (79, 24), (80, 23), (80, 24), (120, 40), (300, 100)]
        {
            drawn(&state, &screen, columns, rows);
        }
    }
}

#[test]
fn a_small_terminal_shows_the_size_that_is_needed() {
    let picture = drawn(&at_work(), &Screen::default(), 60, 20);
    shows(&picture, &["80x24"]);
}

#[test]
fn driver_mistakes_and_crashes_stand_out() {
    let mut state = at_work();
    state.add_mistake(SECOND, String::from("SPI byte with CS high"));
    state.set_crash(SECOND, String::from("invalid instruction"));
    let picture = drawn(&state, &Screen::default(), 80, 24);
    shows(&picture, &["1 DRIVER MISTAKE", "SPI byte with CS high", "CRASHED: invalid"]);
}

#[test]
fn a_silent_node_has_no_pulse_no_status_and_no_temperature() {
    let picture = drawn(&State::new(500_000), &Screen::default(), 80, 24);
    shows(&picture, &["no pulse", "no NodeStatus yet", "node sends none", "Bus 500 kbit/s"]);
}

#[test]
fn help_lists_every_key() {
    let screen = Screen { popup: Some(Popup::Help), ..Screen::default() };
    let picture = drawn(&at_work(), &screen, 80, 24);
    for (keys, text) in keys::HELP {
        shows(&picture, &[keys, text]);
    }
}

#[test]
fn the_menu_lists_the_faults_and_marks_those_that_are_on() {
    let mut state = at_work();
    state.active_faults.push(Fault::NoAck);
    let screen = Screen { popup: Some(Popup::Faults), is_paused: true, ..Screen::default() };
    let picture = drawn(&state, &screen, 80, 24);
    shows(
        &picture,
        &[
            "1     bit-error",
            "4 on  no-ack",
            "8 off spi-noise",
            "as in listen-only mode     │",
            "PAUSED",
        ],
    );
}

#[test]
fn the_faults_that_are_on_are_listed_with_the_keys_that_end_them() {
    let mut state = at_work();
    let line = "Faults on (x ends all):";
    assert!(!drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN).contains(line));
    state.active_faults =
        vec![Fault::Cable, Fault::Silence, Fault::StuckDominant, Fault::ErrorStorm];
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    shows(&picture, &[line, " c cable ", " a silence ", " 5 stuck-dominant ", " error-storm "]);
    // Even with all faults, conditions and links, each line of traffic and of the serial monitor
    // stays.
    state.active_faults = crate::fault::ALL.into_iter().filter(|fault| fault.lasts()).collect();
    state.knows_vendor_code = true;
    state.links = (1..=10).map(|number| format!("slcan /tmp/can{number}: open")).collect();
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    shows(
        &picture,
        &[line, " more", "42 Temperature device 1 298.25 K", "node 0.1.0 id 42", "and 10 more"],
    );
}

#[test]
fn hidden_types_are_named_and_their_lines_are_not_shown() {
    let state = at_work();
    let hide = |names: &[&str]| {
        let hidden = names.iter().map(|name| name.to_string()).collect();
        drawn(&state, &Screen { hidden, ..Screen::default() }, COLUMNS_MIN, ROWS_MIN)
    };
    shows(&hide(&[]), &["┌ Traffic ─", "1 ArrayCommand id"]);
    let picture = hide(&["ArrayCommand"]);
    shows(&picture, &["┌ Traffic without ArrayCommand ─", "42 Temperature device 1"]);
    assert!(!picture.contains("1 ArrayCommand id"), "{picture}");
    let names: Vec<String> = (0..9).map(|number| format!("message {number}000")).collect();
    shows(
        &hide(&names.iter().map(String::as_str).collect::<Vec<_>>()),
        &["┌ Traffic without 9 types ─"],
    );
}

#[test]
fn the_list_of_types_marks_hidden_ones_and_scrolls_to_the_cursor() {
    let mut state = at_work();
    let hidden = [String::from("ArrayCommand")].into();
    let screen = Screen { popup: Some(Popup::Types), hidden, ..Screen::default() };
    let picture = drawn(&state, &screen, COLUMNS_MIN, ROWS_MIN);
    shows(&picture, &["hidden ArrayCommand ", "       NodeStatus ", "Esc closes"]);
    for number in 0..40 {
        let (who, name) = (String::from("1"), format!("message {number}"));
        let line = TrafficLine { at: 0, origin: Origin::Other, who, text: name.clone(), name };
        state.traffic.push(line);
    }
    let last = state.traffic.types().len() - 1;
    let picture =
        drawn(&state, &Screen { selected: last, ..screen.clone() }, COLUMNS_MIN, ROWS_MIN);
    shows(&picture, &["further types "]);
    let nothing = drawn(&State::new(1_000_000), &screen, COLUMNS_MIN, ROWS_MIN);
    shows(&nothing, &["no traffic yet"]);
}

/// The footer names the keys that fit. It always names the help, which has them all.
#[test]
fn the_footer_of_a_wide_terminal_names_every_key() {
    let foot = |columns| {
        let picture = drawn(&at_work(), &Screen::default(), columns, ROWS_MIN);
        picture.lines().last().unwrap().to_owned()
    };
    let wide = foot(160);
    let aliases = [("left", "←"), ("right", "→"), ("t", "tT"), ("T", "tT")];
    // Keys that the lists themselves name, and second names of keys.
    let elsewhere = [
        "1..9", "A..P", "up", "down", "space", "Enter", "PgDn", "End", "?", "Ctrl-C", "Ctrl-Z", "k",
    ];
    for key in keys::HELP
        .iter()
        .flat_map(|(keys, _)| keys.split(' '))
        .filter(|key| !elsewhere.contains(key))
    {
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
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    shows(
        &picture,
        &[
            "slcan /tmp/can1: open",
            "and 8 more",
            "42 Temperature device 1 298.25 K",
            "node 0.1.0 id 42",
        ],
    );
    let picture = drawn(&state, &Screen::default(), 140, 45);
    shows(&picture, &["slcan /tmp/can1: open", "slcan /tmp/can10: open"]);
}

#[test]
fn the_title_of_a_bench_without_autopilot_says_no_autopilot() {
    let mut state = at_work();
    state.autopilot = None;
    shows(&drawn(&state, &Screen::default(), 80, 24), &["no autopilot"]);
}

#[test]
fn a_lit_light_and_a_disarmed_vehicle_are_shown() {
    let mut state = at_work();
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    assert!(!picture.contains("light") && !picture.contains("disarmed"));
    state.set_light(SECOND, 0.5);
    state.autopilot.as_mut().unwrap().is_armed = false;
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    shows(&picture, &["angle +22.5 deg  light (D3) 50 %", "autopilot 1 sweeps", "disarmed"]);
}

#[test]
fn scrolled_traffic_shows_older_lines() {
    let mut state = State::new(1_000_000);
    for number in 0..100u8 {
        let record = Record {
            start: 0,
            end: 0,
            bits: 100,
            kind: RecordKind::Frame {
                frame: can::Frame::extended(0x1004_5701, &[number, 0xC0]),
                from: None,
                acked: true,
            },
        };
        state.add_record(&record, false, None);
    }
    assert!(matches!(state.take_events()[0].1, Event::Traffic(_)));
    let newest = drawn(&state, &Screen::default(), 80, 24);
    shows(&newest, &["thesis.ServoCommand 99"]);
    let screen = Screen { until: Some(49), ..Screen::default() };
    let older = drawn(&state, &screen, 80, 24);
    shows(&older, &["thesis.ServoCommand 49", "50 lines back"]);
    assert!(!older.contains("thesis.ServoCommand 50"));
}

#[test]
fn the_title_says_that_all_actuators_move_and_how_many_motors_turn() {
    let mut state = at_work();
    state.autopilot = state.autopilot.map(|autopilot| AutopilotState {
        moves_all: true,
        motors: 20,
        ..autopilot
    });
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    shows(&picture, &["autopilot 1 sweeps all unitless, 20 motors"]);
}

#[test]
fn further_outputs_are_drawn_with_their_names_while_they_give_pulses() {
    let mut state = at_work();
    let now = state.now;
    state.set_output_pulses([Some((now, 16_000)), None]);
    shows(&drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN), &["OUT2 ├─█─┼──┤ 1000 "]);
    let pulse = |n: u64| (n != 2).then_some((now, (800 + 200 * n) * 16));
    state.set_output_pulses((0..7).map(pulse));
    for (columns, rows) in [(COLUMNS_MIN, ROWS_MIN), (110, ROWS_MIN), (160, 45)] {
        let picture = drawn(&state, &Screen::default(), columns, rows);
        shows(&picture, &[" OUT1 (D10) and temperature (A0) ", "pulse 1750.0 us"]);
        shows(&picture, &[" OUT2 ├█──┼──┤  800 ", " OUT3 ├─█─┼──┤ 1000 "]);
        shows(&picture, &[" OUT4 ├───┼──┤    - ", " OUT8 ├───┼█─┤ 2000 "]);
    }
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    let values: Vec<_> = VALUES.iter().filter(|value| !value.starts_with("Servo")).collect();
    shows(&picture, &values.into_iter().copied().collect::<Vec<_>>());
    state.advance_to(now + SECOND);
    let picture = drawn(&state, &Screen::default(), 120, 40);
    assert!(!picture.contains("OUT"), "{picture}");
}

#[test]
fn motors_are_drawn_with_their_throttle_and_without_an_arm() {
    let mut state = at_work();
    let now = state.now;
    // OneShot125: 40 % and, of OUT2 and OUT3, 0 and 100 %.
    state.add_pulse(now, 175 * 16, Some(SECOND / 400));
    state.set_output_pulses([Some((now, 125 * 16)), Some((now, 250 * 16))]);
    for (columns, rows) in [(COLUMNS_MIN, ROWS_MIN), (160, 45)] {
        let picture = drawn(&state, &Screen::default(), columns, rows);
        shows(&picture, &["pulse 175.0 us", "throttle 40.0 % (OneShot125)", " 100 %"]);
        shows(&picture, &[" OUT2 ────────   0% ", " OUT3 ████████ 100% "]);
        assert!(!picture.contains("deg"), "{picture}");
    }
    // Normal pulses of a single output that --escs names.
    let mut state = at_work();
    state.escs = Escs::new(&[1]);
    for (columns, rows) in [(COLUMNS_MIN, ROWS_MIN), (160, 45)] {
        let picture = drawn(&state, &Screen::default(), columns, rows);
        shows(&picture, &[" Motor (D10) ", "pulse 1750.0 us", "throttle 75.0 %  pulses"]);
    }
    state.advance_to(now + SECOND);
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    shows(&picture, &["no pulse: the motor is off", "throttle -"]);
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
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    shows(
        &picture,
        &["│statics 1,368/1,", ", RAM 1,595/1,792 B│", " text end ", "a line of the seria…│"],
    );
}

#[test]
fn the_circuit_is_shown_after_the_first_circuit_status() {
    let send = |state: &mut State, current: [u8; 2], errors: u8| {
        let data = [120, 0, 0x4D, 0x4A, current[0], current[1], errors, 0xC5];
        let (start, end) = (state.now, state.now + 2_000);
        let frame = can::Frame::extended(0x1804_432A, &data);
        let kind = RecordKind::Frame { frame, from: None, acked: true };
        state.add_record(&Record { start, end, bits: 125, kind }, true, None);
    };
    let mut state = at_work();
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    assert!(!picture.contains("circuit"), "{picture}");
    send(&mut state, [0x66, 0x42], 4);
    for (columns, rows) in [(COLUMNS_MIN, ROWS_MIN), (140, 45)] {
        let picture = drawn(&state, &Screen::default(), columns, rows);
        shows(
            &picture,
            &[
                "circuit 12.60 V  3.20 A OVERCURRENT",
                "flash 9,876 of 14,336 B",
                "CircuitStatus circuit 120 12.60 V",
            ],
        );
    }
    send(&mut state, [0xFF, 0x7F], 0);
    shows(&drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN), &["circuit 12.60 V  - A "]);
}

#[test]
fn the_battery_is_shown_with_its_charge_and_without_the_circuit_with_voltage_and_current() {
    let mut state = at_work();
    let mut battery = battery_info(40.0, 80);
    battery.flags = 0x21;
    state.measured.battery = Some(battery);
    for (columns, rows) in [(COLUMNS_MIN, ROWS_MIN), (140, 45)] {
        let picture = drawn(&state, &Screen::default(), columns, rows);
        shows(&picture, &["battery 3 12.60 V 3.20 A 80 % 40.0 Wh"]);
    }
    shows(&drawn(&state, &Screen::default(), 140, 45), &["40.0 Wh OVERLOAD", "flash 9,876"]);
    let (voltage, current) = (f16::from_f32(12.6), f16::from_f32(3.2));
    state.measured.circuit = Some(CircuitStatus { circuit: 1, voltage, current, errors: 0 });
    shows(
        &drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN),
        &["circuit 12.60 V  3.20 A", "battery 3 80 % 40.0 Wh OVERLOAD", "flash 9,876"],
    );
}

#[test]
fn the_relays_are_shown_with_what_they_do() {
    let mut state = at_work();
    state.measured.hardpoints = [(5, 0), (6, 1)].into();
    for (columns, rows) in [(COLUMNS_MIN, ROWS_MIN), (140, 45)] {
        let picture = drawn(&state, &Screen::default(), columns, rows);
        shows(&picture, &["hardpoint 5 release, 6 hold", "flash 9,876"]);
    }
}

#[test]
fn the_shaft_is_shown_with_the_speed_that_the_node_sends() {
    let mut state = at_work();
    state.wiring.rpm = state.wiring.light.take();
    state.shaft_rpm = 6000;
    for (columns, rows) in [(COLUMNS_MIN, ROWS_MIN), (140, 45)] {
        let mut shown = |rpm: Option<Rpm>, text: &str| {
            state.measured.rpm = rpm;
            let picture = drawn(&state, &Screen::default(), columns, rows);
            shows(&picture, &[&format!("shaft (D3) 6000 rpm  node {text}"), "flash 9,876"]);
        };
        shown(None, "sends none");
        shown(Some(Rpm { sensor: 0, flags: 0, rpm: 5999.8 }), "6000 rpm");
        shown(Some(Rpm { sensor: 0, flags: 1, rpm: 0.0 }), "UNHEALTHY");
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
    for (columns, rows) in [(COLUMNS_MIN, ROWS_MIN), (140, 45)] {
        let mut screen = Screen::default();
        let picture = drawn(&state, &screen, columns, rows);
        shows(&picture, &["HINT (k: seen, 1 more): the node is at 500 kbit/s", "(--bit-rate)"]);
        shows(&picture, VALUES);
        screen.acknowledged = 1;
        let picture = drawn(&state, &screen, columns, rows);
        shows(&picture, &["HINT (k: seen): not modelled exactly: the TWI (I2C)"]);
        screen.acknowledged = 2;
        assert!(!drawn(&state, &screen, columns, rows).contains("HINT"));
    }
}

#[test]
fn a_silent_node_is_not_called_ok() {
    let mut state = at_work();
    shows(&drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN), &["OK OPERATIONAL"]);
    state.advance_to(19 * SECOND + 2_000);
    let picture = drawn(&state, &Screen::default(), COLUMNS_MIN, ROWS_MIN);
    shows(&picture, &["SILENT for 8.0 s", "before: OK OPERATIONAL 0xBEEF"]);
    assert!(!picture.contains("│OK"), "{picture}");
}

#[test]
fn the_list_of_faults_has_every_fault_with_its_key() {
    let screen = Screen { popup: Some(Popup::Faults), ..Screen::default() };
    let mut state = at_work();
    state.active_faults.push(Fault::SensorShort);
    let picture = drawn(&state, &screen, COLUMNS_MIN, ROWS_MIN);
    for fault in crate::fault::ALL {
        let key = keys::key_of(fault).unwrap();
        let marks = ["   ", "off", "on "].map(|mark| format!(" {key} {mark} {fault} "));
        assert!(marks.iter().any(|cell| picture.contains(cell)), "{fault} {key}\n{picture}");
    }
    shows(&picture, &[&format!("{} on  sensor-short", keys::key_of(Fault::SensorShort).unwrap())]);
}
