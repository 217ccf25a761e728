//! Reads Intel HEX files, the usual form of bootloaders.
//!
//! A line is `:LLAAAATT`, data, checksum, in hexadecimal: length, address, type, and a byte that
//! makes the sum of all bytes 0. Types: 0 data, 1 end of file, 2 and 4 the upper part of the
//! addresses that follow, 3 and 5 a start address, which is ignored because an AVR does not use it.
//!
//! Source: Intel, "Hexadecimal Object File Format Specification", revision A (1988).

use super::elf::Firmware;
use anyhow::{Context, Result, bail, ensure};
use std::path::Path;

impl Firmware {
    /// Reads an Intel HEX file, which has no symbols.
    ///
    /// # Errors
    /// If the file is missing, or is not Intel HEX.
    pub fn read_hex(path: &Path) -> Result<Firmware> {
        let text = sim_base::read_text(path, sim_base::PROGRAM_BYTES)
            .with_context(|| format!("cannot read {}", path.display()))?;
        Firmware::parse_hex(&text)
            .with_context(|| format!("{} is not an Intel HEX file", path.display()))
    }

    /// Reads the text of an Intel HEX file.
    ///
    /// # Errors
    /// If the text is not Intel HEX; the message names the line.
    pub fn parse_hex(text: &str) -> Result<Firmware> {
        let mut flash: Vec<(usize, Vec<u8>)> = Vec::new();
        let mut base = 0;
        for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let record = record(line.trim()).with_context(|| format!("line {}", index + 1))?;
            match (record.kind, record.data.as_slice()) {
                (0, data) => {
                    let start = base + record.address;
                    match flash.last_mut() {
                        Some((first, bytes)) if *first + bytes.len() == start => bytes.extend(data),
                        _ => flash.push((start, data.to_vec())),
                    }
                }
                (1, _) => {
                    ensure!(!flash.is_empty(), "nothing to load into flash");
                    return Ok(Firmware { flash, ..Firmware::default() });
                }
                (2, [high, low]) => base = usize::from(u16::from_be_bytes([*high, *low])) << 4,
                (4, [high, low]) => base = usize::from(u16::from_be_bytes([*high, *low])) << 16,
                (3 | 5, _) => {}
                (kind, _) => bail!("line {}: unknown record type {kind}", index + 1),
            }
        }
        bail!("the end of the file is missing")
    }
}

struct Record {
    address: usize,
    kind: u8,
    data: Vec<u8>,
}

fn record(line: &str) -> Result<Record> {
    let digits = line.strip_prefix(':').context("it does not begin with a colon")?;
    ensure!(digits.is_ascii() && digits.len().is_multiple_of(2), "it is not a sequence of bytes");
    let bytes: Vec<u8> = (0..digits.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&digits[at..at + 2], 16))
        .collect::<Result<_, _>>()
        .context("it is not a sequence of bytes")?;
    let [length, high, low, kind, data @ .., _checksum] = bytes.as_slice() else {
        bail!("it is too short");
    };
    ensure!(
        data.len() == usize::from(*length),
        "it has {} bytes of data, but its length field is {length}",
        data.len()
    );
    let sum = bytes.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte));
    ensure!(sum == 0, "the checksum is wrong");
    Ok(Record {
        address: usize::from(u16::from_be_bytes([*high, *low])),
        kind: *kind,
        data: data.to_vec(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const END: &str = ":00000001FF\n";

    #[test]
    fn lines_with_consecutive_addresses_become_one_piece() {
        let text =
            format!(":023800000102C3\r\n:0238020003 04BD\n:0100000055AA\n{END}").replace(' ', "");
        let firmware = Firmware::parse_hex(&text).unwrap();
        assert_eq!(firmware.flash, [(0x3800, vec![1, 2, 3, 4]), (0, vec![0x55])]);
    }

    #[test]
    fn upper_addresses_count_and_start_addresses_are_ignored() {
        let text = format!(":020000020100FB\n:0100000055AA\n:0400000300003800C1\n{END}");
        let firmware = Firmware::parse_hex(&text).unwrap();
        assert_eq!(firmware.flash, [(0x1000, vec![0x55])]);
    }

    #[test]
    fn the_error_of_a_damaged_file_names_the_line() {
        for (text, expected) in [
            (":0100000055AB\n:00000001FF", "line 1"),
            (":0100000055AA\n0100000055AA\n:00000001FF", "line 2"),
            (":0200000055AA\n:00000001FF", "length field is 2"),
            (":0100000055AA", "end of the file"),
            (":00000001FF", "nothing to load"),
            (":zz", "sequence"),
            ("", "end of the file"),
        ] {
            let error = format!("{:#}", Firmware::parse_hex(text).unwrap_err());
            assert!(error.contains(expected), "{error}");
        }
    }
}
