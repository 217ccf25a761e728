//! esc.RawCommand, which motors follow.

use super::Outputs;
use super::kind::Kind;
use crate::monitor::Line;
use crate::tables::parameters::Parameters;
use crate::tables::wire::Transfer;

impl Outputs {
    /// True if an output in use is a motor.
    pub fn has_motors(&self) -> bool {
        self.kinds.motors.outputs() != 0
    }

    /// True if commands above idle have been refused for two to three seconds, because their sender
    /// has not armed.
    pub fn are_commands_refused(&self) -> bool {
        self.kinds.motors.are_refused()
    }

    /// Takes note of an esc.RawCommand: keeps its commands for the outputs that are motors. Returns
    /// the line for the reason of a refusal; [`Line::NONE`] if there is none.
    pub fn act_on_raw_command(&mut self, command: &Transfer, parameters: &Parameters) -> Line {
        let len = command.payload().len() as u8;
        let found = self.kinds.motors.commanded(len, self.each.iter().map(|output| output.id));
        if found == 0 {
            self.leave_out_all(command.source);
            return Line::NONE;
        }
        let line = self.blocked(found, command.source, parameters);
        if line != Line::NONE {
            self.kinds.motors.refuse(found);
            if line == Line::RefusedDisarmed {
                self.kinds.motors.is_disarmed(command);
            }
            return line;
        }
        let left_out = self.kinds.motors.kept() & !found;
        if left_out != 0 {
            self.unpack(left_out);
        }
        self.kinds.motors.leave_out(command.source, found);
        self.kinds.motors.keep(command, found);
        self.keep(found);
        Line::NONE
    }

    /// An esc.RawCommand of this node has a command for no motor: it stops those of its sender. A
    /// function of its own, because the other commands must not take longer for it.
    #[inline(never)]
    fn leave_out_all(&mut self, source: u8) {
        // No other node has any here.
        if self.has_commander(source) {
            self.unpack(self.kinds.motors.kept());
            self.kinds.motors.leave_out(source, 0);
        }
    }

    /// Unpacks the commands that are kept for these motors, a bit each, because the next
    /// esc.RawCommand has none for them.
    #[inline(never)]
    fn unpack(&mut self, motors: u8) {
        let mut left = motors;
        for output in &mut self.each {
            if left & 1 != 0
                && let Some(command) = self.kinds.motors.kept_for(output.id)
            {
                output.entry = command;
            }
            left >>= 1;
        }
    }
}
