//! A meter of what a received frame costs, by the SPI and by the log of the CAN controller.

use std::collections::VecDeque;

use bench::Cycles;
use bench::board::{Board, WireEvent};
use bench::can::Frame;
use bench::mcp2515::{Fate, Mode};

/// Address of CANINTF.
pub(super) const CANINTF: u8 = 0x2C;

/// Values of which the median and the maximum are reported.
#[derive(Clone, Debug, Default)]
pub struct Samples {
    values: Vec<u32>,
}

impl Samples {
    pub fn push(&mut self, value: Cycles) {
        self.values.push(u32::try_from(value).unwrap_or(u32::MAX));
    }

    pub fn values(&self) -> &[u32] {
        &self.values
    }

    /// The value that `percent` of the samples do not exceed; 0 without samples.
    pub fn percentile(&self, percent: usize) -> u32 {
        let mut sorted = self.values.clone();
        let at = (sorted.len() * percent).div_ceil(100).saturating_sub(1);
        if sorted.is_empty() { 0 } else { *sorted.select_nth_unstable(at).1 }
    }

    pub fn median(&self) -> u32 {
        self.percentile(50)
    }

    pub fn max(&self) -> u32 {
        self.values.iter().copied().max().unwrap_or(0)
    }
}

/// One SPI instruction, from chip select low to high.
#[derive(Clone, Debug, Default)]
struct Instruction {
    start: Cycles,
    end: Cycles,
    mosi: Vec<u8>,
    miso: Vec<u8>,
}

/// Why the driver sends an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Purpose {
    /// To check for a received frame.
    Check,
    /// To read or release a frame.
    Read,
    /// To send a frame.
    Send,
    Other,
}

impl Instruction {
    /// The purpose, by the instruction byte (DS20001801J table 12-1).
    fn purpose(&self) -> Purpose {
        match self.mosi[..] {
            [0xA0 | 0xB0, ..] | [0x03, CANINTF, ..] => Purpose::Check,
            [0x90..=0x96, ..] | [0x03, 0x60..=0x7F, ..] | [0x02 | 0x05, CANINTF, ..] => {
                Purpose::Read
            }
            [0x40..=0x45 | 0x80..=0x87, ..] | [0x02 | 0x05, 0x30..=0x5F, ..] => Purpose::Send,
            _ => Purpose::Other,
        }
    }

    /// The frame that READ RX BUFFER returned, if it was read from its first byte.
    fn frame_read(&self) -> Option<Frame> {
        let ([0x90 | 0x94, ..], [_, sidh, sidl, eid8, eid0, dlc, data @ ..]) =
            (&self.mosi[..], &self.miso[..])
        else {
            return None;
        };
        let standard = u32::from(*sidh) << 3 | u32::from(sidl >> 5);
        let id = standard << 18
            | u32::from(sidl & 0b11) << 16
            | u32::from(*eid8) << 8
            | u32::from(*eid0);
        let length = usize::from(dlc & 0x0F).min(8);
        Some(Frame::extended(id, data.get(..length)?))
    }
}

/// Longest pause, in cycles, between the check and the first byte of the frame that counts as
/// service. After a longer one the driver had checked ahead, while the program handled the frame
/// before.
const PAUSE: Cycles = 300;

/// Measures how a driver reads the frames that its controller receives, except in listen-only mode.
#[derive(Default)]
pub struct Meter {
    open: Option<Instruction>,
    check: Option<(Cycles, Cycles, usize)>,
    reads: Vec<Instruction>,
    newest_received_at: Cycles,
    /// Number of frames read and released.
    pub frames: u64,
    /// Number of frames lost because both buffers were full.
    pub lost: u64,
    /// Times at which they were complete.
    pub lost_at: Vec<Cycles>,
    /// Number of frames released before an older one.
    pub out_of_order: u64,
    /// Number of frames read with other contents than on the bus.
    pub garbled: u64,
    /// Cycles from the chip select of the check that saw the frame to the release of its buffer.
    pub service: Samples,
    /// Cycles from the end of the frame to the release of its buffer.
    pub latency: Samples,
    /// Number of chip selects for a frame.
    pub selects: Samples,
    /// Number of SPI bytes for a frame, without its data bytes.
    pub overhead: Samples,
    /// Number of SPI bytes to read or release frames.
    pub fetched_bytes: u64,
}

