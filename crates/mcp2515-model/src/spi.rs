//! The SPI side: instructions, byte by byte.
//!
//! An instruction begins with the first byte after CS falls and ends when CS rises. The chip shifts
//! its answer out while it shifts the master's byte in, so the answer has the state of the
//! registers when the byte begins; the master's byte takes effect when it ends. During instruction,
//! address, mask and data bytes the chip does not drive SO; the model answers FFh. The same holds
//! while CS is high: then the bytes are for another device.
//!
//! The address of READ, WRITE and READ RX BUFFER increments through the whole map and wraps from
//! 7Fh to 00h. LOAD TX BUFFER stops at D7 of its buffer. The datasheet does not say what the chip
//! does with further bytes; they are a violation. At most one violation is recorded per
//! instruction.
//!
//! Source: DS20001801J section 12.

use super::Mcp2515;
use super::registers::{self, ADDRESS_MASK, BUFFER_STRIDE, RXB0CTRL, TXB0CTRL, int, offset};
use sim_base::Cycles;

/// The byte that the master reads while the chip does not drive SO.
const HIGH_IMPEDANCE: u8 = 0xFF;

/// Instruction bytes (Table 12-1).
mod opcode {
    pub const WRITE: u8 = 0x02;
    pub const READ: u8 = 0x03;
    pub const BIT_MODIFY: u8 = 0x05;
    pub const LOAD_TX_BUFFER: u8 = 0x40;
    pub const LOAD_TX_BUFFER_LAST: u8 = 0x45;
    pub const RTS: u8 = 0x80;
    pub const RTS_LAST: u8 = 0x87;
    pub const READ_RX_BUFFER: u8 = 0x90;
    pub const READ_RX_BUFFER_LAST: u8 = 0x96;
    pub const READ_STATUS: u8 = 0xA0;
    pub const RX_STATUS: u8 = 0xB0;
    pub const RESET: u8 = 0xC0;
}

/// The state of an instruction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    #[default]
    Instruction,
    /// Complete, unknown, or sent during start-up: further bytes have no effect.
    Ignore,
    ReadAddress,
    Read {
        address: u8,
    },
    WriteAddress,
    Write {
        address: u8,
    },
    ReadRx {
        buffer: usize,
        address: u8,
        read: bool,
    },
    LoadTx {
        address: u8,
    },
    ReadStatus,
    RxStatus,
    ModifyAddress,
    ModifyMask {
        address: u8,
    },
    ModifyData {
        address: u8,
        mask: u8,
    },
}

/// CS and the instruction in progress.
#[derive(Debug)]
pub(super) struct Spi {
    selected: bool,
    state: State,
    /// The answer to the byte in progress.
    answer: u8,
    /// True if a violation was recorded in this instruction.
    has_violation: bool,
}

impl Default for Spi {
    fn default() -> Spi {
        Spi {
            selected: false,
            state: State::default(),
            answer: HIGH_IMPEDANCE,
            has_violation: false,
        }
    }
}

impl Mcp2515 {
    /// CS falls.
    pub fn select(&mut self, _at: Cycles) {
        if !self.spi.selected {
            self.spi = Spi { selected: true, ..Spi::default() };
        }
    }

    /// The first SCK edge of a byte is at `at`: the chip latches its answer.
    pub fn begin_byte(&mut self, at: Cycles) {
        self.catch_up(at);
        self.spi.answer = match self.spi.state {
            _ if !self.spi.selected => HIGH_IMPEDANCE,
            State::Read { address } | State::ReadRx { address, .. } => self.register(address),
            State::ReadStatus => self.read_status(),
            State::RxStatus => self.rx_status(),
            _ => HIGH_IMPEDANCE,
        };
    }

    /// The byte ends at `at`; `mosi` was sent to the chip. Returns the chip's answer, which
    /// [`begin_byte`](Self::begin_byte) latched.
    pub fn end_byte(&mut self, mosi: u8, at: Cycles) -> u8 {
        self.catch_up(at);
        let answer = std::mem::replace(&mut self.spi.answer, HIGH_IMPEDANCE);
        if !self.spi.selected {
            return HIGH_IMPEDANCE;
        }
        match self.spi.state {
            State::Instruction => self.begin(mosi, at),
            State::Ignore | State::ReadStatus | State::RxStatus => {}
            State::ReadAddress => {
                let address = self.address(mosi, at);
                self.spi.state = State::Read { address };
            }
            State::Read { address } => {
                self.spi.state = State::Read { address: next(address) };
            }
            State::WriteAddress => {
                let address = self.address(mosi, at);
                self.spi.state = State::Write { address };
            }
            State::Write { address } => {
                self.spi.state = State::Write { address: next(address) };
                self.write(address, mosi, at);
            }
            State::ReadRx { buffer, address, .. } => {
                self.spi.state = State::ReadRx { buffer, address: next(address), read: true };
            }
            State::LoadTx { address } => self.load_tx(address, mosi, at),
            State::ModifyAddress => {
                let address = self.address(mosi, at);
                self.spi.state = State::ModifyMask { address };
            }
            State::ModifyMask { address } => {
                self.spi.state = State::ModifyData { address, mask: mosi };
            }
            State::ModifyData { address, mask } => {
                self.spi.state = State::Ignore;
                self.bit_modify(address, mask, mosi, at);
            }
        }
        answer
    }

