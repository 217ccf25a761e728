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
    pub default: i32,
    pub min: i32,
    pub max: i32,
}

impl Parameter {
    /// The response of GetSet: value, default, maximum, minimum and name.
    fn answer<const N: usize>(&self, payload: &mut Payload<N>, value: i32) {
        payload.set(&[]);
        for number in [value, self.default, self.max, self.min] {
            payload.add_number(number);
        }
        payload.add(self.name);
    }
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
const DEFAULTS: [i32; PARAMETERS.len()] = {
    let mut values = [0; PARAMETERS.len()];
    let mut at = 0;
    while at < values.len() {
        values[at] = PARAMETERS[at].default;
        at += 1;
    }
    values
};
/// Bytes of the longest response: that of GetNodeInfo has 41 before the name, that of GetSet 36.
const RESPONSE_MAX: usize = {
    let mut max = 41 + NAME.len();
    let mut at = 0;
    while at < PARAMETERS.len() {
        let len = 36 + PARAMETERS[at].name.len();
        max = if len > max { len } else { max };
        at += 1;
    }
    max
};
/// Bytes of the longest message, which is NodeStatus.
const MESSAGE_MAX: usize = 7;
/// While frames wait to be received the node sends in every ninth turn: a frame that waits longer
/// than those that the driver keeps is lost.
const FRAMES_IN_A_ROW: u8 = 8;
const NODE_ID: usize = 0;
const ACTUATOR_ID: usize = 1;

/// Where the parameters are when the power is off.
pub trait Storage {
    /// Returns parameter `at`, or `None` if it was never stored. In place of a value out of range,
    /// such as that of an erased flash, the node has the default.
    fn load(&mut self, at: usize) -> Option<i32>;
    /// Stores all parameters. Returns true if they are stored.
    fn store(&mut self, values: &[i32; PARAMETERS.len()]) -> bool;
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
struct Outgoing<const N: usize> {
    id: Id,
    sender: Sender,
    payload: Payload<N>,
    /// The part of the next frame that has been made.
    data: Data,
}

impl<const N: usize> Outgoing<N> {
    const NONE: Self = Self {
        id: Id::from_bytes([0; 4]),
        sender: Sender::new(),
        payload: Payload::EMPTY,
        data: Data::EMPTY,
    };

    /// Begins to send the bytes that are in `payload`.
    fn begin(&mut self, id: Id, transfer_id: u8, seed: u16) {
        self.sender.begin(self.payload.bytes().len() as u8, transfer_id, seed);
        (self.id, self.data) = (id, Data::EMPTY);
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
    values: [i32; PARAMETERS.len()],
    receiver: Receiver<Kind, 1, 1, KEPT>,
    response: Outgoing<RESPONSE_MAX>,
    message: Outgoing<MESSAGE_MAX>,
    /// A frame of this node that the driver returned, because one of higher priority took its
    /// place.
    returned: Option<C::Frame>,
    /// The seconds since the start, and when the next one begins. They are counted, because a
    /// microcontroller without a divider takes a kilobyte to divide.
    seconds: u32,
    second_ms: u16,
    /// When the next NodeStatus is due. A Temperature follows half a second later.
    next_ms: u32,
    is_temperature_next: bool,
    /// The turns with a received frame since the last one in which the node could send.
    frames_in_a_row: u8,
    /// The transfer IDs of the two messages.
    transfer_ids: [u8; 2],
}

impl<C: Can, S: Storage> Node<C, S> {
    /// `unique_id` is a number that no other node has, for example that of the microcontroller.
    #[inline(never)]
    pub fn new(can: C, mut storage: S, unique_id: [u8; 16]) -> Self {
        let mut values = DEFAULTS;
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
            seconds: 0,
            second_ms: 1000,
            next_ms: 0,
            is_temperature_next: false,
            frames_in_a_row: 0,
            transfer_ids: [0; 2],
        }
    }

    /// Does the next work: call it in a loop. `now_ms` is the time since the start, and `kelvin`
    /// the temperature in 1/32 K.
    #[inline(never)]
    pub fn turn(&mut self, now_ms: u32, kelvin: u16) -> Result<Option<Action>, C::Error> {
        let received = match self.can.receive() {
            Ok(frame) => Some(frame),
            Err(nb::Error::WouldBlock) => None,
            Err(nb::Error::Other(error)) => return Err(error),
        };
        if (now_ms as u16).wrapping_sub(self.second_ms) as i16 >= 0 {
            self.second_ms = self.second_ms.wrapping_add(1000);
            self.seconds += 1;
        }
        if received.is_some() && self.frames_in_a_row < FRAMES_IN_A_ROW {
            self.frames_in_a_row += 1;
        } else {
            self.frames_in_a_row = 0;
            self.receiver.expire(now_ms as u16);
            self.publish(now_ms, kelvin);
            self.send()?;
        }
        Ok(received.and_then(|frame| self.take(&frame, now_ms)))
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
        let payload = &mut self.message.payload;
        let message = if self.is_temperature_next {
            let [low, high] = float16::from_fixed(kelvin, 5).to_le_bytes();
            // The number of the device, the temperature, and no error.
            payload.set(&[0, 0, low, high, 0]);
            types::DEVICE_TEMPERATURE
        } else {
            payload.set(&status(self.seconds));
            types::NODE_STATUS
        };
        let transfer_id = &mut self.transfer_ids[usize::from(self.is_temperature_next)];
        let id = Id::message(24, message.id, self.node_id);
        self.message.begin(id, *transfer_id, message.seed);
        *transfer_id = (*transfer_id + 1) % 32;
        self.is_temperature_next = !self.is_temperature_next;
        self.next_ms = now_ms.wrapping_add(500);
    }

