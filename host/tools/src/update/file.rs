//! A firmware file, as docs/update.md describes it.

use std::path::Path;
use std::{fmt, fs};

use anyhow::{Context as _, Result, bail, ensure};
use crc::{CRC_16_IBM_3740, Crc};

/// Address of the header: major and minor hardware version, major and minor version of the program,
/// length of the file (little-endian).
const HEADER: usize = 0x68;
const HEADER_LEN: usize = 6;
/// Address of the application descriptor, and its signature. The CRC of the image follows.
const DESCRIPTOR: usize = 0x78;
const SIGNATURE: [u8; 8] = [0x40, 0xA2, 0xE4, 0xF1, 0x64, 0x68, 0x91, 0x06];
/// A file has more than a page of flash, and at most the flash of an ATmega328P without the
/// bootloader.
const LENGTHS: std::ops::RangeInclusive<usize> = 129..=30_720;

/// A firmware file whose CRC is valid.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FirmwareFile {
    pub bytes: Vec<u8>,
    /// Major and minor version of the hardware that the program is for: chip, and wiring of the
    /// CAN board.
    pub hardware: (u8, u8),
    /// Major and minor version of the program.
    pub software: (u8, u8),
    /// The CRC of the image, which GetNodeInfo tells when it runs. `None` in a file without an
    /// application descriptor.
    pub image_crc: Option<u64>,
}

impl FirmwareFile {
    /// Reads a file and checks it.
    ///
    /// # Errors
    /// If it cannot be read, or is not a firmware file.
    pub fn read(path: &Path) -> Result<FirmwareFile> {
        let shown = path.display();
        let metadata = fs::metadata(path).with_context(|| format!("cannot read {shown}"))?;
        // A limit far above any ELF, so that a wrong file is not read completely.
        let may_be_one = metadata.is_file() && metadata.len() < 1 << 26;
        ensure!(may_be_one, "{shown} is not a firmware file");
        let bytes = fs::read(path).with_context(|| format!("cannot read {shown}"))?;
        FirmwareFile::parse(bytes).with_context(|| shown.to_string())
    }

    /// Checks the bytes of a file.
    ///
    /// # Errors
    /// If it is not a firmware file; the message says what it may be, and what to do.
    pub fn parse(bytes: Vec<u8>) -> Result<FirmwareFile> {
        if bytes.starts_with(b"\x7FELF") {
            bail!("this is an ELF file: take the .bin that \"make firmware\" writes next to it");
        }
        if bytes.starts_with(b":") {
            bail!("this is an Intel HEX file: take the .bin of \"make firmware\"");
        }
        let Some(&[hardware_major, hardware_minor, major, minor, low, high]) =
            bytes.get(HEADER..HEADER + HEADER_LEN).and_then(|header| header.first_chunk())
        else {
            bail!("{} bytes are too few for a firmware", bytes.len());
        };
        let length = usize::from(u16::from_le_bytes([low, high]));
        ensure!(
            length == bytes.len() && LENGTHS.contains(&length),
            "the file has {} bytes, and its header says {length}: it is incomplete, or not a \
             firmware file",
            bytes.len()
        );
        // The CRC at the end has the high byte first, so the CRC of all bytes is 0.
        ensure!(
            Crc::<u16>::new(&CRC_16_IBM_3740).checksum(&bytes) == 0,
            "the CRC of the file is wrong: it was changed. Build it again"
        );
        let image_crc = bytes[DESCRIPTOR..]
            .strip_prefix(&SIGNATURE)
            .and_then(|rest| rest.first_chunk())
            .map(|crc| u64::from_le_bytes(*crc));
        Ok(FirmwareFile {
            bytes,
            image_crc,
            hardware: (hardware_major, hardware_minor),
            software: (major, minor),
        })
    }

    /// True if the node can be updated over the bus again after it has this file: a program with
    /// the feature `update` has an application descriptor.
    pub fn takes_updates(&self) -> bool {
        self.image_crc.is_some()
    }
}

impl fmt::Display for FirmwareFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (major, minor) = self.software;
        let (hardware_major, hardware_minor) = self.hardware;
        write!(
            f,
            "version {major}.{minor} for hardware {hardware_major}.{hardware_minor}, {} bytes",
            self.bytes.len()
        )
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use dronecan_host::NodeId;

    pub fn id(id: u8) -> NodeId {
        NodeId::new(id).unwrap()
    }

    /// A file of this length for hardware 2.1, version 1.3.
    pub fn file_of(length: u16) -> FirmwareFile {
        file_with(length, &[])
    }

    /// The same with this image CRC.
    pub fn file_with_crc(length: u16, image_crc: u64) -> FirmwareFile {
        file_with(length, &[SIGNATURE, image_crc.to_le_bytes()].concat())
    }

    fn file_with(length: u16, descriptor: &[u8]) -> FirmwareFile {
        let mut bytes: Vec<u8> = (0..length - 2).map(|n| n as u8).collect();
        bytes[DESCRIPTOR..][..descriptor.len()].copy_from_slice(descriptor);
        let [low, high] = length.to_le_bytes();
        bytes[HEADER..HEADER + HEADER_LEN].copy_from_slice(&[2, 1, 1, 3, low, high]);
        let crc = Crc::<u16>::new(&CRC_16_IBM_3740).checksum(&bytes);
        bytes.extend(crc.to_be_bytes());
        FirmwareFile::parse(bytes).unwrap()
    }

    #[track_caller]
    fn assert_rejected(bytes: &[u8], text: &str) {
        let error = FirmwareFile::parse(bytes.to_vec()).unwrap_err().to_string();
        assert!(error.contains(text), "{error}");
    }

    #[test]
    fn a_file_has_the_versions_of_hardware_and_program() {
        let file = file_of(1000);
        assert_eq!((file.hardware, file.software, file.bytes.len()), ((2, 1), (1, 3), 1000));
        assert_eq!((file.image_crc, file.takes_updates()), (None, false));
        let file = file_with_crc(1000, 0x0123_4567);
        assert_eq!((file.image_crc, file.takes_updates()), (Some(0x0123_4567), true));
    }

    #[test]
    fn other_files_are_rejected_with_a_remedy() {
        let FirmwareFile { bytes, .. } = file_of(1000);
        assert_rejected(b"\x7FELF", "take the .bin");
        assert_rejected(b":10000000", "Intel HEX");
        assert_rejected(b"", "too few");
        assert_rejected(&bytes[..999], "the file has 999 bytes, and its header says 1000");
        let mut changed = bytes;
        changed[500] ^= 1;
        assert_rejected(&changed, "CRC");
    }
}
