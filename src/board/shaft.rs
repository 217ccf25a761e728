//! The pulses of a shaft, by the external interrupt that the CAN controller leaves free: INT1 on
//! D3, or INT0 on D2 if the controller has INT1. The comments say INT1 for both.
//!
//! INT1 triggers on the falling edge. Its handler counts the pulse, keeps its time (Timer0 and the
//! milliseconds), and masks INT1. Timer2, which dims the light in other builds, enables INT1 again
//! at the end of each slot of 248 us, and drops an edge that came meanwhile. So there is one pulse
//! in a slot at most: a noisy input takes no more time than a fast shaft. A slot does not begin
//! with a pulse, so an input that bounces can have two.
//!
//! Both handlers leave interrupts disabled, for 37 and 20 cycles (`make bounds`). So a frame waits
//! for 61 at most.

use core::arch::global_asm;
use core::mem::offset_of;

use super::chip::{EXINT, TC2, steal};
use super::clock::{TICKS, TOP as TIMER0_TOP};
use firmware::hardware::{CAN_INTERRUPT, ShaftPulses};

const _: () = assert!(TIMER0_TOP == ShaftPulses::TICKS_PER_MS - 1);

/// TOP of Timer2, which counts as fast as Timer0.
const TOP: u8 = ShaftPulses::SLOT_TICKS - 1;

/// The number of the interrupt: INT0 is on D2, INT1 on D3.
const INTERRUPT: u8 = 1 - (CAN_INTERRUPT.bit - 2);

/// The bit of the interrupt in EIMSK, and of its flag in EIFR.
const INT1_BIT: u8 = 1 << INTERRUPT;

/// ISC11..0 = 2 in EICRA: the falling edge. The bits of INT1 follow those of INT0.
const FALLING_EDGE: u8 = 2 << (2 * INTERRUPT);

/// OCF0A in TIFR0: Timer0 has begun a millisecond that is not counted yet.
const OCF0A: u8 = 1 << 1;

/// What the handler keeps.
struct Latest {
    /// Pulses so far, modulo 256.
    count: u8,
    /// Timer0, its flags, and the milliseconds at the last pulse, read in this order.
    tcnt0: u8,
    tifr0: u8,
    ms: u8,
}

static mut LATEST: Latest = Latest { count: 0, tcnt0: 0, tifr0: 0, ms: 0 };

// The handlers. The milliseconds do not change while the first one runs. It reads Timer0 before its
// flags: a flag that is set with a small number is that of the millisecond before. The second one
// does nothing while INT1 is enabled, or it would drop a pulse that has just come.
//
// SREG = 0x3F, TCNT0 = 0x26, EIMSK = 0x1D, EIFR = 0x1C, TIFR0 = 0x15. TIMER2_COMPA is vector 7.
global_asm!(
    ".global __vector_{vector}",
    "__vector_{vector}:",
    "    push r24",
    "    in   r24, 0x3F",
    "    push r24",
    "    in   r24, 0x26",
    "    sts  {latest}+{tcnt0}, r24",
    "    in   r24, 0x15",
    "    sts  {latest}+{tifr0}, r24",
    "    lds  r24, {ticks}",
    "    sts  {latest}+{ms}, r24",
    "    lds  r24, {latest}+{count}",
    "    inc  r24",
    "    sts  {latest}+{count}, r24",
    "    cbi  0x1D, {bit}",
    "    pop  r24",
    "    out  0x3F, r24",
    "    pop  r24",
    "    reti",
    ".global __vector_7",
    "__vector_7:",
    "    sbic 0x1D, {bit}",
    "    reti",
    "    push r24",
    "    ldi  r24, {mask}",
    "    out  0x1C, r24",
    "    pop  r24",
    "    sbi  0x1D, {bit}",
    "    reti",
    vector = const INTERRUPT + 1,
    mask = const INT1_BIT,
    bit = const INTERRUPT,
    latest = sym LATEST,
    count = const offset_of!(Latest, count),
    tcnt0 = const offset_of!(Latest, tcnt0),
    tifr0 = const offset_of!(Latest, tifr0),
    ms = const offset_of!(Latest, ms),
    ticks = sym TICKS,
);

fn exint() -> EXINT {
    // Safety: `Bus` uses the same registers, but other bits. One instruction changes a bit of
    // EIMSK. EICRA is written before interrupts are enabled.
    unsafe { steal::<EXINT>() }
}

/// The input for the pulses.
pub struct Shaft {
    tc2: TC2,
    /// `Latest::count` at the last call of [`pulses`](Self::pulses).
    seen: u8,
}

impl Shaft {
    /// Sets the input up, and counts nothing yet. Call it after `Bus::new`, which writes all of
    /// EICRA and EIMSK.
    pub(super) fn new(tc2: TC2) -> Self {
        // Safety: every value of EICRA is valid.
        exint().eicra.modify(|r, w| unsafe { w.bits(r.bits() | FALLING_EDGE) });
        tc2.timsk2.write(|w| w.ocie2a().clear_bit());
        tc2.ocr2a.write(|w| w.bits(TOP));
        tc2.tccr2a.write(|w| w.wgm2().ctc());
        tc2.tccr2b.write(|w| w.cs2().prescale_64());
        Self { tc2, seen: 0 }
    }

    /// The pulses since the last call. Counts the next ones if `is_on` is true.
    pub fn pulses(&mut self, is_on: bool) -> ShaftPulses {
        self.tc2.timsk2.write(|w| w.ocie2a().bit(is_on));
        if !is_on {
            // Safety: every value of EIMSK is valid.
            exint().eimsk.modify(|r, w| unsafe { w.bits(r.bits() & !INT1_BIT) });
        }
        let latest = &raw const LATEST;
        // Safety: the pointer is to a static, so it is always valid. One instruction reads a byte,
        // so each value is whole. The reads are volatile because the handler changes the bytes
        // between two reads.
        let [count, tcnt0, tifr0, mut ms, again] = unsafe {
            [
                (&raw const (*latest).count).read_volatile(),
                (&raw const (*latest).tcnt0).read_volatile(),
                (&raw const (*latest).tifr0).read_volatile(),
                (&raw const (*latest).ms).read_volatile(),
                (&raw const (*latest).count).read_volatile(),
            ]
        };
        if count != again {
            // The time may be that of two pulses. The next call has both.
            return ShaftPulses::NONE;
        }
        if tifr0 & OCF0A != 0 && tcnt0 <= TIMER0_TOP / 2 {
            ms = ms.wrapping_add(1);
        }
        let seen = core::mem::replace(&mut self.seen, count);
        ShaftPulses { count: count.wrapping_sub(seen), ms, ticks: tcnt0 }
    }
}
