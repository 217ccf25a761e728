//! Colours of the live view.

use ratatui::style::{Color, Modifier, Style};

pub const GOOD: Style = Style::new().fg(Color::Green);
pub const WARN: Style = Style::new().fg(Color::Yellow);
pub const BAD: Style = Style::new().fg(Color::Red).add_modifier(Modifier::BOLD);
/// What matters less than the text beside it.
pub const DIM: Style = Style::new().fg(Color::DarkGray);
/// Traffic of the node under test.
pub const NODE: Style = Style::new().fg(Color::Cyan);
