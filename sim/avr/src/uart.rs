//! USART0 in asynchronous mode (datasheet section 20), with its exact timing and buffers.
//!
//! simavr counts 11 bits for a byte of 8N1, has one transmit buffer instead of two, and never loses
//! a received byte. This model follows the datasheet: a shift register and UDR0 to send, a shift
//! register and a FIFO of two bytes to receive, and data overrun. The other end sends back to back,
//! at exactly the rate that the program has set, while the receiver is on. Not
//! modelled: synchronous modes, parity and framing errors, nine data bits, the pins.

use std::cell::RefCell;
use std::collections::VecDeque;

use super::base::{Base, Peripheral, Timer};
use super::chip::Chip;
use super::core::Vector;
use super::processor::SerialCharacter;
use super::regs::{
    DOR0, MPCM0, RXC0, RXCIE0, RXEN0, TXC0, TXEN0, U2X0, UBRR0H, UBRR0L, UCSR0A, UCSR0B, UCSR0C,
    UCSZ02, UDR0, UDRE0, UDRIE0, UPM0, USBS0,
};
use sim_base::Cycles;
use sim_base::Noise;

/// Expires at the end of the character on TXD.
const SEND: Timer = Timer::UartSend;
/// Expires at the end of the character on RXD.
const RECEIVE: Timer = Timer::UartReceive;

/// Most received bytes that wait for the program (section 20.7.3: "two level FIFO").
const RECEIVE_FIFO: usize = 2;

/// USART0 and the lines TXD and RXD.
#[derive(Debug, Default)]
pub(super) struct Uart {
    sending: Option<u8>,
    send_buffer: Option<u8>,
    sent: Vec<(Cycles, u8)>,
    line: VecDeque<u8>,
    arriving: Option<u8>,
    /// Byte that waits in the receive shift register, because the FIFO is full.
    waiting: Option<u8>,
    received: VecDeque<u8>,
    overruns: u32,
    /// Characters that began since the last `take_trace`, after its first call.
    trace: Option<Vec<SerialCharacter>>,
}

impl Peripheral for RefCell<Uart> {
    fn for_chip(_: Chip) -> RefCell<Uart> {
        RefCell::default()
    }

    fn writes(&self) -> &'static [u16] {
        &[UCSR0A, UCSR0B, UCSR0C, UBRR0L, UDR0]
    }

    fn reads(&self) -> &'static [u16] {
        &[UCSR0A, UDR0]
    }

    fn timers(&self) -> &'static [Timer] {
        &[SEND, RECEIVE]
    }

    fn write(&self, base: &Base, address: u16, value: u8) {
        match address {
            UDR0 => self.borrow_mut().write_data(base, value),
            UCSR0A => self.borrow_mut().write_status(base, value),
            UCSR0B => self.borrow_mut().write_control(base, value),
            // simavr's handlers for the rate and the frame format are not called.
            _ => base.core.set(address, value),
        }
    }

    fn read(&self, base: &Base, address: u16) -> u8 {
        match address {
            UDR0 => self.borrow_mut().read_data(base),
            _ => base.core.get(address),
        }
    }

    fn expire(&self, base: &Base, timer: Timer, at: Cycles) {
        if timer == SEND {
            self.borrow_mut().sent_byte(base, at);
        } else {
            self.borrow_mut().received_byte(base, at);
        }
    }

    fn reset(&self, base: &Base, _: &mut Noise) {
        self.borrow_mut().reset(base);
    }

    fn interrupt_returns(&self, base: &Base) {
        self.borrow().request_levels(base);
    }
}

impl Uart {
    /// Resets the UART. Bytes in the chip are lost; bytes on the line wait for the receiver.
    pub fn reset(&mut self, base: &Base) {
        if let Some(trace) = self.trace.as_mut().filter(|_| self.sending.is_some()) {
            let start = base.now();
            trace.push(SerialCharacter {
                to_chip: false,
                start,
                cycles_per_bit: 0,
                levels: 0,
                bits: 0,
            });
        }
        *self = Uart {
            trace: self.trace.take(),
            sent: std::mem::take(&mut self.sent),
            line: std::mem::take(&mut self.line),
            overruns: self.overruns,
            ..Uart::default()
        };
        base.core.set(UCSR0A, UDRE0);
        base.core.set(UCSR0B, 0);
    }

