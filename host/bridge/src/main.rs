//! The program `bridge`. The library of this package has the code.

#![forbid(unsafe_code)]

use bridge::args::Args;
use bridge::run::{self, Failure};
use clap::Parser as _;
use dronecan_host::text::visible;
use std::process::ExitCode;

fn main() -> ExitCode {
    match run::run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err((failure, error)) => {
            eprintln!("bridge: {}", visible(&format!("{error:#}")));
            ExitCode::from(match failure {
                Failure::Other => 1,
                Failure::Usage => 2,
                Failure::Bus => 3,
                Failure::Channel => 4,
                Failure::Names => 5,
            })
        }
    }
}
