//! The output: a live table of nodes in a terminal, otherwise lines.

use crate::args::Args;
use crate::joined::Joined;
use crate::node::Node;
use anyhow::Result;
use dronecan_host::text::visible;
use dronecan_host::{Health, NodeId};
use ratatui::crossterm::event::{self, Event, KeyCode, KeyModifiers};
use ratatui::layout::{Constraint, Layout};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::Line;
use ratatui::widgets::{Block, Paragraph, Row, Table};
use ratatui::{DefaultTerminal, Frame};
use std::collections::{BTreeMap, VecDeque};
use std::io::{IsTerminal as _, Write};
use std::time::Duration;

/// Time between two redraws.
const REFRESH: Duration = Duration::from_millis(250);
/// Number of lines kept for the lower part.
const LINES_KEPT: usize = 200;
/// Time over which a node's rate is measured.
const RATE_OVER: Duration = Duration::from_secs(2);

/// The kind of output.
pub enum Screen {
    Live(Box<Live>),
    Plain,
}

/// A live table of all nodes.
pub struct Live {
    terminal: DefaultTerminal,
    lines: VecDeque<String>,
    next: Duration,
    /// For each node: number of statuses when the rate was last measured, the time of that, and
    /// the rate.
    rates: BTreeMap<NodeId, (u64, Duration, f64)>,
}

impl Screen {
    /// A table if the output is a terminal, unless the user asked for lines.
    ///
    /// # Errors
    /// If the terminal cannot be set up.
    pub fn open(args: &Args) -> Result<Screen> {
        if args.plain
            || args.names
            || !std::io::stdout().is_terminal()
            || !std::io::stdin().is_terminal()
        {
            return Ok(Screen::Plain);
        }
        let terminal = ratatui::try_init()?;
        let (lines, rates) = (VecDeque::new(), BTreeMap::new());
        Ok(Screen::Live(Box::new(Live { terminal, lines, next: Duration::ZERO, rates })))
    }

    /// Shows what has changed. Returns true if the user wants to end the program.
    ///
    /// # Errors
    /// If the terminal was closed.
    pub fn show(&mut self, joined: &mut Joined) -> Result<bool> {
        let now = joined.now();
        let lines = joined.take_log();
        match self {
            Screen::Plain => {
                print(now, &lines);
                Ok(false)
            }
            Screen::Live(live) => {
                live.lines.extend(
                    lines.into_iter().map(|line| format!("{:8.3} {line}", now.as_secs_f64())),
                );
                live.lines.drain(..live.lines.len().saturating_sub(LINES_KEPT));
                if now >= live.next {
                    live.next = now + REFRESH;
                    live.count(now, joined);
                    let Live { terminal, lines, rates, .. } = &mut **live;
                    terminal.draw(|frame| draw(frame, now, joined, lines, rates))?;
                }
                wants_to_end()
            }
        }
    }

    /// Prints the last lines and the totals.
    pub fn last(&mut self, joined: &mut Joined) {
        self.close();
        let now = joined.now();
        let lines: Vec<String> =
            joined.take_log().into_iter().chain([joined.bus.to_string()]).collect();
        print(now, &lines);
        for line in joined.channels.iter().flat_map(|channel| channel.report()) {
            print(now, &[line]);
        }
    }

    /// Restores the terminal.
    pub fn close(&mut self) {
        if matches!(self, Screen::Live(_)) {
            ratatui::restore();
            *self = Screen::Plain;
        }
    }
}

fn print(now: Duration, lines: &[String]) {
    print_to(&mut std::io::stdout().lock(), now, lines);
}

fn print_to(out: &mut impl Write, now: Duration, lines: &[String]) {
    // The reader of the lines may have exited.
    for line in lines {
        let _ = writeln!(out, "{:8.3} {}", now.as_secs_f64(), visible(line));
    }
    let _ = out.flush();
}

fn wants_to_end() -> Result<bool> {
    while event::poll(Duration::ZERO)? {
        if let Event::Key(key) = event::read()? {
            let control_c =
                key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL);
            if control_c || matches!(key.code, KeyCode::Char('q') | KeyCode::Esc) {
                return Ok(true);
            }
        }
    }
    Ok(false)
}

