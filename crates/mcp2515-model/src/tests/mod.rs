//! Tests of the model against its datasheet. Each test cites the section of DS20001801J that it
//! checks.
//!
//! `support` has the bench (chip, bus, a peer node) and restates addresses and bits; `script` runs
//! tables of tests on it. The tests do not use the model's own constants.

mod errors;
mod filters;
mod instructions;
mod interrupts;
mod modes;
mod noise;
mod receive;
mod registers;
mod script;
mod sleep;
mod support;
mod timing;
mod transmit;
mod upset;
