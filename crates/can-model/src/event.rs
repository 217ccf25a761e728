//! Events that an [`Engine`](super::Engine) reports after a bit.

use super::Frame;

/// Why a frame was aborted.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Hash)]
pub enum ErrorKind {
    /// The wire did not have the level that the node drove.
    Bit,
    /// Six equal bits in the stuffed part of a frame.
    Stuff,
    /// The received CRC differs from the calculated one.
    Crc,
    /// A dominant bit where the format requires a recessive one.
    Form,
    /// No node acknowledged the frame.
    Ack,
}

/// An event for a node's owner.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Event {
    /// A frame of another node is valid: in its last but one end-of-frame bit.
    Received(Frame),
    /// The node's own frame was sent: in its last end-of-frame bit.
    Transmitted(Frame),
    /// The node lost arbitration to a lower identifier, and is a receiver now.
    ArbitrationLost,
    /// The node detected an error, or its flag shows another node's.
    Error {
        /// The kind of error.
        kind: ErrorKind,
        /// True if this node is the transmitter of the frame (or of its error frame).
        transmitting: bool,
    },
    /// The transmit error counter passed 255: the node is bus-off.
    BusOff,
    /// After 128 x 11 recessive bits the node has recovered from bus-off; its counters are zero.
    Recovered,
    /// Another node made this node send an overload frame.
    Overload,
}

/// The events of one bit in order, at most two.
#[derive(Clone, Copy, Default, Debug)]
pub struct Events {
    first: Option<Event>,
    second: Option<Event>,
}

impl Events {
    /// True if there is no event.
    pub fn is_empty(&self) -> bool {
        self.first.is_none()
    }

    pub(super) fn push(&mut self, event: Event) {
        if self.first.is_none() {
            self.first = Some(event);
        } else {
            assert!(self.second.is_none(), "three events in one bit: {self:?}, {event:?}");
            self.second = Some(event);
        }
    }
}

impl Iterator for Events {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        let event = self.first.take();
        self.first = self.second.take();
        event
    }
}
