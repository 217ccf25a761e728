//! The UART of the serial monitor, 115200 baud 8N1, polled.

use super::chip::{CLOCK_HZ, USART0};

const BAUD: u32 = 115_200;

/// Divisor with U2X. It gives 117,647 baud, 2.1 % too fast. Without U2X the rate would be 3.5 % too
/// slow.
const UBRR: u16 = (CLOCK_HZ / 8 / BAUD - 1) as u16;

/// The UART.
pub struct Serial {
    usart: USART0,
}

impl Serial {
    pub(super) fn new(usart: USART0) -> Self {
        usart.ubrr0.write(|w| w.bits(UBRR));
        usart.ucsr0a.write(|w| w.u2x0().set_bit());
        usart.ucsr0c.write(|w| w.ucsz0().chr8());
        usart.ucsr0b.write(|w| w.rxen0().set_bit().txen0().set_bit());
        Self { usart }
    }

    /// True if the UART can accept a byte now.
    pub fn can_send(&self) -> bool {
        self.usart.ucsr0a.read().udre0().bit_is_set()
    }

    /// Sends a byte, but not a 0. Call it only when the UART [can](Self::can_send) accept a byte.
    pub fn send(&mut self, byte: u8) {
        if byte != 0 {
            self.usart.udr0.write(|w| w.bits(byte));
        }
    }

    /// Returns the received byte, if there is one.
    pub fn receive(&mut self) -> Option<u8> {
        let received = self.usart.ucsr0a.read().rxc0().bit_is_set();
        received.then(|| self.usart.udr0.read().bits())
    }
}
