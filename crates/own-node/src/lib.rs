//! A DroneCAN node to begin with: copy it, and change what it commands and publishes.
//!
//! It sends NodeStatus each second, answers GetNodeInfo, RestartNode, GetSet and ExecuteOpcode,
//! acts on actuator.ArrayCommand, and publishes device.Temperature. It runs on any driver with the
//! non-blocking trait of `embedded-can`, such as `mcp2515-ordered`, and on any storage of two
//! numbers. Layouts of payloads: the public DSDL.

#![no_std]
#![forbid(unsafe_code)]

mod kind;
mod payload;

use dronecan_wire::{Data, Id, Receiver, Segment, Sender, Verdict, float16, types};
use embedded_can::{ExtendedId, Frame, nb::Can};

use kind::Kind;
use payload::Payload;

/// What other nodes see of this one.
pub const NAME: &[u8] = b"org.example.own-node";
const VERSION: [u8; 2] = [1, 0];

/// A whole number that other nodes can read and set.
pub struct Parameter {
    /// At most 22 bytes.
    pub name: &'static [u8],
    pub default: i64,
    pub min: i64,
    pub max: i64,
}

/// The node ID takes effect after a restart.
pub const PARAMETERS: [Parameter; 2] = [
    Parameter { name: b"NODE_ID", default: 42, min: 1, max: 127 },
    Parameter { name: b"ACTUATOR_ID", default: 1, min: 0, max: 255 },
];
/// Bytes that are kept of a request. One that sets a parameter by its name has ten before the name.
const KEPT: usize = 32;
const _: () = {
    let mut at = 0;
    while at < PARAMETERS.len() {
        assert!(
            PARAMETERS[at].name.len() <= KEPT - 10,
            "a request with this name is not kept whole"
        );
        at += 1;
    }
};
const NODE_ID: usize = 0;
const ACTUATOR_ID: usize = 1;

/// Where the parameters are when the power is off.
pub trait Storage {
    /// Returns parameter `at`, or `None` if it was never stored. In place of a value out of range,
    /// such as that of an erased flash, the node has the default.
    fn load(&mut self, at: usize) -> Option<i64>;
    /// Stores all parameters. Returns true if they are stored.
    fn store(&mut self, values: &[i64; PARAMETERS.len()]) -> bool;
}

/// What the program must do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Move the actuator, in thousandths of its travel: -1000 to 1000.
    Move(i16),
    /// Restart, 100 ms or so later: the response has yet to be sent.
    Restart,
}

/// One transfer that is being sent.
struct Outgoing {
    id: Id,
    sender: Sender,
    payload: Payload,
    /// The part of the next frame that has been made.
    data: Data,
}

impl Outgoing {
    const NONE: Self = Self {
        id: Id::from_bytes([0; 4]),
        sender: Sender::new(),
        payload: Payload::EMPTY,
        data: Data::EMPTY,
    };

    fn begin(&mut self, id: Id, payload: Payload, transfer_id: u8, seed: u16) {
        self.sender.begin(payload.bytes().len() as u8, transfer_id, seed);
        (self.id, self.payload, self.data) = (id, payload, Data::EMPTY);
    }

    /// Makes the next frame, if there is one.
    fn next<F: Frame>(&mut self) -> Option<F> {
        if !self.sender.is_busy() {
            return None;
        }
        while !self.sender.is_ready() {
            self.sender.step(self.payload.bytes(), &mut self.data);
        }
        F::new(ExtendedId::from(self.id), self.data.as_slice())
    }

    /// The driver has accepted the frame.
    fn accepted(&mut self) {
        self.sender.sent();
        self.data = Data::EMPTY;
    }
}

/// The node on a driver and a storage.
pub struct Node<C: Can, S> {
    can: C,
    storage: S,
    unique_id: [u8; 16],
    node_id: u8,
    values: [i64; PARAMETERS.len()],
    receiver: Receiver<Kind, 1, 1, KEPT>,
    response: Outgoing,
    message: Outgoing,
    /// A frame of this node that the driver returned, because one of higher priority took its
    /// place.
    returned: Option<C::Frame>,
    /// When the next NodeStatus is due. A Temperature follows half a second later.
    next_ms: u32,
    is_temperature_next: bool,
    /// The transfer IDs of the two messages.
    transfer_ids: [u8; 2],
}

