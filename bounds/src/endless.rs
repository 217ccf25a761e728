//! The main loop: the largest loop of the functions that do not return.

use anyhow::Result;

use crate::cycles::Timing;
use crate::order::{Loop, Part};
use crate::state::State;
use crate::summary::Entry;

/// A loop of a function that does not return.
#[derive(Debug, Clone)]
pub struct Endless {
    /// The function with the loop.
    pub entry: Entry,
    /// The loop.
    pub inner: Loop,
    /// What is known whenever a round begins.
    pub state: State,
}

/// The largest loop that is reached from a function that does not return.
///
/// # Errors
/// If a path cannot be followed.
pub fn main_loop(timing: &mut Timing<'_, '_>, entry: Entry) -> Result<Option<Endless>> {
    let summary = timing.analysis.function(entry)?;
    let order = timing.order(entry, &summary);
    let mut found: Option<Endless> = None;
    let mut consider = |other: Endless| {
        let size = |endless: &Endless| endless.inner.nodes.len();
        if found.as_ref().is_none_or(|known| size(known) < size(&other)) {
            found = Some(other);
        }
    };
    for part in &order.parts {
        if let Part::Loop(inner) = part
            && let Some(state) = summary.states.get(&inner.head)
        {
            consider(Endless { entry, inner: inner.clone(), state: state.clone() });
        }
    }
    for (_, callee) in &summary.endless_calls {
        if let Some(other) = main_loop(timing, *callee)? {
            consider(other);
        }
    }
    Ok(found)
}
