//! The user interface of the bench.
//!
//! ```text
//! args ──> scene ──> state ──┬──> live (terminal)   <── keys
//!          bench, autopilot  └──> plain (lines)
//! ```
//! [`scene`] advances the bench and the autopilot and updates [`state`], which is plain data. The
//! two views read it. Only [`run`] reads the wall clock. [`pace`] compares it with simulated time.

pub mod args;
mod discharge;
pub mod escs;
pub mod findings;
pub mod help;
pub mod history;
pub mod keys;
pub mod live;
mod measured;
pub mod mistakes;
pub mod pace;
pub mod plain;
pub mod popups;
pub mod report;
pub mod run;
pub mod scene;
pub mod screen;
pub mod state;
mod styles;
pub mod terminal;
pub mod traffic;
