//! The chip that a program for an AVR names.

/// Name of the section of an ELF with [the note](device_of_note).
pub const DEVICE_NOTE: &[u8] = b".note.gnu.avr.deviceinfo";

/// The name of the device in the note of an ELF. The note has the name "AVR", the addresses and
/// sizes of three memories, a table of offsets, and texts. The first offset is that of the device's
/// name (binutils, include/elf/avr.h). `None` if the note is cut or the name is empty.
pub fn device_of_note(note: &[u8]) -> Option<&[u8]> {
    const TABLE_BYTES_AT: usize = 40;
    const TABLE_AT: usize = 44;
    let word =
        |at: usize| Some(u32::from_le_bytes(note.get(at..at + 4)?.try_into().ok()?) as usize);
    let texts = TABLE_BYTES_AT.checked_add(word(TABLE_BYTES_AT)?)?;
    let text = note.get(texts.checked_add(word(TABLE_AT)?)?..)?;
    text.split(|byte| *byte == 0).next().filter(|name| !name.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A note that avr-gcc 14 has written.
    const NOTE: &[u8] =
        b"\x04\0\0\0\x2d\0\0\0\x01\0\0\0AVR\0\0\0\0\0\0\x80\0\0\0\x01\0\0\0\x08\0\0\
        \0\0\0\0\0\x04\0\0\x08\0\0\0\x01\0\0\0\0atmega328p\0\0\0\0";

    #[test]
    fn the_device_is_read_from_the_linker_s_note() {
        assert_eq!(device_of_note(NOTE), Some(b"atmega328p".as_slice()));
        for end in 0..NOTE.len() {
            let _ = device_of_note(&NOTE[..end]);
        }
    }
}
