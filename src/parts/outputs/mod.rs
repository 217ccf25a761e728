//! The outputs: which commands they follow, and what they do when commands stop.
//!
//! A command is followed in two steps. [`Outputs::act_on_array_command`] and its like check a
//! command when it is received, and keep the newest valid entry for each output, with its sender.
//! [`Outputs::follow_next`] follows one of the entries, in a turn of its own: to compute a pulse
//! takes up to 100 us, and frames must not wait for that. An entry that a newer one replaces first
//! is superseded. What may have changed in between, such as arming, is checked again.
//!
//! Outputs are numbered from 0 in the program, and from 1 in the names of parameters. A build has
//! one output or eight ([`OUTPUTS`]), and the code is the same.

mod command;
mod commands;
mod failsafe;
mod kind;
mod kinds;
mod output;
mod pulses;
pub mod travel;

#[cfg_attr(not(feature = "outputs"), path = "absent/doubts.rs")]
mod doubts;

#[cfg_attr(not(feature = "relay"), path = "absent/hardpoint.rs")]
mod hardpoint;

#[cfg_attr(not(feature = "outputs"), path = "absent/raw_command.rs")]
mod raw_command;

use dronecan_wire::Slot;

use crate::hardware::OUTPUTS;
use crate::monitor::Line;
use crate::parts::arming::Arming;
use crate::parts::safety::Safety;
use crate::parts::superseded::Superseded;
use crate::tables::parameters::{OutputParameter, Parameters};
use doubts::Doubts;
use kinds::Kinds;
use output::{NO_SLOT, Output};
pub use pulses::Pulses;
use travel::Ticks;

/// What a turn has followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Followed {
    /// The line to log, which is a refusal if the entry is not followed; [`Line::NONE`] if there is
    /// nothing to log.
    pub line: Line,
    /// The sender of the command, if this is its entry for the lowest output.
    pub commander: u8,
    /// The output followed another node's command a moment ago. Only of a build that knows the
    /// commander of each output.
    pub is_second: bool,
}

/// The parameters of an output are in force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Applied {
    /// It is the last output.
    pub is_last: bool,
    /// Its bit if it has got another type, ID or slot: what lists have had for it so far is not for
    /// it any more.
    pub moved: u8,
}

/// For a quick search, outputs are listed by the lower four bits of their ID. A single output is
/// compared directly.
const LISTED: usize = if OUTPUTS > 1 { 16 } else { 0 };

/// The outputs.
pub struct Outputs {
    each: [Output; OUTPUTS],
    /// For each commander that an output ever had, the bit with the number of its node ID modulo 8:
    /// the status of most other nodes is refused without a look at each output.
    commander_bits: u8,
    /// OUT_COUNT at the start.
    used: u8,
    /// Outputs whose entry waits to be followed: bit n is output n.
    waiting: u8,
    /// The lowest output of each command: bit n is output n. When it is followed, the command is
    /// counted and logged.
    lowest: u8,
    /// Outputs whose last followed command was logged in this second: bit n is output n.
    logged: u8,
    /// Seconds that the outputs are in use since the last followed command. For updates.
    recent_s: u8,
    /// The output that has followed an entry last.
    last: u8,
    /// Outputs in failsafe: bit n is output n.
    failing: u8,
    /// `failing` when it was reported last, and at the beginning of the last round of `tick`.
    reported: u8,
    seen: u8,
    /// Motors that may be in failsafe.
    doubts: Doubts,
    /// The output of the next actuator.Status.
    telemetry: u8,
    /// The output whose parameters are applied next.
    updated: u8,
    /// The output whose commands and failsafe are looked at next.
    ticked: u8,
    /// A pulse changed without a command.
    is_stale: bool,
    /// True if an ArrayCommand came after the last followed command.
    hears_commands: bool,
    /// For each value of the lower four bits of an ID, an output that has or had such an ID, from
    /// 1. 0 if there is none.
    listed: [u8; LISTED],
    /// Which outputs are of which kind.
    kinds: Kinds,
    /// If the vehicle is armed.
    pub arming: Arming,
    /// If the safety switch is on.
    pub safety: Safety,
    /// How many commands were replaced before they were followed.
    pub superseded: Superseded,
}

