//! The update of one node, from BeginFirmwareUpdate to the answer of the new program.
//!
//! Goals: the user learns the result for the node, and the reason. Every stage ends in bounded
//! time.
//!
//! | stage | ends with |
//! | --- | --- |
//! | [`Stage::Asking`] | the response of BeginFirmwareUpdate, or the first request of file.Read, because the response may be lost |
//! | [`Stage::Reading`] | the NodeStatus of the program after the last read, or of a bootloader that waits |
//! | [`Stage::Checking`] | the response of GetNodeInfo, which has the version of the running program |

use std::time::Duration;

use dronecan_host::management::NumberAndText;
use dronecan_host::{DataType, Message, Mode, NodeId, NodeInfo, NodeStatus, Transfer, types};

use crate::file::FirmwareFile;

/// The path of the file, so short that BeginFirmwareUpdate is a single frame.
const PATH: &[u8] = b"fw.bin";
/// Maximum length of the data in a response of file.Read (48.Read.uavcan).
const READ_LEN: usize = 256;

/// Errors of file.Read (file/Error.uavcan).
const OK: i16 = 0;
const NOT_FOUND: i16 = 2;

/// Errors of BeginFirmwareUpdate (40.BeginFirmwareUpdate.uavcan).
const ERROR_OK: u8 = 0;
const ERROR_INVALID_MODE: u8 = 1;
const ERROR_IN_PROGRESS: u8 = 2;

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
pub struct Session<'a> {
    pub node: NodeId,
    own_id: NodeId,
    file: &'a FirmwareFile,
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
    /// Bytes of the file that were sent, without gaps.
    sent: usize,
    outcome: Option<Outcome>,
}

impl<'a> Session<'a> {
    /// The update of a node that runs a program of version `before`.
    pub fn new(
        node: NodeId,
        before: (u8, u8),
        file: &'a FirmwareFile,
        own_id: NodeId,
        now: Duration,
    ) -> Session<'a> {
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
            outcome: None,
        }
    }

    /// Number of bytes of the file that the node has read.
    pub fn sent(&self) -> usize {
        self.sent
    }

    /// The stage in words.
    pub fn stage(&self) -> &'static str {
        match self.stage {
            Stage::Asking => "asking",
            Stage::Reading if self.is_all_sent() => "restarting",
            Stage::Reading => "reading",
            Stage::Checking => "checking",
        }
    }

    /// The state of the node if the program ends now, in words.
    pub fn state_if_ended_now(&self) -> &'static str {
        match self.stage {
            Stage::Reading if !self.is_all_sent() && self.sent > 0 => {
                "has no program now. Its bootloader waits for an update after about 40 s; the same \
                 command then updates it"
            }
            _ => "may not be updated. The same command tries again",
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
                return Some(self.fail("stopped reading and is silent: is its power on?"));
            }
            Stage::Reading if now > self.progressed + PROGRESS_LIMIT => {
                return Some(self.fail(if self.is_all_sent() {
                    "has read all of the file, but does not start it"
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
                _ => "runs a program, but does not answer GetNodeInfo",
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
    }

    /// Handles a transfer. Returns the payload of the response if it is a request of file.Read.
    pub fn take(&mut self, transfer: &Transfer, now: Duration) -> Option<Vec<u8>> {
        if transfer.id.source() != Some(self.node) {
            return None;
        }
        if DataType::of(transfer.id).is_some_and(|data_type| *data_type == types::FILE_READ) {
            return self.read(&transfer.payload, now);
        }
        match (self.stage, Message::decode(transfer)) {
            (Stage::Asking, Message::UpdateBegun(response)) => match response.number {
                ERROR_OK | ERROR_IN_PROGRESS => self.set_stage(Stage::Reading, now),
                ERROR_INVALID_MODE => {
                    self.outcome = Some(Outcome::Failed(format!("refuses: {}", response.text())))
                }
                error => {
                    self.outcome =
                        Some(Outcome::Failed(format!("error {error} {}", response.text())))
                }
            },
            (Stage::Reading, Message::NodeStatus(status)) => self.take_status(status, now),
            (Stage::Checking, Message::NodeInfo(info)) => {
                self.outcome = Some(self.check(&info, now));
            }
            _ => {}
        }
        None
    }

    /// Compares the program that runs with the file.
    fn check(&self, info: &NodeInfo, now: Duration) -> Outcome {
        let ((major, minor), (file_major, file_minor)) = (info.software, self.file.software);
        if info.software != self.file.software {
            return Outcome::Failed(format!(
                "runs version {major}.{minor}, and the file has {file_major}.{file_minor}"
            ));
        }
        if self.file.image_crc.is_some() && info.image_crc != self.file.image_crc {
            return Outcome::Failed(format!("runs another program of version {major}.{minor}"));
        }
        self.updated(now)
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
        match status.mode {
            Mode::SoftwareUpdate => self.heard = now,
            // Between the response and the first read, both the old program and the bootloader may
            // send these modes.
            _ if self.sent == 0 => {}
            Mode::Maintenance => {
                let text =
                    "waits in its bootloader: what it read is not a valid program. Try again";
                self.outcome = Some(Outcome::Failed(text.to_owned()));
            }
            _ if self.is_all_sent() => self.set_stage(Stage::Checking, now),
            _ => {
                let text = "runs its old program again: the bootloader rejected the file, or \
                            received no answer";
                self.outcome = Some(Outcome::Failed(text.to_owned()));
            }
        }
    }

    /// Answers file.Read: `offset u40 | path`, `error i16 | data`.
    fn read(&mut self, request: &[u8], now: Duration) -> Option<Vec<u8>> {
        let (offset, path) = request.split_first_chunk::<5>()?;
        let error = |error: i16| Some(error.to_le_bytes().to_vec());
        if path != PATH {
            return error(NOT_FOUND);
        }
        if self.stage == Stage::Asking {
            self.set_stage(Stage::Reading, now);
        }
        self.heard = now;
        let [b0, b1, b2, b3, b4] = *offset;
        let begin = usize::try_from(u64::from_le_bytes([b0, b1, b2, b3, b4, 0, 0, 0]))
            .unwrap_or(usize::MAX);
        let data = self.file.bytes.get(begin..).unwrap_or_default();
        let data = &data[..data.len().min(READ_LEN)];
        if begin <= self.sent && begin + data.len() > self.sent {
            self.sent = begin + data.len();
            self.progressed = now;
        }
        Some([&OK.to_le_bytes()[..], data].concat())
    }
}

#[cfg(test)]
mod tests;
