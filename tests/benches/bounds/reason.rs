//! Why a bound is loose: each row of the table with a ratio above [`EXPLAINED`] must have a reason.

use std::collections::BTreeSet;

use bounds::report::Report;
use rig::observed::{OF_KINDS, Pair, ROUNDS};

/// A ratio of cycles above this needs a reason.
const EXPLAINED: f64 = 1.5;
/// The same of a turn of one kind.
const EXPLAINED_TURN: f64 = 2.0;
/// The same of the stack: the observed one is at least 80 % of the proved one.
const EXPLAINED_STACK: f64 = 1.25;

/// Why a bound may be loose.
pub enum Reason {
    /// The bound must not be loose.
    None,
    /// In general.
    Text(String),
    /// The code reads frames while there are some: the bound for one with the look for the next.
    Frames(u32),
}

impl Reason {
    /// Of a figure. `of_one` is the same figure with one frame read in each call, and `ran` has the
    /// interrupts whose handlers ran.
    pub fn of(pair: &Pair, of_one: &Pair, report: &Report, ran: &BTreeSet<&str>) -> Self {
        let Pair { name, proved, .. } = pair;
        match name.as_str() {
            "stack" => unseen_handlers(report, ran).map_or(Self::None, Self::Text),
            "turn of the main loop" => Self::Text(
                "reads the frames that INT0 has missed, and is of the longest kind, below".into(),
            ),
            _ if name.starts_with(OF_KINDS) => Self::Text(of_turn(name).into()),
            "handler of TIMER0_COMPB" => Self::Text(
                "adds up the wait for the farthest edge and eight outputs without a pulse".into(),
            ),
            _ if of_one.proved < *proved => Self::Frames(of_one.proved),
            _ if name.contains("blocked") && name.contains("__avr_device_rt_main") => Self::Text(
                "adds up all that the chip can report in one part of a supervision".into(),
            ),
            _ => Self::None,
        }
    }

    /// The text beside a ratio; empty if the ratio needs none.
    ///
    /// # Panics
    /// If it needs one, and there is none.
    pub fn text(&self, pair: &Pair) -> String {
        let Pair { name, proved, observed } = pair;
        let limit = match name.as_str() {
            "stack" => EXPLAINED_STACK,
            name if name.starts_with(OF_KINDS) => EXPLAINED_TURN,
            _ => EXPLAINED,
        };
        let ratio = f64::from(*proved) / f64::from(*observed);
        match self {
            _ if ratio <= limit => String::new(),
            _ if *observed == 0 => "not in the floods".into(),
            Self::Text(text) => text.clone(),
            Self::Frames(one) if *one < 2 * observed => format!(
                "reads all frames that can be there, and in the floods one, whose bound with the \
                 look for the next is {one}"
            ),
            Self::Frames(_) => {
                "reads the frames that INT0 has missed, and in the floods none".into()
            }
            Self::None if name.starts_with(ROUNDS) => {
                "counts the rounds of the annotation; the floods have no case of so many".into()
            }
            Self::None => panic!("{name}: a ratio of {ratio:.2} has no reason"),
        }
    }
}

/// Why the bound of turns of some kinds (avr-specs/bounds.toml) is loose. The first that fits
/// counts.
fn of_turn(name: &str) -> &'static str {
    const REASONS: [(&str, &str); 8] = [
        ("service", "compares each name to its end; in the floods most differ in the first letter"),
        ("message", "copies as many bytes as a register can count; the length is a value in RAM"),
        ("tick", "does all that can be due in the same millisecond"),
        ("chore", "does the longest chore, which the floods have none of"),
        ("poll", "reports all that the chip can report at once"),
        ("monitor", "writes the longest number; in the floods most turns write a letter"),
        (
            "step",
            "makes four bytes of a parameter; in the floods most steps make bytes that are kept",
        ),
        ("", "adds up parts that exclude each other by values in RAM, as the length of a frame"),
    ];
    let fitting = REASONS.iter().find(|(kind, _)| name.contains(kind));
    fitting.map_or("", |(_, reason)| reason)
}

/// The handlers on top of the deepest stack that did not run.
fn unseen_handlers(report: &Report, ran: &BTreeSet<&str>) -> Option<String> {
    let on_top = |name: &str| report.stack.frames.iter().any(|frame| frame.function == name);
    let unseen: Vec<String> = report
        .stack
        .handlers
        .iter()
        .filter(|handler| on_top(&handler.interrupt))
        .filter(|handler| !ran.contains(handler.interrupt.as_str()))
        .map(|handler| match handler.interrupt.as_str() {
            "WDT" => format!("{} of WDT, which runs only if the program hangs", handler.bytes),
            name => format!("{} of {name}, which did not run", handler.bytes),
        })
        .collect();
    (!unseen.is_empty()).then(|| format!("has {}", unseen.join(" and ")))
}