impl Outputs {
    /// Outputs that give no pulse yet.
    pub const fn new() -> Self {
        Self {
            each: [Output::NONE; OUTPUTS],
            commander_bits: 0,
            used: 0,
            waiting: 0,
            lowest: 0,
            logged: 0,
            recent_s: 0,
            last: 0,
            failing: 0,
            reported: 0,
            seen: 0,
            doubts: Doubts::new(),
            telemetry: 0,
            updated: 0,
            ticked: 0,
            is_stale: false,
            hears_commands: false,
            listed: [0; LISTED],
            kinds: Kinds::new(),
            arming: Arming::new(),
            safety: Safety::new(),
            superseded: Superseded::new(),
        }
    }

    /// Uses the first outputs, as many as OUT_COUNT says.
    pub fn start(&mut self, parameters: &Parameters) {
        self.used = parameters.outputs();
    }

    /// The number of outputs in use.
    pub fn used(&self) -> usize {
        if OUTPUTS == 1 { 1 } else { usize::from(self.used).min(OUTPUTS) }
    }

    /// Applies the parameters of all outputs, also to the pulses.
    pub fn update(&mut self, parameters: &Parameters) {
        self.begin_update();
        while !self.update_next(parameters).is_last {}
    }

    /// Begins to apply the parameters: those of the first output are next.
    pub fn begin_update(&mut self) {
        if OUTPUTS > 1 {
            self.updated = 0;
        }
    }

    /// Applies the parameters of the next output. An output takes up to 60 us, so each has a turn
    /// of its own.
    #[inline(never)]
    pub fn update_next(&mut self, parameters: &Parameters) -> Applied {
        let n = if OUTPUTS == 1 { 0 } else { place(self.updated.into()) };
        let moved = self.update_output(n, parameters);
        if OUTPUTS > 1 {
            self.updated = n as u8 + 1;
        }
        self.touch();
        Applied { is_last: n + 1 == self.used(), moved }
    }

    /// Returns what [`Applied::moved`] is.
    fn update_output(&mut self, n: usize, parameters: &Parameters) -> u8 {
        let id = parameters.of(n, OutputParameter::Id) as u8;
        let is_another_kind = self.kinds.update(n, bit(n), parameters);
        let output = &mut self.each[place(n)];
        // Pulse and entry are for the old ID and kind. (A single servo keeps its pulse.)
        let is_another = output.id != id || is_another_kind;
        if OUTPUTS > 1 && is_another {
            output.end();
        }
        output.update(n, parameters);
        output.id = id;
        if is_another {
            self.waiting &= !bit(n);
        }
        if OUTPUTS == 1 {
            return 0;
        }
        let mut moved = 0;
        if is_another {
            self.expect_no_command(bit(n));
            moved = bit(n) | self.leave_slot(n);
        }
        let Slot { at, .. } = self.each[place(n)].slot;
        self.update_slot(n, self.kinds.is_actuator(bit(n)));
        if at != self.each[place(n)].slot.at { moved | bit(n) } else { moved }
    }

    /// Takes its slot from an output. Those that shared it go to the slot of the first of them, or
    /// they would follow the entries for the new ID. Returns them, a bit each.
    fn leave_slot(&mut self, n: usize) -> u8 {
        let left = core::mem::replace(&mut self.each[place(n)].slot, NO_SLOT);
        let others = left.bits & !bit(n);
        let mut heir = NO_SLOT;
        let mut m = 0;
        for output in &mut self.each {
            let own = Slot::new(m);
            output.slot.bits &= !bit(n);
            if others & own.bits != 0 {
                if heir == NO_SLOT {
                    heir = Slot { at: own.at, bits: others };
                    output.slot = heir;
                }
                output.slot.at = heir.at;
            }
            m += 1;
        }
        others
    }

