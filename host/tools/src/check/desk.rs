//! What the checks share: the node as it was heard, requests to it, and what they change of it.
//!
//! A check is a future that waits for frames, lines, answers or a time. It gets none of them
//! itself: the user of [`Session`](super::session::Session) brings them and the time, and polls.

use std::cell::{Ref, RefCell, RefMut};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::Poll;
use std::time::Duration;

use crate::update::session::{Action, Outcome, Session as Update};
use crate::update::tool::Tool;
use dronecan_host::text::visible;
use dronecan_host::{
    ActuatorCommand, CommandUnit, Frame, Message, NodeId, NodeStatus, Opcode, ParameterRequest,
    ParameterResponse, Transfer, TransferId, Value, frames,
};
use half::f16;
use serde::{Deserialize, Serialize};

use crate::check::report::{Report, Row, Verdict};

/// Timeout of a request. A SAVE takes up to a second, and the requests behind it wait.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(1500);
const ATTEMPTS: u32 = 3;
/// Longest line of the serial monitor that is kept.
const LINE_MAX: usize = 200;

/// Something of the node, and when.
#[derive(Clone, Copy, Debug)]
pub struct Heard<T> {
    pub at: Duration,
    /// The same by the adapter's clock, if it has one. Only differences count.
    pub by_adapter: Duration,
    pub what: T,
}

/// The parameters of a board that the checks have changed, and their values before.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Changed {
    /// Another board may have the same node ID.
    pub unique_id: String,
    pub values: BTreeMap<String, i64>,
}

impl fmt::Display for Changed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let values: Vec<_> =
            self.values.iter().map(|(name, value)| format!("{name} {value}")).collect();
        f.write_str(&values.join(", "))
    }
}

/// What the session asks of its user.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// A line for the user.
    Note(String),
    Row(Row),
    /// A question, which [`Answer`] answers. With a number of seconds it is something to do, and
    /// ends by itself.
    Ask(String, Option<u64>),
    /// The question has ended without an answer.
    Withdraw,
    /// Open the serial port, which resets the board.
    OpenPort,
    /// Close it, because the board loses its supply.
    ClosePort,
    /// Ask the adapter whether it has seen errors on the bus since it was asked last.
    AskAdapter,
    /// Send this to the serial port.
    Serial(Vec<u8>),
    /// Record the pins for a second, and hand the recording to `Session::recorded`.
    Record,
    /// Reopen the adapter with this bit rate.
    BitRate(u32),
    /// What is to be put back, should this program end before it does so.
    Remember(Changed),
}

/// The answer to a question.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    Yes,
    No,
    Skip,
}

/// All that is known.
pub struct State {
    pub now: Duration,
    pub node: NodeId,
    pub tool: Tool,
    /// True while this program sends no NodeStatus. The node's follows the first one on the bus.
    pub is_silent: bool,
    /// Frames for the bus, and the number of those that the adapter has not taken yet.
    pub out: Vec<Frame>,
    pub waiting: usize,
    pub outputs: Vec<Output>,
    pub report: Report,
    pub answer: Option<Answer>,
    pub adapter_errors: Option<bool>,
    pub recording: Option<Result<String, String>>,
    /// The actuator that this program commands, and the width of its pulse; and when.
    pub command: Option<(u8, f32)>,
    command_at: Duration,
    /// True if an output has moved.
    pub has_moved: bool,
    transfer_id: u8,
    /// The adapter's clock: the last stamp, and the time that it stands for.
    stamp: Option<Stamp>,
    response: Option<Heard<Message>>,
    expected: Option<(u16, u8)>,
    /// When a response arrived that nobody waited for, by the adapter's clock.
    before: Option<Duration>,
    pub statuses: Vec<Heard<NodeStatus>>,
    pub temperatures: Vec<Heard<f32>>,
    /// Times of the frames of the node.
    pub frames: Vec<Duration>,
    /// Lines of the serial monitor, and texts of LogMessage.
    pub lines: Vec<(Duration, String)>,
    pub serial_bytes: usize,
    line: Vec<u8>,
    pub others: BTreeSet<NodeId>,
    /// Other nodes that say that the vehicle is armed, or command outputs.
    pub armed_by: Option<NodeId>,
    pub commander: Option<NodeId>,
    pub changed: Changed,
    /// True if a changed value may be in the EEPROM.
    pub is_saved: bool,
    pub update: Option<Update>,
    /// Times of the requests for parts of the file, by the adapter's clock.
    pub reads: Vec<Duration>,
}

