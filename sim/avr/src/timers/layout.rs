//! The registers, pins and interrupts of the three timers.
//!
//! Source: Atmel 2545, sections 15.9, 16.11 and 18.11 ("Register Description"), 14.3 (pins), 17 and
//! 18.10 (prescalers), 10.11.3 (PRR).

use super::counter::{ICF, OCFA, TOV};
use super::modes::Mode;
use crate::core::Core;
use crate::regs::{self, PORT_B, PORT_D};

/// A pin, as the index of its port and its bit.
pub type PinOf = (usize, u8);

/// What differs between the timers, apart from their addresses.
#[derive(Debug)]
pub struct Layout {
    /// 0, 1 or 2.
    pub number: u8,
    pub tccra: u16,
    pub tccrb: u16,
    /// Register with FOCnA in bit 7 and FOCnB in bit 6.
    pub foc: u16,
    /// TCNTn, or its low byte.
    pub tcnt: u16,
    /// OCRnA and OCRnB, or their low bytes.
    pub ocr: [u16; 2],
    pub timsk: u16,
    pub tifr: u16,
    /// True for Timer1: 16 bits, of which the high byte is at the next address; and ICR1.
    pub is_wide: bool,
    /// CPU cycles of a timer clock, by CSn2:0. 0: stopped, also for the clock on the pin Tn.
    pub dividers: [u64; 8],
    /// Bit of GTCCR that resets the prescaler.
    pub prescaler_reset: u8,
    /// Bit of PRR that stops the timer.
    pub power_reduction: u8,
    /// OCnA and OCnB.
    pub pins: [PinOf; 2],
}

/// Registers whose writes the timers handle.
pub const WRITES: &[u16] = &[
    regs::PINB,
    regs::DDRB,
    regs::PORTB,
    regs::PIND,
    regs::DDRD,
    regs::PORTD,
    regs::TIFR0,
    regs::TIFR1,
    regs::TIFR2,
    regs::GTCCR,
    regs::TCCR0A,
    regs::TCCR0B,
    regs::TCNT0,
    regs::OCR0A,
    regs::OCR0B,
    regs::PRR,
    regs::EICRA,
    regs::PCMSK0,
    regs::PCMSK2,
    regs::TIMSK0,
    regs::TIMSK1,
    regs::TIMSK2,
    regs::TCCR1A,
    regs::TCCR1B,
    regs::TCCR1C,
    regs::TCNT1L,
    regs::TCNT1H,
    regs::ICR1L,
    regs::ICR1H,
    regs::OCR1AL,
    regs::OCR1AH,
    regs::OCR1BL,
    regs::OCR1BH,
    regs::TCCR2A,
    regs::TCCR2B,
    regs::TCNT2,
    regs::OCR2A,
    regs::OCR2B,
    regs::ASSR,
];

/// Registers whose reads the timers answer.
pub const READS: &[u16] = &[
    regs::TIFR0,
    regs::TIFR1,
    regs::TIFR2,
    regs::TCNT0,
    regs::TCNT1L,
    regs::TCNT1H,
    regs::ICR1L,
    regs::ICR1H,
    regs::TCNT2,
];

/// Number of the timer that has a register of [`WRITES`] or [`READS`].
pub fn timer_of(address: u16) -> usize {
    match address {
        regs::TIFR0 | regs::TIMSK0 | regs::TCCR0A..=regs::OCR0B => 0,
        regs::TIFR2 | regs::TIMSK2 | regs::TCCR2A..=regs::OCR2B => 2,
        _ => 1,
    }
}

/// Timer0 and Timer1 share a prescaler (section 17).
const SHARED_DIVIDERS: [u64; 8] = [0, 1, 8, 64, 256, 1024, 0, 0];
/// Table 18-9.
const TIMER2_DIVIDERS: [u64; 8] = [0, 1, 8, 32, 64, 128, 256, 1024];

