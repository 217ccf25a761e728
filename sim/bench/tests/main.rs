//! The tests of the bench are one program: each would link simavr and the bench of its own.

mod autopilot_types;
mod avr;
mod avr_board;
mod avr_chip;
mod avr_corners;
mod avr_peripherals;
mod avr_spm;
mod avr_stack;
mod avr_timers;
mod avr_twi;
mod avr_unmodelled;
mod bit_timing;
mod boards;
mod opcodes;
mod own_node;
mod own_node_uno;
mod third_party;
