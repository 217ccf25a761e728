//! Plays frames and bench events from a file.
//!
//! ```text
//! # Time in seconds, then a frame as candump and --log write it, or an event.
//! (0.500000) can0 1404562A#0100A95C00C0
//! (2.5) temperature 60
//! (2.6) pwr-voltage 1260
//! (2.7) pwr-current 330
//! (3.0) button press
//! (3.1) button release
//! (4.0) fault no-ack
//! (5.0) serial help\r
//! ```
//!
//! Times are simulated seconds since power-on, so the log of a run plays at the times of that run.
//! The timestamps of a real bus count from 1970: if the first timestamp is that large, all times
//! are relative to it. Lines can be in any order.
//!
//! The script has its own station on the bus. It sends each frame at its time, or later if the bus
//! is busy. A log has the frames of all nodes: remove those of a node that takes part again (`grep
//! -v`), or two stations send the same identifier.
//!
//! `pwr-voltage` and `pwr-current` are millivolts at the inputs that measure a circuit, like the
//! options `--pwr-voltage` and `--pwr-current`. A board without such inputs ignores them.
//!
//! Faults are those of `--inject`: a lasting fault ends when it is named again. The text of
//! `serial` can contain `\r`, `\n`, `\t`, `\\` and `\xNN`; a line end is not added. Error frames in
//! a log (`20000008#...`) are skipped: no station sent them.

use super::Link;
use crate::fault::Fault;
use anyhow::{Context, Result, anyhow};
use bench::Bench;
use bench::can::{Frame, SoftNode};
use bench::{Cycles, F_CPU_HZ};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// Timestamps from here on, September 2001, are of the wall clock. No run is that long.
const WALL_CLOCK_FROM: Cycles = 1_000_000_000 * F_CPU_HZ;
/// Flag in the identifier of an error frame in candump's format.
const CAN_ERR_FLAG: u32 = 1 << 29;
/// Supply of the AVR, and the highest voltage at an input.
const SUPPLY_MV: u32 = 5000;
const NS_PER_S: u64 = 1_000_000_000;

/// An event of a script other than a frame.
#[derive(Clone, Debug, PartialEq)]
pub enum BenchEvent {
    /// Degrees Celsius at the sensor.
    Temperature(f64),
    /// Millivolts at the input for the circuit's voltage.
    CircuitVoltage(u32),
    /// Millivolts at the input for the circuit's current.
    CircuitCurrent(u32),
    /// The button is pressed (true) or released.
    Button(bool),
    /// A fault begins; a lasting fault that is on ends.
    Fault(Fault),
    /// Bytes to the Arduino's serial port.
    Serial(Vec<u8>),
}

/// The action of a line.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    Send(Frame),
    Do(BenchEvent),
    /// Nothing, for an error frame of a log.
    Skip,
}

/// A script, with the events that are not due yet and the station that sends its frames.
pub struct Script {
    path: PathBuf,
    station: Option<Rc<RefCell<SoftNode>>>,
    frames: usize,
    events: VecDeque<(Cycles, BenchEvent)>,
}

impl Script {
    /// Reads the file, and adds a station to the bus if there are frames to send.
    ///
    /// # Errors
    /// If the file cannot be read, or has an invalid line; the message names the line.
    pub fn open(path: &Path, bench: &mut Bench) -> Result<Script> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("--script: cannot read {}", path.display()))?;
        let lines = parse(&text)
            .map_err(|(line, error)| anyhow!("--script: {}:{line}: {error}", path.display()))?;
        let mut script =
            Script { path: path.to_owned(), station: None, frames: 0, events: VecDeque::new() };
        for (at, action) in lines {
            match action {
                Action::Send(frame) => {
                    script.frames += 1;
                    let station = script.station.get_or_insert_with(|| {
                        let station = Rc::new(RefCell::new(SoftNode::new(bench.bus().bit_rate())));
                        bench.attach("script", station.clone());
                        station
                    });
                    station.borrow_mut().send_at(at, frame);
                }
                Action::Do(event) => script.events.push_back((at, event)),
                Action::Skip => {}
            }
        }
        Ok(script)
    }

    /// Time of the next event, at which the bench must stop; `None` after the last.
    pub fn next_event_at(&self) -> Option<Cycles> {
        self.events.front().map(|(at, _)| *at)
    }

    /// Removes and returns the events that are due at `until` or before, in order.
    pub fn take_events(&mut self, until: Cycles) -> Vec<(Cycles, BenchEvent)> {
        let due = self.events.partition_point(|(at, _)| *at <= until);
        self.events.drain(..due).collect()
    }

    /// Number of frames that are not sent yet.
    pub fn frames_left(&self) -> usize {
        self.station.as_ref().map_or(0, |station| station.borrow().queued())
    }
}

