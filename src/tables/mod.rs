//! The tables: what the node receives, what it publishes, its parameters, its conditions, and what
//! they are packed into for flash.
//!
//! A row has all that depends on its message, its parameter or its condition. The tables know
//! neither node nor parts: [`kind`] and [`publication`] give their rows to the macros of the
//! modules above, which call the methods that the rows name.
//!
//! | module | table |
//! | --- | --- |
//! | [`kind`] | the received data types; [`wire`] configures how transfers are reassembled |
//! | [`publication`] | the messages that the node sends |
//! | [`types`] | the data types that are not in [`dronecan_wire::types`] |
//! | [`parameters`] | the parameters, and their values; [`bit_rate`] the timing for CAN_BAUDRATE |
//! | [`condition`] | the conditions of the node's health |
//! | [`output_kinds`] | the kinds of output |
//! | [`information`] | versions, name and texts |

/// The constants of the type of a table's rows, which wraps a number: that of the row in a build
/// that has the row, with bits of its own if it has them, and `$none` in one that leaves it out.
macro_rules! numbered {
    ($type:ident, $none:expr; $(if $if:meta {
        $($(#[doc = $doc:literal])* $name:ident $(| $bits:expr)?;)*
    })*) => {
        const _: () = {
            #[repr(u8)]
            enum Place {
                $($(#[cfg($if)] $name,)*)*
            }

            #[allow(non_upper_case_globals, reason = "they read as variants of an enumeration")]
            impl $type {
                $($(
                    $(#[doc = $doc])*
                    #[cfg($if)]
                    pub const $name: Self = Self(Place::$name as u8 $(| $bits)?);
                    $(#[doc = $doc])*
                    #[cfg(not($if))]
                    pub const $name: Self = $none;
                )*)*
            }
        };
    };
}
pub(crate) use numbered;

pub mod bit_rate;
pub mod condition;
pub mod information;
pub mod kind;
pub mod output_kinds;
pub mod parameters;
pub mod publication;
pub mod types;
pub mod wire;

use crate::progmem::Progmem;

/// The flash with the tables that the node reads.
pub trait Constants:
    Progmem<parameters::Descriptions> + Progmem<information::Information> + Progmem<kind::DataTypes>
{
    /// The byte at index `at` of [`information::PACKED`].
    #[inline(never)]
    fn information(self, at: u8) -> u8 {
        Progmem::<information::Information>::byte(self, u16::from(at))
    }
}

impl<P> Constants for P where
    P: Progmem<parameters::Descriptions>
        + Progmem<information::Information>
        + Progmem<kind::DataTypes>
{
}
