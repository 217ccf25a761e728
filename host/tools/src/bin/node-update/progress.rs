//! Shows the progress of updates: a bar for each node on a terminal, lines elsewhere.

use std::io::IsTerminal as _;

use dronecan_host::NodeId;
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use node_tools::update::session::Session;

/// Number of lines, one for each quarter of the file.
const LINES: usize = 4;

/// The place where all progress is shown.
pub struct Display {
    /// `None` for lines.
    bars: Option<MultiProgress>,
}

impl Display {
    /// Bars on a terminal, unless `plain`; lines elsewhere.
    pub fn new(plain: bool) -> Display {
        let is_terminal = !plain && std::io::stdout().is_terminal();
        Display { bars: is_terminal.then(MultiProgress::new) }
    }

    /// Prints a line, above the bars.
    pub fn line(&self, text: &str) {
        match &self.bars {
            Some(bars) => bars.suspend(|| println!("{text}")),
            None => println!("{text}"),
        }
    }

    /// Progress of an update with a file of `len` bytes.
    pub fn progress(&self, node: NodeId, len: usize) -> Progress {
        let bar = self.bars.as_ref().map(|bars| {
            let template = "node {prefix} [{bar:30}] {bytes}/{total_bytes} {msg}";
            let style = ProgressStyle::with_template(template)
                .unwrap_or_else(|_| ProgressStyle::default_bar());
            let bar = ProgressBar::new(len as u64)
                .with_style(style.progress_chars("=> "))
                .with_prefix(node.to_string());
            bars.add(bar)
        });
        Progress { bar, node, len, printed: 0, stage: "" }
    }
}

/// Progress of the update of one node.
pub struct Progress {
    bar: Option<ProgressBar>,
    node: NodeId,
    len: usize,
    printed: usize,
    stage: &'static str,
}

impl Progress {
    /// Shows what has changed.
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
