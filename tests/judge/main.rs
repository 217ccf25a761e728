//! The judge of the package `bounds`: random programs are analysed and run, with random inputs and
//! with interrupts at random instructions. What is seen may not exceed what was proved.
//!
//!     cargo test -p tests --test judge -- --nocapture
//!     JUDGE_SECONDS=1800 JUDGE_SEED=7 ...       longer, and other programs
//!     JUDGE_SECONDS=0 JUDGE_SEED=1234 ...       only the program of this seed
//!
//! A program that exceeds its bounds is kept in the target directory.

mod assembler;
mod c;
mod random;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use bench::avr::{Avr, State};
use bench::target_dir;
use bounds::annotations::Annotations;
use bounds::chip::Chip;
use bounds::report::{Report, Scope};
use rig::observed::{OF_KINDS, Observer, Pair, WITH_CALL};

use random::Random;

/// How long the programs are generated, unless JUDGE_SECONDS says otherwise.
const SECONDS: u64 = 20;
/// Steps of a run, between which inputs change, and the most cycles of one.
const STEPS: u32 = 4_000;
const STEP_CYCLES: u64 = 70;
/// The pins of INT0, INT1, the pin change interrupt and of inputs that programs read.
const INPUTS: [(char, u8); 6] = [('D', 2), ('D', 3), ('B', 0), ('B', 3), ('C', 1), ('C', 4)];

/// A number from the environment.
fn setting(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok().filter(|text| !text.is_empty())?;
    Some(text.parse().unwrap_or_else(|_| panic!("{name} is no number: {text}")))
}

/// What became of the programs.
#[derive(Default)]
struct Verdicts {
    /// For each kind of program: those that were analysed, and those that were refused.
    programs: BTreeMap<&'static str, (u32, u32)>,
    /// Why programs were refused, and how many.
    reasons: BTreeMap<String, u32>,
    /// For each kind of figure: how many have a bound, the greatest and the least ratio of the
    /// bound to what was seen, and the seeds of these.
    figures: BTreeMap<String, Figure>,
}

struct Figure {
    number: u32,
    unbounded: u32,
    worst: (f64, u64),
    closest: (f64, u64),
}

#[test]
fn random_programs_stay_within_their_bounds() {
    let (first, seconds) = (setting("JUDGE_SEED"), setting("JUDGE_SECONDS"));
    let until = Instant::now() + Duration::from_secs(seconds.unwrap_or(SECONDS));
    let mut verdicts = Verdicts::default();
    let mut seed = first.unwrap_or(1);
    println!("seeds from {seed}");
    loop {
        judge(seed, &mut verdicts);
        seed += 1;
        if Instant::now() >= until {
            break;
        }
    }
    verdicts.print(seed);
    if seconds != Some(0) {
        for (kind, (analysed, _)) in &verdicts.programs {
            assert!(*analysed > 0, "no program of {kind} was analysed");
        }
    }
}

/// Writes, analyses and runs the program of a seed.
fn judge(seed: u64, verdicts: &mut Verdicts) {
    let mut random = Random::new(seed);
    let directory = target_dir().join("judge");
    fs::create_dir_all(&directory).expect("a directory");
    let (kind, elf, annotations) = write(&mut random, &directory.join(seed.to_string()));
    let bytes = fs::read(&elf).expect("the program");
    let annotations = Annotations::parse(&annotations).expect("annotations");
    let count = verdicts.programs.entry(kind).or_default();
    let report = match Report::of(&bytes, Chip::Atmega168, annotations, Scope::Everything) {
        Ok(report) => report,
        Err(error) => {
            count.1 += 1;
            let text = format!("{error:#}");
            assert!(text.contains("0x") || text.contains("recursion"), "seed {seed}: {text}");
            *verdicts.reasons.entry(kind_of(&text)).or_default() += 1;
            return remove(&elf);
        }
    };
    count.0 += 1;
    let pairs = run(&elf, &report, &mut random);
    for pair in &pairs {
        assert!(
            pair.observed <= pair.proved,
            "seed {seed}, {}: {}: proved {}, seen {}",
            elf.display(),
            pair.name,
            pair.proved,
            pair.observed
        );
        verdicts.count(seed, pair);
    }
    remove(&elf);
}

