//! USART0 in asynchronous mode (datasheet section 20), with its exact timing and buffers.
//!
//! simavr counts 11 bits for a byte of 8N1, has one transmit buffer instead of two, and never loses
//! a received byte. This model follows the datasheet: a shift register and UDR0 to send, a shift
//! register and a FIFO of two bytes to receive, and data overrun. The other end sends back to back
//! while the receiver is on, at the rate that the program has set, or at one of its own. Beyond the
//! tolerance of the receiver a character is read as its samples fall, with a framing error if the
//! stop bit is 0. Not modelled: synchronous modes, parity errors, nine data bits, the pins.

use std::cell::RefCell;
use std::collections::VecDeque;

use super::base::{Base, Peripheral, Timer};
use super::chip::Chip;
use super::core::Vector;
use super::processor::SerialCharacter;
use super::regs::{
    DOR0, FE0, MPCM0, RXC0, RXCIE0, RXEN0, TXC0, TXEN0, U2X0, UBRR0H, UBRR0L, UCSR0A, UCSR0B,
    UCSR0C, UCSZ02, UDR0, UDRE0, UDRIE0, UPM0, USBS0,
};
use sim_base::{Cycles, Noise};

/// Expires at the end of the character on TXD.
const SEND: Timer = Timer::UartSend;
/// Expires at the end of the character on RXD.
const RECEIVE: Timer = Timer::UartReceive;

/// Most received bytes that wait for the program (section 20.7.3: "two level FIFO").
const RECEIVE_FIFO: usize = 2;
/// Difference between sender and receiver in percent up to which all samples of a character fall
/// into its bits: half a bit in 9.5, less an eighth for the rate of sampling (section 20.8.3).
const TOLERANCE_PERCENT: u64 = 4;

/// A character as the receiver has it.
#[derive(Clone, Copy, Debug)]
struct Received {
    byte: u8,
    /// The stop bit is 0.
    has_frame_error: bool,
}

/// True if a receiver at `own` bits per second reads what is sent at `sent` bits per second.
pub fn rates_match(sent: u64, own: u64) -> bool {
    sent.abs_diff(own) * 100 <= own * TOLERANCE_PERCENT
}

/// What a receiver at `own` bits per second makes of a character of 8N1 that is sent at `sent` bits
/// per second: it samples the middle of its own bits. After the character the line is idle.
fn read_at(byte: u8, sent: u64, own: u64) -> Received {
    if rates_match(sent, own) {
        return Received { byte, has_frame_error: false };
    }
    let levels = u16::from(byte) << 1;
    let is_high = |bit: u64| {
        let at = (2 * bit + 1) * sent / (2 * own);
        at >= 9 || levels >> at & 1 == 1
    };
    let bits = (0..8).map(|bit| u8::from(is_high(bit + 1)) << bit);
    Received { byte: bits.sum(), has_frame_error: !is_high(9) }
}

/// The byte of [`Avr::serial_take`](super::Avr::serial_take) that a receiver at `own` bits per
/// second reads if the chip sends at `sent` bits per second.
pub fn byte_read_at(byte: u8, sent: u64, own: u64) -> u8 {
    read_at(byte, sent, own).byte
}

