//! The text of a script: frames and bench events with their times.
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
//! (6.0) i2c 0x48:0x00=0x19,0x80
//! ```
//!
//! Times are simulated seconds since power-on, so the log of a run plays at the times of that run.
//! The timestamps of a recording count from 1970 or from the start of a computer, with ten digits
//! before the point: these times are relative to the earliest of them. Lines can be in any order.
//!
//! `pwr-voltage` and `pwr-current` are millivolts at the inputs that measure a circuit, like the
//! options `--pwr-voltage` and `--pwr-current`. A board without such inputs ignores them.
//!
//! Faults are those of `--inject`: a lasting fault ends when it is named again. The text of
//! `serial` can contain `\r`, `\n`, `\t`, `\\` and `\xNN`; a line end is not added. Error frames in
//! a log (`20000008#...`) are skipped: no station sent them. [`candump`] has the forms of
//! recordings.

mod candump;

use crate::can::Frame;
use crate::fault::Fault;
use crate::i2c;
use crate::pins::Setting;
use crate::{Cycles, F_CPU_HZ};

pub use candump::text;

/// Supply of the AVR, and the highest voltage at an input.
const SUPPLY_MV: u32 = 5000;
const NS_PER_S: u64 = 1_000_000_000;
/// Times with this many digits before the point count from another origin than the start of the
/// run. candump writes those of the wall clock, and of a clock that starts with the computer, with
/// leading zeros. No run is that long.
const ABSOLUTE_DIGITS: usize = 10;

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
    /// A level or a voltage at a pin.
    Set(Setting),
    /// Registers of a device on the two-wire bus.
    I2c(i2c::Setting),
    /// Speed of the shaft in revolutions a minute.
    Shaft(u32),
}

/// The action of a line.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    Send(Frame),
    Do(BenchEvent),
    /// Nothing, for an error frame of a log.
    Skip,
}

/// Reads all lines, and sorts them by time. Lines of the same time keep their order.
///
/// # Errors
/// For an invalid line: its number, and the reason.
pub fn parse(text: &str) -> Result<Vec<(Cycles, Action)>, (usize, String)> {
    let mut lines = Vec::new();
    let mut differences = candump::Differences::default();
    for (line, number) in text.lines().zip(1..) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let (time, rest) = candump::split_time(line).map_err(|error| (number, error))?;
        let (at, is_absolute) = parse_seconds(time).map_err(|error| (number, error))?;
        let action = parse_action(rest).map_err(|error| (number, error))?;
        if !matches!(action, Action::Do(_)) {
            differences.check(time, at).map_err(|error| (number, error))?;
        }
        lines.push((at, is_absolute, action));
    }
    let absolute = lines.iter().filter(|(_, is_absolute, _)| *is_absolute);
    let origin = absolute.map(|(at, ..)| *at).min().unwrap_or(0);
    let from_start =
        |(at, is_absolute, action)| (if is_absolute { at - origin } else { at }, action);
    let mut lines: Vec<_> = lines.into_iter().map(from_start).collect();
    lines.sort_by_key(|(at, _)| *at);
    Ok(lines)
}

fn parse_action(rest: &str) -> Result<Action, String> {
    let (word, argument) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
    let argument = argument.trim_start();
    Ok(match word {
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
        "set" => {
            let (pin, level) = argument.split_once(char::is_whitespace).unwrap_or((argument, ""));
            Action::Do(BenchEvent::Set(Setting::parse(pin, level.trim())?))
        }
        "rpm" => Action::Do(BenchEvent::Shaft(rpm(argument)?)),
        "i2c" => Action::Do(BenchEvent::I2c(argument.parse()?)),
        "serial" => Action::Do(BenchEvent::Serial(parse_text(argument)?)),
        _ => match candump::frame(argument) {
            Some(frame) => frame?.map_or(Action::Skip, Action::Send),
            None => {
                return Err(format!(
                    "expected \"can0 1404562A#0100\", \"temperature 60\", \"pwr-voltage 1260\", \
                     \"pwr-current 330\", \"button press\", \"button release\", \"fault NAME\", \
                     \"set D7 low\", \"rpm 6000\", \"i2c 0x48:0=1\" or \"serial TEXT\", not \
                     \"{rest}\""
                ));
            }
        },
    })
}

