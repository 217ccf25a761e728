//! hardpoint.Command and hardpoint.Status, of relays.

use super::Outputs;
use super::kind::Kind;
use crate::monitor::Line;
use crate::tables::parameters::Parameters;

impl Outputs {
    /// Follows a hardpoint.Command: 0 releases the relays with this ID, other numbers hold. Returns
    /// the line to log; [`Line::NONE`] if the node has no such relay.
    #[inline(always)]
    pub fn act_on_hardpoint_command(
        &mut self,
        source: u8,
        id: u8,
        holds: bool,
        parameters: &Parameters,
    ) -> Line {
        let (mut found, mut bit) = (0, 1u8);
        for output in &self.each {
            if output.id == id {
                found |= bit;
            }
            bit <<= 1;
        }
        found &= self.kinds.relays.outputs();
        if found == 0 {
            return Line::NONE;
        }
        let line = self.blocked(found, source, parameters);
        if line != Line::NONE {
            return line;
        }
        self.kinds.relays.act_on_command(found, holds, parameters);
        Line::Hardpoint
    }

    /// The ID of the relay for the next hardpoint.Status, and true if it holds. `None` if there is
    /// no relay.
    #[inline(always)]
    pub fn next_relay(&mut self) -> Option<(u8, bool)> {
        let (bit, holds) = self.kinds.relays.next_to_report();
        let mut left = bit;
        let mut relays = self.each.iter().filter(|_| {
            left = left.rotate_right(1);
            left == 1 << 7
        });
        relays.next().map(|output| (output.id, holds))
    }
}
