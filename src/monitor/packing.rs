//! Packs the texts at compile time, and says how to unpack them.

use super::text::LINES;

/// A byte of a packed text, decoded.
///
/// | codes | |
/// | --- | --- |
/// | 0x20 to [`LAST_CHARACTER`], carriage return, line feed | characters |
/// | from [`FIRST_FIELD`] to 0x1F | fields |
/// | the others, from the one after [`LAST_CHARACTER`] | pairs |
pub enum Code {
    /// This character.
    Character(u8),
    /// A pair of codes. The first is at this index of [`PACKED`], the other [`SECOND`] bytes after
    /// it.
    Pair(u16),
    /// The value of this field.
    Field(u8),
}

const FIRST_CHARACTER: u8 = b' ';
const LAST_CHARACTER: u8 = b'z';
const FIRST_FIELD: u8 = b'\r' + 1;
const FIELDS: u8 = FIRST_CHARACTER - FIRST_FIELD;
const FIRST_PAIR: u8 = LAST_CHARACTER + 1;
const _: () = assert!(Field::LETTERS.len() <= FIELDS as usize);
/// Number of codes that can stand for a pair.
const PAIRS: u8 = b'\n'.wrapping_sub(FIRST_PAIR);

impl From<u8> for Code {
    fn from(code: u8) -> Self {
        let index = code.wrapping_sub(FIRST_PAIR);
        if index < PAIRS {
            return Self::Pair((PAIRS_AT as u16).wrapping_add(u16::from(index)));
        }
        let index = code.wrapping_sub(FIRST_FIELD);
        if index < FIELDS { Self::Field(index) } else { Self::Character(code) }
    }
}

/// Ends a line: the pair of carriage return and line feed.
pub const LINE_END: u8 = FIRST_PAIR;

/// The numbers of the fields in [`Code::Field`], and their letters in a text. See
/// [`Event`](super::Event).
pub struct Field;

impl Field {
    /// `s`. This number and the next two are also indices in the bytes of an event.
    pub const SOURCE: u8 = 0;
    /// `t`
    pub const TRANSFER: u8 = 1;
    /// `c`
    pub const CODE: u8 = 2;
    /// `w`
    pub const WORD: u8 = 3;
    /// `n`
    pub const NAME: u8 = 4;
    /// `o`
    pub const OUTPUTS: u8 = 5;
    /// `b`
    pub const B: u8 = 6;
    /// `p`
    pub const HALVES: u8 = 7;
    /// `a`
    pub const A: u8 = 8;
    /// `+`
    pub const SIGN: u8 = 9;
    /// `0`. The next three numbers stand for one, two and three decimal places.
    pub const NO_PLACES: u8 = 10;

    /// The letters in the order of the numbers.
    const LETTERS: &[u8; 14] = b"stcwnobpa+0123";
}

const fn field(letter: u8) -> u16 {
    let mut n = 0;
    while Field::LETTERS[n] != letter {
        n += 1;
    }
    FIRST_FIELD as u16 + n as u16
}

const fn plain_len() -> usize {
    let mut len = 0;
    let mut line = 0;
    while line < LINES.len() {
        len += LINES[line].len() + 1;
        line += 1;
    }
    len
}

/// Marks the end of a line during packing. Larger than every code.
const END: u16 = 0x100;

/// The lines during packing.
struct Packing {
    text: [u16; plain_len()],
    len: usize,
    pairs: [[u8; 2]; PAIRS as usize],
    used: usize,
}

impl Packing {
    /// The lines unpacked: one code for each character and each field.
    const fn new() -> Self {
        let mut packing =
            Self { text: [END; plain_len()], len: 0, pairs: [[0; 2]; PAIRS as usize], used: 0 };
        let mut line = 0;
        while line < LINES.len() {
            let text = LINES[line].as_bytes();
            let mut n = 0;
            while n < text.len() {
                packing.text[packing.len] = if text[n] == b'%' {
                    n += 1;
                    field(text[n])
                } else {
                    assert!(FIRST_CHARACTER <= text[n] && text[n] <= LAST_CHARACTER);
                    text[n] as u16
                };
                packing.len += 1;
                n += 1;
            }
            packing.text[packing.len] = END;
            packing.len += 1;
            line += 1;
        }
        packing
    }

