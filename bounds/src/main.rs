//! The command `bounds`: prints the stack and the cycles of an AVR program.

use std::process::ExitCode;

use clap::Parser;

use bounds::command::{Args, run};

/// Exit code for a program that cannot be followed, and for a file that cannot be read.
const REFUSED: u8 = 2;

fn main() -> ExitCode {
    run(&Args::parse(), &mut std::io::stdout().lock()).unwrap_or_else(|error| {
        eprintln!("bounds: {error:#}");
        ExitCode::from(REFUSED)
    })
}
