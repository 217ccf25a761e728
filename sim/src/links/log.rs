//! The log of the bus: pcap if the name of the file ends in .pcap, decoded transfers if it ends in
//! .txt, else candump text.
//!
//! ```text
//! (2.512352) can0 1404562A#0100A95C00C0
//! ```
//!
//! The time is that of the frame's SOF, in simulated seconds since power-on. So `--script` plays
//! each frame of a log at its time. python-can, can-utils and Wireshark read it as seconds since
//! 1970.
//!
//! A pcap has link type CAN_SOCKETCAN, with error frames. Text has no error frames, because a
//! program that plays the log would send them as frames; the status line has their number. In text
//! a DLC above 8 becomes 8, because python-can and Wireshark reject it; a pcap keeps it.
//!
//! The log of decoded transfers has a line for each transfer: the time of its end, its sender, and
//! its content:
//!
//! ```text
//!      2.514901   127>120 param.GetSet request OUT1_MIN = 1100
//! ```
//!
//! [`dialect`](bench::dronecan::dialect) says how it finds the dialect of a transfer. Transfers of
//! the draft are marked `draft`.
//!
//! Sources: can-utils, log file format (candump.c, lib.h); tcpdump.org, "LINKTYPE_CAN_SOCKETCAN";
//! Linux, can/error.h.

use super::Link;
use anyhow::{Context, Result};
use bench::Bench;
use bench::can::{ErrorKind, Frame, Id, Record, RecordKind};
use bench::dronecan::text::visible;
use bench::dronecan::{Observation, Observer};
use bench::{Cycles, F_CPU_HZ};
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

const CYCLES_PER_US: u64 = F_CPU_HZ / 1_000_000;
/// The log writes to the file when it has this many bytes, or after `WRITE_PERIOD`. It writes whole
/// lines, so that the file of a run that is killed can be read.
const WRITE_SIZE: usize = 64 * 1024;
const WRITE_PERIOD: Cycles = F_CPU_HZ / 100;

/// First word of a pcap file with times in microseconds. A pcap file has the byte order of the
/// computer that writes it.
const PCAP_MAGIC: u32 = 0xA1B2_C3D4;
const PCAP_VERSION: [u16; 2] = [2, 4];
const PCAP_SNAPSHOT_LENGTH: u32 = 65_535;
const LINKTYPE_CAN_SOCKETCAN: u32 = 227;

const CAN_EFF_FLAG: u32 = 1 << 31;
const CAN_RTR_FLAG: u32 = 1 << 30;
const CAN_ERR_FLAG: u32 = 1 << 29;
/// Class of an error frame: protocol violation; data\[2\] and data\[3\] have its kind and its
/// place.
const CAN_ERR_PROT: u32 = 0x008;
/// Class of an error frame: no ACK.
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

/// A log of the bus.
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
    /// Creates the file. The formats have no field for the bit rate of the bus.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn create(path: &Path, _bit_rate: u32) -> Result<Log> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
        let format = match ending.as_deref() {
            Some("pcap") => Format::Pcap,
            Some("txt") => Format::Transfers,
            _ => Format::Candump,
        };
        let file = File::create(path)
            .with_context(|| format!("--log: cannot write {}", path.display()))?;
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

    /// Writes the lines so far to the file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&mut self) -> Result<()> {
        let text = std::mem::take(&mut self.text);
        let written = self.out.write_all(&text).and_then(|()| self.out.flush());
        self.failed |= written.is_err();
        written.with_context(|| format!("cannot write {}", self.path.display()))
    }

    /// Writes the last lines, unless a write has failed before.
    fn write_rest(&mut self) -> Result<()> {
        if self.failed { Ok(()) } else { self.write() }
    }

    fn add(&mut self, record: &Record) -> io::Result<()> {
        let us = record.start / CYCLES_PER_US;
        match (self.format, record.kind) {
            (Format::Candump, RecordKind::Frame { mut frame, .. }) => {
                frame.dlc = frame.dlc.min(8);
                writeln!(self.text, "({}.{:06}) can0 {frame}", us / 1_000_000, us % 1_000_000)
            }
            (Format::Candump, RecordKind::ErrorFrame { .. }) => Ok(()),
            (Format::Transfers, RecordKind::Frame { frame, .. }) => {
                self.add_transfer(record.end, &frame)
            }
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
            Observation::Partial => Ok(()),
            Observation::Invalid(why) => {
                self.add_line(at, "-", &format!("invalid frame {frame} {why}"))
            }
            Observation::Complete(transfer) => {
                self.add_line(at, &transfer.endpoints(), &transfer.to_string())
            }
        }
    }

    fn add_line(&mut self, at: Cycles, who: &str, text: &str) -> io::Result<()> {
        let us = at / CYCLES_PER_US;
        let text = visible(text);
        writeln!(self.text, "{:6}.{:06} {who:>9} {text}", us / 1_000_000, us % 1_000_000)
    }
}

