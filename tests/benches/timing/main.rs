//! Timing of the shipped ELF in cycles of its AVR, that of firmwares with third-party drivers, and
//! the speed of the simulator. Prints all, and writes docs/benchmarks.md with its plots.
//!
//! It measures everything from outside: at the pins, on the SPI, on the bus, and by the program
//! counter.

mod plot;
mod third_party;

use std::fmt::Write as _;
use std::time::Instant;

use bench::Cycles;
use bench::autopilot::{Profile as Autopilot, Settings};
use bench::budget::{PAINT, budget};
use plot::{Axis, Plot};
use rig::load::{Client, Figures, Kind, Load, Loaded, Meter, Pace, Samples, run, run_all};
use rig::profile::{Names, Profile};
use rig::{MS, Program, Rig};
use third_party::{ThirdParty, receive};

/// Simulated durations.
const LOAD_MS: u64 = 2000;
const FOREIGN_MS: u64 = 1200;
const SOAK_MS: u64 = 60_000;
/// The loads that run for [`SOAK_MS`].
const SOAKED: [Kind; 8] = [
    Kind::Command(0),
    Kind::Command(5),
    Kind::Command(8),
    Kind::LongCommand,
    Kind::Status(0),
    Kind::Thesis,
    Kind::LookAlike(1),
    Kind::Mixed,
];
const PROFILE_MS: u64 = 4000;
const LOSS_MS: u64 = 500;
const SPEED_MS: u64 = 2000;

/// What `scripts/own-node-uno --compare` printed. It needs avr-hal, which is in no registry.
const OWN_NODE: &str = "\
    \n\
    own-node on an Uno with arduino-hal receives by INT0 into a queue of eight frames, with our \
    driver or with the crate\n\
    `mcp2515` (`scripts/own-node-uno --compare`). Frames lost in 5 s, of those on the bus; \
    *served* is the longest time\n\
    from the end of a frame to the release of its buffer:\n\
    \n\
    | driver | flash | variables | stack | ArduPilot | PX4 | 20 motors at 400 Hz | full bus | \
    served |\n\
    | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n\
    | `mcp2515-ordered` | 13,096 B | 383 B | 595 B | 0 of 2,495 | 0 of 2,375 | 0 of 14,459 | 0 \
    of 34,311 | 89 us |\n\
    | `mcp2515` 0.3 | 15,344 B | 319 B | 740 B | 403 | 404 | 3,078 | 15,533 | 3,356 us |\n\
    \n\
    With the crate `mcp2515` the node follows no command of nine frames: it loses some of \
    each.\n";

/// Loads in percent of a full bus, for the plot.
const PERCENTS: [u64; 13] = [5, 10, 20, 30, 40, 50, 60, 70, 80, 90, 95, 98, 100];

/// The name of a kind on the page.
fn name(kind: Kind) -> String {
    match kind {
        Kind::Command(5) => "ArrayCommand, 5 B: a command".to_owned(),
        Kind::Command(length) => format!("ArrayCommand, {length} B"),
        Kind::Position => "ArrayCommand, 5 B: a position".to_owned(),
        Kind::RawCommand => "esc.RawCommand for eight motors, 3 frames".into(),
        Kind::LongCommand => "ArrayCommand of 9 frames".to_owned(),
        Kind::Beginning => "ArrayCommand: first frames only, 8 B".to_owned(),
        Kind::Status(8) => "NodeStatus, 8 B".to_owned(),
        Kind::Status(length) => format!("NodeStatus, {length} B: invalid"),
        Kind::Thesis => "thesis's command, 2 B".to_owned(),
        Kind::Arming => "ArmingStatus, 2 B".to_owned(),
        Kind::Request => "GetNodeInfo request, 1 B".to_owned(),
        Kind::ParameterRequest => "GetSet request by index, 3 B".to_owned(),
        Kind::LongRequest => "GetSet request by name, 3 frames".to_owned(),
        Kind::OpcodeRequest => "ExecuteOpcode request, 8 B".to_owned(),
        Kind::RestartRequest => "RestartNode request, wrong number, 6 B".to_owned(),
        Kind::UpdateRequest => "BeginFirmwareUpdate request, 4 frames".to_owned(),
        Kind::LookAlike(length) => format!("type 20210, {length} B: rejected"),
        Kind::UnknownRequest(length) => format!("request for an unknown service, {length} B"),
        Kind::Anonymous => "anonymous Allocation, 8 B: rejected".to_owned(),
        Kind::OwnId => "ArrayCommand from the node's own ID, 5 B".to_owned(),
        Kind::Mixed => "all of these at random".to_owned(),
        Kind::Foreign => "messages for others, 8 B".to_owned(),
        Kind::ThirdParty(length) => format!("{length} B"),
    }
}

