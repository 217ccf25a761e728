//! The rows that are printed, and the part of docs/benchmarks.md.

use std::fmt::{self, Write as _};

use bench::avr::Chip;
use rig::flood::{Outcome, Pace, Scenario, Traffic, Unit};

/// What one flood measured.
pub struct Row {
    program: String,
    flood: String,
    frames: u64,
    lost: u64,
    commands: u64,
    superseded: u64,
    /// Longest release of a frame in cycles.
    release: u32,
    /// Most frames in the firmware's queue, and its places.
    deepest: u8,
    places: u8,
    /// Longest time until the newest value was in the output, in cycles.
    newest: u32,
}

impl Row {
    pub fn of(scenario: Scenario, outcome: &Outcome) -> Row {
        Row {
            program: scenario.setup.to_string(),
            flood: flood(scenario),
            frames: outcome.frames(),
            lost: outcome.meter.lost,
            commands: outcome.commands,
            superseded: outcome.register.superseded,
            release: outcome.meter.latency.max(),
            deepest: outcome.deepest,
            places: outcome.places,
            newest: outcome.longest_to_follow(),
        }
    }

    /// The loss as "none" or "1 in 35".
    fn loss(&self) -> String {
        match self.lost {
            0 => "none".into(),
            lost => format!("1 in {}", self.frames / lost),
        }
    }

    /// The cells of the table.
    fn cells(&self) -> [String; 9] {
        [
            self.program.clone(),
            self.flood.clone(),
            self.frames.to_string(),
            self.lost.to_string(),
            self.loss(),
            format!("{} of {}", self.superseded, self.commands),
            self.release.to_string(),
            format!("{} of {}", self.deepest, self.places),
            format!("{:.0} us", f64::from(self.newest) / 16.0),
        ]
    }
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.cells().join(" | "))
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
        Pace::Bursts => name += ", bursts",
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
fn sentence(rows: &[Row], chip: Chip, minutes: f64) -> String {
    let frames: u64 = rows.iter().map(|row| row.frames).sum();
    let loss = |row: &&Row| row.lost as f64 / row.frames.max(1) as f64;
    let worst = rows.iter().max_by(|one, other| loss(one).total_cmp(&loss(other)));
    let of = format!(
        "On a full bus of 1 Mbit/s the {chip} lost {{}} of {frames} frames of valid transfers in \
         {} floods of {minutes} simulated minutes each",
        rows.len()
    );
    let lost: u64 = rows.iter().map(|row| row.lost).sum();
    let of = of.replace("{}", &if lost == 0 { "none".to_owned() } else { lost.to_string() });
    match worst {
        Some(worst) if worst.lost > 0 => {
            format!("{of}; at worst {} ({}; {}).", worst.loss(), worst.program, worst.flood)
        }
        _ => format!("{of}."),
    }
}

/// The part of the page for a chip.
pub fn part(rows: &[Row], chip: Chip, minutes: f64) -> String {
    let mut part = format!("{}\n\n{}\n\n", heading(chip), sentence(rows, chip, minutes));
    part.push_str(
        "Written by `make losses`. The bus is full of valid transfers with random values that \
         change with each frame,\nwhile a client reads, sets and saves parameters. *Superseded* \
         commands, out of those on the bus, were received\nand replaced by a newer one before the \
         node followed them (only with one output). *Release* is the longest time\nfrom the end \
         of a frame to the release of its buffer. *Queue* is how full the firmware's queue of \
         received\nframes became. *Newest* is the longest time until an output had the newest \
         value.\n\n| program | frames | sent | lost | | superseded | release, cycles | queue | \
         newest |\n| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n",
    );
    for row in rows {
        let _ = writeln!(part, "| {} |", row.cells().join(" | "));
    }
    part
}

/// Replaces the chip's part of docs/benchmarks.md, or appends it.
pub fn write(part: &str, chip: Chip) {
    rig::page::write_part(&heading(chip), part);
}
