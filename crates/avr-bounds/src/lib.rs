#![doc = include_str!("../README.md")]
//!
//! ## How it works
//!
//! [`program`] reads the ELF, and `avr-core` decodes its instructions ([`opcode`]). [`step`] says
//! what an instruction does to what is known of the processor ([`state`], [`value`]). [`stack`]
//! follows all paths of each function, which also finds the targets of jumps, and adds up the
//! stack. [`cycles`] follows them again, in order and each loop round by round, and adds up the
//! time. What cannot be followed is an error with its place, unless the file of [`annotations`]
//! says what is true there.

#![forbid(unsafe_code)]

pub mod annotations;
mod arithmetic;
pub mod assumptions;
mod branch;
pub mod chip;
pub mod clock;
pub mod command;
mod countdown;
pub mod cycles;
pub mod enables;
pub mod interference;
mod liveness;
mod memory;
pub mod order;
mod path;
pub mod program;
pub mod report;
mod rounds;
pub mod stack;
pub mod state;
pub mod step;
pub mod summary;
pub mod text;
pub mod times;
pub mod value;
pub mod virtuals;
mod wait;
pub mod whole;
mod wide;

pub use avr_core::opcode;
