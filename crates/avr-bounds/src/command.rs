//! The command line, also as a part of another program.

use std::fs::File;
use std::io::{Read as _, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail, ensure};
use clap::Args as Arguments;
use clap::Parser;

use crate::annotations::Annotations;
use crate::chip::Chip;
use crate::report::{Report, Scope};

/// What `--help` says behind the options.
macro_rules! help {
    () => {
        "\
Follows every path of the machine code, and runs nothing: no path takes more than is printed. It
knows the ATmega168 and the ATmega328P.

  stack at its deepest: 9 bytes         of the main program and the handlers on top of it
    = f 4 + g 3 + INT0 2                functions, each with the return address to its caller
  handler of INT0: 660 cycles           from the interrupt's response to the end of RETI
  INT0 blocked for 41 cycles, A to B    A blocks the interrupt, and B ends that
  turn of the main loop at A: 99 cycles the longest round of the loop that never ends

What cannot be followed is refused with its address and function. A file for --annotations then says
what is true there, such as how often a loop runs at most:

  [[loop]]
  function = \"wait\"
  at_most = 20
  reason = \"the byte takes 16 cycles\"

The output ends with what is assumed and not checked. The crate's README has all kinds of entries."
    };
}

/// What `--help` of a command with these options says behind them.
pub const HELP: &str = help!();

/// Proves from the machine code of an AVR program how much stack and how many cycles it needs.
#[derive(Debug, Clone, Parser)]
#[command(
    name = "avr-bounds",
    version,
    after_help = concat!(
        help!(),
        "\n\nExit codes: 0; 1 if --ram-limit is exceeded; 2 if the program or a file is refused, a \
         handler or a blocked stretch has no bound, or any loop with --every-loop."
    )
)]
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
    /// The chip, atmega168 or atmega328p. Necessary if the program does not name it.
    #[arg(long)]
    pub chip: Option<Chip>,
    /// A file with what the analysis cannot find.
    #[arg(long, value_name = "TOML")]
    pub annotations: Option<PathBuf>,
    /// Finds no times.
    #[arg(long)]
    pub stack_only: bool,
    /// Lists all stretches, and the loops with their bounds.
    #[arg(long, conflicts_with = "stack_only")]
    pub loops: bool,
    /// Fails if any loop has no bound, also of the main program.
    #[arg(long, conflicts_with = "stack_only")]
    pub every_loop: bool,
    /// Prints JSON.
    #[arg(long)]
    pub json: bool,
    /// Fails if variables and stack need more bytes.
    #[arg(long, value_name = "BYTES")]
    pub ram_limit: Option<u32>,
}

/// Most bytes of a file: far more than any program has. A device such as /dev/zero has no end.
const MOST_BYTES: u64 = 64 << 20;

fn read_file(path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(MOST_BYTES + 1).read_to_end(&mut bytes)?;
    ensure!(bytes.len() as u64 <= MOST_BYTES, "it has more than {MOST_BYTES} bytes");
    Ok(bytes)
}

/// What helps if a loop has no bound.
const ADVICE: &str = "Give each loop a [[loop]] with its function, number and at_most in a file \
                      for --annotations, or a [[wait]] if it reads a register (README.md)";

impl Options {
    /// Runs the command. Returns the exit code: 1 if a limit is exceeded.
    ///
    /// # Errors
    /// If a file cannot be read, the program cannot be followed, or a handler or a stretch has no
    /// bound.
    pub fn run(&self, out: &mut impl Write) -> Result<ExitCode> {
        let path = self.elf.display();
        let elf = read_file(&self.elf).with_context(|| format!("cannot read {path}"))?;
        let annotations = match &self.annotations {
            Some(path) => {
                let shown = path.display();
                let text = read_file(path).with_context(|| format!("cannot read {shown}"))?;
                let text = String::from_utf8(text).ok();
                let text = text.with_context(|| format!("{shown} is no text in UTF-8"))?;
                Annotations::parse(&text).with_context(|| shown.to_string())?
            }
            None => Annotations::default(),
        };
        let report = self.report(&elf, annotations).with_context(|| path.to_string())?;
        if self.json {
            writeln!(out, "{}", serde_json::to_string_pretty(&report)?)?;
        } else if self.loops {
            write!(out, "{report:#}")?;
        } else {
            write!(out, "{report}")?;
        }
        if let Some(times) = &report.times
            && !times.is_bounded()
        {
            bail!(
                "{path}: a handler or a blocked stretch has no bound: {}. {ADVICE}",
                times.missing.join("; ")
            );
        }
        if let Some(times) = &report.times
            && self.every_loop
            && !times.is_explained()
        {
            bail!("{path}: a loop has no bound: {}. {ADVICE}", times.missing.join("; "));
        }
        let is_exceeded =
            self.ram_limit.zip(report.ram_bytes).is_some_and(|(most, used)| used > most);
        if is_exceeded {
            eprintln!("avr-bounds: {path}: variables and stack exceed {:?} bytes", self.ram_limit);
        }
        Ok(if is_exceeded { ExitCode::FAILURE } else { ExitCode::SUCCESS })
    }

    fn report(&self, elf: &[u8], annotations: Annotations) -> Result<Report> {
        let chip = match (self.chip, Chip::of_elf(elf)?) {
            (Some(chip), None) | (None, Some(chip)) => chip,
            (Some(chip), Some(named)) if chip == named => chip,
            (Some(_), Some(named)) => bail!("the program is for an {}", named.name()),
            (None, None) => bail!("the program does not name its chip: use --chip"),
        };
        let scope = if self.stack_only { Scope::Stack } else { Scope::Everything };
        Report::of(elf, chip, annotations, scope)
    }
}
