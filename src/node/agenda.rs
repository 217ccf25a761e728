//! Chooses what to do next. The main loop collects [`Facts`], does the one [`Turn`] that they
//! select, and begins again. No turn waits.
//!
//! Received frames come first, because their queue is short: an interrupt reads them from the
//! controller during any turn. An entry of a command is followed when no frame waits, which on a
//! full bus is so after most frames, and after [`FRAMES_BEFORE_ENTRY`] frames in any case. After
//! [`FRAMES_IN_A_ROW`] frames another turn follows, so that a flood of frames cannot stop the
//! clock, the failsafe and the node's own messages. The tick
//! never has two of these turns in a row. All other work is ordered by how rare it is, the rarest
//! first, so that frequent work cannot starve rare work.

use crate::hardware::OUTPUTS;

/// Frames in a row after which another turn follows.
pub const FRAMES_IN_A_ROW: u8 = 16;

/// Frames after which an entry of a command is followed although more wait. With one output every
/// second frame of a full bus leaves time to follow one. In a build for eight a frame takes longer:
/// after 16 frames the queue has at most six frames in the worst flood, after 12 seven, and after
/// eight it becomes full.
pub const FRAMES_BEFORE_ENTRY: u8 = if OUTPUTS == 1 { 2 } else { 16 };

/// The work that is pending.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Facts {
    /// A millisecond or more has begun.
    pub has_ticked: bool,
    /// A chore is pending: see [`Node::has_chore`](super::Node::has_chore).
    pub has_chore: bool,
    /// The controller needs a poll, or the next step of its start.
    pub is_controller_due: bool,
    /// The controller should get new filters, and now is a good moment.
    pub wants_filters: bool,
    /// The controller is on the bus.
    pub is_on_bus: bool,
    /// The controller has room for a frame.
    pub has_room: bool,
    /// A frame is ready to be handed to the controller.
    pub has_frame_to_send: bool,
    /// Messages or responses are due, or a transfer is in progress.
    pub has_to_send: bool,
}

/// What to do now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// Act on the oldest received frame, and on the transfer that it completes.
    ActOnFrame,
    /// Do the work of each millisecond.
    Tick,
    /// Follow an entry of a command.
    Follow,
    /// Do one pending chore.
    DoChore,
    /// Poll the controller.
    PollController,
    /// Set new filters in the controller.
    SetFilters,
    /// Ask the controller if it has room for a frame.
    FindRoom,
    /// Hand the ready frame to the controller.
    SendFrame,
    /// Do a step towards the next frame to send. If nothing can be sent yet: do as for
    /// [`Monitor`](Self::Monitor).
    PrepareFrame,
    /// Send a character of the log.
    Monitor,
}

/// The state between turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Agenda {
    /// Frames since the last turn besides frames and entries.
    frames_in_a_row: u8,
    /// Frames since an entry waits, or since the last one was followed.
    frames_before_entry: u8,
    /// The last turn besides frames and entries was the tick.
    was_tick: bool,
    /// The controller had no room. The node asks again after the next tick.
    is_full: bool,
}

impl Agenda {
    /// No turn taken yet.
    pub const fn new() -> Self {
        Self { frames_in_a_row: 0, frames_before_entry: 0, was_tick: false, is_full: false }
    }