/// A handle of the [`State`].
#[derive(Clone)]
pub struct Desk(Rc<RefCell<State>>);

impl Desk {
    pub fn new(node: NodeId, changed: Changed) -> Desk {
        Desk(Rc::new(RefCell::new(State {
            now: Duration::ZERO,
            node,
            tool: Tool::default(),
            is_silent: true,
            out: Vec::new(),
            waiting: 0,
            outputs: Vec::new(),
            report: Report::default(),
            answer: None,
            adapter_errors: None,
            recording: None,
            command: None,
            command_at: Duration::ZERO,
            has_moved: false,
            transfer_id: 0,
            stamp: None,
            response: None,
            expected: None,
            before: None,
            statuses: Vec::new(),
            temperatures: Vec::new(),
            frames: Vec::new(),
            lines: Vec::new(),
            serial_bytes: 0,
            line: Vec::new(),
            others: BTreeSet::new(),
            armed_by: None,
            commander: None,
            is_saved: !changed.values.is_empty(),
            changed,
            update: None,
            reads: Vec::new(),
        })))
    }

    pub fn state(&self) -> Ref<'_, State> {
        self.0.borrow()
    }

    pub fn state_mut(&self) -> RefMut<'_, State> {
        self.0.borrow_mut()
    }

    pub fn now(&self) -> Duration {
        self.state().now
    }

    pub fn output(&self, output: Output) {
        self.state_mut().outputs.push(output);
    }

    pub fn note(&self, text: impl Into<String>) {
        self.output(Output::Note(text.into()));
    }

    pub fn row(
        &self,
        what: &'static str,
        expected: impl Into<String>,
        seen: impl Into<String>,
        verdict: Verdict,
    ) {
        let seen = visible(&seen.into()).into_owned();
        let row = Row { what, expected: expected.into(), seen, verdict };
        self.state_mut().report.rows.push(row.clone());
        self.output(Output::Row(row));
    }

    /// A row that is passed or failed.
    pub fn check(
        &self,
        what: &'static str,
        expected: impl Into<String>,
        seen: impl Into<String>,
        passed: bool,
    ) {
        let verdict = if passed { Verdict::Passed } else { Verdict::Failed };
        self.row(what, expected, seen, verdict);
    }

    pub fn skip(&self, what: &'static str, why: impl Into<String>) {
        self.row(what, "", why, Verdict::Skipped);
    }

    /// Waits until `found` returns something, at most until a time.
    pub async fn wait<T>(
        &self,
        until: Duration,
        mut found: impl FnMut(&mut State) -> Option<T>,
    ) -> Option<T> {
        poll_fn(|_| {
            let mut state = self.state_mut();
            match found(&mut state) {
                Some(found) => Poll::Ready(Some(found)),
                None if state.now >= until => Poll::Ready(None),
                None => Poll::Pending,
            }
        })
        .await
    }

    pub async fn pause(&self, time: Duration) {
        self.wait(self.now() + time, |_| None::<()>).await;
    }

    /// True if the adapter has seen errors on the bus since it was asked last. `None` if it does
    /// not say.
    pub async fn adapter_errors(&self) -> Option<bool> {
        self.state_mut().adapter_errors = None;
        self.output(Output::AskAdapter);
        let until = self.now() + Duration::from_millis(300);
        self.wait(until, |state| state.adapter_errors.take()).await
    }

    pub async fn question(&self, question: impl Into<String>) -> Answer {
        self.state_mut().answer = None;
        self.output(Output::Ask(question.into(), None));
        self.wait(Duration::MAX, |state| state.answer.take()).await.unwrap_or(Answer::Skip)
    }

    /// Asks, and returns true for yes.
    pub async fn is_allowed(&self, question: impl Into<String>) -> bool {
        self.question(question).await == Answer::Yes
    }

    /// Waits for a bit of the status code. Returns when it came.
    pub async fn code(&self, bit: u16, since: Duration, within_ms: u64) -> Option<Duration> {
        self.wait(since + Duration::from_millis(within_ms), |state| {
            let mut new = state.statuses.iter().filter(|status| status.at > since);
            new.find(|status| status.what.vendor_code & bit != 0).map(|status| status.at)
        })
        .await
    }

    /// Lets the user do something, and waits until `done` sees it. `None` if the user skips it, or
    /// does not do it in time.
    pub async fn hands<T>(
        &self,
        task: impl Into<String>,
        seconds: u64,
        mut done: impl FnMut(&mut State) -> Option<T>,
    ) -> Option<T> {
        self.state_mut().answer = None;
        self.output(Output::Ask(task.into(), Some(seconds)));
        let end = self.now() + Duration::from_secs(seconds);
        let result = self
            .wait(end, |state| match state.answer {
                Some(Answer::Skip | Answer::No) => Some(None),
                _ => done(state).map(Some),
            })
            .await;
        self.output(Output::Withdraw);
        result.flatten()
    }

    /// Sends a request, and returns its response. Repeats the request if none comes.
    ///
    /// # Errors
    /// If the node does not respond.
    pub async fn ask(&self, message: &Message) -> Result<Heard<Message>, String> {
        for _ in 0..ATTEMPTS {
            {
                let mut state = self.state_mut();
                let node = state.node;
                let id = state.tool.request(message, node).map(|id| id.get());
                let service = message.data_type().map(|data_type| data_type.id);
                state.expected = service.zip(id);
                state.response = None;
            }
            let until = self.now() + ANSWER_TIMEOUT;
            if let Some(response) = self.wait(until, |state| state.response.take()).await {
                return Ok(response);
            }
        }
        Err(format!("no response to {} in {ATTEMPTS} attempts", message.name()))
    }

    async fn parameter(&self, request: ParameterRequest) -> Result<ParameterResponse, String> {
        match self.ask(&Message::ParameterRequest(request)).await?.what {
            Message::ParameterResponse(response) => Ok(response),
            other => Err(format!("an unexpected response: {other}")),
        }
    }

    /// Reads a parameter by its number. One that is not there has no name.
    pub async fn parameter_at(&self, index: u16) -> Result<ParameterResponse, String> {
        self.parameter(ParameterRequest { index, ..ParameterRequest::default() }).await
    }

    /// Reads an integer parameter.
    pub async fn get(&self, name: &str) -> Result<i64, String> {
        self.get_set(name, Value::Empty).await
    }

    async fn get_set(&self, name: &str, value: Value) -> Result<i64, String> {
        let request = ParameterRequest { index: 0, value, name: name.into() };
        match self.parameter(request).await?.value {
            Value::Integer(value) => Ok(value),
            _ => Err(format!("the node has no {name}")),
        }
    }

    /// Sets a parameter that is put back at the end.
    pub async fn change(&self, name: &str, value: i64) -> Result<(), String> {
        let before = self.get(name).await?;
        let changed = {
            let mut state = self.state_mut();
            state.changed.values.entry(name.to_owned()).or_insert(before);
            state.changed.clone()
        };
        self.output(Output::Remember(changed));
        let set = self.get_set(name, Value::Integer(value)).await?;
        if set == value {
            Ok(())
        } else {
            Err(format!("{name} is {set} after it was set to {value}"))
        }
    }

    /// Saves the parameters. Returns the time between the response to a request before it, which
    /// the node has read at the same time, and that to the SAVE.
    pub async fn save(&self) -> Result<Duration, String> {
        {
            let mut state = self.state_mut();
            state.is_saved = true;
            let node = state.node;
            state.tool.request(&Message::ParameterRequest(ParameterRequest::default()), node);
            state.before = None;
        }
        let saved = self.ask(&Message::ExecuteOpcode(Opcode::SAVE)).await?;
        let before = self.state().before;
        match saved.what {
            Message::OpcodeExecuted(true) => {
                Ok(saved.by_adapter.saturating_sub(before.unwrap_or(saved.by_adapter)))
            }
            _ => Err("the node says that SAVE failed".into()),
        }
    }

    /// Puts back what was changed. Returns what that was.
    pub async fn put_back(&self) -> Result<String, String> {
        let (changed, is_saved) = {
            let state = self.state();
            (state.changed.clone(), state.is_saved)
        };
        for (name, value) in &changed.values {
            let set = self.get_set(name, Value::Integer(*value)).await?;
            if set != *value {
                return Err(format!("{name} is {set}, and was {value}"));
            }
        }
        if is_saved && !changed.values.is_empty() {
            self.save().await?;
        }
        let mut state = self.state_mut();
        state.changed.values.clear();
        state.is_saved = false;
        let now = Output::Remember(state.changed.clone());
        state.outputs.push(now);
        Ok(changed.to_string())
    }

    /// Updates the node with [`State::update`], to its end.
    pub async fn run_update(&self) -> Outcome {
        loop {
            let action = self
                .wait(Duration::MAX, |state| {
                    let now = state.now;
                    state.update.as_mut().and_then(|update| update.poll(now))
                })
                .await;
            let mut state = self.state_mut();
            match action {
                Some(Action::Request(message)) => {
                    let node = state.node;
                    state.tool.request(&message, node);
                }
                Some(Action::End(outcome)) => {
                    state.update = None;
                    return outcome;
                }
                None => {}
            }
        }
    }

    /// Sends a message to all nodes.
    pub fn broadcast(&self, message: &Message, source: NodeId) {
        self.state_mut().broadcast(message, source);
    }
}

