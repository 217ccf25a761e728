//! The tests are one program: each would link the library of its own.

mod assumed;
mod cycles;
mod opcodes;
mod sound;
mod stack;
mod support;