impl Link for Script {
    fn serve(&mut self, _bench: &mut Bench) -> Result<()> {
        if let Some(station) = &self.station {
            // Without this the station's queue of received frames would grow without bound.
            station.borrow_mut().take_received();
        }
        Ok(())
    }

    fn status(&self) -> String {
        let sent = self.frames - self.frames_left();
        let events = self.events.len();
        format!(
            "script {}: {sent} of {} frames sent, {events} events to come",
            self.path.display(),
            self.frames
        )
    }
}

/// Reads all lines, and sorts them by time. Lines of the same time keep their order.
///
/// # Errors
/// For an invalid line: its number, and the reason.
pub fn parse(text: &str) -> Result<Vec<(Cycles, Action)>, (usize, String)> {
    let mut lines = Vec::new();
    for (line, number) in text.lines().zip(1..) {
        let line = line.trim();
        if !line.is_empty() && !line.starts_with('#') {
            lines.push(parse_line(line).map_err(|error| (number, error))?);
        }
    }
    lines.sort_by_key(|(at, _)| *at);
    let origin = lines.first().map_or(0, |(at, _)| *at);
    if origin >= WALL_CLOCK_FROM {
        lines.iter_mut().for_each(|(at, _)| *at -= origin);
    }
    Ok(lines)
}

fn parse_line(line: &str) -> Result<(Cycles, Action), String> {
    let (time, rest) = line
        .strip_prefix('(')
        .and_then(|line| line.split_once(')'))
        .ok_or("expected a time in brackets, as in \"(2.5) temperature 60\"")?;
    let at = parse_seconds(time)?;
    let rest = rest.trim_start();
    let (word, argument) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
    let argument = argument.trim_start();
    let action = match word {
        "temperature" => Action::Do(BenchEvent::Temperature(parse_temperature(argument)?)),
        "pwr-voltage" => Action::Do(BenchEvent::CircuitVoltage(parse_millivolts(argument)?)),
        "pwr-current" => Action::Do(BenchEvent::CircuitCurrent(parse_millivolts(argument)?)),
        "button" => Action::Do(BenchEvent::Button(match argument {
            "press" => true,
            "release" => false,
            _ => {
                return Err(format!(
                    "expected \"button press\" or \"button release\", not \"{rest}\""
                ));
            }
        })),
        "fault" => Action::Do(BenchEvent::Fault(argument.parse()?)),
        "serial" => Action::Do(BenchEvent::Serial(parse_text(argument)?)),
        _ if argument.contains('#') => parse_frame(argument)?,
        _ => {
            return Err(format!(
                "expected \"can0 1404562A#0100\", \"temperature 60\", \"pwr-voltage 1260\", \"pwr-current 330\", \"button press\", \
                 \"button release\", \"fault NAME\" or \"serial TEXT\", not \"{rest}\""
            ));
        }
    };
    Ok((at, action))
}

/// Reads decimal seconds, rounded to a cycle.
fn parse_seconds(text: &str) -> Result<Cycles, String> {
    let wrong = || format!("\"{text}\" is not a time in seconds: write for example 2.5");
    let (whole, fraction) = text.trim().split_once('.').unwrap_or((text.trim(), "0"));
    let digits = |part: &str| !part.is_empty() && part.bytes().all(|digit| digit.is_ascii_digit());
    if !digits(whole) || !digits(fraction) {
        return Err(wrong());
    }
    let seconds: u32 = whole.parse().map_err(|_| wrong())?;
    let ns: u64 = format!("{fraction:0<9.9}").parse().map_err(|_| wrong())?;
    let cycles = (ns * F_CPU_HZ + NS_PER_S / 2) / NS_PER_S;
    Ok(u64::from(seconds) * F_CPU_HZ + cycles)
}

fn parse_temperature(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|celsius: &f64| celsius.is_finite()).ok_or_else(|| {
        format!("expected degrees Celsius, as in \"temperature 60\", not \"{text}\"")
    })
}

/// Reads a voltage at an analogue input, from ground to the supply of the AVR.
///
/// # Errors
/// If `text` is not a number in this range; the message says the range.
pub fn millivolts(text: &str) -> Result<u32, String> {
    text.parse()
        .ok()
        .filter(|mv| *mv <= SUPPLY_MV)
        .ok_or_else(|| format!("use millivolts from 0 to {SUPPLY_MV}"))
}

fn parse_millivolts(text: &str) -> Result<u32, String> {
    millivolts(text).map_err(|advice| format!("{advice}, not \"{text}\""))
}

