//! The two receive buffers: filling, rollover, overflow, and a log for latency measurements.
//!
//! The protocol engine has the message assembly buffer. A frame goes to the buffer that its filters
//! choose. If RXB0 is full and BUKT is set, it goes to RXB1, whatever RXB1's own filters are. RXB1
//! does not roll over. If no buffer is free, the frame is lost and sets the overflow flag of the
//! last buffer in question (4.2, Figure 4-3).
//!
//! In listen-only mode valid and invalid frames are received, whatever filters, masks and RXM say
//! (10.3). The datasheet does not say to which buffer they go, nor what is in it. In the model they
//! go where RXM = 11 puts them, to RXB0 first. Of a broken frame the part up to the error is loaded
//! (as 4.2.2 has it for RXM = 11), with zeros for the data bytes that are missing. If its control
//! field was not complete, nothing is loaded.
//!
//! Limit: with RXM = 11 the chip also loads the part of a frame before an error; outside of
//! listen-only mode the model loads only valid frames. Data bytes beyond the frame's length keep
//! the previous frame's values; by 4.1.2 the driver must not rely on that.
//!
//! Source: DS20001801J section 4, Registers 4-1 to 4-9, sections 7.6.1 and 10.3.

use std::collections::VecDeque;

use super::filters::{self, Hit, pack_id};
use super::registers::{self, BUFFER_STRIDE, RXB0CTRL, dlc, eflg, int, offset, rxctrl, sidl};
use super::{Mcp2515, Mode};
use can_model::{Frame, Id};
use sim_base::Cycles;

/// An accepted frame, and its result.
#[derive(Clone, Debug)]
pub struct LoggedFrame {
    /// The frame.
    pub frame: Frame,
    /// 0 for RXB0, 1 for RXB1.
    pub buffer: usize,
    /// Time at which it was complete: RXnIF was set, or the frame was lost.
    pub received_at: Cycles,
    /// The result.
    pub fate: Fate,
    /// True if the other buffer was full at `received_at`, too.
    pub other_is_full: bool,
    /// The mode at `received_at`. In listen-only mode the frame may be broken.
    pub mode: Mode,
}

/// How a frame left the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// The driver (or a reset) cleared RXnIF at this time.
    Cleared(Cycles),
    /// The buffer was still full: RXnOVR.
    Lost,
}

/// Logged frames, and the frames now in the buffers.
#[derive(Debug, Default)]
pub(super) struct FrameLog {
    closed: VecDeque<LoggedFrame>,
    held: [Option<LoggedFrame>; 2],
}

impl FrameLog {
    /// Enough for some seconds of a full bus. The oldest entries are dropped if they are not taken.
    const CAPACITY: usize = 65_536;

    fn push(&mut self, entry: LoggedFrame) {
        if self.closed.len() == Self::CAPACITY {
            self.closed.pop_front();
        }
        self.closed.push_back(entry);
    }

    fn close(&mut self, buffer: usize, at: Cycles) {
        if let Some(held) = self.held[buffer].take() {
            self.push(LoggedFrame { fate: Fate::Cleared(at), ..held });
        }
    }

    pub(super) fn take(&mut self) -> Vec<LoggedFrame> {
        std::mem::take(&mut self.closed).into()
    }
}

impl Mcp2515 {
    /// Index of RXBnCTRL in the register file.
    fn rx_control(n: usize) -> usize {
        usize::from(RXB0CTRL) + n * usize::from(BUFFER_STRIDE)
    }

    pub(super) fn is_rx_full(&self, n: usize) -> bool {
        self.registers[usize::from(registers::CANINTF)] & (int::RX0 << n) != 0
    }

    /// Handles a frame that is complete at `at`, or in listen-only mode broken.
    pub(super) fn receive(&mut self, frame: Frame, at: Cycles) {
        let control = [self.registers[Self::rx_control(0)], self.registers[Self::rx_control(1)]];
        let rxm = match self.mode {
            Mode::ListenOnly => [rxctrl::RXM >> rxctrl::RXM_SHIFT; 2],
            _ => control.map(|control| (control & rxctrl::RXM) >> rxctrl::RXM_SHIFT),
        };
        let Some(Hit { buffer, filter }) = filters::accept(&self.registers, rxm, &frame) else {
            return;
        };
        let rolls_over = buffer == 0 && self.is_rx_full(0) && control[0] & rxctrl::BUKT != 0;
        let buffer = if rolls_over { 1 } else { buffer };
        if self.is_rx_full(buffer) {
            self.overflow(frame, buffer, at);
            return;
        }
        self.load(&frame, buffer);
        let remote = if frame.remote { rxctrl::RXRTR } else { 0 };
        let index = Self::rx_control(buffer);
        if buffer == 0 {
            self.rxb0_filter = filter;
            self.registers[index] &= !(rxctrl::RXRTR | rxctrl::FILHIT0);
            self.registers[index] |= remote | filter;
        } else {
            self.registers[index] &= !(rxctrl::RXRTR | rxctrl::FILHIT);
            self.registers[index] |= remote | filter;
        }
        if rolls_over {
            // Register 4-1, note 1: FILHIT0 has the filter of the frame that rolled over.
            let index = Self::rx_control(0);
            self.registers[index] = self.registers[index] & !rxctrl::FILHIT0 | filter;
        }
        self.log.held[buffer] = Some(self.logged(frame, buffer, at));
        self.raise(int::RX0 << buffer);
    }

