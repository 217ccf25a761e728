//! Text forms of payloads, and of text whose origin is unknown.

use std::borrow::Cow;
use std::fmt::{self, Write as _};

/// Makes the control characters in `text` visible: `\x1b`, `\u{202e}`.
///
/// For text from a node, a file or another program, before a terminal, a log or a report shows it:
/// an escape sequence could otherwise change what the terminal shows, or what it types. Line ends
/// are control characters, too: pass single lines.
pub fn visible(text: &str) -> Cow<'_, str> {
    if !text.contains(is_hidden) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 8);
    for character in text.chars() {
        // Writing to a String cannot fail.
        let _ = match u32::from(character) {
            code @ ..0x100 if is_hidden(character) => write!(shown, "\\x{code:02x}"),
            code if is_hidden(character) => write!(shown, "\\u{{{code:x}}}"),
            _ => shown.write_char(character),
        };
    }
    Cow::Owned(shown)
}

/// True for the control characters of Unicode (C0, DEL, C1), for those that change the direction of
/// text (UAX #9), and for the separators of lines and paragraphs.
fn is_hidden(character: char) -> bool {
    let changes_direction = matches!(
        character,
        '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}'
    );
    character.is_control() || changes_direction || matches!(character, '\u{2028}' | '\u{2029}')
}

/// Bytes as hexadecimal digits without separators.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect()
}

/// Writes a payload that is not decoded: a space and its bytes, or nothing if it is empty.
pub(crate) fn write_raw(f: &mut fmt::Formatter<'_>, payload: &[u8]) -> fmt::Result {
    if payload.is_empty() { Ok(()) } else { write!(f, " {}", hex(payload)) }
}

/// Writes a space and a value.
pub(crate) fn display<T: fmt::Display>(f: &mut fmt::Formatter<'_>, value: &T) -> fmt::Result {
    write!(f, " {value}")
}

/// Writes a list, or "(empty)".
pub(crate) fn list<T: fmt::Display>(f: &mut fmt::Formatter<'_>, items: &[T]) -> fmt::Result {
    if items.is_empty() {
        return write!(f, " (empty)");
    }
    items.iter().enumerate().try_for_each(|(index, item)| {
        let separator = if index == 0 { " " } else { ", " };
        write!(f, "{separator}{item}")
    })
}

/// The names of the bits that are set, each after a space. Bits without a name are one number, of
/// `width` characters.
pub(crate) fn flags(bits: u16, names: &[&str], width: usize) -> String {
    let named = names.iter().enumerate().filter(|(bit, _)| bits >> bit & 1 != 0);
    let text: String = named.map(|(_, name)| format!(" {name}")).collect();
    match bits >> names.len() << names.len() {
        0 => text,
        unknown => format!("{text} flags {unknown:#0width$x}"),
    }
}

/// An enumeration with the numbers and the names of its variants. The one behind `or` has the other
/// numbers.
macro_rules! numbered {
    ($(#[$doc:meta])* pub enum $name:ident or $others:ident $text_of_others:literal {
        $($(#[$about:meta])* $variant:ident = $number:literal $text:literal,)*
    }) => {
        $(#[$doc])*
        pub enum $name {
            $($(#[$about])* $variant,)*
            $others(u8),
        }

        impl $name {
            fn from_field(field: u8) -> $name {
                match field {
                    $($number => $name::$variant,)*
                    other => $name::$others(other),
                }
            }

            /// The number on the wire.
            pub fn field(self) -> u8 {
                match self {
                    $($name::$variant => $number,)*
                    $name::$others(other) => other,
                }
            }
        }

        $crate::fields::as_number! {
            $name: u8, |field| Some($name::from_field(field)), $name::field;
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                match self {
                    $($name::$variant => f.pad($text),)*
                    $name::$others(other) => write!(f, $text_of_others, other),
                }
            }
        }
    };
}
pub(crate) use numbered;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_become_visible_and_all_else_stays() {
        for (text, expected) in [
            ("\u{1b}[2J\u{1b}]0;x\u{7}", "\\x1b[2J\\x1b]0;x\\x07"),
            ("a\tb\r\nc\0", "a\\x09b\\x0d\\x0ac\\x00"),
            ("\u{7f}\u{9b}2J\u{85}", "\\x7f\\x9b2J\\x85"),
            ("\u{202e}evil\u{2066}\u{2028}", "\\u{202e}evil\\u{2066}\\u{2028}"),
        ] {
            assert_eq!(visible(text), expected);
        }
        for plain in ["", "ß → 漢 \\x1b", "node 42 is org.example"] {
            assert!(matches!(visible(plain), Cow::Borrowed(same) if same == plain));
        }
    }
}
