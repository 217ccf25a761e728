//! `sim utilisation`: plans the load of a bus before the vehicle is built.
//!
//! ```text
//! text ──> stream (messages and their rates) ──> cost (bits of a transfer) ──> plan (sums, advice)
//! published: a rule of thumb, tables, and exact bits beside them    measured: a running bus
//! ```
//! Limits: the result is a mean over a long time. Whether a message is late in the worst case
//! depends on priorities and on transfers at the same time; neither is computed. Error frames and
//! retransmissions are not counted.

mod cost;
mod examples;
pub mod measured;
mod plan;
mod published;
mod stream;

use anyhow::{Context, Result, anyhow, bail};
use bench::dronecan::types::{DataType, KNOWN, Kind, Layout};
pub use cost::{Bits, Cost};
pub use examples::Example;
pub use plan::{Plan, Row, Verdict};
use std::io::{ErrorKind, Write};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
pub use stream::{Channel, Entry, Stream};

const BIT_RATE_DEFAULT: u32 = 1_000_000;
/// The bit rates of CAN.
const BIT_RATES: RangeInclusive<u32> = 10_000..=1_000_000;

const ABOUT: &str = "\
Plans a bus: which messages, how often, from how many nodes; prints what share of the bus they \
                     take.

A message is \"[NODESx] TYPE[COUNT]@RATE\", for example \"4x esc.Status@50\": four nodes send \
                     esc.Status 50 times a second
each, or \"ArrayCommand[8]@50\": one node sends commands for 8 actuators. TYPE is a name (--list), \
                     a full DSDL name such as
uavcan.equipment.esc.Status, or a number. Without [COUNT] a list is as long as it can be. Instead \
                     of [COUNT], \":BYTES\" gives
the length of the payload, and \"=HEX\" the payload itself. A service, such as GetNodeInfo, counts \
                     its request and its
response.

Of each transfer it counts the bits of all its frames, with the spaces between them:
  least    no stuff bit at all: 67 bits a frame and 8 for each data byte, the tail byte included
  typical  the mean of 32 transfers of each node, bit by bit, with random payloads or the one given
  most     as many stuff bits as there can be: up to a fifth more";

const EXAMPLES: &str = "\
Examples:
  sim utilisation --example quadcopter
  sim utilisation --example ardupilot-15-servos --bit-rate 500000
  sim utilisation --message \"ArrayCommand[8]@50\" --message \"4x esc.Status@50\" --message \"13x \
                        NodeStatus@1\"
  sim utilisation --bit-rate 500000 --message \"1034@100\" --message \"20100:12@5\"
  sim utilisation --message \"NodeStatus=2A000000000000@1\" --message \"3x GetNodeInfo[24]@0.1\"
  sim utilisation --file vehicle.txt
  sim utilisation --tables
  sim utilisation --list

A file has one message in a line, without quotes; \"bit-rate 500000\" may be a line too, and # \
                        begins a remark.";

/// Options of `sim utilisation`.
#[derive(Clone, Debug, clap::Args)]
#[command(about = "Plan the load of a bus", long_about = ABOUT, after_long_help = EXAMPLES)]
pub struct Args {
    /// Bits per second on the bus [default: that of the file, else 1000000]
    #[arg(
        long,
        value_name = "BIT/S",
        value_parser = bit_rate,
        allow_hyphen_values = true,
    )]
    pub bit_rate: Option<u32>,

    /// A message that is sent regularly, such as "4x esc.Status@50" (repeatable)
    #[arg(long, value_name = "MESSAGE")]
    pub message: Vec<Entry>,

    /// Messages from a file, one in a line
    #[arg(long, value_name = "FILE")]
    pub file: Option<PathBuf>,

    /// Messages of a ready plan
    #[arg(long, value_name = "NAME", value_enum)]
    pub example: Option<Example>,

    /// Print the tables that Vertiq publishes, and where exact bits differ
    #[arg(long, conflicts_with_all = ["message", "file", "example", "bit_rate", "list"])]
    pub tables: bool,

    /// List the known types with their numbers and longest payloads
    #[arg(long, conflicts_with_all = ["message", "file", "example", "bit_rate"])]
    pub list: bool,
}

/// Prints the plan, the tables or the list.
///
/// # Errors
/// If nothing is planned, the file is wrong, or the output cannot be written.
pub fn run(args: &Args, mut out: impl Write) -> Result<()> {
    if args.list {
        return list(out);
    }
    if args.tables {
        return published::print(out);
    }
    let (mut bit_rate, mut streams) = (args.bit_rate, Vec::new());
    for text in args.example.iter().flat_map(|example| example.messages()) {
        streams.extend(text.parse::<Entry>().map_err(anyhow::Error::msg)?.0);
    }
    if let Some(path) = &args.file {
        let (entries, rate) = read(path)?;
        bit_rate = bit_rate.or(rate);
        streams.extend(entries.into_iter().flat_map(|entry| entry.0));
    }
    streams.extend(args.message.iter().flat_map(|entry| entry.0.clone()));
    if streams.is_empty() {
        bail!(
            "nothing is planned: give --message \"NodeStatus@1\", --file or --example; see --help"
        );
    }
    Plan::new(bit_rate.unwrap_or(BIT_RATE_DEFAULT), streams).print(&mut out)
}

fn bit_rate(text: &str) -> Result<u32, String> {
    sim_base::parse_number(text, BIT_RATES)
}

fn read(path: &Path) -> Result<(Vec<Entry>, Option<u32>)> {
    let text =
        sim_base::read_text(path, sim_base::PROGRAM_BYTES).map_err(|error| match error.kind() {
            // The file exists but is not a plan: the user's mistake, not the machine's.
            ErrorKind::InvalidData | ErrorKind::IsADirectory => {
                anyhow!("{} is not a text file: {error}", path.display())
            }
            _ => anyhow!(error).context(format!("cannot read {}", path.display())),
        })?;
    let (mut entries, mut bit_rate) = (Vec::new(), None);
    for (number, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim();
        let place = || format!("{}, line {}", path.display(), number + 1);
        if let Some(rate) = line.strip_prefix("bit-rate ") {
            let rate = rate.trim().parse().ok().filter(|rate| BIT_RATES.contains(rate));
            bit_rate =
                Some(rate.with_context(|| format!("{}: a bit rate is 10000 to 1000000", place()))?);
        } else if !line.is_empty() {
            entries.push(line.parse().map_err(anyhow::Error::msg).with_context(place)?);
        }
    }
    Ok((entries, bit_rate))
}

fn list(mut out: impl Write) -> Result<()> {
    let longest = |layout: Layout| layout.bytes(layout.elements_max);
    let mut known: Vec<&DataType> = KNOWN.iter().collect();
    known.sort_by_key(|known| (known.kind == Kind::Service, known.id));
    writeln!(
        out,
        "{:>6}  {:30} {:>16} {:>17}",
        "number", "type", "longest, bytes", "[COUNT] at most"
    )?;
    for known in known {
        let (bytes, tail) = match known.response {
            None => (longest(known.payload).to_string(), known.payload),
            Some(response) => {
                (format!("{} + {}", longest(known.payload), longest(response)), response)
            }
        };
        let count =
            if tail.elements_max > 0 { tail.elements_max.to_string() } else { String::new() };
        let line = format!("{:6}  {:30} {bytes:>16} {count:>17}", known.id, known.name);
        writeln!(out, "{}", line.trim_end())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