    /// Finds the slot of an output, which `has_slot` if it follows ArrayCommands. The first of the
    /// outputs with the same ID has the slot, with the bits of all of them.
    fn update_slot(&mut self, n: usize, has_slot: bool) {
        let own = Slot::new(n as u8);
        if !has_slot {
            return;
        }
        let id = self.each[place(n)].id;
        if let Some(first) = self.search(id, n) {
            let first = &mut self.each[place(first)];
            first.slot.bits |= own.bits;
            let at = first.slot.at;
            self.each[place(n)].slot = Slot { at, ..own };
            return;
        }
        let slot = &mut self.each[place(n)].slot;
        *slot = Slot { at: own.at, bits: slot.bits | own.bits };
        if let Some(listed) = self.listed.get_mut(usize::from(id % 16)) {
            *listed = n as u8 + 1;
        }
    }

    /// The slot in which the receiver keeps an entry with this ID. It is looked up in 20 cycles,
    /// unless IDs differ by 16.
    #[inline(always)]
    pub fn slot_of(&self, id: u8) -> Option<Slot> {
        if OUTPUTS == 1 {
            return (self.each[0].id == id).then_some(Slot::new(0));
        }
        let listed = self.listed.get(usize::from(id % 16))?;
        let output = &self.each[place(listed.checked_sub(1)?.into())];
        if output.id == id && output.slot.bits != 0 {
            return Some(output.slot);
        }
        self.search(id, OUTPUTS).map(|first| self.each[place(first)].slot)
    }

    /// The first of `count` outputs that has this ID and a slot.
    #[inline(never)]
    fn search(&self, id: u8, count: usize) -> Option<usize> {
        let mut outputs = self.each.iter().take(count);
        outputs.position(|output| output.id == id && output.slot.bits != 0)
    }

    /// Width of an output's pulse; 0 for none.
    pub fn pulse(&self, output: usize) -> Ticks {
        self.each[place(output)].pulse()
    }

    /// The position that an output's pulse asks for, in radians as a float16; NaN without a pulse.
    pub fn position(&self, output: usize) -> u16 {
        self.each[place(output)].position()
    }

    /// Gives the pulses to the outputs of the board.
    pub fn show(&mut self, board: &mut impl Pulses) {
        self.kinds.show(board);
        // A single output ends its pulses only between two of them, so it gets its width again
        // until it does.
        if OUTPUTS == 1 || core::mem::take(&mut self.is_stale) || self.used() == 1 {
            for output in 0..self.used() {
                board.set(output, self.each[place(output)].pulse());
            }
        }
    }

    /// A pulse changed without a command. (The board gets that of a single output in any case.)
    fn touch(&mut self) {
        if OUTPUTS > 1 {
            self.is_stale = true;
        }
    }
}

/// The bit of an output in a set of outputs, or of a node ID modulo 8. The AVR shifts by one place
/// at a time, so this takes half as long as a shift by a variable.
const fn bit(output: usize) -> u8 {
    let mut bit = 1u8;
    if output & 1 != 0 {
        bit <<= 1;
    }
    if output & 2 != 0 {
        bit <<= 2;
    }
    if output & 4 != 0 {
        bit = bit.rotate_left(4);
    }
    bit
}

/// The same reference, of which the compiler does not know that it is to a static. Otherwise it
/// adds the address of the static to the offset of a field at each access, and that takes three
/// instructions more. (A single output has no offset.)
fn by_pointer<T: ?Sized>(outputs: &mut T) -> &mut T {
    if OUTPUTS == 1 { outputs } else { core::hint::black_box(outputs) }
}

/// The place of an output in a table. Outputs beyond the last do not occur, and the compiler cannot
/// know that.
#[allow(clippy::modulo_one, reason = "a build may have one output")]
fn place(output: usize) -> usize {
    output % OUTPUTS
}

#[cfg(all(test, feature = "monitor", not(feature = "draft")))]
mod tests;