fn named(load: Load, ms: u64) -> String {
    name(load.kind) + if ms == SOAK_MS { ", a minute" } else { "" }
}

fn pace(load: Load) -> &'static str {
    match load.pace {
        Pace::Full => "full",
        Pace::Bursts => "bursts",
        Pace::Every(_) => "part",
    }
}

fn us(cycles: impl Into<f64>) -> f64 {
    cycles.into() / 16.0
}

fn row(page: &mut String, cells: &[String]) {
    let _ = writeln!(page, "| {} |", cells.join(" | "));
}

fn loads(page: &mut String, runs: &[(Load, u64, Figures)]) {
    page.push_str(
        "| frames | priority | pace | received | lost | out of order | stuck | service, median / \
         max | release, median / 99 % / max | chip selects | bytes besides the data |\n| --- | \
         ---: | --- | ---: | ---: | ---: | --- | ---: | ---: | ---: | ---: |\n",
    );
    for (load, ms, figures) in runs {
        let meter = &figures.meter;
        row(
            page,
            &[
                named(*load, *ms),
                load.priority.to_string(),
                pace(*load).to_owned(),
                meter.frames.to_string(),
                meter.lost.to_string(),
                meter.out_of_order.to_string(),
                if figures.stuck { "yes" } else { "no" }.to_owned(),
                format!("{} / {}", meter.service.median(), meter.service.max()),
                format!(
                    "{} / {} / {}",
                    meter.latency.median(),
                    meter.latency.percentile(99),
                    meter.latency.max()
                ),
                meter.selects.max().to_string(),
                meter.overhead.max().to_string(),
            ],
        );
    }
}

/// Compares the node with the minimum that the SPI's speed allows.
fn floor(page: &mut String, runs: &[(Load, u64, Figures)]) {
    page.push_str(
        "| data | bytes on the SPI | minimum | service, median | times the minimum |\n| ---: | \
         ---: | ---: | ---: | ---: |\n",
    );
    let full = |run: &&(Load, u64, Figures)| run.0.priority == 0 && run.0.pace == Pace::Full;
    for (load, _, figures) in runs.iter().filter(full) {
        let Kind::Command(length) = load.kind else { continue };
        let bytes = length as u32 + figures.meter.overhead.median();
        let (floor, service) = (16 * bytes, figures.meter.service.median());
        row(
            page,
            &[
                format!("{length} B"),
                bytes.to_string(),
                floor.to_string(),
                service.to_string(),
                format!("{:.2}", f64::from(service) / f64::from(floor)),
            ],
        );
    }
}