    /// CS rises.
    pub fn deselect(&mut self, at: Cycles) {
        if !self.spi.selected {
            return;
        }
        self.catch_up(at);
        match self.spi.state {
            State::ReadRx { buffer, read, .. } => {
                if !read && self.is_rx_full(buffer) {
                    self.violation(
                        at,
                        format!(
                            "READ RX BUFFER of RXB{buffer} ended before a byte was read: the \
                             frame is thrown away (DS20001801J 12.4)"
                        ),
                    );
                }
                self.write_canintf(0, int::RX0 << buffer, at);
            }
            State::ModifyAddress | State::ModifyMask { .. } | State::ModifyData { .. } => {
                self.violation(
                    at,
                    "BIT MODIFY ended before its data byte: nothing is changed (DS20001801J 12.10)"
                        .to_owned(),
                );
            }
            _ => {}
        }
        self.spi = Spi::default();
    }

    /// Records a driver mistake, unless this instruction already has one.
    pub(super) fn violation(&mut self, at: Cycles, text: String) {
        if !self.spi.has_violation {
            self.spi.has_violation = self.spi.selected;
            self.violations.record(at, text);
        }
    }

    fn begin(&mut self, instruction: u8, at: Cycles) {
        if at < self.settled_at {
            self.spi.state = State::Ignore;
            return;
        }
        if at < self.deaf_until {
            self.violation(
                at,
                format!(
                    "instruction {instruction:02X}h during oscillator start-up: ignored \
                     (DS20001801J 8.1)"
                ),
            );
            self.spi.state = State::Ignore;
            return;
        }
        self.spi.state = match instruction {
            opcode::RESET => {
                self.reset(at);
                State::Ignore
            }
            opcode::READ => State::ReadAddress,
            opcode::WRITE => State::WriteAddress,
            opcode::BIT_MODIFY => State::ModifyAddress,
            opcode::READ_STATUS => State::ReadStatus,
            opcode::RX_STATUS => State::RxStatus,
            opcode::RTS..=opcode::RTS_LAST => {
                for n in (0..3).filter(|n| instruction & 1 << n != 0) {
                    self.request_to_send(n, at);
                }
                State::Ignore
            }
            opcode::READ_RX_BUFFER..=opcode::READ_RX_BUFFER_LAST if instruction & 1 == 0 => {
                self.begin_read_rx(instruction, at)
            }
            opcode::LOAD_TX_BUFFER..=opcode::LOAD_TX_BUFFER_LAST => {
                let buffer = TXB0CTRL + (instruction & 0b111) / 2 * BUFFER_STRIDE;
                State::LoadTx {
                    address: buffer + [offset::SIDH, offset::D0][usize::from(instruction & 1)],
                }
            }
            _ => {
                self.violation(
                    at,
                    format!(
                        "unknown instruction {instruction:02X}h: ignored (DS20001801J Table 12-1)"
                    ),
                );
                State::Ignore
            }
        };
    }

    /// Bit 2 of the instruction selects the buffer, bit 1 SIDH or D0 (Figure 12-3).
    fn begin_read_rx(&mut self, instruction: u8, at: Cycles) -> State {
        let buffer = usize::from(instruction >> 2 & 1);
        if !self.is_rx_full(buffer) {
            self.violation(
                at,
                format!(
                    "READ RX BUFFER {instruction:02X}h while RX{buffer}IF is clear: stale data, \
                     and a frame that comes meanwhile is thrown away when CS rises (DS20001801J \
                     12.4)"
                ),
            );
        }
        let start = [offset::SIDH, offset::D0][usize::from(instruction >> 1 & 1)];
        State::ReadRx {
            buffer,
            address: RXB0CTRL + BUFFER_STRIDE * buffer as u8 + start,
            read: false,
        }
    }

    fn load_tx(&mut self, address: u8, value: u8, at: Cycles) {
        if address & 0x0F > offset::D7 {
            self.violation(
                at,
                format!("LOAD TX BUFFER of {value:02X}h beyond D7: ignored (DS20001801J 12.6)"),
            );
        } else {
            self.spi.state = State::LoadTx { address: next(address) };
            self.write(address, value, at);
        }
    }

    fn address(&mut self, byte: u8, at: Cycles) -> u8 {
        if byte & !ADDRESS_MASK != 0 {
            self.violation(
                at,
                format!("address {byte:02X}h is beyond 7Fh (DS20001801J Table 11-1)"),
            );
        }
        byte & ADDRESS_MASK
    }

    /// The answer to READ STATUS (Figure 12-8).
    fn read_status(&self) -> u8 {
        let flags = self.registers[usize::from(registers::CANINTF)];
        (0..3).fold(flags & (int::RX0 | int::RX1), |status, n| {
            let requested = u8::from(self.is_tx_requested(n));
            let sent = u8::from(flags & int::TX0 << n != 0);
            status | requested << (2 + 2 * n) | sent << (3 + 2 * n)
        })
    }
}

fn next(address: u8) -> u8 {
    address.wrapping_add(1) & ADDRESS_MASK
}