impl Meter {
    /// Starts to measure now.
    pub fn attach(board: &mut Board) -> Meter {
        board.attach_probe();
        board.take_wire_events();
        Meter::attach_to_log(board)
    }

    /// Starts to measure now without the SPI: the frames, those lost, and the latency.
    pub fn attach_to_log(board: &mut Board) -> Meter {
        board.chip().borrow_mut().take_frame_log();
        Meter::default()
    }

    /// Evaluates what happened since the last call.
    pub fn collect(&mut self, board: &mut Board) {
        let log = board.chip().borrow_mut().take_frame_log();
        let mut releases: VecDeque<(Cycles, Cycles, Frame)> = VecDeque::new();
        // The driver throws away what it hears in listen-only mode, of which much is broken.
        for entry in log.into_iter().filter(|entry| entry.mode != Mode::ListenOnly) {
            match entry.fate {
                Fate::Lost => {
                    self.lost += 1;
                    self.lost_at.push(entry.received_at);
                }
                Fate::Cleared(at) => {
                    self.frames += 1;
                    self.latency.push(at - entry.received_at);
                    if entry.received_at < self.newest_received_at {
                        self.out_of_order += 1;
                    }
                    self.newest_received_at = entry.received_at;
                    releases.push_back((at, entry.received_at, entry.frame));
                }
            }
        }
        for (at, event) in board.take_wire_events() {
            match event {
                WireEvent::Cs(false) => {
                    self.open = Some(Instruction { start: at, ..Instruction::default() })
                }
                WireEvent::Spi { byte, miso } => {
                    if let Some(open) = &mut self.open {
                        open.mosi.push(byte.mosi);
                        open.miso.push(miso);
                    }
                }
                WireEvent::Cs(true) => {
                    if let Some(mut instruction) = self.open.take() {
                        instruction.end = at;
                        self.instruction(instruction, &mut releases);
                    }
                }
                _ => {}
            }
        }
    }

    fn instruction(
        &mut self,
        instruction: Instruction,
        releases: &mut VecDeque<(Cycles, Cycles, Frame)>,
    ) {
        match instruction.purpose() {
            Purpose::Check => {
                self.check = Some((instruction.start, instruction.end, instruction.mosi.len()));
                self.reads.clear();
            }
            Purpose::Read => {
                self.fetched_bytes += instruction.mosi.len() as u64;
                self.reads.push(instruction);
            }
            // The status check was for a transmit buffer.
            Purpose::Send => self.check = None,
            Purpose::Other => {}
        }
        let Some(last) = self.reads.last() else { return };
        if releases.front().is_none_or(|&(at, ..)| at > last.end) {
            return;
        }
        let (at, _, frame) = releases.pop_front().expect("a release");
        let read = self.reads.iter().find_map(Instruction::frame_read);
        self.garbled += u64::from(read.is_some_and(|read| read != frame));
        let first = self.reads[0].start;
        let begun = match self.check {
            Some((start, end, _)) if first.saturating_sub(end) <= PAUSE => start,
            Some((start, end, _)) => first - (end - start),
            None => first,
        };
        self.service.push(at - begun);
        let bytes = self.reads.iter().map(|read| read.mosi.len()).sum::<usize>()
            + self.check.map_or(0, |check| check.2);
        self.overhead.push((bytes - frame.data().len()) as Cycles);
        self.selects.push((self.reads.len() + usize::from(self.check.is_some())) as Cycles);
        self.check = None;
        self.reads.clear();
    }
}