    /// Duration of a bit in CPU cycles.
    pub fn cycles_per_bit(base: &Base) -> u64 {
        Uart::character(base, 0).cycles_per_bit
    }

    /// Duration of a character in CPU cycles, from the start bit to the last stop bit.
    pub fn cycles_per_byte(base: &Base) -> u64 {
        let character = Uart::character(base, 0);
        u64::from(character.bits) * character.cycles_per_bit
    }

    /// The character for a byte that starts now, in the frame format and at the rate that the
    /// program has set.
    fn character(base: &Base, byte: u8) -> SerialCharacter {
        let core = &base.core;
        let (a, b, c) = (core.get(UCSR0A), core.get(UCSR0B), core.get(UCSR0C));
        let divisor =
            u64::from(u16::from_le_bytes([core.get(UBRR0L), core.get(UBRR0H) & 0x0F])) + 1;
        let cycles_per_bit = divisor * if a & U2X0 != 0 { 8 } else { 16 };
        let data_bits = if b & UCSZ02 != 0 { 9 } else { 5 + ((c >> 1) & 0b11) };
        let stop_bits = if c & USBS0 != 0 { 2 } else { 1 };
        let data = u16::from(byte) & ((1 << data_bits) - 1);
        let (mut levels, mut bits) = (data << 1, 1 + data_bits);
        if c & UPM0 != 0 {
            // UPM0 is 3 for odd parity, and 2 for even parity.
            let odd = u16::from(c & UPM0 == UPM0);
            levels |= (data.count_ones() as u16 & 1 ^ odd) << bits;
            bits += 1;
        }
        levels |= ((1 << stop_bits) - 1) << bits;
        SerialCharacter {
            to_chip: false,
            start: base.now(),
            cycles_per_bit,
            levels,
            bits: bits + stop_bits,
        }
    }

    /// Writes UDR0.
    pub fn write_data(&mut self, base: &Base, value: u8) {
        if base.core.get(UCSR0B) & TXEN0 == 0 {
            return;
        }
        if self.sending.is_none() {
            self.start_sending(base, value, base.now());
        } else if self.send_buffer.is_none() {
            self.send_buffer = Some(value);
            base.core.clear(Vector::UsartDataRegisterEmpty);
            base.core.clear_bits(UCSR0A, UDRE0);
        } else {
            base.report_violation(
                "UDR0 is written while it is full (UDRE0 is 0): the byte is lost",
            );
        }
        self.request_levels(base);
    }

    /// Reads UDR0.
    pub fn read_data(&mut self, base: &Base) -> u8 {
        let value = self.received.pop_front().unwrap_or_default();
        base.core.clear_bits(UCSR0A, DOR0);
        self.received.extend(self.waiting.take());
        if self.received.is_empty() {
            base.core.clear(Vector::UsartReceiveComplete);
            base.core.clear_bits(UCSR0A, RXC0);
        }
        value
    }

    /// Writes UCSR0A. A one clears TXC0; the other flags are read-only.
    pub fn write_status(&mut self, base: &Base, value: u8) {
        let writable = U2X0 | MPCM0;
        let status = base.core.get(UCSR0A);
        base.core.set(UCSR0A, status & !writable | value & writable);
        if value & TXC0 != 0 {
            base.core.clear(Vector::UsartTransmitComplete);
            base.core.clear_bits(UCSR0A, TXC0);
        }
    }

    /// Writes UCSR0B. Switching the receiver off empties its buffers.
    pub fn write_control(&mut self, base: &Base, value: u8) {
        let core = &base.core;
        core.set(UCSR0B, value);
        if value & RXEN0 == 0 {
            self.arriving = None;
            self.waiting = None;
            self.received.clear();
            base.unschedule(RECEIVE);
            core.clear(Vector::UsartReceiveComplete);
            core.clear_bits(UCSR0A, RXC0 | DOR0);
        }
        // The transmitter still sends the bytes that it has (section 20.6.5); write_data checks
        // TXEN0.
        self.start_receiving(base, base.now());
        self.request_levels(base);
    }

