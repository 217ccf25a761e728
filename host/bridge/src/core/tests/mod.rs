//! Tests of the bridge with simulated nodes, in simulated time.

mod commands;
mod forward;
mod parameters;
mod presence;
mod rig;
mod robustness;
