//! The log of the bus in a file: pcap if its name ends in .pcap, decoded transfers if it ends in
//! .txt, else candump text. [`bench::bus_log`] has these forms. The status line has the number of
//! error frames that candump text leaves out.

use super::Link;
use anyhow::{Context, Result};
use bench::Bench;
use bench::bus_log::{BusLog, Format};
use bench::can::{Record, RecordKind};
use bench::{Cycles, F_CPU_HZ};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The log writes to the file when it has this many bytes, or after `WRITE_PERIOD`. It writes whole
/// lines, so that the file of a run that is killed can be read.
const WRITE_SIZE: usize = 64 * 1024;
const WRITE_PERIOD: Cycles = F_CPU_HZ / 100;

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
    log: BusLog,
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
        let (bus_log, text) = BusLog::new(format);
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
            log: bus_log,
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
        self.log.add(record, &mut self.text);
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

#[cfg(test)]
mod tests {
    use super::*;
    use bench::can::ErrorKind;
    use std::cell::RefCell;
    use std::io;
    use std::rc::Rc;

    const CYCLES_PER_US: u64 = F_CPU_HZ / 1_000_000;

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
        let start = start_us * CYCLES_PER_US;
        let kind = RecordKind::Frame { frame: text.parse().unwrap(), from: None, acked: true };
        Record { start, end: start + 1, bits: 1, kind }
    }

    /// A log of frames, each with its microseconds, and of an error frame.
    fn log_of(disk: &Disk, format: Format, frames: &[(u64, &str)]) -> Log {
        let mut log = log(disk, format);
        for (us, text) in frames {
            log.record(&frame(*us, text), None).unwrap();
        }
        let kind = RecordKind::ErrorFrame { kind: Some(ErrorKind::Stuff), from: None };
        log.record(&Record { start: 0, end: 1, bits: 1, kind }, None).unwrap();
        log
    }

    #[test]
    fn a_line_has_time_interface_and_frame() {
        let disk = disk(1000);
        let frames = [
            (2_512_352, "1404562A#0100A95C00C0"),
            (61_000_001, "123#R4"),
            (61_000_500, "7FF#"),
            (61_000_700, "7FF#1122334455667788_C"),
        ];
        let log = log_of(&disk, Format::Candump, &frames);
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
        let frames = [
            (100, "1E0BF8FF#4D0D00014C040084"),
            (300, "1E0BF8FF#0000000000535224"),
            (500, "1E0BF8FF#565F4D494E44"),
            (700, "123#01"),
            (900, "1003F20A#0000000000000020"),
            (950, "17C40409#5A"),
        ];
        drop(log_of(&disk, Format::Transfers, &frames));
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

    #[test]
    fn a_full_disk_is_an_error_that_names_the_file_also_at_the_end_of_the_run() {
        let two = [(0, "123#01"), (1, "123#01")];
        let mut bench = Bench::new(1_000_000);
        for at_end in [false, true] {
            let mut log = log_of(&disk(30), Format::Candump, &two);
            let result = if at_end { log.finish(&mut bench) } else { log.serve(&mut bench) };
            let error = format!("{:#}", result.unwrap_err());
            assert!(error.starts_with("cannot write run.log: "), "{at_end}: {error}");
            log.finish(&mut bench).expect("reported once");
        }
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
