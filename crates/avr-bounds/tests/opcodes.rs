//! The decoder against avr-objdump, for each of the 65,536 first words.

use std::fs;
use std::process::Command;

use avr_bounds::opcode::Op;
use avr_bounds::text::Text;

/// The word behind each first word: an address for the long instructions, and MOVW otherwise.
const SECOND: u16 = 0x0150;

/// Mnemonics that avr-objdump knows and this core does not have.
const OTHER_CORES: [&str; 8] = ["xch", "las", "lac", "lat", "des", "elpm", "eijmp", "eicall"];

/// Disassembles a program of all first words, and returns the text of each.
fn disassembled() -> Vec<String> {
    let path = std::env::temp_dir().join(format!("bounds-opcodes-{}.bin", std::process::id()));
    let words = (0..=u16::MAX).flat_map(|first| [first, SECOND]);
    fs::write(&path, words.flat_map(u16::to_le_bytes).collect::<Vec<u8>>()).unwrap();
    let output = Command::new("avr-objdump")
        .args(["-D", "-z", "-b", "binary", "-m", "avr:5"])
        .arg(&path)
        .output()
        .expect("avr-objdump of binutils-avr");
    fs::remove_file(&path).unwrap();
    assert!(output.status.success());
    let mut texts = vec![String::new(); 0x1_0000];
    for line in String::from_utf8(output.stdout).unwrap().lines() {
        let mut columns = line.split('\t');
        let Some(address) = columns.next().and_then(|column| column.trim().strip_suffix(':'))
        else {
            continue;
        };
        let Ok(address) = usize::from_str_radix(address, 16) else { continue };
        let Some(mnemonic) = columns.nth(1) else { continue };
        let operands = columns.next().filter(|text| !text.starts_with(';')).unwrap_or("");
        if address.is_multiple_of(4) {
            texts[address / 4] = format!("{mnemonic} {operands}").trim().into();
        }
    }
    texts
}

#[test]
fn every_first_word_has_the_text_of_objdump() {
    let texts = disassembled();
    let (mut decoded, mut refused) = (0, 0);
    for first in 0..=u16::MAX {
        let (at, text) = (u32::from(first) * 4, &texts[usize::from(first)]);
        let Some(op) = Op::decode(first, SECOND, at) else {
            let mnemonic = text.split(' ').next().unwrap();
            let is_spm_z = text == "spm Z+";
            assert!(
                mnemonic == ".word" || OTHER_CORES.contains(&mnemonic) || is_spm_z,
                "{first:#06x} is {text} and was refused"
            );
            refused += 1;
            continue;
        };
        assert_eq!(&Text(op, at).to_string(), text, "{first:#06x}");
        decoded += 1;
    }
    println!("{decoded} words decoded, {refused} refused");
    assert!(decoded > 60_000 && refused > 1000);
}

#[test]
fn the_length_is_two_words_exactly_where_objdump_consumes_the_second() {
    for first in 0..=u16::MAX {
        let one = Op::decode(first, SECOND, 0);
        let other = Op::decode(first, SECOND + 2, 0);
        let Some(op) = one else { continue };
        assert_eq!(op.bytes() == 4, one != other, "{first:#06x}");
    }
}
