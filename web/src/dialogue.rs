//! What a tool asks one node, one request after the other: its information and its parameters, to
//! set, save and erase them, also from a file, and to restart. Without I/O: messages and the time
//! in, requests out.

use std::collections::VecDeque;
use std::time::Duration;

use bench::dronecan::{
    CanId, Message, NodeInfo, Opcode, ParameterRequest, ParameterResponse, RESTART_MAGIC, Transfer,
    TransferId, Value,
};
use serde_json::{Value as Json, json};

use crate::parameter_file::{self, Loading};

/// Time without an answer after which a request is repeated. A SAVE of eight outputs is answered
/// after 0.95 s.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(1500);
/// Requests are sent this often before the tool gives up.
const ATTEMPTS: u32 = 4;
/// Maximum number of parameters of a node: more than any has, and few enough to show.
const PARAMETERS_MAX: usize = 2000;
/// Maximum number of requests that wait.
const QUEUE_MAX: usize = 2000;
/// Maximum length of a parameter's text (param.Value).
const TEXT_MAX: usize = 128;

/// A request that waits for its answer.
struct Pending {
    message: Message,
    /// `None` until it is sent.
    transfer_id: Option<TransferId>,
    sent_at: Duration,
    attempts: u32,
}

/// What the tool asks, and what it knows.
#[derive(Default)]
pub struct Dialogue {
    queue: VecDeque<Message>,
    pending: Option<Pending>,
    /// True while the tool reads parameters by index, up to the first that does not exist.
    reads_all: bool,
    /// Parameters in the order of their indices.
    pub parameters: Vec<ParameterResponse>,
    pub info: Option<NodeInfo>,
    /// A file whose parameters the node gets.
    loading: Option<Loading>,
    /// What of the last file the node has not, and why.
    problems: Vec<String>,
    /// What happened last, in words; empty before the first request.
    pub message: String,
}

impl Dialogue {
    /// True while a request waits for its answer, or to be sent.
    pub fn is_busy(&self) -> bool {
        self.pending.is_some() || !self.queue.is_empty() || self.loading.is_some()
    }

    /// Queues a request. Too many are dropped.
    pub fn request(&mut self, message: Message) {
        if self.queue.len() < QUEUE_MAX {
            self.queue.push_back(message);
        }
    }

    /// Reads the node's information and all its parameters, unless it does already.
    pub fn read_all(&mut self) {
        if self.reads_all {
            return;
        }
        self.parameters.clear();
        self.reads_all = true;
        self.request(Message::NodeInfoRequest);
        self.request(read(0));
    }

    /// Sets a parameter.
    pub fn set(&mut self, name: &str, value: Value) {
        let known = self.parameters.iter().find(|parameter| parameter.name() == name);
        let name = known.map_or_else(|| name.into(), |parameter| parameter.name.clone());
        self.request(Message::ParameterRequest(ParameterRequest { index: 0, value, name }));
    }

    /// Sets a parameter that was read to the value that the user wrote.
    ///
    /// # Errors
    /// If the text is no value of its type; the text says what would be.
    pub fn set_written(&mut self, name: &str, text: &str) -> Result<(), String> {
        let known = self.parameters.iter().find(|parameter| parameter.name() == name);
        let Some(known) = known else { return Err(format!("{name} is not read yet")) };
        let text = text.trim();
        let value = match known.value {
            Value::Integer(_) => text.parse().map(Value::Integer).map_err(|_| "a whole number"),
            Value::Real(_) => text.parse().map(Value::Real).map_err(|_| "a number"),
            Value::Boolean(_) => text.parse().map(Value::Boolean).map_err(|_| "true or false"),
            Value::Text(_) if text.len() > TEXT_MAX => Err("a text of at most 128 bytes"),
            Value::Text(_) => Ok(Value::Text(text.into())),
            Value::Empty => Err("no value"),
        };
        let value = value.map_err(|what| format!("{name} takes {what}, not \"{text}\""))?;
        self.set(name, value);
        Ok(())
    }