    /// Replaces each occurrence of the pair `old` by the code `new`, and counts the pairs of the
    /// result. Returns the most frequent pair and its count. One pass does both, because the
    /// compiler evaluates this slowly, once for each crate that needs the result.
    const fn replace(&mut self, old: [u16; 2], new: u16) -> ([u16; 2], u8) {
        // Each array counts a quarter of all pairs: on the AVR, whose sizes apply here, an array of
        // 65,536 bytes is too large.
        const QUARTER: usize = 1 << 14;
        let mut q0 = [0u8; QUARTER];
        let mut q1 = [0u8; QUARTER];
        let mut q2 = [0u8; QUARTER];
        let mut q3 = [0u8; QUARTER];
        let (mut best, mut best_count) = ([END; 2], 0);
        let (mut from, mut to, mut first) = (0, 0, END);
        while from < self.len {
            let mut second = self.text[from];
            from += 1;
            if second == old[0] && from < self.len && self.text[from] == old[1] {
                second = new;
                from += 1;
            }
            self.text[to] = second;
            to += 1;
            if first != END && second != END {
                let counts = match first >> 6 {
                    0 => &mut q0,
                    1 => &mut q1,
                    2 => &mut q2,
                    _ => &mut q3,
                };
                let count = &mut counts[((first & 63) << 8 | second) as usize];
                *count = count.saturating_add(1);
                if *count > best_count {
                    (best, best_count) = ([first, second], *count);
                }
            }
            first = second;
        }
        self.len = to;
        (best, best_count)
    }
}

/// Byte-pair encoding: replaces the most frequent pair of codes by a new code, as long as that
/// makes the table shorter.
const PACKING: Packing = {
    let mut packing = Packing::new();
    // The first pair is the end of a line.
    packing.pairs[0] = *b"\r\n";
    packing.used = 1;
    // Nothing is larger than `END`, so this call only counts.
    let (mut pair, mut count) = packing.replace([END + 1; 2], END);
    // A pair takes two bytes of the table, so a count of two saves nothing.
    while count > 2 && packing.used < PAIRS as usize {
        packing.pairs[packing.used] = [pair[0] as u8, pair[1] as u8];
        let code = FIRST_PAIR.wrapping_add(packing.used as u8);
        packing.used += 1;
        (pair, count) = packing.replace(pair, code as u16);
    }
    packing
};

/// Index of the first halves of the pairs. The second halves follow.
const PAIRS_AT: usize = 0;
/// Distance from the first half of a pair to its second half.
pub const SECOND: u16 = PACKING.used as u16;
const LINES_AT: usize = PAIRS_AT + 2 * PACKING.used;

/// All texts: the pairs, then the lines. The length of each line is stored before it.
pub const PACKED: [u8; LINES_AT + PACKING.len] = {
    let mut packed = [0; LINES_AT + PACKING.len];
    let mut n = 0;
    while n < PACKING.used {
        [packed[PAIRS_AT + n], packed[PAIRS_AT + PACKING.used + n]] = PACKING.pairs[n];
        n += 1;
    }
    let mut length_at = LINES_AT;
    n = 0;
    while n < PACKING.len {
        let at = LINES_AT + n + 1;
        if PACKING.text[n] == END {
            length_at = at;
        } else {
            packed[at] = PACKING.text[n] as u8;
            packed[length_at] += 1;
        }
        n += 1;
    }
    packed
};

/// Index of the length of the first line.
pub const FIRST_LINE: u16 = LINES_AT as u16;
