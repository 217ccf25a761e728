//! What the simulator observes never exceeds what the package `bounds` proves from the machine
//! code: of the programs that ship, on a full bus, of firmwares with third-party drivers, and of
//! programs of avr-gcc in other styles.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use bench::avr::Avr;
use bench::board::Board;
use bench::{Bench, root, target_dir};
use bounds::annotations::Annotations;
use bounds::chip::Chip;
use bounds::report::{Report, Scope};
use rig::flood::{Flood, Scenario, Setup, Traffic};
use rig::load::{Kind, Load, Pace, Sender};
use rig::observed::{Observer, Pair};
use rig::reception::Reception;
use rig::{MS, parallel};

/// Simulated time of each flood.
const FLOOD_MS: u64 = 200;

/// What is proved of an ELF with a file of annotations.
#[track_caller]
fn proved(elf: &Path, annotations: &str) -> Report {
    let annotations = Annotations::parse(annotations).expect("annotations");
    let bytes = fs::read(elf).unwrap_or_else(|error| panic!("{}: {error}", elf.display()));
    let chip = Chip::of_elf(&bytes).expect("an ELF").unwrap_or(Chip::Atmega168);
    Report::of(&bytes, chip, annotations, Scope::Everything)
        .unwrap_or_else(|error| panic!("{error:#}"))
}

/// Prints the figures, and fails if one exceeds its proof.
#[track_caller]
fn check(program: &str, pairs: &[Pair]) {
    for Pair { name, proved, observed } in pairs {
        println!("{program}: {name}: proved {proved}, observed {observed}");
    }
    let wrong: Vec<&Pair> = pairs.iter().filter(|pair| pair.observed > pair.proved).collect();
    assert!(wrong.is_empty(), "{program}: more than proved: {wrong:#?}");
}

fn setups() -> Vec<Setup> {
    let chip = rig::board().chip;
    Setup::ALL.into_iter().filter(|setup| setup.chip() == chip).collect()
}

#[test]
fn the_programs_that_ship_stay_within_their_bounds_on_a_full_bus() {
    let annotations = fs::read_to_string(root().join("avr-specs/bounds.toml")).expect("a file");
    let elves: BTreeSet<PathBuf> = setups().iter().map(Setup::elf).collect();
    let reports: BTreeMap<PathBuf, Report> =
        elves.into_iter().map(|elf| (elf.clone(), proved(&elf, &annotations))).collect();
    let floods: Vec<Scenario> =
        setups().into_iter().map(|setup| Scenario::full(setup, Traffic::Mixed)).collect();
    let found = parallel::each(&floods, |scenario| {
        let report = &reports[&scenario.setup.elf()];
        let mut flood = Flood::new(*scenario);
        let times = report.times.as_ref().expect("times");
        let observer = Observer::begin(flood.rig.board().avr_mut(), times);
        flood.run_ms(FLOOD_MS);
        observer.observed().beside(report)
    });
    for (scenario, pairs) in floods.iter().zip(found) {
        let seen = |name: &str| pairs.iter().any(|pair| pair.name.starts_with(name));
        assert!(seen("handler of INT0") && seen("INT0 blocked"), "{pairs:?}");
        check(&scenario.setup.to_string(), &pairs);
    }
}

#[test]
fn the_bootloader_stays_within_its_bounds_on_a_blocked_bus() {
    let wiring = rig::board();
    let report = rig::loader::report(&wiring);
    let pairs = rig::loader::observed(&wiring, &report);
    check("bootloader", &pairs);
    // Most of a turn is the wait for the bus, and most of the start the CRC of the program.
    for name in ["from the reset to the program", "turn of the main loop"] {
        let pair = pairs.iter().find(|pair| pair.name == name).expect("a figure");
        assert!(pair.observed > pair.proved / 10 * 7, "{pair:?}");
    }
}

/// Cycles that the calculation of the reception must leave.
const LEAST_MARGIN: i64 = 10;

/// With several outputs it is only tested (tests/boards/full_bus.rs).
#[test]
fn it_is_proved_that_a_node_with_one_output_loses_no_frame_in_its_controller() {
    let presets: BTreeSet<PathBuf> = setups().iter().map(Setup::elf).collect();
    let presets: Vec<PathBuf> = presets.into_iter().collect();
    let margins = parallel::each(&presets, |elf| {
        let elf = fs::read(elf).expect("the program was built");
        Reception::of(&elf, false).least_margin()
    });
    for (elf, margin) in presets.iter().zip(margins) {
        println!("{}: {margin:?}", elf.display());
        assert!(margin.is_some_and(|cycles| cycles >= LEAST_MARGIN), "{}", elf.display());
    }
}

/// These firmwares enable no interrupts.
#[test]
fn firmwares_with_third_party_drivers_stay_within_their_stack() {
    for name in ["mcp2515-crate", "mcp25xx-crate"] {
        let directory = format!("avr-{}/firmware", Chip::Atmega168.name());
        let elf = target_dir().join(directory).join(format!("third-party-{name}.elf"));
        assert!(elf.exists(), "{} is missing: run `make third-party`", elf.display());
        let report = proved(&elf, "");
        let mut board = Board::load(&elf).unwrap_or_else(|error| panic!("{error:#}"));
        // D4 low selects reception only.
        board.press_button(true);
        let observer = Observer::begin(board.avr_mut(), report.times.as_ref().expect("times"));
        let mut bench = Bench::new(1_000_000);
        bench.add_board(board, "third-party");
        let load = Load { kind: Kind::ThirdParty(2), priority: 0, pace: Pace::Full };
        let mut sender = Sender::attach(&mut bench, load);
        for _ in 0..FLOOD_MS {
            sender.feed(bench.now());
            let end = bench.now() + MS;
            bench.run_until(end);
        }
        let pairs = observer.observed().beside(&report);
        assert!(pairs[0].observed > 10, "{pairs:?}");
        check(name, &pairs);
    }
}

/// Compiles a program of tests/data/styles.
#[track_caller]
fn compiled(name: &str, optimisation: &str) -> PathBuf {
    let source = root().join("tests/data/styles").join(format!("{name}.c"));
    let elf = format!("{name}{optimisation}-{}.elf", std::process::id());
    let elf = std::env::temp_dir().join(elf);
    let status = Command::new("avr-gcc")
        .args(["-mmcu=atmega328p", "-std=gnu99", optimisation, "-o"])
        .args([&elf, &source])
        .status()
        .expect("avr-gcc");
    assert!(status.success(), "avr-gcc {}", source.display());
    elf
}

#[test]
fn programs_of_avr_gcc_stay_within_their_bounds() {
    let programs = [("state_machine", 2), ("nested", 2), ("masks", 2), ("sort", 1), ("windows", 1)];
    for (name, handlers) in programs {
        for optimisation in ["-Os", "-O1", "-O3"] {
            let elf = compiled(name, optimisation);
            let report = proved(&elf, "");
            let mut avr = Avr::load(&elf).unwrap_or_else(|error| panic!("{error:#}"));
            fs::remove_file(&elf).expect("the file is there");
            let observer = Observer::begin(&mut avr, report.times.as_ref().expect("times"));
            avr.run_until(2000 * MS);
            let observed = observer.observed();
            assert!(observed.handlers.len() == handlers, "{observed:?}");
            assert!(observed.turns > 1000, "{observed:?}");
            check(&format!("{name} {optimisation}"), &observed.beside(&report));
        }
    }
}