/// USART0 and the lines TXD and RXD.
#[derive(Debug, Default)]
pub(super) struct Uart {
    sending: Option<u8>,
    send_buffer: Option<u8>,
    sent: Vec<(Cycles, u8)>,
    line: VecDeque<u8>,
    /// Bits per second of the other end; `None` if they are those of the program.
    line_rate: Option<u64>,
    arriving: Option<Received>,
    /// Character that waits in the receive shift register, because the FIFO is full.
    waiting: Option<Received>,
    received: VecDeque<Received>,
    overruns: u32,
    /// Bits per second of the last character that the program has sent.
    sent_rate: u64,
    /// Last time at which the program looked for a character and found none.
    polled_at: Option<Cycles>,
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
            UCSR0A => self.borrow_mut().read_status(base),
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
            line_rate: self.line_rate,
            overruns: self.overruns,
            sent_rate: self.sent_rate,
            ..Uart::default()
        };
        base.core.set(UCSR0A, UDRE0);
        base.core.set(UCSR0B, 0);
    }

    /// Duration of a bit in CPU cycles.
    pub fn cycles_per_bit(base: &Base) -> u64 {
        Uart::character(base, 0).cycles_per_bit
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
        let value = self.received.pop_front().map_or(0, |received| received.byte);
        base.core.clear_bits(UCSR0A, DOR0);
        self.received.extend(self.waiting.take());
        self.show_frame_error(base);
        if self.received.is_empty() {
            base.core.clear(Vector::UsartReceiveComplete);
            base.core.clear_bits(UCSR0A, RXC0);
        }
        value
    }

    /// Reads UCSR0A.
    pub fn read_status(&mut self, base: &Base) -> u8 {
        let status = base.core.get(UCSR0A);
        if status & RXC0 == 0 && self.sending.is_none() {
            self.polled_at = Some(base.now());
        }
        status
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
            core.clear_bits(UCSR0A, RXC0 | FE0 | DOR0);
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
        if let Some(character) = self.arriving.take() {
            if self.received.len() < RECEIVE_FIFO {
                self.received.push_back(character);
            } else {
                self.waiting = Some(character);
            }
            base.core.set_bits(UCSR0A, RXC0);
            self.show_frame_error(base);
        }
        self.start_receiving(base, at);
        self.request_levels(base);
    }

    /// FE0 is that of the character that the program reads next (section 20.11.2).
    fn show_frame_error(&self, base: &Base) {
        if self.received.front().is_some_and(|received| received.has_frame_error) {
            base.core.set_bits(UCSR0A, FE0);
        } else {
            base.core.clear_bits(UCSR0A, FE0);
        }
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

    /// Sets the bits per second of the other end; `None` for those of the program.
    pub fn set_line_rate(&mut self, bits_per_second: Option<u64>) {
        self.line_rate = bits_per_second;
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

    /// True if the program has looked for a character since `since`, and none is on its way in
    /// either direction.
    pub fn is_polled(&self, since: Cycles) -> bool {
        self.polled_at.is_some_and(|at| at >= since)
            && self.sending.is_none()
            && self.received.is_empty()
            && self.unsent_to_chip() == 0
    }

    /// Bits per second of the last character that the program has sent.
    pub fn sent_rate(&self) -> u64 {
        self.sent_rate
    }

    /// Number of bytes that were lost because the program read too late.
    pub fn overruns(&self) -> u32 {
        self.overruns
    }

    fn start_sending(&mut self, base: &Base, value: u8, at: Cycles) {
        self.sending = Some(value);
        let character = SerialCharacter { start: at, ..Uart::character(base, value) };
        self.sent_rate = base.silicon.get().rate_on_line(character.cycles_per_bit);
        let end = self.begin(character);
        base.schedule(SEND, end);
    }

    /// Begins a character on a line. Returns the time of its end.
    fn begin(&mut self, character: SerialCharacter) -> Cycles {
        if let Some(trace) = &mut self.trace {
            trace.push(character);
        }
        character.start + u64::from(character.bits) * character.cycles_per_bit
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
        let mut character =
            SerialCharacter { to_chip: true, start: at, ..Uart::character(base, byte) };
        let silicon = base.silicon.get();
        let own = silicon.rate_on_line(character.cycles_per_bit);
        let own_end = at + u64::from(character.bits) * character.cycles_per_bit;
        let rate = self.line_rate.filter(|rate| !rates_match(*rate, own)).unwrap_or(own);
        if rate != own {
            character.cycles_per_bit = silicon.rate_on_line(rate).max(1);
        }
        self.arriving = Some(read_at(byte, rate, own));
        let mut end = self.begin(character);
        // The receiver takes what begins before its stop bit for a part of this character.
        while end < own_end && self.line.pop_front().is_some() {
            end += u64::from(character.bits) * character.cycles_per_bit;
        }
        base.schedule(RECEIVE, end.max(own_end));
    }
}