fn servo(page: &mut String, runs: &[(Load, u64, Figures)]) {
    page.push_str(
        "| frames | priority | pace | commands followed | register written, median | max |\n| --- \
         | ---: | --- | ---: | ---: | ---: |\n",
    );
    for (load, ms, figures) in runs.iter().filter(|(load, ..)| load.kind.moves_servo()) {
        let latency = &figures.command_to_servo;
        row(
            page,
            &[
                named(*load, *ms),
                load.priority.to_string(),
                pace(*load).to_owned(),
                latency.values().len().to_string(),
                format!("{:.1} us", us(latency.median())),
                format!("{:.1} us", us(latency.max())),
            ],
        );
    }
    let spread = |figures: &Figures| {
        let first = *figures.periods.keys().next().expect("a pulse");
        figures.periods.keys().next_back().expect("a pulse") - first
    };
    let jitter = runs.iter().map(|(_, _, figures)| spread(figures)).max().expect("a load");
    let unasked: u64 = runs.iter().map(|(.., figures)| figures.unasked_moves).sum();
    let pulses: u64 = runs.iter().flat_map(|(.., figures)| figures.periods.values()).sum();
    let _ = writeln!(
        page,
        "\nThe periods of all {pulses} pulses differ by {} ticks of Timer1 (0.5 us), and the \
         register was\nwritten {unasked} times with a value that no command had requested.",
        jitter / 8
    );
}

/// Writes the turns of the main loop and the stack.
fn turns(page: &mut String) {
    let names = Names::of_node();
    page.push_str(
        "| on the bus | turns | mean | worst | | most of the worst turn |\n| --- | ---: | ---: | \
         ---: | ---: | --- |\n",
    );
    let full = |kind| Some(Load { kind, priority: 31, pace: Pace::Full });
    let loads = [
        (None, Client::None, "only its own messages"),
        (None, Client::Saving, "a client only"),
        (
            Some(Load { kind: Kind::Command(5), priority: 31, pace: Pace::Every(5 * MS / 2) }),
            Client::Saving,
            "commands at 400 Hz and the client",
        ),
        (full(Kind::Command(5)), Client::Saving, "commands back to back and the client"),
        (
            Some(Load { kind: Kind::LongCommand, priority: 31, pace: Pace::Bursts }),
            Client::Saving,
            "bursts of commands of 9 frames and the client",
        ),
        (full(Kind::Request), Client::Saving, "requests back to back and the client"),
        (full(Kind::Foreign), Client::None, "messages for others back to back"),
    ];
    let mut worst: Option<(Cycles, String)> = None;
    let mut deepest: Option<(u16, String)> = None;
    for (load, client, what) in loads {
        let mut loaded = Loaded::new(load, client);
        let profile = Profile::begin(loaded.rig.board().avr_mut());
        loaded.run_ms(PROFILE_MS);
        let (count, mean, longest) = profile.turns();
        let tasks = profile.tasks(&names);
        let most: Vec<String> = tasks
            .iter()
            .take(3)
            .map(|share| format!("`{}` {}", share.name, share.cycles))
            .collect();
        row(
            page,
            &[
                what.to_owned(),
                count.to_string(),
                mean.to_string(),
                longest.to_string(),
                format!("{:.0} us", us(longest as f64)),
                most.join(", "),
            ],
        );
        if worst.as_ref().is_none_or(|(most, _)| longest > *most) {
            let mut table = format!(
                "The longest turn, {longest} cycles with {what},\nby what the main function \
                 calls, and by the innermost function (only those with 2 % or more):\n\n| cycles \
                 | task |\n| ---: | --- |\n"
            );
            for share in &tasks {
                row(&mut table, &[share.cycles.to_string(), format!("`{}`", share.name)]);
            }
            table.push_str("\n| cycles | function |\n| ---: | --- |\n");
            for share in
                profile.functions(&names).iter().filter(|share| share.cycles * 50 >= longest)
            {
                row(&mut table, &[share.cycles.to_string(), format!("`{}`", share.name)]);
            }
            worst = Some((longest, table));
        }
        let (sp, calls) = profile.deepest();
        let avr = loaded.rig.board().avr();
        let bottom = avr.symbol("__heap_start").expect("a linker's symbol").address as u16;
        let top = avr.chip().ram_end();
        let depth = (top - sp).max(avr.stack_high_water(PAINT, bottom));
        if deepest.as_ref().is_none_or(|(most, _)| depth > *most) {
            let (statics, depth_seen) = (bottom - 0x100, top - sp);
            let mut table = format!(
                "{depth} bytes at the deepest, with {what};\nwith {statics} bytes of variables {} \
                 of {}. The calls that lead there, {depth_seen} bytes,\nwith the stack in use \
                 when each makes the next call:\n\n| bytes | function |\n| ---: | --- |\n",
                statics + depth,
                budget().statics_and_stack
            );
            for call in &calls {
                row(
                    &mut table,
                    &[(top - call.sp).to_string(), format!("`{}`", names.function(call.from))],
                );
            }
            deepest = Some((depth, table));
        }
    }
    let (Some((_, worst)), Some((_, deepest))) = (worst, deepest) else { return };
    let _ = write!(page, "\n{worst}\n## Stack\n\n{deepest}");
}

