//! Driver of the MCP2515 (datasheet DS20001801J): never waits, keeps frames in order, and keeps an eye on the chip.
//!
//! # How it works
//!
//! [`Mcp2515::poll`] brings the chip up one short step at a time: reset, then each group of registers written *and read
//! back*, then normal mode, which must show in CANSTAT. While it runs, `poll` looks every [`SUPERVISION_MS`] whether the
//! chip still has its configuration (a brown-out or a glitch resets it), and at its error flags. Whatever goes wrong, it
//! tells and starts over, for ever, at most once in [`RETRY_MS`].
//!
//! [`Mcp2515::calls`] goes by the level of the INT pin. Waiting for an edge loses the chip when a second frame arrives
//! before the first is read, because then the pin never rises.
//!
//! # Cost
//!
//! A frame is received in three chip selects and 18 bytes: READ STATUS, READ RX BUFFER (which also clears the flag),
//! and READ STATUS once more for the order (see `rx_order.rs`). It is sent in three and 19 bytes.
//!
//! # Assumptions
//!
//! `receive` must be called for each frame within two frame times, or the chip, which has two buffers, loses frames. It counts
//! as lost at least one each time that it says so.

mod registers;
mod rx_order;
mod tx_order;

use embedded_hal::digital::InputPin;
use embedded_hal::spi::SpiDevice;

use super::Frame;
use super::bit_timing::BitTiming;
use registers::*;
use rx_order::{Buffer, RxOrder};
use tx_order::TxOrder;

/// Between two looks at a running chip, in milliseconds.
pub const SUPERVISION_MS: u16 = 10;

/// From a failure to the next reset of the chip, in milliseconds.
pub const RETRY_MS: u16 = 100;

/// From RESET to the first access, in milliseconds: the oscillator takes 128 cycles to start (8.1), 8 us at 16 MHz. One
/// tick of the clock may be over at once, so two.
const START_UP_MS: u16 = 2;

/// How often to look for normal mode, once a millisecond. The chip waits for eleven recessive bits (10.5), which a busy bus
/// offers after every frame.
const NORMAL_MODE_LOOKS: u8 = 50;

/// Until frames that nobody acknowledges are given up, in milliseconds (DroneCAN specification, chapter 4: one second).
const TX_TIMEOUT_MS: u16 = 1000;

/// What the chip is to accept: two masks and six filters over 29-bit identifiers (DS20001801J 4.5). A mask bit of 1
/// compares that bit. Filters 0 and 1 go with mask 0 and buffer 0, filters 2 to 5 with mask 1 and buffer 1.
pub trait Acceptance {
    /// Mask 0 or 1.
    fn mask(&self, n: u8) -> u32;
    /// Filter 0 to 5. All six exist in the chip, so all six need a value.
    fn filter(&self, n: u8) -> u32;
}

/// What came out of a receive buffer. It borrows the driver's copy, because a frame costs 14 cycles a byte to move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received<'a> {
    /// An extended data frame: its identifier and its bytes.
    Frame(u32, &'a [u8]),
    /// A frame with a standard identifier.
    Standard,
    /// A remote frame.
    Remote,
}

/// What [`Mcp2515::poll`] has to tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Notice {
    /// The chip is configured and on the bus.
    Running,
    /// Not in configuration mode after a reset. The value is CANSTAT; 0x00 and 0xFF mean that nobody answers.
    NotAnswering(u8),
    /// A register did not read back as written. The value is its address.
    NotKeeping(u8),
    /// Normal mode was asked for and did not come: the bus is held dominant. The value is CANSTAT.
    NotStarting(u8),
    /// The chip lost its configuration while running. The value is CANSTAT.
    Lost(u8),
    /// The error flags that are set now (EFLG), because one of them has changed or frames were lost.
    Flags(ErrorFlags),
    /// Frames waited for a second without success and were given up.
    GaveUpSending,
}

/// EFLG, as read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorFlags(u8);

impl ErrorFlags {
    /// A frame for us was lost because the receive buffers were full.
    pub fn frames_lost(self) -> bool {
        self.0 & (RX0OVR | RX1OVR) != 0
    }

    /// The chip is off the bus, and comes back by itself after 128 x 11 recessive bits.
    pub fn bus_off(self) -> bool {
        self.0 & TXBO != 0
    }

    /// 128 or more errors in either counter.
    pub fn error_passive(self) -> bool {
        self.0 & (TXEP | RXEP) != 0
    }
}

/// Where the chip is on its way to the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// To be reset.
    Down,
    /// Reset; its oscillator starts.
    Starting,
    /// Being configured: the number of the next group of registers.
    Configuring { step: u8 },
    /// Normal mode was asked for, and was not there yet so many times.
    Entering { looks: u8 },
    /// On the bus.
    Running,
}

