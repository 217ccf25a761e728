//! The file that says what the analysis cannot find: targets of indirect calls, bounds of loops,
//! waits for the hardware. Each entry has a reason. It also names kinds of turns.
//!
//! Functions are named as [`Program::function_name`] prints them.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context, Result, bail, ensure};
use serde::Deserialize;

use crate::clock::Kinds;
use crate::program::Program;

/// The contents of the file.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Annotations {
    /// Targets of indirect calls and jumps.
    #[serde(default)]
    pub indirect: Vec<Indirect>,
    /// Bounds of loops.
    #[serde(default, rename = "loop")]
    pub loops: Vec<Loop>,
    /// Waits for the hardware.
    #[serde(default)]
    pub wait: Vec<Wait>,
    /// Kinds of turns of the main loop.
    #[serde(default, rename = "turn")]
    pub turns: Vec<TurnKind>,
}

/// The targets of the indirect calls and jumps of a function.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Indirect {
    /// The function that calls or jumps.
    pub function: String,
    /// Functions that it may call or jump to.
    pub targets: Vec<String>,
    /// Why these are all.
    pub reason: String,
}

/// The bound of a loop, or of several.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Loop {
    /// The function that contains the loop.
    pub function: String,
    /// Which of its loops, counted from 1 by address. If it is left out: those for which the
    /// analysis finds no bound.
    pub number: Option<usize>,
    /// The entry is for programs with this function only. Of two that fit the first counts.
    pub with: Option<String>,
    /// The entry is for this chip only.
    pub chip: Option<String>,
    /// How the text of the loop's first instruction begins, as `--loops` prints it. If it begins
    /// otherwise, another loop has the number now, and the program is refused.
    pub begins: Option<String>,
    /// How often the loop goes back to its beginning, each time it is reached.
    pub at_most: Option<u32>,
    /// In place of `at_most`: what ends the loop, if that happens outside of the chip. The rounds
    /// before the last are not counted.
    pub until: Option<String>,
    /// With `until`: a round is a turn of the main loop.
    #[serde(default)]
    pub is_turn: bool,
    /// Why it does not go back more often, or what bounds its time.
    pub reason: String,
}

/// A kind of turns of the main loop, which gets a bound of its own. A turn can be of several kinds,
/// and then counts for each combination of them by itself. Nothing rests on this entry.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TurnKind {
    /// What such a turn does.
    pub kind: String,
    /// A turn that calls one of these functions is of this kind, wherever it calls it. Those that
    /// the program does not have do not count.
    pub calls: Vec<String>,
}

/// Most kinds of turns.
pub const MOST_KINDS: usize = 32;

/// A loop that only reads a register until the hardware changes it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wait {
    /// Address of the register that the loop reads, in the data space.
    pub register: u16,
    /// How long the hardware takes, in cycles: from the last write of SPDR for SPSR (0x4D), else
    /// from the beginning of the loop.
    pub cycles: u32,
    /// Where the time comes from.
    pub reason: String,
}

impl Loop {
    /// How the output names the entry.
    pub fn name(&self) -> String {
        let number = self.number.map(|number| format!(" {number}")).unwrap_or_default();
        let with = self.with.as_ref().map(|with| format!(" with {with}")).unwrap_or_default();
        let chip = self.chip.as_ref().map(|chip| format!(" on {chip}")).unwrap_or_default();
        format!("[[loop]] {}{number}{with}{chip}", self.function)
    }
}

impl Wait {
    /// How the output names the entry.
    pub fn name(&self) -> String {
        format!("[[wait]] {:#04x}", self.register)
    }
}

