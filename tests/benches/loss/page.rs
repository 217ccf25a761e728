//! The rows that are printed, and the part of docs/benchmarks.md.

use std::fmt::{self, Write as _};

use bench::avr::Chip;
use rig::flood::{Outcome, Pace, Scenario, Traffic, Unit};

/// What one flood measured: the cells of its row.
#[derive(Clone)]
pub struct Row {
    cells: [String; COLUMNS],
}

const COLUMNS: usize = 11;

impl Row {
    pub fn of(scenario: Scenario, minutes: f64, outcome: &Outcome, commit: &str) -> Row {
        let (frames, lost) = (outcome.frames(), outcome.meter.lost);
        Row {
            cells: [
                scenario.setup.to_string(),
                flood(scenario),
                minutes.to_string(),
                frames.to_string(),
                lost.to_string(),
                frames.checked_div(lost).map_or("none".into(), |frames| format!("1 in {frames}")),
                format!("{} of {}", outcome.register.superseded, outcome.commands),
                outcome.meter.latency.max().to_string(),
                format!("{} of {}", outcome.deepest, outcome.places),
                format!("{:.0} us", f64::from(outcome.longest_to_follow()) / 16.0),
                format!("`{commit}`"),
            ],
        }
    }

    /// The row in this line of the page. `None` if it is none.
    fn parse(line: &str) -> Option<Row> {
        let cells: Vec<String> =
            line.strip_prefix("| ")?.strip_suffix(" |")?.split(" | ").map(str::to_owned).collect();
        let row = Row { cells: cells.try_into().ok()? };
        row.cells[3].parse::<u64>().is_ok().then_some(row)
    }

    /// The program and the flood.
    fn name(&self) -> String {
        self.cells[..2].join(" | ")
    }

    fn minutes(&self) -> f64 {
        self.cells[2].parse().expect("a number of minutes")
    }

    fn frames(&self) -> u64 {
        self.cells[3].parse().expect("a number of frames")
    }

    fn lost(&self) -> u64 {
        self.cells[4].parse().expect("a number of frames")
    }
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.cells.join(" | "))
    }
}

/// The name of a flood on the page.
fn flood(scenario: Scenario) -> String {
    let mut name = match scenario.traffic {
        Traffic::Command(Unit::Unitless) => "ArrayCommand, unitless".to_owned(),
        Traffic::Command(Unit::Position) => "ArrayCommand, position".to_owned(),
        Traffic::Command(Unit::Width) => "ArrayCommand, microseconds".to_owned(),
        Traffic::List(entries) => format!("ArrayCommand of {entries} entries"),
        Traffic::Throttles(motors) => format!("esc.RawCommand of {motors}"),
        Traffic::Byte => "thesis.ServoCommand".to_owned(),
        Traffic::DraftByte => "the draft's command 760".to_owned(),
        Traffic::DraftStatus => "the draft's NodeStatus".to_owned(),
        Traffic::Elsewhere => "ArrayCommand for other nodes".to_owned(),
        Traffic::Status => "NodeStatus".to_owned(),
        Traffic::Arming => "ArmingStatus".to_owned(),
        Traffic::Safety => "SafetyState".to_owned(),
        Traffic::Lights => "LightsCommand".to_owned(),
        Traffic::OneServo => "ArrayCommand, one servo flooded".to_owned(),
        Traffic::Foreign => "messages for others, and commands".to_owned(),
        Traffic::LongAndShort if scenario.setup.servos > 0 => {
            "NodeStatus and thesis.ServoCommand".to_owned()
        }
        Traffic::LongAndShort => "NodeStatus and ArmingStatus".to_owned(),
        Traffic::Mixed => "all of these at random".to_owned(),
    };
    if scenario.senders == 2 {
        name += ", two senders";
    }
    if scenario.priority == 0 {
        name += ", priority 0";
    }
    match scenario.pace {
        Pace::Full => {}
        Pace::Percent(percent) => name += &format!(", {percent} %"),
        Pace::Hz(rate) => name += &format!(", {rate} Hz"),
        Pace::Bursts => name += ", bursts",
    }
    if let Some(bits) = 1_000_000_u32.checked_div(scenario.noise_per_million) {
        let _ = write!(name, ", 1 bit in {bits} inverted");
    }
    name
}