/// Results of a firmware with frames of two bytes.
struct Firmware {
    name: &'static str,
    /// Percent of the frames lost, for each load in percent.
    loss: Vec<(f64, f64)>,
    /// The measurement at 100 %.
    full: Meter,
}

impl Firmware {
    fn measure(name: &'static str, full: Cycles, run: impl Fn(Pace) -> Meter) -> Firmware {
        let meters = PERCENTS.map(|percent| match percent {
            100 => run(Pace::Full),
            _ => run(Pace::Every(full * 100 / percent)),
        });
        let lost =
            |meter: &Meter| 100.0 * meter.lost as f64 / (meter.frames + meter.lost).max(1) as f64;
        let loss = PERCENTS
            .iter()
            .zip(&meters)
            .map(|(percent, meter)| (*percent as f64, lost(meter)))
            .collect();
        let [.., full] = meters;
        Firmware { name, loss, full }
    }

    fn third_party(name: &'static str, full: Cycles, third_party: ThirdParty) -> Firmware {
        let load = |pace| Load { kind: Kind::ThirdParty(2), priority: 0, pace };
        Firmware::measure(name, full, |pace| receive(third_party, load(pace), LOSS_MS))
    }

    fn node(name: &'static str, full: Cycles, kind: Kind) -> Firmware {
        Firmware::measure(name, full, |pace| run(Load { kind, priority: 31, pace }, LOSS_MS).meter)
    }
}

/// Writes the table of firmwares. Rows in italics are published results.
fn peers(page: &mut String, firmwares: &[Firmware]) {
    page.push_str(
        "| firmware | lossless up to | lost at 100 % | out of order | service, median / max | \
         release, max | SPI bytes / chip selects |\n| --- | ---: | ---: | ---: | ---: | ---: | \
         ---: |\n",
    );
    for Firmware { name, loss, full } in firmwares {
        let lossless =
            loss.iter().take_while(|(_, lost)| *lost == 0.0).last().map_or(0.0, |(load, _)| *load);
        let (_, lost) = loss.last().expect("a load of 100 %");
        row(
            page,
            &[
                (*name).to_owned(),
                format!("{lossless} %"),
                format!("{lost:.1} %"),
                full.out_of_order.to_string(),
                format!("{} / {}", full.service.median(), full.service.max()),
                full.latency.max().to_string(),
                format!("{} / {}", full.overhead.max() + 2, full.selects.max()),
            ],
        );
    }
    page.push_str(
        "| *Arduino core, MCP_CAN, Servo: the thesis's sketch, printing* | *3.9 %* | *96.0 %* | | \
         *2596 / 2933* | | *24 / 7* |\n| *the same, silent* | *34.0 %* | *65.9 %* | | *2344 / \
         2683* | | *24 / 7* |\n| *MCP_CAN, bare loop* | *53.3 %* | *46.6 %* | | *2296 / 2398* | | \
         *24 / 7* |\n| *autowp's library, bare loop* | *72.5 %* | *27.5 %* | | *1653 / 1755* | | \
         *20 / 5* |\n| *`mcp25xx` 0.4, bare loop* | *99.4 %* | *0.8 %* | | *1164 / 1173* | | *21 \
         / 3* |\n| *`mcp2515` 0.3, bare loop* | *63.7 %* | *36.3 %* | | *2021 / 2025* | | *25 / \
         8* |\n",
    );
}

