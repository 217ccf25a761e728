//! The command `avr-bounds`: prints the stack and the cycles of an AVR program.

use std::process::ExitCode;

use clap::Parser;

use avr_bounds::command::Args;

/// Exit code for a program that cannot be followed, and for a file that cannot be read.
const REFUSED: u8 = 2;

fn main() -> ExitCode {
    Args::parse().options.run(&mut std::io::stdout().lock()).unwrap_or_else(|error| {
        eprintln!("avr-bounds: {error:#}");
        ExitCode::from(REFUSED)
    })
}
