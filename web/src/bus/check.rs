//! The checks of a node ([`node_tools::check`]) on the real bus, without the serial port and a
//! logic analyser. While they run the page sends nothing else.

use std::time::Duration;

use bench::can::Frame;
use bench::dronecan::NodeId;
use bench::dronecan::slcan::adapter::{Adapter, BUS_ERROR};
use node_tools::check::desk::{Answer, Output};
use node_tools::check::session::{Plan, Session};
use serde_json::{Value as Json, json};

/// How long error counters are observed.
const WATCH: Duration = Duration::from_secs(60);

/// The checks of a node.
pub struct Check {
    node: NodeId,
    session: Session,
    /// Why there can be no more frames.
    lost: Option<String>,
    lines: Vec<Json>,
    /// The question that waits for its answer, and the time at which it ends by itself.
    question: Option<(String, Option<Duration>)>,
    /// What is to be put back, should the page be closed before the session does so.
    left: String,
}

impl Check {
    /// Begins. `left` is what earlier checks have not put back, as [`Check::json`] had it.
    pub fn new(node: NodeId, bit_rate: u32, left: &str) -> Check {
        let plan = Plan {
            node,
            bit_rate,
            has_port: false,
            has_analyser: false,
            watch: WATCH,
            files: Vec::new(),
        };
        let session = Session::new(plan, serde_json::from_str(left).unwrap_or_default());
        Check { node, session, lost: None, lines: Vec::new(), question: None, left: left.into() }
    }

    /// True until the checks have ended.
    pub fn is_running(&self) -> bool {
        self.lost.is_none() && !self.session.is_done()
    }

    /// Handles a frame of the bus.
    pub fn take(&mut self, frame: &Frame, now: Duration, stamp_us: Option<u64>) {
        self.session.frame(frame, now, stamp_us);
    }

    /// Goes on. Returns the frames for the bus.
    pub fn poll(&mut self, now: Duration, waiting: usize, adapter: &mut Adapter) -> Vec<Frame> {
        if let Some(flags) = adapter.flags.take() {
            self.session.adapter_errors(flags & BUS_ERROR != 0);
        }
        self.session.poll(now, waiting);
        for output in self.session.take_outputs() {
            match output {
                Output::Note(text) => self.lines.push(json!({ "text": text, "verdict": null })),
                Output::Row(row) => {
                    let text = format!("{}: {}", row.what, row.seen);
                    self.lines.push(json!({ "text": text, "verdict": row.verdict.to_string() }));
                }
                Output::Ask(text, seconds) => {
                    self.question = Some((text, seconds.map(|s| now + Duration::from_secs(s))));
                }
                Output::Withdraw => self.question = None,
                Output::AskAdapter => adapter.ask_flags(),
                Output::Remember(changed) if changed.values.is_empty() => self.left.clear(),
                Output::Remember(changed) => self.left = json!(changed).to_string(),
                // There is no such thing in the page.
                Output::OpenPort | Output::ClosePort | Output::Serial(_) => {}
                Output::Record | Output::BitRate(_) => {}
            }
        }
        self.session.take_frames()
    }

    /// Answers the question: "yes", "no", or else it is skipped.
    pub fn answer(&mut self, answer: &str) {
        self.question = None;
        self.session.answer(match answer {
            "yes" => Answer::Yes,
            "no" => Answer::No,
            _ => Answer::Skip,
        });
    }

    /// Ends the checks, and puts back what they have changed.
    pub fn stop(&mut self) {
        self.session.stop("stopped", false);
    }

    /// The adapter is gone. What is left is put back by the next checks of the node.
    pub fn lose(&mut self, why: &str) {
        if self.is_running() {
            self.question = None;
            self.session.stop(why, true);
            self.lost = Some(why.into());
        }
    }

    /// What the page shows.
    pub fn json(&self, now: Duration) -> Json {
        let question = self.question.as_ref();
        let until = question.and_then(|(_, until)| *until);
        json!({
            "node": self.node.get(),
            "runs": self.is_running(),
            "lines": self.lines,
            "question": question.map(|(text, _)| text),
            "seconds": until.map(|until| until.saturating_sub(now).as_secs()),
            "summary": self.session.report().summary(),
            "left": self.left,
        })
    }

    /// The report as Markdown.
    pub fn report(&self, bit_rate: u32) -> String {
        let mut report = self.session.report();
        report.about = vec![
            ("Page", env!("CARGO_PKG_VERSION").into()),
            ("Node", self.node.to_string()),
            ("Bus", format!("{bit_rate} bit/s")),
            node_tools::check::report::board(),
        ];
        report.markdown()
    }
}
