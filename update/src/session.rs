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
use dronecan_host::{DataType, Message, Mode, NodeId, NodeStatus, Transfer, types};

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
        (self.stage, self.attempts, self.ask_at, self.heard) = (stage, 0, now, now);
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
                self.outcome = Some(if info.software == self.file.software {
                    self.updated(now)
                } else {
                    let ((major, minor), (file_major, file_minor)) =
                        (info.software, self.file.software);
                    Outcome::Failed(format!(
                        "runs version {major}.{minor}, and the file has {file_major}.{file_minor}"
                    ))
                });
            }
            _ => {}
        }
        None
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
        if begin <= self.sent {
            self.sent = self.sent.max(begin + data.len());
        }
        Some([&OK.to_le_bytes()[..], data].concat())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::file::tests::file_of;
    use dronecan_host::{CanId, NodeInfo, TransferId};

    fn id(id: u8) -> NodeId {
        NodeId::new(id).unwrap()
    }

    fn seconds(seconds: f32) -> Duration {
        Duration::from_secs_f32(seconds)
    }

    fn session(file: &FirmwareFile) -> Session<'_> {
        Session::new(id(120), (1, 2), file, id(125), Duration::ZERO)
    }

    fn transfer(can_id: CanId, payload: Vec<u8>) -> Transfer {
        Transfer { id: can_id, transfer_id: TransferId::new(0), payload, frames: 1 }
    }

    /// A service transfer of node 120.
    fn service(service_id: u8, request: bool, payload: Vec<u8>) -> Transfer {
        transfer(
            CanId::Service {
                priority: 16,
                service_id,
                request,
                destination: id(125),
                source: id(120),
            },
            payload,
        )
    }

    fn status(mode: Mode) -> Transfer {
        let payload = NodeStatus { mode, ..NodeStatus::default() }.encode();
        transfer(CanId::Message { priority: 20, type_id: 341, source: id(120) }, payload)
    }

    fn read(session: &mut Session, offset: u16) -> Vec<u8> {
        let [low, high] = offset.to_le_bytes();
        session
            .take(&service(48, true, [&[low, high, 0, 0, 0][..], b"fw.bin"].concat()), seconds(2.0))
            .unwrap()
    }

    fn begin(session: &mut Session, number: u8, text: &[u8]) {
        assert!(matches!(
            session.poll(Duration::ZERO),
            Some(Action::Request(Message::BeginUpdate(_)))
        ));
        let response = NumberAndText { number, text: text.to_vec() }.encode();
        assert_eq!(session.take(&service(40, false, response), seconds(0.1)), None);
    }

    #[track_caller]
    fn failed(session: &mut Session, now: f32, text: &str) {
        match session.poll(seconds(now)) {
            Some(Action::End(Outcome::Failed(why))) => assert!(why.contains(text), "{why}"),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_node_that_reads_the_file_and_runs_it_is_updated() {
        let file = file_of(600);
        let mut session = session(&file);
        begin(&mut session, ERROR_OK, b"");
        session.take(&status(Mode::Operational), seconds(0.2));
        let answers: Vec<_> = [0, 256, 512].map(|offset| read(&mut session, offset)).to_vec();
        assert_eq!(answers.iter().map(Vec::len).collect::<Vec<_>>(), [258, 258, 90]);
        assert_eq!(
            answers.iter().flat_map(|answer| &answer[2..]).copied().collect::<Vec<_>>(),
            file.bytes
        );
        assert_eq!((session.sent(), session.stage()), (600, "restarting"));
        session.take(&status(Mode::SoftwareUpdate), seconds(2.5));
        assert_eq!(session.poll(seconds(2.6)), None);
        session.take(&status(Mode::Operational), seconds(3.0));
        assert_eq!(session.poll(seconds(3.0)), Some(Action::Request(Message::NodeInfoRequest)));
        let info: NodeInfo = NodeInfo { software: (1, 3), ..NodeInfo::default() };
        session.take(&service(1, false, info.encode()), seconds(3.5));
        let text = "runs version 1.3, before 1.2; 3.5 s".to_owned();
        assert_eq!(session.poll(seconds(3.5)), Some(Action::End(Outcome::Updated(text))));
    }

    #[test]
    fn a_node_s_reason_for_a_rejection_is_reported() {
        let file = file_of(600);
        let mut session = session(&file);
        begin(&mut session, ERROR_INVALID_MODE, b"armed, or a command in the last 2 s");
        failed(&mut session, 0.1, "refuses: armed, or a command");
    }

    #[test]
    fn a_silent_node_gets_five_requests() {
        let file = file_of(600);
        let mut session = session(&file);
        let asked = (0..50).filter(|n| session.poll(seconds(0.1 * *n as f32)).is_some()).count();
        assert_eq!(asked, 5);
        failed(&mut session, 5.1, "does not answer BeginFirmwareUpdate");
    }

    #[test]
    fn a_lost_response_does_not_matter_if_the_node_reads() {
        let file = file_of(600);
        let mut session = session(&file);
        assert!(session.poll(Duration::ZERO).is_some());
        read(&mut session, 0);
        assert_eq!((session.poll(seconds(3.0)), session.stage()), (None, "reading"));
    }

    #[test]
    fn a_node_in_its_bootloader_or_old_program_counts_as_not_updated() {
        let file = file_of(600);
        for (mode, text) in [
            (Mode::Maintenance, "waits in its bootloader"),
            (Mode::Operational, "runs its old program"),
        ] {
            let mut session = session(&file);
            begin(&mut session, ERROR_OK, b"");
            read(&mut session, 0);
            session.take(&status(mode), seconds(3.0));
            failed(&mut session, 3.0, text);
        }
    }

    #[test]
    fn an_update_of_a_silent_node_fails_after_the_bootloader_s_timeout() {
        let file = file_of(600);
        let mut session = session(&file);
        begin(&mut session, ERROR_IN_PROGRESS, b"");
        read(&mut session, 0);
        session.take(&status(Mode::SoftwareUpdate), seconds(30.0));
        assert_eq!(session.poll(seconds(74.0)), None);
        failed(&mut session, 76.0, "silent");
    }

    #[test]
    fn an_update_to_another_version_fails() {
        let file = file_of(300);
        let mut session = session(&file);
        begin(&mut session, ERROR_OK, b"");
        read(&mut session, 0);
        read(&mut session, 256);
        session.take(&status(Mode::Operational), seconds(3.0));
        session.take(&service(1, false, NodeInfo::<NodeStatus>::default().encode()), seconds(3.1));
        failed(&mut session, 3.2, "runs version 0.0, and the file has 1.3");
    }

    #[test]
    fn requests_of_other_nodes_or_for_other_files_are_not_answered() {
        let file = file_of(300);
        let mut session = session(&file);
        begin(&mut session, ERROR_OK, b"");
        let request = [&[0; 5][..], b"other.bin"].concat();
        assert_eq!(session.take(&service(48, true, request), seconds(1.0)), Some(vec![2, 0]));
        let other = CanId::Service {
            priority: 16,
            service_id: 48,
            request: true,
            destination: id(125),
            source: id(121),
        };
        assert_eq!(
            session.take(&transfer(other, [&[0; 5][..], b"fw.bin"].concat()), seconds(1.0)),
            None
        );
        assert_eq!(session.sent(), 0);
    }
}