    /// Reads all parameters and sets those that differ in a file. `others` are the node IDs of
    /// other nodes.
    ///
    /// # Errors
    /// If the file has no parameters, or another request waits.
    pub fn load(&mut self, file: &str, others: Vec<u8>) -> Result<(), String> {
        if self.is_busy() {
            return Err(String::from("the node has not answered yet: try again"));
        }
        self.loading = Some(Loading::new(file, others)?);
        self.problems.clear();
        self.read_all();
        Ok(())
    }

    /// A file with the parameters that were read.
    pub fn file(&self, title: &str) -> String {
        parameter_file::write(title, &self.parameters)
    }

    /// Sets the next parameter of the file.
    fn load_next(&mut self) {
        let next = self.loading.as_mut().and_then(Loading::next_to_set);
        match (next, self.loading.take()) {
            (Some((name, value)), loading) => {
                self.loading = loading;
                self.set(&name, value);
            }
            (None, Some(loading)) => {
                self.message = loading.summary();
                self.problems = loading.problems();
            }
            (None, None) => {}
        }
    }

    /// Drops all that waits, because of `why`.
    fn give_up(&mut self, why: &str) {
        self.message = why.into();
        self.queue.clear();
        (self.pending, self.reads_all) = (None, false);
        if let Some(mut loading) = self.loading.take() {
            loading.abandon();
            self.message += &format!("; {}", loading.summary());
            self.problems = loading.problems();
        }
    }

    /// Saves all parameters, or erases the saved ones.
    pub fn execute(&mut self, opcode: Opcode) {
        self.request(Message::ExecuteOpcode(opcode));
    }

    /// Restarts the node.
    pub fn restart(&mut self) {
        self.request(Message::RestartNode(RESTART_MAGIC));
    }

    /// Drops the requests that wait, and keeps what was read.
    pub fn cancel(&mut self) {
        if self.is_busy() {
            self.give_up("stopped");
        }
    }

    /// Returns the request that is due. Tell its transfer ID to [`Dialogue::sent`].
    pub fn poll(&mut self, now: Duration) -> Option<Message> {
        let is_late = |pending: &mut Pending| now >= pending.sent_at + ANSWER_TIMEOUT;
        if let Some(pending) = self.pending.take_if(is_late) {
            if pending.attempts < ATTEMPTS {
                return Some(self.ask(pending.message, now, pending.attempts + 1));
            }
            self.give_up(&format!("no answer to {}", pending.message));
        }
        if self.pending.is_some() {
            return None;
        }
        let message = self.queue.pop_front()?;
        Some(self.ask(message, now, 1))
    }

    fn ask(&mut self, message: Message, sent_at: Duration, attempts: u32) -> Message {
        let request = message.clone();
        self.pending = Some(Pending { message, transfer_id: None, sent_at, attempts });
        request
    }

    /// Notes the transfer ID of the request that [`Dialogue::poll`] returned. Without one it could
    /// not be sent.
    pub fn sent(&mut self, transfer_id: Option<TransferId>) {
        match &mut self.pending {
            Some(pending) if transfer_id.is_some() => pending.transfer_id = transfer_id,
            _ => self.give_up("the request cannot be sent"),
        }
    }

    /// Handles a transfer of the node to the tool.
    pub fn take(&mut self, transfer: &Transfer) {
        let is_response = matches!(transfer.id, CanId::Service { request: false, .. });
        let is_answer = |pending: &mut Pending| pending.transfer_id == Some(transfer.transfer_id);
        if is_response && let Some(Pending { message, .. }) = self.pending.take_if(is_answer) {
            self.answer(message, Message::decode(transfer));
        }
    }

    fn answer(&mut self, message: Message, answer: Message) {
        self.message = in_words(&message, &answer);
        match (message, answer) {
            (Message::ParameterRequest(request), Message::ParameterResponse(response)) => {
                self.take_parameter(&request, response);
            }
            (_, Message::NodeInfo(info)) => self.info = Some(*info),
            _ => {}
        }
    }

