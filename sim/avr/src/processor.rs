//! The interface between a processor and the board around it.
//!
//! A processor runs its program up to a given time. It calls the board's device for each byte on
//! the SPI and the board's watchers for each change of a pin, in the middle of an instruction. The
//! callbacks may drive pins.

use sim_base::Cycles;

/// Receives each new level of a pin.
pub type PinWatcher = Box<dyn FnMut(bool, Cycles)>;

/// State of the processor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// Executes instructions.
    Running,
    /// Sleeps until an interrupt.
    Sleeping,
    /// The program counter, a byte address, left the flash, or is in flash that cannot be read
    /// while other flash is programmed. Only a reset ends this state.
    Crashed(u32),
    /// Sleeps with interrupts off. Only a reset ends this state.
    Done,
}

/// One of the two output compare pins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Oc {
    /// OC1A = PB1 = D9.
    A,
    /// OC1B = PB2 = D10.
    B,
}

/// Cause of a reset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResetCause {
    /// Power-on: SRAM and registers have random contents, and of the flags in MCUSR only PORF is
    /// set.
    PowerOn,
    /// The RESET pin was low.
    External,
    /// The supply was too low for a moment.
    BrownOut,
    /// The watchdog timed out.
    Watchdog,
}

/// A reset of the chip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reset {
    /// Time of the reset.
    pub at: Cycles,
    /// Cause of the reset.
    pub cause: ResetCause,
}

/// A mistake of the program that a real chip does not report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation {
    /// Time of the mistake.
    pub at: Cycles,
    /// Description of the mistake, with the program counter.
    pub text: String,
}

/// A byte on the SPI, which the device gets at the end of the last bit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SpiByte {
    /// The byte on MOSI, with the first bit on the wire as the most significant one.
    pub mosi: u8,
    /// Time at which the program wrote SPDR.
    pub start: Cycles,
    /// Time of the end of the last bit.
    pub end: Cycles,
    /// Length of an SCK period in CPU cycles.
    pub cycles_per_bit: u64,
    /// SPI mode: CPOL * 2 + CPHA.
    pub mode: u8,
}

/// A device on the SPI.
pub trait SpiDevice {
    /// Begins a byte: the device latches the byte that it shifts out.
    fn begin_byte(&mut self, at: Cycles);

    /// Ends a byte. Returns the byte that the device shifted out.
    fn end_byte(&mut self, byte: &SpiByte) -> u8;
}

/// A device that calculates its byte at the end of the transfer.
impl<F: FnMut(&SpiByte) -> u8> SpiDevice for F {
    fn begin_byte(&mut self, _at: Cycles) {}

    fn end_byte(&mut self, byte: &SpiByte) -> u8 {
        self(byte)
    }
}

/// What is on the two-wire bus (TWI, I2C), which the chip leads as its only master.
pub trait TwiBus {
    /// A START, or a repeated one, and the byte after it, which ends now. `address` has 7 bits.
    /// True if a device acknowledges.
    fn address(&mut self, now: Cycles, address: u8, is_read: bool) -> bool;

    /// A byte to the device. True if it acknowledges.
    fn write(&mut self, byte: u8) -> bool;

    /// The next byte of the device.
    fn read(&mut self) -> u8;

    /// A STOP.
    fn stop(&mut self);
}

/// A character on TXD or RXD.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SerialCharacter {
    /// True for RXD, to the chip; false for TXD.
    pub to_chip: bool,
    /// Time of the start of the start bit.
    pub start: Cycles,
    /// Length of a bit in CPU cycles.
    pub cycles_per_bit: u64,
    /// The levels of the bits. Bit 0 is the start bit.
    pub levels: u16,
    /// Number of bits: 10 for 8N1. 0 if a reset has cut off the last character, and the line is
    /// idle from `start` on.
    pub bits: u8,
}
