//! The scripts derive from the table what `avr-specs/boards.rs` derives.

use bench::boards::{self, Choice, fastest_bit_rate, names};
use std::process::Command;

/// Prints a line for each board, each CAN board and each wiring that the scripts accept, with what
/// `scripts/boards.py` says of it.
const SCRIPT: &str = r#"
import boards
for board in boards.TABLE["boards"]:
    for shield in boards.TABLE["shields"]:
        for cs in boards.pins_for_cs():
            for interrupt in boards.INTERRUPTS:
                for crystal in boards.CRYSTALS_MHZ:
                    choice = boards.Choice(board, shield, cs, interrupt, crystal)
                    print(board, shield, cs, interrupt, crystal, choice.chip, choice.servo,
                          *choice.power, *choice.outputs, choice.light,
                          choice.bit_rate)
"#;

#[test]
fn the_scripts_derive_the_same_pins() {
    let scripts = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scripts");
    let output = Command::new("python3")
        .args(["-c", SCRIPT])
        .env("PYTHONPATH", scripts)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .expect("python3 runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let printed = String::from_utf8(output.stdout).expect("text");
    for line in printed.lines() {
        let words: Vec<&str> = line.split(' ').collect();
        let [board, shield, cs, int, crystal_mhz, ..] = words[..] else { panic!("{line}") };
        let choice = Choice {
            board: board.into(),
            shield: shield.into(),
            cs: cs.into(),
            int: int.into(),
            crystal_mhz: crystal_mhz.parse().expect("a number"),
        };
        let bit_rate = fastest_bit_rate(choice.crystal_mhz).to_string();
        let derived = [
            &[choice.chip(), choice.servo()],
            &choice.power()[..],
            &[choice.servo()],
            &choice.outputs(),
            &[choice.light(None).unwrap_or("None"), &bit_rate],
        ];
        assert_eq!(words[5..], derived.concat(), "{line}");
    }
    let count = printed.lines().count();
    // CS on 11 pins, INT on 2, crystals of 2 frequencies.
    assert_eq!(count, names("boards").count() * names("shields").count() * 11 * 2 * 2);
}

#[test]
fn the_environment_chooses_a_board_and_its_wiring() {
    assert_eq!(Choice::of_environment(|_| None), Choice::of("diecimila", "seeed"));
    let variable = |name: &str| match name {
        "NODE_BOARD" => Some(String::from("uno")),
        "NODE_SHIELD" => Some(String::from("module")),
        "NODE_CS" => Some(String::from("A4")),
        "NODE_INT" => Some(String::from("D3")),
        _ => Some(String::new()),
    };
    let choice = Choice::of_environment(variable);
    assert_eq!((choice.chip(), choice.crystal_mhz, choice.servo()), ("atmega328p", 8, "D10"));
    assert_eq!(choice.power(), ["A5", "A3"]);
    assert_eq!(choice.outputs(), ["D5", "D6", "D7", "D8", "A1", "A2", "D9"]);
    assert_eq!((choice.rpm(), choice.light(choice.rpm())), (Some("D2"), None));
    assert_eq!(choice.hardware_minor(), boards::OWN_WIRING);
    let sparkfun = Choice::of("uno", "sparkfun");
    assert_eq!((sparkfun.light(None), sparkfun.hardware_minor()), (Some("D3"), 1));
    assert_eq!((sparkfun.rpm(), sparkfun.light(sparkfun.rpm())), (Some("D3"), None));
}
