//! The ports: PINx, DDRx, PORTx, and what a change of a pin's level causes (sections 13 and 14).
//!
//! PINx has the levels that watchers and interrupts were told last.

use super::Own;
use crate::engine::Vector;
use crate::regs::{self, PORT_D, port_register};

/// Bits of port D that are INT0 and INT1.
const INT_BITS: [u8; 2] = [2, 3];

impl Own {
    /// Writes PINx, DDRx or PORTx.
    pub(super) fn write_port(&self, address: u16, value: u8) {
        let port = usize::from((address - regs::PINB) / 3);
        let port_register = port_register(port);
        if address == port_register - 2 {
            self.set(port_register, self.get(port_register) ^ value);
        } else {
            self.set(address, value);
        }
    }

    /// Sets the levels of a port's pins. Returns those that have changed.
    pub fn set_levels(&self, port: usize, levels: u8) -> u8 {
        let pin_register = port_register(port) - 2;
        let changed = self.get(pin_register) ^ levels;
        if changed == 0 {
            return 0;
        }
        self.set(pin_register, levels);
        if changed & self.get(regs::PCMSK0 + port as u16) != 0 {
            self.raise(Vector::PinChange(port as u8));
        }
        if port == PORT_D {
            for (n, bit) in INT_BITS.into_iter().enumerate() {
                let rises = levels & 1 << bit != 0;
                let is_edge = match self.sense(n as u8) {
                    0 => false,
                    1 => true,
                    2 => !rises,
                    _ => rises,
                };
                if changed & 1 << bit != 0 && is_edge {
                    self.raise(Vector::External(n as u8));
                }
            }
        }
        changed
    }

    /// ISCn1:0 in EICRA.
    fn sense(&self, n: u8) -> u8 {
        self.get(regs::EICRA) >> (2 * n) & 0b11
    }

    /// The number of the enabled external interrupt whose low level requests it.
    #[inline]
    pub(super) fn low_level(&self) -> Option<u8> {
        let enabled = self.get(regs::EIMSK);
        if enabled == 0 {
            return None;
        }
        (0..2).find(|&n| {
            let is_low = self.get(regs::PIND) & 1 << INT_BITS[usize::from(n)] == 0;
            enabled & 1 << n != 0 && self.sense(n) == 0 && is_low
        })
    }

    /// A one in `ones` clears its flag in PCIFR.
    pub(super) fn clear_pin_change_flags(&self, ones: u8) {
        (0..3).filter(|port| ones & 1 << port != 0).for_each(|port| {
            self.clear(Vector::PinChange(port));
        });
    }
}