    /// Handles the end of the last stop bit of a byte on TXD.
    pub fn sent_byte(&mut self, base: &Base, at: Cycles) {
        let core = &base.core;
        if let Some(byte) = self.sending.take() {
            self.sent.push((at, byte));
        }
        if let Some(next) = self.send_buffer.take() {
            self.start_sending(base, next, at);
            core.set_bits(UCSR0A, UDRE0);
        } else {
            core.raise(Vector::UsartTransmitComplete);
        }
        self.request_levels(base);
    }

    /// Handles the end of the last stop bit of a byte on RXD.
    pub fn received_byte(&mut self, base: &Base, at: Cycles) {
        if let Some(byte) = self.arriving.take() {
            if self.received.len() < RECEIVE_FIFO {
                self.received.push_back(byte);
            } else {
                self.waiting = Some(byte);
            }
            base.core.set_bits(UCSR0A, RXC0);
        }
        self.start_receiving(base, at);
        self.request_levels(base);
    }

    /// Requests the interrupts of RXC0 and UDRE0 if they are set (sections 20.7.3, 20.6.3).
    pub fn request_levels(&self, base: &Base) {
        let core = &base.core;
        let (status, control) = (core.get(UCSR0A), core.get(UCSR0B));
        if status & RXC0 != 0 && control & RXCIE0 != 0 {
            core.raise(Vector::UsartReceiveComplete);
        }
        if status & UDRE0 != 0 && control & UDRIE0 != 0 {
            core.raise(Vector::UsartDataRegisterEmpty);
        }
    }

    /// Adds bytes from outside to the line.
    pub fn send_to_chip(&mut self, base: &Base, bytes: &[u8]) {
        self.line.extend(bytes);
        self.start_receiving(base, base.now());
    }

    /// Drops the bytes from outside that have not begun to arrive.
    pub fn discard_to_chip(&mut self) {
        self.line.clear();
    }

    /// Removes and returns the bytes that the program has sent, each with the time of the end of
    /// its last stop bit.
    pub fn take_sent(&mut self) -> Vec<(Cycles, u8)> {
        std::mem::take(&mut self.sent)
    }

    /// Removes and returns the characters that began on both lines since the last call. The first
    /// call starts the recording.
    pub fn take_trace(&mut self) -> Vec<SerialCharacter> {
        self.trace.replace(Vec::new()).unwrap_or_default()
    }

    /// Number of bytes from outside that have not arrived yet.
    pub fn unsent_to_chip(&self) -> usize {
        self.line.len() + usize::from(self.arriving.is_some())
    }

    /// Number of bytes that were lost because the program read too late.
    pub fn overruns(&self) -> u32 {
        self.overruns
    }

    fn start_sending(&mut self, base: &Base, value: u8, at: Cycles) {
        self.sending = Some(value);
        let end = self.begin(base, value, at, false);
        base.schedule(SEND, end);
    }

    /// Begins a character on a line. Returns the time of its end.
    fn begin(&mut self, base: &Base, byte: u8, start: Cycles, to_chip: bool) -> Cycles {
        let character = SerialCharacter { to_chip, start, ..Uart::character(base, byte) };
        if let Some(trace) = &mut self.trace {
            trace.push(character);
        }
        start + u64::from(character.bits) * character.cycles_per_bit
    }

    fn start_receiving(&mut self, base: &Base, at: Cycles) {
        if self.arriving.is_some() || base.core.get(UCSR0B) & RXEN0 == 0 {
            return;
        }
        let Some(byte) = self.line.pop_front() else {
            return;
        };
        // > A Data OverRun occurs when the receive buffer is full (two characters), it is a new
        // > character waiting in the Receive Shift Register, and a new start bit is detected.
        // > (section 20.11.2)
        if self.waiting.take().is_some() {
            base.core.set_bits(UCSR0A, DOR0);
            self.overruns += 1;
        }
        self.arriving = Some(byte);
        let end = self.begin(base, byte, at, true);
        base.schedule(RECEIVE, end);
    }
}
