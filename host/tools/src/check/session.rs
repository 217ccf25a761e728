//! The checks of a board as a state machine: frames, serial bytes, answers and the time in; frames,
//! questions and rows out.
//!
//! Goals: each defect has its row, and a healthy board has no failed one. All that the checks
//! change is put back, however they end.
//!
//! The stages: the checks; then what they have changed is put back, also after a signal, when the
//! vehicle is armed, and when the adapter was lost and is back.

use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Waker};
use std::time::Duration;

use crate::update::session::Outcome;
use dronecan_host::{Frame, Message, RESTART_MAGIC};

pub use crate::check::board::Plan;
use crate::check::checks;
use crate::check::desk::{Answer, Changed, Desk, Output};
use crate::check::report::Report;

/// How long the node has to answer before the program gives up to put something back.
const PUT_BACK_WITHIN: Duration = Duration::from_secs(20);
/// The same after the adapter was lost: somebody plugs it in again.
const PLUGGED_WITHIN: Duration = Duration::from_secs(60);

#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    Checks,
    PuttingBack,
    Done,
}

/// The checks of a board.
pub struct Session {
    desk: Desk,
    job: Pin<Box<dyn Future<Output = ()>>>,
    stage: Stage,
    is_lost: bool,
}

impl Session {
    /// The checks of a board. `left` is what an earlier run has not put back.
    pub fn new(plan: Plan, left: Changed) -> Session {
        let desk = Desk::new(plan.node, left);
        let job = Box::pin(checks::all(desk.clone(), plan));
        Session { desk, job, stage: Stage::Checks, is_lost: false }
    }

    /// Handles a frame of the bus. `stamp_us` is the time stamp of the adapter, if it adds them.
    pub fn frame(&mut self, frame: &Frame, now: Duration, stamp_us: Option<u64>) {
        let mut state = self.desk.state_mut();
        state.now = now;
        state.frame(frame, stamp_us);
    }

    /// Handles bytes of the serial port.
    pub fn serial(&mut self, bytes: &[u8], now: Duration) {
        let mut state = self.desk.state_mut();
        state.now = now;
        state.serial(bytes);
    }

    /// The adapter says whether it has seen errors on the bus since it was asked last.
    pub fn adapter_errors(&mut self, has_seen: bool) {
        self.desk.state_mut().adapter_errors = Some(has_seen);
    }

    /// The answer to the last question.
    pub fn answer(&mut self, answer: Answer) {
        self.desk.state_mut().answer = Some(answer);
    }

    /// The recording of the pins, or why there is none.
    pub fn recorded(&mut self, recording: Result<String, String>) {
        self.desk.state_mut().recording = Some(recording);
    }

    /// Ends the checks, and puts back what they have changed. `is_lost` if the adapter or the
    /// serial port is lost.
    pub fn stop(&mut self, why: &str, is_lost: bool) {
        self.is_lost |= is_lost;
        if self.stage == Stage::Checks {
            self.desk.state_mut().report.ended = Some(why.to_owned());
            self.desk.output(Output::Withdraw);
            self.put_back();
        }
    }

    fn put_back(&mut self) {
        self.stage = Stage::PuttingBack;
        let within = if self.is_lost { PLUGGED_WITHIN } else { PUT_BACK_WITHIN };
        self.job = Box::pin(put_back(self.desk.clone(), within));
    }

    /// Goes on. `waiting` is the number of frames that the adapter has not taken yet.
    pub fn poll(&mut self, now: Duration, waiting: usize) {
        {
            let mut state = self.desk.state_mut();
            state.now = now;
            state.waiting = waiting;
        }
        let armed_by = self.desk.state().armed_by;
        if let (Some(by), Stage::Checks) = (armed_by, self.stage) {
            self.desk.check(
                "Vehicle",
                "disarmed",
                format!("armed, says node {by}: disarm it before the checks"),
                false,
            );
            self.stop("the vehicle is armed", false);
        }
        if self.desk.state().tool.has_conflict() {
            self.stop("another node sends with this program's node ID. Try again", false);
            let mut state = self.desk.state_mut();
            state.tool.leave();
            // All are in use: then nothing can be sent.
            let _ = state.tool.take_id(None, None);
        }
        let mut context = Context::from_waker(Waker::noop());
        while self.stage != Stage::Done && self.job.as_mut().poll(&mut context).is_ready() {
            match self.stage {
                Stage::Checks => self.put_back(),
                _ => self.stage = Stage::Done,
            }
        }
        self.desk.state_mut().send();
    }

    /// Removes and returns the frames for the bus.
    pub fn take_frames(&mut self) -> Vec<Frame> {
        std::mem::take(&mut self.desk.state_mut().out)
    }

    /// Removes and returns what the user of the session has to do.
    pub fn take_outputs(&mut self) -> Vec<Output> {
        std::mem::take(&mut self.desk.state_mut().outputs)
    }

    /// True if the checks have ended, and what they changed is put back as far as possible.
    pub fn is_done(&self) -> bool {
        self.stage == Stage::Done
    }

    /// True if something is to be put back.
    pub fn has_changed(&self) -> bool {
        let state = self.desk.state();
        !state.changed.values.is_empty() || state.update.is_some()
    }

    /// The report so far.
    pub fn report(&self) -> Report {
        self.desk.state().report.clone()
    }
}

/// Puts back what the checks have changed, and says what it could not.
async fn put_back(desk: Desk, within: Duration) {
    let (changed, is_updating, has_moved) = {
        let mut state = desk.state_mut();
        state.is_silent = false;
        state.command = None;
        (state.changed.to_string(), state.update.is_some(), state.has_moved)
    };
    let end = desk.now() + within;
    if is_updating {
        desk.note("the update goes on to its end: a node without a program could not start");
        let (text, is_updated) = match desk.run_update().await {
            Outcome::Updated(text) => (text, true),
            Outcome::Failed(text) => (format!("{text}. \"make update\" goes on with it"), false),
        };
        desk.check("Update", "the same program", text, is_updated);
    }
    if !changed.is_empty() {
        desk.note(format!("puts back {changed}"));
        let result = loop {
            match desk.put_back().await {
                Err(_) if desk.now() < end => desk.pause(Duration::from_millis(100)).await,
                result => break result,
            }
        };
        let seen = match &result {
            Ok(done) => format!("{done}: read back"),
            Err(why) => format!("not put back: {why}. The next run does it first"),
        };
        desk.check("Put back", changed, seen, result.is_ok());
    }
    if has_moved {
        desk.note("restarts the node: then its output has no pulse, as before");
        let _ = desk.ask(&Message::RestartNode(RESTART_MAGIC)).await;
    }
}
