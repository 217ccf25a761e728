//! The log of the bus: candump text, pcap if the name of the file ends in .pcap, or what was said if it ends in .txt.
//!
//! ```text
//! (2.512352) can0 1404562A#0100A95C00C0
//! ```
//!
//! The time is simulated, in seconds since power-on, of the frame's SOF: a log that is played back with `--script` puts
//! each frame where it was. python-can, can-utils and Wireshark take it as seconds since 1970.
//!
//! A pcap has link type CAN_SOCKETCAN, with error frames. Text has no error frames: what replays a log would send them as
//! frames. They are counted, and the status tells. Nor has text a DLC above 8, for python-can and Wireshark give up at it: it
//! becomes 8, and the pcap has it.
//!
//! What was said has a line for each transfer, when its last frame has ended, with its sender and its meaning:
//!
//! ```text
//!      2.514901   127>120 param.GetSet request OUT1_MIN = 1100
//! ```
//!
//! The dialect of each line is found as [`dialect`](bench::dronecan::dialect) has it; what is of the draft says so.
//!
//! Sources: can-utils, log file format (candump.c, lib.h); tcpdump.org, "LINKTYPE_CAN_SOCKETCAN"; Linux, can/error.h.

use super::Link;
use anyhow::{Context, Result};
use bench::Bench;
use bench::can::{ErrorKind, Frame, Id, Record, RecordKind};
use bench::dronecan::{Heard, Observer};
use bench::{Cycles, F_CPU_HZ};
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

const CYCLES_PER_US: u64 = F_CPU_HZ / 1_000_000;
/// Lines are handed to the system in pieces of at least this size, or after this time: whole lines only, so that a
/// program that is killed leaves a file that can be read.
const WRITE_SIZE: usize = 64 * 1024;
const WRITE_PERIOD: Cycles = F_CPU_HZ / 100;

/// Header of a pcap file with times in microseconds, in this machine's byte order, as the format wants it.
const PCAP_MAGIC: u32 = 0xA1B2_C3D4;
const PCAP_VERSION: [u16; 2] = [2, 4];
const PCAP_SNAPSHOT_LENGTH: u32 = 65_535;
const LINKTYPE_CAN_SOCKETCAN: u32 = 227;

const CAN_EFF_FLAG: u32 = 1 << 31;
const CAN_RTR_FLAG: u32 = 1 << 30;
const CAN_ERR_FLAG: u32 = 1 << 29;
/// Class of an error frame: the protocol was violated; data\[2\] and data\[3\] say how and where.
const CAN_ERR_PROT: u32 = 0x008;
/// Class of an error frame: nobody acknowledged.
const CAN_ERR_ACK: u32 = 0x020;
const CAN_ERR_PROT_BIT: u8 = 0x01;
const CAN_ERR_PROT_FORM: u8 = 0x02;
const CAN_ERR_PROT_STUFF: u8 = 0x04;
const CAN_ERR_PROT_LOC_CRC_SEQ: u8 = 0x08;
const CAN_ERR_DLC: u8 = 8;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Candump,
    Pcap,
    Transfers,
}

/// See the module.
pub struct Log {
    path: PathBuf,
    format: Format,
    out: Box<dyn Write>,
    text: Vec<u8>,
    next_write: Cycles,
    frames: u64,
    error_frames: u64,
    failed: bool,
    observer: Observer,
}

