//! What the node wants of the CAN controller, and what it notes of it.

use dronecan_wire::NodeId;
use mcp2515_ordered::{Attempts, ErrorFlags, Event as CanEvent, Notice};

use super::Node;
use super::acceptance::{Filters, NodeAcceptance, Row};
use super::health::count;
use crate::monitor::{Line, Monitor};
use crate::progmem::Progmem;
use crate::tables::condition::Conditions;

impl Node {
    /// The filters and masks for the CAN controller.
    pub fn acceptance<P: Progmem<Filters>>(&self, flash: P) -> NodeAcceptance<P> {
        let row = if self.identity.id == 0 { Row::WITHOUT_ID } else { self.row() };
        NodeAcceptance { node: NodeId::new(self.identity.id), row, flash }
    }

    /// The set of filters for a node with an ID.
    pub(super) fn row(&self) -> Row {
        if self.control.outputs.has_motors() { Row::WITH_MOTORS } else { Row::WITH_ID }
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
    pub fn notice(&mut self, notice: Notice, monitor: &mut Monitor) {
        let line = match notice.event {
            CanEvent::Flags => return self.flags(ErrorFlags(notice.value), monitor),
            CanEvent::Running => Line::Running,
            CanEvent::NotAnswering => Line::NotAnswering,
            CanEvent::NotKeeping => Line::NotKeeping,
            CanEvent::NotStarting => Line::NotStarting,
            CanEvent::Lost => Line::ControllerLost,
            CanEvent::GaveUpSending => Line::GaveUp,
        };
        if notice.event == CanEvent::GaveUpSending {
            count(&mut self.record.health.counts.given_up);
        }
        if notice.event != CanEvent::Running {
            self.record.health.happened(Conditions::CONTROLLER);
        }
        let event = monitor.log_line(line);
        event.set_code(notice.value);
        event.set_a(self.record.health.counts.given_up);
    }

    fn flags(&mut self, flags: ErrorFlags, monitor: &mut Monitor) {
        if flags.frames_lost() {
            count(&mut self.record.health.counts.overruns);
            self.record.health.happened(Conditions::FRAMES_LOST);
            monitor.log_line(Line::FramesLost).set_a(self.record.health.counts.overruns);
        }
        if flags.bus_off() {
            self.record.health.happened(Conditions::BUS_OFF);
            monitor.log_line(Line::BusOff);
        }
        let is_passive = flags.error_passive();
        self.record.health.set(
            Conditions::ERROR_PASSIVE,
            is_passive,
            [Line::ErrorPassive, Line::ErrorActive],
            monitor,
        );
    }
}
