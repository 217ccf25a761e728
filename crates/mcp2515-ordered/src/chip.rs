//! The chip on its SPI, and what may be written to it when.
//!
//! The MCP2515 takes bit timing, filters and masks in configuration mode only (DS20001801J 10.1). [`ConfigurationMode`] is the only way to
//! write these registers, and exists only in the [`Step`]s between a reset and normal mode.

use embedded_hal::digital::OutputPin;
use embedded_hal::spi::SpiBus;

use crate::filters::{sidh, sidl};
use crate::frame::Frame;
use crate::registers::*;
use crate::rx_order::Buffer;
use crate::tx_order::Rank;

/// How often to check for normal mode, once a millisecond. The chip waits for eleven recessive bits (10.5), which a busy bus offers after
/// every frame.
const NORMAL_MODE_CHECKS: u8 = 50;

/// A step on the way to the bus.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Step(u8);

impl Step {
    /// To be reset. Zero, so that an unconfigured driver is all zero bytes.
    pub const DOWN: Self = Self(0);
    /// Reset; its oscillator starts.
    pub const STARTING: Self = Self(1);
    /// The register at address 0 is to be written. The others follow.
    const CONFIGURING: Self = Self(2);
    /// To leave configuration mode. The following steps check for normal mode.
    pub const ENTERING: Self = Self(Self::CONFIGURING.0 + CANINTE + 1);
    /// The last check.
    pub const LAST_CHECK: Self = Self(Self::ENTERING.0 + NORMAL_MODE_CHECKS);
    /// On the bus. From here on the chip runs.
    pub const RUNNING: Self = Self(0x80);
    /// On the bus, with frames being given up.
    pub const ABORTING: Self = Self(0x81);

    #[inline(always)]
    pub fn is_running(self) -> bool {
        self >= Self::RUNNING
    }

    /// The step after this one.
    #[inline(always)]
    pub fn next(self) -> Self {
        Self(self.0 + 1)
    }
}

/// The chip between a reset and normal mode.
pub struct ConfigurationMode<'c, SPI, CS> {
    chip: &'c mut Chip<SPI, CS>,
    step: Step,
}

impl<SPI: SpiBus, CS: OutputPin> ConfigurationMode<'_, SPI, CS> {
    /// The register to write in this step: one of a filter or a mask, CNF1 to CNF3, or CANINTE. `None` if all are written.
    #[inline(always)]
    pub fn register(&self) -> Option<u8> {
        (self.step != Step::ENTERING).then_some(self.step.0.wrapping_sub(Step::CONFIGURING.0))
    }

    /// Writes the register, and reads it back. True if it holds the value.
    #[inline(always)]
    pub fn write(&mut self, register: u8, value: u8) -> bool {
        self.chip.access(instruction::WRITE, register, value);
        self.chip.read(register) == value
    }

    /// The step after this one, where registers follow that are not configured: 0x0C to 0x0F, 0x1C to 0x1F.
    #[inline(always)]
    pub fn step_over(self, register: u8) -> Option<Step> {
        (register == 0x0B || register == 0x1B).then_some(Step(self.step.0 + 5))
    }

    /// Leaves for the mode that `canctrl` requests. RXB0 receives by its filters, and what finds it full goes to RXB1.
    #[inline(always)]
    pub fn leave(self, canctrl: u8) {
        self.chip.access(instruction::WRITE, RXB0CTRL, BUKT);
        self.chip.write_canctrl(canctrl);
    }
}

