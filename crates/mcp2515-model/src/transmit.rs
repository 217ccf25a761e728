//! The three transmit buffers: request, selection, result, abort.
//!
//! Goals: before each start of frame the pending buffer with the highest TXP is selected, and with
//! equal TXP the one with the highest number (3.2). A request has no effect on the bus before its
//! SPI byte ends.
//!
//! Assumptions: the engine copies the frame that it begins to send, and reports exactly one result
//! for it: transmitted, arbitration lost, or error.
//!
//! Invariants: TXREQ is set if and only if the buffer has a frame to send. The frame does not
//! change while TXREQ is set, because the model ignores writes to the buffer until TXREQ is clear,
//! which the driver must wait for (3.1).
//!
//! A request takes effect at the end of its SPI byte: the RTS instruction itself, or the
//! data byte of a WRITE or BIT MODIFY to TXBnCTRL. A request clears ABTF, MLOA and TXERR;
//! automatic repetitions do not.
//!
//! Source: DS20001801J section 3, Register 3-1, Figure 3-1. Not modelled: the TXnRTS pins, and
//! erratum 5 of the errata DS80179 (CS held low for the length of a whole frame repeats the frame).

use super::Mcp2515;
use super::filters::unpack_id;
use super::registers::{self, BUFFER_STRIDE, TXB0CTRL, canctrl, dlc, int, offset, txctrl};
use can_model::Frame;
use sim_base::Cycles;

/// State of a buffer besides its registers.
#[derive(Clone, Debug, Default)]
pub(super) struct TxState {
    /// The frame, while TXREQ is set.
    frame: Option<Frame>,
    /// End of the SPI byte that set TXREQ.
    requested_at: Cycles,
    /// The flag of a request that was withdrawn while its frame was on the bus.
    withdrawn: Option<Withdrawal>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Withdrawal {
    /// TXREQ was cleared: no flag.
    Request,
    /// CANCTRL.ABAT was set: sets ABTF.
    AbortAll,
}

impl TxState {
    /// The frame to send, while TXREQ is set.
    pub(super) fn frame(&self) -> Option<&Frame> {
        self.frame.as_ref()
    }
}

/// Why an attempt to send failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Failure {
    LostArbitration,
    BusError,
}

impl Mcp2515 {
    /// Index of TXBnCTRL in the register file.
    fn tx_control(n: usize) -> usize {
        usize::from(TXB0CTRL) + n * usize::from(BUFFER_STRIDE)
    }

    pub(super) fn is_tx_requested(&self, n: usize) -> bool {
        self.registers[Self::tx_control(n)] & txctrl::TXREQ != 0
    }

    pub(super) fn has_tx_request(&self) -> bool {
        self.tx.iter().any(|tx| tx.frame.is_some())
    }

    /// A write to TXBnCTRL; `mask` has the bits that it may change.
    pub(super) fn write_tx_control(&mut self, n: usize, value: u8, mask: u8, at: Cycles) {
        let index = Self::tx_control(n);
        let kept = mask & txctrl::TXP;
        self.registers[index] = self.registers[index] & !kept | value & kept;
        if mask & txctrl::TXREQ == 0 {
            return;
        }
        if value & txctrl::TXREQ != 0 {
            self.request_to_send(n, at);
        } else {
            self.withdraw(n, Withdrawal::Request);
        }
    }

    pub(super) fn request_to_send(&mut self, n: usize, at: Cycles) {
        let index = Self::tx_control(n);
        let pending = self.is_tx_requested(n);
        self.registers[index] &= !(txctrl::ABTF | txctrl::MLOA | txctrl::TXERR);
        self.registers[index] |= txctrl::TXREQ;
        if pending {
            self.tx[n].withdrawn = None;
        } else {
            let frame = self.tx_frame(n);
            self.tx[n] = TxState { frame: Some(frame), requested_at: at, withdrawn: None };
        }
        if self.registers[usize::from(registers::CANCTRL)] & canctrl::ABAT != 0 {
            self.violation(
                at,
                format!(
                    "TXB{n}CTRL.TXREQ set while CANCTRL.ABAT is set: aborted at once (DS20001801J \
                     3.6)"
                ),
            );
            self.withdraw(n, Withdrawal::AbortAll);
        }
    }

    /// CANCTRL.ABAT was set: aborts all pending transmissions.
    pub(super) fn abort_all(&mut self) {
        for n in 0..self.tx.len() {
            self.withdraw(n, Withdrawal::AbortAll);
        }
    }

    /// Ends a request now, or after the current attempt if its frame is on the bus (3.6).
    fn withdraw(&mut self, n: usize, how: Withdrawal) {
        if !self.is_tx_requested(n) {
            return;
        }
        if self.in_flight == Some(n) {
            self.tx[n].withdrawn = Some(how);
        } else {
            self.finish(n);
            if how == Withdrawal::AbortAll {
                self.registers[Self::tx_control(n)] |= txctrl::ABTF;
            }
        }
    }

    fn finish(&mut self, n: usize) {
        self.registers[Self::tx_control(n)] &= !txctrl::TXREQ;
        self.tx[n] = TxState::default();
    }

    /// The frame in the registers of the buffer.
    fn tx_frame(&self, n: usize) -> Frame {
        let control = Self::tx_control(n);
        let at = |offset: u8| self.registers[control + usize::from(offset)];
        let id =
            unpack_id([at(offset::SIDH), at(offset::SIDL), at(offset::EID8), at(offset::EID0)]);
        let code = at(offset::DLC) & dlc::CODE;
        if at(offset::DLC) & dlc::RTR != 0 {
            return Frame::remote(id, code);
        }
        let data = std::array::from_fn(|n| at(offset::D0 + n as u8));
        Frame::with_dlc(id, code, data)
    }

    /// The buffer whose frame is sent next, of those requested no later than `at`.
    pub(super) fn next_to_send(&self, at: Cycles) -> Option<usize> {
        (0..self.tx.len())
            .filter(|&n| self.tx[n].frame.is_some() && self.tx[n].requested_at <= at)
            .max_by_key(|&n| (self.registers[Self::tx_control(n)] & txctrl::TXP, n))
    }

    /// The frame on the bus was sent successfully.
    pub(super) fn tx_succeeded(&mut self) {
        if let Some(n) = self.in_flight.take() {
            self.finish(n);
            self.raise(int::TX0 << n);
        }
    }

    /// The frame on the bus failed. The buffer keeps its request for another attempt, unless
    /// the request was withdrawn or the chip is in one-shot mode.
    pub(super) fn tx_failed(&mut self, why: Failure) {
        let Some(n) = self.in_flight.take() else {
            return;
        };
        let control = Self::tx_control(n);
        self.registers[control] |= match why {
            Failure::LostArbitration => txctrl::MLOA,
            Failure::BusError => txctrl::TXERR,
        };
        let one_shot = self.registers[usize::from(registers::CANCTRL)] & canctrl::OSM != 0;
        // 3.6, note 2: in one-shot mode ABTF is set for a frame that failed on the bus, too.
        if one_shot || self.tx[n].withdrawn == Some(Withdrawal::AbortAll) {
            self.registers[control] |= txctrl::ABTF;
        }
        if one_shot || self.tx[n].withdrawn.is_some() {
            self.finish(n);
        }
    }

    /// A reset: drops all requests, and aborts the frame on the bus.
    pub(super) fn reset_transmit(&mut self) {
        self.tx = Default::default();
        self.in_flight = None;
    }
}
