//! Who the node is: its ID, and the unique ID of its hardware.

use super::control::Context;
use crate::monitor::Line;
use crate::parts::allocation::Allocation;
use crate::tables::publication::Publication;
use crate::tables::wire::Transfer;

/// The identity.
pub struct Identity {
    /// 1 to 127; 0 while the node has no ID.
    pub id: u8,
    /// The unique ID.
    pub unique_id: [u8; 16],
    /// The request for an ID.
    pub allocation: Allocation,
}

impl Identity {
    /// No ID yet.
    pub const fn new() -> Self {
        Self { id: 0, unique_id: [0; 16], allocation: Allocation::new() }
    }

    /// Allocation: an ID for this node, or what another node asks for.
    #[allow(dead_code, reason = "a build may leave out its row")]
    pub fn act_on_allocation(&mut self, message: &Transfer, context: &mut Context) -> Line {
        if self.id != 0 {
            return Line::AllocationElsewhere;
        }
        context.publisher.withdraw(Publication::Allocation);
        let line = self.take_id(message, context.now_ms);
        context.record.note.set_code(self.id);
        if self.id != 0 {
            context.filters.change();
        }
        line
    }

    /// Takes the ID that an allocator gives. Returns the line to log.
    #[inline(never)]
    fn take_id(&mut self, message: &Transfer, now_ms: u16) -> Line {
        self.id = self.allocation.act_on_message(message, &self.unique_id, now_ms);
        if self.id != 0 {
            Line::Allocated
        } else if message.source == 0 {
            // An anonymous request is another node's.
            Line::RefusedSource
        } else {
            Line::AllocationElsewhere
        }
    }
}
