//! The CAN controller: an MCP2515 on the SPI, by polling. Names are those of the datasheet
//! (DS20001801J).
//!
//! Its filters accept service frames to this node, and nothing else. A frame goes to RXB0, or to
//! RXB1 while RXB0 is full. All frames leave through TXB0, one after the other, so that they stay
//! in order.

use firmware::hardware::{CAN_SELECT, Pin};

use crate::layout::Frame;
use crate::registers::*;
use crate::variables::{self, CNF1, CNF2, CNF3, NODE_ID};

/// SPI instructions (table 12-1).
mod instruction {
    pub const WRITE: u8 = 0x02;
    pub const READ: u8 = 0x03;
    /// LOAD TX BUFFER, from TXB0SIDH on.
    pub const LOAD_TXB0: u8 = 0x40;
    /// RTS for TXB0.
    pub const RTS_TXB0: u8 = 0x81;
    /// READ RX BUFFER, from RXB0SIDH and from RXB1SIDH on. The end of the instruction frees the
    /// buffer.
    pub const READ_RXB0: u8 = 0x90;
    pub const READ_RXB1: u8 = 0x94;
    pub const READ_STATUS: u8 = 0xA0;
    pub const RESET: u8 = 0xC0;
}

/// Answer to READ STATUS (figure 12-8).
mod status {
    pub const RX0IF: u8 = 1 << 0;
    pub const RX1IF: u8 = 1 << 1;
    pub const TXB0_TXREQ: u8 = 1 << 2;
}

const RXF0SIDH: u8 = 0x00;
const RXF3SIDH: u8 = 0x10;
const RXM0SIDH: u8 = 0x20;
const CANINTF: u8 = 0x2C;
const CANSTAT: u8 = 0x0E;
const CANCTRL: u8 = 0x0F;
/// Counts errors in frames of others.
const REC: u8 = 0x1D;
const RXB0CTRL: u8 = 0x60;
/// CANSTAT: the mode of the chip.
const OPMOD: u8 = 0b1110_0000;
/// RXB0CTRL: a frame that finds RXB0 full goes to RXB1.
const BUKT: u8 = 1 << 2;
/// SIDL: the identifier is extended.
pub const EXIDE: u8 = 1 << 3;

/// The mode that the loader wants, as in CANCTRL: [`NORMAL`], [`TRIAL`] or [`LISTEN_ONLY`].
pub const MODE: Register = idle::GPIOR2;
pub const NORMAL: u8 = 0;
/// Normal and one-shot mode.
pub const TRIAL: u8 = 1 << 3;
pub const LISTEN_ONLY: u8 = 0b0110_0000;

/// CANINTF: a frame was sent. With MERRF, there was an error in a frame, the register is negative.
pub const TX0IF: u8 = 1 << 2;

/// In the last byte of an identifier: the frame belongs to a service.
pub const SERVICE: u8 = 1 << 7;
/// In the third byte of the identifier of a service: the frame belongs to a request.
pub const REQUEST: u8 = 1 << 7;
/// The bits of a node ID.
pub const NODE_ID_BITS: u8 = 0x7F;

/// The longest wait for a frame to leave, in turns of 5.4 us: 0.35 s (`scripts/bounds --boot`). The
/// frame before may have to win an arbitration first.
const TURNS_FOR_FRAME: u16 = u16::MAX;

/// Not zero if RXB1 had a frame when RXB0 was read.
const IS_RXB1_NEXT: Register = idle::EEDR;

/// Sets up the pins and the SPI: mode 0,0 at 8 MHz.
#[inline(always)]
pub fn set_up_spi() {
    const SS: Pin = Pin::named("D10");
    const MOSI: Pin = Pin::named("D11");
    const SCK: Pin = Pin::named("D13");
    let (ddr, port) = port(CAN_SELECT.port);
    port.set(CAN_SELECT.mask());
    // SS must be an output, so that the SPI stays master.
    let mut outputs = SS.mask() | MOSI.mask() | SCK.mask();
    if CAN_SELECT.port == b'B' {
        outputs |= CAN_SELECT.mask();
    } else {
        ddr.set(CAN_SELECT.mask());
    }
    crate::registers::port(b'B').0.write(outputs);
    SPCR.write(SPE | MSTR);
    SPSR.write(SPI2X);
}

/// Resets the chip, and puts it on the bus in [`MODE`]. While it listens, it receives each
/// frame.
#[inline(always)]
pub fn configure() {
    command(instruction::RESET);
    IS_RXB1_NEXT.write(0);
    // The oscillator starts in 128 periods (8.1), which is 16 us at 8 MHz. This takes longer.
    let mut turns = 64u8;
    loop {
        _ = SPSR.read();
        turns -= 1;
        if turns == 0 {
            break;
        }
    }
    begin_filters(3, RXF0SIDH, NODE_ID.read());
    end();
    begin_filters(3, RXF3SIDH, NODE_ID.read());
    end();
    // Behind the masks follows the bit timing.
    begin_filters(2, RXM0SIDH, NODE_ID_BITS);
    exchange(CNF3.read());
    exchange(CNF2.read());
    exchange(CNF1.read());
    end();
    // The bits of LISTEN_ONLY are those of RXM, which turn the filters off. That of TRIAL cannot be
    // written here.
    write(BUKT | MODE.read(), RXB0CTRL);
    set_mode();
}