/// Groups of four registers: six filters, two masks, and the bit timing with CANINTE.
const CONFIGURATION_STEPS: u8 = 9;

/// The chip, on an SPI device of mode 0,0 and at most 10 MHz, with its INT pin.
pub struct Mcp2515<SPI, INT, A> {
    spi: SPI,
    int: INT,
    acceptance: A,
    timing: BitTiming,
    phase: Phase,
    /// When to poll.
    due_ms: u16,
    rx: RxOrder,
    tx: TxOrder,
    /// Buffers that waited to be sent when last looked at, and since when that has not changed.
    tx_waiting: u8,
    tx_since_ms: u16,
    aborting: bool,
    flags: ErrorFlags,
    /// READ RX BUFFER and what it answers.
    buffer: [u8; 14],
}

impl<SPI: SpiDevice, INT: InputPin, A: Acceptance> Mcp2515<SPI, INT, A> {
    /// A chip that is reset at the first [`poll`](Self::poll).
    pub fn new(spi: SPI, int: INT, acceptance: A, timing: BitTiming) -> Self {
        Self {
            spi,
            int,
            acceptance,
            timing,
            phase: Phase::Down,
            due_ms: 0,
            rx: RxOrder::new(),
            tx: TxOrder::new(),
            tx_waiting: 0,
            tx_since_ms: 0,
            aborting: false,
            flags: ErrorFlags(0),
            buffer: [0; 14],
        }
    }

    /// Whether the chip is on the bus.
    pub fn is_running(&self) -> bool {
        self.phase == Phase::Running
    }

    /// Whether, when last looked at, the chip had nothing left to send.
    pub fn is_empty(&self) -> bool {
        self.tx_waiting == 0
    }

    /// Whether it is time to [`poll`](Self::poll). `now_ms` wraps around.
    pub fn is_due(&self, now_ms: u16) -> bool {
        now_ms.wrapping_sub(self.due_ms) < 1 << 15
    }

    /// Does the next short step of start-up or supervision.
    ///
    /// # Errors
    ///
    /// Those of the SPI device; the chip is then started over.
    #[inline(never)]
    pub fn poll(&mut self, now_ms: u16) -> Result<Option<Notice>, SPI::Error> {
        self.due_ms = now_ms;
        match self.phase {
            Phase::Down => {
                self.phase = Phase::Starting;
                self.due_ms = now_ms.wrapping_add(START_UP_MS);
                self.spi.write(&[instruction::RESET])?;
            }
            Phase::Starting => {
                let [canstat] = self.read(CANSTAT)?;
                if canstat & OPMOD != MODE_CONFIGURATION {
                    return Ok(self.fail(Notice::NotAnswering(canstat)));
                }
                self.phase = Phase::Configuring { step: 0 };
            }
            Phase::Configuring { step } if step < CONFIGURATION_STEPS => {
                let (address, values) = self.configuration(step);
                self.write(address, values)?;
                if self.read(address)? != values {
                    return Ok(self.fail(Notice::NotKeeping(address)));
                }
                self.phase = Phase::Configuring { step: step + 1 };
            }
            Phase::Configuring { .. } => {
                self.write(RXB0CTRL, [BUKT])?;
                self.write(CANCTRL, [MODE_NORMAL])?;
                self.phase = Phase::Entering { looks: 0 };
            }
            Phase::Entering { looks } => {
                let [canstat] = self.read(CANSTAT)?;
                if canstat & OPMOD == MODE_NORMAL {
                    self.phase = Phase::Running;
                    self.rx = RxOrder::new();
                    self.tx = TxOrder::new();
                    (self.tx_waiting, self.aborting, self.flags) = (0, false, ErrorFlags(0));
                    return Ok(Some(Notice::Running));
                }
                if looks == NORMAL_MODE_LOOKS {
                    return Ok(self.fail(Notice::NotStarting(canstat)));
                }
                self.phase = Phase::Entering { looks: looks + 1 };
                self.due_ms = now_ms.wrapping_add(1);
            }
            Phase::Running => {
                self.due_ms = now_ms.wrapping_add(SUPERVISION_MS);
                return self.supervise(now_ms);
            }
        }
        Ok(None)
    }

    /// Whether [`receive`](Self::receive) is worth calling. Costs a few cycles, where `receive` would cost 60 to say no.
    #[inline(always)]
    pub fn calls(&mut self) -> bool {
        // A pin that cannot be read counts as low: a look too many costs 2 us, a look too few a frame.
        self.is_running() && (!self.rx.is_empty() || self.int.is_low().unwrap_or(true))
    }