    fn take_parameter(&mut self, request: &ParameterRequest, response: ParameterResponse) {
        let is_next = self.reads_all && request.name.is_empty();
        let known = self.parameters.iter_mut().find(|known| known.name == response.name);
        if response.name.is_empty() {
            self.reads_all = false;
            self.message = format!("{} parameters read", self.parameters.len());
            if let Some(loading) = &mut self.loading {
                loading.begin(&self.parameters);
                self.load_next();
            }
        } else if let Some(known) = known {
            if !request.value.is_empty() && response.value != request.value {
                let (name, asked) = (response.name(), &request.value);
                self.message = format!(
                    "{name} is not {asked}: the node rejected it. Some parameters change only \
                     while the vehicle is disarmed"
                );
            }
            *known = response.clone();
            let is_of_file =
                |loading: &mut Loading| loading.answered(&response.name(), &response.value);
            if is_next {
                self.give_up(&format!("the node tells {} twice: not read on", response.name()));
            } else if self.loading.as_mut().is_some_and(is_of_file) {
                self.load_next();
            }
        } else if self.parameters.len() == PARAMETERS_MAX {
            self.give_up(&format!("more than {PARAMETERS_MAX} parameters: not read on"));
        } else {
            self.parameters.push(response);
            if is_next {
                self.queue.push_front(read(request.index + 1));
            }
        }
    }

    /// What the page shows, a JSON object.
    pub fn json(&self) -> Json {
        let parameters = self.parameters.iter().map(|parameter| {
            json!({
                "name": parameter.name(),
                "kind": kind(&parameter.value),
                "value": written(&parameter.value),
                "min": written(&parameter.min),
                "max": written(&parameter.max),
                "default": written(&parameter.default),
            })
        });
        json!({
            "busy": self.is_busy(),
            "message": self.message,
            "problems": self.problems,
            "info": self.info.as_ref().map(ToString::to_string),
            "parameters": parameters.collect::<Json>(),
        })
    }
}

/// What an answer means to the user.
fn in_words(request: &Message, answer: &Message) -> String {
    let (done, what) = match (request, answer) {
        (_, Message::ParameterResponse(parameter)) => {
            return format!("{} = {}", parameter.name(), parameter.value);
        }
        (_, Message::NodeInfo(info)) => return format!("{}, reading", info.name()),
        (Message::ExecuteOpcode(Opcode::SAVE), Message::OpcodeExecuted(done)) => {
            (done, "saved: the node keeps its parameters without power")
        }
        (Message::ExecuteOpcode(_), Message::OpcodeExecuted(done)) => {
            (done, "erased: the node has its defaults, and keeps them")
        }
        (_, Message::Restarting(done)) => (done, "the node restarts"),
        _ => return answer.to_string(),
    };
    let refused = "the node refused: disarm the vehicle, then press again";
    String::from(if *done { what } else { refused })
}

fn read(index: u16) -> Message {
    Message::ParameterRequest(ParameterRequest { index, ..ParameterRequest::default() })
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Empty => "none",
        Value::Integer(_) => "integer",
        Value::Real(_) => "real",
        Value::Boolean(_) => "boolean",
        Value::Text(_) => "text",
    }
}

