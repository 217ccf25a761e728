//! What a build may leave out, a file or a folder each.
//!
//! A part owns its state and gets what else it needs as arguments. It has the same methods whether
//! it is built or not: left out, it is the type of no size in `absent/`, whose methods do nothing,
//! and the compiler removes their calls. Here is where a build chooses.
//!
//! The rows of a part in the tables of types, messages, parameters, conditions and lines are in
//! groups of the part's feature. What is in a group that a build leaves out has no number there,
//! and code that names it does nothing.

/// The twin of a part, for builds that leave the part out: a type of no size, with the methods of
/// the part, which do nothing and return a constant.
macro_rules! absent {
    ($name:ident; $(fn $method:ident($($argument:tt)*) $(-> $type:ty = $value:expr)?;)*) => {
        /// Nothing.
        pub struct $name;

        impl $name {
            /// Nothing.
            pub const fn new() -> Self {
                Self
            }

            $(
                /// Does nothing.
                pub fn $method($($argument)*) $(-> $type)? {
                    $($value)?
                }
            )*
        }
    };
}

pub mod outputs;

#[cfg_attr(not(feature = "allocation"), path = "absent/allocation.rs")]
pub mod allocation;

#[cfg_attr(feature = "outputs", path = "arming_by_source.rs")]
#[cfg_attr(not(feature = "standard"), path = "absent/arming.rs")]
pub mod arming;

#[cfg_attr(not(feature = "battery"), path = "absent/battery.rs")]
pub mod battery;

#[cfg_attr(not(feature = "button"), path = "absent/button.rs")]
pub mod button;

#[cfg_attr(not(feature = "lights"), path = "absent/lights.rs")]
pub mod lights;

#[cfg_attr(not(feature = "log"), path = "absent/log.rs")]
pub mod log;

#[cfg_attr(not(feature = "draft"), path = "absent/measurement.rs")]
pub mod measurement;

#[cfg_attr(not(feature = "power"), path = "absent/power.rs")]
pub mod power;

#[cfg_attr(not(feature = "rpm"), path = "absent/rpm.rs")]
pub mod rpm;

#[cfg_attr(not(feature = "safety"), path = "absent/safety.rs")]
pub mod safety;

#[cfg_attr(not(feature = "stats"), path = "absent/stats.rs")]
pub mod stats;

#[cfg_attr(not(feature = "outputs"), path = "absent/superseded.rs")]
pub mod superseded;

#[cfg_attr(not(feature = "tunnel"), path = "absent/tunnel.rs")]
pub mod tunnel;

#[cfg_attr(not(feature = "update"), path = "absent/update.rs")]
pub mod update;
