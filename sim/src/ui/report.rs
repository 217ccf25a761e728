//! The result of a run for other programs: `--json FILE`, and the exit code.
//!
//! Field names and units are a stable interface: a CI job may read any of them. A version may add
//! fields; it changes none.
//!
//! `findings` lists everything that was wrong. `outcome` is the worst of them that counts as a
//! failure: a crash and a mistake always, what is wrong with the program by the option `--strict`,
//! and what is not modelled by `--unmodelled-exit`. `--allow` leaves out single ones.

use super::state::State;
use crate::time::{micros, seconds};
use bench::dronecan::battery::PERCENT_UNKNOWN;
use clap::ValueEnum;
use serde::Serialize;
use std::process::ExitCode;

/// What was wrong in a run, the worst first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Finding {
    /// The firmware crashed.
    #[value(skip)]
    Crashed,
    /// The firmware misused a chip.
    Mistakes,
    /// The firmware started again: after a reset, or by a jump to its start.
    Restarted,
    /// Frames for the node were lost, because both receive buffers were full.
    LostFrames,
    /// The node has neither sent a frame nor fetched one from the MCP2515. A program that leaves
    /// the SPI alone, and is not one of this project, need not.
    NeverSent,
    /// There was a hint.
    Hints,
    /// The firmware used something of the processor that is not modelled exactly.
    Unmodelled,
}

impl Finding {
    /// What was wrong in the run that ended in `state`.
    pub fn all_of(state: &State) -> Vec<Finding> {
        let found = [
            (state.crash.is_some(), Finding::Crashed),
            (state.mistakes.total() > 0, Finding::Mistakes),
            (state.resets_total > 0, Finding::Restarted),
            (state.controller.overflows > 0, Finding::LostFrames),
            (state.has_never_sent(), Finding::NeverSent),
            (!state.hints.is_empty(), Finding::Hints),
            (!state.unmodelled.is_empty(), Finding::Unmodelled),
        ];
        found.into_iter().filter_map(|(is_so, finding)| is_so.then_some(finding)).collect()
    }

    /// The finding in words, for the last line of a run.
    fn text(self, state: &State) -> String {
        match self {
            Finding::Crashed => {
                format!("the node crashed: {}", state.crash.as_deref().unwrap_or_default())
            }
            Finding::Mistakes => {
                let first = state.mistakes.kinds().first().map_or("", |first| &first.text);
                let count = state.mistakes.total();
                format!("the node's program made {count} mistakes, the first: {first}")
            }
            Finding::Restarted => format!("the node restarted {} times", state.resets_total),
            Finding::LostFrames => format!("the node lost {} frames", state.controller.overflows),
            Finding::NeverSent => String::from("the node has neither sent nor fetched a frame"),
            Finding::Hints => format!("hint: {}", state.hints.first().map_or("", |hint| hint)),
            Finding::Unmodelled => {
                let first = state.unmodelled.first().map_or("", |text| text);
                format!("not modelled exactly: {first}")
            }
        }
    }
}

/// The findings that count as a failure, by the options.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Judgement {
    /// True if each finding is a failure that is wrong with the program.
    pub is_strict: bool,
    /// The findings that are no failure.
    pub allowed: Vec<Finding>,
    /// Exit code for [`Finding::Unmodelled`], if an option sets it.
    pub unmodelled_exit: Option<u8>,
}

impl Judgement {
    /// The worst finding that counts as a failure, and the exit code for it. The program returns 2
    /// for a wrong command line, and 3 for an error of this computer.
    pub fn failure(&self, state: &State) -> Option<(Finding, u8)> {
        let judged = |finding| match finding {
            allowed if self.allowed.contains(&allowed) => 0,
            Finding::Crashed | Finding::Mistakes => 1,
            Finding::Unmodelled => self.unmodelled_exit.unwrap_or(0),
            _ => u8::from(self.is_strict),
        };
        let findings = Finding::all_of(state).into_iter();
        findings.map(|finding| (finding, judged(finding))).find(|(_, code)| *code != 0)
    }

    /// The exit code of the run that ended in `state`, and the reason for a code other than 0.
    pub fn exit(&self, state: &State) -> (ExitCode, Option<String>) {
        match self.failure(state) {
            Some((finding, code)) => (code.into(), Some(finding.text(state))),
            None => (ExitCode::SUCCESS, None),
        }
    }
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(untagged)]
enum Outcome {
    #[serde(serialize_with = "as_well")]
    Well,
    Failed(Finding),
}