/// Commands to a servo come 50 times a second.
const COMMAND_PERIOD: Duration = Duration::from_millis(20);
/// Priority of commands, as ArduPilot has it.
const PRIORITY: u8 = 8;

/// A time stamp of the adapter, and the two times that it stands for.
struct Stamp {
    us: u64,
    at: Duration,
    by_adapter: Duration,
}

/// Stamps in milliseconds begin again each minute, those in microseconds at 2^32.
const STAMP_PERIODS_US: [u64; 2] = [60_000_000, 1 << 32];

impl State {
    /// True if the adapter adds time stamps.
    pub fn has_stamps(&self) -> bool {
        self.stamp.is_some()
    }

    /// The adapter's time of a frame.
    fn by_adapter(&mut self, stamp_us: Option<u64>) -> Duration {
        let Some(us) = stamp_us else { return self.now };
        let by_adapter = match &self.stamp {
            Some(last) if self.now < last.at + Duration::from_secs(30) => {
                let period = STAMP_PERIODS_US[usize::from(last.us >= STAMP_PERIODS_US[0])];
                let passed = if us >= last.us { us - last.us } else { us + period - last.us };
                last.by_adapter + Duration::from_micros(passed)
            }
            _ => self.now,
        };
        self.stamp = Some(Stamp { us, at: self.now, by_adapter });
        by_adapter
    }