/// Writes the source and the ELF of a program. Returns its kind, the ELF, and its annotations.
fn write(random: &mut Random, path: &Path) -> (&'static str, PathBuf, String) {
    let optimisation = random.pick(&["-O0", "-Os", "-O2"]);
    let (kind, text, ending, options, annotations) = if random.percent(50) {
        let c::Source { text, annotations } = c::program(random);
        (optimisation, text, "c", vec!["-std=gnu99", optimisation], annotations)
    } else {
        let text = assembler::program(random);
        ("assembler", text, "S", vec!["-nostartfiles", "-nostdlib"], String::new())
    };
    let (source, elf) = (path.with_extension(ending), path.with_extension("elf"));
    fs::write(&source, text).expect("a file");
    let output = Command::new("avr-gcc")
        .args(["-mmcu=atmega168", "-w", "-o"])
        .arg(&elf)
        .args(options)
        .arg(&source)
        .output()
        .expect("avr-gcc");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}: {errors}", source.display());
    (kind, elf, annotations)
}

/// Removes a program that has shown nothing.
fn remove(elf: &Path) {
    for ending in ["elf", "c", "S"] {
        let _ = fs::remove_file(elf.with_extension(ending));
    }
}

/// What was proved beside what a run has shown.
fn run(elf: &Path, report: &Report, random: &mut Random) -> Vec<Pair> {
    let mut avr = Avr::load(elf).unwrap_or_else(|error| panic!("{error:#}"));
    let observer = Observer::begin(&mut avr, report.times.as_ref().expect("times"));
    for _ in 0..STEPS {
        let (port, bit) = random.pick(&INPUTS);
        avr.drive_pin(port, bit, random.percent(50));
        let end = avr.now() + 1 + random.below(STEP_CYCLES);
        if let State::Crashed(pc) = avr.run_until(end) {
            panic!("{}: the program has crashed at {pc:#x}", elf.display());
        }
    }
    observer.observed().beside(report)
}

/// The reason of a refusal without addresses, names and numbers.
fn kind_of(text: &str) -> String {
    let reason = text.split(" in ").last().unwrap_or(text);
    let words =
        reason.split(' ').filter(|word| !word.chars().any(|letter| letter.is_ascii_digit()));
    words.take(9).collect::<Vec<&str>>().join(" ")
}

impl Verdicts {
    fn count(&mut self, seed: u64, pair: &Pair) {
        let kind = match pair.name.split_once(' ') {
            Some((first, rest)) if rest.starts_with("blocked") => format!("{first} blocked"),
            Some(("handler", _)) => "handler".into(),
            _ if pair.name.starts_with(WITH_CALL) => WITH_CALL.into(),
            _ if pair.name.starts_with(OF_KINDS) => "turn of a kind".into(),
            _ => pair.name.clone(),
        };
        let ratio = f64::from(pair.proved) / f64::from(pair.observed.max(1));
        let none = (1.0, 0);
        let figure = self.figures.entry(kind).or_insert(Figure {
            number: 0,
            unbounded: 0,
            worst: none,
            closest: (f64::MAX, 0),
        });
        if pair.proved == u32::MAX {
            figure.unbounded += 1;
        } else if pair.observed > 0 {
            figure.number += 1;
            if ratio > figure.worst.0 {
                figure.worst = (ratio, seed);
            }
            if ratio < figure.closest.0 {
                figure.closest = (ratio, seed);
            }
        }
    }

    fn print(&self, end: u64) {
        println!("programs up to seed {}:", end - 1);
        for (kind, (analysed, refused)) in &self.programs {
            println!("  {kind}: {analysed} analysed and run, {refused} refused");
        }
        for (reason, number) in &self.reasons {
            println!("  refused {number}: {reason}");
        }
        println!("bound to seen:");
        for (kind, Figure { number, unbounded, worst, closest }) in &self.figures {
            if *number == 0 {
                println!("  {kind}: {unbounded} without a bound");
                continue;
            }
            println!(
                "  {kind}: {number} figures, from {:.2} (seed {}) to {:.2} (seed {}); {unbounded} \
                 without a bound",
                closest.0, closest.1, worst.0, worst.1
            );
        }
    }
}