fn as_well<S: serde::Serializer>(serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str("well")
}

/// The report of a run, which `--json FILE` writes.
#[derive(Debug, Serialize)]
pub struct Report {
    outcome: Outcome,
    exit_code: u8,
    findings: Vec<Finding>,
    simulated_s: f64,
    board: String,
    crash: Option<String>,
    mistakes_total: u64,
    mistakes: Vec<Mistake>,
    hints: Vec<String>,
    /// What the program used of the processor that is not modelled exactly.
    unmodelled: Vec<String>,
    restarts_total: u64,
    /// The first 100 restarts.
    restarts: Vec<Restart>,
    bus: Bus,
    node: Node,
    servo: Servo,
    /// Output 2 to the last output with pulses.
    outputs: Vec<Output>,
    /// Last CircuitStatus of the node.
    circuit: Option<Circuit>,
    /// Last BatteryInfo of the node.
    battery: Option<Battery>,
    /// Last sensors.rpm.RPM of the node.
    rpm: Option<Revolutions>,
    spi: Spi,
    /// The registers of devices on the two-wire bus that the program has written.
    i2c: Vec<Registers>,
    budget: Budget,
}

#[derive(Debug, Serialize)]
struct Mistake {
    text: String,
    count: u64,
    first_s: f64,
}

#[derive(Debug, Serialize)]
struct Restart {
    at_s: f64,
    cause: String,
}

#[derive(Debug, Serialize)]
struct Bus {
    bit_rate: u32,
    frames: u64,
    error_frames: u64,
    unacknowledged: u64,
}

#[derive(Debug, Serialize)]
struct Node {
    frames_received: u64,
    frames_sent: u64,
    frames_lost: u64,
    /// The first 100 lost frames, in candump's notation.
    lost: Vec<LostFrame>,
    /// Longest time from the end of a frame until the driver released its buffer; `null` if it
    /// released none.
    served_within_us: Option<f64>,
    tec: u16,
    rec: u16,
}

#[derive(Debug, Serialize)]
struct LostFrame {
    at_s: f64,
    frame: String,
}