    /// Handles a frame of the bus. `stamp_us` is the adapter's time stamp, if it adds them.
    pub fn frame(&mut self, frame: &Frame, stamp_us: Option<u64>) {
        let by_adapter = self.by_adapter(stamp_us);
        if let dronecan_host::Id::Extended(id) = frame.id
            && let Some(source) = dronecan_host::CanId::parse(id).and_then(|id| id.source())
        {
            if source == self.node {
                self.frames.push(self.now);
            } else {
                self.others.insert(source);
            }
        }
        if let Some(transfer) = self.tool.receive(frame, self.now) {
            self.transfer(&transfer, by_adapter);
        }
    }

    fn transfer(&mut self, transfer: &Transfer, by_adapter: Duration) {
        let now = self.now;
        if let Some(update) = &mut self.update
            && let Some(answer) = update.take(transfer, now, self.tool.heard())
        {
            self.reads.push(by_adapter);
            self.tool.answer(transfer, &answer);
            return;
        }
        let source = transfer.id.source();
        let is_node = source == Some(self.node);
        match Message::decode(transfer) {
            Message::ArmingStatus(status) if status != 0 => self.armed_by = source,
            Message::ArrayCommand(_) | Message::RawCommand(_) | Message::HardpointCommand(_)
                if !is_node =>
            {
                self.commander = source;
            }
            Message::NodeStatus(what) if is_node => {
                self.statuses.push(Heard { at: now, by_adapter, what });
            }
            Message::Temperature(temperature) if is_node => {
                let what = temperature.celsius();
                self.temperatures.push(Heard { at: now, by_adapter, what });
            }
            Message::LogMessage(log) if is_node => {
                let text = String::from_utf8_lossy(&log.text).into_owned();
                self.lines.push((now, text));
            }
            what if is_node && what.is_request() == Some(false) => {
                let service = what.data_type().map(|data_type| data_type.id);
                if service.zip(Some(transfer.transfer_id.get())) == self.expected {
                    self.expected = None;
                    self.response = Some(Heard { at: now, by_adapter, what });
                } else {
                    self.before = Some(by_adapter);
                }
            }
            _ => {}
        }
    }

