//! The model against its datasheet: each test cites the section of DS20001801J that it checks.
//!
//! `support` holds the bench (chip, bus, a peer node) and restates addresses and bits; nothing here
//! uses the model's own constants.

mod crates;
mod errors;
mod filters;
mod instructions;
mod interrupts;
mod modes;
mod noise;
mod receive;
mod registers;
mod sleep;
mod support;
mod timing;
mod transmit;
mod upset;
