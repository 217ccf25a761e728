//! A node with several outputs: which are in use, which commands are for them, and which of them
//! are in failsafe.

use super::super::actuator::Actuator;
use super::super::agenda::Entry;
use super::super::parameters::{OutputParameter, Parameters};
use super::super::servo::{CommandType, Output};
use super::super::wire::{KEPT, Transfer};
use super::{Actuators, place};
use crate::hardware::OUTPUTS;
use crate::monitor::{Event, Line};
use dronecan_wire::{Slot, esc};

/// What the outputs have together.
pub struct Several {
    /// Outputs in use.
    used: u8,
    /// OUTn_ID of each output.
    ids: [u8; OUTPUTS],
    /// Outputs in use that are motors: bit n - 1 is output n.
    motors: u8,
    /// Outputs in failsafe: bit n - 1 is output n.
    failing: u8,
    /// `failing` when it was logged and published last.
    published: u8,
    /// The output of the next actuator.Status.
    #[cfg(feature = "standard")]
    reported: u8,
    /// No entry of the last command was followed yet.
    is_new: bool,
    /// The last frame brought the entry that waits.
    is_fresh: bool,
    /// The slots of the last commands, the length of an entry, and the last command's source and
    /// transfer ID.
    bytes: [u8; KEPT],
    entry_len: u8,
    source: u8,
    transfer: u8,
    /// Outputs that have not followed theirs yet, a bit each, and the output to look at next.
    waiting: u8,
    next: u8,
    /// For each output the slot in which the receiver keeps its entry. Outputs with the same ID
    /// have the same.
    slots: [Slot; OUTPUTS],
    /// For each value of the lower four bits of an ID, an output in use with such an ID, from 1. 0
    /// if there is none.
    by_lower_bits: [u8; 16],
    /// The output whose commands and failsafe are looked at next.
    ticked: u8,
    /// A pulse changed without a command.
    is_stale: bool,
}

impl Several {
    /// No output in use yet.
    pub const fn new() -> Self {
        Self {
            used: 0,
            ids: [0; OUTPUTS],
            motors: 0,
            failing: 0,
            published: 0,
            #[cfg(feature = "standard")]
            reported: 0,
            is_new: false,
            is_fresh: false,
            bytes: [0; KEPT],
            entry_len: 0,
            source: 0,
            transfer: 0,
            waiting: 0,
            next: 0,
            slots: [NO_SLOT; OUTPUTS],
            by_lower_bits: [0; 16],
            ticked: 0,
            is_stale: false,
        }
    }

    /// Takes over the IDs of the outputs.
    pub fn update(&mut self, parameters: &Parameters) {
        self.by_lower_bits = [0; 16];
        self.motors = 0;
        let before = core::mem::replace(&mut self.slots, [NO_SLOT; OUTPUTS]);
        for (output, before) in before.into_iter().enumerate().take(self.used()) {
            let id = parameters.of(output, OutputParameter::Id) as u8;
            self.ids[output] = id;
            if parameters.of(output, OutputParameter::Type) as u8 == MOTOR {
                self.motors |= 1 << output;
            } else {
                self.slots[output] = self.search(id).unwrap_or(Slot::new(output as u8));
                self.by_lower_bits[usize::from(id % 16)] = output as u8 + 1;
            }
            // What waits is in the slot as it was. The other one may have an old entry.
            if self.slots[output] != before {
                self.waiting &= !(1 << output);
            }
        }
        self.is_stale = true;
    }

    /// The slot for an ID, if an output in use has it. It is looked up in 20 cycles, unless IDs
    /// differ by 16.
    #[inline(always)]
    fn slot_of(&self, id: u8) -> Option<Slot> {
        let output =
            usize::from(self.by_lower_bits[usize::from(id % 16)].checked_sub(1)?) % OUTPUTS;
        if self.ids[output] == id { Some(self.slots[output]) } else { self.search(id) }
    }

    #[inline(never)]
    fn search(&self, id: u8) -> Option<Slot> {
        let output = (0..self.used())
            .find(|&output| self.ids[output] == id && self.slots[output] != NO_SLOT)?;
        Some(self.slots[output])
    }

    /// True if the output is a motor.
    #[inline(always)]
    pub fn is_motor(&self, output: usize) -> bool {
        self.motors & 1 << output != 0
    }

