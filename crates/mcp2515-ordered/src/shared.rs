//! A chip on an SPI bus with other devices: each instruction is one transaction.

use embedded_hal::spi::SpiDevice;

use crate::chip::{Instructions, load_tx_data, read_rx_buffer, taken, tx_buffer};
use crate::filters::{sidh, sidl};
use crate::frame::Frame;
use crate::registers::*;
use crate::rx_order::Buffer;
use crate::tx_order::Rank;

/// The number of registers that one READ takes: from CNF3 to CANCTRL.
const READ_LEN: usize = 8;

/// A chip on an SPI bus with other devices. It reads eight data bytes of each frame, because a
/// transaction cannot depend on the length that it reads.
pub struct Shared<D> {
    device: D,
    /// The registers of the READ in progress.
    registers: [u8; READ_LEN],
    /// The index of the next register to return.
    next: u8,
}

impl<D> Shared<D> {
    pub(crate) const fn new(device: D) -> Self {
        Self { device, registers: [0; READ_LEN], next: 0 }
    }
}

impl<D: SpiDevice> Instructions for Shared<D> {
    fn reset(&mut self) {
        self.exchange([instruction::RESET]);
    }

    fn status(&mut self) -> u8 {
        let [_, status] = self.exchange([instruction::READ_STATUS, 0]);
        status
    }

    fn read(&mut self, register: u8) -> u8 {
        let [_, _, value] = self.exchange([instruction::READ, register, 0]);
        value
    }

    fn write(&mut self, register: u8, value: u8) {
        self.exchange([instruction::WRITE, register, value]);
    }

    /// Reads all eight registers, so that all values are of the same time.
    fn begin_read(&mut self, register: u8) {
        let mut bytes = [0; 2 + READ_LEN];
        bytes[..2].copy_from_slice(&[instruction::READ, register]);
        let [_, _, registers @ ..] = self.exchange(bytes);
        self.registers = registers;
        self.next = 0;
    }

    fn read_next(&mut self) -> u8 {
        let value = self.registers.get(usize::from(self.next)).copied().unwrap_or(0);
        self.next += 1;
        value
    }

    fn end_read(&mut self) {}

    fn read_frame(&mut self, buffer: Buffer, frame: &mut Frame) -> u8 {
        let mut bytes = [0; 6 + Frame::MAX_LEN];
        bytes[0] = read_rx_buffer(buffer);
        let [_, sidh, sidl, eid8, eid0, dlc, data @ ..] = self.exchange(bytes);
        *frame = Frame {
            len: (dlc & DLC).min(Frame::MAX_LEN as u8),
            id: [sidh, sidl, eid8, eid0],
            data,
        };
        dlc
    }

    fn send_frame(&mut self, rank: Rank, frame: &Frame) {
        let [b3, b2, b1, b0] = frame.id;
        let registers = Frame { id: [sidh(b3, b2), sidl(b2), b1, b0], ..*frame };
        self.send_raw(rank, &registers, frame.len);
    }

    fn write_identifier(&mut self, rank: Rank, frame: &Frame) {
        let [b3, b2, b1, b0] = frame.id;
        let (begin, txp) = (tx_buffer(rank), rank.priority());
        let (sidh, sidl) = (sidh(b3, b2), sidl(b2));
        self.exchange([instruction::WRITE, begin, txp, sidh, sidl, b1, b0, frame.len]);
    }

    fn write_data_and_send(&mut self, rank: Rank, frame: &Frame) {
        let [d0, d1, d2, d3, d4, d5, d6, d7] = frame.data;
        self.exchange([load_tx_data(rank), d0, d1, d2, d3, d4, d5, d6, d7]);
        self.exchange([instruction::RTS | rank.buffer()]);
    }

    fn send_raw(&mut self, rank: Rank, frame: &Frame, dlc: u8) {
        let [sidh, sidl, eid8, eid0] = frame.id;
        let [d0, d1, d2, d3, d4, d5, d6, d7] = frame.data;
        let (begin, txp) = (tx_buffer(rank), rank.priority());
        self.exchange([
            instruction::WRITE,
            begin,
            txp,
            sidh,
            sidl,
            eid8,
            eid0,
            dlc,
            d0,
            d1,
            d2,
            d3,
            d4,
            d5,
            d6,
            d7,
        ]);
        self.exchange([instruction::RTS | rank.buffer()]);
    }

    fn write_canctrl(&mut self, value: u8) {
        self.write(CANCTRL, value);
    }

    fn clear_overflow(&mut self) {
        self.write(EFLG, 0);
    }

    fn clear_interrupts(&mut self) {
        self.exchange([instruction::BIT_MODIFY, CANINTF, ERRIF | TXIF, 0]);
    }

    fn take_interrupts(&mut self) -> u8 {
        let flags = self.read(CANINTF);
        self.exchange([instruction::BIT_MODIFY, CANINTF, taken(flags), 0]);
        flags
    }
}

impl<D: SpiDevice> Shared<D> {
    /// Exchanges the bytes of an instruction, and returns those that the chip answers.
    fn exchange<const N: usize>(&mut self, mut bytes: [u8; N]) -> [u8; N] {
        _ = self.device.transfer_in_place(&mut bytes);
        bytes
    }
}
