//! The firmware's library on its [desk](firmware::desk), with these checks at all times:
//!
//! * The servo moves only to the position of a valid command for this output, or to the failsafe
//!   when it is due, and not before the first command. A command in one frame always moves it; one
//!   in several frames does if no other sender sends one at the same time. The node restarts only
//!   on request.
//! * The node sends valid DroneCAN frames of known types from its own ID, and each response has a
//!   request.
//! * The serial monitor writes lines of printable ASCII.
//! * The servo output has the node's value, and no work continues for ever.

use std::collections::HashSet;
use std::time::Duration;

use dronecan_host::{
    CanId, Decoded, Message, NodeInfo, Observation, Observer, Transfer, split, types,
};
use firmware::desk::{Desk, Memory};
use firmware::tables::condition::ResetCause;
use firmware::tables::parameters::{OutputParameter, Parameter};
use mcp2515_ordered::{Event, Frame, Notice};

use crate::orders::{self, Completed, Order, Transfers};
use crate::steps::{Damage, Input, Sent, Step, Type};

/// Identifier of requests, without service, destination and source.
const REQUEST: u32 = 0x1E00_8080;

/// Priority of the messages: the middle.
const MESSAGE: u32 = 0x1000_0000;

/// Maximum length of a line; the longest are about 80 characters.
const LINE_MAX: usize = 120;

/// Longest simulated time of an input, in milliseconds. `tests/boards/soak.rs` tests the wrap of
/// the 16-bit clock.
const LIFE_MS: u64 = 20_000;

/// Time for which an ArmingStatus is valid: four to five seconds.
const ARMED_FOR_MS: (u64, u64) = (4000, 5000);

/// Time for which a commander stays the autopilot after its last message.
const COMMANDER_FOR_MS: u64 = 3000;

/// Node ID of the client at the end of an input.
const ASKER: u8 = 126;

/// The node under test, and the state that the checks need.
pub struct Rig {
    /// The node and its desk. The controller accepts frames in [`leave`](Self::leave) only.
    pub desk: Desk,
    /// The incomplete line of the serial monitor.
    line: Vec<u8>,

    heard: Transfers,
    /// Open requests: service, client, transfer ID.
    asked: HashSet<(u8, u8, u8)>,
    sent: Observer,
    /// Transfers that the node has sent and that were not taken yet.
    pub transfers: Vec<Transfer>,
    /// True if a restart was requested.
    may_restart: bool,
    /// When the node last followed a command that it must follow, and since when the vehicle is
    /// armed.
    followed_ms: Option<u64>,
    armed: Option<Armed>,
    /// The last commander and its time, if they are certain.
    commander: Option<(u8, u64)>,
    /// True if a SafetyState was sent, so that the pulse may end and commands may be rejected.
    has_heard_safety: bool,
    /// Output 1 was a motor at some time (OUT1_TYPE). This rig does not know when a motor moves.
    was_motor: bool,
}

/// Since when the vehicle may be armed.
#[derive(Clone, Copy)]
struct Armed {
    since_ms: u64,
    /// True if the commander sent the ArmingStatus.
    is_sure: bool,
}

impl Rig {
    /// A node that has just started with this EEPROM.
    pub fn new(memory: Memory) -> Rig {
        let mut rig = Rig {
            desk: Desk::start(memory, ResetCause::POWER_ON),
            line: Vec::new(),
            heard: Transfers::default(),
            asked: HashSet::new(),
            sent: Observer::new(),
            transfers: Vec::new(),
            may_restart: false,
            followed_ms: None,
            armed: None,
            commander: None,
            has_heard_safety: false,
            was_motor: false,
        };
        rig.begin();
        rig
    }

