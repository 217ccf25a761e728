//! The vendor-specific status code in words.
//!
//! docs/status.md defines the code of this project's firmware. The codes of other programs have
//! other meanings, so the views show words only for programs with the ELF section `.board`.

/// Bits 0 to 2 of the code: the fault that caused the last reset, as a number.
const RESET: u16 = 0b111;

/// The fault for each number in the bits `RESET`. 0 is no fault; 6 and 7 have no meaning yet.
const RESETS: [Option<&str>; 8] = [
    None,
    Some("restarted by the watchdog"),
    Some("restarted after a brown-out"),
    Some("restarted after a panic"),
    Some("restarted after a stray interrupt"),
    Some("restarted after a stack overflow"),
    Some("restarted, cause 6"),
    Some("restarted, cause 7"),
];

/// The condition of each other bit.
const CONDITIONS: [(u16, &str); 13] = [
    (1 << 3, "transfer errors"),
    (1 << 4, "node ID conflict"),
    (1 << 5, "frames lost"),
    (1 << 6, "error-passive"),
    (1 << 7, "bus-off"),
    (1 << 8, "controller restarted or sending given up"),
    (1 << 9, "two commanders"),
    (1 << 10, "failsafe"),
    (1 << 11, "temperature"),
    (1 << 12, "power"),
    (1 << 13, "parameters lost"),
    (1 << 14, "disarmed or safe"),
    (1 << 15, "speaks the draft"),
];

/// The conditions in `code`, a text each; none for code 0.
pub fn conditions(code: u16) -> Vec<&'static str> {
    let set = |(bit, text): (u16, &'static str)| (code & bit != 0).then_some(text);
    let reset = RESETS[usize::from(code & RESET)];
    reset.into_iter().chain(CONDITIONS.into_iter().filter_map(set)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_bit_has_its_text() {
        for bit in 3..16 {
            let texts = conditions(1 << bit);
            assert_eq!(texts, [CONDITIONS[bit - 3].1], "bit {bit}");
        }
        for (cause, text) in RESETS.iter().enumerate() {
            assert_eq!(conditions(cause as u16).first().copied(), *text);
        }
        assert!(conditions(0).is_empty());
    }

    /// The row of each bit in docs/status.md contains a word of the bit's text.
    #[test]
    fn the_texts_agree_with_the_document() {
        let document = include_str!("../../../docs/status.md").to_lowercase();
        let words = [
            "transfer",
            "node",
            "frames",
            "error-passive",
            "bus-off",
            "controller",
            "two",
            "failsafe",
            "temperature",
            "",
            "parameters",
            "safe",
            "draft",
        ];
        for (bit, word) in (3..).zip(words) {
            let start = format!("| {bit} |");
            let row = document
                .lines()
                .find(|line| line.starts_with(&start))
                .expect("each bit has its row");
            assert!(row.contains(word) && conditions(1 << bit)[0].contains(word), "{word}: {row}");
        }
    }

    #[test]
    fn several_conditions_are_listed_in_the_order_of_their_bits() {
        assert_eq!(conditions(0x0421), ["restarted by the watchdog", "frames lost", "failsafe"]);
        assert_eq!(conditions(0xFFFF).len(), 14);
    }
}
