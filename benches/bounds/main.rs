//! Prints what is proved of each program beside what the simulator observes, and the calculation of
//! the reception, and writes them to docs/benchmarks.md.
//!
//! Each program of both chips runs in floods of each kind of frame, of [`FLOOD_MS`] simulated time
//! each.

mod reception;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;

use bench::root;
use bounds::annotations::Annotations;
use bounds::chip::Chip;
use bounds::report::Report;
use reception::Reception;
use rig::flood::{Flood, Scenario, Setup, Traffic};
use rig::observed::{Observer, Pair};
use rig::parallel;

/// Simulated time of each flood.
const FLOOD_MS: u64 = 200;

const HEADING: &str = "## Proved and observed";

/// A ratio above this needs a reason.
const EXPLAINED: f64 = 1.5;

fn main() {
    // Cargo also asks bench targets to list their tests.
    if std::env::args().any(|argument| argument == "--list") {
        return;
    }
    let mut programs: BTreeMap<String, Vec<Setup>> = BTreeMap::new();
    for setup in Setup::ALL {
        programs.entry(program(setup)).or_default().push(setup);
    }
    let mut figures = String::from(
        "| program | figure | proved | observed | ratio |\n| --- | --- | ---: | ---: | ---: |\n",
    );
    let mut receptions = Reception::heading();
    for (name, setups) in &programs {
        let elf = fs::read(setups[0].elf()).expect("the program was built");
        let report = report(&elf, |_| {});
        for Pair { name: figure, proved, observed } in observed(setups, &report) {
            let proved = f64::from(proved);
            let ratio = if observed == 0 { 0.0 } else { proved / f64::from(observed) };
            let mark = if ratio > EXPLAINED { "*" } else { "" };
            let _ = writeln!(
                figures,
                "| {name} | {figure} | {proved} | {observed} | {ratio:.2}{mark} |"
            );
        }
        for has_edges in [false, true] {
            let several = setups.iter().any(|setup| setup.outputs() > 1);
            if !has_edges || several {
                let kind = match (has_edges, several) {
                    (true, _) => ", several outputs",
                    (false, true) => ", one output",
                    _ => "",
                };
                let row = Reception::of(&elf, has_edges).row(&format!("{name}{kind}"));
                receptions.push_str(&row);
            }
        }
    }
    let part = format!("{HEADING}\n\n{TEXT}\n{figures}\n{RATIOS}\n{RECEPTION}\n{receptions}");
    print!("{part}");
    rig::page::write_part(HEADING, &part);
}

fn program(setup: Setup) -> String {
    format!("{:?}", setup.preset).to_lowercase()
}

/// What is proved of a program with the project's annotations, which `change` may change.
pub fn report(elf: &[u8], change: impl FnOnce(&mut Annotations)) -> Report {
    let text = fs::read_to_string(root().join("avr-specs/bounds.toml")).expect("the annotations");
    let mut annotations = Annotations::parse(&text).expect("annotations");
    change(&mut annotations);
    let chip = Chip::of_elf(elf).expect("an ELF").expect("the program names its chip");
    Report::of(elf, chip, annotations, true).expect("the program can be followed")
}

/// The longest of all floods, the stretches of each interrupt together.
fn observed(setups: &[Setup], report: &Report) -> Vec<Pair> {
    let floods: Vec<Scenario> = setups
        .iter()
        .flat_map(|setup| Traffic::all(*setup).into_iter().map(|kind| Scenario::full(*setup, kind)))
        .collect();
    let times = report.times.as_ref().expect("times");
    let all = parallel::each(&floods, |scenario| {
        let mut flood = Flood::new(*scenario);
        let observer = Observer::begin(flood.rig.board().avr_mut(), times);
        flood.run_ms(FLOOD_MS);
        observer.observed().beside(report)
    });
    let mut longest: Vec<Pair> = Vec::new();
    for pair in all.into_iter().flatten() {
        let name = without_addresses(&pair.name);
        match longest.iter_mut().find(|other| other.name == name && other.proved == pair.proved) {
            Some(known) => known.observed = known.observed.max(pair.observed),
            None => longest.push(Pair { name, ..pair }),
        }
    }
    // Of a handler there is a row already.
    longest.retain(|pair| !pair.name.contains("__vector") && pair.proved != u32::MAX);
    longest
}

/// Addresses differ with each change of the program.
fn without_addresses(name: &str) -> String {
    let words = name.split(' ').filter(|word| !word.starts_with("0x") && *word != "to");
    words.collect::<Vec<&str>>().join(" ").replace("__avr_device_rt_main", "the main loop")
}

const TEXT: &str = "\
Written by `make bounds-page`. *Proved* is the longest path of the machine code (bounds.md),
*observed* the most in floods of each kind of frame. Cycles of 62.5 ns; the stack in bytes. INT0 is
the interrupt of the controller. A stretch of the main loop takes from the instruction that masks it
to the one that unmasks it.
";

const RATIOS: &str = "\
The ratios above 1.5, marked by `*`:

* *Handler of INT0*: the proof reads three frames in one call, and on the ATmega328P eight, as many
  as the queue has places. In the floods the handler reads each frame before the next one ends. For
  one frame the proof is 925 to 953 cycles: it checks for a second one.
* *INT0 blocked* for more than 2,000 cycles in the main loop is the same code, called when INT0 has
  missed a frame, which is one frame at most in the floods.
* *Handler of TIMER0_COMPB*: the proof adds up a handler that waits for the farthest edge and passes
  over all outputs without a pulse.
* *The turn of the main loop* is a sum over all parts of a turn. The agenda chooses one of them, by
  values in RAM that the analysis does not follow. So it is no bound to plan with.
";

const RECEPTION: &str = "\
### Reception

Frames arrive as fast as the bus allows, without stuff bits: 1,072 cycles for a frame without data,
1,328 for the shortest of a transfer, 2 bytes, and 128 for each further byte. A frame waits at most
for the *rest* of the handler, which has just looked at INT, for the longest *masked* stretch of the
main loop, and for its own *release*; each *further frame* adds its part while there is a backlog.
The handler of the millisecond interrupts all of these, and with several outputs that of the edges
each 100 us. The table has the longest time from the end of a frame to the release of its buffer
(frames each 1,328 cycles), and the margin until a frame would be lost: at the second frame behind
it with two buffers, at the next one with one. SafetyState, ArmingStatus and ServoCommand have one
buffer and 2 bytes, all other types two buffers: a command 5 bytes or more, a request 1 or more.
*Only tested*: the calculation does not prove it; a negative number is what is missing. The floods
of `make losses` and `make test` test it. The queue of received frames needs a bound of the main
loop's turn, so it is only tested.
";