impl Link for Log {
    fn serve(&mut self, bench: &mut Bench) -> Result<()> {
        let is_due = bench.now() >= self.next_write && !self.text.is_empty();
        if is_due || self.text.len() >= WRITE_SIZE {
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

    fn finish(&mut self, _bench: &mut Bench) -> Result<()> {
        self.write_rest()
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
        // A drop cannot report an error. All but the last 10 ms are in the file already.
        let _ = self.write_rest();
    }
}

fn pcap_header() -> Vec<u8> {
    let mut header = PCAP_MAGIC.to_ne_bytes().to_vec();
    header.extend(PCAP_VERSION.iter().flat_map(|part| part.to_ne_bytes()));
    // Time zone and accuracy of the timestamps: always 0.
    header.extend([0; 8]);
    header.extend(PCAP_SNAPSHOT_LENGTH.to_ne_bytes());
    header.extend(LINKTYPE_CAN_SOCKETCAN.to_ne_bytes());
    header
}

fn pcap_packet(out: &mut Vec<u8>, us: u64, packet: &[u8]) {
    // 32 bits of seconds are enough for a hundred years.
    let fields = [
        (us / 1_000_000) as u32,
        (us % 1_000_000) as u32,
        packet.len() as u32,
        packet.len() as u32,
    ];
    out.extend(fields.iter().flat_map(|field| field.to_ne_bytes()));
    out.extend(packet);
}

/// A frame as struct can_frame: identifier with flags in network byte order, length, two zeros, DLC
/// if above 8 else 0, data.
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

    /// A file in memory with room for `room` bytes.
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
        Record {
            start,
            end: start + 1,
            bits: 1,
            kind: RecordKind::Frame { frame, from: None, acked: true },
        }
    }

    fn error(kind: ErrorKind) -> Record {
        Record {
            start: 0,
            end: 1,
            bits: 1,
            kind: RecordKind::ErrorFrame { kind: Some(kind), from: None },
        }
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
    fn the_log_of_transfers_has_a_line_for_each_transfer() {
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
            "        - invalid frame 1003F20A#0000000000000020 continues a transfer that did not \
             start",
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
    fn packets_have_flags_for_remote_frames_long_dlcs_and_errors() {
        let packet = |text: &str| socketcan_frame(&text.parse().unwrap());
        assert_eq!(packet("123#R4"), [0x40, 0, 1, 0x23, 4, 0, 0, 0]);
        assert_eq!(packet("7FF#1122334455667788_C")[..8], [0, 0, 7, 0xFF, 8, 0, 0, 12]);
        assert_eq!(
            socketcan_error(Some(ErrorKind::Stuff))[..12],
            [0x20, 0, 0, 8, 8, 0, 0, 0, 0, 0, 4, 0]
        );
        assert_eq!(socketcan_error(Some(ErrorKind::Crc))[8..12], [0, 0, 0, 8]);
        assert_eq!(socketcan_error(Some(ErrorKind::Ack))[..4], [0x20, 0, 0, 0x20]);
    }

    /// A run that is killed must leave its log.
    #[test]
    fn lines_are_in_the_file_after_10_ms() {
        let disk = disk(1000);
        let mut bench = Bench::new(1_000_000);
        let mut log = log(&disk, Format::Candump);
        log.record(&frame(1, "123#01"), None).unwrap();
        bench.run_for_ms(10);
        log.serve(&mut bench).unwrap();
        assert_eq!(*disk.bytes.borrow(), b"(0.000001) can0 123#01\n");
    }

    /// A log with more lines to write than its disk has room for.
    fn log_on_a_full_disk() -> (Log, Bench) {
        let mut log = log(&disk(30), Format::Candump);
        for us in 0..2 {
            log.record(&frame(us, "123#01"), None).unwrap();
        }
        (log, Bench::new(1_000_000))
    }

    #[test]
    fn a_full_disk_is_an_error_that_names_the_file() {
        let (mut log, mut bench) = log_on_a_full_disk();
        let error = log.serve(&mut bench).unwrap_err();
        assert!(format!("{error:#}").starts_with("cannot write run.log: "), "{error:#}");
    }

    #[test]
    fn a_disk_that_is_full_at_the_end_of_the_run_is_an_error() {
        let (mut log, mut bench) = log_on_a_full_disk();
        let error = log.finish(&mut bench).unwrap_err();
        assert!(format!("{error:#}").starts_with("cannot write run.log: "), "{error:#}");
        log.finish(&mut bench).expect("reported once");
    }

    #[test]
    fn an_impossible_path_is_an_error_that_names_it() {
        let Err(error) = Log::create(Path::new("/nonexistent/run.log"), 1_000_000) else {
            panic!("created");
        };
        assert!(
            format!("{error:#}").starts_with("--log: cannot write /nonexistent/run.log: "),
            "{error:#}"
        );
    }
}
