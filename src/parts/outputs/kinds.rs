//! The outputs of each kind, and who is asked about an output.

use super::kind::Kind;
use super::output::Output;
use super::pulses::Pulses;
use super::travel::{CommandType, Ticks, Travel};
use crate::tables::output_kinds::for_output_kinds;
use crate::tables::parameters::{OutputParameter, Parameters};
use servos::Servos;

#[allow(dead_code, reason = "a build may have no kind that drives levels")]
mod levels;
#[cfg(feature = "outputs")]
mod motors;
#[cfg(feature = "relay")]
mod relays;
mod servos;

macro_rules! kinds {
    (() $(if $if:meta => $field:ident: $kind:ty = $number:literal,)*) => {
        /// The outputs of each kind.
        pub struct Kinds {
            $(
                #[cfg($if)]
                pub $field: $kind,
            )*
        }

        impl Kinds {
            /// All outputs are servos.
            pub const fn new() -> Self {
                Self { $(#[cfg($if)] $field: <$kind>::new(),)* }
            }
        }
    };
}

for_output_kinds! { kinds: }

/// Asks the kind of an output: `ask!(kinds, bit, ref kind => kind.question())`.
macro_rules! ask {
    ($kinds:expr, $bit:expr, $kind:pat => $answer:expr) => {
        for_output_kinds! { answer: $kinds, $bit, $kind => $answer }
    };
}

macro_rules! answer {
    (
        ($kinds:expr, $bit:expr, $kind:pat => $answer:expr)
        $(if $if:meta => $field:ident: $type:ty = $number:literal,)*
    ) => {{
        $(#[cfg($if)] if $kinds.$field.outputs() & $bit != 0 {
            let $kind = $kinds.$field;
            return $answer;
        })*
        let $kind = Servos;
        $answer
    }};
}

/// Asks each kind of the table, which knows its outputs:
/// `ask_all!(kinds, (kind, number) => kind.question())`.
macro_rules! ask_all {
    ($kinds:expr, $row:pat => $answer:expr) => {
        for_output_kinds! { answers: $kinds, $row => $answer }
    };
}

macro_rules! answers {
    (
        ($kinds:expr, $row:pat => $answer:expr)
        $(if $if:meta => $field:ident: $type:ty = $number:literal,)*
    ) => {
        $(
            #[cfg($if)]
            {
                let $row = (&mut $kinds.$field, $number);
                $answer;
            }
        )*
    };
}

#[allow(unused_mut, unused_variables, reason = "a build may have servos only")]
#[allow(clippy::toplevel_ref_arg, reason = "who asks says if a kind is borrowed mutably")]
impl Kinds {
    /// Applies the parameters of an output. Returns true if it is of another kind than before.
    pub fn update(&mut self, n: usize, bit: u8, parameters: &Parameters) -> bool {
        let number = parameters.of(n, OutputParameter::Type) as u8;
        let mut is_another = false;
        ask_all!(self, (kind, row) => {
            let (was, is) = (kind.outputs() & bit != 0, number == row);
            kind.update(n, bit, is, parameters);
            is_another |= was != is;
        });
        is_another
    }

    /// See [`Kind::is_actuator`].
    pub fn is_actuator(&self, bit: u8) -> bool {
        ask!(self, bit, ref kind => kind.is_actuator())
    }

    /// See [`Kind::needs_armed`]. True for several outputs if it is for one.
    pub fn needs_armed(&self, bit: u8) -> bool {
        ask!(self, bit, ref kind => kind.needs_armed())
    }

    /// See [`Kind::unpack`].
    pub fn unpack(&mut self, bit: u8, output: &mut Output) {
        ask_all!(self, (kind, _) => kind.unpack(bit, output));
    }

    /// See [`Kind::pulse`].
    pub fn pulse(&mut self, bit: u8, travel: &Travel, unit: CommandType, value: i16) -> Ticks {
        ask!(self, bit, ref mut kind => kind.pulse(bit, travel, unit, value))
    }

    /// See [`Kind::tick`].
    pub fn tick(
        &mut self,
        bit: u8,
        output: &mut Output,
        now_ms: u16,
        parameters: &Parameters,
    ) -> bool {
        let mut is_changed = false;
        ask_all!(self, (kind, _) => is_changed |= kind.tick(bit, output, now_ms, parameters));
        is_changed
    }

    /// See [`Kind::timeout_ms`].
    pub fn timeout_ms(&self, n: usize, bit: u8, parameters: &Parameters) -> u16 {
        ask!(self, bit, ref kind => kind.timeout_ms(n, parameters))
    }

    /// See [`Kind::is_left_out`].
    pub fn is_left_out(&mut self, bit: u8, commander: u8) -> bool {
        let mut is_left_out = false;
        ask_all!(self, (kind, _) => is_left_out |= kind.is_left_out(bit, commander));
        is_left_out
    }

    /// See [`Kind::fail_safe`]. An output that follows no command keeps its pulse, or has none.
    #[inline(never)]
    pub fn fail_safe(&mut self, n: usize, bit: u8, output: &mut Output, parameters: &Parameters) {
        if output.is_following() {
            output.stop_following();
            ask!(self, bit, ref mut kind => kind.fail_safe(n, output, parameters));
        }
    }

    /// See [`Kind::begin_safe`].
    pub fn begin_safe(&mut self, bit: u8, output: &mut Output, ends_pulses: bool) {
        output.stop_following();
        ask!(self, bit, ref mut kind => kind.begin_safe(output, ends_pulses));
    }

    /// See [`Kind::second`].
    pub fn second(&mut self, parameters: &Parameters) {
        ask_all!(self, (kind, _) => kind.second(parameters));
    }

    /// See [`Kind::show`].
    pub fn show(&mut self, board: &mut impl Pulses) {
        ask_all!(self, (kind, _) => kind.show(board));
    }
}
