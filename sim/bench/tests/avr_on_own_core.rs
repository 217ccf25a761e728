//! The tests of the simulated AVR, again on the own core: `avr::ENGINE` follows from the name of
//! the program.

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