/// Reads decimal seconds, rounded to a cycle. True if they count from another origin than the start
/// of the run.
fn parse_seconds(text: &str) -> Result<(Cycles, bool), String> {
    let text = text.trim();
    let wrong = || format!("\"{text}\" is not a time in seconds: write for example 2.5");
    let (whole, fraction) = text.split_once('.').unwrap_or((text, "0"));
    let digits = |part: &str| !part.is_empty() && part.bytes().all(|digit| digit.is_ascii_digit());
    if !digits(whole) || !digits(fraction) {
        return Err(wrong());
    }
    let seconds: u32 = whole.parse().map_err(|_| wrong())?;
    let ns: u64 = format!("{fraction:0<9.9}").parse().map_err(|_| wrong())?;
    let cycles = (ns * F_CPU_HZ + NS_PER_S / 2) / NS_PER_S;
    Ok((u64::from(seconds) * F_CPU_HZ + cycles, whole.len() >= ABSOLUTE_DIGITS))
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

/// The highest speed of the shaft, in revolutions a minute.
pub const RPM_MAX: u32 = 10_000_000;

/// Reads the speed of a shaft.
///
/// # Errors
/// If `text` is not a number in the range; the message says the range.
pub fn rpm(text: &str) -> Result<u32, String> {
    match text.parse() {
        Ok(rpm @ 0..=RPM_MAX) => Ok(rpm),
        _ => Err(format!("use revolutions a minute from 0 to {RPM_MAX}")),
    }
}

fn parse_millivolts(text: &str) -> Result<u32, String> {
    millivolts(text).map_err(|advice| format!("{advice}, not \"{text}\""))
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

    const S: Cycles = F_CPU_HZ;

    fn error(text: &str) -> (usize, String) {
        parse(text).unwrap_err()
    }

    #[test]
    fn a_script_has_frames_events_and_comments_in_any_order() {
        let text = "# warm up\n\n(2.5) temperature -3.5\n (1.000001) can0 123#0102\n(3) button \
                    press\n(3) button release\n(4.0) fault no-ack\n(4.5) pwr-voltage 1260\n(4.5) \
                    pwr-current 0\n(5.000000) serial a b\\r\\x1b\\\\\n(6) vcan1 00000001#R R\n(7) \
                    i2c 0x48:1=2\n";
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
            (6 * S, Action::Send(Frame::remote(crate::can::Id::Extended(1), 0))),
            (7 * S, Action::Do(BenchEvent::I2c("0x48:1=2".parse().unwrap()))),
        ];
        assert_eq!(actions, expected);
    }

    #[test]
    fn timestamps_of_the_wall_clock_count_from_the_first_line() {
        let text = "(1795219694.512352) can0 123#\n(1795219695.512354) can0 124#\n(1795219695.6) \
                    can0 20000008#00\n";
        let times: Vec<_> = parse(text).unwrap().into_iter().map(|(at, _)| at).collect();
        assert_eq!(times[..2], [0, S + 32]);
    }

    /// An event can be added to a recording, at a time of the run.
    #[test]
    fn timestamps_since_boot_count_from_the_first_and_times_of_the_run_do_not() {
        let text =
            "(0000012345.678901) can0 123#\n(0000012346.678901) can0 124#\n(0.5) temperature 60";
        let times: Vec<_> = parse(text).unwrap().into_iter().map(|(at, _)| at).collect();
        assert_eq!(times, [0, S / 2, S]);
    }

    #[test]
    fn times_are_exact_to_the_cycle() {
        assert_eq!(parse_seconds("0.0000000625"), Ok((1, false)));
        assert_eq!(parse_seconds("7.000001"), Ok((7 * S + 16, false)));
        assert_eq!(parse_seconds("4294967295.999999999"), Ok((4_294_967_296 * S, true)));
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
}
