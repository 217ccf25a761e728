//! Shows the progress of an update: a bar on a terminal, lines elsewhere.

use std::io::IsTerminal as _;

use dronecan_host::NodeId;
use indicatif::{ProgressBar, ProgressStyle};

use crate::session::Session;

/// Number of lines, one for each quarter of the file.
const LINES: usize = 4;

pub struct Progress {
    bar: Option<ProgressBar>,
    node: NodeId,
    len: usize,
    printed: usize,
    stage: &'static str,
}

impl Progress {
    /// Progress of an update with a file of `len` bytes.
    pub fn new(node: NodeId, len: usize, plain: bool) -> Progress {
        let bar = (!plain && std::io::stdout().is_terminal()).then(|| {
            let template = "node {prefix} [{bar:30}] {bytes}/{total_bytes} {msg}";
            let style = ProgressStyle::with_template(template)
                .unwrap_or_else(|_| ProgressStyle::default_bar());
            ProgressBar::new(len as u64)
                .with_style(style.progress_chars("=> "))
                .with_prefix(node.to_string())
        });
        Progress { bar, node, len, printed: 0, stage: "" }
    }

    pub fn show(&mut self, session: &Session) {
        let stage = session.stage();
        if let Some(bar) = &self.bar {
            bar.set_position(session.sent() as u64);
            if stage != self.stage {
                bar.set_message(stage);
            }
        } else {
            let quarters = session.sent() * LINES / self.len;
            if stage != self.stage || quarters > self.printed {
                println!("node {}: {stage}, {} of {} bytes", self.node, session.sent(), self.len);
            }
            self.printed = quarters;
        }
        self.stage = stage;
    }

    /// Removes the bar.
    pub fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