/// Mean time between frames of two bytes on a full bus, in cycles.
fn frame_cycles() -> Cycles {
    let meter = receive(
        ThirdParty::Mcp25xx,
        Load { kind: Kind::ThirdParty(2), priority: 0, pace: Pace::Full },
        1000,
    );
    1000 * MS / (meter.frames + meter.lost)
}

/// Points (time in cycles, percent of the frames that waited longer).
fn waited(samples: &Samples) -> Vec<(f64, f64)> {
    let mut sorted = samples.values().to_vec();
    sorted.sort_unstable();
    let share = |at: usize| 100.0 * (sorted.len() - at) as f64 / sorted.len() as f64;
    let mut points: Vec<(f64, f64)> = Vec::new();
    for (at, &value) in sorted.iter().enumerate() {
        // Only as many points as the plot can show.
        let far = |&(x, y): &(f64, f64)| f64::from(value) - x >= 4.0 || y / share(at) > 1.02;
        if points.last().is_none_or(far) || at + 1 == sorted.len() {
            points.push((value.into(), share(at)));
        }
    }
    points
}

fn draw_latency(firmwares: &[Firmware]) {
    let lines =
        firmwares.iter().map(|firmware| (firmware.name, waited(&firmware.full.latency))).collect();
    let plot = Plot {
        title: "Frames that waited longer in the controller, at 100 % load",
        x: Axis {
            label: "cycles from the end of the frame to the release of its buffer",
            from: 100.0,
            to: 10_000.0,
            logarithmic: true,
            marks: vec![100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0, 10_000.0],
        },
        y: Axis {
            label: "per cent of the frames",
            from: 0.001,
            to: 100.0,
            logarithmic: true,
            marks: vec![0.001, 0.01, 0.1, 1.0, 10.0, 100.0],
        },
        lines,
        names_down: 200.0,
    };
    write("docs/img/latency.svg", &plot.svg());
}

fn draw_loss(firmwares: &[Firmware]) {
    let lines = firmwares.iter().map(|firmware| (firmware.name, firmware.loss.clone())).collect();
    let marks = vec![0.0, 20.0, 40.0, 60.0, 80.0, 100.0];
    let plot = Plot {
        title: "Frames lost over bus load",
        x: Axis {
            label: "load of frames for the node, per cent",
            from: 0.0,
            to: 100.0,
            logarithmic: false,
            marks,
        },
        y: Axis {
            label: "per cent lost",
            from: 0.0,
            to: 60.0,
            logarithmic: false,
            marks: vec![0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0],
        },
        lines,
        names_down: 0.0,
    };
    write("docs/img/loss.svg", &plot.svg());
}

/// EEPROMs of boards with different node IDs.
fn eeproms(boards: usize) -> Vec<Vec<u8>> {
    let mut rig = Rig::running();
    let one = |id| {
        rig.set("CAN_NODE", id);
        rig.save();
        rig.board().avr().eeprom()
    };
    (20..).take(boards).map(one).collect()
}

/// Simulated seconds per second, with these boards and an autopilot on a bus.
fn speed(eeproms: &[Vec<u8>]) -> f64 {
    let eeproms: Vec<&[u8]> = eeproms.iter().map(Vec::as_slice).collect();
    let mut rig = Program::Preset.with_boards(&eeproms);
    rig.overflows_expected = true;
    rig.attach_autopilot(Settings::of(Autopilot::Ardupilot));
    rig.run_ms(500);
    let started = Instant::now();
    rig.run_ms(SPEED_MS);
    SPEED_MS as f64 / 1000.0 / started.elapsed().as_secs_f64()
}

