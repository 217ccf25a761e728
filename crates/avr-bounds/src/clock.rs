//! Cycles on the longest path: since the entry of a function, and since interrupts were blocked.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::chip::INTERRUPTS;
use crate::enables::Enables;
use crate::state::{Interrupts, State};

/// What can be blocked: the number of a [`Watch`].
pub type WatchIndex = usize;

/// An interrupt, or all of them, whose blocked stretches are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Watch {
    /// All interrupts, by the I flag.
    All,
    /// An interrupt, an index of [`INTERRUPTS`], by the I flag or its own enable bit.
    One(usize),
}

impl Watch {
    /// True if the interrupt can be blocked in a state.
    pub fn is_blocked(self, interrupts: Interrupts, enables: &Enables) -> bool {
        interrupts != Interrupts::Enabled || !self.is_enabled(enables)
    }

    /// True if the interrupt is known to be blocked in a state.
    pub fn is_surely_blocked(self, interrupts: Interrupts, enables: &Enables) -> bool {
        let is_disabled = interrupts == Interrupts::Disabled;
        match self {
            Self::All => is_disabled,
            Self::One(interrupt) => is_disabled || enables.is_masked(interrupt),
        }
    }

    /// True if its own enable bit is known to be 1.
    pub fn is_enabled(self, enables: &Enables) -> bool {
        match self {
            Self::All => true,
            Self::One(interrupt) => enables.is_unmasked(interrupt),
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::All => "interrupts",
            Self::One(interrupt) => INTERRUPTS[interrupt].name,
        }
    }
}

/// The longest blocked stretches up to a place.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Blocked {
    /// Of those that began in this function or those that it called: cycles, by the address where
    /// they began.
    pub own: BTreeMap<u32, u32>,
    /// Of those that had begun before its entry: cycles since the entry.
    pub inherited: Option<u32>,
}

/// Cycles since the program looked at a pin the last time, and did not use the SPI afterwards.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Looked {
    /// For each look that can be the last one, by its address: cycles at most.
    pub own: BTreeMap<u32, u32>,
    /// Cycles since the entry of the function on paths that neither look nor use the SPI.
    pub through: Option<u32>,
}

impl Looked {
    /// Nothing was looked at since the entry.
    pub fn at_entry() -> Self {
        Self { own: BTreeMap::new(), through: Some(0) }
    }

    /// Lets time pass.
    pub fn pass(&mut self, cycles: u32) {
        for since in self.own.values_mut().chain(&mut self.through) {
            *since = since.saturating_add(cycles);
        }
    }

    /// Looks at a pin.
    pub fn look(&mut self, at: u32) {
        *self = Self { own: BTreeMap::from([(at, 0)]), through: None };
    }

    /// Uses the SPI.
    pub fn transfer(&mut self) {
        *self = Self { own: BTreeMap::new(), through: None };
    }

    /// Goes through a function that is called.
    pub fn call(&mut self, callee: &Self) {
        match callee.through {
            Some(cycles) => self.pass(cycles),
            None => (self.own, self.through) = (BTreeMap::new(), None),
        }
        keep_longer(&mut self.own, &callee.own);
    }
}

/// The times on the longest path to a place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Clocks {
    /// Cycles since the entry of the function.
    pub total: u32,
    /// Since the last look at a pin.
    pub looked: Looked,
    /// For each watch.
    pub blocked: Vec<Blocked>,
    /// Loops on a path whose rounds are not counted.
    pub opens: u32,
    /// Of a function that does not return: for each function that it may have called in this round,
    /// also by way of others, by its address, `total` on the paths with the call.
    pub through: BTreeMap<u32, u32>,
    /// For each set of kinds of turns ([`Kinds`]) `total` on the paths of just these kinds.
    pub of_kinds: OfKinds,
}

/// A set of kinds of turns: bit n for the n-th kind of the annotations.
pub type Kinds = u32;

/// The longest time for each set of kinds of turns. Empty if the annotations name no kinds.
pub type OfKinds = Vec<(Kinds, u32)>;

/// Keeps the longer time of a set.
fn keep_longer_of(known: &mut OfKinds, kinds: Kinds, cycles: u32) {
    match known.iter_mut().find(|(other, _)| *other == kinds) {
        Some((_, longest)) => *longest = cycles.max(*longest),
        None => known.push((kinds, cycles)),
    }
}

/// Keeps the longer time for each address.
pub(crate) fn keep_longer(known: &mut BTreeMap<u32, u32>, other: &BTreeMap<u32, u32>) {
    for (at, since) in other {
        let longest = known.entry(*at).or_default();
        *longest = (*longest).max(*since);
    }
}

fn longer<T: Ord>(a: Option<T>, b: Option<T>) -> Option<T> {
    // `None` is less than any value.
    a.max(b)
}

