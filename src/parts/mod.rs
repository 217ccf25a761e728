//! What a build may leave out, a file or a folder each.
//!
//! A part owns its state and gets what else it needs as arguments. It has the same methods whether
//! it is built or not: left out, it is the type of no size in `absent/`, whose methods do nothing,
//! and the compiler removes their calls. Here is where a build chooses.
//!
//! The rows of a part in the tables of types, messages, parameters, conditions and lines are in
//! groups of the part's feature. What is in a group that a build leaves out has no number there,
//! and code that names it does nothing.

pub mod outputs;

#[cfg(feature = "allocation")]
pub mod allocation;
#[cfg(not(feature = "allocation"))]
#[path = "absent/allocation.rs"]
pub mod allocation;

#[cfg(feature = "outputs")]
#[path = "arming_by_source.rs"]
pub mod arming;
#[cfg(all(feature = "standard", not(feature = "outputs")))]
pub mod arming;
#[cfg(not(feature = "standard"))]
#[path = "absent/arming.rs"]
pub mod arming;

#[cfg(feature = "battery")]
pub mod battery;
#[cfg(not(feature = "battery"))]
#[path = "absent/battery.rs"]
pub mod battery;

#[cfg(feature = "button")]
pub mod button;
#[cfg(not(feature = "button"))]
#[path = "absent/button.rs"]
pub mod button;

#[cfg(feature = "draft")]
#[path = "draft.rs"]
pub mod dialect;
#[cfg(not(feature = "draft"))]
#[path = "absent/draft.rs"]
pub mod dialect;

#[cfg(feature = "lights")]
pub mod lights;
#[cfg(not(feature = "lights"))]
#[path = "absent/lights.rs"]
pub mod lights;

#[cfg(feature = "log")]
pub mod log;
#[cfg(not(feature = "log"))]
#[path = "absent/log.rs"]
pub mod log;

#[cfg(feature = "outputs")]
pub mod motors;
#[cfg(not(feature = "outputs"))]
#[path = "absent/motors.rs"]
pub mod motors;

#[cfg(feature = "power")]
pub mod power;
#[cfg(not(feature = "power"))]
#[path = "absent/power.rs"]
pub mod power;

#[cfg(feature = "relay")]
pub mod relays;
#[cfg(not(feature = "relay"))]
#[path = "absent/relays.rs"]
pub mod relays;

#[cfg(feature = "safety")]
pub mod safety;
#[cfg(not(feature = "safety"))]
#[path = "absent/safety.rs"]
pub mod safety;

#[cfg(feature = "stats")]
pub mod stats;
#[cfg(not(feature = "stats"))]
#[path = "absent/stats.rs"]
pub mod stats;

#[cfg(feature = "tunnel")]
pub mod tunnel;
#[cfg(not(feature = "tunnel"))]
#[path = "absent/tunnel.rs"]
pub mod tunnel;

#[cfg(feature = "update")]
pub mod update;
#[cfg(not(feature = "update"))]
#[path = "absent/update.rs"]
pub mod update;

/// The NodeStatus of another node.
pub struct Heard {
    /// Uptime in seconds, little-endian.
    pub uptime: [u8; 4],
    /// The health: 0 OK, 1 warning, 2 error, 3 critical.
    pub level: u8,
}