    fn overflow(&mut self, frame: Frame, buffer: usize, at: Cycles) {
        if self.mode != Mode::ListenOnly {
            self.rx_overflows += 1;
        }
        self.registers[usize::from(registers::EFLG)] |= [eflg::RX0OVR, eflg::RX1OVR][buffer];
        self.raise(int::ERR);
        self.log.push(self.logged(frame, buffer, at));
    }

    /// An entry of the log. Its fate is [`Fate::Lost`] until [`FrameLog::close`] gives it another.
    fn logged(&self, frame: Frame, buffer: usize, at: Cycles) -> LoggedFrame {
        LoggedFrame {
            frame,
            buffer,
            received_at: at,
            fate: Fate::Lost,
            other_is_full: self.is_rx_full(1 - buffer),
            mode: self.mode,
        }
    }

    /// Writes the frame into the registers of a buffer.
    fn load(&mut self, frame: &Frame, buffer: usize) {
        let control = Self::rx_control(buffer);
        let [sidh, mut low, eid8, eid0] = pack_id(frame.id);
        let mut length = frame.dlc & dlc::CODE;
        if frame.remote {
            match frame.id {
                Id::Standard(_) => low |= sidl::SRR,
                Id::Extended(_) => length |= dlc::RTR,
            }
        }
        let mut store = |offset: u8, value: u8| {
            self.registers[control + usize::from(offset)] = value;
        };
        store(offset::SIDH, sidh);
        store(offset::SIDL, low);
        store(offset::EID8, eid8);
        store(offset::EID0, eid0);
        store(offset::DLC, length);
        for (n, &byte) in frame.data().iter().enumerate() {
            store(offset::D0 + n as u8, byte);
        }
    }

    /// A write to RXBnCTRL; `mask` has the bits that it may change.
    pub(super) fn write_rx_control(&mut self, n: usize, value: u8, mask: u8, at: Cycles) {
        let index = Self::rx_control(n);
        let address = index as u8;
        let mask = mask & registers::writable(address);
        self.registers[index] = self.registers[index] & !mask | value & mask;
        if n == 0 {
            let copy = self.registers[index] & rxctrl::BUKT != 0;
            self.registers[index] &= !rxctrl::BUKT1;
            self.registers[index] |= if copy { rxctrl::BUKT1 } else { 0 };
        }
        let rxm = (self.registers[index] & rxctrl::RXM) >> rxctrl::RXM_SHIFT;
        if mask & rxctrl::RXM != 0 && (rxm == 0b01 || rxm == 0b10) {
            self.violation(
                at,
                format!(
                    "RXB{n}CTRL.RXM = {rxm:02b} is reserved (DS20001801J Register 4-{})",
                    n + 1
                ),
            );
        }
    }

    /// RXnIF was cleared.
    pub(super) fn rx_flag_cleared(&mut self, n: usize, at: Cycles) {
        self.log.close(n, at);
    }

    /// The answer to RX STATUS (Figure 12-9).
    pub(super) fn rx_status(&self) -> u8 {
        let Some(n) = (0..2).find(|&n| self.is_rx_full(n)) else {
            return 0;
        };
        let control = Self::rx_control(n);
        let full = u8::from(self.is_rx_full(0)) << 6 | u8::from(self.is_rx_full(1)) << 7;
        let extended = self.registers[control + usize::from(offset::SIDL)] & sidl::EXIDE;
        let remote = self.registers[control] & rxctrl::RXRTR;
        let filter = match n {
            0 => self.rxb0_filter,
            _ => match self.registers[control] & rxctrl::FILHIT {
                rolled_over @ 0..=1 => rolled_over + 6,
                filter => filter,
            },
        };
        full | extended << 1 | remote | filter
    }
}