/// The chip on its SPI.
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
    /// Configuration mode, if the chip is in it at `step`.
    #[inline(always)]
    pub fn configuration_mode(&mut self, step: Step) -> Option<ConfigurationMode<'_, SPI, CS>> {
        (Step::CONFIGURING..=Step::ENTERING).contains(&step).then_some(ConfigurationMode { chip: self, step })
    }

    /// RESET.
    #[inline(always)]
    pub fn reset(&mut self) {
        self.select();
        self.exchange(instruction::RESET);
        self.deselect();
    }

    /// READ STATUS.
    #[inline(never)]
    pub fn status(&mut self) -> u8 {
        self.select();
        self.exchange(instruction::READ_STATUS);
        let status = self.exchange(0);
        self.deselect();
        status
    }

    /// READ of one register.
    #[inline(always)]
    pub fn read(&mut self, register: u8) -> u8 {
        self.access(instruction::READ, register, 0)
    }

    /// The beginning of a READ of several registers: [`next`](Self::next) gives them, [`deselect`](Self::deselect) ends it.
    #[inline(always)]
    pub fn begin_read(&mut self, register: u8) {
        self.begin(instruction::READ, register);
    }

    /// The next register of a READ.
    #[inline(never)]
    pub fn next(&mut self) -> u8 {
        self.exchange(0)
    }

    /// WRITE to CANCTRL.
    #[inline(always)]
    pub fn write_canctrl(&mut self, value: u8) {
        self.access(instruction::WRITE, CANCTRL, value);
    }

    /// Clears RX0OVR and RX1OVR. The other bits of EFLG are read-only.
    #[inline(always)]
    pub fn clear_overflow(&mut self) {
        self.access(instruction::WRITE, EFLG, 0);
    }

    /// READ RX BUFFER. In place of the identifier there are SIDH, SIDL, EID8 and EID0. Returns RXBnDLC.
    #[inline(always)]
    pub fn read_frame(&mut self, buffer: Buffer, frame: &mut Frame) -> u8 {
        self.select();
        // RXB0 is read by 0x90, RXB1 by 0x94.
        self.exchange(instruction::READ_RX_BUFFER | (buffer as u8 & Buffer::Rxb1 as u8) << 1);
        _ = self.spi.read(&mut frame.id);
        let dlc = self.exchange(0);
        frame.len = (dlc & DLC).min(Frame::MAX_LEN as u8);
        if let Some(data) = frame.data.get_mut(..usize::from(frame.len)) {
            _ = self.spi.read(data);
        }
        self.deselect();
        dlc
    }

    /// WRITE to a transmit buffer, and RTS for it.
    #[inline(always)]
    pub fn send_frame(&mut self, rank: Rank, frame: &Frame) {
        // TXB0, TXB1, TXB2: addresses 0x30, 0x40, 0x50. The priority is in the register before the identifier.
        self.begin(instruction::WRITE, TXB0CTRL + ((rank.buffer() & 6) << 3));
        self.exchange(rank.priority());
        let [b3, b2, ..] = frame.id;
        self.exchange(sidh(b3, b2));
        self.exchange(sidl(b2));
        self.exchange(frame.id[2]);
        self.exchange(frame.id[3]);
        self.exchange(frame.len);
        // The chip does not send what follows the last byte that counts.
        _ = self.spi.write(&frame.data);
        self.deselect();
        self.select();
        self.exchange(instruction::RTS | rank.buffer());
        self.deselect();
    }

    /// READ or WRITE of one register.
    #[inline(never)]
    fn access(&mut self, instruction: u8, register: u8, value: u8) -> u8 {
        self.begin(instruction, register);
        let answer = self.exchange(value);
        self.deselect();
        answer
    }

    /// The beginning of a READ or WRITE.
    #[inline(never)]
    fn begin(&mut self, instruction: u8, register: u8) {
        self.select();
        self.exchange(instruction);
        self.exchange(register);
    }

    #[inline(always)]
    fn select(&mut self) {
        _ = self.cs.set_low();
    }

    /// Ends an instruction, when the SPI has sent all of it.
    #[inline(always)]
    pub fn deselect(&mut self) {
        _ = self.spi.flush();
        _ = self.cs.set_high();
    }

    #[inline(never)]
    fn exchange(&mut self, byte: u8) -> u8 {
        let mut bytes = [byte];
        _ = self.spi.transfer_in_place(&mut bytes);
        bytes[0]
    }
}
