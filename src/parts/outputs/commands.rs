//! Commands: which outputs one is for, and how the outputs follow.

use dronecan_wire::Slot;

use super::command::Command;
use super::output::Output;
use super::pulses::Pulses;
use super::travel::CommandType;
use super::{Followed, Outputs, by_pointer, place};
use crate::hardware::OUTPUTS;
use crate::monitor::{Event, Line};
use crate::parts::{arming, update};
use crate::tables::parameters::Parameters;
use crate::tables::wire::Transfer;

/// An output has two commanders if another node commands it within this time, in milliseconds.
const SECOND_MS: u16 = 2000;

/// An output is in use for this time after a followed command, in seconds: at least one less.
const RECENT_S: u8 = 3;

impl Outputs {
    /// True if no output follows commands, and no ArrayCommand came after the last followed one,
    /// not even one for other actuators.
    pub fn hears_nothing(&self) -> bool {
        let follows = OUTPUTS > 1 && self.each.iter().any(Output::is_following);
        !self.hears_commands && !follows
    }

    /// Takes note of an ArrayCommand: keeps its entries for the outputs in use. Returns the line
    /// for the reason of a refusal; [`Line::NONE`] if there is none.
    #[inline(always)]
    pub fn act_on_array_command(&mut self, command: &Transfer, parameters: &Parameters) -> Line {
        self.hears_commands = true;
        if command.slots() == 0 {
            return Line::NONE;
        }
        let line = self.blocked(command.slots(), command.source, parameters);
        if line != Line::NONE {
            return line;
        }
        let (mut refusal, mut bit) = (Line::NONE, 1);
        let (mut left, mut kept) = (command.slots(), 0);
        let (entries, _) = command.bytes().as_chunks::<{ Slot::LEN as usize }>();
        for output in by_pointer(&mut self.each) {
            if left & 1 != 0 {
                let at = if OUTPUTS == 1 { 0 } else { output.slot.at };
                let [id, number, low, high] = entries[usize::from(at / Slot::LEN) % entries.len()];
                // An entry that cannot be followed must not replace one that can. The ID may have
                // changed since it came. (Several outputs forget it then.)
                match CommandType::checked(number, high) {
                    Ok(_) if OUTPUTS == 1 && id != output.id => {}
                    Ok(unit) => {
                        output.entry = Command::of(command, unit, [low, high]);
                        kept |= bit;
                    }
                    Err(line) => refusal = line,
                }
            }
            left >>= 1;
            if left == 0 {
                break;
            }
            bit <<= 1;
        }
        self.keep(kept);
        refusal
    }

    /// Takes note of the thesis's command, which is for the first output: 0 to 255 over the full
    /// travel. Returns the line for the reason of a refusal; [`Line::NONE`] if there is none.
    pub fn act_on_servo_command(&mut self, command: &Transfer, parameters: &Parameters) -> Line {
        if !self.kinds.is_actuator(1) {
            return Line::RefusedType;
        }
        let line = self.blocked(1, command.source, parameters);
        if line == Line::NONE {
            let &[position, ..] = command.bytes();
            self.each[0].entry = Command::of(command, CommandType::Byte, [position, 0]);
            self.keep(1);
        }
        line
    }

    /// Has these outputs, a bit each, follow their entries: those of one command.
    pub(super) fn keep(&mut self, outputs: u8) {
        if self.waiting & outputs != 0 {
            self.superseded.count();
        }
        if OUTPUTS > 1 {
            if self.waiting == 0 {
                // Begin with the lowest output, so that the command is followed in one round.
                self.last = u8::MAX;
            }
            self.lowest = self.lowest & !outputs | outputs & outputs.wrapping_neg();
        }
        self.waiting |= outputs;
    }

    /// The line for the reason to reject the commands of a node for these outputs, a bit each;
    /// [`Line::NONE`] if there is none.
    #[inline(always)]
    pub(super) fn blocked(&self, outputs: u8, source: u8, parameters: &Parameters) -> Line {
        if self.is_disarmed(outputs, source, parameters) {
            Line::RefusedDisarmed
        } else if self.safety.is_safe() {
            Line::RefusedSafe
        } else {
            Line::NONE
        }
    }

    /// True if the vehicle is disarmed as far as this node and these outputs, a bit each, are
    /// concerned.
    pub(super) fn is_disarmed(&self, outputs: u8, source: u8, parameters: &Parameters) -> bool {
        if self.kinds.needs_armed(outputs) {
            !self.arming.is_armed_by(source)
        } else {
            self.arming.is_disarmed_by(source, parameters)
        }
    }

    /// True if an entry waits to be followed.
    pub fn has_entry(&self) -> bool {
        self.waiting != 0
    }

    /// Follows the next entry that waits. Fills in the event for the line to log.
    pub fn follow_next(
        &mut self,
        event: &mut Event,
        now_ms: u16,
        parameters: &Parameters,
        board: &mut impl Pulses,
    ) -> Followed {
        let (output, bit) = self.next_waiting(board.next());
        self.waiting &= !bit;
        self.kinds.unpack(bit, &mut self.each[place(output)]);
        let Command { source, transfer, unit, .. } = self.each[place(output)].entry;
        event.set_source(source);
        event.set_transfer(transfer);
        event.set_code(self.each[place(output)].id);
        let mut line = self.blocked(bit, source, parameters);
        let (mut commander, mut is_second) = (0, false);
        if line == Line::NONE {
            let before = self.each[place(output)].pulse();
            let followed = &mut self.each[place(output)];
            if arming::IS_BY_SOURCE && followed.commander != source {
                is_second =
                    followed.commander != 0 && followed.has_followed_within(SECOND_MS, now_ms);
                followed.commander = source;
                self.commander_bits |= super::bit(source.into());
            }
            if update::IS_THERE {
                self.recent_s = RECENT_S;
            }
            let (pulse, value) = self.each[place(output)]
                .follow(now_ms, |travel, unit, value| self.kinds.pulse(bit, travel, unit, value));
            board.set(output, pulse);
            self.hears_commands = false;
            self.failing &= !bit;
            self.doubts.end(bit);
            if OUTPUTS == 1 || self.lowest & bit != 0 {
                commander = source;
                line = unit.line();
            }
            // An equal command is logged once a second.
            if pulse == before && self.logged & bit != 0 {
                line = Line::NONE;
            }
            self.logged |= bit;
            if line != Line::NONE {
                event.set_a(unit.logged(value));
                event.set_b(pulse);
            }
        }
        Followed { line, commander, is_second }
    }

    /// The next output whose entry waits: that whose pulse begins next, which has the number `next`
    /// or a higher one. If all begin together, each has its turn, also if newer commands come
    /// meanwhile.
    #[inline(always)]
    fn next_waiting(&mut self, next: Option<u8>) -> (usize, u8) {
        if OUTPUTS == 1 {
            return (0, 1);
        }
        let mut output = place(next.unwrap_or(self.last.wrapping_add(1)).into());
        let mut bit = super::bit(output);
        for _ in 0..OUTPUTS {
            if self.waiting & bit != 0 {
                break;
            }
            output += 1;
            bit = bit.rotate_left(1);
        }
        let output = place(output);
        self.last = output as u8;
        (output, bit)
    }
}