impl Log {
    /// Creates the file. The bit rate is that of the bus; neither format has a place for it.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(path: &Path, _bit_rate: u32) -> Result<Log> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
        let format = match ending.as_deref() {
            Some("pcap") => Format::Pcap,
            Some("txt") => Format::Transfers,
            _ => Format::Candump,
        };
        let file = File::create(path).with_context(|| format!("--log: cannot write {}", path.display()))?;
        Log::new(path, Box::new(file), format)
    }

    fn new(path: &Path, out: Box<dyn Write>, format: Format) -> Result<Log> {
        let text = match format {
            Format::Candump | Format::Transfers => Vec::new(),
            Format::Pcap => pcap_header(),
        };
        let path = path.to_owned();
        let mut log = Log {
            path,
            format,
            out,
            text,
            next_write: 0,
            frames: 0,
            error_frames: 0,
            failed: false,
            observer: Observer::new(),
        };
        log.write()?;
        Ok(log)
    }

    /// Hands what is there to the system. Dropping does the same, but cannot report an error.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&mut self) -> Result<()> {
        let text = std::mem::take(&mut self.text);
        let written = self.out.write_all(&text).and_then(|()| self.out.flush());
        self.failed |= written.is_err();
        written.with_context(|| format!("cannot write {}", self.path.display()))
    }

    fn add(&mut self, record: &Record) -> io::Result<()> {
        let us = record.start / CYCLES_PER_US;
        match (self.format, record.kind) {
            (Format::Candump, RecordKind::Frame { mut frame, .. }) => {
                frame.dlc = frame.dlc.min(8);
                writeln!(self.text, "({}.{:06}) can0 {frame}", us / 1_000_000, us % 1_000_000)
            }
            (Format::Candump, RecordKind::ErrorFrame { .. }) => Ok(()),
            (Format::Transfers, RecordKind::Frame { frame, .. }) => self.add_transfer(record.end, &frame),
            (Format::Transfers, RecordKind::ErrorFrame { kind, .. }) => {
                let kind = kind.map_or(String::new(), |kind| format!(": {kind:?}").to_lowercase());
                self.add_line(record.end, "-", &format!("error frame{kind}"))
            }
            (Format::Pcap, RecordKind::Frame { frame, .. }) => {
                pcap_packet(&mut self.text, us, &socketcan_frame(&frame));
                Ok(())
            }
            (Format::Pcap, RecordKind::ErrorFrame { kind, .. }) => {
                pcap_packet(&mut self.text, us, &socketcan_error(kind));
                Ok(())
            }
        }
    }

    fn add_transfer(&mut self, at: Cycles, frame: &Frame) -> io::Result<()> {
        let id = match frame.id {
            Id::Extended(id) if !frame.remote => id,
            _ => return self.add_line(at, "-", &format!("CAN frame {frame}")),
        };
        match self.observer.push(id, frame.data(), bench::elapsed(at)) {
            Heard::Partial => Ok(()),
            Heard::Invalid(why) => self.add_line(at, "-", &format!("invalid frame {frame} {why}")),
            Heard::Said(said) => self.add_line(at, &said.who(), &said.to_string()),
        }
    }

    fn add_line(&mut self, at: Cycles, who: &str, text: &str) -> io::Result<()> {
        let us = at / CYCLES_PER_US;
        writeln!(self.text, "{:6}.{:06} {who:>9} {text}", us / 1_000_000, us % 1_000_000)
    }
}

impl Link for Log {
    fn serve(&mut self, bench: &mut Bench) -> Result<()> {
        let due = bench.now() >= self.next_write && !self.text.is_empty();
        if due || self.text.len() >= WRITE_SIZE {
            self.next_write = bench.now() + WRITE_PERIOD;
            self.write()?;
        }
        Ok(())
    }

    fn record(&mut self, record: &Record, _from: Option<&str>) -> Result<()> {
        match record.kind {
            RecordKind::Frame { .. } => self.frames += 1,
            RecordKind::ErrorFrame { .. } => self.error_frames += 1,
        }
        self.add(record)?;
        Ok(())
    }

    fn status(&self) -> String {
        let errors = match (self.format, self.error_frames) {
            (_, 0) => String::new(),
            (Format::Pcap | Format::Transfers, count) => format!(" and {count} error frames"),
            (Format::Candump, count) => format!("; {count} error frames left out"),
        };
        format!("log to {}, {} frames{errors}", self.path.display(), self.frames)
    }
}

impl Drop for Log {
    fn drop(&mut self) {
        if !self.failed {
            // Nobody is left to tell. All but the last moment is in the file.
            let _ = self.write();
        }
    }
}

fn pcap_header() -> Vec<u8> {
    let mut header = PCAP_MAGIC.to_ne_bytes().to_vec();
    header.extend(PCAP_VERSION.iter().flat_map(|part| part.to_ne_bytes()));
    // Time zone and accuracy of the times: always 0.
    header.extend([0; 8]);
    header.extend(PCAP_SNAPSHOT_LENGTH.to_ne_bytes());
    header.extend(LINKTYPE_CAN_SOCKETCAN.to_ne_bytes());
    header
}

