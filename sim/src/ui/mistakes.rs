//! The mistakes of a firmware: for each kind the first mistake and their number.

use bench::Cycles;

/// Most kinds that are kept. Mistakes of further kinds only count in the total. A program in a loop
/// makes few kinds.
const KINDS_MAX: usize = 100;

/// A kind of mistake.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mistake {
    /// Time of the first mistake of this kind.
    pub first_at: Cycles,
    /// Text of the first mistake of this kind.
    pub text: String,
    /// Number of mistakes of this kind.
    pub count: u64,
    kind: String,
}

/// All mistakes of a run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Mistakes {
    kinds: Vec<Mistake>,
    total: u64,
}

impl Mistakes {
    /// Adds a mistake. Returns true if it is the first of its kind.
    pub fn add(&mut self, at: Cycles, text: &str) -> bool {
        self.total += 1;
        let kind = without_numbers(text);
        if let Some(known) = self.kinds.iter_mut().find(|known| known.kind == kind) {
            known.count += 1;
            return false;
        }
        let is_kept = self.kinds.len() < KINDS_MAX;
        if is_kept {
            self.kinds.push(Mistake { first_at: at, text: text.to_owned(), count: 1, kind });
        }
        is_kept
    }

    /// Number of mistakes of all kinds.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// The kinds, in the order of their first mistakes.
    pub fn kinds(&self) -> &[Mistake] {
        &self.kinds
    }
}

/// The text with `#` for each number, decimal or hexadecimal. It is equal for mistakes that differ
/// only in a value or an address.
fn without_numbers(text: &str) -> String {
    let mut kind = String::new();
    for word in text.split_inclusive(|c: char| !c.is_ascii_alphanumeric()) {
        let (word, separator) = match word.char_indices().last() {
            Some((at, last)) if !last.is_ascii_alphanumeric() => word.split_at(at),
            _ => (word, ""),
        };
        let digits = word.strip_suffix('h').or(word.strip_prefix("0x")).unwrap_or(word);
        let is_number = digits.contains(|c: char| c.is_ascii_digit())
            && digits.chars().all(|c| c.is_ascii_hexdigit());
        kind.push_str(if is_number { "#" } else { word });
        kind.push_str(separator);
    }
    kind
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mistakes_that_differ_in_a_number_only_are_one_kind() {
        let mut mistakes = Mistakes::default();
        assert!(mistakes.add(5, "AVR: SPDR is written during a transfer (PC 0x01a2)"));
        assert!(!mistakes.add(6, "AVR: SPDR is written during a transfer (PC 0x0b1c)"));
        assert!(mistakes.add(
            7,
            "MCP2515: CNF1 <- 41h ignored: writable only in configuration mode (DS20001801J 10.1)"
        ));
        assert!(!mistakes.add(
            8,
            "MCP2515: CNF1 <- C0h ignored: writable only in configuration mode (DS20001801J 10.1)"
        ));
        assert!(mistakes.add(
            9,
            "MCP2515: CNF2 <- C0h ignored: writable only in configuration mode (DS20001801J 10.1)"
        ));
        assert_eq!(mistakes.total(), 5);
        let kinds: Vec<_> =
            mistakes.kinds().iter().map(|kind| (kind.first_at, kind.count)).collect();
        assert_eq!(kinds, [(5, 2), (7, 2), (9, 1)]);
        assert!(mistakes.kinds()[1].text.contains("41h"));
    }

    #[test]
    fn the_number_of_kinds_is_bounded() {
        let mut mistakes = Mistakes::default();
        let names = ('a'..='z')
            .flat_map(|first| ('a'..='z').map(move |second| format!("mistake {first}{second}")));
        let reported =
            names.map(|name| mistakes.add(0, &name)).filter(|is_first| *is_first).count();
        assert_eq!(
            (reported, mistakes.kinds().len(), mistakes.total()),
            (KINDS_MAX, KINDS_MAX, 676)
        );
    }
}