impl Clocks {
    /// At the entry of a function.
    pub fn at_entry(watches: &[Watch], state: &State, has_kinds: bool) -> Self {
        let blocked = watches.iter().map(|watch| Blocked {
            own: BTreeMap::new(),
            inherited: watch.is_blocked(state.interrupts, &state.enables).then_some(0),
        });
        Self {
            total: 0,
            looked: Looked::at_entry(),
            blocked: blocked.collect(),
            opens: 0,
            through: BTreeMap::new(),
            of_kinds: if has_kinds { vec![(0, 0)] } else { Vec::new() },
        }
    }

    /// The paths so far, followed by those of a function that is called: of the kinds `own`, or of
    /// none, and of those of the calls in it.
    pub fn call_kinds(&mut self, own: Kinds, callee: &OfKinds) {
        let mut after = OfKinds::new();
        for (before, passed) in &self.of_kinds {
            for (kinds, more) in callee {
                keep_longer_of(&mut after, before | own | kinds, passed.saturating_add(*more));
            }
        }
        self.of_kinds = after;
    }

    /// Begins a round of an endless loop.
    pub fn begin_turn(&mut self) {
        self.total = 0;
        self.through.clear();
        if !self.of_kinds.is_empty() {
            self.of_kinds = vec![(0, 0)];
        }
    }

    /// Lets time pass.
    pub fn pass(&mut self, cycles: u32) {
        self.total = self.total.saturating_add(cycles);
        self.looked.pass(cycles);
        let of_kinds = self.of_kinds.iter_mut().map(|(_, since)| since);
        for since in self.through.values_mut().chain(of_kinds) {
            *since = since.saturating_add(cycles);
        }
        for Blocked { own, inherited } in &mut self.blocked {
            for since in own.values_mut().chain(inherited) {
                *since = since.saturating_add(cycles);
            }
        }
    }

    /// Lets a time pass that has no bound.
    pub fn never_end(&mut self) {
        self.pass(u32::MAX);
    }

    /// Enters a loop whose rounds are not counted: then a blocked stretch has no bound.
    pub fn open(&mut self) {
        self.opens = self.opens.saturating_add(1);
        self.looked.pass(u32::MAX);
        for Blocked { own, inherited } in &mut self.blocked {
            own.values_mut().chain(inherited).for_each(|since| *since = u32::MAX);
        }
    }

    /// The total, if it has a bound.
    pub fn bounded_total(&self) -> u32 {
        if self.opens > 0 { u32::MAX } else { self.total }
    }

    /// The same for the stretches that were shorter before.
    pub fn never_end_where_longer(&mut self, before: &Self) {
        for (now, before) in self.blocked.iter_mut().zip(&before.blocked) {
            for (begins, since) in &mut now.own {
                if before.own.get(begins).is_none_or(|before| *since > *before) {
                    *since = u32::MAX;
                }
            }
            if now.inherited > before.inherited {
                now.inherited = Some(u32::MAX);
            }
        }
    }

    /// The longer of two, where two paths meet.
    pub fn join(&mut self, other: &Self) {
        self.total = self.total.max(other.total);
        self.opens = self.opens.max(other.opens);
        keep_longer(&mut self.through, &other.through);
        for (kinds, cycles) in &other.of_kinds {
            keep_longer_of(&mut self.of_kinds, *kinds, *cycles);
        }
        keep_longer(&mut self.looked.own, &other.looked.own);
        self.looked.through = longer(self.looked.through, other.looked.through);
        for (mine, theirs) in self.blocked.iter_mut().zip(&other.blocked) {
            keep_longer(&mut mine.own, &theirs.own);
            mine.inherited = longer(mine.inherited, theirs.inherited);
        }
    }
}

/// A stretch during which an interrupt is blocked.
#[derive(Debug, Clone, Serialize, PartialEq, Eq)]
pub struct Stretch {
    /// The interrupt, or "interrupts".
    pub blocks: &'static str,
    /// Cycles at most, without those of handlers that interrupt it.
    pub cycles: u32,
    /// Address of the instruction that begins it.
    pub begins: u32,
    /// Address of the instruction that ends it.
    pub ends: u32,
}

/// The stretches that have ended.
#[derive(Debug, Clone, Default)]
pub struct Ended {
    /// The longest for each watch, beginning and end.
    longest: BTreeMap<(WatchIndex, u32, u32), u32>,
}

impl Ended {
    /// Notes a stretch.
    pub fn note(&mut self, watch: WatchIndex, begins: u32, ends: u32, cycles: u32) {
        let known = self.longest.entry((watch, begins, ends)).or_default();
        *known = cycles.max(*known);
    }

    /// All stretches, the longest first.
    pub fn list(&self, watches: &[Watch]) -> Vec<Stretch> {
        let mut list: Vec<Stretch> = self
            .longest
            .iter()
            .map(|((watch, begins, ends), cycles)| Stretch {
                blocks: watches[*watch].name(),
                cycles: *cycles,
                begins: *begins,
                ends: *ends,
            })
            .collect();
        list.sort_by_key(|stretch| std::cmp::Reverse(stretch.cycles));
        list
    }
}
