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
            // It stops the motors of its sender. No other has any here.
            if self.has_commander(command.source) {
                self.leave_out(command.source, found);
            }
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
        self.leave_out(command.source, found);
        self.kinds.motors.keep(command, found);
        self.keep(found);
        Line::NONE
    }

    /// Takes note of an esc.RawCommand of this node, which has commands for the motors `found`, a
    /// bit each.
    fn leave_out(&mut self, source: u8, found: u8) {
        let left_out = self.kinds.motors.kept() & !found;
        if left_out != 0 {
            self.unpack(left_out);
        }
        self.kinds.motors.leave_out(source, found);
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