    /// Resets the board, or starts it after a requested restart.
    pub fn start(&mut self, cause: ResetCause) {
        let memory = std::mem::replace(&mut self.desk.memory, Memory::blank());
        // A reset does not change the rest of the desk.
        let (readings, is_pressed) = (self.desk.readings, self.desk.is_pressed);
        self.desk = Desk::start(memory, cause);
        (self.desk.readings, self.desk.is_pressed) = (readings, is_pressed);
        self.line.clear();
        self.heard = Transfers::default();
        self.asked.clear();
        self.sent = Observer::new();
        self.may_restart = false;
        self.followed_ms = None;
        self.armed = None;
        self.commander = None;
        self.has_heard_safety = false;
        self.begin();
    }

    fn begin(&mut self) {
        self.desk.can.room = 0;
        self.desk.settle();
        assert_eq!(self.desk.program.node.pulse(0), 0, "a pulse before any command");
    }

    /// The node's ID; 0 while it has none.
    pub fn id(&self) -> u8 {
        self.desk.program.node.id()
    }

    /// The value of a parameter, in 16 bits.
    pub fn parameter(&self, index: u8) -> Option<u16> {
        self.desk.program.node.parameters.value(index)
    }

    /// Time since the start.
    fn now_ms(&self) -> u64 {
        self.desk.ms.into()
    }

    /// Runs a step.
    pub fn step(&mut self, step: &Step) {
        match step {
            Step::Frame { id: [first, rest @ ..], data } => {
                let [a, b, c] = *rest;
                // The driver passes 29 bits, and one that marks other kinds of frames.
                self.receive([first & (Frame::FOREIGN | 0x1F), a, b, c], data);
            }
            Step::Known { what, source, data } => {
                self.receive(self.identifier(*what, *source), data)
            }
            Step::Transfer { sent, damage } => self.send(sent, *damage),
            Step::Wait(ms) => self.wait(*ms),
            Step::Leave(0) => self.leave(u32::MAX),
            Step::Leave(frames) => self.leave((*frames).into()),
            Step::Input(input) => self.input(*input),
        }
    }

    fn input(&mut self, input: Input) {
        match input {
            Input::Pressed => self.desk.is_pressed = true,
            Input::Released => self.desk.is_pressed = false,
            Input::Question => self.desk.is_asked = true,
            Input::Reset => self.start(ResetCause::EXTERNAL),
            Input::Sensor(reading) => self.desk.readings = [reading; 2],
            Input::Controller(event, value) => {
                let events = [
                    Event::Running,
                    Event::NotAnswering,
                    Event::NotKeeping,
                    Event::NotStarting,
                    Event::Lost,
                    Event::GaveUpSending,
                    Event::Flags,
                    Event::AnotherRate,
                ];
                let event = events[usize::from(event) % events.len()];
                self.desk.program.node.notice(Notice { event, value });
            }
        }
    }

    /// The identifier of frames of a type to the node.
    fn identifier(&self, what: Type, source: u8) -> [u8; 4] {
        let message = |data_type: u16| MESSAGE | u32::from(data_type) << 8;
        let me = u32::from(self.desk.program.node.id());
        let request = |service: u16| REQUEST | u32::from(service) << 16 | me << 8;
        let id = match what {
            Type::ArrayCommand => message(types::ARRAY_COMMAND.id),
            Type::ThesisCommand => message(types::THESIS_COMMAND.id),
            Type::ArmingStatus => message(types::ARMING_STATUS.id),
            Type::LightsCommand => message(types::LIGHTS_COMMAND.id),
            Type::RawCommand => message(types::RAW_COMMAND.id),
            Type::NodeStatus => message(types::NODE_STATUS.id),
            Type::Allocation => message(types::ALLOCATION.id),
            Type::GetNodeInfo => request(types::GET_NODE_INFO.id),
            Type::GetSet => request(types::GET_SET.id),
            Type::ExecuteOpcode => request(types::EXECUTE_OPCODE.id),
            Type::RestartNode => request(types::RESTART_NODE.id),
            Type::BeginFirmwareUpdate => request(types::BEGIN_FIRMWARE_UPDATE.id),
            Type::GetTransportStats => request(types::GET_TRANSPORT_STATS.id),
            Type::Temperature => message(types::TEMPERATURE.id),
            Type::FileRead => request(48),
        };
        (id | u32::from(source & 0x7F)).to_be_bytes()
    }

