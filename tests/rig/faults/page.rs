//! Writes docs/reliability.md: all cases with their measured times.

use std::fmt::Write as _;

use super::{Case, Measured, bus, chip, input, processor};

const INTRODUCTION: &str = "\
# Reliability

Each fault, what the node does, and how long it takes. `make reliability` measures this with the
shipped ELF in the simulator, and writes this page. `make test` (`make test-long` for the slowest)
checks each case against the limits in brackets (`bus_faults.rs`, `chip_faults.rs`,
`processor_faults.rs` and `input_faults.rs` in `tests/boards`; the cases are in `tests/rig/faults`).

An autopilot commands the servo 50 times a second, with `OUT1_TIMEOUT` 300 ms and `OUT1_FS` the
trim. *Logged* is the time from the beginning of the fault to the end of its line on the serial
monitor. *Back* is the time from the end of the fault until a servo pulse shows a new command
**and** the node has answered a request. It includes the 20 ms between two commands and the 20 ms of
the servo's period, so a node that notices nothing of a fault takes 53 ms. The bits are those of the
vendor-specific status code ([status.md](status.md)); the tests check them, too. In every fault but
a reset, which ends the pulses, each pulse of the servo was complete, began 20 ms after the one
before, and had a width that the column *servo* allows.

After a fault the node does not flood the bus: it drops frames that it could not send in time, and a
status has the current state.

The figures are those of a typical chip. `make test-long` checks the limits at four corners of its
tolerances (`sim --help faults`): the node's own times are up to 0.5 % longer or shorter, as its
resonator, and all that follows a reset comes up to 73 ms later.
";

const DEAF: &str = "
## When the node is deaf

While the controller is configured or only listens, the node receives nothing. No frame and no error
of others starts that while frames of the node's own rate pass, once its rate is proven: after 1.2 s
on the bus, or after it has heard valid frames between errors (`PROOF` in
`crates/mcp2515-ordered/src/driver.rs`). `of_the_commands_that_pass_in_a_fault_…` in
`tests/boards/bus_faults.rs` goes through all faults of `sim --help faults`: of the commands that
pass, the node follows at least 95 of 100, unless the fault cuts it off.

| what | started by | deaf for | how often others can start it |
| --- | --- | --- | --- |
| start of the controller | a start of the program, a change of its registers | 5 to 6 ms | never |
| new filters | a node ID, the first motor, the beginning of a failsafe, if no ArrayCommand came since the last one that was followed | 5 ms | once in each failsafe |
| controller without an answer, bus held dominant | wires, power, a short circuit | until it is over, and 0.1 s | never |
| listening before the rate is proven | an error in the first 1.2 s after a start or a pulled cable | in noise 0.5 s, at 5 frames a second 1.2 s; else 0.1 to 0.2 s after the last error | until the rate is proven |
| listening after it is proven | error-passive, and no frame received for 1.5 s | the same | only who lets no frame pass for 1.5 s |
| search with `CAN_BAUDRATE` 0 | a start | until the rate is found: 1 s beside an autopilot, 6 s where two nodes send their status only | while it searches |
| bootloader, before it sends | a restart into it | until a frame without an error; after errors it tries the next rate each second | with errors, all the time: an update waits until the noise is over |

A rate of the bus that changes without a gap looks like noise: the node sends 100 to 3,100 error
frames within 2.5 s, and then listens. Nodes of one wrong rate that have the bus to themselves for
1.2 s prove their rate to each other, and send up to 400 error frames each: power them up beside the
autopilot.
";

const SOAK: &str = "
## Long runs

`make soak HOURS=4` runs a node for simulated hours: 50 commands a second, statuses and other
messages of other nodes, a client that reads, sets and saves parameters, and about four times a
minute one of 21 kinds of faults (22 with the preset `full`). The node must recover from each within
a second. Between the faults it must follow and count each command, in pulses that begin 20 ms after
the one before, send its statuses in time and in order, and lose nothing. `make test-long` does this
for a minute (`tests/boards/soak.rs`). In four hours no check failed; the longest recovery took 200
ms, from a short circuit of the bus.

## Mistakes in the program

A test that cannot fail proves nothing. So two programs put mistakes into the firmware, and the
tests must notice them: `make mutants` with the unit tests (`.cargo/mutants.toml` leaves out
mistakes that make the same program), and `make elf-mutants`, which breaks the shipped program in
each place that `tests/elf-mutants.txt` names and runs the tests on simulated boards. What a test on
a board says has no unit test besides: a mistake in `src` that `make mutants` lists as missed must
fail on a board.

## What the node does not notice

* A filter or a mask of the controller that changes by itself: outside configuration mode all of
  them read as zero (DS20001801J 4.5), and a change of mode loses frames. The failsafe writes the
  filters again, because a changed filter may be why commands stopped. A filter that accepts too
  much only costs time. One that rejects requests or statuses is corrected by the next failsafe or
  restart.
* A bit of RXB1CTRL, TXRTSCTRL or BFPCTRL that flips, until the next failsafe or restart. RXM in
  RXB1CTRL can turn off the filters of buffer 1: the program rejects what comes in addition, and
  loses nothing on a full bus. The other two give functions to pins that are not connected; those
  that are inputs have pull-ups (DS20001801J table 1-1). `tests/boards/chip_faults.rs` flips them.
* A bit that flips on the SPI while the node reads a command: a single-frame transfer has no CRC
  that the program can check. The pulse stays within the travel, and the next command corrects it.
";

/// Titles of the chapters, with their cases.
const CHAPTERS: [(&str, &[&Case]); 4] = [
    ("The bus", &bus::ALL),
    ("The CAN controller", &chip::ALL),
    ("The processor", &processor::ALL),
    ("The sensor and the received frames", &input::ALL),
];

/// The cells of a case's row.
fn row(case: &Case, measured: Measured) -> [String; 6] {
    let logged = case.logged_limit_ms.map(|limit| {
        format!("{:.0} ({limit})", measured.logged_ms.expect("Case::run has checked it"))
    });
    [
        case.fault.into(),
        case.noticed.into(),
        logged.unwrap_or_default(),
        case.reaction.into(),
        case.servo.into(),
        format!("{:.0} ({})", measured.recovery_ms, case.limit_ms),
    ]
}

/// The whole page, with the times that `measure` returns for each case.
pub fn page(measure: impl Fn(&Case) -> Measured) -> String {
    let mut page = format!("{INTRODUCTION}\n{}\n", crate::page::measured());
    for (title, cases) in CHAPTERS {
        let _ = write!(
            page,
            "\n## {title}\n\n\
             | what | noticed by | logged, ms (limit) | reaction | servo | back, ms (limit) |\n\
             | --- | --- | ---: | --- | --- | ---: |\n"
        );
        for case in cases {
            let _ = writeln!(page, "| {} |", row(case, measure(case)).join(" | "));
        }
    }
    page.push_str(DEAF);
    page.push_str(SOAK);
    page
}
