//! The forms of recordings: what candump of can-utils and python-can write.
//!
//! ```text
//! (1436509052.249713) can0 123#0102        candump -l and -L; python-can, which adds R or T
//! (000.249713)  can0  123   [2]  01 02     candump -ta and -tz, on the screen
//! (000.249713)  can0  RX - -  123   [2]  01 02     the same with -x
//! ```
//!
//! Bytes can have dots between them, as in cansend's notation. A frame of the screen can have its
//! text (`-a`) behind it. Other forms are refused with the option to use: differences of times
//! (`-td`), dates (`-tA`), no times, binary digits (`-i`), swapped bytes (`-S`), colours (`-c`).

use crate::Cycles;
use crate::can::Frame;

/// Flag in the identifier of an error frame in candump's format.
const CAN_ERR_FLAG: u32 = 1 << 29;
const UTF8_MARK: &[u8] = b"\xEF\xBB\xBF";
const UTF16_LE_MARK: &[u8] = b"\xFF\xFE";
const UTF16_BE_MARK: &[u8] = b"\xFE\xFF";
/// What to record with.
const USE: &str = "record with \"candump -L can0\"";

/// The text of a file, which can begin with a byte order mark: some editors write one, and so does
/// the `>` of a Windows shell, in UTF-16.
///
/// # Errors
/// If the file is not text.
pub fn text(bytes: Vec<u8>) -> Result<String, String> {
    let utf16 = |from: fn([u8; 2]) -> u16| {
        let (units, rest) = bytes[UTF16_LE_MARK.len()..].as_chunks::<2>();
        let units: Vec<u16> = units.iter().map(|unit| from(*unit)).collect();
        String::from_utf16(&units).ok().filter(|_| rest.is_empty())
    };
    let text = if bytes.starts_with(UTF16_LE_MARK) {
        utf16(u16::from_le_bytes)
    } else if bytes.starts_with(UTF16_BE_MARK) {
        utf16(u16::from_be_bytes)
    } else {
        let begin = if bytes.starts_with(UTF8_MARK) { UTF8_MARK.len() } else { 0 };
        std::str::from_utf8(&bytes[begin..]).ok().map(str::to_owned)
    };
    text.ok_or_else(|| format!("is not text in UTF-8 or UTF-16; {USE}"))
}

/// Splits a line into its time and the rest.
///
/// # Errors
/// If the line has no time in seconds; the message says how to record with times.
pub fn split_time(line: &str) -> Result<(&str, &str), String> {
    if line.contains('\x1b') {
        return Err(format!("the line has colours, of candump -c; {USE}"));
    }
    let Some((time, rest)) = line.strip_prefix('(').and_then(|line| line.split_once(')')) else {
        return Err(format!(
            "expected a time in brackets, as in \"(2.5) temperature 60\"; for times, {USE}"
        ));
    };
    if time.contains(':') {
        return Err(format!("\"{time}\" is a date, of candump -tA; {USE}"));
    }
    Ok((time, rest.trim_start()))
}

/// Finds times that candump -td wrote: the differences to the frame before.
#[derive(Default)]
pub struct Differences {
    last: Cycles,
}

impl Differences {
    /// Checks the `time` of a frame, which is `at`.
    ///
    /// candump writes differences, and times since its start (-tz), with three digits and six. Only
    /// times since the start never decrease.
    ///
    /// # Errors
    /// If the time is a difference.
    pub fn check(&mut self, time: &str, at: Cycles) -> Result<(), String> {
        let is_short = time.len() == "000.000000".len() && time.starts_with('0');
        if is_short && at < self.last {
            return Err(format!("the times are differences, of candump -td; {USE}"));
        }
        if is_short {
            self.last = at;
        }
        Ok(())
    }
}

/// Reads a frame behind the name of its interface. `None` if `text` is no frame of a recording;
/// `Some(Ok(None))` for an error frame.
pub fn frame(text: &str) -> Option<Result<Option<Frame>, String>> {
    if text.contains('#') && !text.contains('[') {
        return Some(of_log(text));
    }
    let words: Vec<&str> = text.split_whitespace().collect();
    // With -x: direction, bit rate switch, error state.
    let words = match words[..] {
        ["RX" | "TX", "-" | "B", "-" | "E", ref frame @ ..] => frame,
        _ => &words[..],
    };
    match *words {
        [id, length, ref bytes @ ..] if length.starts_with(['[', '{']) => {
            Some(of_screen(id, length, bytes))
        }
        _ => None,
    }
}

fn fd(frame: &str) -> String {
    format!("{frame} is a CAN FD frame, and this bus has classic frames only")
}