/// Puts the chip into [`MODE`].
#[inline(always)]
pub fn set_mode() {
    write(MODE.read(), CANCTRL);
}

/// True if there was an error in a frame of others since the chip was set up.
#[inline(always)]
pub fn has_received_error() -> bool {
    read(REC) != 0
}

/// Begins to write `count` filters or masks for services with `destination`. The caller may write
/// the registers behind them, and must end it.
#[inline(never)]
fn begin_filters(mut count: u8, register: u8, destination: u8) {
    begin_at(instruction::WRITE, register);
    loop {
        exchange(0);
        // The masks have no such bit.
        exchange(EXIDE);
        exchange(destination);
        exchange(SERVICE);
        count -= 1;
        if count == 0 {
            return;
        }
    }
}

/// True if the chip is in normal mode. It is not if it was reset, or waits for a pause on the bus.
#[inline(always)]
pub fn is_on_bus() -> bool {
    read(CANSTAT) & OPMOD == NORMAL
}

/// Reads CANINTF.
#[inline(always)]
pub fn interrupt_flags() -> u8 {
    read(CANINTF)
}

/// The data of the last received frame.
#[inline(always)]
pub fn data() -> *const u8 {
    // SAFETY: the pointer is to a variable, so the field is valid.
    unsafe { (&raw const (*variables::frame()).data).cast() }
}

/// Reads the oldest frame. Returns false if there is none.
#[inline(always)]
pub fn receive() -> bool {
    // If both buffers were full, RXB1 comes next, whatever RXB0 has meanwhile.
    let mut instruction = instruction::READ_RXB1;
    if IS_RXB1_NEXT.read() == 0 {
        let status = read_status();
        if status & status::RX0IF != 0 {
            instruction = instruction::READ_RXB0;
            IS_RXB1_NEXT.write(status & status::RX1IF);
        } else if status & status::RX1IF == 0 {
            return false;
        }
    } else {
        IS_RXB1_NEXT.write(0);
    }
    begin(instruction);
    let mut byte = variables::frame().cast::<u8>();
    let mut left = size_of::<Frame>() as u8;
    loop {
        // SAFETY: the loop writes the bytes of the frame, any value of which is valid.
        unsafe {
            *byte = exchange(0);
            byte = byte.add(1);
        }
        left -= 1;
        if left == 0 {
            break;
        }
    }
    end();
    true
}

/// Waits until TXB0 is free. Returns false if the frame in it does not leave.
#[inline(always)]
pub fn wait_for_room() -> bool {
    let mut turns = TURNS_FOR_FRAME;
    while read_status() & status::TXB0_TXREQ != 0 {
        turns -= 1;
        if turns == 0 {
            return false;
        }
    }
    true
}

/// Begins to load TXB0, with SIDH to EID0. DLC and the data must follow with [`exchange`], and then
/// [`send`].
#[inline(always)]
pub fn begin_frame(sidh: u8, sidl: u8, eid8: u8, eid0: u8) {
    begin(instruction::LOAD_TXB0);
    exchange(sidh);
    exchange(sidl);
    exchange(eid8);
    exchange(eid0);
}

/// Ends loading TXB0, and sends the frame.
#[inline(always)]
pub fn send() {
    end();
    command(instruction::RTS_TXB0);
}

#[inline(never)]
fn read_status() -> u8 {
    begin(instruction::READ_STATUS);
    exchange_last(0)
}

#[inline(never)]
fn read(register: u8) -> u8 {
    begin_at(instruction::READ, register);
    exchange_last(0)
}

#[inline(never)]
fn write(value: u8, register: u8) {
    begin_at(instruction::WRITE, register);
    exchange_last(value);
}

/// Begins an instruction with the address of a register.
#[inline(never)]
fn begin_at(instruction: u8, register: u8) {
    begin(instruction);
    exchange(register);
}

/// Begins an instruction.
#[inline(never)]
fn begin(instruction: u8) {
    port(CAN_SELECT.port).1.clear(CAN_SELECT.mask());
    exchange(instruction);
}

/// Does an instruction of one byte.
#[inline(always)]
fn command(instruction: u8) {
    port(CAN_SELECT.port).1.clear(CAN_SELECT.mask());
    exchange_last(instruction);
}

/// Sends the last byte of an instruction, and returns the one that comes back.
#[inline(never)]
fn exchange_last(byte: u8) -> u8 {
    let answer = exchange(byte);
    end();
    answer
}

#[inline(always)]
fn end() {
    port(CAN_SELECT.port).1.set(CAN_SELECT.mask());
}

/// Sends a byte over the SPI, and returns the one that comes back. The wait ends after 16 cycles,
/// because the master makes the clock.
#[inline(never)]
pub fn exchange(byte: u8) -> u8 {
    SPDR.write(byte);
    while !SPSR.has(SPIF) {}
    SPDR.read()
}
