//! The rig under load: a sender that fills the bus, a client that keeps the node busy, and a meter
//! of what a received frame costs. The meter uses the wires of the board and the log of its CAN
//! controller.

mod client;
mod kind;
mod loaded;
mod meter;
mod sender;

use super::parallel;

pub use client::{BusyClient, Client};
pub use kind::{Kind, Load, Pace, may_lose_commands};
pub use loaded::{Figures, Loaded, compare_register};
pub use meter::{Meter, Samples};
pub use sender::{SENDER, Sender, long_command};

/// Runs the node under each load for so many milliseconds, with a client that
/// [saves](Client::Saving), and calls `seen` after each load. See [`parallel::each`].
pub fn run_all(
    loads: &[(Load, u64)],
    seen: impl Fn(Load, u64, &Figures) + Sync,
) -> Vec<(Load, u64, Figures)> {
    parallel::each(loads, |&(load, ms)| {
        let figures = run(load, ms);
        seen(load, ms, &figures);
        (load, ms, figures)
    })
}

/// Runs the node under one load for `ms` milliseconds.
pub fn run(load: Load, ms: u64) -> Figures {
    let mut loaded = Loaded::new(Some(load), Client::Saving);
    loaded.run_ms(ms);
    loaded.finish()
}
