//! The program `bridge`. The library of this package has the code.

#![forbid(unsafe_code)]

use bridge::args::Args;
use bridge::help::HELP;
use bridge::run::{self, Failure};
use clap::Parser as _;
use dronecan_host::text::visible;
use std::io::Write as _;
use std::process::ExitCode;

/// Exit code for a wrong command line, the same as clap's.
const WRONG_USAGE: u8 = 2;

fn main() -> ExitCode {
    let arguments: Vec<String> =
        std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    match HELP.asked(&arguments) {
        None => {}
        Some(Ok(text)) => {
            // The reader may have closed the pipe, as `| head` does.
            let _ = std::io::stdout().write_all(text.as_bytes());
            return ExitCode::SUCCESS;
        }
        Some(Err(error)) => {
            eprintln!("bridge: {}", visible(&error));
            return ExitCode::from(WRONG_USAGE);
        }
    }
    match run::run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err((failure, error)) => {
            eprintln!("bridge: {}", visible(&format!("{error:#}")));
            ExitCode::from(match failure {
                Failure::Other => 1,
                Failure::Usage => WRONG_USAGE,
                Failure::Bus => 3,
                Failure::Channel => 4,
                Failure::Names => 5,
            })
        }
    }
}