impl<C: Can, S: Storage> Node<C, S> {
    /// `unique_id` is a number that no other node has, for example that of the microcontroller.
    pub fn new(can: C, mut storage: S, unique_id: [u8; 16]) -> Self {
        let mut values = PARAMETERS.each_ref().map(|parameter| parameter.default);
        for (at, (value, parameter)) in values.iter_mut().zip(&PARAMETERS).enumerate() {
            let stored = storage.load(at).filter(|it| (parameter.min..=parameter.max).contains(it));
            *value = stored.unwrap_or(*value);
        }
        Self {
            can,
            storage,
            unique_id,
            node_id: values[NODE_ID] as u8,
            values,
            receiver: Receiver::new(),
            response: Outgoing::NONE,
            message: Outgoing::NONE,
            returned: None,
            next_ms: 0,
            is_temperature_next: false,
            transfer_ids: [0; 2],
        }
    }

    /// Does the next work: call it in a loop. `now_ms` is the time since the start, and `kelvin`
    /// the temperature in 1/32 K.
    pub fn turn(&mut self, now_ms: u32, kelvin: u16) -> Result<Option<Action>, C::Error> {
        let received = match self.can.receive() {
            Ok(frame) => Some(frame),
            Err(nb::Error::WouldBlock) => None,
            Err(nb::Error::Other(error)) => return Err(error),
        };
        let action = received.and_then(|frame| self.take(&frame, now_ms));
        self.receiver.expire(now_ms as u16);
        self.publish(now_ms, kelvin);
        self.send()?;
        Ok(action)
    }

    /// Passes the next frames to the driver, unless it has no room. A returned frame goes before
    /// the frames that follow it.
    fn send(&mut self) -> Result<(), C::Error> {
        if let Some(frame) = self.returned.take()
            && !self.transmit(&frame)?
        {
            self.returned = Some(frame);
        }
        if self.returned.is_none()
            && let Some(frame) = self.response.next()
            && self.transmit(&frame)?
        {
            self.response.accepted();
        }
        if self.returned.is_none()
            && let Some(frame) = self.message.next()
            && self.transmit(&frame)?
        {
            self.message.accepted();
        }
        Ok(())
    }

    /// Returns true if the driver accepted the frame.
    fn transmit(&mut self, frame: &C::Frame) -> Result<bool, C::Error> {
        match self.can.transmit(frame) {
            Ok(returned) => {
                self.returned = returned;
                Ok(true)
            }
            Err(nb::Error::WouldBlock) => Ok(false),
            Err(nb::Error::Other(error)) => Err(error),
        }
    }

    /// Begins the next message if it is due.
    fn publish(&mut self, now_ms: u32, kelvin: u16) {
        if self.message.sender.is_busy() || (now_ms.wrapping_sub(self.next_ms) as i32) < 0 {
            return;
        }
        let (message, payload) = if self.is_temperature_next {
            let bits = float16::from_fixed(kelvin, 5).to_le_bytes();
            // The number of the device, the temperature, and no error.
            (types::DEVICE_TEMPERATURE, Payload::new(&[&[0, 0], &bits, &[0]]))
        } else {
            (types::NODE_STATUS, Payload::new(&[&status(now_ms)]))
        };
        let transfer_id = &mut self.transfer_ids[usize::from(self.is_temperature_next)];
        let id = Id::message(24, message.id, self.node_id);
        self.message.begin(id, payload, *transfer_id, message.seed);
        *transfer_id = (*transfer_id + 1) % 32;
        self.is_temperature_next = !self.is_temperature_next;
        self.next_ms = now_ms.wrapping_add(500);
    }