    /// Stops an output that is a motor. Returns true if it is one.
    #[inline(always)]
    pub fn stop_motor(&self, output: usize, actuator: &mut Actuator) -> bool {
        let is_motor = self.is_motor(output);
        if is_motor {
            actuator.stop_motor();
        }
        is_motor
    }

    /// Keeps the entries of a command, and those of an earlier one that wait for other outputs.
    #[inline(always)]
    fn keep(&mut self, command: &Transfer, entry_len: u8) {
        self.entry_len = entry_len;
        let (mut slots, mut left) = (command.slots(), Slot::LEN);
        for (to, from) in self.bytes.iter_mut().zip(command.bytes()) {
            if slots & 1 != 0 {
                *to = *from;
            }
            left -= 1;
            if left == 0 {
                left = Slot::LEN;
                slots >>= 1;
                if slots == 0 {
                    return;
                }
            }
        }
    }

    /// Has these outputs, a bit each, follow a command later.
    #[inline(always)]
    fn wait(&mut self, outputs: u8, command: &Transfer) -> Line {
        self.waiting |= outputs;
        self.source = command.source;
        self.transfer = command.transfer_id();
        self.is_new = true;
        self.is_fresh = true;
        Line::CommandWaits
    }

    /// True if the pulses are to be given to the board, which they are after each change.
    #[inline(always)]
    pub fn take_stale(&mut self) -> bool {
        // A single output ends its pulses only between two of them, so it gets its width again
        // until it does.
        core::mem::take(&mut self.is_stale) || self.used == 1
    }

    /// The outputs to look at in this millisecond: one after the other.
    #[inline(always)]
    pub fn tick(&mut self) -> core::ops::Range<usize> {
        let output = self.ticked;
        self.ticked = if output + 1 < self.used { output + 1 } else { 0 };
        usize::from(output) % OUTPUTS..usize::from(output) % OUTPUTS + 1
    }

    /// The outputs in use.
    #[inline(always)]
    pub fn used(&self) -> usize {
        usize::from(self.used).min(OUTPUTS)
    }

    /// Notes that an output follows a command.
    #[inline(always)]
    pub fn follow(&mut self, output: usize) {
        self.failing &= !(1 << output);
        // An older command must not replace this one.
        self.waiting &= !(1 << output);
    }

    /// Notes that a pulse changed without a command.
    #[inline(always)]
    pub fn touch(&mut self) {
        self.is_stale = true;
    }

    /// True if the output is in failsafe.
    #[cfg(feature = "safety")]
    pub fn is_failing(&self, output: usize, is_failsafe: bool) -> bool {
        if self.used == 1 { is_failsafe } else { self.failing & 1 << output != 0 }
    }

    /// Notes that the failsafe of an output begins.
    #[inline(always)]
    pub fn fail(&mut self, output: usize) {
        self.failing |= 1 << output;
    }
}

/// OUTn_TYPE: the output follows esc.RawCommand, and not ArrayCommand.
const MOTOR: u8 = 1;

/// The slot of a motor, which needs no entry of an ArrayCommand.
const NO_SLOT: Slot = Slot { at: 0, bit: 0 };

/// Command type and value of the entry in a slot.
#[inline(always)]
fn entry(bytes: &[u8; KEPT], slot: Slot, entry_len: u8) -> Option<(u8, u16)> {
    let byte = |n| bytes.get(usize::from(slot.at) + n).copied();
    let (unit, low, high) = match entry_len {
        // An entry of the draft has no command type.
        3 => (CommandType::Unitless as u8, byte(1)?, byte(2)?),
        _ => (byte(1)?, byte(2)?, byte(3)?),
    };
    Some((unit, u16::from_le_bytes([low, high])))
}

impl Actuators {
    /// Uses the first outputs, so many as OUT_COUNT said at the start.
    pub fn start(&mut self, parameters: &Parameters) {
        self.several.used = parameters.outputs() as u8;
    }

    /// The slot of the receiver for an entry with this ID.
    #[inline(always)]
    pub fn slot_of(&self, id: u8) -> Option<Slot> {
        self.several.slot_of(id)
    }

