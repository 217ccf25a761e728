//! The tests of `sim` are one program: each would link the bench of its own.

#[path = "../bench/tests/avr/mod.rs"]
mod avr;
mod bounds;
mod gdb;
mod links;
mod links_program;
mod links_serial;
mod links_slcan;
mod own_program;
mod utilisation;
mod wire;
mod wire_logs;
mod wire_vcd;