/// The program and the flood as in the row.
pub fn name(scenario: Scenario) -> String {
    format!("{} | {}", scenario.setup, flood(scenario))
}

/// The heading of a chip's part of the page.
fn heading(chip: Chip) -> String {
    format!("## Frames lost on a full bus: {chip}")
}

/// The sentence that other documents quote: the worst row.
fn sentence(rows: &[Row], chip: Chip, floods: usize) -> String {
    let loss = |row: &&Row| row.lost() as f64 / row.frames().max(1) as f64;
    let worst = rows.iter().max_by(|one, other| loss(one).total_cmp(&loss(other)));
    let frames: u64 = rows.iter().map(Row::frames).sum();
    let minutes: f64 = rows.iter().map(Row::minutes).sum();
    let lost = match rows.iter().map(Row::lost).sum() {
        0 => "none".to_owned(),
        lost => lost.to_string(),
    };
    let floods = match rows.len() {
        all if all == floods => all.to_string(),
        some => format!("{some} of {floods}"),
    };
    let sentence = format!(
        "On a full bus of 1 Mbit/s the {chip} lost {lost} of {frames} frames of valid transfers\n\
         in {floods} floods of {minutes} simulated minutes in all"
    );
    match worst {
        Some(worst) if worst.lost() > 0 => {
            format!(
                "{sentence};\nat worst {} ({}; {}).",
                worst.cells[5], worst.cells[0], worst.cells[1]
            )
        }
        _ => format!("{sentence}."),
    }
}

/// The part of the page for a chip, of which there are so many floods.
pub fn part(rows: &[Row], chip: Chip, floods: usize) -> String {
    let mut part = format!("{}\n\n{}\n\n", heading(chip), sentence(rows, chip, floods));
    part.push_str(
        "Written by `make losses`. The bus is full of valid transfers with random values that\n\
         change with each frame, while a client reads, sets and saves parameters. *Superseded*\n\
         commands, out of those on the bus, were received and replaced by a newer one before the\n\
         node followed them (only with one output). *Release* is the longest time from the end\n\
         of a frame to the release of its buffer. *Queue* is how full the firmware's queue of\n\
         received frames became. *Newest* is the longest time until an output had the newest\n\
         value. *Commit*: that of the program. What the node hears while it only listens counts\n\
         as neither sent nor lost: after disturbed frames it looks for the bit rate of the bus.\n\n\
         | program | frames | minutes | sent | lost | | \
         superseded | release, cycles | queue | newest | commit |\n| --- | --- | ---: | ---: | \
         ---: | ---: | ---: | ---: | ---: | ---: | --- |\n",
    );
    for row in rows {
        let _ = writeln!(part, "| {row} |");
    }
    part
}

/// The chip's part of docs/benchmarks.md. It is written after each flood, so a run may be cut, and
/// `ONLY` runs a part.
pub struct Page {
    chip: Chip,
    /// The names of all floods, in the order of their rows.
    names: Vec<String>,
}

impl Page {
    pub fn new(chip: Chip, floods: &[Scenario]) -> Page {
        Page { chip, names: floods.iter().map(|&flood| name(flood)).collect() }
    }

    /// Writes a row in place of the one of its flood, and leaves out those of no flood.
    pub fn write(&mut self, row: &Row) {
        let earlier = rig::page::read_part(&heading(self.chip));
        let mut rows: Vec<Row> = earlier.lines().filter_map(Row::parse).collect();
        rows.retain(|earlier| earlier.name() != row.name());
        rows.push(row.clone());
        let place = |row: &Row| self.names.iter().position(|name| *name == row.name());
        rows.retain(|row| place(row).is_some());
        rows.sort_by_key(place);
        rig::page::write_part(&heading(self.chip), &part(&rows, self.chip, self.names.len()));
    }
}
