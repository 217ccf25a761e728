//! Text forms of payloads.

use std::fmt;

/// Bytes as hexadecimal digits without separators.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect()
}

/// Writes a payload that is not decoded: a space and its bytes, or nothing if it is empty.
pub(crate) fn write_raw(f: &mut fmt::Formatter<'_>, payload: &[u8]) -> fmt::Result {
    if payload.is_empty() { Ok(()) } else { write!(f, " {}", hex(payload)) }
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