    /// Takes an ArrayCommand, whose entries have `entry_len` bytes: those for the outputs in use.
    /// An output follows a single entry at once, unless more frames wait (`has_backlog`). Other
    /// entries are followed later, one at a time, by [`follow_next`](Self::follow_next), because
    /// each takes up to 100 us. So also on a full bus no frame is lost, and the newest commands
    /// are followed.
    #[inline(always)]
    #[allow(clippy::too_many_arguments, reason = "it is inlined")]
    pub fn take_array_command(
        &mut self,
        command: &Transfer,
        entry_len: u8,
        has_backlog: impl FnOnce() -> bool,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        board: &mut impl Output,
    ) -> Line {
        self.hears_commands = true;
        if command.slots() == 0 {
            return Line::CommandElsewhere;
        }
        if let Some(line) = self.blocked(parameters) {
            return line;
        }
        let (mut bit, mut waiting, mut output) = (1u8, 0, 0);
        for (n, slot) in self.several.slots.iter().take(self.used()).enumerate() {
            if command.slots() & slot.bit != 0 {
                waiting |= bit;
                output = n % OUTPUTS;
            }
            bit <<= 1;
        }
        // A sender's single entry never replaces the entry of another sender that waits: what is
        // rejected could keep what is not from being followed.
        let is_others = self.several.waiting != 0 && self.several.source != command.source;
        if waiting.is_power_of_two() && (is_others || !has_backlog()) {
            let entry = entry(command.bytes(), self.several.slots[output], entry_len);
            let line = self.follow_entry(entry, output, event, now_ms, board);
            board.commit();
            return line;
        }
        self.several.keep(command, entry_len);
        self.several.wait(waiting, command)
    }

    /// Notes that a frame comes.
    #[inline(always)]
    pub fn note_frame(&mut self) {
        self.several.is_fresh = false;
    }

    /// If an entry of a command waits.
    #[inline(always)]
    pub fn entry(&self) -> Entry {
        if self.several.waiting == 0 {
            Entry::None
        } else if self.several.is_fresh || self.several.used != 1 {
            Entry::Waits
        } else {
            Entry::IsOverdue
        }
    }

    /// Follows the next entry that waits. After those of all outputs it has the board begin their
    /// pulses in the same period. Returns the line to log and fills in the event for it;
    /// [`Line::CommandWaits`] if there is nothing to log, because another entry of the same command
    /// was logged.
    #[inline(never)]
    pub fn follow_next(
        &mut self,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        board: &mut impl Output,
    ) -> Line {
        let mut line = Line::CommandWaits;
        // From one output to the next, also if a newer command comes meanwhile. So each has its
        // turn.
        let mut left = self.several.waiting >> self.several.next;
        if left != 0 {
            let mut output = self.several.next;
            while left & 1 == 0 {
                output += 1;
                left >>= 1;
            }
            left >>= 1;
            self.several.next = output + 1;
            let is_only = self.several.waiting == 1 << output;
            let output = usize::from(output) % OUTPUTS;
            event.set_source(self.several.source);
            event.set_transfer(self.several.transfer);
            self.several.waiting &= !(1 << output);
            let is_motor = self.several.is_motor(output);
            line = if is_motor {
                self.follow_throttle(output, event, now_ms, parameters, board)
            } else if let Some(line) = self.blocked(parameters) {
                line
            } else {
                let (slot, entry_len) = (self.several.slots[output], self.several.entry_len);
                self.follow_entry(
                    entry(&self.several.bytes, slot, entry_len),
                    output,
                    event,
                    now_ms,
                    board,
                )
            };
            if !line.is_refusal() {
                if !core::mem::take(&mut self.several.is_new) {
                    line = Line::CommandWaits;
                } else if !is_only {
                    line = if is_motor { Line::RawCommandMany } else { Line::CommandMany };
                }
            }
        }
        if left == 0 {
            self.several.next = 0;
            board.commit();
        }
        line
    }

    /// Follows the entry for an output. The caller has found that nothing [blocks](Self::blocked)
    /// it.
    #[inline(never)]
    fn follow_entry(
        &mut self,
        entry: Option<(u8, u16)>,
        output: usize,
        event: &mut Event,
        now_ms: u16,
        board: &mut impl Output,
    ) -> Line {
        event.set_code(self.several.ids[output]);
        let Some((unit, value)) = entry else { return Line::RefusedLength };
        match self.each[place(output)].pulse_of_command(unit, value, event) {
            Err(line) => line,
            Ok((pulse, line)) => {
                self.follow(output, pulse, event, now_ms, board);
                line
            }
        }
    }

