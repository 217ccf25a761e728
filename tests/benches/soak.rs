//! Runs a node with random faults for simulated hours: see `rig::soak`. `make soak HOURS=4`, or see
//! `--help`.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use bench::Cycles;
use rig::MS;
use rig::soak::Soak;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

const HELP: &str = "\
Runs the firmware with random faults for hours of simulated time: an autopilot commands its servo, \
                    on an ATmega328P six of
eight outputs, and other nodes command theirs, begin commands that never end, and send what is \
                    rejected. A client reads, sets and
saves parameters, changes types of outputs and asks for updates, and about four faults a minute \
                    happen. Between faults nothing may
be lost. The firmware must recover from each fault within a second.

  make soak                     one hour
  make soak HOURS=4             four
  make soak BOARD=uno           one with the program and the chip of an Uno
  make soak HOURS=0.1 SEED=7    six minutes with other faults

SOAK_HOURS and SOAK_SEED in the environment are the same variables. It prints a line each \
                    simulated minute. Ctrl-C ends it with a
summary. The exit code is 0 if no check failed, 1 if one failed, 130 after Ctrl-C.";

const MINUTE: Cycles = 60_000 * MS;

fn setting(name: &str, default: f64) -> Result<f64, String> {
    let Some(text) = std::env::var(name).ok().filter(|text| !text.is_empty()) else {
        return Ok(default);
    };
    let number = text.parse().ok().filter(|number: &f64| number.is_finite() && *number >= 0.0);
    number.ok_or_else(|| {
        format!("{name} is \"{text}\": use a number, as in \"make soak HOURS=4 SEED=7\"")
    })
}

fn main() -> ExitCode {
    // Cargo also asks bench targets to list their tests.
    if std::env::args().any(|argument| argument == "--list") {
        return ExitCode::SUCCESS;
    }
    if std::env::args().any(|argument| argument == "--help") {
        println!("{HELP}");
        return ExitCode::SUCCESS;
    }
    let (hours, seed) = match (setting("SOAK_HOURS", 1.0), setting("SOAK_SEED", 1.0)) {
        (Ok(hours), Ok(seed)) => (hours, seed as u64),
        (Err(error), _) | (_, Err(error)) => {
            eprintln!("{error}");
            return ExitCode::from(2);
        }
    };
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        // The second signal ends the program at once.
        flag::register_conditional_shutdown(signal, 130, Arc::clone(&stop))
            .expect("a signal that can be caught");
        flag::register(signal, Arc::clone(&stop)).expect("a signal that can be caught");
    }
    let is_to_stop = || stop.load(Ordering::Relaxed);

    println!("{hours} simulated hours, seed {seed}");
    let started = Instant::now();
    let end = (hours * 60.0 * MINUTE as f64) as Cycles;
    let mut soak = Soak::new(seed);
    let result = catch_unwind(AssertUnwindSafe(|| {
        while soak.now() < end && !is_to_stop() {
            let minute = soak.now() + MINUTE;
            soak.run_until(end.min(minute), &is_to_stop);
            let faults: u32 = soak.report.faults.values().map(|(count, _)| count).sum();
            println!(
                "{:6.1} min: {} commands, {faults} faults, {:.1} times real time",
                soak.now() as f64 / MINUTE as f64,
                soak.report.commands,
                soak.now() as f64 / (1000 * MS) as f64 / started.elapsed().as_secs_f64()
            );
        }
    }));
    println!("\n{}", soak.report);
    let lived = soak.now() as f64 / (60.0 * MINUTE as f64);
    match result {
        Err(_) => {
            println!(
                "a check FAILED after {lived:.3} simulated hours, seed {seed}; see above. \
                 SOAK_SEED={seed} repeats it."
            );
            // After a failed check the rig's final checks are not needed.
            std::mem::forget(soak);
            ExitCode::FAILURE
        }
        Ok(()) if is_to_stop() => {
            println!("stopped after {lived:.3} simulated hours; no check had failed");
            ExitCode::from(130)
        }
        Ok(()) => {
            println!("no check failed in {lived:.3} simulated hours");
            ExitCode::SUCCESS
        }
    }
}
