//! The vendor-specific status code: its bits, and what they mean in words.
//!
//! docs/status.md defines the code of this project's firmware. The codes of other programs have
//! other meanings, so the views show words only for programs with the ELF section `.board`.

/// Bits 0 to 2 of the code: the fault that caused the last reset, one of the numbers below.
pub const RESET: u16 = 0b111;
pub const WATCHDOG: u16 = 1;
pub const BROWN_OUT: u16 = 2;
pub const PANIC: u16 = 3;
pub const STRAY_INTERRUPT: u16 = 4;
pub const STACK_COLLISION: u16 = 5;

/// The other bits.
pub const TRANSFER_ERRORS: u16 = 1 << 3;
pub const ID_CONFLICT: u16 = 1 << 4;
pub const FRAMES_LOST: u16 = 1 << 5;
pub const ERROR_PASSIVE: u16 = 1 << 6;
pub const BUS_OFF: u16 = 1 << 7;
/// The node restarted the controller, or dropped a frame that it could not send.
pub const CONTROLLER: u16 = 1 << 8;
pub const TWO_COMMANDERS: u16 = 1 << 9;
pub const FAILSAFE: u16 = 1 << 10;
/// The temperature is out of range, or the sensor is open or shorted.
pub const TEMPERATURE: u16 = 1 << 11;
/// The voltage or the current of the circuit is out of range.
pub const POWER: u16 = 1 << 12;
pub const PARAMETERS_LOST: u16 = 1 << 13;
pub const DISARMED: u16 = 1 << 14;
pub const DRAFT: u16 = 1 << 15;

/// A condition in words, and what to do.
type Words = (&'static str, &'static str);

/// What to do after a fault of the program.
const REPORT: &str = "report it: the program should not do that";

/// The fault for each number in the bits `RESET`. 0 is no fault; 6 and 7 have no meaning yet.
const RESETS: [Option<Words>; 8] = [
    None,
    Some(("restarted by the watchdog", REPORT)),
    Some(("restarted after a brown-out", "give the board 5 V that do not dip when servos move")),
    Some(("restarted after a panic", REPORT)),
    Some(("restarted after a stray interrupt", REPORT)),
    Some(("restarted after a stack overflow", REPORT)),
    Some(("restarted, cause 6", REPORT)),
    Some(("restarted, cause 7", REPORT)),
];

/// The condition of each other bit.
const CONDITIONS: [(u16, Words); 13] = [
    (
        TRANSFER_ERRORS,
        ("transfer errors", "look for noise, and for nodes that send half transfers"),
    ),
    (ID_CONFLICT, ("node ID conflict", "give one of the two nodes another CAN_NODE")),
    (FRAMES_LOST, ("frames lost", "let the others send less")),
    (ERROR_PASSIVE, ("error-passive", "check the cable, the terminators, and the other nodes")),
    (BUS_OFF, ("bus-off", "check CAN H and CAN L, and the bit rate of all nodes")),
    (
        CONTROLLER,
        (
            "controller restarted or sending given up",
            "check the wires and the supply of the MCP2515, the cable, and the bit rate",
        ),
    ),
    (TWO_COMMANDERS, ("two commanders", "let one node command the output")),
    (FAILSAFE, ("failsafe", "send commands: none came for OUTn_TIMEOUT")),
    (TEMPERATURE, ("temperature", "check the sensor, TEMP_MIN and TEMP_MAX")),
    (POWER, ("power", "check the circuit, and the limits PWR1_...")),
    (PARAMETERS_LOST, ("parameters lost", "set the parameters, and save them")),
    (DISARMED, ("disarmed or safe", "arm the vehicle, and put the safety switch off")),
    (DRAFT, ("speaks the draft", "nothing: this program does")),
];

/// The conditions in `code`, each in words and with what to do; none for code 0.
pub fn with_advice(code: u16) -> impl Iterator<Item = (&'static str, &'static str)> {
    let set = move |(bit, words): (u16, Words)| (code & bit != 0).then_some(words);
    let reset = RESETS[usize::from(code & RESET)];
    reset.into_iter().chain(CONDITIONS.into_iter().filter_map(set))
}

/// The conditions in `code`, a text each; none for code 0.
pub fn conditions(code: u16) -> Vec<&'static str> {
    with_advice(code).map(|(text, _)| text).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_bit_has_its_text() {
        for bit in 3..16 {
            let texts = conditions(1 << bit);
            assert_eq!(texts, [CONDITIONS[bit - 3].1.0], "bit {bit}");
        }
        for (cause, words) in RESETS.iter().enumerate() {
            assert_eq!(with_advice(cause as u16).next(), *words);
        }
        assert!(conditions(0).is_empty());
    }

    /// The row of each bit in docs/status.md has its code and the first word of its text.
    #[test]
    fn the_texts_agree_with_the_document() {
        let document = include_str!("../../../docs/status.md").to_lowercase();
        for (code, (text, _)) in CONDITIONS {
            let start = format!("| {} | `{code:#06x}` |", code.trailing_zeros());
            let row = document.lines().find(|line| line.starts_with(&start)).expect(text);
            assert!(row.contains(text.split(' ').next().expect("a word")), "{text}: {row}");
        }
    }

    #[test]
    fn several_conditions_are_listed_in_the_order_of_their_bits() {
        assert_eq!(conditions(0x0421), ["restarted by the watchdog", "frames lost", "failsafe"]);
        assert_eq!(conditions(0xFFFF).len(), 14);
    }
}
