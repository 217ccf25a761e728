//! Access to the chip over its SPI, and the steps in which a register may be written.
//!
//! The MCP2515 accepts bit timing, filters and masks in configuration mode only (DS20001801J 10.1).
//! Only [`ConfigurationMode`] can write these registers, and it exists only in the [`Step`]s
//! between a reset and normal mode.

use embedded_hal::digital::OutputPin;
use embedded_hal::spi::SpiBus;

use crate::filters::{sidh, sidl};
use crate::frame::Frame;
use crate::registers::*;
use crate::rx_order::Buffer;
use crate::tx_order::Rank;

/// Number of checks for normal mode, one in each millisecond. The chip waits for eleven recessive
/// bits (10.5), which a busy bus has after every frame.
const NORMAL_MODE_CHECKS: u8 = 50;

/// A step of the start-up.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Step(u8);

impl Step {
    /// Reset the chip. Zero, so that an unconfigured driver is all zero bytes.
    pub const DOWN: Self = Self(0);
    /// Check that the chip is in configuration mode: its oscillator has started after the reset.
    pub const STARTING: Self = Self(1);
    /// Write the register at address 0. The other registers follow.
    const CONFIGURING: Self = Self(2);
    /// Leave configuration mode. The following steps check for normal mode.
    pub const ENTERING: Self = Self(Self::CONFIGURING.0 + CANINTE + 1);
    /// Check for normal mode for the last time.
    pub const LAST_CHECK: Self = Self(Self::ENTERING.0 + NORMAL_MODE_CHECKS);
    /// The chip is on the bus. From this step on the chip runs.
    pub const RUNNING: Self = Self(0x80);
    /// The chip is on the bus and aborts all frames that wait.
    pub const ABORTING: Self = Self(0x81);

    pub fn is_running(self) -> bool {
        self >= Self::RUNNING
    }

    /// The step after this one.
    pub fn next(self) -> Self {
        Self(self.0 + 1)
    }
}

/// Access to the chip between a reset and normal mode.
pub struct ConfigurationMode<'c, SPI, CS> {
    chip: &'c mut Chip<SPI, CS>,
    step: Step,
}

impl<SPI: SpiBus, CS: OutputPin> ConfigurationMode<'_, SPI, CS> {
    /// Returns the register to write in this step: of a filter or a mask, CNF1 to CNF3, or CANINTE.
    /// `None` if all are written.
    pub fn register(&self) -> Option<u8> {
        (self.step != Step::ENTERING).then_some(self.step.0.wrapping_sub(Step::CONFIGURING.0))
    }

    /// Writes the register and reads it back. Returns true if it holds the value.
    pub fn write(&mut self, register: u8, value: u8) -> bool {
        self.chip.access(instruction::WRITE, register, value);
        self.chip.read(register) == value
    }

    /// Returns the next step if the registers after this one are not part of the configuration:
    /// 0x0C to 0x0F, and 0x1C to 0x1F.
    pub fn step_over(self, register: u8) -> Option<Step> {
        (register == 0x0B || register == 0x1B).then_some(Step(self.step.0 + 5))
    }

    /// Requests the mode in `canctrl`. Sets RXB0 to use its filters, and to roll a frame over to
    /// RXB1 if RXB0 is full.
    pub fn leave(self, canctrl: u8) {
        self.chip.access(instruction::WRITE, RXB0CTRL, BUKT);
        self.chip.write_canctrl(canctrl);
    }
}

/// The chip, on its SPI and with its CS pin.
pub struct Chip<SPI, CS> {
    spi: SPI,
    cs: CS,
}

impl<SPI, CS> Chip<SPI, CS> {
    pub const fn new(spi: SPI, cs: CS) -> Self {
        Self { spi, cs }
    }
}

