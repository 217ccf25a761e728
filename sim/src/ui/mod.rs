//! The user's side of the bench.
//!
//! ```text
//! args ──> scene ──> state ──┬──> live (terminal)   <── keys
//!          bench, autopilot  └──> plain (lines)
//! ```
//! [`scene`] steps the bench and the autopilot and fills [`state`], which is plain data. The two views read it. Only
//! [`run`] knows of the wall clock, which [`pace`] compares with simulated time.

pub mod args;
pub mod findings;
pub mod history;
pub mod keys;
pub mod live;
pub mod mistakes;
pub mod pace;
pub mod plain;
pub mod popups;
pub mod report;
pub mod run;
pub mod scene;
pub mod screen;
pub mod state;
pub mod traffic;
pub mod vendor_code;
pub mod wires;