fn pcap_packet(out: &mut Vec<u8>, us: u64, packet: &[u8]) {
    // Seconds have 32 bits, which is a hundred years.
    let fields = [(us / 1_000_000) as u32, (us % 1_000_000) as u32, packet.len() as u32, packet.len() as u32];
    out.extend(fields.iter().flat_map(|field| field.to_ne_bytes()));
    out.extend(packet);
}

/// Identifier with flags in network byte order, length, three bytes of which the last is the DLC if it is above 8, data.
fn socketcan_frame(frame: &Frame) -> Vec<u8> {
    let id = match frame.id {
        Id::Standard(id) => u32::from(id),
        Id::Extended(id) => id | CAN_EFF_FLAG,
    };
    let remote = if frame.remote { CAN_RTR_FLAG } else { 0 };
    let length = frame.dlc.min(8);
    let long_dlc = if frame.dlc > 8 { frame.dlc } else { 0 };
    socketcan(id | remote, length, long_dlc, frame.data())
}

fn socketcan_error(kind: Option<ErrorKind>) -> Vec<u8> {
    let mut data = [0; 8];
    let class = match kind {
        Some(ErrorKind::Ack) => CAN_ERR_ACK,
        _ => CAN_ERR_PROT,
    };
    match kind {
        Some(ErrorKind::Bit) => data[2] = CAN_ERR_PROT_BIT,
        Some(ErrorKind::Form) => data[2] = CAN_ERR_PROT_FORM,
        Some(ErrorKind::Stuff) => data[2] = CAN_ERR_PROT_STUFF,
        Some(ErrorKind::Crc) => data[3] = CAN_ERR_PROT_LOC_CRC_SEQ,
        Some(ErrorKind::Ack) | None => {}
    }
    socketcan(CAN_ERR_FLAG | class, CAN_ERR_DLC, 0, &data)
}