    /// Chooses the next turn. `has_frame`: a received frame waits. `has_entry`: an
    /// entry of a command waits to be followed. Calls `facts` only if these do not decide.
    #[inline(always)]
    pub fn next(
        &mut self,
        has_frame: bool,
        has_entry: bool,
        facts: impl FnOnce() -> Facts,
    ) -> Turn {
        if has_entry && (!has_frame || self.frames_before_entry >= FRAMES_BEFORE_ENTRY) {
            self.frames_before_entry = 0;
            return Turn::Follow;
        }
        if has_frame && self.frames_in_a_row < FRAMES_IN_A_ROW {
            self.frames_in_a_row += 1;
            self.frames_before_entry = if has_entry { self.frames_before_entry + 1 } else { 0 };
            return Turn::ActOnFrame;
        }
        self.frames_in_a_row = 0;
        let facts = facts();
        // In a flood a millisecond passes before each turn that is left for the rest.
        self.was_tick = facts.has_ticked && !self.was_tick;
        if self.was_tick {
            self.is_full = false;
            return Turn::Tick;
        }
        if facts.has_chore {
            return Turn::DoChore;
        }
        if facts.is_controller_due {
            return Turn::PollController;
        }
        if facts.wants_filters {
            return Turn::SetFilters;
        }
        if facts.is_on_bus {
            if facts.has_frame_to_send {
                if facts.has_room {
                    self.is_full = false;
                    return Turn::SendFrame;
                }
                if !self.is_full {
                    // Assume no room until the controller reports some.
                    self.is_full = true;
                    return Turn::FindRoom;
                }
            } else if facts.has_to_send {
                return Turn::PrepareFrame;
            }
        }
        Turn::Monitor
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The turns for constant facts, one after the other.
    fn turns(has_frame: bool, facts: Facts) -> impl Iterator<Item = Turn> {
        let mut agenda = Agenda::new();
        std::iter::from_fn(move || Some(agenda.next(has_frame, false, || facts)))
    }

    fn first(facts: Facts) -> Turn {
        turns(false, facts).next().unwrap()
    }

    const EVERYTHING: Facts = Facts {
        has_ticked: true,
        has_chore: true,
        is_controller_due: true,
        wants_filters: true,
        is_on_bus: true,
        has_room: true,
        has_frame_to_send: true,
        has_to_send: true,
    };

    #[test]
    fn frames_come_before_everything_else_but_not_for_ever() {
        let turns: Vec<Turn> =
            turns(true, EVERYTHING).take(2 * FRAMES_IN_A_ROW as usize + 1).collect();
        let frames = [Turn::ActOnFrame; FRAMES_IN_A_ROW as usize];
        assert_eq!(turns[..frames.len()], frames);
        assert_eq!(turns[frames.len()], Turn::Tick);
        assert_eq!(turns[frames.len() + 1..], frames);
    }

    /// A millisecond passes with the frames between two of its other turns.
    #[test]
    fn in_a_flood_of_frames_there_is_time_for_more_than_the_tick() {
        let facts =
            Facts { has_ticked: true, is_on_bus: true, has_to_send: true, ..Facts::default() };
        let others: Vec<Turn> =
            turns(true, facts).filter(|&turn| turn != Turn::ActOnFrame).take(4).collect();
        assert_eq!(others, [Turn::Tick, Turn::PrepareFrame, Turn::Tick, Turn::PrepareFrame]);
    }

    #[test]
    fn in_a_flood_of_frames_every_entry_has_its_turn() {
        for entries in [1, 8] {
            let most = entries * u16::from(FRAMES_BEFORE_ENTRY);
            let mut agenda = Agenda::new();
            for waiting in 0..100 {
                // At any point of the flood.
                for _ in 0..waiting {
                    agenda.next(true, false, || EVERYTHING);
                }
                let (mut entries, mut taken) = (entries, 0);
                while entries != 0 {
                    match agenda.next(true, true, || EVERYTHING) {
                        Turn::ActOnFrame => taken += 1,
                        Turn::Follow => entries -= 1,
                        _ => {}
                    }
                }
                assert!(taken <= most, "{taken} frames");
            }
        }
    }

    #[test]
    fn in_a_flood_of_frames_and_entries_other_work_has_its_turn_after_16_frames() {
        let mut agenda = Agenda::new();
        let mut frames = 0;
        for _ in 0..200 {
            match agenda.next(true, true, || EVERYTHING) {
                Turn::ActOnFrame => frames += 1,
                Turn::Follow => {}
                _ => assert_eq!(core::mem::take(&mut frames), FRAMES_IN_A_ROW),
            }
        }
    }

    #[test]
    fn without_a_frame_the_rarest_comes_first() {
        let mut facts = EVERYTHING;
        let mut order = vec![];
        loop {
            let turn = first(facts);
            order.push(turn);
            match turn {
                Turn::Tick => facts.has_ticked = false,
                Turn::DoChore => facts.has_chore = false,
                Turn::PollController => facts.is_controller_due = false,
                Turn::SetFilters => facts.wants_filters = false,
                Turn::SendFrame => facts.has_frame_to_send = false,
                Turn::PrepareFrame => facts.has_to_send = false,
                Turn::Monitor => break,
                turn => panic!("{turn:?}"),
            }
        }
        use Turn::*;
        assert_eq!(
            order,
            [Tick, DoChore, PollController, SetFilters, SendFrame, PrepareFrame, Monitor]
        );
    }

    #[test]
    fn a_controller_without_room_is_asked_once_a_millisecond() {
        let facts = Facts { is_on_bus: true, has_frame_to_send: true, ..Facts::default() };
        let mut agenda = Agenda::new();
        for _ in 0..3 {
            assert_eq!(agenda.next(false, false, || facts), Turn::FindRoom);
            for _ in 0..5 {
                assert_eq!(agenda.next(false, false, || facts), Turn::Monitor);
            }
            assert_eq!(
                agenda.next(false, false, || Facts { has_ticked: true, ..facts }),
                Turn::Tick
            );
        }
    }

    #[test]
    fn as_many_frames_go_in_a_millisecond_as_there_is_room_for() {
        let facts = Facts { is_on_bus: true, has_frame_to_send: true, ..Facts::default() };
        let mut agenda = Agenda::new();
        for _ in 0..3 {
            assert_eq!(agenda.next(false, false, || facts), Turn::FindRoom);
            assert_eq!(
                agenda.next(false, false, || Facts { has_room: true, ..facts }),
                Turn::SendFrame
            );
        }
        assert_eq!(agenda.next(false, false, || facts), Turn::FindRoom);
        assert_eq!(agenda.next(false, false, || facts), Turn::Monitor);
    }

    #[test]
    fn nothing_is_sent_while_the_controller_is_not_on_the_bus() {
        let facts = Facts {
            has_frame_to_send: true,
            has_to_send: true,
            has_room: true,
            ..Facts::default()
        };
        assert_eq!(first(facts), Turn::Monitor);
    }
}