impl<SPI: SpiBus, CS: OutputPin> Chip<SPI, CS> {
    /// Returns access to configuration mode, if the chip is in it at `step`.
    pub fn configuration_mode(&mut self, step: Step) -> Option<ConfigurationMode<'_, SPI, CS>> {
        (Step::CONFIGURING..=Step::ENTERING)
            .contains(&step)
            .then_some(ConfigurationMode { chip: self, step })
    }

    /// Sends RESET.
    pub fn reset(&mut self) {
        self.select();
        self.exchange(instruction::RESET);
        self.deselect();
    }

    /// Sends READ STATUS and returns the answer.
    #[inline(never)]
    pub fn status(&mut self) -> u8 {
        self.select();
        self.exchange_inline(instruction::READ_STATUS);
        let status = self.exchange_inline(0);
        self.deselect();
        status
    }

    /// Reads one register.
    pub fn read(&mut self, register: u8) -> u8 {
        self.access(instruction::READ, register, 0)
    }

    /// Begins a READ of several registers. [`next`](Self::next) reads them, and
    /// [`deselect`](Self::deselect) ends the READ.
    pub fn begin_read(&mut self, register: u8) {
        self.begin(instruction::READ, register);
    }

    /// Reads the next register of a READ.
    #[inline(never)]
    pub fn next(&mut self) -> u8 {
        self.exchange(0)
    }

    /// Writes CANCTRL.
    pub fn write_canctrl(&mut self, value: u8) {
        self.access(instruction::WRITE, CANCTRL, value);
    }

    /// Clears RX0OVR and RX1OVR. The other bits of EFLG are read-only.
    pub fn clear_overflow(&mut self) {
        self.access(instruction::WRITE, EFLG, 0);
    }

    /// Clears ERRIF, and leaves the other flags of CANINTF alone.
    pub fn clear_error_interrupt(&mut self) {
        self.begin(instruction::BIT_MODIFY, CANINTF);
        self.exchange(ERRIF);
        self.exchange(0);
        self.deselect();
    }

    /// Reads a receive buffer with READ RX BUFFER. Stores SIDH, SIDL, EID8 and EID0 in place of the
    /// identifier. Returns RXBnDLC.
    pub fn read_frame(&mut self, buffer: Buffer, frame: &mut Frame) -> u8 {
        self.select();
        // The instruction is 0x90 for RXB0 and 0x94 for RXB1.
        self.exchange_inline(
            instruction::READ_RX_BUFFER | (buffer as u8 & Buffer::Rxb1 as u8) << 1,
        );
        _ = self.spi.read(&mut frame.id);
        let dlc = self.exchange_inline(0);
        frame.len = (dlc & DLC).min(Frame::MAX_LEN as u8);
        if let Some(data) = frame.data.get_mut(..usize::from(frame.len)) {
            _ = self.spi.read(data);
        }
        self.deselect();
        dlc
    }

    /// Writes a transmit buffer, and sends RTS for it.
    pub fn send_frame(&mut self, rank: Rank, frame: &Frame) {
        self.begin_frame(rank, frame);
        self.end_frame(rank, frame);
    }

    /// Writes the priority, identifier and length of a transmit buffer, and ends the instruction.
    pub fn write_identifier(&mut self, rank: Rank, frame: &Frame) {
        self.begin_frame(rank, frame);
        self.deselect();
    }

    /// Writes the data of a transmit buffer with LOAD TX BUFFER, and sends RTS for it.
    pub fn write_data_and_send(&mut self, rank: Rank, frame: &Frame) {
        self.select();
        // The instruction is 0x41, 0x43 and 0x45 for the data of TXB0, TXB1 and TXB2.
        self.exchange(instruction::LOAD_TX_DATA | rank.buffer() & 6);
        self.end_frame(rank, frame);
    }

    fn begin_frame(&mut self, rank: Rank, frame: &Frame) {
        // TXB0, TXB1 and TXB2 are at 0x30, 0x40 and 0x50. The register before the identifier holds
        // the priority.
        self.begin(instruction::WRITE, TXB0CTRL + ((rank.buffer() & 6) << 3));
        self.exchange(rank.priority());
        let [b3, b2, ..] = frame.id;
        self.exchange(sidh(b3, b2));
        self.exchange(sidl(b2));
        self.exchange(frame.id[2]);
        self.exchange(frame.id[3]);
        self.exchange(frame.len);
    }

    fn end_frame(&mut self, rank: Rank, frame: &Frame) {
        // Always eight bytes: the chip sends only the first `len` bytes.
        _ = self.spi.write(&frame.data);
        self.deselect();
        self.select();
        self.exchange(instruction::RTS | rank.buffer());
        self.deselect();
    }

    /// Reads or writes one register. Returns the byte that the chip answers.
    #[inline(never)]
    fn access(&mut self, instruction: u8, register: u8, value: u8) -> u8 {
        self.begin(instruction, register);
        let answer = self.exchange(value);
        self.deselect();
        answer
    }

    /// Begins a READ or WRITE.
    #[inline(never)]
    fn begin(&mut self, instruction: u8, register: u8) {
        self.select();
        self.exchange(instruction);
        self.exchange(register);
    }

    fn select(&mut self) {
        _ = self.cs.set_low();
    }

    /// Ends an instruction, after the SPI has sent all of it.
    pub fn deselect(&mut self) {
        _ = self.spi.flush();
        _ = self.cs.set_high();
    }

    #[inline(never)]
    fn exchange(&mut self, byte: u8) -> u8 {
        self.exchange_inline(byte)
    }

    /// The same where every cycle counts: to receive a frame.
    #[inline(always)]
    fn exchange_inline(&mut self, byte: u8) -> u8 {
        let mut bytes = [byte];
        _ = self.spi.transfer_in_place(&mut bytes);
        bytes[0]
    }
}
