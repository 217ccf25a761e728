//! Loops: followed round by round until no path goes back to the head.

use anyhow::Result;

use crate::clock::{Clocks, Looked};
use crate::countdown;
use crate::cycles::{NoBound, Timing};
use crate::order::Loop;
use crate::path::{Bound, Run, Turn};
use crate::state::State;
use crate::wait;

/// Instructions of a loop that are followed, before the analysis gives up.
const MOST_STEPS: u32 = 200_000;

/// Rounds of a loop for which it has given up before.
const MOST_ROUNDS: u32 = 16;

/// A loop that is followed.
struct Rounds<'a> {
    inner: &'a Loop,
    function: String,
    /// Its number in the function, counted from 1.
    number: usize,
    /// How often it goes back to its head, if that is known.
    most: Option<u32>,
    is_annotated: bool,
    /// The time at its beginning.
    begin: u32,
    since_spdr: u8,
    /// Instructions that had been followed at its beginning.
    steps: u32,
    /// The state and the time at the beginning of the round before.
    previous: Option<(State, u32)>,
}

impl Timing<'_, '_> {
    /// Follows a loop until nothing goes back to its head.
    pub(crate) fn rounds(&mut self, run: &mut Run, inner: &Loop) -> Result<()> {
        if run.is_endless(inner) {
            return self.endless(run, inner);
        }
        let Some((state, clocks)) = run.pending.get_mut(&inner.head) else { return Ok(()) };
        if let Some((rounds, cycles)) = countdown::skip(self.analysis.program, inner, state) {
            clocks.pass(cycles);
            let number = number(run, inner);
            run.bounds.push((inner.head, Bound { number, rounds, cycles }));
            // The last round.
            self.round(run, inner)?;
            run.pending.remove(&inner.head);
            return Ok(());
        }
        let mut rounds = self.begin(run, inner);
        for round in 0.. {
            if round > 0 && !self.goes_on(run, &mut rounds, round)? {
                run.pending.remove(&inner.head);
                return Ok(());
            }
            if let Some((state, clocks)) = run.pending.get(&inner.head) {
                rounds.previous = Some((state.clone(), clocks.total));
                let cycles = clocks.total.saturating_sub(rounds.begin);
                let bound = Bound { number: rounds.number, rounds: round, cycles };
                if clocks.total != u32::MAX {
                    run.bounds.push((inner.head, bound));
                }
            }
            self.round(run, inner)?;
        }
        Ok(())
    }

    fn begin<'a>(&self, run: &Run, inner: &'a Loop) -> Rounds<'a> {
        let function = self.analysis.program.function_name(inner.head);
        let number = number(run, inner);
        let annotations = self.analysis.annotations;
        let mut most = annotations.bound(&function, Some(number)).map(|found| found.at_most);
        if most.is_none() && self.unbounded.contains(&inner.head) {
            most = annotations.bound(&function, None).map(|found| found.at_most);
        }
        let pending = run.pending.get(&inner.head);
        Rounds {
            inner,
            function,
            number,
            most,
            is_annotated: most.is_some(),
            begin: pending.map_or(0, |(_, clocks)| clocks.total),
            since_spdr: pending.map_or(0, |(state, _)| state.since_spdr),
            steps: self.steps,
            previous: None,
        }
    }

    fn round(&mut self, run: &mut Run, inner: &Loop) -> Result<()> {
        self.instruction(run, inner.head)?;
        self.parts(run, &inner.body)
    }

    /// True if a further round must be followed.
    fn goes_on(&mut self, run: &mut Run, rounds: &mut Rounds<'_>, round: u32) -> Result<bool> {
        let head = rounds.inner.head;
        let Some((state, clocks)) = run.pending.get_mut(&head) else { return Ok(false) };
        let Some((before, total)) = rounds.previous.take() else { return Ok(false) };
        let cycles = clocks.total.saturating_sub(total);
        let is_too_long = self.steps - rounds.steps > MOST_STEPS
            || round > MOST_ROUNDS && self.too_long.contains(&head);
        if round == 1 && !rounds.is_annotated {
            let since_spdr = rounds.since_spdr;
            rounds.most =
                wait::rounds(self.analysis, rounds.inner, &run.summary, since_spdr, cycles);
        }
        let is_stable = *state == before;
        match rounds.most {
            Some(most) if round > most => return Ok(false),
            // From here on each round is like this one.
            Some(most) if is_stable && round > 1 && most > round => {
                clocks.pass(cycles.saturating_mul(most - round));
                rounds.most = Some(round);
            }
            None if is_stable || is_too_long => {
                if is_too_long {
                    self.too_long.insert(head);
                }
                clocks.never_end();
                if let Some(any) = run.summary.states.get(&head) {
                    *state = any.clone();
                }
                rounds.most = Some(round);
                self.no_bound(run, rounds)?;
            }
            _ => {}
        }
        Ok(true)
    }

    /// A loop without a bound: it gets that of the annotations when the function is followed once
    /// more.
    fn no_bound(&mut self, run: &mut Run, rounds: &Rounds<'_>) -> Result<()> {
        let Rounds { inner: Loop { head, .. }, function, number, .. } = rounds;
        let text = format!("{head:#x} in {function}: loop {number} has no bound");
        run.is_incomplete |= self.unbounded.insert(*head);
        if !run.is_lenient {
            return Err(NoBound(text).into());
        }
        if self.analysis.annotations.bound(function, None).is_none() {
            self.missing.insert(text);
        }
        Ok(())
    }

    /// Follows an endless loop, from the state that is true in each of its rounds. A stretch can
    /// last from one round to the next.
    fn endless(&mut self, run: &mut Run, inner: &Loop) -> Result<()> {
        let Some((mut state, mut clocks)) = run.pending.remove(&inner.head) else { return Ok(()) };
        if let Some(any) = run.summary.states.get(&inner.head) {
            state = any.clone();
        }
        for round in 0.. {
            (clocks.total, clocks.looked) = (0, Looked::at_entry());
            run.pending.insert(inner.head, (state.clone(), clocks.clone()));
            self.round(run, inner)?;
            let Some((_, after)) = run.pending.remove(&inner.head) else { return Ok(()) };
            let (nodes, cycles, enables) = (inner.nodes.len(), after.total, state.enables);
            run.note_turn(Turn { nodes, head: inner.head, cycles, enables });
            let mut joined = clocks.clone();
            joined.join(&Clocks { total: 0, looked: Looked::at_entry(), ..after });
            if joined == clocks {
                return Ok(());
            }
            if round > 0 {
                joined.never_end_where_longer(&clocks);
            }
            clocks = joined;
        }
        Ok(())
    }
}

fn number(run: &Run, inner: &Loop) -> usize {
    1 + run.order.heads.iter().position(|at| *at == inner.head).unwrap_or(0)
}
