//! The instructions of the chip, a chip alone on its bus, and the steps in which a register may be
//! written.
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
    /// The chip listens to a bus of another bit rate, and sends nothing.
    pub const LISTENING: Self = Self(0x7F);
    /// The chip is on the bus. From this step on the chip runs.
    pub const RUNNING: Self = Self(0x80);

    pub fn is_running(self) -> bool {
        self == Self::RUNNING
    }

    /// The step after this one.
    pub fn next(self) -> Self {
        Self(self.0 + 1)
    }
}

/// Access to the chip between a reset and normal mode.
pub struct ConfigurationMode<'c, C> {
    chip: &'c mut C,
    step: Step,
}

impl<C: Instructions> ConfigurationMode<'_, C> {
    /// Returns the register to write in this step: of a filter or a mask, CNF1 to CNF3, or CANINTE.
    /// `None` if all are written.
    pub fn register(&self) -> Option<u8> {
        (self.step != Step::ENTERING).then_some(self.step.0.wrapping_sub(Step::CONFIGURING.0))
    }

    /// Writes the register and reads it back. Returns true if it holds the value.
    pub fn write(&mut self, register: u8, value: u8) -> bool {
        self.chip.write(register, value);
        self.chip.read(register) == value
    }

    /// Returns the next step if the registers after this one are not part of the configuration:
    /// 0x0C to 0x0F, and 0x1C to 0x1F.
    pub fn step_over(self, register: u8) -> Option<Step> {
        (register == 0x0B || register == 0x1B).then_some(Step(self.step.0 + 5))
    }

    /// Sets RXB0 to use its filters, and to roll a frame over to RXB1 if RXB0 is full. Then the
    /// chip may leave the mode.
    pub fn finish(self) {
        self.chip.write(RXB0CTRL, BUKT);
    }
}

/// The instructions of the chip. [`Exclusive`](crate::Exclusive) sends them on a bus of the chip's
/// own, and [`Shared`](crate::Shared) on a bus with other devices. No other type can implement the
/// trait.
pub trait Instructions: Sized {
    /// Sends RESET.
    fn reset(&mut self);

    /// Sends READ STATUS and returns the answer.
    fn status(&mut self) -> u8;

    /// Reads one register.
    fn read(&mut self, register: u8) -> u8;

    /// Writes one register.
    fn write(&mut self, register: u8, value: u8);

    /// Begins a READ of at most eight registers. [`read_next`](Self::read_next) returns each of
    /// them, and [`end_read`](Self::end_read) ends the READ.
    fn begin_read(&mut self, register: u8);

    /// Returns the next register of a READ.
    fn read_next(&mut self) -> u8;

    /// Ends a READ.
    fn end_read(&mut self);

    /// Reads a receive buffer with READ RX BUFFER. Stores SIDH, SIDL, EID8 and EID0 in place of the
    /// identifier. Returns RXBnDLC.
    fn read_frame(&mut self, buffer: Buffer, frame: &mut Frame) -> u8;

    /// Writes a transmit buffer, and sends RTS for it.
    fn send_frame(&mut self, rank: Rank, frame: &Frame);

    /// Writes the priority, identifier and length of a transmit buffer, and ends the instruction.
    fn write_identifier(&mut self, rank: Rank, frame: &Frame);

    /// Writes the data of a transmit buffer with LOAD TX BUFFER, and sends RTS for it.
    fn write_data_and_send(&mut self, rank: Rank, frame: &Frame);

    /// Writes a transmit buffer with SIDH, SIDL, EID8 and EID0, which are in place of the
    /// identifier, and DLC. Sends RTS for it.
    fn send_raw(&mut self, rank: Rank, frame: &Frame, dlc: u8);

    /// Writes CANCTRL.
    fn write_canctrl(&mut self, value: u8);

    /// Clears RX0OVR and RX1OVR. The other bits of EFLG are read-only.
    fn clear_overflow(&mut self);

    /// Clears ERRIF and the three TXnIF, and leaves the other flags of CANINTF alone.
    fn clear_interrupts(&mut self);

    /// Returns the flags of CANINTF and clears them; if MERRF is among them, both RXnIF, too.
    fn take_interrupts(&mut self) -> u8;

    /// Returns access to configuration mode, if the chip is in it at `step`.
    fn configuration_mode(&mut self, step: Step) -> Option<ConfigurationMode<'_, Self>> {
        (Step::CONFIGURING..=Step::ENTERING)
            .contains(&step)
            .then_some(ConfigurationMode { chip: self, step })
    }
}

/// A chip on an SPI bus of its own, and its CS pin. It reads only the bytes that a frame has.
pub struct Exclusive<SPI, CS> {
    spi: SPI,
    cs: CS,
}

impl<SPI, CS> Exclusive<SPI, CS> {
    pub(crate) const fn new(spi: SPI, cs: CS) -> Self {
        Self { spi, cs }
    }
}

impl<SPI: SpiBus, CS: OutputPin> Exclusive<SPI, CS> {
    /// Sends RESET.
    fn reset(&mut self) {
        self.select();
        self.exchange(instruction::RESET);
        self.deselect();
    }

    /// Sends READ STATUS and returns the answer.
    #[inline(never)]
    fn status(&mut self) -> u8 {
        self.select();
        self.exchange_inline(instruction::READ_STATUS);
        let status = self.exchange_inline(0);
        self.deselect();
        status
    }

    /// Reads one register.
    fn read(&mut self, register: u8) -> u8 {
        self.access(instruction::READ, register, 0)
    }

    /// Begins a READ of several registers. [`read_next`](Self::read_next) reads them, and
    /// [`deselect`](Self::deselect) ends the READ.
    fn begin_read(&mut self, register: u8) {
        self.begin(instruction::READ, register);
    }