    /// Sends a transfer, damaged if there is damage, to the node.
    pub fn send(&mut self, sent: &Sent, damage: Option<(Damage, u8)>) {
        let id = self.identifier(sent.what, sent.source);
        let can_id = CanId::parse(u32::from_be_bytes(id));
        let seed = can_id.and_then(types::DataType::of).and_then(|known| known.seed);
        let number = dronecan_host::TransferId::new(sent.number);
        let mut frames = split(&sent.payload, number, seed.unwrap_or(0));
        if let Some((damage, frame)) = damage {
            let at = usize::from(frame) % frames.len();
            let tail = frames[at].len() - 1;
            match damage {
                Damage::Lost => drop(frames.remove(at)),
                Damage::Twice => frames.insert(at, frames[at].clone()),
                Damage::First => frames[..=at].rotate_right(1),
                Damage::Last => frames[at..].rotate_left(1),
                Damage::Short => drop(frames[at].remove(0)),
                Damage::Toggle => frames[at][tail] ^= 1 << 5,
                Damage::Bit => frames[at][0] ^= 1,
                Damage::Number => {
                    frames[at][tail] = frames[at][tail] & 0xE0 | (frames[at][tail] + 1) & 0x1F
                }
            }
        }
        for frame in frames {
            self.receive(id, &frame);
        }
    }

    /// The node receives a frame and handles it.
    pub fn receive(&mut self, id: [u8; 4], data: &[u8]) {
        let mut frame = Frame { id, len: data.len() as u8, ..Frame::EMPTY };
        frame.data[..data.len()].copy_from_slice(data);
        let (before, now_ms) = (self.desk.program.node.pulse(0), self.now_ms());
        let parameters = self.desk.program.node.parameters;
        self.desk.hear(&frame);
        self.note_motor();
        let after = self.desk.program.node.pulse(0);
        let raw = u32::from_be_bytes(id);
        let v0 = if id[0] & Frame::FOREIGN != 0 {
            None
        } else {
            self.heard.push(raw, data, now_ms, &parameters)
        };
        let is_safety_state =
            matches!(CanId::parse(raw), Some(CanId::Message { type_id: 20_000, .. }));
        self.has_heard_safety |= is_safety_state && id[0] & Frame::FOREIGN == 0;
        let (mut goals, mut must_move) = (Vec::new(), false);
        if let Some(heard) = v0 {
            if let Completed {
                id: CanId::Service { service_id, request: true, source, .. },
                number,
                ..
            } = heard
            {
                self.asked.insert((service_id, source.get(), number));
            }
            match heard.order(self.desk.program.node.id(), &parameters) {
                Some(Order::Go { widths, is_clear }) => {
                    let needs_arming = parameters.get(Parameter::ArmReq) != 0;
                    let is_sure = is_clear && heard.is_sure && self.desk.program.node.id() != 0;
                    let source = heard.source();
                    if !needs_arming
                        || self.armed.is_some_and(|of| now_ms - of.since_ms <= ARMED_FOR_MS.1)
                    {
                        goals.extend(widths);
                        let by_commander =
                            |of: Armed| of.is_sure && now_ms - of.since_ms < ARMED_FOR_MS.0;
                        let is_armed = !needs_arming || self.armed.is_some_and(by_commander);
                        must_move = is_sure && is_armed && !self.has_heard_safety;
                    }
                    // Also for a command that is rejected because the vehicle is disarmed.
                    self.commander = is_sure.then_some((source, now_ms));
                }
                Some(Order::Restart) => {
                    self.may_restart = true;
                    goals.extend(orders::failsafe(&parameters));
                }
                Some(Order::Arm(on)) => {
                    let is_commander =
                        |(id, at_ms)| id == heard.source() && now_ms - at_ms < COMMANDER_FOR_MS;
                    let is_sure = heard.is_sure && self.commander.is_some_and(is_commander);
                    self.armed = match (on, self.armed) {
                        (true, _) => Some(Armed { since_ms: now_ms, is_sure }),
                        (false, _) if is_sure => None,
                        (false, armed) => armed.map(|of| Armed { is_sure: false, ..of }),
                    };
                }
                None => {}
            }
        }
        let is_there =
            goals.iter().any(|width| width.fits(after)) || self.has_heard_safety && after == 0;
        // The frame may have set a parameter.
        let before = if self.is_limited(before, after) { after } else { before };
        let is_right = is_there || !must_move && after == before || self.was_motor;
        assert!(is_right, "from {before} to {after} ticks, where {goals:?} may be");
        if must_move {
            self.followed_ms = Some(now_ms);
        }
    }

