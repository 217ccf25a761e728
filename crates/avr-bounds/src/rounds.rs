//! Loops: followed round by round until no path goes back to the head.

use std::collections::BTreeMap;

use anyhow::{Context as _, Result, bail};

use crate::annotations;
use crate::clock::{Clocks, Looked, keep_longer};
use crate::countdown;
use crate::cycles::{NoBound, Timing};
use crate::opcode::Op;
use crate::order::Loop;
use crate::path::{Bound, Open, Run, Told, Turn};
use crate::program::Program;
use crate::stack::Analysis;
use crate::state::{Interrupts, State};
use crate::summary::Summary;
use crate::text::Text;
use crate::wait;

/// Instructions of a loop that are followed, before the analysis gives up.
const MOST_STEPS: u32 = 200_000;

/// Rounds of a loop for which it has given up before.
const MOST_ROUNDS: u32 = 16;

/// Rounds of a loop with an annotation that are followed one by one. All further ones begin with
/// what is true in each.
const FOLLOWED_ROUNDS: u32 = 500;

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

impl<'a> Timing<'a, '_> {
    /// Follows a loop until nothing goes back to its head.
    pub(crate) fn rounds(&mut self, run: &mut Run, inner: &Loop) -> Result<()> {
        for at in &inner.lead {
            self.instruction(run, *at)?;
        }
        if run.is_endless(inner) {
            return self.endless(run, inner);
        }
        let annotation = self.annotation(run, inner)?;
        if let Some(annotation) = annotation
            && let Some(until) = &annotation.until
        {
            return self.open(run, inner, annotation, until);
        }
        let Some((state, clocks)) = run.pending.get_mut(&inner.head).map(Box::as_mut) else {
            return Ok(());
        };
        if let Some((rounds, cycles)) =
            countdown::skip(self.analysis.program, &self.analysis.interference, inner, state)
        {
            clocks.pass(cycles);
            let number = number(run, inner);
            run.bounds.push((inner.head, Bound { number, rounds, cycles }));
            // The last round.
            self.round(run, inner)?;
            run.pending.remove(&inner.head);
            return Ok(());
        }
        let mut rounds = self.begin(run, inner, annotation.and_then(|found| found.at_most));
        for round in 0.. {
            if round > 0 && !self.goes_on(run, &mut rounds, round)? {
                run.pending.remove(&inner.head);
                return Ok(());
            }
            if let Some((state, clocks)) = run.pending.get(&inner.head).map(Box::as_ref) {
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

    /// The annotation of a loop: of its number, or of those for which no bound was found.
    fn annotation(&mut self, run: &Run, inner: &Loop) -> Result<Option<&'a annotations::Loop>> {
        let Analysis { program, annotations, .. } = &*self.analysis;
        let (program, annotations) = (*program, *annotations);
        let function = program.function_name(inner.head);
        let number = number(run, inner);
        let is_unbounded = self.unbounded.contains(&inner.head);
        let found = annotations
            .bound(&function, Some(number))
            .or_else(|| annotations.bound(&function, None).filter(|_| is_unbounded));
        if let Some(begins) = found.and_then(|found| found.begins.as_ref()) {
            let text = Text(program.instruction(inner.head)?.op, inner.head).to_string();
            if !text.starts_with(begins.as_str()) {
                bail!(
                    "{}: loop {number} begins with `{text}`, and in the annotation with \
                     `{begins}`: look which number that loop has now",
                    program.place(inner.head)
                );
            }
        }
        if let Some(found) = found {
            let text = match (found.at_most, &found.until) {
                (Some(rounds), _) => format!("at most {rounds} rounds, because {}", found.reason),
                (_, Some(until)) => format!("it ends when {until}: {}", found.reason),
                _ => found.reason.clone(),
            };
            self.annotated.insert(inner.head, text);
            self.used.insert(found.name());
            if let Some(at_most) = found.at_most {
                let told = Told { number, backs: run.backs(inner), at_most };
                self.told.insert(inner.head, told);
            }
        }
        Ok(found)
    }

    fn begin<'l>(&self, run: &Run, inner: &'l Loop, most: Option<u32>) -> Rounds<'l> {
        let function = self.analysis.program.function_name(inner.head);
        let number = number(run, inner);
        let pending = run.pending.get(&inner.head).map(Box::as_ref);
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
        let Some((state, clocks)) = run.pending.get_mut(&head).map(Box::as_mut) else {
            return Ok(false);
        };
        let Some((before, total)) = rounds.previous.take() else { return Ok(false) };
        let cycles = clocks.total.saturating_sub(total);
        let is_too_long = self.steps - rounds.steps > MOST_STEPS
            || round > MOST_ROUNDS && self.too_long.contains(&head);
        if round == 1 && !rounds.is_annotated {
            let since_spdr = rounds.since_spdr;
            let wait = wait::rounds(self.analysis, rounds.inner, &run.summary, since_spdr, cycles);
            rounds.most = wait.map(|(rounds, _)| rounds);
            self.annotated.extend(wait.map(|(_, wait)| (head, wait.reason.clone())));
            self.used.extend(wait.map(|(_, wait)| wait.name()));
        }
        if round >= FOLLOWED_ROUNDS && rounds.is_annotated {
            *state = any_round(&run.summary, head)?;
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
                *state = any_round(&run.summary, head)?;
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
        let Some(pending) = run.pending.remove(&inner.head) else { return Ok(()) };
        let mut clocks = pending.1;
        let state = any_round(&run.summary, inner.head)?;
        // What follows the loop has no time since the entry of the function.
        let opens = u32::from(run.has_exit(inner));
        for round in 0.. {
            (clocks.looked, clocks.opens) = (Looked::at_entry(), opens);
            clocks.begin_turn();
            run.pending.insert(inner.head, Box::new((state.clone(), clocks.clone())));
            self.round(run, inner)?;
            let Some(pending) = run.pending.remove(&inner.head) else { return Ok(()) };
            let after = pending.1;
            keep_longer(run.through.entry(inner.head).or_default(), &after.through);
            let of_kinds = after.of_kinds.iter().copied().collect();
            keep_longer(run.of_kinds.entry(inner.head).or_default(), &of_kinds);
            run.note_turn(Turn {
                size: size(self.analysis.program, inner),
                head: inner.head,
                cycles: after.total,
                is_named: false,
                is_open: after.opens > opens,
                enables: state.enables,
            });
            let mut joined = clocks.clone();
            let mut after = Clocks { looked: Looked::at_entry(), opens, ..after };
            after.begin_turn();
            joined.join(&after);
            if joined == clocks {
                self.never_ended(&state, &clocks, inner.head);
                return Ok(());
            }
            if round > 0 {
                joined.never_end_where_longer(&clocks);
            }
            clocks = joined;
        }
        Ok(())
    }

    /// Notes the stretches that go on in all rounds of an endless loop because it is not known
    /// whether interrupts are enabled. Where they are disabled for ever, the program has stopped.
    fn never_ended(&mut self, state: &State, clocks: &Clocks, head: u32) {
        if state.interrupts != Interrupts::Either {
            return;
        }
        for (index, blocked) in clocks.blocked.iter().enumerate() {
            for begins in blocked.own.keys() {
                self.ended.note(index, *begins, head, u32::MAX);
                self.missing.insert(format!(
                    "{}: interrupts are blocked from here on, and a value that is written to SREG \
                     later is not known",
                    self.analysis.program.place(*begins)
                ));
            }
        }
    }

    /// Follows a loop whose rounds are not counted, from the state that is true in each of them.
    /// The last round counts, on the way to what follows the loop.
    fn open(
        &mut self,
        run: &mut Run,
        inner: &Loop,
        annotation: &annotations::Loop,
        until: &str,
    ) -> Result<()> {
        let Some(pending) = run.pending.remove(&inner.head) else { return Ok(()) };
        let mut clocks = pending.1;
        let state = any_round(&run.summary, inner.head)?;
        clocks.open();
        let mut cycles = 0;
        for round in 0.. {
            run.pending.insert(inner.head, Box::new((state.clone(), clocks.clone())));
            self.round(run, inner)?;
            let Some(pending) = run.pending.remove(&inner.head) else { break };
            let after = pending.1;
            let is_bounded = after.total != u32::MAX;
            cycles = if is_bounded { cycles.max(after.total - clocks.total) } else { u32::MAX };
            if annotation.is_turn {
                run.note_turn(Turn {
                    size: size(self.analysis.program, inner),
                    head: inner.head,
                    cycles,
                    is_named: true,
                    is_open: after.opens > clocks.opens,
                    enables: state.enables,
                });
            }
            let mut joined = clocks.clone();
            let (total, opens) = (clocks.total, clocks.opens);
            // A turn with this loop has no bound.
            let (through, of_kinds) = (BTreeMap::new(), Vec::new());
            joined.join(&Clocks { total, opens, through, of_kinds, ..after });
            if joined == clocks {
                break;
            }
            if round > 0 {
                joined.never_end_where_longer(&clocks);
                joined.looked.pass(u32::MAX);
            }
            clocks = joined;
        }
        let (until, reason) = (until.into(), annotation.reason.clone());
        run.opens.push((inner.head, Open { number: number(run, inner), cycles, until, reason }));
        Ok(())
    }
}

/// What is true at the beginning of each round.
fn any_round(summary: &Summary, head: u32) -> Result<State> {
    let state = summary.states.get(&head).cloned();
    state.with_context(|| format!("{head:#x}: the paths to this loop were not followed"))
}

/// The instructions of a loop, and a number of them for each call.
fn size(program: &Program, inner: &Loop) -> usize {
    const CALL: usize = 20;
    let is_call = |at: &&u32| {
        let op = program.instruction(**at).map(|found| found.op);
        matches!(op, Ok(Op::Call(_) | Op::Rcall(_) | Op::Icall))
    };
    inner.nodes.len() + CALL * inner.nodes.iter().filter(is_call).count()
}

fn number(run: &Run, inner: &Loop) -> usize {
    1 + run.order.heads.iter().position(|at| *at == inner.head).unwrap_or(0)
}
