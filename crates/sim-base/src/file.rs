//! Reading a file that a user has named, which may be another one than he meant.

use std::fs::File;
use std::io::{self, Error, ErrorKind, Read};
use std::path::Path;

/// Most bytes of a program or a text that a user names: far above any ELF file.
pub const PROGRAM_BYTES: u64 = 64 << 20;

/// Reads a file, a pipe or a device of at most `limit` bytes. Without a limit a device such as
/// /dev/zero would fill the memory.
///
/// # Errors
/// If the file cannot be read, or is longer.
pub fn read_file(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(limit + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit {
        let text = format!("it has more than {} bytes: is it another file?", limit);
        return Err(Error::new(ErrorKind::FileTooLarge, text));
    }
    Ok(bytes)
}

/// Reads a text, as [`read_file`].
///
/// # Errors
/// If the file cannot be read, is longer, or is no text in UTF-8.
pub fn read_text(path: &Path, limit: u64) -> io::Result<String> {
    String::from_utf8(read_file(path, limit)?)
        .map_err(|_| Error::new(ErrorKind::InvalidData, "it is no text in UTF-8"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_up_to_its_limit_and_no_further() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml");
        let length = std::fs::metadata(&path).unwrap().len();
        assert_eq!(read_file(&path, length).unwrap(), std::fs::read(&path).unwrap());
        assert_eq!(read_file(&path, length - 1).unwrap_err().kind(), ErrorKind::FileTooLarge);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_device_without_an_end_is_refused() {
        let error = read_file(Path::new("/dev/zero"), 1000).unwrap_err();
        assert_eq!(error.to_string(), "it has more than 1000 bytes: is it another file?");
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn bytes_that_are_no_text_are_refused() {
        let error = read_text(&std::env::current_exe().unwrap(), PROGRAM_BYTES * 16).unwrap_err();
        assert_eq!(error.to_string(), "it is no text in UTF-8");
    }
}