fn socketcan(id: u32, length: u8, long_dlc: u8, data: &[u8]) -> Vec<u8> {
    let mut packet = id.to_be_bytes().to_vec();
    packet.extend([length, 0, 0, long_dlc]);
    packet.extend(data);
    packet
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;
    use std::rc::Rc;

    /// A file that can be looked at while it is being written, and that has room for so many bytes.
    #[derive(Clone)]
    struct Disk {
        bytes: Rc<RefCell<Vec<u8>>>,
        room: usize,
    }

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.bytes.borrow().len() + bytes.len() > self.room {
                return Err(io::ErrorKind::StorageFull.into());
            }
            self.bytes.borrow_mut().extend(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn disk(room: usize) -> Disk {
        Disk { bytes: Rc::default(), room }
    }

    fn log(disk: &Disk, format: Format) -> Log {
        Log::new(Path::new("run.log"), Box::new(disk.clone()), format).unwrap()
    }

    fn frame(start_us: u64, text: &str) -> Record {
        let frame = text.parse().unwrap();
        let start = start_us * CYCLES_PER_US;
        Record { start, end: start + 1, bits: 1, kind: RecordKind::Frame { frame, from: None, acked: true } }
    }

    fn error(kind: ErrorKind) -> Record {
        Record { start: 0, end: 1, bits: 1, kind: RecordKind::ErrorFrame { kind: Some(kind), from: None } }
    }

    #[test]
    fn a_line_has_time_interface_and_frame() {
        let disk = disk(1000);
        let mut log = log(&disk, Format::Candump);
        for (us, text) in [
            (2_512_352, "1404562A#0100A95C00C0"),
            (61_000_001, "123#R4"),
            (61_000_500, "7FF#"),
            (61_000_700, "7FF#1122334455667788_C"),
        ] {
            log.record(&frame(us, text), None).unwrap();
        }
        log.record(&error(ErrorKind::Stuff), None).unwrap();
        assert_eq!(log.status(), "log to run.log, 4 frames; 1 error frames left out");
        drop(log);
        let text = String::from_utf8(disk.bytes.take()).unwrap();
        let expected = [
            "(2.512352) can0 1404562A#0100A95C00C0",
            "(61.000001) can0 123#R4",
            "(61.000500) can0 7FF#",
            "(61.000700) can0 7FF#1122334455667788",
        ];
        assert_eq!(text.lines().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn what_was_said_has_a_line_for_each_transfer() {
        let disk = disk(10_000);
        let mut log = log(&disk, Format::Transfers);
        for (us, text) in [
            (100, "1E0BF8FF#4D0D00014C040084"),
            (300, "1E0BF8FF#0000000000535224"),
            (500, "1E0BF8FF#565F4D494E44"),
            (700, "123#01"),
            (900, "1003F20A#0000000000000020"),
            (950, "17C40409#5A"),
        ] {
            log.record(&frame(us, text), None).unwrap();
        }
        log.record(&error(ErrorKind::Stuff), None).unwrap();
        drop(log);
        let text = String::from_utf8(disk.bytes.take()).unwrap();
        let lines: Vec<_> = text.lines().map(|line| &line[14..]).collect();
        let expected = [
            "  127>120 param.GetSet request SRV_MIN = 1100",
            "        - CAN frame 123#01",
            "        - invalid frame 1003F20A#0000000000000020 continues a transfer that did not start",
            "        1 draft.ThesisCommand 90",
            "        - error frame: stuff",
        ];
        assert_eq!(lines, expected);
    }

    #[test]
    fn a_pcap_has_a_header_and_sixteen_bytes_before_each_packet() {
        let disk = disk(1000);
        let mut log = log(&disk, Format::Pcap);
        log.record(&frame(2_512_352, "1404562A#0100A95C00C0"), None).unwrap();
        drop(log);
        let bytes = disk.bytes.take();
        assert_eq!(bytes.len(), 24 + 16 + 14);
        let word = |at: usize| u32::from_ne_bytes(bytes[at..at + 4].try_into().unwrap());
        assert_eq!((word(0), word(20)), (0xA1B2_C3D4, 227));
        assert_eq!([24, 28, 32, 36].map(word), [2, 512_352, 14, 14]);
        assert_eq!(bytes[40..48], [0x94, 0x04, 0x56, 0x2A, 6, 0, 0, 0]);
        assert_eq!(bytes[48..], [0x01, 0x00, 0xA9, 0x5C, 0x00, 0xC0]);
    }

    #[test]
    fn packets_tell_remote_frames_long_dlcs_and_errors() {
        let packet = |text: &str| socketcan_frame(&text.parse().unwrap());
        assert_eq!(packet("123#R4"), [0x40, 0, 1, 0x23, 4, 0, 0, 0]);
        assert_eq!(packet("7FF#1122334455667788_C")[..8], [0, 0, 7, 0xFF, 8, 0, 0, 12]);
        assert_eq!(socketcan_error(Some(ErrorKind::Stuff))[..12], [0x20, 0, 0, 8, 8, 0, 0, 0, 0, 0, 4, 0]);
        assert_eq!(socketcan_error(Some(ErrorKind::Crc))[8..12], [0, 0, 0, 8]);
        assert_eq!(socketcan_error(Some(ErrorKind::Ack))[..4], [0x20, 0, 0, 0x20]);
    }

    /// A killed program must leave what it saw.
    #[test]
    fn lines_are_in_the_file_soon() {
        let disk = disk(1000);
        let mut bench = Bench::new(1_000_000);
        let mut log = log(&disk, Format::Candump);
        log.record(&frame(1, "123#01"), None).unwrap();
        bench.run_for_ms(10);
        log.serve(&mut bench).unwrap();
        assert_eq!(*disk.bytes.borrow(), b"(0.000001) can0 123#01\n");
    }

    #[test]
    fn a_full_disk_is_an_error_that_names_the_file() {
        let disk = disk(30);
        let mut bench = Bench::new(1_000_000);
        let mut log = log(&disk, Format::Candump);
        for us in 0..2 {
            log.record(&frame(us, "123#01"), None).unwrap();
        }
        let error = log.serve(&mut bench).unwrap_err();
        assert!(format!("{error:#}").starts_with("cannot write run.log: "), "{error:#}");
    }

    #[test]
    fn a_path_that_cannot_be_is_an_error_that_names_it() {
        let Err(error) = Log::create(Path::new("/nonexistent/run.log"), 1_000_000) else {
            panic!("created");
        };
        assert!(format!("{error:#}").starts_with("--log: cannot write /nonexistent/run.log: "), "{error:#}");
    }
}
