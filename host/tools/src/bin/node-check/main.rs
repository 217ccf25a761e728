//! Checks a real board: `make check`.
//!
//! The program opens the bus, runs the [`Session`], and writes its report. What to send and what to
//! ask is the library's.

#![forbid(unsafe_code)]

mod analyser;
mod keys;
mod links;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, Error, Result};
use clap::Parser as _;
use dronecan_host::text::visible;
use node_tools::check::args::Args;
use node_tools::check::desk::{Changed, Output};
use node_tools::check::report::{Report, Row, Verdict, board};
use node_tools::check::session::{Plan, Session};
use node_tools::update::file::FirmwareFile;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use analyser::Analyser;
use keys::Keys;
use links::Links;

/// The exit code after a signal.
const INTERRUPTED: i32 = 5;

/// Why the program ends without a report.
enum Failure {
    Usage(Error),
    Link(Error),
}

fn main() -> ExitCode {
    let (code, error) = match run(&Args::parse()) {
        Ok(code) => return ExitCode::from(code),
        Err(Failure::Usage(error)) => (2, error),
        Err(Failure::Link(error)) => (3, error),
    };
    eprintln!("node-check: {}", visible(&format!("{error:#}")));
    ExitCode::from(code)
}

fn run(args: &Args) -> Result<u8, Failure> {
    let interrupted = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        // The second one ends the program at once. The next run puts back what this one has not.
        signal_hook::flag::register_conditional_shutdown(signal, INTERRUPTED, interrupted.clone())
            .and_then(|_| signal_hook::flag::register(signal, interrupted.clone()))
            .context("cannot handle signals")
            .map_err(Failure::Usage)?;
    }
    let files = args.firmware.iter().map(|path| FirmwareFile::read(path)).collect::<Result<_>>();
    let files = files.map_err(Failure::Usage)?;
    fs::create_dir_all(&args.report)
        .with_context(|| format!("cannot make {}", args.report.display()))
        .map_err(Failure::Usage)?;
    let left_path = args.report.join(format!("put-back-{}.json", args.node));
    let left = left(&left_path).map_err(Failure::Usage)?;
    let mut links = Links::open(args).map_err(Failure::Link)?;
    let mut keys = Keys::new();
    let mut analyser = Analyser::find();
    let mut session = Session::new(
        Plan {
            node: args.node,
            bit_rate: args.bitrate,
            has_port: args.port.is_some(),
            has_analyser: analyser.is_there(),
            watch: std::time::Duration::from_secs(args.watch),
            files,
        },
        left,
    );
    let mut is_lost = false;
    while !session.is_done() {
        if interrupted.load(Ordering::Relaxed) {
            session.stop("ended by a signal", false);
        }
        if let Err(error) = links.turn(&mut session, keys.wants_input()) {
            if !is_lost {
                println!("{}", visible(&format!("{error:#}")));
                if session.has_changed() {
                    println!("plug it in again: the program then puts back what it has changed");
                }
            }
            is_lost = true;
            session.stop(&format!("{error:#}"), true);
        }
        if let Some(answer) = keys.answer(links.now()) {
            session.answer(answer);
        }
        if let Some(recording) = analyser.recording() {
            session.recorded(recording);
        }
        session.poll(links.now(), links.waiting());
        links.send(&mut session);
        for output in session.take_outputs() {
            match output {
                Output::Note(text) => keys.line(&visible(&text)),
                Output::Row(row) => keys.line(&shown(&row)),
                Output::Ask(text, seconds) => keys.ask(&visible(&text), seconds, links.now()),
                Output::Withdraw => keys.withdraw(),
                Output::OpenPort => {
                    if let Err(error) = links.open_port() {
                        is_lost = true;
                        keys.line(&visible(&format!("{error:#}")));
                        session.stop(&format!("{error:#}"), true);
                    }
                }
                Output::BitRate(bit_rate) => links.set_bit_rate(bit_rate),
                Output::Record => analyser.record(),
                Output::ClosePort => links.close_port(),
                Output::AskAdapter => links.ask_flags(),
                Output::Serial(bytes) => links.write_port(&bytes),
                Output::Remember(changed) => remember(&left_path, &changed),
            }
        }
    }
    links.close();
    let mut report = session.report();
    report.about = about(args);
    write(args, &report).map_err(Failure::Usage)?;
    println!("{}: {}", report.summary(), args.report.join("report.md").display());
    Ok(match report.count(Verdict::Failed) {
        _ if is_lost => 3,
        _ if interrupted.load(Ordering::Relaxed) => INTERRUPTED as u8,
        0 if report.ended.is_none() => 0,
        _ => 1,
    })
}

fn about(args: &Args) -> Vec<(&'static str, String)> {
    vec![
        ("node-check", env!("CARGO_PKG_VERSION").into()),
        ("Node", args.node.to_string()),
        ("Bus", format!("{}, {} bit/s", args.bus, args.bitrate)),
        (
            "Serial port",
            args.port.as_ref().map_or("none".into(), |port| port.display().to_string()),
        ),
        board(),
    ]
}

/// A row for the terminal.
fn shown(row: &Row) -> String {
    let Row { what, expected, seen, verdict } = row;
    let expected = match verdict {
        Verdict::Failed => format!(" (expected: {expected})"),
        _ => String::new(),
    };
    format!("{verdict:8}{what}: {seen}{expected}")
}

/// What an earlier run has not put back.
fn left(path: &PathBuf) -> Result<Changed> {
    match fs::read(path) {
        Ok(text) => serde_json::from_slice(&text)
            .with_context(|| format!("{} is broken: remove it", path.display())),
        Err(_) => Ok(Changed::default()),
    }
}

fn remember(path: &Path, changed: &Changed) {
    let done = if changed.values.is_empty() {
        fs::remove_file(path)
    } else {
        fs::write(path, serde_json::json!(changed).to_string())
    };
    if let Err(error) = done {
        println!("cannot write {}: {error}", path.display());
    }
}

fn write(args: &Args, report: &Report) -> Result<()> {
    let json = format!("{:#}\n", report.json());
    for (name, text) in [("report.md", report.markdown()), ("report.json", json)] {
        let path = args.report.join(name);
        fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}