    /// The next frame, oldest first; `None` when there is none.
    ///
    /// # Errors
    ///
    /// Those of the SPI device.
    #[inline(never)]
    pub fn receive(&mut self) -> Result<Option<Received<'_>>, SPI::Error> {
        if self.rx.is_empty() {
            let status = self.read_status()?;
            self.rx.seen_late(status & status::RX0IF != 0, status & status::RX1IF != 0);
        }
        let Some(buffer) = self.rx.take() else { return Ok(None) };
        self.buffer[0] = match buffer {
            Buffer::Rxb0 => instruction::READ_RX_BUFFER,
            Buffer::Rxb1 => instruction::READ_RX_BUFFER + 4,
        };
        self.spi.transfer_in_place(&mut self.buffer)?;
        if buffer == Buffer::Rxb0 && self.rx.is_empty() {
            let status = self.read_status()?;
            self.rx.seen_at_once(status & status::RX0IF != 0, status & status::RX1IF != 0);
        }
        let [_, sidh, sidl, eid8, eid0, dlc, ref data @ ..] = self.buffer;
        Ok(Some(if sidl & IDE == 0 {
            Received::Standard
        } else if dlc & RTR != 0 {
            Received::Remote
        } else {
            // Codes above 8 mean 8.
            let data = data.get(..usize::from(dlc & DLC)).unwrap_or(data);
            Received::Frame(identifier([sidh, sidl, eid8, eid0]), data)
        }))
    }

    /// Hands a frame to the chip, to be sent after all that it has already; `false` if it has no room.
    ///
    /// # Errors
    ///
    /// Those of the SPI device.
    #[inline(never)]
    pub fn transmit(&mut self, frame: &Frame, now_ms: u16) -> Result<bool, SPI::Error> {
        if !self.is_running() || self.aborting {
            return Ok(false);
        }
        let waiting = self.waiting()?;
        let Some(slot) = self.tx.next(waiting) else {
            return Ok(false);
        };
        if waiting == 0 || waiting != self.tx_waiting {
            self.tx_since_ms = now_ms;
        }
        self.tx_waiting = waiting | 1 << slot.buffer;

        let [sidh, sidl, eid8, eid0] = extended_bytes(frame.id());
        let (&[d0, d1, d2, d3, d4, d5, d6, d7], len) = frame.padded();
        let load = instruction::LOAD_TX_BUFFER + 2 * slot.buffer;
        // The bytes after the last are sent to the chip, too, which does not use them.
        self.spi.write(&[load, sidh, sidl, eid8, eid0, len, d0, d1, d2, d3, d4, d5, d6, d7])?;
        self.write(TXB0CTRL + (slot.buffer << 4), [TXREQ | slot.priority])?;
        Ok(true)
    }

    /// A look at a running chip.
    #[inline(never)]
    fn supervise(&mut self, now_ms: u16) -> Result<Option<Notice>, SPI::Error> {
        let [canstat, canctrl] = self.read(CANSTAT)?;
        let [cnf3, cnf2, cnf1, caninte, _, eflg] = self.read(CNF3)?;
        let (_, kept) = self.configuration(CONFIGURATION_STEPS - 1);
        if canstat & OPMOD != MODE_NORMAL || canctrl & OPMOD != MODE_NORMAL || [cnf3, cnf2, cnf1, caninte] != kept {
            return Ok(self.fail(Notice::Lost(canstat)));
        }

        let flags = ErrorFlags(eflg);
        let changed = flags != self.flags;
        // The flags of loss stay until they are cleared, and only by BIT MODIFY: the others are read-only.
        if flags.frames_lost() {
            self.modify(EFLG, RX0OVR | RX1OVR, 0)?;
        }
        self.flags = ErrorFlags(eflg & !(RX0OVR | RX1OVR));
        if changed {
            return Ok(Some(Notice::Flags(flags)));
        }

        if self.aborting {
            self.aborting = false;
            self.modify(CANCTRL, ABAT, 0)?;
        }
        let waiting = self.waiting()?;
        if waiting == 0 || waiting != self.tx_waiting {
            self.tx_waiting = waiting;
            self.tx_since_ms = now_ms;
        } else if now_ms.wrapping_sub(self.tx_since_ms) >= TX_TIMEOUT_MS {
            self.aborting = true;
            self.modify(CANCTRL, ABAT, ABAT)?;
            return Ok(Some(Notice::GaveUpSending));
        }
        Ok(None)
    }

    /// Address and values of a group of registers.
    #[inline(never)]
    fn configuration(&self, step: u8) -> (u8, [u8; 4]) {
        match step {
            // RXF0 to RXF2 begin at address 0, RXF3 to RXF5 at 0x10.
            0..3 => (step << 2, extended_bytes(self.acceptance.filter(step))),
            3..6 => ((step + 1) << 2, extended_bytes(self.acceptance.filter(step))),
            6 | 7 => (RXM0SIDH + ((step - 6) << 2), identifier_bytes(self.acceptance.mask(step - 6))),
            _ => (CNF3, [self.timing.cnf3, self.timing.cnf2, self.timing.cnf1, RX0IE | RX1IE]),
        }
    }

    fn fail(&mut self, notice: Notice) -> Option<Notice> {
        self.phase = Phase::Down;
        self.due_ms = self.due_ms.wrapping_add(RETRY_MS);
        Some(notice)
    }

    /// TXREQ of the three buffers, as bits 0 to 2.
    #[inline(never)]
    fn waiting(&mut self) -> Result<u8, SPI::Error> {
        let status = self.read_status()?;
        let mut waiting = 0;
        if status & status::TX0REQ != 0 {
            waiting |= 1;
        }
        if status & status::TX0REQ << 2 != 0 {
            waiting |= 2;
        }
        if status & status::TX0REQ << 4 != 0 {
            waiting |= 4;
        }
        Ok(waiting)
    }

    fn read_status(&mut self) -> Result<u8, SPI::Error> {
        let mut bytes = [instruction::READ_STATUS, 0];
        self.spi.transfer_in_place(&mut bytes)?;
        Ok(bytes[1])
    }

    fn modify(&mut self, address: u8, mask: u8, value: u8) -> Result<(), SPI::Error> {
        self.spi.write(&[instruction::BIT_MODIFY, address, mask, value])
    }

    fn write<const N: usize>(&mut self, address: u8, values: [u8; N]) -> Result<(), SPI::Error> {
        let mut bytes = [0; 6];
        let (head, rest) = bytes.split_at_mut(2);
        head.copy_from_slice(&[instruction::WRITE, address]);
        rest.split_at_mut(N).0.copy_from_slice(&values);
        self.spi.write(bytes.split_at(2 + N).0)
    }

    fn read<const N: usize>(&mut self, address: u8) -> Result<[u8; N], SPI::Error> {
        let mut bytes = [0; 8];
        bytes[0] = instruction::READ;
        bytes[1] = address;
        self.spi.transfer_in_place(bytes.split_at_mut(2 + N).0)?;
        let mut values = [0; N];
        values.copy_from_slice(bytes[2..].split_at(N).0);
        Ok(values)
    }
}