impl Annotations {
    /// Reads the text of a file.
    ///
    /// # Errors
    /// If the text is no such file, or an entry has no reason.
    pub fn parse(text: &str) -> Result<Self> {
        let this: Self = toml::from_str(text).context("wrong annotations")?;
        let indirect = this.indirect.iter().map(|entry| (&entry.function, &entry.reason));
        let loops = this.loops.iter().map(|entry| (&entry.function, &entry.reason));
        for (function, reason) in indirect.chain(loops) {
            ensure!(!reason.trim().is_empty(), "the annotation of {function} needs a reason");
        }
        if let Some(entry) =
            this.loops.iter().find(|entry| entry.at_most.is_some() == entry.until.is_some())
        {
            bail!("the annotation of {} needs either at_most or until", entry.function);
        }
        ensure!(this.turns.len() <= MOST_KINDS, "there are at most {MOST_KINDS} kinds of turns");
        if let Some(wait) = this.wait.iter().find(|wait| wait.reason.trim().is_empty()) {
            bail!("the wait for register {:#x} needs a reason", wait.register);
        }
        Ok(this)
    }

    /// The entries that say nothing about a program, as the output names them. `used` has the names
    /// of those that bounded a loop of it.
    pub fn unused(&self, program: &Program, used: &BTreeSet<String>) -> Vec<String> {
        let is_absent = |name: &str| program.function_address(name).is_none();
        let indirect = self.indirect.iter().filter(|entry| is_absent(&entry.function));
        let indirect = indirect.map(|entry| format!("[[indirect]] {}", entry.function));
        let rounds = self.loops.iter().map(Loop::name).chain(self.wait.iter().map(Wait::name));
        let rounds = rounds.filter(|name| !used.contains(name));
        let calls = self.turns.iter().flat_map(|entry| {
            let absent = entry.calls.iter().filter(|call| is_absent(call));
            absent.map(|call| format!("[[turn]] {}: {call}", entry.kind))
        });
        indirect.chain(rounds).chain(calls).collect()
    }

    /// Leaves out the entries that are for other programs.
    pub fn keep_those_of(&mut self, program: &Program) {
        let is_in = |name: &String| program.function_address(name).is_some();
        let is_chip = |name: &String| name == program.chip.name();
        self.loops.retain(|entry| entry.with.as_ref().is_none_or(is_in));
        self.loops.retain(|entry| entry.chip.as_ref().is_none_or(is_chip));
    }

    /// The addresses to which the indirect calls and jumps of a function lead, if there is an
    /// entry for it.
    ///
    /// # Errors
    /// If a target is not in the program.
    pub fn targets(&self, program: &Program, function: &str) -> Result<Option<Vec<u32>>> {
        let named = |entry: &&Indirect| entry.function == function;
        let Some(entry) = self.indirect.iter().find(named) else { return Ok(None) };
        let find = |name: &String| {
            program.function_address(name).with_context(|| format!("there is no function {name}"))
        };
        entry.targets.iter().map(find).collect::<Result<Vec<u32>>>().map(Some)
    }

    /// The bound of loop `number` of a function, counted from 1; `None`: of all loops of the
    /// function for which the analysis finds none.
    pub fn bound(&self, function: &str, number: Option<usize>) -> Option<&Loop> {
        let fits = |entry: &Loop| entry.function == function && entry.number == number;
        self.loops.iter().find(|entry| fits(entry))
    }

    /// The functions of which a call tells the kind of a turn, by their addresses, with the kinds.
    pub fn kinds(&self, program: &Program) -> BTreeMap<u32, Kinds> {
        let mut kinds = BTreeMap::new();
        for (number, entry) in self.turns.iter().enumerate() {
            for function in &entry.calls {
                if let Some(address) = program.function_address(function) {
                    *kinds.entry(address).or_default() |= 1 << number;
                }
            }
        }
        kinds
    }

    /// The names of a set of kinds of turns, in the order of the entries.
    pub fn names_of(&self, kinds: Kinds) -> Vec<String> {
        let named = self.turns.iter().enumerate().filter(|(number, _)| kinds >> number & 1 != 0);
        named.map(|(_, entry)| entry.kind.clone()).collect()
    }

    /// The wait for a register.
    pub fn wait(&self, register: u16) -> Option<&Wait> {
        self.wait.iter().find(|entry| entry.register == register)
    }
}