    /// Notes if output 1 is a motor.
    fn note_motor(&mut self) {
        self.was_motor |= self.desk.program.node.parameters.of(0, OutputParameter::Type) != 0;
    }

    /// True if the current travel changes the pulse `before` to `after`.
    fn is_limited(&self, before: u16, after: u16) -> bool {
        orders::Travel::of(&self.desk.program.node.parameters).limited(before).fits(after)
    }

    /// Runs for `ms` milliseconds.
    pub fn wait(&mut self, ms: u16) {
        for _ in 0..ms {
            if self.now_ms() >= LIFE_MS {
                return;
            }
            self.tick();
        }
    }

    fn tick(&mut self) {
        let (before, now_ms) = (self.desk.program.node.pulse(0), self.now_ms());
        self.desk.pass(1);
        let after = self.desk.program.node.pulse(0);
        assert_eq!(self.desk.servos.0[0], after, "the servo has another pulse");
        self.note_motor();
        if after != before && !self.is_limited(before, after) && !self.was_motor {
            let parameters = &self.desk.program.node.parameters;
            let timeout_ms = u64::from(parameters.of(0, OutputParameter::Timeout));
            let is_late = self.followed_ms.is_none_or(|followed| now_ms - followed >= timeout_ms);
            let has_reason = timeout_ms != 0 && is_late
                || parameters.get(Parameter::ArmReq) != 0
                || self.has_heard_safety;
            let goal = orders::failsafe(parameters);
            assert!(
                has_reason && goal.is_some_and(|goal| goal.fits(after)),
                "from {before} to {after} by itself"
            );
        }
        for (_, frame) in std::mem::take(&mut self.desk.can.sent) {
            self.check(&frame);
        }
        self.read();
        if self.desk.is_to_restart {
            assert!(self.may_restart, "the node restarted without a request");
            self.start(ResetCause::ASKED_FOR);
        }
    }

    /// Reads the output of the serial monitor.
    fn read(&mut self) {
        for byte in self.desk.log.drain(..) {
            match byte {
                b'\r' | b'\n' => self.line.clear(),
                byte => {
                    assert!((0x20..0x7F).contains(&byte), "a character {byte:#04x}");
                    self.line.push(byte);
                    assert!(
                        self.line.len() <= LINE_MAX,
                        "a line is too long: {}",
                        String::from_utf8_lossy(&self.line)
                    );
                }
            }
        }
    }

    /// The controller accepts up to this many frames from the node, in the next millisecond: the
    /// node asks a full controller for room once a millisecond.
    pub fn leave(&mut self, frames: u32) {
        self.desk.can.room = frames;
        self.tick();
        self.desk.can.room = 0;
    }

