//! The command line of `bounds` and of `sim bounds`.

use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Args as Arguments;
use clap::Parser;

use crate::annotations::Annotations;
use crate::chip::Chip;
use crate::program::Program;
use crate::stack::Analysis;
use crate::{report, times, whole};

/// Proves from the machine code of an AVR program how much stack and how many cycles it needs.
#[derive(Debug, Clone, Parser)]
#[command(name = "bounds", version)]
pub struct Args {
    /// What to analyse.
    #[command(flatten)]
    pub options: Options,
}

/// The options, for programs that have the command as a part.
#[derive(Debug, Clone, Arguments)]
pub struct Options {
    /// The program: an ELF with symbols.
    pub elf: PathBuf,
    /// The chip: atmega168 or atmega328p.
    #[arg(long, default_value = "atmega328p")]
    pub chip: Chip,
    /// A file with what the analysis cannot find.
    #[arg(long)]
    pub annotations: Option<PathBuf>,
    /// Finds the times, too.
    #[arg(long)]
    pub cycles: bool,
    /// Lists the loops with their bounds, too.
    #[arg(long, requires = "cycles")]
    pub loops: bool,
    /// Prints JSON.
    #[arg(long)]
    pub json: bool,
    /// Fails if variables and stack need more bytes.
    #[arg(long, value_name = "BYTES")]
    pub ram_limit: Option<u32>,
}

/// Runs the command. Returns the exit code: 1 if a limit is exceeded.
///
/// # Errors
/// If a file cannot be read, the program cannot be followed, or a handler or a stretch has no
/// bound.
pub fn run(args: &Args, out: &mut impl Write) -> Result<ExitCode> {
    let options = &args.options;
    let path = options.elf.display();
    let elf = fs::read(&options.elf).with_context(|| format!("cannot read {path}"))?;
    let mut annotations = match &options.annotations {
        Some(path) => {
            let shown = path.display();
            let text = fs::read_to_string(path).with_context(|| format!("cannot read {shown}"))?;
            Annotations::parse(&text).with_context(|| shown.to_string())?
        }
        None => Annotations::default(),
    };
    let program = Program::from_elf(&elf, options.chip).with_context(|| path.to_string())?;
    annotations.keep_those_of(&program);
    let mut analysis = Analysis::new(&program, &annotations);
    let stack = whole::stack(&mut analysis).with_context(|| path.to_string())?;
    let times = match options.cycles {
        true => Some(times::times(&mut analysis).with_context(|| path.to_string())?),
        false => None,
    };
    let report = report::Report::new(&program, stack, times);
    if options.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&report)?)?;
    } else if options.loops {
        write!(out, "{report:#}")?;
    } else {
        write!(out, "{report}")?;
    }
    if let Some(times) = &report.times
        && !times.is_bounded()
    {
        bail!("{path}: a handler or a stretch has no bound: {}", times.missing.join("; "));
    }
    let is_exceeded =
        options.ram_limit.zip(report.ram_bytes).is_some_and(|(most, used)| used > most);
    if is_exceeded {
        eprintln!("bounds: {path}: variables and stack exceed {:?} bytes", options.ram_limit);
    }
    Ok(if is_exceeded { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}
