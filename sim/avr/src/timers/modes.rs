//! The waveform generation modes of the timers.
//!
//! Source: Atmel 2545, tables 15-8 (Timer0), 16-4 (Timer1) and 18-8 (Timer2). A reserved mode
//! counts as Normal mode.

/// How the counter counts, and what its matches do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Normal,
    /// Clear Timer on Compare Match.
    Ctc,
    FastPwm,
    PhaseCorrect,
    PhaseAndFrequencyCorrect,
}

impl Kind {
    /// True in the modes in which OCRnx is buffered and FOCnx does nothing.
    pub fn is_pwm(self) -> bool {
        !matches!(self, Kind::Normal | Kind::Ctc)
    }

    /// True if the counter counts up to TOP and down to BOTTOM.
    pub fn has_two_slopes(self) -> bool {
        matches!(self, Kind::PhaseCorrect | Kind::PhaseAndFrequencyCorrect)
    }
}

/// The largest value to which the counter counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Top {
    Fixed(u16),
    Icr,
    Ocra,
}

/// A waveform generation mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mode {
    pub kind: Kind,
    pub top: Top,
    /// True if COMnA1:0 = 1 toggles OCnA in this PWM mode. OCnB has no such function.
    pub toggles_a: bool,
}

impl Mode {
    /// Normal mode of a counter up to `max`.
    pub const fn normal(max: u16) -> Mode {
        mode(Kind::Normal, Top::Fixed(max))
    }

    /// Mode of Timer0 or Timer2, by WGMn2:0.
    pub fn of_8_bits(wgm: u8) -> Mode {
        MODES_8_BITS[usize::from(wgm & 0b111)]
    }

    /// Mode of Timer1, by WGM13:0.
    pub fn of_16_bits(wgm: u8) -> Mode {
        MODES_16_BITS[usize::from(wgm & 0b1111)]
    }
}

const fn mode(kind: Kind, top: Top) -> Mode {
    Mode { kind, top, toggles_a: false }
}

const fn toggling(kind: Kind, top: Top) -> Mode {
    Mode { kind, top, toggles_a: true }
}

const MODES_8_BITS: [Mode; 8] = [
    Mode::normal(0xFF),
    mode(Kind::PhaseCorrect, Top::Fixed(0xFF)),
    mode(Kind::Ctc, Top::Ocra),
    mode(Kind::FastPwm, Top::Fixed(0xFF)),
    Mode::normal(0xFF),
    toggling(Kind::PhaseCorrect, Top::Ocra),
    Mode::normal(0xFF),
    toggling(Kind::FastPwm, Top::Ocra),
];

const MODES_16_BITS: [Mode; 16] = [
    Mode::normal(0xFFFF),
    mode(Kind::PhaseCorrect, Top::Fixed(0x00FF)),
    mode(Kind::PhaseCorrect, Top::Fixed(0x01FF)),
    mode(Kind::PhaseCorrect, Top::Fixed(0x03FF)),
    mode(Kind::Ctc, Top::Ocra),
    mode(Kind::FastPwm, Top::Fixed(0x00FF)),
    mode(Kind::FastPwm, Top::Fixed(0x01FF)),
    mode(Kind::FastPwm, Top::Fixed(0x03FF)),
    mode(Kind::PhaseAndFrequencyCorrect, Top::Icr),
    toggling(Kind::PhaseAndFrequencyCorrect, Top::Ocra),
    mode(Kind::PhaseCorrect, Top::Icr),
    toggling(Kind::PhaseCorrect, Top::Ocra),
    mode(Kind::Ctc, Top::Icr),
    Mode::normal(0xFFFF),
    toggling(Kind::FastPwm, Top::Icr),
    toggling(Kind::FastPwm, Top::Ocra),
];