fn speeds() -> String {
    let eeproms = eeproms(10);
    let mut page = String::from(
        "Speed of the simulation: simulated time over real time, on one core of this machine, with \
         an autopilot at work.\n\n| boards on the bus | times real time | boards x time |\n\
         | ---: | ---: | ---: |\n",
    );
    for boards in [1, 2, 5, 10] {
        let speed = speed(&eeproms[..boards]);
        let _ = writeln!(page, "| {boards} | {speed:.1} | {:.1} |", speed * boards as f64);
    }
    let started = Instant::now();
    _ = run(Load { kind: Kind::Command(8), priority: 31, pace: Pace::Full }, SPEED_MS);
    let full = SPEED_MS as f64 / 1000.0 / started.elapsed().as_secs_f64();
    let _ = writeln!(
        page,
        "\nOne board on a bus that is full of commands, measured as for docs/benchmarks.md: \
         {full:.1} times."
    );
    page
}

/// Writes a file for the default preset. Another firmware's results are only printed.
fn write(file: &str, text: &str) {
    if std::env::var_os("NODE_ELF").is_some_and(|path| !path.is_empty()) {
        return;
    }
    let path = bench::root().join(file);
    std::fs::write(&path, text)
        .unwrap_or_else(|error| panic!("{} cannot be written: {error}", path.display()));
}

/// The parts of docs/benchmarks.md that other benches write, which are behind those of this one.
fn others() -> String {
    let page =
        std::fs::read_to_string(bench::root().join("docs/benchmarks.md")).unwrap_or_default();
    let parts = ["\n## Proved and observed", "\n## Frames lost"];
    let begins = parts.iter().filter_map(|heading| page.find(heading)).min();
    begins.map_or(String::new(), |at| page[at..].to_owned())
}

