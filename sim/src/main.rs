//! `sim`: the node on a simulated bench, for people and for scripts.
//!
//! Steps: read the command line, boot the bench, show it live or as lines, write the report, return
//! the exit code. See `sim --help`.

use anyhow::{Context, Result};
use bench::dronecan::text::visible;
use clap::Parser;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use sim::ui::args::{Args, Command};
use sim::ui::help::HELP;
use sim::ui::plain::summary;
use sim::ui::report::Report;
use sim::ui::run;
use sim::ui::scene::Scene;
use sim::ui::terminal;
use sim::usage::{OrUsage, is_usage};
use sim::utilisation;
use std::env;
use std::fs::{self, OpenOptions};
use std::io::{self, IsTerminal, Write};
use std::process::{self, ExitCode};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Exit code for a wrong command line, the same as clap's.
const WRONG_USAGE: u8 = 2;
/// Exit code for an error of this computer, such as a missing file or a busy port.
const MACHINE_FAILED: u8 = 3;
/// Signals within this time after the first count as the same signal.
const REPEATED_WITHIN: Duration = Duration::from_secs(1);

fn main() -> ExitCode {
    let arguments: Vec<String> =
        env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    match HELP.asked(&arguments) {
        None => {}
        Some(Ok(text)) => {
            // The reader may have closed the pipe, as `| head` does.
            let _ = io::stdout().write_all(text.as_bytes());
            return ExitCode::SUCCESS;
        }
        Some(Err(error)) => {
            complain(&error);
            return ExitCode::from(WRONG_USAGE);
        }
    }
    match run(&Args::parse()) {
        Ok(code) => code,
        // The reader has closed the pipe, as `| head` does.
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            // Errors can have text from an ELF file or a script.
            format!("{error:#}").lines().for_each(complain);
            ExitCode::from(if is_usage(&error) { WRONG_USAGE } else { MACHINE_FAILED })
        }
    }
}

fn run(args: &Args) -> Result<ExitCode> {
    match &args.command {
        Some(Command::Utilisation(args)) => {
            utilisation::run(args, io::stdout().lock()).or_usage()?;
            return Ok(ExitCode::SUCCESS);
        }
        Some(Command::Bounds(options)) => return options.run(&mut io::stdout().lock()),
        None => {}
    }
    args.check().or_usage()?;
    if let Some(path) = &args.json {
        // Or a long run would be for nothing.
        let file = OpenOptions::new().create(true).append(true).open(path);
        file.with_context(|| format!("--json: cannot write {}", path.display()))?;
    }
    let stop = stop_on_signals()?;
    let mut scene = Scene::new(args)?;
    if args.plain || !io::stdout().is_terminal() || !terminal::can_show_pictures() {
        run::plain(&mut scene, args, &stop, io::stdout().lock())?;
    } else {
        let speed = run::live(&mut scene, args, &stop)?;
        // The window may be closed.
        let _ = io::stdout().write_all(summary(scene.state(), speed).as_bytes());
    }
    if let Some(path) = &args.json {
        let json = Report::new(scene.state(), &args.judgement()).to_json();
        fs::write(path, json)
            .with_context(|| format!("--json: cannot write {}", path.display()))?;
    }
    let (code, reason) = args.judgement().exit(scene.state());
    if let Some(reason) = reason {
        complain(&reason);
    }
    Ok(code)
}

/// Prints a line on the error output, whose terminal may be closed.
fn complain(text: &str) {
    let _ = writeln!(io::stderr(), "sim: {}", visible(text));
}

/// Returns a flag that signals set. The run then ends between two slices, so that it restores the
/// terminal and prints the summary.
fn stop_on_signals() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let asked = stop.clone();
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP]).context("cannot catch signals")?;
    thread::spawn(move || {
        let mut first = None;
        for signal in signals.forever() {
            asked.store(true, Ordering::Relaxed);
            // A later signal ends the program at once, in case the run hangs. But one request can
            // come as two signals: `timeout` sends it to make and to the whole process
            // group, and make passes it on.
            if first.get_or_insert_with(Instant::now).elapsed() > REPEATED_WITHIN {
                process::exit(128 + signal);
            }
        }
    });
    Ok(stop)
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .chain()
        .filter_map(|cause| cause.downcast_ref::<io::Error>())
        .any(|cause| cause.kind() == io::ErrorKind::BrokenPipe)
}