/// A value as a user writes it; `None` if there is none.
fn written(value: &Value) -> Option<String> {
    match value {
        Value::Empty => None,
        Value::Text(text) => Some(text.escape_ascii().to_string()),
        other => Some(other.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench::dronecan::NodeId;

    const SECOND: Duration = Duration::from_secs(1);

    fn node(id: u8) -> NodeId {
        NodeId::new(id).unwrap()
    }

    fn response(service_id: u8, transfer_id: u8, payload: Vec<u8>) -> Transfer {
        let (source, destination) = (node(42), node(126));
        let id = CanId::Service { priority: 16, service_id, request: false, destination, source };
        Transfer { id, transfer_id: TransferId::new(transfer_id), payload, frames: 1 }
    }

    /// Answers requests for parameters with those of `names`, by index, until none is due.
    fn answer(dialogue: &mut Dialogue, names: impl Fn(u16) -> String) -> usize {
        let mut count = 0;
        while let Some(message) = dialogue.poll(SECOND) {
            let id = TransferId::new(count as u8);
            dialogue.sent(Some(id));
            count += 1;
            let transfer = match message {
                Message::ParameterRequest(request) => {
                    let answer = ParameterResponse {
                        value: Value::Integer(request.index.into()),
                        name: names(request.index).into(),
                        ..ParameterResponse::default()
                    };
                    response(11, id.get(), answer.encode())
                }
                _ => response(
                    1,
                    id.get(),
                    NodeInfo::<bench::dronecan::NodeStatus>::default().encode(),
                ),
            };
            dialogue.take(&transfer);
        }
        count
    }

    #[test]
    fn a_node_that_never_ends_its_parameters_is_read_up_to_a_limit() {
        let mut dialogue = Dialogue::default();
        dialogue.read_all();
        answer(&mut dialogue, |index| format!("P{index}"));
        assert_eq!(dialogue.parameters.len(), PARAMETERS_MAX);
        assert!(dialogue.message.contains("more than 2000 parameters"), "{}", dialogue.message);
        dialogue.read_all();
        answer(&mut dialogue, |_| String::from("SAME"));
        assert_eq!(dialogue.message, "the node tells SAME twice: not read on");
        assert!(!dialogue.is_busy());
    }

    /// What is said of a request is for a user, who may have to disarm.
    #[test]
    fn the_answer_to_a_save_is_in_words() {
        let said = |opcode, done| {
            in_words(&Message::ExecuteOpcode(opcode), &Message::OpcodeExecuted(done))
        };
        assert!(said(Opcode::SAVE, true).starts_with("saved: "));
        assert!(said(Opcode::ERASE, true).starts_with("erased: "));
        assert_eq!(
            said(Opcode::ERASE, false),
            "the node refused: disarm the vehicle, then press again"
        );
    }

    #[test]
    fn a_request_without_an_answer_is_sent_four_times() {
        let mut dialogue = Dialogue::default();
        dialogue.restart();
        let mut sent = 0;
        for now in 0..100 {
            if dialogue.poll(SECOND * now / 10).is_some() {
                dialogue.sent(Some(TransferId::new(sent)));
                sent += 1;
            }
        }
        assert_eq!(sent, 4);
        assert!(dialogue.message.starts_with("no answer to RestartNode"), "{}", dialogue.message);
        assert!(!dialogue.is_busy());
    }

    #[test]
    fn what_a_user_writes_is_read_by_the_type_of_the_parameter() {
        let values = [
            ("I", Value::Integer(1), "-5", Some(Value::Integer(-5))),
            ("I", Value::Integer(1), "1.5", None),
            ("I", Value::Integer(1), "9007199254740993", Some(Value::Integer(9007199254740993))),
            ("R", Value::Real(1.0), "1.5", Some(Value::Real(1.5))),
            ("B", Value::Boolean(true), "false", Some(Value::Boolean(false))),
            ("B", Value::Boolean(true), "2", None),
            ("T", Value::Text(b"a".to_vec()), "b c", Some(Value::Text(b"b c".to_vec()))),
            ("E", Value::Empty, "1", None),
        ];
        for (name, value, text, expected) in values {
            let mut dialogue = Dialogue::default();
            let known = ParameterResponse { value, name: name.into(), ..Default::default() };
            dialogue.parameters.push(known);
            let result = dialogue.set_written(name, text);
            assert_eq!(result.is_ok(), expected.is_some(), "{name} {text}: {result:?}");
            let asked = dialogue.poll(SECOND).map(|message| match message {
                Message::ParameterRequest(request) => request.value,
                other => panic!("{other}"),
            });
            assert_eq!(asked, expected);
        }
    }
}
