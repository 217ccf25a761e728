//! The program `sim`: shows a [`bench`](mod@bench) on the terminal, and joins it to other programs.

pub mod fault;
pub mod links;
pub mod pins;
pub mod time;
pub mod ui;
pub mod usage;
pub mod utilisation;
