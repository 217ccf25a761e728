//! Reads a program that is uploaded to a real board: an ELF, an Intel HEX file, or a .bin of this
//! project (docs/update.md). Refuses one that is not for the board.

#![forbid(unsafe_code)]

use anyhow::{Context, Result, bail, ensure};
use bench::avr::{Chip, Firmware};
use bench::boards::{self, Choice, OWN_WIRING};
use dronecan_wire::crc;

use crate::stk500::capacity;

/// The header of our programs: hardware version, version, length, and two bytes for the CRC.
const HARDWARE_MAJOR: usize = 0x68;
const HARDWARE_MINOR: usize = 0x69;
const LENGTH: usize = 0x6C;
const HEADER_END: usize = 0x70;

/// The CRC of a whole program from here is 0.
const CRC_START: u16 = 0xFFFF;

const ERASED: u8 = 0xFF;

/// The bytes of the program from address 0.
///
/// # Errors
/// If the file is no program, or not one for this board with this CAN board; the text says why.
pub fn read(file: &[u8], board: &str, shield: &str) -> Result<Vec<u8>> {
    let choice = chosen(board, shield)?;
    let chip: Chip = choice.chip().parse().map_err(anyhow::Error::msg)?;
    let title = boards::text(choice.board(), "title");
    let program = if file.starts_with(b":") {
        flat(&Firmware::parse_hex(&String::from_utf8_lossy(file))?)?
    } else if file.starts_with(b"\x7FELF") {
        let firmware = Firmware::parse(file)?;
        let of = firmware.chip().context("it is for another chip than this board's")?;
        if let Some(of) = of.filter(|of| *of != chip) {
            bail!("the program is for an {of}, and the {title} has an {chip}");
        }
        flat(&firmware)?
    } else {
        ensure!(
            has_header(file),
            "it is no program: neither an ELF, nor an Intel HEX file, nor a complete .bin of this \
             project"
        );
        file.to_vec()
    };
    let room = capacity(chip);
    ensure!(
        program.len() <= room,
        "the program has {} bytes, and the {title} has room for {room} below its bootloader",
        program.len()
    );
    if has_header(&program) {
        check_hardware(&program, &choice, chip)?;
    }
    Ok(program)
}

fn chosen(board: &str, shield: &str) -> Result<Choice> {
    for (kind, name) in [("boards", board), ("shields", shield)] {
        ensure!(boards::find(kind, name).is_some(), "there is no {name} in the {kind}");
    }
    Ok(Choice::of(board, shield))
}

/// The flash from address 0.
fn flat(firmware: &Firmware) -> Result<Vec<u8>> {
    let first = firmware.flash.iter().map(|(address, _)| *address).min().unwrap_or_default();
    ensure!(
        first == 0,
        "it begins at {first:#06X}, as bootloaders do: those need a programmer (docs/update.md)"
    );
    let mut program = Vec::new();
    for (address, bytes) in &firmware.flash {
        let end = address + bytes.len();
        ensure!(end <= 1 << 20, "it is larger than any chip");
        if program.len() < end {
            program.resize(end, ERASED);
        }
        program[*address..end].copy_from_slice(bytes);
    }
    Ok(program)
}

/// True if the program is one of ours, and complete.
fn has_header(program: &[u8]) -> bool {
    program.len() > HEADER_END
        && usize::from(u16::from_le_bytes([program[LENGTH], program[LENGTH + 1]])) == program.len()
        && program.iter().fold(CRC_START, |crc, byte| crc::step(crc, *byte)) == 0
}

fn check_hardware(program: &[u8], choice: &Choice, chip: Chip) -> Result<()> {
    let (major, minor) = (program[HARDWARE_MAJOR], program[HARDWARE_MINOR]);
    let wanted = boards::number(boards::entry("chips", choice.chip()), "hardware_major");
    ensure!(
        u32::from(major) == wanted,
        "the program is for another chip than the {chip} of the {}",
        boards::text(choice.board(), "title")
    );
    ensure!(
        [choice.hardware_minor(), OWN_WIRING].contains(&minor),
        "the program is for the wiring of another CAN board: {}",
        boards::names("shields")
            .filter(|name| Choice::of(&choice.board, name).hardware_minor() == minor)
            .map(|name| boards::text(boards::entry("shields", name), "title"))
            .collect::<Vec<_>>()
            .join(", or ")
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A complete program of `length` bytes for a hardware version.
    fn program(major: u8, minor: u8, length: usize) -> Vec<u8> {
        let mut bytes = vec![0x55; length];
        bytes[HARDWARE_MAJOR] = major;
        bytes[HARDWARE_MINOR] = minor;
        bytes[LENGTH..LENGTH + 2].copy_from_slice(&(length as u16).to_le_bytes());
        let check = LENGTH + 2;
        (0..=u16::MAX)
            .find(|value| {
                bytes[check..check + 2].copy_from_slice(&value.to_le_bytes());
                bytes.iter().fold(CRC_START, |crc, byte| crc::step(crc, *byte)) == 0
            })
            .expect("a value with which the CRC is 0");
        bytes
    }

    #[track_caller]
    fn assert_refused(file: &[u8], board: &str, shield: &str, words: &str) {
        let error = read(file, board, shield).expect_err("the file is wrong");
        assert!(format!("{error:#}").contains(words), "{error:#}");
    }

    #[test]
    fn a_program_for_the_board_is_accepted() {
        let file = program(2, 0, 200);
        assert_eq!(read(&file, "uno", "seeed").expect("a program for it"), file);
        // A wiring of the user's own.
        let file = program(2, OWN_WIRING, 200);
        assert_eq!(read(&file, "uno", "module").expect("a program for it"), file);
    }

    #[test]
    fn what_is_no_program_is_refused() {
        let mut cut = program(2, 0, 300);
        cut.pop();
        for file in [&b"hello"[..], &[], &[0; 500], &cut] {
            assert_refused(file, "uno", "seeed", "it is no program");
        }
        assert_refused(b":00000001FF\n", "uno", "seeed", "nothing to load");
        assert_refused(b":0200000000FF\n", "uno", "seeed", "line 1");
        assert_refused(b"\x7FELF", "uno", "seeed", "ELF");
        let bootloader = b":027E000000007F\n:00000001FF\n";
        let mut sum = *bootloader;
        // The checksum of the first record: its bytes and it add up to 0.
        sum[13..15].copy_from_slice(b"80");
        assert_refused(&sum, "uno", "seeed", "as bootloaders do");
    }

    #[test]
    fn a_program_that_is_too_long_is_refused() {
        // A byte at address 0, and one at 0x3800.
        let file = b":0100000000FF\n:0138000000C7\n:00000001FF\n";
        assert_refused(file, "diecimila", "seeed", "has 14337 bytes, and");
    }
}
