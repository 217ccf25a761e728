//! The update of one node, from BeginFirmwareUpdate to the answer of the new program.
//!
//! Goals: the user learns the result for the node, and the reason. Every stage ends in bounded
//! time. The result is what the node says of its program, not what was sent to it.
//!
//! | stage | ends with |
//! | --- | --- |
//! | [`Stage::Asking`] | the response of BeginFirmwareUpdate, or the first request of file.Read, because the response may be lost |
//! | [`Stage::Reading`] | the NodeStatus of a program, or of a bootloader that waits |
//! | [`Stage::Checking`] | the response of GetNodeInfo, which has the mode, and version and CRC of the program |
//!
//! A bootloader that reads for a program that was stopped reads on from this one, if that has its
//! node ID. Else it gives up after 30 to 40 seconds. If the node then has no program or another
//! one, the update begins again.

use std::rc::Rc;
use std::time::Duration;

use dronecan_host::management::NumberAndText;
use dronecan_host::{
    CanId, DataType, Message, Mode, NodeId, NodeInfo, NodeStatus, Transfer, types,
};

use crate::update::file::FirmwareFile;
use crate::update::heard::Heard;

/// The path of the file, so short that BeginFirmwareUpdate is a single frame.
pub const PATH: &[u8] = b"fw.bin";
/// Maximum length of the data in a response of file.Read (48.Read.uavcan).
const READ_LEN: usize = 256;

/// Errors of file.Read (file/Error.uavcan).
const OK: i16 = 0;
const NOT_FOUND: i16 = 2;

/// Errors of BeginFirmwareUpdate (40.BeginFirmwareUpdate.uavcan).
const ERROR_OK: u8 = 0;
const ERROR_INVALID_MODE: u8 = 1;
const ERROR_IN_PROGRESS: u8 = 2;

/// Why a node refuses that gives no reason: those of this project with the feature `update` do.
const NO_UPDATES: &str = "its program takes no update over the bus. Upload one with the feature \
                          \"update\" through the serial port (ATmega168: FEATURES=remote)";
/// Timeout of a request, and number of attempts.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);
const ATTEMPTS: u32 = 5;
/// A node must read a new part of the file, or restart after the last one, in this time. It is
/// longer than [`SILENCE_LIMIT`], so that a node that is silent is told from one that repeats
/// itself.
const PROGRESS_LIMIT: Duration = Duration::from_secs(60);
/// A bootloader stops after 20 to 40 seconds without an answer, and then needs a moment to check
/// its program.
const SILENCE_LIMIT: Duration = Duration::from_secs(45);

/// So many NodeStatus in a row with the mode of a program, or of a waiting bootloader, are what the
/// node does. One is not: the program before sends a last one after its response, and bootloaders
/// of the versions before 2.1 send one of MAINTENANCE before they restart.
const CERTAIN: u32 = 2;
/// Updates that begin again, because the node was in one that was broken off.
const BEGINS: u32 = 3;

/// The stage of an update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Asking,
    Reading,
    Checking,
}

/// The result of an update.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    Updated(String),
    Failed(String),
}

/// The next action.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    Request(Message),
    End(Outcome),
}

/// The update of one node.
pub struct Session {
    pub node: NodeId,
    own_id: NodeId,
    file: Rc<FirmwareFile>,
    /// Version of the program before the update.
    before: (u8, u8),
    stage: Stage,
    /// Times of the start and of the last relevant frame.
    began: Duration,
    heard: Duration,
    /// Time of the last new part of the file, or of the begin of the stage.
    progressed: Duration,
    /// Number of requests in this stage, and time of the next one.
    attempts: u32,
    ask_at: Duration,
    /// End of the last part of the file that was sent.
    sent: usize,
    /// True if the node has read the first part again, which it writes last.
    is_complete: bool,
    /// True if the node was already in an update, and read parts from another program.
    is_continued: bool,
    /// The node that the bootloader asks for the file, if it is another one, which is not there.
    lost_server: Option<NodeId>,
    /// Number of requests for an update that were accepted.
    begins: u32,
    /// Number of NodeStatus in a row of a waiting bootloader, and of a program.
    waiting: u32,
    running: u32,
    outcome: Option<Outcome>,
}

impl Session {
    /// The update of a node that runs a program of version `before`.
    pub fn new(
        node: NodeId,
        before: (u8, u8),
        file: Rc<FirmwareFile>,
        own_id: NodeId,
        now: Duration,
    ) -> Session {
        Session {
            node,
            own_id,
            file,
            before,
            stage: Stage::Asking,
            began: now,
            heard: now,
            progressed: now,
            attempts: 0,
            ask_at: now,
            sent: 0,
            is_complete: false,
            is_continued: false,
            lost_server: None,
            begins: 0,
            waiting: 0,
            running: 0,
            outcome: None,
        }
    }

    /// Number of bytes of the file.
    pub fn file_len(&self) -> usize {
        self.file.bytes.len()
    }

