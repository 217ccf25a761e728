//! docs/reliability.md: all cases, with what was measured.

use std::fmt::Write as _;

use super::{Case, Measured, bus, chip, input, processor};

const INTRODUCTION: &str = "\
# Reliability

What can go wrong, what the node makes of it, and how long that takes. `make reliability` measures it with the shipped ELF in the
simulator, and writes this page; `make test` holds each case to the limits in brackets (`tests/bus_faults.rs`, `chip_faults.rs`,
`processor_faults.rs` and `input_faults.rs`; the cases themselves are in `rig/src/faults`).

An autopilot commands the servo 50 times a second, with `OUT1_TIMEOUT` 300 ms and `OUT1_FS` the trim. *Told* is the time from the
beginning of the fault to the end of the line about it on the serial monitor. *Back* is the time from the end of the fault until a new
command is seen in a servo pulse **and** a request has been answered: it has the 20 ms between two commands and the 20 ms of the servo's
period in it, and 53 ms is as fast as it can be measured. The bits are those of the vendor-specific status code
([status.md](status.md)), which are checked, too. In every fault each pulse of the servo was a whole one, began 20 ms after the one
before, and had a width that is named here.

After a fault nothing floods the bus: what could not be sent in time is dropped, and a status says how the node is, not how it was.
";

const SOAK: &str = "
## In the long run

`make soak HOURS=4` lets the node live for simulated hours: commands 50 times a second, statuses, chatter of other nodes, a client that
asks, sets and saves now and then, and four times a minute or so one of twenty faults. Each must be over within a second. Between them
each command is followed and counted, each pulse has the width of a command just given and begins 20 ms after the one before, statuses
come in time and in order and with the true uptime, nothing is lost in the controller, parameters are what they were set to, and the
stack keeps to its place. `make test` does that for a minute (`tests/soak.rs`), and `make soak` for as long as you like.

Four hours on the Diecimila with the preset `default` (23 November 2026, an hour of a busy machine): 704,052 commands, 10,821 requests, 687
saves, 1,355,577 frames and 687 faults of 21 kinds. All was well; 40 frames were lost, each in a fault. The longest recovery took 180 ms,
from a controller that was held in configuration mode.

## Mistakes in the program

Tests that could not fail would prove nothing, so mistakes are put into the program, and the tests must notice them.

* `make mutants` runs cargo-mutants with the host's unit tests: on `crates/` and on those modules of `src/node` that decide a pulse, are
  trusted at a start, or say how the node is. In `actuator.rs`, `servo.rs`, `autopilot.rs`, `agenda.rs`, `condition.rs`, `health.rs` and
  `store.rs` it made 340 mistakes, 5 to 20 seconds each. The tests let 28 through at first. Eleven have unit tests now: ten in the safety
  switch, which only black-box tests knew, and one in the check of a CRC. Fifteen make the same program, and `.cargo/mutants.toml` leaves
  them out with the reason. Two are left, in how noise is spread over a new unique ID. None is left in what decides a pulse.
  In `parameters.rs`, `dronecan-wire` and `mcp2515-ordered` it made 905, a second each, and the tests let 109 through: most in what the
  node's tests on boards know and the crate's own did not, such as a stuck INT. 20 are left, all in the driver: constants of bits that its
  tests never see set, when it looks at the chip, and how often a bus-off counts. The tests on boards hold those to their limits.
* `make elf-mutants` breaks the shipped program in 24 places, such as no check of a CRC, a failsafe without limits, no watchdog, and runs
  the tests on simulated boards. Each was noticed.

## What is not noticed

* A filter or a mask of the controller that changes by itself: outside configuration mode all of them read as zero (DS20001801J 4.5), and
  to leave normal mode costs frames. The failsafe gives the controller its filters again, because they may be why commands stopped. A
  filter that lets too much in costs time only. One that keeps out requests or statuses is put right by the next failsafe or restart.
* A bit that flips on the SPI while a command is read: a frame of one piece has no checksum that goes as far as the program. The pulse
  stays within the travel, and the next command puts it right.
";

/// The chapters and their cases.
pub const CHAPTERS: [(&str, &[&Case]); 4] = [
    ("The bus", &bus::ALL),
    ("The CAN controller", &chip::ALL),
    ("The processor", &processor::ALL),
    ("The sensor, and what comes over the bus", &input::ALL),
];

/// The cells of a case's row; without a measurement those two that have one are empty.
pub fn row(case: &Case, measured: Option<Measured>) -> [String; 6] {
    let told = case.told_limit_ms.map(|limit| {
        let told = measured.and_then(|measured| measured.told_ms);
        format!("{} ({limit})", told.map_or(String::new(), |ms| format!("{ms:.0}")))
    });
    let back = measured.map_or(String::new(), |measured| format!("{:.0}", measured.recovery_ms));
    [
        case.fault.into(),
        case.noticed.into(),
        told.unwrap_or_default(),
        case.reaction.into(),
        case.servo.into(),
        format!("{back} ({})", case.limit_ms),
    ]
}

/// The whole page.
pub fn page(measure: impl Fn(&Case) -> Measured) -> String {
    let mut page = String::from(INTRODUCTION);
    for (title, cases) in CHAPTERS {
        let _ = write!(
            page,
            "\n## {title}\n\n\
             | what | noticed by | told, ms (limit) | reaction | servo | back, ms (limit) |\n\
             | --- | --- | ---: | --- | --- | ---: |\n"
        );
        for case in cases {
            let _ = writeln!(page, "| {} |", row(case, Some(measure(case))).join(" | "));
        }
    }
    page.push_str(SOAK);
    page
}
