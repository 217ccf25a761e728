//! The lines of a serial monitor.

use crate::Cycles;

/// Longest line, in characters. A line that the node does not end is cut here.
const CHARACTERS_MAX: usize = 200;

/// The line that a node is sending.
#[derive(Debug, Default)]
pub struct SerialLine(Option<(Cycles, String)>);

impl SerialLine {
    /// Adds a byte; one that is not printable becomes `\x..`. Returns a line that ends with it, and
    /// the time of its first byte.
    pub fn push(&mut self, at: Cycles, byte: u8) -> Option<(Cycles, String)> {
        let (_, line) = self.0.get_or_insert((at, String::new()));
        match byte {
            b'\r' => return None,
            b'\n' => {}
            b' '..=b'~' => line.push(char::from(byte)),
            _ => line.push_str(&format!("\\x{byte:02x}")),
        }
        let is_over = byte == b'\n' || line.len() >= CHARACTERS_MAX;
        if is_over { self.0.take() } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_become_lines_with_the_times_of_their_first_bytes() {
        let mut line = SerialLine::default();
        let mut lines = |bytes: &[u8]| -> Vec<_> {
            bytes.iter().zip(100..).filter_map(|(byte, at)| line.push(at, *byte)).collect()
        };
        assert_eq!(lines(b"node 42\r\n\x07"), [(100, String::from("node 42"))]);
        assert_eq!(lines(b"x\n"), [(109, String::from("\\x07x"))]);
        assert_eq!(lines(&[b'y'; 401]).len(), 2, "a line that does not end is cut");
    }
}