fn main() {
    // Cargo also asks bench targets to list their tests.
    if std::env::args().any(|argument| argument == "--list") {
        return;
    }
    let begun = Instant::now();
    let mut page = String::from(
        "# Benchmarks\n\nWritten by `make bench`: the shipped ELF in the simulator, measured at \
         its pins, on the SPI and on the bus, in cycles of the 16 MHz\nAVR (16 cycles are a \
         microsecond). A second run writes the same page. The bus has 1 Mbit/s. Of a real\nchip \
         the widths and periods of pulses, uptime, rates and time-outs deviate as its clock,\nby \
         up to 0.5 %, and a write to the EEPROM takes up to 10 % longer; no frame is lost for \
         that.\n\n**Everything is on** unless a row says otherwise: `actuator.Status` and \
         `device.Temperature` 50 times a second,\na client reads all parameters as fast as the \
         node answers, and in each round sets one and saves all; the serial monitor\nis read and \
         gets a `?` twice a second.\n\n",
    );
    page.push_str(&rig::page::measured());
    page.push_str(
        "\n\n## Load\n\nFrames that the filters accept, at priority 0 (they win every arbitration \
         against the node) or 31 (they lose every arbitration, so that\nall of the node's \
         messages go out, too), back to back, or in bursts of 1 to 40 after silences of up to 10 \
         ms. *Service* is the time from\nthe chip select of the status read that finds a frame to \
         the release of its buffer (RXnIF cleared), *release* the time from the end of\nthe frame \
         on the bus to that release. The node reads and rejects invalid frames, and frames that \
         are not for it although its filters\naccept them: messages whose type has the low byte \
         of ArrayCommand's (such as 20210), requests for services that it does not have, \
         and\nmessages of its types from an anonymous sender or from its own ID.\n\nThe limits: \
         no frame of a transfer lost, median of the service 450 cycles, release at most 1,250 \
         cycles.\n\n",
    );
    let paces = [(0, Pace::Full), (31, Pace::Full), (31, Pace::Bursts)];
    let all = Kind::MATCHING
        .into_iter()
        .flat_map(|kind| paces.map(|(priority, pace)| Load { kind, priority, pace }));
    let long = SOAKED.map(|kind| (Load { kind, priority: 31, pace: Pace::Full }, SOAK_MS));
    let positions =
        paces.map(|(priority, pace)| (Load { kind: Kind::Position, priority, pace }, LOAD_MS));
    let all: Vec<_> = all.map(|load| (load, LOAD_MS)).chain(positions).chain(long).collect();
    let runs = run_all(&all, |load, ms, figures| {
        let (name, frames) = (named(load, ms), figures.meter.frames);
        eprintln!("{name}, priority {}, {}: {frames} frames", load.priority, pace(load));
    });
    loads(&mut page, &runs);
    let lost = |(_, _, figures): &(Load, u64, Figures)| {
        let meter = &figures.meter;
        100.0 * meter.lost as f64 / (meter.frames + meter.lost) as f64
    };
    let positions =
        runs.iter().filter(|(load, ..)| load.kind == Kind::Position && load.pace == Pace::Full);
    let most = positions.map(lost).fold(0.0, f64::max);
    let _ = writeln!(
        page,
        "\nTo follow a command for a position takes a division, so it has a turn of its own: the \
         newest command is followed when no frame\nwaits. Of a bus full of such commands, 8,700 a \
         second, the node lost {most:.1} % (docs/decisions.md)."
    );
    let mut foreign = Loaded::new(
        Some(Load { kind: Kind::Foreign, priority: 31, pace: Pace::Full }),
        Client::Saving,
    );
    foreign.run_ms(FOREIGN_MS);
    let foreign = foreign.finish();
    let _ = writeln!(
        page,
        "\nA bus full of messages for others takes no time of a node with one output, because the \
         filters reject them. The {} frames that\nthe node read in {} ms were the client's. The \
         node sent {} frames, {} NodeStatus among them.",
        foreign.meter.frames, FOREIGN_MS, foreign.own_frames, foreign.own_statuses
    );
    page.push_str(
        "\n### The minimum\n\nSCK is at most half of the AVR's clock, so a byte takes at least 16 \
         cycles. The shortest possible time of one status read and one READ\nRX BUFFER, and the \
         measured time, for ArrayCommand frames back to back:\n\n",
    );
    floor(&mut page, &runs);
    page.push_str(
        "\n### Other firmwares\n\nFrames of 2 bytes for the node. The firmwares of \
         `tests/third-party/` only receive; ours is the whole node with everything on. Rows\n\
         in italics are published results of such a measurement, which `make bench` does not \
         repeat. Those of the two crates have another build than\nours, which is for size \
         (`opt-level = \"z\"`), like the node's.\n\n",
    );
    let full = frame_cycles();
    let firmwares = [
        Firmware::node("this node: the thesis's commands", full, Kind::Thesis),
        Firmware::node("this node: frames of ArrayCommand", full, Kind::Command(2)),
        Firmware::third_party("mcp25xx 0.4, bare loop", full, ThirdParty::Mcp25xx),
        Firmware::third_party("mcp2515 0.3, bare loop", full, ThirdParty::Mcp2515),
    ];
    peers(&mut page, &firmwares);
    page.push_str(OWN_NODE);
    page.push_str(
        "\n![Share of the frames over the time in the controller](img/latency.svg)\n\n![Loss over \
         load](img/loss.svg)\n",
    );
    page.push_str(
        "\n## From command to servo\n\nThe time from the end of a command's last frame to the \
         write to OCR1B, which sets the next pulse. The limit is 500 us. ArduPilot sends\n\
         ArrayCommands of 9 frames (15 commands), and so does PX4 since June 2026.\n\n",
    );
    servo(&mut page, &runs);
    page.push_str(
        "\n## Turns of the main loop\n\nA turn is the time from one reset of the watchdog to the \
         next, in cycles. The limit is 250 us, 4000 cycles.\n\n",
    );
    turns(&mut page);
    page.push_str("\nThe speed of the simulation: [bench.md](bench.md#speed).\n");
    print!("{page}");
    write("docs/benchmarks.md", &(page + &others()));
    draw_latency(&firmwares);
    draw_loss(&firmwares);
    print!("\n{}", speeds());
    eprintln!("measured in {:.0} s", begun.elapsed().as_secs_f64());
}
