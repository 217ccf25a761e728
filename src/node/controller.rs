//! What the node wants of the CAN controller, and what it notes of it.

use dronecan_wire::NodeId;
use mcp2515_ordered::{Attempts, ErrorFlags, Event as CanEvent, Notice};

use super::Node;
use super::acceptance::{Filters, NodeAcceptance, Row};
use super::health::count;
use crate::monitor::Line;
use crate::progmem::Progmem;
use crate::tables::bit_rate::Search;
use crate::tables::condition::Conditions;
use crate::tables::parameters::Parameter;

impl Node {
    /// The filters and masks for the CAN controller, and the search for the bit rate.
    pub fn acceptance<P: Progmem<Filters>>(&self, flash: P) -> NodeAcceptance<P> {
        let row = if self.identity.id == 0 { Row::WITHOUT_ID } else { self.row() };
        let search = Search::new(self.parameters.get(Parameter::CanBaudrate) as u8);
        NodeAcceptance { node: NodeId::new(self.identity.id), row, search, flash }
    }

    /// The set of filters for a node with an ID.
    #[inline(never)]
    pub(super) fn row(&self) -> Row {
        if self.control.outputs.used() > 1 {
            Row::WITH_SEVERAL_OUTPUTS
        } else if self.control.outputs.has_motors() {
            Row::WITH_MOTORS
        } else {
            Row::WITH_ID
        }
    }

    /// How often the controller tries to send a frame. An anonymous frame is sent once, because
    /// other nodes may send frames with the same identifier (specification, chapter 4).
    pub fn attempts(&self) -> Attempts {
        if self.identity.id == 0 { Attempts::Once } else { Attempts::UntilSent }
    }

    /// True if the controller should get new filters now. New filters are pending after the node
    /// got an ID or its first motor, and after a failsafe during which no command was received,
    /// because wrong filters may be the cause. Setting filters takes the controller off the bus for
    /// 5 ms. So the node waits, for some seconds at most, until it sends no transfer, and the
    /// controller has sent all its frames (`is_controller_empty`). It does not wait for the rest of
    /// what it receives: it sends nothing until then, and another node could begin one transfer
    /// after the other.
    pub fn wants_filters(&self, is_controller_empty: bool) -> bool {
        self.filters.are_pending()
            && (self.filters.are_urgent()
                || is_controller_empty && !self.transmission.outgoing.is_busy())
    }

    /// Notes that the controller got its filters.
    pub fn filters_are_set(&mut self) {
        self.filters.are_set();
    }

    /// Acts on an event of the CAN controller.
    #[inline(never)]
    pub fn notice(&mut self, notice: Notice) {
        if notice.event == CanEvent::Flags {
            return self.flags(ErrorFlags(notice.value));
        }
        // Before the branch: so the compiler computes the number of the line, and does not compare.
        let line = line_of(notice.event);
        if notice.event == CanEvent::Running {
            return self.console.note_running();
        }
        self.record.health.happened(Conditions::CONTROLLER);
        let mut number = u16::from(notice.value);
        if notice.event == CanEvent::GaveUpSending {
            number = count(&mut self.record.health.counts.given_up);
        }
        self.console.note_controller(line, number);
    }

    fn flags(&mut self, flags: ErrorFlags) {
        let health = &mut self.record.health;
        if flags.frames_lost() {
            count(&mut health.counts.overruns);
            health.happened(Conditions::FRAMES_LOST);
            self.console.happened(Conditions::FRAMES_LOST);
        }
        if flags.bus_off() {
            health.happened(Conditions::BUS_OFF);
            self.console.happened(Conditions::BUS_OFF);
        }
        let was_passive = health.has(Conditions::ERROR_PASSIVE);
        health.set(Conditions::ERROR_PASSIVE, flags.error_passive());
        if was_passive && !flags.error_passive() {
            self.console.log.tell_again(health.conditions.told());
        }
    }
}

/// The line of an event, but of flags, which have none, and of [`CanEvent::Running`], which the
/// console tells.
#[inline(never)]
fn line_of(event: CanEvent) -> Line {
    match event {
        CanEvent::Running => Line::Running,
        CanEvent::NotAnswering => Line::NotAnswering,
        CanEvent::NotKeeping => Line::NotKeeping,
        CanEvent::NotStarting => Line::NotStarting,
        CanEvent::Lost => Line::ControllerLost,
        CanEvent::IntWrong => Line::IntWrong,
        CanEvent::AnotherRate => Line::AnotherRate,
        CanEvent::GaveUpSending => Line::GaveUp,
        CanEvent::Flags => Line::NONE,
    }
}
