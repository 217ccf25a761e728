//! Counts the frames that each program loses on a full bus of 1 Mbit/s, with random values, for ten
//! simulated minutes of each kind of frame. Prints a line after each, and writes it into its part
//! of docs/benchmarks.md with the sentence that README.md and docs/decisions.md quote.
//!
//! `NODE_BOARD` chooses the programs: those of the Diecimila (ATmega168) or of the Uno
//! (ATmega328P). `MINUTES` is another duration; below a minute the page is not written. With
//! `WHY=1` it also prints the turns of the main loop in which the queue of received frames became
//! full, with their cycles. `ONLY` selects the floods whose row contains this text: the page keeps
//! the other rows.

mod page;

use std::sync::Mutex;
use std::time::Instant;

use page::{Page, Row};
use rig::flood::{Pace, Scenario, Setup, Traffic, run};
use rig::parallel;

/// Simulated duration of each flood, in minutes.
const MINUTES: f64 = 10.0;

/// The floods of a program: of each kind from one sender below the node's priority, and mixed ones
/// from two senders, above it, in bursts, and on a disturbed bus.
fn floods(setup: Setup) -> Vec<Scenario> {
    let mut all: Vec<Scenario> =
        Traffic::all(setup).into_iter().map(|traffic| Scenario::full(setup, traffic)).collect();
    let mixed = Scenario::full(setup, Traffic::Mixed);
    all.push(Scenario { senders: 2, seed: 2, ..mixed });
    all.push(Scenario { priority: 0, seed: 3, ..mixed });
    all.push(Scenario { pace: Pace::Bursts, seed: 4, ..mixed });
    all.push(Scenario { noise_per_million: 1000, seed: 5, ..mixed });
    all.push(Scenario { noise_per_million: 10_000, seed: 6, ..mixed });
    all
}

fn main() {
    // Cargo also asks bench targets to list their tests.
    if std::env::args().any(|argument| argument == "--list") {
        return;
    }
    let minutes = match std::env::var("MINUTES") {
        Ok(text) if !text.is_empty() => text
            .parse()
            .unwrap_or_else(|error| panic!("MINUTES={text} is no number of minutes: {error}")),
        _ => MINUTES,
    };
    let chip = rig::board().chip;
    let setups = Setup::ALL.into_iter().filter(|setup| setup.chip() == chip);
    let is_set = |name: &str| std::env::var(name).is_ok_and(|text| !text.is_empty());
    let only = std::env::var("ONLY").unwrap_or_default();
    let all: Vec<Scenario> = setups
        .flat_map(floods)
        .map(|flood| Scenario { explains: is_set("WHY"), ..flood })
        .collect();
    let floods: Vec<Scenario> =
        all.iter().copied().filter(|flood| page::name(*flood).contains(&only)).collect();
    let page = Mutex::new(Page::new(chip, &all));
    let commit = rig::page::commit();
    let begun = Instant::now();
    let rows = parallel::each(&floods, |&scenario| {
        let outcome = run(scenario, (minutes * 60_000.0) as u64);
        let row = Row::of(scenario, minutes, &outcome, &commit);
        let mut text = format!("{:5.0} s  {row}\n", begun.elapsed().as_secs_f64());
        for turns in &outcome.fills {
            text += &format!("  the queue became full after these turns, cycles:\n{turns}\n");
        }
        eprint!("{text}");
        if minutes >= 1.0 {
            page.lock().expect("no row failed").write(&row);
        }
        row
    });
    print!("{}", page::part(&rows, chip, all.len()));
}