/// The identifier in the layout that SIDH, SIDL, EID8 and EID0 share: bits 28..21; 20..18 and 17..16 around the flags; 15..8;
/// 7..0. Byte by byte, because the AVR shifts an `u32` one bit at a time.
fn identifier_bytes(id: u32) -> [u8; 4] {
    let [b3, b2, b1, b0] = id.to_be_bytes();
    [b3 << 3 | b2 >> 5, (b2 & 0b1_1100) << 3 | b2 & 0b11, b1, b0]
}

/// The same, marked as extended: for filters and for frames to send.
fn extended_bytes(id: u32) -> [u8; 4] {
    let [sidh, sidl, eid8, eid0] = identifier_bytes(id);
    [sidh, sidl | IDE, eid8, eid0]
}

/// The identifier from SIDH, SIDL, EID8 and EID0.
fn identifier([sidh, sidl, eid8, eid0]: [u8; 4]) -> u32 {
    u32::from_be_bytes([sidh >> 3, sidh << 5 | (sidl & 0b1110_0000) >> 3 | sidl & 0b11, eid8, eid0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identifiers_are_laid_out_as_the_datasheet_draws_them() {
        // Registers 5-4 to 5-7: one bit at a time.
        for bit in 0..29 {
            let [sidh, sidl, eid8, eid0] = extended_bytes(1 << bit);
            let expected = match bit {
                0..8 => (0, 0x08, 0, 1 << bit),
                8..16 => (0, 0x08, 1 << (bit - 8), 0),
                16 | 17 => (0, 0x08 | 1 << (bit - 16), 0, 0),
                18..21 => (0, 0x08 | 1 << (bit - 18 + 5), 0, 0),
                _ => (1 << (bit - 21), 0x08, 0, 0),
            };
            assert_eq!((sidh, sidl, eid8, eid0), expected, "bit {bit}");
            assert_eq!(identifier([sidh, sidl, eid8, eid0]), 1 << bit);
        }
        assert_eq!(identifier([0xFF; 4]), Frame::ID_MASK);
    }
}