    /// Checks a frame that the node sent.
    fn check(&mut self, frame: &Frame) {
        let id = u32::from_be_bytes(frame.id);
        assert_eq!(id >> 29, 0, "more than 29 bits: {id:#x}");
        assert!(frame.len >= 1 && frame.len <= 8, "{} bytes", frame.len);
        let (transfer, message) = match self.sent.push(id, frame.data(), Duration::ZERO) {
            Observation::Partial => return,
            Observation::Invalid(why) => panic!("{why}: {frame:?}"),
            Observation::Complete(Decoded::V0(transfer, message)) => (transfer, message),
            Observation::Complete(Decoded::Draft(_, message)) => panic!("the draft: {message}"),
        };
        assert!(!matches!(message, Message::Other { .. }), "{message}");
        match transfer.id {
            CanId::Anonymous { .. } => {
                assert!(self.id() == 0 && matches!(message, Message::Allocation(_)), "{message}");
            }
            CanId::Message { source, .. } => assert_eq!(source.get(), self.id(), "{message}"),
            CanId::Service { service_id, request, destination, source, .. } => {
                assert!(!request && source.get() == self.id(), "{message}");
                let answered = (service_id, destination.get(), transfer.transfer_id.get());
                assert!(self.asked.contains(&answered), "there was no request for {message}");
            }
        }
        self.transfers.push(transfer);
    }

    /// Node ID of another node, which sends requests and commands.
    fn other(&self) -> u8 {
        if self.id() == ASKER { ASKER - 1 } else { ASKER }
    }

    /// Sends a request repeatedly for some seconds, because the node may be busy or restart, and
    /// returns the answer. `None` if the node has no ID, or loses it by the restart.
    pub fn ask(&mut self, what: Type, payload: &[u8]) -> Option<Message> {
        for number in 0..50u8 {
            self.leave(u32::MAX);
            self.transfers.clear();
            let number = number & 31;
            let asker = self.other();
            if self.id() == 0 {
                return None;
            }
            self.send(&Sent { what, source: asker, number, payload: payload.to_vec() }, None);
            // A request whose answer waits for the EEPROM is not repeated.
            for _ in 0..8 {
                self.leave(u32::MAX);
                let [_, service, ..] = self.identifier(what, asker);
                let to_asker = |transfer: &&Transfer| {
                    transfer.transfer_id.get() == number
                        && matches!(transfer.id, CanId::Service { service_id, destination, .. }
                            if service_id == service && destination.get() == asker)
                };
                if let Some(answer) = self.transfers.iter().find(to_asker) {
                    return Some(Message::decode(answer));
                }
                (0..50).for_each(|_| self.tick());
            }
        }
        panic!("no answer to {what:?}");
    }

    /// Requests the node's information, if it has an ID.
    pub fn node_info(&mut self) -> Option<NodeInfo> {
        match self.ask(Type::GetNodeInfo, &[])? {
            Message::NodeInfo(info) => Some(*info),
            other => panic!("{other}"),
        }
    }

    /// Checks that the node answers and follows commands; or requests a node ID, if it has none.
    pub fn still_works(&mut self) {
        let Some(info) = self.node_info() else {
            self.transfers.clear();
            for _ in 0..30 {
                (0..100).for_each(|_| self.tick());
                self.leave(u32::MAX);
            }
            assert!(!self.transfers.is_empty(), "the node must request an ID");
            return;
        };
        assert!(!info.name.is_empty(), "{info}");
        let source = self.other();
        let command = |rig: &mut Rig, value: f32| {
            let actuator = rig.desk.program.node.parameters.of(0, OutputParameter::Id) as u8;
            let [low, high] = half::f16::from_f32(value).to_le_bytes();
            rig.send(
                &Sent {
                    what: Type::ArrayCommand,
                    source,
                    number: 0,
                    payload: vec![actuator, 0, low, high],
                },
                None,
            );
        };
        // Only a commander can arm the vehicle.
        command(self, 0.0);
        self.send(&Sent { what: Type::ArmingStatus, source, number: 0, payload: vec![255] }, None);
        // Both commands move the servo, because their widths differ from the current one.
        command(self, 0.5);
        command(self, -0.5);
        let is_safe = self.has_heard_safety;
        assert!(self.desk.program.node.pulse(0) != 0 || is_safe || self.was_motor);
    }
}