    /// Acts on a received frame. Not inlined, as `new` and `turn`: the main program would have the
    /// stack of all three.
    #[inline(never)]
    fn take(&mut self, frame: &C::Frame, now_ms: u32) -> Option<Action> {
        let embedded_can::Id::Extended(id) = frame.id() else { return None };
        if frame.is_remote_frame() {
            return None;
        }
        let segment = Segment::read(Id::from(id), frame.data(), self.node_id).ok()?;
        let actuator = self.values[ACTUATOR_ID] as u8;
        match self.receiver.accept(segment, actuator, now_ms as u16) {
            Verdict::Message(message) => match message.kind {
                Kind::ArrayCommand => {
                    // The number of the actuator, the unit (0: its travel), and a float16.
                    let &[_, 0, low, high] = message.payload() else { return None };
                    let travel = float16::to_fixed(u16::from_le_bytes([low, high]), 10);
                    let thousandths = i32::from(travel) * 1000 / 1024;
                    Some(Action::Move(thousandths.clamp(-1000, 1000) as i16))
                }
                Kind::Unknown
                | Kind::GetNodeInfo
                | Kind::RestartNode
                | Kind::GetSet
                | Kind::ExecuteOpcode => None,
            },
            // A client that sends the next request before the response is complete repeats it.
            Verdict::Request(request) if !self.response.sender.is_busy() => {
                let transfer_id = request.transfer_id();
                let payload = &mut self.response.payload;
                let (service, action) = match request.kind {
                    Kind::GetNodeInfo => {
                        // No commit and no checksum of the software. The last byte before the name
                        // is the length of a certificate.
                        payload.set(&status(self.seconds));
                        payload.add(&VERSION);
                        payload.add(&[0; 13]);
                        payload.add(&VERSION);
                        payload.add(&self.unique_id);
                        payload.add(&[0]);
                        payload.add(NAME);
                        (types::GET_NODE_INFO, None)
                    }
                    Kind::RestartNode => {
                        let is_magic = request.payload() == [0x1E, 0x1B, 0x55, 0xCE, 0xAC];
                        payload.set(&[if is_magic { 0x80 } else { 0 }]);
                        (types::RESTART_NODE, is_magic.then_some(Action::Restart))
                    }
                    Kind::ExecuteOpcode => {
                        let is_done =
                            execute(&mut self.values, &mut self.storage, request.payload());
                        payload.set(&[0, 0, 0, 0, 0, 0, if is_done { 0x80 } else { 0 }]);
                        (types::EXECUTE_OPCODE, None)
                    }
                    Kind::GetSet => {
                        match get_set(&mut self.values, request.payload()) {
                            Some((parameter, value)) => parameter.answer(payload, value),
                            // Value, default, maximum and minimum are nothing.
                            None => payload.set(&[0; 4]),
                        }
                        (types::GET_SET, None)
                    }
                    Kind::Unknown | Kind::ArrayCommand => return None,
                };
                let id = Id::response(request.priority, service.id, request.source, self.node_id);
                self.response.begin(id, transfer_id, service.seed);
                action
            }
            _ => None,
        }
    }
}

/// Reads or sets a parameter, by its name or its index.
fn get_set(
    values: &mut [i32; PARAMETERS.len()],
    request: &[u8],
) -> Option<(&'static Parameter, i32)> {
    // The index has 13 bits. The three below are what the value is: nothing or a whole number.
    let &[low, high, ref rest @ ..] = request else { return None };
    let (new, name) = match (high & 7, rest.split_first_chunk()) {
        (1, Some((number, name))) => (i32::try_from(i64::from_le_bytes(*number)).ok(), name),
        _ => (None, rest),
    };
    let at = if name.is_empty() {
        usize::from(low) | usize::from(high >> 3) << 8
    } else {
        PARAMETERS.iter().position(|parameter| parameter.name == name)?
    };
    let (parameter, value) = (PARAMETERS.get(at)?, values.get_mut(at)?);
    if let Some(new) = new.filter(|new| (parameter.min..=parameter.max).contains(new)) {
        *value = new;
    }
    Some((parameter, *value))
}

/// Opcode 0 stores the parameters, 1 sets all to their defaults. Returns true if they are stored.
fn execute(
    values: &mut [i32; PARAMETERS.len()],
    storage: &mut impl Storage,
    request: &[u8],
) -> bool {
    let is_known = match request.first() {
        Some(0) => true,
        Some(1) => {
            *values = DEFAULTS;
            true
        }
        _ => false,
    };
    is_known && storage.store(values)
}

/// A NodeStatus: the time since the start in seconds, and a healthy node that operates.
fn status(seconds: u32) -> [u8; 7] {
    let [s0, s1, s2, s3] = seconds.to_le_bytes();
    [s0, s1, s2, s3, 0, 0, 0]
}
