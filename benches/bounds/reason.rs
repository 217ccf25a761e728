//! Why a bound is loose: each row of the table with a ratio above [`EXPLAINED`] must have a reason.

use std::collections::BTreeSet;

use bounds::report::Report;
use rig::observed::Pair;

/// A ratio of cycles above this needs a reason.
const EXPLAINED: f64 = 1.5;
/// The same of the stack: the observed one is at least 80 % of the proved one.
const EXPLAINED_STACK: f64 = 1.25;

/// Why a bound may be loose.
pub struct Reason(Option<String>);

impl Reason {
    /// The bound must not be loose.
    pub fn none() -> Self {
        Self(None)
    }

    /// Of a figure. `of_one` is the same figure with one frame read in each call, and `ran` has the
    /// interrupts whose handlers ran.
    pub fn of(pair: &Pair, of_one: &Pair, report: &Report, ran: &BTreeSet<&str>) -> Self {
        let Pair { name, proved, .. } = pair;
        Self(match name.as_str() {
            "stack" => unseen_handlers(report, ran),
            "turn of the main loop" => Some(
                "adds up all parts of a turn, of which the agenda chooses one by values in RAM"
                    .into(),
            ),
            "handler of TIMER0_COMPB" => Some(
                "adds up the wait for the farthest edge and eight outputs without a pulse".into(),
            ),
            _ if of_one.proved < *proved => Some(format!(
                "reads all frames that can be there; in the floods one at most, whose bound with \
                 the look for the next is {}",
                of_one.proved
            )),
            _ => None,
        })
    }

    /// The text beside a ratio; empty if the ratio needs none.
    ///
    /// # Panics
    /// If it needs one, and there is none.
    pub fn text(&self, name: &str, ratio: f64) -> &str {
        let limit = if name == "stack" { EXPLAINED_STACK } else { EXPLAINED };
        match (&self.0, ratio > limit) {
            (_, false) => "",
            (Some(text), true) => text,
            (None, true) => panic!("{name}: a ratio of {ratio:.2} has no reason"),
        }
    }
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