    /// Acts on a received frame.
    fn take(&mut self, frame: &C::Frame, now_ms: u32) -> Option<Action> {
        let embedded_can::Id::Extended(id) = frame.id() else { return None };
        if frame.is_remote_frame() {
            return None;
        }
        let segment = Segment::read(Id::from(id), frame.data(), self.node_id).ok()?;
        let actuator = self.values[ACTUATOR_ID] as u8;
        match self.receiver.accept(segment, actuator, now_ms as u16) {
            Verdict::Message(message) => match (message.kind, message.payload()) {
                // The number of the actuator, the unit (0: its travel), and a float16.
                (Kind::ArrayCommand, &[_, 0, low, high]) => {
                    let travel = float16::to_fixed(u16::from_le_bytes([low, high]), 10);
                    let thousandths = i32::from(travel) * 1000 / 1024;
                    Some(Action::Move(thousandths.clamp(-1000, 1000) as i16))
                }
                _ => None,
            },
            // A client that sends the next request before the response is complete repeats it.
            Verdict::Request(request) if !self.response.sender.is_busy() => {
                let request = *request;
                let (service, payload, action) = match request.kind {
                    Kind::GetNodeInfo => (types::GET_NODE_INFO, self.node_info(now_ms), None),
                    Kind::RestartNode => {
                        let is_magic = request.payload() == [0x1E, 0x1B, 0x55, 0xCE, 0xAC];
                        let ok = if is_magic { 0x80 } else { 0 };
                        let action = is_magic.then_some(Action::Restart);
                        (types::RESTART_NODE, Payload::new(&[&[ok]]), action)
                    }
                    Kind::ExecuteOpcode => {
                        (types::EXECUTE_OPCODE, self.execute(request.payload()), None)
                    }
                    Kind::GetSet => (types::GET_SET, self.get_set(request.payload()), None),
                    Kind::Unknown | Kind::ArrayCommand => return None,
                };
                let id = Id::response(request.priority, service.id, request.source, self.node_id);
                self.response.begin(id, payload, request.transfer_id(), service.seed);
                action
            }
            _ => None,
        }
    }

    fn node_info(&self, now_ms: u32) -> Payload {
        // No commit and no checksum of the software. The last byte before the name is the length of
        // a certificate.
        let [software, hardware] = [VERSION; 2];
        let parts: [&[u8]; 7] =
            [&status(now_ms), &software, &[0; 13], &hardware, &self.unique_id, &[0], NAME];
        Payload::new(&parts)
    }

    /// Reads or sets a parameter, by its name or its index.
    fn get_set(&mut self, request: &[u8]) -> Payload {
        // The index has 13 bits. The three below are what the value is: nothing or a whole number.
        let &[low, high, ref rest @ ..] = request else { return Payload::NO_PARAMETER };
        let (new, name) = match (high & 7, rest.split_first_chunk()) {
            (1, Some((number, name))) => (Some(i64::from_le_bytes(*number)), name),
            _ => (None, rest),
        };
        let at = if name.is_empty() {
            usize::from(low) | usize::from(high >> 3) << 8
        } else {
            let named = |parameter: &Parameter| parameter.name == name;
            PARAMETERS.iter().position(named).unwrap_or(usize::MAX)
        };
        let (Some(parameter), Some(value)) = (PARAMETERS.get(at), self.values.get_mut(at)) else {
            return Payload::NO_PARAMETER;
        };
        if let Some(new) = new.filter(|new| (parameter.min..=parameter.max).contains(new)) {
            *value = new;
        }
        Payload::of_parameter(parameter, *value)
    }

    /// Opcode 0 stores the parameters, 1 sets all to their defaults.
    fn execute(&mut self, request: &[u8]) -> Payload {
        let is_known = match request.first() {
            Some(0) => true,
            Some(1) => {
                self.values = PARAMETERS.each_ref().map(|parameter| parameter.default);
                true
            }
            _ => false,
        };
        let is_stored = is_known && self.storage.store(&self.values);
        Payload::new(&[&[0; 6], &[if is_stored { 0x80 } else { 0 }]])
    }
}

/// A NodeStatus: the time since the start in seconds, and a healthy node that operates.
fn status(now_ms: u32) -> [u8; 7] {
    let [s0, s1, s2, s3] = (now_ms / 1000).to_le_bytes();
    [s0, s1, s2, s3, 0, 0, 0]
}