    /// Number of bytes up to the end of the last part that the node has read.
    pub fn sent(&self) -> usize {
        self.sent
    }

    /// The stage in words.
    pub fn stage(&self) -> &'static str {
        match self.stage {
            Stage::Asking => "asking",
            Stage::Reading if self.lost_server.is_some() => {
                "waiting until its bootloader gives up an update that was broken off"
            }
            Stage::Reading if self.is_all_sent() => "restarting",
            Stage::Reading => "reading",
            Stage::Checking => "checking",
        }
    }

    /// The state of the node if the program ends now, in words.
    pub fn state_if_ended_now(&self) -> &'static str {
        match self.stage {
            Stage::Checking => {
                "was not asked which program it has now. Updating it again does that"
            }
            _ if self.is_complete => {
                "has read all of the file, and restarts. Updating it again tells what it runs"
            }
            Stage::Reading if self.sent > 0 => {
                "has no program now. Its bootloader waits, and updating it again goes on from there"
            }
            _ => "has perhaps not begun the update. Try again",
        }
    }

    fn is_all_sent(&self) -> bool {
        self.sent == self.file.bytes.len()
    }

    /// Returns the action that is due: a request, or the end.
    pub fn poll(&mut self, now: Duration) -> Option<Action> {
        if let Some(outcome) = self.outcome.take() {
            return Some(Action::End(outcome));
        }
        let request = match self.stage {
            Stage::Reading if now > self.heard + SILENCE_LIMIT => {
                return Some(self.fail(if self.is_all_sent() {
                    "has read all of the file and is silent since: does its program speak DroneCAN?"
                } else {
                    "stopped reading and is silent: is its power on?"
                }));
            }
            Stage::Reading if now > self.progressed + PROGRESS_LIMIT => {
                return Some(self.fail(if self.is_complete {
                    "has read all of the file, but does not start it"
                } else if self.sent == 0 {
                    "accepted the update, but reads nothing from this program"
                } else {
                    "reads the same part of the file again and again"
                }));
            }
            Stage::Reading => return None,
            Stage::Asking => Message::BeginUpdate(NumberAndText {
                number: self.own_id.get(),
                text: PATH.to_vec(),
            }),
            Stage::Checking => Message::NodeInfoRequest,
        };
        if now < self.ask_at {
            return None;
        }
        if self.attempts == ATTEMPTS {
            return Some(self.fail(match self.stage {
                Stage::Asking => "does not answer BeginFirmwareUpdate",
                _ => "does not answer GetNodeInfo after the update",
            }));
        }
        self.attempts += 1;
        self.ask_at = now + ANSWER_TIMEOUT;
        Some(Action::Request(request))
    }

    fn fail(&self, text: &str) -> Action {
        Action::End(Outcome::Failed(text.to_owned()))
    }

    fn set_stage(&mut self, stage: Stage, now: Duration) {
        (self.stage, self.attempts, self.ask_at) = (stage, 0, now);
        (self.heard, self.progressed) = (now, now);
        (self.waiting, self.running) = (0, 0);
    }

    /// Begins to wait for requests of file.Read.
    fn await_reads(&mut self, is_continued: bool, now: Duration) {
        self.is_continued = is_continued;
        self.begins += 1;
        self.set_stage(Stage::Reading, now);
    }

    /// Begins again, if the update was one that another program had begun, or that the node has not
    /// begun. Returns false if not.
    fn begins_again(&mut self, now: Duration) -> bool {
        let may = (self.is_continued || self.sent == 0) && self.begins < BEGINS;
        if may {
            (self.sent, self.is_complete) = (0, false);
            self.lost_server = None;
            self.set_stage(Stage::Asking, now);
        }
        may
    }

    /// Handles a transfer. Returns the payload of the response if it is a request of file.Read to
    /// this program.
    pub fn take(&mut self, transfer: &Transfer, now: Duration, heard: &Heard) -> Option<Vec<u8>> {
        if transfer.id.source() != Some(self.node) {
            return None;
        }
        if let Some(server) = server_asked(transfer) {
            if server == self.own_id {
                return self.read(&transfer.payload, now);
            }
            if heard.is_on_bus(server, now) {
                self.outcome = Some(Outcome::Failed(another_update(server)));
            } else {
                (self.heard, self.lost_server) = (now, Some(server));
            }
            return None;
        }
        match (self.stage, Message::decode(transfer)) {
            (Stage::Asking, Message::UpdateBegun(response)) => match response.number {
                ERROR_OK => self.await_reads(false, now),
                ERROR_IN_PROGRESS => self.await_reads(true, now),
                ERROR_INVALID_MODE => {
                    let text = response.text();
                    let why = if text.is_empty() { NO_UPDATES } else { &text };
                    let advice = match text.starts_with("armed") {
                        true => ": disarm it, stop the commands, and try again",
                        false => "",
                    };
                    self.outcome = Some(Outcome::Failed(format!("refuses: {why}{advice}")))
                }
                error => {
                    self.outcome =
                        Some(Outcome::Failed(format!("error {error} {}", response.text())))
                }
            },
            (Stage::Reading, Message::NodeStatus(status)) => self.take_status(status, now),
            (Stage::Checking, Message::NodeInfo(info)) => {
                self.outcome = self.check(&info, now);
            }
            _ => {}
        }
        None
    }

    /// Compares the node's program with the file. Returns `None` if the update goes on.
    fn check(&mut self, info: &NodeInfo, now: Duration) -> Option<Outcome> {
        let ((major, minor), (file_major, file_minor)) = (info.software, self.file.software);
        let is_same_version = info.software == self.file.software;
        let has_file = is_same_version
            && match self.file.image_crc {
                Some(_) => info.image_crc == self.file.image_crc,
                None => self.is_complete,
            };
        let waits = info.status.mode == Mode::Maintenance;
        if info.status.mode == Mode::SoftwareUpdate {
            self.set_stage(Stage::Reading, now);
            return None;
        }
        if has_file && !waits {
            return Some(self.updated(now));
        }
        if !has_file && self.begins_again(now) {
            return None;
        }
        Some(Outcome::Failed(if waits && has_file {
            "has the program of the file, but its bootloader does not start it, because the \
             watchdog has restarted it three times. After a reset it starts"
                .to_owned()
        } else if waits && self.is_complete {
            "waits in its bootloader: what it read is not a valid program. Try again".to_owned()
        } else if waits {
            "waits in its bootloader: it has not read all of the file. Try again".to_owned()
        } else if !self.is_complete {
            format!(
                "runs version {major}.{minor}, which is not the file: the bootloader rejected the \
                 file, or received no answer"
            )
        } else if !is_same_version {
            format!("runs version {major}.{minor}, and the file has {file_major}.{file_minor}")
        } else {
            format!("runs another program of version {major}.{minor}")
        }))
    }

    fn updated(&self, now: Duration) -> Outcome {
        let seconds = (now - self.began).as_secs_f32();
        let (major, minor) = self.file.software;
        // A bootloader without a program has the version 0.0.
        let before = match self.before {
            (0, 0) => String::new(),
            (major, minor) => format!(", before {major}.{minor}"),
        };
        Outcome::Updated(format!("runs version {major}.{minor}{before}; {seconds:.1} s"))
    }

    /// The mode shows what runs: the bootloader reads (SOFTWARE_UPDATE) or waits (MAINTENANCE), or
    /// a program runs.
    fn take_status(&mut self, status: NodeStatus, now: Duration) {
        let (waiting, running) = (self.waiting, self.running);
        (self.waiting, self.running) = (0, 0);
        match status.mode {
            Mode::SoftwareUpdate => self.heard = now,
            Mode::Maintenance => self.waiting = waiting + 1,
            _ => self.running = running + 1,
        }
        // A program after a read is not the one before.
        let has_restarted = self.running > 0 && self.sent > 0;
        if has_restarted || self.running == CERTAIN || self.waiting == CERTAIN {
            self.set_stage(Stage::Checking, now);
        }
    }

    /// Answers file.Read: `offset u40 | path`, `error i16 | data`.
    fn read(&mut self, request: &[u8], now: Duration) -> Option<Vec<u8>> {
        let (offset, path) = request.split_first_chunk::<5>()?;
        let error = |error: i16| Some(error.to_le_bytes().to_vec());
        if path != PATH {
            return error(NOT_FOUND);
        }
        if self.stage != Stage::Reading {
            self.await_reads(self.is_continued, now);
        }
        (self.heard, self.lost_server) = (now, None);
        let [b0, b1, b2, b3, b4] = *offset;
        let begin = usize::try_from(u64::from_le_bytes([b0, b1, b2, b3, b4, 0, 0, 0]))
            .unwrap_or(usize::MAX);
        let data = self.file.bytes.get(begin..).unwrap_or_default();
        let data = &data[..data.len().min(READ_LEN)];
        self.is_continued |= self.sent == 0 && begin > 0;
        if begin == 0 && self.is_all_sent() && !self.is_complete {
            self.is_complete = true;
            self.progressed = now;
        }
        if !data.is_empty() && begin + data.len() > self.sent {
            self.sent = begin + data.len();
            self.progressed = now;
        }
        Some([&OK.to_le_bytes()[..], data].concat())
    }
}

/// The node that this request of file.Read is to.
pub fn server_asked(transfer: &Transfer) -> Option<NodeId> {
    let is_read = DataType::of(transfer.id).is_some_and(|data_type| *data_type == types::FILE_READ);
    match transfer.id {
        CanId::Service { request: true, destination, .. } if is_read => Some(destination),
        _ => None,
    }
}

/// Why a node is not updated that reads a file from another node.
pub fn another_update(server: NodeId) -> String {
    format!("another update is under way: node {server} sends a file")
}

#[cfg(test)]
mod tests;