    /// Handles bytes of the serial port.
    pub fn serial(&mut self, bytes: &[u8]) {
        self.serial_bytes += bytes.len();
        for byte in bytes {
            if *byte == b'\n' || self.line.len() == LINE_MAX {
                let line = std::mem::take(&mut self.line);
                let text = String::from_utf8_lossy(&line).trim_end().to_owned();
                self.lines.push((self.now, text));
            } else {
                self.line.push(*byte);
            }
        }
    }

    /// The last NodeStatus.
    pub fn status(&self) -> Option<NodeStatus> {
        self.statuses.last().map(|status| status.what)
    }

    /// The first line since a time that contains a text.
    pub fn line_with(&self, since: Duration, text: &str) -> Option<String> {
        let mut lines = self.lines.iter().filter(|(at, _)| *at >= since);
        lines.find(|(_, line)| line.contains(text)).map(|(_, line)| line.clone())
    }

    fn broadcast(&mut self, message: &Message, source: NodeId) {
        if let Some((data_type, payload)) = message.encode() {
            self.transfer_id = self.transfer_id.wrapping_add(1);
            let id = data_type.message_id(PRIORITY, source);
            self.out.extend(frames(id, &payload, TransferId::new(self.transfer_id)));
        }
    }

    /// Sends NodeStatus and commands that are due, and hands over the frames for the bus.
    pub fn send(&mut self) {
        if !self.is_silent {
            self.tool.poll(self.now);
        }
        if let (Some((actuator, us)), Some(own)) = (self.command, self.tool.id())
            && self.now >= self.command_at
        {
            self.has_moved = true;
            self.command_at = self.now + COMMAND_PERIOD;
            let value = f16::from_f32(us);
            let command = ActuatorCommand { actuator, unit: CommandUnit::Pwm, value };
            self.broadcast(&Message::ArrayCommand(vec![command]), own);
        }
        self.out.extend(self.tool.take_frames());
    }
}
