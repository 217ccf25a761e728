//! What a program uses of the chip that this crate does not model exactly.
//!
//! Each feature is reported once, when the program first writes or reads the register that turns it
//! on. `docs/peripherals.md` lists all of them, and also the deviations that no register shows.

use super::core::Core;
use super::regs::{self, ADATE, ADCSRB, ADSC, ADTS, MUX};
use super::sleep::Mode;
use sim_base::Cycles;

/// A feature of the chip that the program uses and that is not modelled exactly.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Unmodelled {
    /// Time of the first use.
    pub at: Cycles,
    /// The feature, and what the model does instead.
    pub text: &'static str,
}

const CLKPR: u16 = 0x61;
const CLKPS: u8 = 0b1111;
const ACSR: u16 = 0x50;
const ACD: u8 = 1 << 7;
/// ACBG, ACIE, ACIC and ACIS1:0.
const COMPARATOR_IN_USE: u8 = 0b0100_1111;
const ACME: u8 = 1 << 6;
const TEMPERATURE_SENSOR: u8 = 8;
/// The address in TWAR.
const TWA: u8 = 0xFE;
const UMSEL0: u8 = 0b11 << 6;
/// PRADC, PRUSART0, PRSPI and PRTWI.
const PRR_WITHOUT_TIMERS: u8 = 0b1000_0111;

/// Registers whose writes can turn on such a feature.
#[allow(dead_code, reason = "a build may be without simavr, which has to be told of them")]
pub(super) const WRITES: &[u16] = &[
    CLKPR,
    ACSR,
    regs::ADCSRA,
    ADCSRB,
    regs::TWAR,
    regs::PRR,
    regs::UCSR0B,
    regs::UCSR0C,
    regs::SPCR,
    regs::TCCR0B,
    regs::TCCR1B,
    regs::TCCR2B,
    regs::ASSR,
];
/// Registers of which a read is a use.
pub(super) const READS: &[u16] = &[ACSR];

const COMPARATOR: &str = "the analogue comparator: both its inputs are at 0 V";
const AUTO_TRIGGER: &str =
    "the ADC's auto trigger by another source than itself (ADTS): no event starts a conversion";
const RESERVED_MODE: &str = "a reserved mode of a timer (WGM): it counts as Normal mode";
const EXTERNAL_CLOCK: &str = "a clock from a pin, T0 or T1: the timer stops";

/// The feature that a write of `value` to a register turns on.
pub(super) fn used_by_write(core: &Core, address: u16, value: u8) -> Option<&'static str> {
    let is_used = |is_used: bool, text| is_used.then_some(text);
    match address {
        CLKPR => is_used(value & CLKPS != 0, "CLKPR: the clock stays at 16 MHz"),
        ACSR => is_used(value & ACD == 0 && value & COMPARATOR_IN_USE != 0, COMPARATOR),
        regs::ADCSRA if value & ADATE != 0 && core.get(ADCSRB) & ADTS != 0 => Some(AUTO_TRIGGER),
        regs::ADCSRA => is_used(
            value & ADSC != 0 && core.get(regs::ADMUX) & MUX == TEMPERATURE_SENSOR,
            "the ADC's temperature sensor: it reads 0",
        ),
        ADCSRB if value & ACME != 0 => Some(COMPARATOR),
        ADCSRB => is_used(value & ADTS != 0 && core.get(regs::ADCSRA) & ADATE != 0, AUTO_TRIGGER),
        regs::TWAR => is_used(
            value & TWA != 0 && value & TWA != TWA,
            "the TWI (I2C) as a slave: nothing addresses it",
        ),
        regs::PRR => is_used(
            value & PRR_WITHOUT_TIMERS != 0,
            "PRR for the ADC, USART0, the SPI or the TWI: they go on",
        ),
        regs::UCSR0B => {
            is_used(value & regs::UCSZ02 != 0, "characters of nine bits on USART0: it has eight")
        }
        regs::UCSR0C => is_used(value & UMSEL0 != 0, "a synchronous mode of USART0"),
        regs::SPCR => is_used(
            value & regs::SPE != 0 && value & regs::MSTR == 0,
            "the SPI as a slave: nothing selects it",
        ),
        regs::TCCR0B => timer(value, is_reserved_8(core.get(regs::TCCR0A), value)),
        regs::TCCR1B => {
            timer(value, value & 0b1_1000 == 0b1_1000 && core.get(regs::TCCR1A) & 0b11 == 1)
        }
        regs::TCCR2B => {
            is_used(value & CS != 0 && is_reserved_8(core.get(regs::TCCR2A), value), RESERVED_MODE)
        }
        regs::ASSR => {
            is_used(value & regs::AS2 != 0, "Timer2 with its own crystal (AS2): the timer stops")
        }
        _ => None,
    }
}

/// Clock select bits of TCCRnB.
const CS: u8 = 0b111;

/// Modes 4 and 6 (tables 15-8 and 18-8).
fn is_reserved_8(tccra: u8, tccrb: u8) -> bool {
    tccrb & 1 << 3 != 0 && tccra & 1 == 0
}

/// Checks CSn2:0 of Timer0 or Timer1.
fn timer(tccrb: u8, is_reserved: bool) -> Option<&'static str> {
    match tccrb & CS {
        0 => None,
        6 | 7 => Some(EXTERNAL_CLOCK),
        _ => is_reserved.then_some(RESERVED_MODE),
    }
}

/// The feature that a read of a register in [`READS`] uses.
pub(super) fn used_by_read(_address: u16) -> &'static str {
    COMPARATOR
}

/// The feature that SLEEP uses with this value of SMCR.
pub(super) fn used_by_sleep(core: &Core, smcr: u8) -> Option<&'static str> {
    let is_set = |register: u16, bit: u8| core.get(register) & bit != 0;
    let sends = is_set(regs::UCSR0B, regs::TXEN0) && !is_set(regs::UCSR0A, regs::UDRE0);
    let mode = Mode::of(smcr)?;
    let is_busy = sends
        || is_set(regs::ADCSRA, regs::ADSC) && !mode.converts
        || is_set(regs::TWCR, regs::TWEN) && !is_set(regs::TWCR, regs::TWINT);
    is_busy.then_some(
        "a sleep in which clocks stand, while USART0, the ADC or the TWI is at work: it goes on",
    )
}