#[derive(Debug, Serialize)]
struct Servo {
    pulses: u64,
    /// Width of the last pulse; `null` if the output is off at the end.
    width_us: Option<f64>,
    period_us: Option<f64>,
    shortest_us: Option<f64>,
    longest_us: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Output {
    output: usize,
    /// Width of the last pulse; `null` if the output is off at the end.
    width_us: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Circuit {
    circuit_id: u16,
    /// `null` if the node does not know the value; the current, too.
    voltage_v: Option<f32>,
    current_a: Option<f32>,
    error_flags: u8,
}

#[derive(Debug, Serialize)]
struct Battery {
    battery_id: u8,
    /// `null` if the node does not know the value; the energy, too.
    charge_percent: Option<u8>,
    remaining_wh: Option<f32>,
    status_flags: u16,
}

#[derive(Debug, Serialize)]
struct Revolutions {
    sensor_id: u8,
    rpm: f32,
    flags: u16,
}

#[derive(Debug, Serialize)]
struct Registers {
    address: u8,
    /// The register of the first value. The others follow.
    register: u8,
    values: Vec<u8>,
}

#[derive(Debug, Serialize)]
struct Spi {
    selects: u64,
    bytes: u64,
    bytes_elsewhere: u64,
    selects_per_frame: Option<f64>,
    bytes_per_frame: Option<f64>,
}

/// Memory in bytes. Only programs of this project have limits.
#[derive(Debug, Serialize)]
struct Budget {
    flash: u32,
    flash_limit: Option<u32>,
    /// `null` for a chip with a bootloader.
    statics: Option<u32>,
    statics_limit: Option<u32>,
    /// `null` for a program with several stacks; the lowest stack pointer, too.
    stack: Option<u32>,
    lowest_sp: Option<u32>,
    statics_and_stack_limit: Option<u32>,
}

impl Report {
    /// The report of the run that ended in `state`.
    pub fn new(state: &State, judgement: &Judgement) -> Report {
        let failure = judgement.failure(state);
        let memory = &state.memory;
        Report {
            outcome: failure.map_or(Outcome::Well, |(finding, _)| Outcome::Failed(finding)),
            exit_code: failure.map_or(0, |(_, code)| code),
            findings: Finding::all_of(state),
            simulated_s: seconds(state.now),
            board: state.wiring.to_string(),
            crash: state.crash.clone(),
            mistakes_total: state.mistakes.total(),
            mistakes: state.mistakes.kinds().iter().map(Mistake::of).collect(),
            hints: state.hints.clone(),
            unmodelled: state.unmodelled.clone(),
            restarts_total: state.resets_total,
            restarts: state
                .resets
                .iter()
                .map(|(at, cause)| Restart { at_s: seconds(*at), cause: cause.clone() })
                .collect(),
            bus: Bus {
                bit_rate: state.bus.bit_rate,
                frames: state.bus.frames,
                error_frames: state.bus.error_frames,
                unacknowledged: state.bus.unacknowledged,
            },
            node: Node {
                frames_received: state.frames_for_node,
                frames_sent: state.frames_of_node,
                frames_lost: state.controller.overflows,
                lost: state
                    .lost_frames
                    .iter()
                    .map(|(at, frame)| LostFrame { at_s: seconds(*at), frame: frame.to_string() })
                    .collect(),
                served_within_us: state.latency.worst.map(micros),
                tec: state.controller.tec,
                rec: state.controller.rec,
            },
            servo: Servo {
                pulses: state.servo.count,
                width_us: state.servo.pulse.map(micros),
                period_us: state.servo.period.map(micros),
                shortest_us: state.servo.shortest.map(micros),
                longest_us: state.servo.longest.map(micros),
            },
            outputs: state
                .output_widths()
                .into_iter()
                .zip(2..)
                .map(|(width, output)| Output { output, width_us: width.map(micros) })
                .collect(),
            circuit: state.measured.circuit.map(|circuit| Circuit {
                circuit_id: circuit.circuit,
                voltage_v: Some(circuit.voltage.to_f32()).filter(|volts| !volts.is_nan()),
                current_a: Some(circuit.current.to_f32()).filter(|amperes| !amperes.is_nan()),
                error_flags: circuit.errors,
            }),
            battery: state.measured.battery.as_ref().map(|battery| Battery {
                battery_id: battery.battery,
                charge_percent: Some(battery.charge).filter(|&charge| charge != PERCENT_UNKNOWN),
                remaining_wh: Some(battery.remaining_wh.to_f32()).filter(|energy| !energy.is_nan()),
                status_flags: battery.flags,
            }),
            rpm: state.measured.rpm.map(|rpm| Revolutions {
                sensor_id: rpm.sensor,
                rpm: rpm.rpm,
                flags: rpm.flags,
            }),
            spi: Spi {
                selects: state.spi.selects,
                bytes: state.spi.bytes,
                bytes_elsewhere: state.spi.bytes_elsewhere,
                selects_per_frame: state.per_node_frame(state.spi.selects),
                bytes_per_frame: state.per_node_frame(state.spi.bytes),
            },
            i2c: state
                .i2c
                .iter()
                .cloned()
                .map(|(address, register, values)| Registers { address, register, values })
                .collect(),
            budget: Budget {
                flash: memory.flash,
                flash_limit: memory.limit(|limits| limits.flash),
                statics: memory.statics,
                statics_limit: memory.limit(|limits| limits.statics),
                stack: memory.stack,
                lowest_sp: state.lowest_sp(),
                statics_and_stack_limit: memory.limit(|limits| limits.statics_and_stack),
            },
        }
    }

    /// The report as JSON, with a newline at its end.
    pub fn to_json(&self) -> String {
        let json = serde_json::to_string_pretty(self).expect("numbers and texts only");
        json + "\n"
    }
}

impl Mistake {
    fn of(kind: &super::mistakes::Mistake) -> Mistake {
        Mistake { text: kind.text.clone(), count: kind.count, first_s: seconds(kind.first_at) }
    }
}

#[cfg(test)]
mod tests {
    use super::super::state::battery_info;
    use super::*;
    use bench::F_CPU_HZ;
    use bench::can::Frame;
    use bench::dronecan::{BatteryInfo, CircuitStatus, Rpm};
    use half::f16;
    use serde_json::{Value, json};

    fn report(state: &State) -> Value {
        serde_json::from_str(&Report::new(state, &Judgement::default()).to_json()).unwrap()
    }

    /// The report of a state has these values, by JSON Pointer.
    #[track_caller]
    fn has(state: &State, expected: &[(&str, Value)]) {
        let report = report(state);
        for (place, value) in expected {
            assert_eq!(report.pointer(place), Some(value), "{place} in {report}");
        }
    }

    #[test]
    fn a_run_without_events_is_clean_and_null_stands_for_what_was_not_measured() {
        let expected = [
            ("/outcome", json!("well")),
            ("/exit_code", json!(0)),
            ("/bus/bit_rate", json!(500_000)),
            ("/servo/width_us", Value::Null),
            ("/spi/bytes_per_frame", Value::Null),
            ("/outputs", json!([])),
            ("/circuit", Value::Null),
            ("/battery", Value::Null),
            ("/rpm", Value::Null),
        ];
        has(&State::new(500_000), &expected);
    }

    #[test]
    fn each_hint_is_given_once_and_the_number_of_hints_is_bounded() {
        let mut state = State::new(1_000_000);
        for number in 0..1000 {
            state.add_hint(number, String::from("the UART is at 9600 baud"));
            state.add_hint(number, format!("the UART is at {number} baud"));
        }
        assert_eq!(state.hints.len(), 20);
        assert_eq!(state.take_events().len(), 20);
    }

    /// A symbol of the program can have any name.
    #[test]
    fn names_from_the_program_have_no_control_characters_in_the_report() {
        let mut state = State::new(1_000_000);
        let name = "\u{1b}[2J\u{9b}\u{7f}";
        state.add_mistake(0, format!("mistake at {name}"));
        state.add_hint(0, format!("hint at {name}"));
        state.set_crash(0, format!("crash at {name}"));
        let shown = |what: &str| json!(format!("{what} at \\x1b[2J\\x9b\\x7f"));
        let expected = ["/mistakes/0/text", "/hints/0", "/crash"]
            .into_iter()
            .zip(["mistake", "hint", "crash"].map(shown));
        has(&state, &expected.collect::<Vec<_>>());
        let text = Report::new(&state, &Judgement::default()).to_json();
        assert!(!text.replace('\n', "").contains(char::is_control), "{text}");
    }

    #[test]
    fn the_report_has_what_the_node_measures_and_null_for_what_it_does_not_know() {
        let mut state = State::new(1_000_000);
        state.set_output_pulses([None, Some((0, 24_008)), None]);
        let (voltage, current) = (f16::from_f32(12.5), f16::NAN);
        state.measured.circuit = Some(CircuitStatus { circuit: 120, voltage, current, errors: 1 });
        state.measured.battery = Some(BatteryInfo { flags: 33, ..battery_info(40.0, 80) });
        state.measured.rpm = Some(Rpm { sensor: 3, flags: 1, rpm: 61.75 });
        let circuit =
            json!({"circuit_id": 120, "voltage_v": 12.5, "current_a": null, "error_flags": 1});
        let battery = |energy: Value, charge: Value, flags: u16| {
            json!({
                "battery_id": 3, "charge_percent": charge, "remaining_wh": energy,
                "status_flags": flags
            })
        };
        let expected = [
            (
                "/outputs",
                json!([{"output": 2, "width_us": null}, {"output": 3, "width_us": 1500.5}]),
            ),
            ("/circuit", circuit),
            ("/battery", battery(json!(40.0), json!(80), 33)),
            ("/rpm", json!({"sensor_id": 3, "rpm": 61.75, "flags": 1})),
        ];
        has(&state, &expected);
        state.measured.battery = Some(battery_info(f32::NAN, PERCENT_UNKNOWN));
        has(&state, &[("/battery", battery(Value::Null, Value::Null, 1))]);
    }

    #[test]
    fn the_report_has_mistakes_lost_frames_restarts_and_pulses_and_the_exit_code_1() {
        let mut state = State::new(1_000_000);
        state.advance_to(2 * F_CPU_HZ);
        state.add_mistake(F_CPU_HZ / 2, String::from("CNF1 <- 41h ignored"));
        state.add_mistake(F_CPU_HZ, String::from("CNF1 <- 42h ignored"));
        state.add_lost_frame(F_CPU_HZ, Frame::standard(0x123, &[1]), "");
        state.add_reset(F_CPU_HZ, String::from("Watchdog"));
        state.add_pulse(2 * F_CPU_HZ - 320_000, 16_000, None);
        state.add_pulse(2 * F_CPU_HZ, 24_000, Some(320_000));
        let expected = [
            ("/outcome", json!("mistakes")),
            ("/exit_code", json!(1)),
            ("/mistakes/0/count", json!(2)),
            ("/mistakes/0/first_s", json!(0.5)),
            ("/node/lost/0", json!({"frame": "123#01", "at_s": 1.0})),
            ("/restarts_total", json!(1)),
            ("/restarts/0/cause", json!("Watchdog")),
            ("/servo/width_us", json!(1500.0)),
            ("/servo/shortest_us", json!(1000.0)),
            ("/servo/longest_us", json!(1500.0)),
        ];
        has(&state, &expected);
        state.set_crash(0, String::from("gone"));
        has(&state, &[("/outcome", json!("crashed"))]);
    }

    /// Each finding alone, and all together: the worst one is the outcome. What is not modelled is
    /// a limit of the simulator, not of the program.
    #[test]
    fn a_strict_run_fails_for_each_finding_and_says_which() {
        let judged = |state: &State, is_strict| {
            let judgement = Judgement { is_strict, ..Judgement::default() };
            let report = serde_json::to_value(Report::new(state, &judgement)).unwrap();
            assert_eq!(report["exit_code"] == 1, judgement.exit(state).1.is_some(), "{report}");
            (report["outcome"].as_str().unwrap().to_owned(), report["findings"].clone())
        };
        let sent = || {
            let mut state = State::new(1_000_000);
            (state.knows_vendor_code, state.frames_of_node) = (true, 1);
            state
        };
        type Change = fn(&mut State);
        let changes: [(Change, &str, [&str; 2]); 7] = [
            (|state| state.add_unmodelled(0, "the TWI"), "unmodelled", ["well"; 2]),
            (|state| state.add_hint(0, String::from("a hint")), "hints", ["well", "hints"]),
            (|state| state.frames_of_node = 0, "never_sent", ["well", "never_sent"]),
            (|state| state.controller.overflows = 1, "lost_frames", ["well", "lost_frames"]),
            (|state| state.add_jump(0, ""), "restarted", ["well", "restarted"]),
            (|state| state.add_mistake(0, String::from("x")), "mistakes", ["mistakes"; 2]),
            (|state| state.set_crash(0, String::from("gone")), "crashed", ["crashed"; 2]),
        ];
        let mut all = sent();
        assert_eq!(judged(&all, true), (String::from("well"), json!([])));
        for (number, (change, finding, outcomes)) in changes.into_iter().enumerate() {
            let mut state = sent();
            change(&mut state);
            let found = [false, true].map(|is_strict| judged(&state, is_strict));
            assert_eq!(found, outcomes.map(|outcome| (outcome.to_owned(), json!([finding]))));
            change(&mut all);
            let (outcome, findings) = judged(&all, true);
            assert_eq!((&outcome[..], findings[0].as_str()), (outcomes[1], Some(finding)));
            assert_eq!(findings.as_array().unwrap().len(), number + 1);
        }
    }

    #[test]
    fn what_is_allowed_is_no_failure_and_is_still_told() {
        let mut state = State::new(1_000_000);
        state.spi.bytes_elsewhere = 1;
        state.add_jump(0, "");
        state.add_hint(0, String::from("a hint"));
        let judged = |allowed: &[Finding]| {
            let strict =
                Judgement { is_strict: true, allowed: allowed.to_vec(), unmodelled_exit: None };
            let report = serde_json::to_value(Report::new(&state, &strict)).unwrap();
            (report["outcome"].clone(), report["findings"].as_array().unwrap().len())
        };
        assert_eq!(judged(&[]), ("restarted".into(), 3));
        assert_eq!(judged(&[Finding::Restarted]), ("never_sent".into(), 3));
        assert_eq!(judged(&[Finding::Restarted, Finding::NeverSent]), ("hints".into(), 3));
        let all = [Finding::Restarted, Finding::NeverSent, Finding::Hints];
        assert_eq!(judged(&all), ("well".into(), 3));
    }

    #[test]
    fn what_is_not_modelled_has_an_exit_code_of_the_user_s_choice() {
        let mut state = State::new(1_000_000);
        state.frames_of_node = 1;
        state.add_unmodelled(0, "the TWI");
        state.add_unmodelled(5, "the TWI");
        let code = |is_strict, unmodelled_exit| {
            let judgement = Judgement { is_strict, unmodelled_exit, ..Judgement::default() };
            judgement.failure(&state).map(|(_, code)| code)
        };
        let lax = [code(false, None), code(false, Some(4))];
        assert_eq!(lax, [None, Some(4)]);
        let strict = [code(true, None), code(true, Some(0)), code(true, Some(4))];
        assert_eq!(strict, [None, None, Some(4)]);
        has(&state, &[("/unmodelled", json!(["the TWI"]))]);
        assert_eq!(state.take_events().len(), 1, "reported once");
    }
}
