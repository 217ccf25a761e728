//! The endless loops of a program, such as the main loop: from them no path leads to another loop
//! but those within.

use std::collections::BTreeSet;

use anyhow::Result;

use crate::cycles::Timing;
use crate::order::{Loop, Part};
use crate::state::State;
use crate::summary::{Entry, Summary};

/// An endless loop.
#[derive(Debug, Clone)]
pub struct Endless {
    /// The function with the loop.
    pub entry: Entry,
    /// The loop.
    pub inner: Loop,
    /// What is known whenever a round begins.
    pub state: State,
}

/// The endless loops that are reached from a function that does not return.
///
/// # Errors
/// If a path cannot be followed.
pub fn find(timing: &mut Timing<'_, '_>, entry: Entry) -> Result<Vec<Endless>> {
    let summary = timing.analysis.function(entry)?;
    if summary.exit.is_some() {
        return Ok(Vec::new());
    }
    let order = timing.order(entry, &summary);
    let loops: Vec<&Loop> = order
        .parts
        .iter()
        .filter_map(|part| match part {
            // The program stops in a loop of one instruction.
            Part::Loop(inner) if inner.nodes.len() > 1 => Some(inner),
            _ => None,
        })
        .collect();
    let mut found = Vec::new();
    let mut calls = Vec::new();
    for (at, callee) in &summary.endless_calls {
        let endless = find(timing, *callee)?;
        if !endless.is_empty() {
            calls.push(*at);
            found.extend(endless);
        }
    }
    for inner in &loops {
        let reached = reached(&summary, &inner.nodes);
        let is_left = calls.iter().any(|at| reached.contains(at))
            || loops.iter().any(|other| {
                other.head != inner.head && other.nodes.iter().any(|at| reached.contains(at))
            });
        if let Some(state) = summary.states.get(&inner.head).filter(|_| !is_left) {
            found.push(Endless { entry, inner: (*inner).clone(), state: state.clone() });
        }
    }
    Ok(found)
}

/// The instructions that are reached from these.
fn reached(summary: &Summary, from: &BTreeSet<u32>) -> BTreeSet<u32> {
    let mut reached = from.clone();
    let mut pending: Vec<u32> = from.iter().copied().collect();
    while let Some(at) = pending.pop() {
        for (_, to) in summary.edges.range((at, 0)..=(at, u32::MAX)) {
            if reached.insert(*to) {
                pending.push(*to);
            }
        }
    }
    reached
}