/// Reads "123#0102", with a direction behind it or without.
fn of_log(text: &str) -> Result<Option<Frame>, String> {
    let (frame, direction) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    let direction = direction.trim();
    if !matches!(direction, "" | "R" | "T" | "RX" | "TX" | "Rx" | "Tx") {
        return Err(format!("expected nothing after the frame, not \"{direction}\""));
    }
    if frame.contains("##") {
        return Err(fd(frame));
    }
    let (id, body) = frame.split_once('#').unwrap_or((frame, ""));
    let is_even = |part: &str| part.len().is_multiple_of(2) && !part.is_empty();
    let body = match body.split_once('_') {
        // A frame with a DLC above eight.
        Some((bytes, dlc)) if bytes.split('.').all(is_even) => {
            format!("{}_{dlc}", bytes.replace('.', ""))
        }
        None if body.split('.').all(is_even) => body.replace('.', ""),
        _ => body.to_owned(),
    };
    parsed(id, &body, frame)
}

/// Reads "123   [2]  01 02".
fn of_screen(id: &str, length: &str, bytes: &[&str]) -> Result<Option<Frame>, String> {
    let frame = format!("{id} {length} {}", bytes.join(" "));
    let inner = length.get(1..length.len() - 1).unwrap_or_default();
    // With -8 the DLC is in braces, and can be above eight.
    let is_raw = length.starts_with('{');
    let closing = if is_raw { '}' } else { ']' };
    let dlc = u8::from_str_radix(inner, 16).ok().filter(|_| length.ends_with(closing));
    let Some(dlc) = dlc else { return Err(format!("\"{frame}\": the length is not [0] to [8]")) };
    if inner.len() > 1 {
        return Err(fd(&frame));
    }
    if bytes.starts_with(&["remote", "request"]) {
        let dlc = if dlc == 0 { String::new() } else { format!("{dlc:X}") };
        return parsed(id, &format!("R{dlc}"), &frame);
    }
    if bytes.iter().any(|byte| byte.contains('`')) {
        return Err(format!("the bytes are swapped, as with candump -S; {USE}"));
    }
    if bytes.first().is_some_and(|byte| byte.len() == 8) {
        return Err(format!("the bytes are binary, as with candump -i; {USE}"));
    }
    let count = usize::from(dlc.min(8));
    let (data, behind) = bytes.split_at_checked(count).unwrap_or((bytes, &[]));
    let is_text = |word: &&str| word.starts_with('\'') || *word == "ERRORFRAME";
    if !behind.first().is_none_or(is_text) || data.iter().any(|byte| byte.len() != 2) {
        return Err(format!("\"{frame}\" does not have {count} bytes"));
    }
    let raw = if dlc > 8 { format!("_{dlc:X}") } else { String::new() };
    if data.len() != count || (dlc > 8 && !is_raw) {
        return Err(format!("\"{frame}\" does not have {count} bytes"));
    }
    parsed(id, &(data.concat() + &raw), &frame)
}

