//! The kinds of output, by OUTn_TYPE. An output of type 0, or of one that is not here, is a servo.

/// Gives the rows to a macro, after what else it is given in brackets. A row is
/// `if condition => field: type = number`, for the fields of `Kinds` in parts/outputs/kinds.rs.
macro_rules! for_output_kinds {
    ($to:ident: $($given:tt)*) => {
        $to! { ($($given)*)
            if feature = "outputs" => motors: motors::Motors = 1,
            if feature = "relay" => relays: relays::Relays = 2,
        }
    };
}

pub(crate) use for_output_kinds;

macro_rules! greatest {
    (() $(if $if:meta => $field:ident: $kind:ty = $number:literal,)*) => {
        /// The greatest OUTn_TYPE.
        #[allow(dead_code, reason = "a build may have no OUTn_TYPE")]
        pub const GREATEST_TYPE: i32 = {
            let numbers: &[i32] = &[$(#[cfg($if)] $number,)*];
            let (mut greatest, mut n) = (0, 0);
            while n < numbers.len() {
                if numbers[n] > greatest {
                    greatest = numbers[n];
                }
                n += 1;
            }
            greatest
        };
    };
}

for_output_kinds! { greatest: }
