//! Why the firmware's queue of received frames became full: the turns of the main loop before that.

use bench::board::Board;

use super::super::profile::{Names, Profile, Share};
use super::setup::Setup;

/// Occasions that are explained; the others are alike.
const MOST: usize = 3;
/// Shares of a turn that are named.
const SHARES: usize = 4;

/// Looks for the turns in which the queue becomes full.
pub struct Fills {
    profile: Profile,
    names: Names,
    /// Number of turns when the queue became full, until the turn ends.
    full_in: Option<u64>,
    is_full: bool,
    /// For each occasion its turns, oldest first.
    pub found: Vec<String>,
}

impl Fills {
    /// Starts to look at each instruction of a running program.
    pub fn begin(setup: Setup, board: &mut Board) -> Fills {
        Fills {
            profile: Profile::begin(board.avr_mut()),
            names: Names::of(&setup.elf()),
            full_in: None,
            is_full: false,
            found: Vec::new(),
        }
    }

    /// The queue is full now, or is not.
    pub fn look(&mut self, is_full: bool) {
        let began = is_full && !std::mem::replace(&mut self.is_full, is_full);
        let (turns, ..) = self.profile.turns();
        if self.full_in.is_some_and(|turn| turn < turns) {
            self.full_in = None;
            let turns = self.profile.recent(&self.names);
            self.found.push(turns.iter().map(|turn| text(turn)).collect::<Vec<_>>().join("\n"));
        }
        if began && self.full_in.is_none() && self.found.len() < MOST {
            self.full_in = Some(turns);
        }
    }
}

/// The length of a turn in cycles, and its longest shares.
fn text(turn: &[Share]) -> String {
    let cycles: u64 = turn.iter().map(|share| share.cycles).sum();
    let share = |share: &Share| format!("{} {}", share.name, share.cycles);
    let longest: Vec<String> = turn.iter().take(SHARES).map(share).collect();
    format!("    {cycles:5}  {}", longest.join(", "))
}