/// The frame with this identifier and body; `None` for an error frame. `text` is for the error.
fn parsed(id: &str, body: &str, text: &str) -> Result<Option<Frame>, String> {
    let number = Some(id).filter(|id| id.len() == 8).map(|id| u32::from_str_radix(id, 16));
    if number.is_some_and(|id| id.is_ok_and(|id| id & CAN_ERR_FLAG != 0)) {
        return Ok(None);
    }
    let frame: Result<Frame, _> = format!("{id}#{body}").parse();
    frame.map(Some).map_err(|error| format!("\"{text}\": {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::script::{Action, parse};

    /// The frames of a recording, in candump's notation.
    fn frames(text: &str) -> Result<Vec<String>, String> {
        let lines = parse(text).map_err(|(line, error)| format!("{line}: {error}"))?;
        let frame = |(_, action)| match action {
            Action::Send(frame) => Some(frame.to_string()),
            _ => None,
        };
        Ok(lines.into_iter().filter_map(frame).collect())
    }

    #[test]
    fn what_candump_and_python_can_write_is_read() {
        for (line, expected) in [
            ("(1436509052.249713) can0 1404562A#0100A95C00C0", "1404562A#0100A95C00C0"),
            ("(1436509052.249713) vcan0 123#0102 R", "123#0102"),
            ("(1436509052.249713) can0 123#0102 T", "123#0102"),
            ("(0.249713) can0 123#0102 Rx", "123#0102"),
            ("(0.249713) can0 123#0102 TX", "123#0102"),
            ("(0.249713) can0 123#01.02.03", "123#010203"),
            ("(0.2) can0 7FF#11.22.33.44.55.66.77.88_C", "7FF#1122334455667788_C"),
            ("(0000012345.678901) can0 123#R4", "123#R4"),
            (
                " (1436509052.249713)  can0  1404562A   [6]  01 00 A9 5C 00 C0",
                "1404562A#0100A95C00C0",
            ),
            (" (000.000000)  can0  123   [0] ", "123#"),
            (" (000.000000)  can0  123   [4]  remote request", "123#R4"),
            (" (000.000000)  can0  123   [0]  remote request", "123#R"),
            (" (000.249713)  can0  RX - -  123   [2]  01 02", "123#0102"),
            (" (000.249713)  can0  TX - -  00000123   [2]  01 02", "00000123#0102"),
            (" (000.249713)  can0  123   [3]  41 5B 23   'A[#'", "123#415B23"),
            (" (000.249713)  can0  123   {C}  11 22 33 44 55 66 77 88", "123#1122334455667788_C"),
        ] {
            assert_eq!(frames(line), Ok(vec![expected.to_owned()]), "{line}");
        }
        for skipped in [
            "(1436509052.249713) can0 20000008#0000040000000000",
            " (000.1)  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME",
        ] {
            assert_eq!(frames(skipped), Ok(Vec::new()), "{skipped}");
        }
    }

    #[test]
    fn what_cannot_be_played_is_refused_with_what_to_use() {
        let dated = "(2015-07-10 08:17:33.850870)  can0  123   [0]";
        let differences = "(000.000000) can0 123#\n(000.020010) can0 123#\n(000.019990) can0 123#";
        for (text, expected) in [
            ("  can0  123   [2]  01 02", "1: expected a time in brackets"),
            ("can0 123#01", "candump -L can0"),
            (dated, "is a date, of candump -tA; record with \"candump -L can0\""),
            (differences, "3: the times are differences, of candump -td; record with"),
            ("(0.1)  can0  123  [03]  01 02 03", "CAN FD"),
            ("(0.1)  can0  123  [12]  01 02 03 04 05 06 07 08 09 0A 0B 0C", "CAN FD"),
            ("(0.1) can0 123##1010203", "CAN FD"),
            ("(0.1)  can0  123   [2]  02`01", "candump -S; record with"),
            ("(0.1)  can0  123   [2]  00000001 00000010", "candump -i; record with"),
            ("(0.1)  can0  \x1b[31m123   [2]  01 02\x1b[0m", "candump -c; record with"),
            ("(0.1)  can0  123   [3]  01 02", "does not have 3 bytes"),
            ("(0.1)  can0  123   [1]  01 02", "does not have 1 bytes"),
            ("(0.1)  can0  123   [x]  01 02", "is not [0] to [8]"),
            ("(0.1)  can0  123   [", "is not [0] to [8]"),
            ("(0.1)  can0  1234  [1]  01", "not a CAN frame"),
            ("(0.1) can0 123#01.0", "not a CAN frame"),
            ("(0.1) can0 123#01..02", "not a CAN frame"),
        ] {
            let error = frames(text).unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }

    #[test]
    fn times_since_the_start_and_logs_in_any_order_are_no_differences() {
        let since_start = "(000.000000) can0 1# \n(000.020010) can0 2#\n(000.040000) can0 3#";
        assert_eq!(frames(&since_start.replace(" can0 ", " can0 00")).unwrap().len(), 3);
        let logs = "(100.5) can0 123#\n(101.500000) can0 123#\n(2.500000) can0 124#";
        assert_eq!(frames(logs).unwrap(), ["124#", "123#", "123#"]);
    }

    #[test]
    fn files_with_a_byte_order_mark_are_read() {
        let line = "(0.1) can0 123#01\r\n";
        let wide = |bytes: fn(u16) -> [u8; 2]| -> Vec<u8> {
            ['\u{feff}'].into_iter().chain(line.chars()).flat_map(|c| bytes(c as u16)).collect()
        };
        for bytes in [
            format!("\u{feff}{line}").into_bytes(),
            line.as_bytes().to_vec(),
            wide(u16::to_le_bytes),
            wide(u16::to_be_bytes),
        ] {
            assert_eq!(frames(&text(bytes).unwrap()), Ok(vec![String::from("123#01")]));
        }
        for bytes in [&b"\xFF\xFEx"[..], b"(0.1) \xFF", b"\xFF\xFE\x00\xD8"] {
            assert!(text(bytes.to_vec()).unwrap_err().contains("candump -L"), "{bytes:x?}");
        }
    }
}
