//! The sleep modes but Idle: which clocks stop, what wakes the chip, and how long that takes
//! (datasheet section 10).
//!
//! Timers stop. What the USART, the SPI, the TWI and, but for ADC Noise Reduction, the ADC have
//! begun goes on; [`unmodelled`](super::unmodelled) tells it of all but the SPI.

use super::core::Core;
use super::regs;
use sim_base::Cycles;

/// Cycles of the crystal until it counts as stable, with the fuses of an Arduino: 16K CK (CKSEL
/// 1111, SUT 11; table 9-4).
const OF_CRYSTAL: Cycles = 16_384;
/// The same of the standby modes, in which the crystal runs (section 10.7).
const OF_STANDBY: Cycles = 6;

/// A sleep mode whose clocks stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Mode {
    /// The timers that stop, by their bits of PRR.
    pub stopped: u8,
    /// Time from what wakes the chip until the clocks run.
    pub start_up: Cycles,
    /// ADC Noise Reduction: a conversion begins (section 10.5).
    pub converts: bool,
}

impl Mode {
    /// The mode of SM2:0 in SMCR. `None` is Idle; the reserved modes count as that.
    pub fn of(smcr: u8) -> Option<Mode> {
        let of_clock_io = regs::PRTIM0 | regs::PRTIM1;
        let all = of_clock_io | regs::PRTIM2;
        let (stopped, start_up) = match smcr >> 1 & 0b111 {
            0b001 => return Some(Mode { stopped: all, start_up: 0, converts: true }),
            0b010 => (all, OF_CRYSTAL),
            0b011 => (of_clock_io, OF_CRYSTAL),
            0b110 => (all, OF_STANDBY),
            0b111 => (of_clock_io, OF_STANDBY),
            _ => return None,
        };
        Some(Mode { stopped, start_up, converts: false })
    }

    /// True if something wakes the chip from this mode (table 10-1). `is_low` says of INT0 and INT1
    /// if they are low: edges are not noticed without the clock.
    pub fn is_woken(self, core: &Core, is_low: [bool; 2]) -> bool {
        let is_low_level =
            |n: usize| is_low[n] && is_set(core, regs::EIMSK, 1 << n) && sense(core, n) == 0;
        core.interrupts_enabled()
            && (is_flagged(core, regs::PCIFR, regs::PCICR)
                || is_watchdog_pending(core)
                || (0..2).any(is_low_level)
                || self.stopped & regs::PRTIM2 == 0 && is_flagged(core, regs::TIFR2, regs::TIMSK2)
                || self.converts && (is_adc_pending(core) || is_memory_ready(core)))
    }
}

/// True if any enabled interrupt is pending: SLEEP then does not stop the clocks.
pub(super) fn is_pending(core: &Core) -> bool {
    const OF_USART: u8 = regs::RXCIE0 | regs::TXCIE0 | regs::UDRIE0;
    let flags = [
        (regs::TIFR0, regs::TIMSK0),
        (regs::TIFR1, regs::TIMSK1),
        (regs::TIFR2, regs::TIMSK2),
        (regs::PCIFR, regs::PCICR),
        (regs::EIFR, regs::EIMSK),
    ];
    core.interrupts_enabled()
        && (flags.into_iter().any(|(flags, enables)| is_flagged(core, flags, enables))
            || core.get(regs::UCSR0A) & core.get(regs::UCSR0B) & OF_USART != 0
            || is_watchdog_pending(core)
            || is_adc_pending(core)
            || is_set(core, regs::SPSR, regs::SPIF) && is_set(core, regs::SPCR, regs::SPIE)
            || is_set(core, regs::TWCR, regs::TWINT) && is_set(core, regs::TWCR, regs::TWIE)
            || is_memory_ready(core))
}

/// ISCn1:0.
pub(super) fn sense(core: &Core, n: usize) -> u8 {
    core.get(regs::EICRA) >> (2 * n) & 0b11
}

fn is_set(core: &Core, register: u16, bit: u8) -> bool {
    core.get(register) & bit != 0
}

/// True if a flag is set whose interrupt is enabled, in registers with the same places for both.
fn is_flagged(core: &Core, flags: u16, enables: u16) -> bool {
    core.get(flags) & core.get(enables) != 0
}

fn is_watchdog_pending(core: &Core) -> bool {
    is_set(core, regs::WDTCSR, regs::WDIF) && is_set(core, regs::WDTCSR, regs::WDIE)
}

fn is_adc_pending(core: &Core) -> bool {
    is_set(core, regs::ADCSRA, regs::ADIF) && is_set(core, regs::ADCSRA, regs::ADIE)
}

/// EEPROM Ready or SPM Ready: pending whenever nothing is written.
fn is_memory_ready(core: &Core) -> bool {
    let is_ready = |register, enable: u8, busy: u8| core.get(register) & (enable | busy) == enable;
    is_ready(regs::EECR, regs::EERIE, regs::EEPE)
        || is_ready(regs::SPMCSR, regs::SPMIE, regs::SELFPRGEN)
}