/// The timers, by number.
pub static LAYOUTS: [Layout; 3] = [
    Layout {
        number: 0,
        tccra: regs::TCCR0A,
        tccrb: regs::TCCR0B,
        foc: regs::TCCR0B,
        tcnt: regs::TCNT0,
        ocr: [regs::OCR0A, regs::OCR0B],
        timsk: regs::TIMSK0,
        tifr: regs::TIFR0,
        is_wide: false,
        dividers: SHARED_DIVIDERS,
        prescaler_reset: regs::PSRSYNC,
        power_reduction: 1 << 5,
        pins: [(PORT_D, 6), (PORT_D, 5)],
    },
    Layout {
        number: 1,
        tccra: regs::TCCR1A,
        tccrb: regs::TCCR1B,
        foc: regs::TCCR1C,
        tcnt: regs::TCNT1L,
        ocr: [regs::OCR1AL, regs::OCR1BL],
        timsk: regs::TIMSK1,
        tifr: regs::TIFR1,
        is_wide: true,
        dividers: SHARED_DIVIDERS,
        prescaler_reset: regs::PSRSYNC,
        power_reduction: 1 << 3,
        pins: [(PORT_B, 1), (PORT_B, 2)],
    },
    Layout {
        number: 2,
        tccra: regs::TCCR2A,
        tccrb: regs::TCCR2B,
        foc: regs::TCCR2B,
        tcnt: regs::TCNT2,
        ocr: [regs::OCR2A, regs::OCR2B],
        timsk: regs::TIMSK2,
        tifr: regs::TIFR2,
        is_wide: false,
        dividers: TIMER2_DIVIDERS,
        prescaler_reset: regs::PSRASY,
        power_reduction: 1 << 6,
        pins: [(PORT_B, 3), (PORT_D, 3)],
    },
];

impl Layout {
    /// Largest value of the counter.
    pub fn max(&self) -> u16 {
        if self.is_wide { 0xFFFF } else { 0xFF }
    }

    /// Flags that TIFRn and TIMSKn have.
    pub fn flags(&self) -> u8 {
        TOV | OCFA | OCFA << 1 | if self.is_wide { ICF } else { 0 }
    }

    /// The flags of this timer in `flags`, one by one.
    pub fn each_flag(&self, flags: u8) -> impl Iterator<Item = u8> + use<> {
        let flags = flags & self.flags();
        [TOV, OCFA, OCFA << 1, ICF].into_iter().filter(move |flag| flags & flag != 0)
    }

    /// CPU cycles of a timer clock, by the registers; 0: stopped.
    pub fn divider(&self, core: &Core) -> u64 {
        let gtccr = core.get(regs::GTCCR);
        let is_held = gtccr & regs::TSM != 0 && gtccr & self.prescaler_reset != 0;
        let is_off = core.get(regs::PRR) & self.power_reduction != 0;
        let is_asynchronous = self.number == 2 && core.get(regs::ASSR) & regs::AS2 != 0;
        if is_held || is_off || is_asynchronous {
            return 0;
        }
        self.dividers[usize::from(core.get(self.tccrb) & 0b111)]
    }

    /// Bits of TCCRnB that can be read. FOCnx always reads as zero.
    pub fn tccrb_bits(&self) -> u8 {
        if self.is_wide { 0b1101_1111 } else { 0b0000_1111 }
    }

    /// The waveform generation mode, by the values of TCCRnA and TCCRnB.
    pub fn mode(&self, tccra: u8, tccrb: u8) -> Mode {
        let low = tccra & 0b11;
        if self.is_wide {
            Mode::of_16_bits((tccrb >> 1) & 0b1100 | low)
        } else {
            Mode::of_8_bits((tccrb >> 1) & 0b100 | low)
        }
    }

    /// COMnA1:0 and COMnB1:0, by the value of TCCRnA.
    pub fn com(&self, tccra: u8) -> [u8; 2] {
        [tccra >> 6, tccra >> 4 & 0b11]
    }

    /// True if CSn2:0 in this value of TCCRnB selects the clock on the pin Tn.
    pub fn has_external_clock(&self, tccrb: u8) -> bool {
        self.number != 2 && tccrb & 0b111 >= 6
    }
}