    /// Takes an esc.RawCommand: the commands for the outputs that are motors. They are followed
    /// later, as the entries of an ArrayCommand for several outputs.
    #[inline(never)]
    pub fn take_raw_command(&mut self, command: &Transfer, parameters: &Parameters) -> Line {
        let Several { motors, ids, bytes, .. } = &mut self.several;
        let (mut found, mut bit) = (0, 1u8);
        let (entries, _) = bytes.as_chunks_mut::<{ Slot::LEN as usize }>();
        for (entry, id) in entries.iter_mut().zip(ids) {
            if *motors & bit != 0
                && let Some(throttle) = esc::raw_command(command.payload(), *id)
            {
                [entry[0], entry[1]] = throttle.to_le_bytes();
                found |= bit;
            }
            bit <<= 1;
        }
        if found == 0 {
            return Line::RawCommandElsewhere;
        }
        if let Some(line) = self.blocked_motor(parameters) {
            return line;
        }
        self.several.wait(found, command)
    }

    /// The line for the reason to reject all commands for motors, if there is one. Motors need an
    /// armed vehicle, whatever ARM_REQ says.
    fn blocked_motor(&self, parameters: &Parameters) -> Option<Line> {
        if self.armed_s == 0 { Some(Line::RefusedDisarmed) } else { self.blocked(parameters) }
    }

    /// Follows the command that waits for a motor.
    #[inline(never)]
    fn follow_throttle(
        &mut self,
        output: usize,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        board: &mut impl Output,
    ) -> Line {
        if let Some(line) = self.blocked_motor(parameters) {
            return line;
        }
        let at = usize::from(Slot::new(output as u8).at);
        let byte = |n| self.several.bytes.get(at + n).copied().unwrap_or_default();
        let throttle = i16::from_le_bytes([byte(0), byte(1)]);
        event.set_code(self.several.ids[output]);
        event.a = throttle as u16;
        self.follow(
            output,
            self.each[place(output)].pulse_of_throttle(throttle),
            event,
            now_ms,
            board,
        );
        Line::RawCommand
    }

    /// True if an output in use is a motor.
    #[inline(always)]
    pub fn has_motors(&self) -> bool {
        self.several.motors != 0
    }

    /// Node ID of the sender of the command that waits, or was followed last.
    pub fn commander(&self) -> u8 {
        self.several.source
    }

    /// True if no output is in failsafe.
    pub fn has_recovered(&self) -> bool {
        self.several.failing == 0
    }

    /// Outputs in failsafe: bit n - 1 is output n.
    pub fn failing(&self) -> u8 {
        self.several.failing
    }

    /// Ends the failsafe of all outputs: commands are missing for a reason.
    #[cfg(feature = "safety")]
    pub fn clear_failing(&mut self) {
        self.several.failing = 0;
    }

    /// True if several outputs are in use and one is in failsafe. Of a single output the status
    /// says all.
    pub fn publishes_failsafe(&self) -> bool {
        self.several.used > 1 && self.several.failing != 0
    }

    /// An output whose failsafe has begun (true) or ended (false) since it was last logged, if
    /// several outputs are in use.
    pub fn take_change(&mut self) -> Option<(usize, bool)> {
        let changed = self.several.failing ^ self.several.published;
        if changed == 0 || self.several.used == 1 {
            return None;
        }
        let output = changed.trailing_zeros() as usize;
        self.several.published ^= 1 << output;
        Some((output, self.several.failing & 1 << output != 0))
    }

    /// The output of the next actuator.Status: the servos take turns. A motor has an index and no
    /// actuator ID, so it has none.
    #[cfg(feature = "standard")]
    #[inline(always)]
    pub fn next_to_report(&mut self) -> Option<usize> {
        for _ in 0..self.used() {
            let output = usize::from(self.several.reported) % OUTPUTS;
            self.several.reported = if output + 1 < self.used() { output as u8 + 1 } else { 0 };
            if !self.several.is_motor(output) {
                return Some(output);
            }
        }
        None
    }
}