impl Live {
    fn count(&mut self, now: Duration, joined: &Joined) {
        for (id, node) in joined.bridge.nodes() {
            let (count, at, rate) = self.rates.entry(*id).or_insert((node.statuses, now, 0.0));
            let passed = now.saturating_sub(*at);
            if passed >= RATE_OVER {
                *rate = (node.statuses - *count) as f64 / passed.as_secs_f64();
                (*count, *at) = (node.statuses, now);
            }
        }
    }
}

type Rates = BTreeMap<NodeId, (u64, Duration, f64)>;

fn draw(
    frame: &mut Frame,
    now: Duration,
    joined: &Joined,
    lines: &VecDeque<String>,
    rates: &Rates,
) {
    let nodes = joined.bridge.nodes();
    let reports: Vec<String> = std::iter::once(joined.bus.to_string())
        .chain(joined.channels.iter().flat_map(|channel| channel.report()))
        .collect();
    let height = |lines: usize| Constraint::Length(lines as u16 + 2);
    let [table, channels, log] = Layout::vertical([
        height(nodes.len().max(1) + 1),
        height(reports.len()),
        Constraint::Min(3),
    ])
    .areas(frame.area());
    let header =
        ["node", "name", "health", "mode", "uptime", "vendor", "status", "heard", "parameters"];
    let rows = nodes
        .iter()
        .map(|(id, node)| row(now, *id, node, rates.get(id).map_or(0.0, |rate| rate.2)));
    let widths = [4, 32, 8, 15, 10, 6, 8, 7, 10].map(Constraint::Length);
    let widget = Table::new(rows, widths)
        .header(Row::new(header).style(Modifier::BOLD))
        .block(Block::bordered().title(" Nodes ").title_bottom(" q quits "));
    frame.render_widget(widget, table);
    let text: Vec<Line> = reports.iter().map(|line| Line::from(visible(line))).collect();
    frame.render_widget(
        Paragraph::new(text).block(Block::bordered().title(" Bus and channels ")),
        channels,
    );
    let room = usize::from(log.height.saturating_sub(2));
    let text: Vec<Line> = lines
        .iter()
        .skip(lines.len().saturating_sub(room))
        .map(|line| Line::from(visible(line)))
        .collect();
    frame.render_widget(Paragraph::new(text).block(Block::bordered().title(" Log ")), log);
}

fn row(now: Duration, id: NodeId, node: &Node, rate: f64) -> Row<'static> {
    let style = match (node.is_online, node.status.health) {
        (false, _) => Style::new().fg(Color::DarkGray),
        (_, Health::Ok) => Style::new(),
        (_, Health::Warning) => Style::new().fg(Color::Yellow),
        (_, Health::Error | Health::Critical) => Style::new().fg(Color::Red),
    };
    let heard = now.saturating_sub(node.heard).as_secs_f64();
    let parameters = match (&node.table, &node.listing) {
        (_, Some(listing)) => format!("{}..", listing.got.len()),
        (Some(table), None) => table.entries.len().to_string(),
        (None, None) => String::from("-"),
    };
    Row::new([
        id.to_string(),
        node.name().unwrap_or_else(|| String::from("?")),
        if node.is_online { node.status.health.to_string() } else { String::from("offline") },
        node.status.mode.to_string(),
        format!("{} s", node.status.uptime_s),
        format!("{:#06X}", node.status.vendor_code),
        format!("{rate:.1} Hz"),
        format!("{heard:.1} s"),
        parameters,
    ])
    .style(style)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_shows_control_characters() {
        let mut out = Vec::new();
        let line = String::from("node 42 is \u{1b}]0;owned\u{7}\u{9b}2J");
        print_to(&mut out, Duration::from_millis(1500), &[line]);
        let expected = "   1.500 node 42 is \\x1b]0;owned\\x07\\x9b2J\n";
        assert_eq!(String::from_utf8(out).unwrap(), expected);
    }
}
