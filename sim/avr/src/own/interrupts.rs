//! The interrupts: their vectors, flags and enable bits, in order of their priority.
//!
//! Source: Atmel 2545, section 12.4 (vectors) and the register descriptions.

use std::cell::Cell;

use super::Own;
use crate::engine::Vector;
use crate::regs;

/// What an interrupt's entry does to its flag.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Entry {
    ClearsFlag,
    /// The condition holds until the program ends it.
    KeepsFlag,
}

/// A source of interrupts: register and mask of its flag (address 0: it has none) and of its enable
/// bit.
#[derive(Debug, Clone, Copy)]
struct Source {
    flag: (u16, u8),
    enable: (u16, u8),
    entry: Entry,
}

const fn source(flag: (u16, u8), enable: (u16, u8), entry: Entry) -> Source {
    Source { flag, enable, entry }
}

const NO_FLAG: (u16, u8) = (0, 0);
const UNUSED: Source = source(NO_FLAG, (0, 0), Entry::KeepsFlag);

/// The sources by the number of their vector.
const SOURCES: [Source; 26] = {
    use Entry::{ClearsFlag, KeepsFlag};
    [
        UNUSED,
        source((regs::EIFR, 1), (regs::EIMSK, 1), ClearsFlag),
        source((regs::EIFR, 2), (regs::EIMSK, 2), ClearsFlag),
        source((regs::PCIFR, 1), (regs::PCICR, 1), ClearsFlag),
        source((regs::PCIFR, 2), (regs::PCICR, 2), ClearsFlag),
        source((regs::PCIFR, 4), (regs::PCICR, 4), ClearsFlag),
        source((regs::WDTCSR, regs::WDIF), (regs::WDTCSR, regs::WDIE), ClearsFlag),
        source((regs::TIFR2, 2), (regs::TIMSK2, 2), ClearsFlag),
        source((regs::TIFR2, 4), (regs::TIMSK2, 4), ClearsFlag),
        source((regs::TIFR2, 1), (regs::TIMSK2, 1), ClearsFlag),
        source((regs::TIFR1, 0x20), (regs::TIMSK1, 0x20), ClearsFlag),
        source((regs::TIFR1, 2), (regs::TIMSK1, 2), ClearsFlag),
        source((regs::TIFR1, 4), (regs::TIMSK1, 4), ClearsFlag),
        source((regs::TIFR1, 1), (regs::TIMSK1, 1), ClearsFlag),
        source((regs::TIFR0, 2), (regs::TIMSK0, 2), ClearsFlag),
        source((regs::TIFR0, 4), (regs::TIMSK0, 4), ClearsFlag),
        source((regs::TIFR0, 1), (regs::TIMSK0, 1), ClearsFlag),
        source((regs::SPSR, regs::SPIF), (regs::SPCR, regs::SPIE), ClearsFlag),
        source((regs::UCSR0A, regs::RXC0), (regs::UCSR0B, regs::RXCIE0), KeepsFlag),
        source((regs::UCSR0A, regs::UDRE0), (regs::UCSR0B, regs::UDRIE0), KeepsFlag),
        source((regs::UCSR0A, regs::TXC0), (regs::UCSR0B, regs::TXCIE0), ClearsFlag),
        source((regs::ADCSRA, regs::ADIF), (regs::ADCSRA, regs::ADIE), ClearsFlag),
        source(NO_FLAG, (regs::EECR, regs::EERIE), KeepsFlag),
        UNUSED,
        source((regs::TWCR, regs::TWINT), (regs::TWCR, regs::TWIE), KeepsFlag),
        source(NO_FLAG, (regs::SPMCSR, regs::SPMIE), KeepsFlag),
    ]
};

/// Number of a vector.
fn number(vector: Vector) -> usize {
    match vector {
        Vector::External(n) => 1 + usize::from(n),
        Vector::PinChange(port) => 3 + usize::from(port),
        Vector::Watchdog => WATCHDOG,
        Vector::Timer(timer, flag) => {
            let [compare_a, compare_b, overflow] =
                [[14, 15, 16], [11, 12, 13], [7, 8, 9]][usize::from(timer)];
            match flag {
                0b0001 => overflow,
                0b0010 => compare_a,
                0b0100 => compare_b,
                _ => 10,
            }
        }
        Vector::SpiTransferComplete => 17,
        Vector::UsartReceiveComplete => 18,
        Vector::UsartDataRegisterEmpty => 19,
        Vector::UsartTransmitComplete => 20,
        Vector::Adc => 21,
        Vector::EepromReady => 22,
        Vector::Twi => 24,
        Vector::SpmReady => 25,
    }
}

const WATCHDOG: usize = 6;

/// The requested interrupts, a bit for each vector, enabled or not.
#[derive(Debug, Default)]
pub(super) struct Requests(Cell<u32>);

impl Requests {
    /// Removes all requests.
    pub fn reset(&self) {
        self.0.set(0);
    }
}

impl Own {
    /// Sets an interrupt's flag, and requests it.
    pub fn raise(&self, vector: Vector) {
        let number = number(vector);
        let (address, mask) = SOURCES[number].flag;
        if address != 0 {
            self.set(address, self.get(address) | mask);
        }
        self.requests.0.set(self.requests.0.get() | 1 << number);
        self.has_none_pending.set(false);
    }

    /// Clears an interrupt's flag and its request.
    pub fn clear(&self, vector: Vector) {
        let (address, mask) = SOURCES[number(vector)].flag;
        if address != 0 {
            self.set(address, self.get(address) & !mask);
        }
        self.withdraw(vector);
    }

    /// Removes an interrupt's request.
    pub fn withdraw(&self, vector: Vector) {
        self.requests.0.set(self.requests.0.get() & !(1 << number(vector)));
    }

    /// True if an enabled interrupt is requested.
    #[inline]
    pub fn has_pending(&self) -> bool {
        !self.has_none_pending.get() && self.finds_pending()
    }

    fn finds_pending(&self) -> bool {
        let is_pending = self.pending().is_some() || self.low_level().is_some();
        self.has_none_pending.set(!is_pending);
        is_pending
    }

    /// The vector of the requested, enabled interrupt of the highest priority.
    fn pending(&self) -> Option<usize> {
        let mut requested = self.requests.0.get();
        while requested != 0 {
            let number = requested.trailing_zeros() as usize;
            let (address, mask) = SOURCES[number].enable;
            if self.get(address) & mask != 0 {
                return Some(number);
            }
            requested &= requested - 1;
        }
        None
    }

    /// Removes and returns the vector of the pending interrupt, for its entry.
    pub fn take_interrupt(&self) -> Option<u8> {
        if !self.has_pending() {
            return None;
        }
        let level = self.low_level().map(|n| number(Vector::External(n)));
        let number = level.into_iter().chain(self.pending()).min()?;
        self.requests.0.set(self.requests.0.get() & !(1 << number));
        let Source { flag: (address, mask), entry, .. } = SOURCES[number];
        if entry == Entry::ClearsFlag {
            self.set(address, self.get(address) & !mask);
        }
        let control = self.get(regs::WDTCSR);
        if number == WATCHDOG && control & regs::WDE != 0 {
            // > [...] by executing the corresponding interrupt [...] WDIE and WDIF are cleared
            // > automatically by hardware (section 11.9.2, Interrupt and System Reset Mode)
            self.set(regs::WDTCSR, control & !regs::WDIE);
        }
        Some(number as u8)
    }
}