fn parse_frame(text: &str) -> Result<Action, String> {
    // python-can adds R or T for the direction.
    let (frame, direction) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    if !matches!(direction.trim(), "" | "R" | "T") {
        return Err(format!("expected nothing after the frame, not \"{}\"", direction.trim()));
    }
    if frame.contains("##") {
        return Err(format!("{frame} is a CAN FD frame, and this bus has classic frames only"));
    }
    let id = frame.split('#').next().filter(|id| id.len() == 8);
    if id.and_then(|id| u32::from_str_radix(id, 16).ok()).is_some_and(|id| id & CAN_ERR_FLAG != 0) {
        return Ok(Action::Skip);
    }
    frame.parse().map(Action::Send).map_err(|error| format!("\"{frame}\": {error}"))
}

fn parse_text(text: &str) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let mut rest = text.as_bytes();
    while let Some((&byte, behind)) = rest.split_first() {
        let escaped = if byte == b'\\' { behind.first() } else { None };
        let (byte, length) = match (byte, escaped) {
            (b'\\', Some(b'r')) => (b'\r', 2),
            (b'\\', Some(b'n')) => (b'\n', 2),
            (b'\\', Some(b't')) => (b'\t', 2),
            (b'\\', Some(b'\\')) => (b'\\', 2),
            (b'\\', Some(b'x'))
                if rest.len() >= 4 && rest[2..4].iter().all(u8::is_ascii_hexdigit) =>
            {
                let digit = |at: usize| (rest[at] as char).to_digit(16).unwrap_or_default() as u8;
                (digit(2) << 4 | digit(3), 4)
            }
            (b'\\', _) => {
                return Err(String::from(
                    "after a \\ expected r, n, t, \\ or two digits as in \\x1B",
                ));
            }
            (byte, _) => (byte, 1),
        };
        bytes.push(byte);
        rest = &rest[length..];
    }
    if bytes.is_empty() {
        return Err(String::from("expected the text to send, as in \"serial help\\r\""));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::links::log::Log;
    use crate::links::scratch::Scratch;
    use bench::can::RecordKind;

    const S: Cycles = F_CPU_HZ;

    fn error(text: &str) -> (usize, String) {
        parse(text).unwrap_err()
    }

    #[test]
    fn a_script_has_frames_events_and_comments_in_any_order() {
        let text = "# warm up\n\n(2.5) temperature -3.5\n (1.000001) can0 123#0102\n(3) button press\n\
                    (3) button release\n(4.0) fault no-ack\n(4.5) pwr-voltage 1260\n(4.5) pwr-current 0\n(5.000000) serial a b\\r\\x1b\\\\\n(6) vcan1 00000001#R R\n";
        let actions = parse(text).unwrap();
        let expected = [
            (S + 16, Action::Send(Frame::standard(0x123, &[1, 2]))),
            (S * 5 / 2, Action::Do(BenchEvent::Temperature(-3.5))),
            (3 * S, Action::Do(BenchEvent::Button(true))),
            (3 * S, Action::Do(BenchEvent::Button(false))),
            (4 * S, Action::Do(BenchEvent::Fault(Fault::NoAck))),
            (S * 9 / 2, Action::Do(BenchEvent::CircuitVoltage(1260))),
            (S * 9 / 2, Action::Do(BenchEvent::CircuitCurrent(0))),
            (5 * S, Action::Do(BenchEvent::Serial(b"a b\r\x1B\\".to_vec()))),
            (6 * S, Action::Send(Frame::remote(bench::can::Id::Extended(1), 0))),
        ];
        assert_eq!(actions, expected);
    }

    #[test]
    fn timestamps_of_the_wall_clock_count_from_the_first_line() {
        let text = "(1795219694.512352) can0 123#\n(1795219695.512354) can0 124#\n(1795219695.6) can0 20000008#00\n";
        let times: Vec<_> = parse(text).unwrap().into_iter().map(|(at, _)| at).collect();
        assert_eq!(times[..2], [0, S + 32]);
    }

    #[test]
    fn times_are_exact_to_the_cycle() {
        assert_eq!(parse_seconds("0.0000000625"), Ok(1));
        assert_eq!(parse_seconds("7.000001"), Ok(7 * S + 16));
        assert_eq!(parse_seconds("4294967295.999999999"), Ok(4_294_967_296 * S));
        for text in ["", ".", "-1", "1.", "1e3", "0x1", "4294967296.0", "١"] {
            assert!(parse_seconds(text).is_err(), "{text}");
        }
    }

    #[test]
    fn error_frames_of_a_log_are_not_sent() {
        assert_eq!(parse("(0) can0 20000008#0000040000000000").unwrap(), [(0, Action::Skip)]);
    }

    #[test]
    fn the_error_of_an_invalid_line_has_its_number_and_the_valid_form() {
        for (text, line, expected) in [
            ("(1) can0 123#01\ncan0 123#01", 2, "time in brackets"),
            ("# x\n\n(x) can0 123#01", 3, "2.5"),
            ("(1) can0 123#0", 1, "not a CAN frame"),
            ("(1) can0 123##100", 1, "classic"),
            ("(1) can0 123#00 now", 1, "after the frame"),
            ("(1) can0", 1, "1404562A#0100"),
            ("(1)", 1, "serial TEXT"),
            ("(1) temperature hot", 1, "degrees"),
            ("(1) temperature nan", 1, "degrees"),
            ("(1) pwr-voltage 12.6", 1, "0 to 5000, not \"12.6\""),
            ("(1) pwr-current", 1, "0 to 5000"),
            ("(1) button push", 1, "button release"),
            ("(1) fault gremlins", 1, "stuck-dominant"),
            ("(1) serial", 1, "serial help"),
            ("(1) serial \\q", 1, "\\x1B"),
            ("(1) serial \\x1", 1, "\\x1B"),
            ("(1) serial \\", 1, "\\x1B"),
        ] {
            let (at, message) = error(text);
            assert_eq!(at, line, "{text}");
            assert!(message.contains(expected), "{text}: {message}");
        }
    }

    #[test]
    fn the_error_of_a_missing_or_invalid_script_names_the_file() {
        let directory = Scratch::new();
        let mut bench = Bench::new(1_000_000);
        let mut message =
            |path: &Path| format!("{:#}", Script::open(path, &mut bench).err().unwrap());
        let path = directory.path("x.script");
        assert!(message(&path).starts_with(&format!("--script: cannot read {}: ", path.display())));
        std::fs::write(&path, "(1) button press\n(2) jump\n").unwrap();
        assert!(message(&path).starts_with(&format!("--script: {}:2: expected ", path.display())));
    }

    #[test]
    fn events_are_taken_when_they_are_due() {
        let directory = Scratch::new();
        let path = directory.path("x.script");
        std::fs::write(&path, "(0.001) button press\n(0.002) fault cable\n").unwrap();
        let mut script = Script::open(&path, &mut Bench::new(1_000_000)).unwrap();
        assert_eq!(script.next_event_at(), Some(S / 1000));
        assert_eq!(script.take_events(S / 1000 - 1), []);
        assert_eq!(script.take_events(S / 1000), [(S / 1000, BenchEvent::Button(true))]);
        assert_eq!(script.take_events(S), [(S / 500, BenchEvent::Fault(Fault::Cable))]);
        assert_eq!(script.next_event_at(), None);
    }

    /// Runs a bus with a listener, logs it, and returns the frames on the bus.
    fn run(bench: &mut Bench, script: Option<&mut Script>, log: &Path) -> Vec<(Cycles, Frame)> {
        let listener = Rc::new(RefCell::new(SoftNode::new(bench.bus().bit_rate())));
        bench.attach("listener", listener);
        let mut log = Log::create(log, bench.bus().bit_rate()).unwrap();
        let mut passed = Vec::new();
        let mut script = script;
        for _ in 0..100 {
            bench.run_for_ms(1);
            if let Some(script) = &mut script {
                script.serve(bench).unwrap();
            }
            for record in bench.bus().take_records() {
                log.record(&record, None).unwrap();
                if let RecordKind::Frame { frame, .. } = record.kind {
                    passed.push((record.start, frame));
                }
            }
            log.serve(bench).unwrap();
        }
        passed
    }

    /// Two stations arbitrate, with bursts back to back and every kind of frame.
    #[test]
    fn the_log_of_a_run_plays_the_same_frames_at_the_same_times() {
        for bit_rate in [1_000_000, 125_000] {
            let directory = Scratch::new();
            let mut bench = Bench::new(bit_rate);
            for station in 0..2 {
                let node = Rc::new(RefCell::new(SoftNode::new(bit_rate)));
                bench.attach("talker", node.clone());
                for number in 0..40_u32 {
                    let id = 0x1000_0000 + 7919 * (number % 13) + station;
                    let data = number.to_le_bytes();
                    let frame = match number % 4 {
                        0 => Frame::standard((id & 0x7FF) as u16, &data[..3]),
                        1 => Frame::remote(bench::can::Id::Extended(id), 4),
                        2 => Frame::extended(id, &[number as u8; 8]),
                        _ => Frame::extended(id, &data),
                    };
                    node.borrow_mut().send_at(u64::from(number / 8 * 10_007), frame);
                }
            }
            let first = run(&mut bench, None, &directory.path("first.log"));
            assert_eq!(first.len(), 80);
            let mut bench = Bench::new(bit_rate);
            let mut script = Script::open(&directory.path("first.log"), &mut bench).unwrap();
            let second = run(&mut bench, Some(&mut script), &directory.path("second.log"));
            assert_eq!(second, first);
            assert_eq!(script.frames_left(), 0);
            let text = |name: &str| std::fs::read_to_string(directory.path(name)).unwrap();
            assert_eq!(text("first.log"), text("second.log"));
        }
    }
}
