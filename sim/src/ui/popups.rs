//! Draws the lists over the live view: the faults, the types of traffic, the help.

use super::keys::{self, Popup};
use super::screen::Screen;
use super::state::State;
use super::styles::{BAD, DIM, WARN};
use crate::fault::{ALL, Fault};
use ratatui::Frame;
use ratatui::layout::{Constraint, Rect};
use ratatui::style::{Style, Stylize};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Clear, Paragraph};

/// Most lines in the list of types.
const TYPE_LINES: usize = 20;
/// Faults with a digit as their key.
const DIGITS: usize = 9;
/// Columns of the list for the other faults.
const FAULT_COLUMNS: usize = 3;
/// Rows of the border of a list.
const BORDER_ROWS: usize = 2;

/// Draws the open list, if there is one.
pub fn draw(frame: &mut Frame<'_>, area: Rect, state: &State, screen: &Screen) {
    match screen.popup {
        Some(Popup::Faults) => draw_faults(frame, area, state),
        Some(Popup::Types) => draw_types(frame, area, state, screen),
        Some(Popup::Help) => draw_help(frame, area),
        None => {}
    }
}

fn draw_faults(frame: &mut Frame<'_>, area: Rect, state: &State) {
    let cell = |fault: &Fault| {
        let is_on = state.active_faults.contains(fault);
        let (mark, style) = match (is_on, fault.lasts()) {
            (true, _) => ("on ", BAD),
            (false, true) => ("off", Style::new()),
            (false, false) => ("", Style::new()),
        };
        let key = keys::key_of(*fault).map_or(' ', |key| key);
        [Span::from(format!(" {key} ")).bold(), Span::styled(format!("{mark:3} {fault:15}"), style)]
    };
    // The faults with a digit with their explanations; the others in columns.
    let (digits, others) = ALL.split_at(DIGITS);
    let mut lines: Vec<Line<'_>> = digits
        .iter()
        .map(|fault| {
            let text = fault.explanation().trim_end_matches(" (on/off)");
            let explanation = Span::styled(text, DIM);
            Line::from_iter(cell(fault).into_iter().chain([explanation]))
        })
        .collect();
    lines
        .extend(others.chunks(FAULT_COLUMNS).map(|row| Line::from_iter(row.iter().flat_map(cell))));
    popup(frame, area, " Faults: a key begins or ends one, x ends all, Esc closes ", lines, 76);
}

fn draw_types(frame: &mut Frame<'_>, area: Rect, state: &State, screen: &Screen) {
    let line = |(index, known): (usize, &super::traffic::MessageType)| {
        let is_hidden = screen.hidden.contains(&known.name);
        let mark = if is_hidden { "hidden" } else { "" };
        let line = Line::from(format!(" {mark:6} {:40.40} {:>9} ", known.name, known.count));
        let line = if is_hidden { line.style(DIM) } else { line };
        if index == screen.selected { line.reversed() } else { line }
    };
    // Scrolls so that the list shows the cursor.
    let rows = TYPE_LINES.min(usize::from(area.height).saturating_sub(BORDER_ROWS)).max(1);
    let first = (screen.selected + 1).saturating_sub(rows);
    let types = state.traffic.types().iter().enumerate();
    let mut lines: Vec<_> = types.map(line).skip(first).take(rows).collect();
    if lines.is_empty() {
        lines.push(Line::from(" no traffic yet"));
    }
    popup(
        frame,
        area,
        " Traffic: ↑ ↓, space hides or shows, Enter shows all, Esc closes ",
        lines,
        70,
    );
}

fn draw_help(frame: &mut Frame<'_>, area: Rect) {
    let line = |(keys, text): &(&'static str, &'static str)| {
        Line::from(vec![Span::from(format!(" {keys:16}")).bold(), Span::from(*text)])
    };
    let mut lines: Vec<_> = keys::HELP.iter().map(line).collect();
    lines.push(Line::styled(
        " Traffic: time of the frame's end, sender, message. Cyan: the node.",
        DIM,
    ));
    popup(frame, area, " Keys (Esc closes) ", lines, 74);
}

fn popup(frame: &mut Frame<'_>, area: Rect, title: &str, lines: Vec<Line<'_>>, columns: u16) {
    let rows = u16::try_from(lines.len() + BORDER_ROWS).unwrap_or(u16::MAX);
    let place = area.centered(Constraint::Length(columns), Constraint::Length(rows));
    frame.render_widget(Clear, place);
    let block = Block::bordered().title(title.to_owned()).border_style(WARN);
    frame.render_widget(Paragraph::new(lines).block(block), place);
}
