//! What an [`Engine`](super::Engine) reports after a bit.

use super::Frame;

/// Why a frame was given up.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Hash)]
pub enum ErrorKind {
    /// The wire did not have the level that the node drove.
    Bit,
    /// Six equal bits where stuffing forbids them.
    Stuff,
    /// The checksum received is not the one calculated.
    Crc,
    /// A dominant bit where the format demands a recessive one.
    Form,
    /// Nobody acknowledged the frame sent.
    Ack,
}

/// Something a node's owner should know.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Event {
    /// A frame of another node is valid: at its last but one end-of-frame bit.
    Received(Frame),
    /// The node's own frame went out: at its last end-of-frame bit.
    Transmitted(Frame),
    /// Another node with a lower identifier was sending too; this node is its receiver now.
    ArbitrationLost,
    /// An error was found.
    Error {
        /// What was wrong.
        kind: ErrorKind,
        /// Whether this node was the transmitter of the frame (or of its error frame).
        transmitting: bool,
    },
    /// The transmit error counter passed 255: the node has left the bus.
    BusOff,
    /// 128 x 11 recessive bits have passed since: the node is back, its counters at zero.
    Recovered,
    /// An overload frame was forced upon the node.
    Overload,
}

/// The events of one bit, none to two, in order.
#[derive(Clone, Copy, Default, Debug)]
pub struct Events {
    first: Option<Event>,
    second: Option<Event>,
}

impl Events {
    /// True if nothing happened.
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