    /// Reads the next register of a READ.
    #[inline(never)]
    fn read_next(&mut self) -> u8 {
        self.exchange(0)
    }

    /// Writes CANCTRL.
    fn write_canctrl(&mut self, value: u8) {
        self.access(instruction::WRITE, CANCTRL, value);
    }

    /// Clears RX0OVR and RX1OVR. The other bits of EFLG are read-only.
    fn clear_overflow(&mut self) {
        self.access(instruction::WRITE, EFLG, 0);
    }

    /// Clears ERRIF and the three TXnIF, and leaves the other flags of CANINTF alone.
    fn clear_interrupts(&mut self) {
        self.clear(ERRIF | TXIF);
    }

    /// Returns the flags of CANINTF, and clears those that [`taken`] names.
    fn take_interrupts(&mut self) -> u8 {
        let flags = self.read(CANINTF);
        self.clear(taken(flags));
        flags
    }

    /// Clears flags of CANINTF.
    fn clear(&mut self, flags: u8) {
        self.begin(instruction::BIT_MODIFY, CANINTF);
        self.exchange(flags);
        self.exchange(0);
        self.deselect();
    }

    /// Reads a receive buffer with READ RX BUFFER. Stores SIDH, SIDL, EID8 and EID0 in place of the
    /// identifier. Returns RXBnDLC.
    fn read_frame(&mut self, buffer: Buffer, frame: &mut Frame) -> u8 {
        self.select();
        self.exchange_inline(read_rx_buffer(buffer));
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
    fn send_frame(&mut self, rank: Rank, frame: &Frame) {
        self.begin_frame(rank, frame);
        self.end_frame(rank, frame);
    }

    /// Writes the priority, identifier and length of a transmit buffer, and ends the instruction.
    fn write_identifier(&mut self, rank: Rank, frame: &Frame) {
        self.begin_frame(rank, frame);
        self.deselect();
    }

    /// Writes the data of a transmit buffer with LOAD TX BUFFER, and sends RTS for it.
    fn write_data_and_send(&mut self, rank: Rank, frame: &Frame) {
        self.select();
        self.exchange(load_tx_data(rank));
        self.end_frame(rank, frame);
    }

    fn begin_frame(&mut self, rank: Rank, frame: &Frame) {
        self.begin(instruction::WRITE, tx_buffer(rank));
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
    fn deselect(&mut self) {
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

/// Each method calls the one of the same name above.
impl<SPI: SpiBus, CS: OutputPin> Instructions for Exclusive<SPI, CS> {
    fn reset(&mut self) {
        Self::reset(self);
    }

    fn status(&mut self) -> u8 {
        Self::status(self)
    }

    fn read(&mut self, register: u8) -> u8 {
        Self::read(self, register)
    }

    #[inline(always)]
    fn write(&mut self, register: u8, value: u8) {
        self.access(instruction::WRITE, register, value);
    }

    fn begin_read(&mut self, register: u8) {
        Self::begin_read(self, register);
    }

    fn read_next(&mut self) -> u8 {
        Self::read_next(self)
    }

    fn end_read(&mut self) {
        self.deselect();
    }

    fn write_canctrl(&mut self, value: u8) {
        Self::write_canctrl(self, value);
    }

    fn clear_overflow(&mut self) {
        Self::clear_overflow(self);
    }

    fn clear_interrupts(&mut self) {
        Self::clear_interrupts(self);
    }

    fn take_interrupts(&mut self) -> u8 {
        Self::take_interrupts(self)
    }

    fn read_frame(&mut self, buffer: Buffer, frame: &mut Frame) -> u8 {
        Self::read_frame(self, buffer, frame)
    }

    fn send_frame(&mut self, rank: Rank, frame: &Frame) {
        Self::send_frame(self, rank, frame);
    }

    fn write_identifier(&mut self, rank: Rank, frame: &Frame) {
        Self::write_identifier(self, rank, frame);
    }

    fn write_data_and_send(&mut self, rank: Rank, frame: &Frame) {
        Self::write_data_and_send(self, rank, frame);
    }

    fn send_raw(&mut self, rank: Rank, frame: &Frame, dlc: u8) {
        self.begin(instruction::WRITE, tx_buffer(rank));
        self.exchange(rank.priority());
        _ = self.spi.write(&frame.id);
        self.exchange(dlc);
        self.end_frame(rank, frame);
    }
}

/// The address of a transmit buffer: 0x30, 0x40, 0x50 for TXB0, TXB1, TXB2. The register there
/// holds the priority, and the identifier follows.
pub fn tx_buffer(rank: Rank) -> u8 {
    TXB0CTRL + ((rank.buffer() & 6) << 3)
}

/// READ RX BUFFER: 0x90 for RXB0 and 0x94 for RXB1.
pub fn read_rx_buffer(buffer: Buffer) -> u8 {
    instruction::READ_RX_BUFFER | (buffer as u8 & Buffer::Rxb1 as u8) << 1
}

/// The flags of CANINTF that are cleared if these were read: the same, and none that was set
/// meanwhile. But MERRF takes both RXnIF with it: a broken frame that came meanwhile has set MERRF
/// again, and without it would look like a valid one.
pub fn taken(flags: u8) -> u8 {
    if flags & MERRF == 0 { flags } else { flags | RX1IF | RX0IF }
}

/// LOAD TX BUFFER for the data: 0x41, 0x43 and 0x45 for TXB0, TXB1 and TXB2.
pub fn load_tx_data(rank: Rank) -> u8 {
    instruction::LOAD_TX_DATA | rank.buffer() & 6
}
