//! What the simulator observes never exceeds what the package `bounds` proves from the machine
//! code: of the programs that ship, on a full bus, of firmwares with third-party drivers, and of
//! programs of avr-gcc in other styles.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use bench::avr::Avr;
use bench::board::Board;
use bench::wiring::Wiring;
use bench::{Bench, firmware_for, root, target_dir};
use bounds::annotations::Annotations;
use bounds::chip::Chip;
use bounds::report::{Report, Scope};
use rig::flood::{Flood, Scenario, Setup, Traffic};
use rig::load::{Kind, Load, Pace, Sender};
use rig::observed::{OF_KINDS, Observer, Pair, ROUNDS};
use rig::reception::{Buffers, Reception};
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
        let seen =
            |name: &str| pairs.iter().any(|pair| pair.name.starts_with(name) && pair.observed > 0);
        let of_each = ["handler of INT0", "INT0 blocked", ROUNDS];
        assert!(of_each.into_iter().all(seen), "{pairs:?}");
        for kind in ["tick", "send"] {
            assert!(seen(&format!("{OF_KINDS}{kind}")), "{kind}: {pairs:?}");
        }
        check(&scenario.setup.to_string(), &pairs);
    }
}

/// One that has the former name of a function would bound nothing, and nobody would notice.
#[test]
#[ignore = "takes long: make test-all"]
fn each_annotation_says_something_about_a_program_that_is_built() {
    let annotations = fs::read_to_string(root().join("avr-specs/bounds.toml")).expect("a file");
    let of_each: [(&str, &[&str]); 2] =
        [("diecimila", &["default", "remote", "thesis"]), ("uno", &["full", "outputs,rpm"])];
    let elves: Vec<PathBuf> = of_each
        .into_iter()
        .flat_map(|(board, names)| names.iter().map(move |name| firmware_for(board, "seeed", name)))
        .map(|elf| elf.unwrap_or_else(|error| panic!("{error:#}")))
        .collect();
    let unused = parallel::each(&elves, |elf| proved(elf, &annotations).unused);
    assert_eq!(by_none(unused), [""; 0], "entries of bounds.toml for no program");
    let loaders = ["diecimila", "uno"].map(|board| {
        let wiring = Wiring::of(board, "seeed").unwrap_or_else(|error| panic!("{error:#}"));
        rig::loader::report(&wiring).unused
    });
    assert_eq!(by_none(loaders.to_vec()), [""; 0], "entries of bounds-boot.toml for no loader");
}

/// What is in each of the lists.
fn by_none(unused: Vec<Vec<String>>) -> Vec<String> {
    let [first, others @ ..] = &unused[..] else { return vec![] };
    first.iter().filter(|name| others.iter().all(|other| other.contains(name))).cloned().collect()
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

/// With several outputs for frames of commands, five bytes or more: shorter ones are only tested
/// (tests/boards/full_bus.rs).
#[test]
fn it_is_proved_that_the_controller_loses_no_frame() {
    let presets: BTreeSet<PathBuf> = setups().iter().map(Setup::elf).collect();
    let presets: Vec<PathBuf> = presets.into_iter().collect();
    let margins = parallel::each(&presets, |elf| {
        let elf = fs::read(elf).expect("the program was built");
        let one = Reception::of(&elf);
        let several = one.with_several_outputs();
        let of_several =
            [5, 8].map(|bytes| several.as_ref().map(|several| several.margin(bytes, Buffers::Two)));
        [Some(one.least_margin())].into_iter().chain(of_several).flatten().collect::<Vec<_>>()
    });
    for (elf, margins) in presets.iter().zip(margins) {
        println!("{}: {margins:?}", elf.display());
        let is_proved = |margin: &Option<i64>| margin.is_some_and(|least| least >= LEAST_MARGIN);
        assert!(margins.iter().all(is_proved), "{}: {margins:?}", elf.display());
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
#[ignore = "takes long, and depends on no firmware"]
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
