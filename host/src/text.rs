//! How payloads are written for people.

use std::fmt;

/// Bytes as hexadecimal digits without anything between them.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect()
}

/// Writes what is not decoded: nothing, or a space and its bytes.
pub(crate) fn write_raw(f: &mut fmt::Formatter<'_>, payload: &[u8]) -> fmt::Result {
    if payload.is_empty() { Ok(()) } else { write!(f, " {}", hex(payload)) }
}

/// Writes a list, or what an empty one is.
pub(crate) fn list<T: fmt::Display>(f: &mut fmt::Formatter<'_>, items: &[T]) -> fmt::Result {
    if items.is_empty() {
        return write!(f, " (empty)");
    }
    items.iter().enumerate().try_for_each(|(index, item)| {
        let separator = if index == 0 { " " } else { ", " };
        write!(f, "{separator}{item}")
    })
}
