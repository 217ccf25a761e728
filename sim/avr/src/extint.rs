//! The external interrupts INT0 and INT1 (datasheet section 13): edges while the interrupt is
//! masked.

use super::base::{Base, Peripheral};
use super::chip::Chip;
use super::core::Vector;
use super::regs::{EIFR, EIMSK};

/// The model of INT0 and INT1. Its state is in EIMSK and EIFR.
pub(super) struct ExternalInterrupts;

impl Peripheral for ExternalInterrupts {
    fn for_chip(_: Chip) -> ExternalInterrupts {
        ExternalInterrupts
    }

    fn writes(&self) -> &'static [u16] {
        &[EIFR, EIMSK]
    }

    fn write(&self, base: &Base, address: u16, value: u8) {
        let core = &base.core;
        match address {
            // simavr loses an edge that comes while its interrupt is masked.
            // > [...] an edge [...] triggers an interrupt request, INTF0 becomes set [...]. If the
            // > I-bit in SREG and the INT0 bit in EIMSK are set (one), the MCU will jump to the
            // > corresponding Interrupt Vector. (section 13.2.3)
            EIMSK => {
                core.set(EIMSK, value);
                let flags = core.get(EIFR);
                for n in [0, 1].into_iter().filter(|n| value & flags & 1 << n != 0) {
                    core.raise(Vector::External(n));
                }
            }
            // > Alternatively, the flag can be cleared by writing a logical one to it. (section
            // > 13.2.3)
            _ => {
                for n in [0, 1].into_iter().filter(|n| value & 1 << n != 0) {
                    core.clear(Vector::External(n));
                }
            }
        }
    }
}
