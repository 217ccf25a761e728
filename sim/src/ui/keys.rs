//! Keys of the live view and what they do.

use crate::fault::{ALL, Fault};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// A list that is drawn over the rest of the screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Popup {
    Faults,
    /// The types of traffic, to hide and show.
    Types,
    Help,
}

/// The action of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Changes the commanded deflection by this many hundredths of full deflection, and holds it
    /// there.
    Nudge(i8),
    ToggleSweep,
    /// Changes the temperature at the sensor by this many degrees Celsius.
    Warm(i8),
    /// Changes the speed of the shaft by this many steps.
    Spin(i8),
    /// Begins a fault, or ends it if it lasts and is on.
    Inject(Fault),
    /// Ends a fault if it is on.
    End(Fault),
    /// Ends each fault that is on.
    EndAll,
    /// Closes the list if it is open; else opens it in place of any other.
    Toggle(Popup),
    /// Closes the open list; if none is open, closes the load of the bus.
    Close,
    TogglePause,
    /// Shows the load of the bus by node and type in place of the traffic, or the traffic again.
    ToggleLoad,
    NextCommandType,
    /// Moves the cursor in the list of the types of traffic.
    Select(i8),
    /// Hides or shows the type of traffic under the cursor.
    ToggleType,
    ShowAllTypes,
    /// Scrolls the traffic by this many pages: back if positive, towards the newest line if
    /// negative.
    Scroll(i8),
    /// Shows the newest traffic again.
    ScrollEnd,
    /// Removes the hint from the screen.
    Acknowledge,
    /// Stops the program, as other programs do at Ctrl-Z.
    Suspend,
    Quit,
}

/// Keys and their help, a line each, the most useful first.
pub const HELP: &[(&str, &str)] = &[
    ("left right", "move the servo and hold it (with shift: fast)"),
    ("s", "sweep the servo, or hold it"),
    ("v", "command type: unitless, position, PWM, thesis"),
    ("t T", "temperature at the sensor down, up"),
    ("u U", "speed of the shaft down, up"),
    ("c", "pull the node's bus cable, or plug it"),
    ("a", "stop the autopilot's messages, or send them again"),
    ("d", "disarm the vehicle, or arm it"),
    ("o", "replace the autopilot by one of the other dialect"),
    ("f", "list of faults"),
    ("1..9 A..P", "begin a fault of that list; the same key ends it"),
    ("x", "end all faults"),
    ("r", "press the board's reset button"),
    ("l", "show the load by node and type, or the traffic"),
    ("/", "list of message types, to hide and show them:"),
    ("up down", "  choose a type"),
    ("space Enter", "  hide or show the type; show all types"),
    ("p space", "pause and resume simulated time"),
    ("PgUp PgDn End", "scroll the bus traffic; End shows the newest"),
    ("k", "acknowledge the hint on the screen"),
    ("h ? Esc", "show this help; close the list or the load"),
    ("q Ctrl-C Ctrl-Z", "quit; Ctrl-Z: until the shell's fg"),
];

/// Hundredths of full deflection for each arrow key, without and with shift.
const STEP: i8 = 5;
const FAST_STEP: i8 = 25;

/// The action of `key` while `popup` is open. A digit begins a fault only in the list of faults,
/// but ends it at any time.
pub fn action(key: KeyEvent, popup: Option<Popup>) -> Option<Action> {
    if key.kind == KeyEventKind::Release {
        return None;
    }
    let step = if key.modifiers.contains(KeyModifiers::SHIFT) { FAST_STEP } else { STEP };
    if key.modifiers.contains(KeyModifiers::CONTROL) {
        return match key.code {
            KeyCode::Char('c') => Some(Action::Quit),
            KeyCode::Char('z') => Some(Action::Suspend),
            _ => None,
        };
    }
    let in_types = popup == Some(Popup::Types);
    Some(match key.code {
        KeyCode::Left => Action::Nudge(-step),
        KeyCode::Right => Action::Nudge(step),
        KeyCode::PageUp => Action::Scroll(1),
        KeyCode::PageDown => Action::Scroll(-1),
        KeyCode::End => Action::ScrollEnd,
        KeyCode::Esc => Action::Close,
        KeyCode::Up if in_types => Action::Select(-1),
        KeyCode::Down if in_types => Action::Select(1),
        KeyCode::Char(' ') if in_types => Action::ToggleType,
        KeyCode::Enter if in_types => Action::ShowAllTypes,
        KeyCode::Char(digit @ '1'..='9') => {
            let fault = *ALL.get(digit as usize - '1' as usize)?;
            if popup == Some(Popup::Faults) { Action::Inject(fault) } else { Action::End(fault) }
        }
        KeyCode::Char(letter @ 'A'..='P') if popup == Some(Popup::Faults) => {
            Action::Inject(lettered().find(|(known, _)| *known == letter)?.1)
        }
        KeyCode::Char('k') => Action::Acknowledge,
        KeyCode::Char('x') => Action::EndAll,
        KeyCode::Char('/') => Action::Toggle(Popup::Types),
        KeyCode::Char('s') => Action::ToggleSweep,
        KeyCode::Char('t') => Action::Warm(-1),
        KeyCode::Char('T') => Action::Warm(1),
        KeyCode::Char('u') => Action::Spin(-1),
        KeyCode::Char('U') => Action::Spin(1),
        KeyCode::Char('c') => Action::Inject(Fault::Cable),
        KeyCode::Char('a') => Action::Inject(Fault::Silence),
        KeyCode::Char('d') => Action::Inject(Fault::Disarm),
        KeyCode::Char('o') => Action::Inject(Fault::OtherDialect),
        KeyCode::Char('f') => Action::Toggle(Popup::Faults),
        KeyCode::Char('r') => Action::Inject(Fault::Reset),
        KeyCode::Char('p' | ' ') => Action::TogglePause,
        KeyCode::Char('l') => Action::ToggleLoad,
        KeyCode::Char('v') => Action::NextCommandType,
        KeyCode::Char('h' | '?') => Action::Toggle(Popup::Help),
        KeyCode::Char('q') => Action::Quit,
        _ => return None,
    })
}

/// The faults without a digit and without a key of their own, with their letters in the list of
/// faults.
fn lettered() -> impl Iterator<Item = (char, Fault)> {
    let has_own_key = |fault: &Fault| {
        matches!(
            fault,
            Fault::Cable | Fault::Silence | Fault::Disarm | Fault::Reset | Fault::OtherDialect
        )
    };
    ('A'..='P').zip(ALL.into_iter().skip(9).filter(move |fault| !has_own_key(fault)))
}

/// The key that begins and ends `fault`. A digit or a capital letter begins its fault only in the
/// list of faults.
pub fn key_of(fault: Fault) -> Option<char> {
    let begins = |key: &char| {
        let key = KeyEvent::new(KeyCode::Char(*key), KeyModifiers::NONE);
        action(key, Some(Popup::Faults)) == Some(Action::Inject(fault))
    };
    ('!'..='~').find(begins)
}

#[cfg(test)]
mod tests {
    use super::*;

    const POPUPS: [Option<Popup>; 4] =
        [None, Some(Popup::Faults), Some(Popup::Types), Some(Popup::Help)];

    #[test]
    fn each_key_has_its_action() {
        use Action::{End, Inject, Nudge, Scroll, Select, Spin, Toggle, Warm};
        let no_list: &[(&str, Action)] = &[
            ("left", Nudge(-5)),
            ("right", Nudge(5)),
            ("s", Action::ToggleSweep),
            ("t", Warm(-1)),
            ("T", Warm(1)),
            ("u", Spin(-1)),
            ("U", Spin(1)),
            ("c", Inject(Fault::Cable)),
            ("a", Inject(Fault::Silence)),
            ("o", Inject(Fault::OtherDialect)),
            ("d", Inject(Fault::Disarm)),
            ("f", Toggle(Popup::Faults)),
            ("x", Action::EndAll),
            ("/", Toggle(Popup::Types)),
            ("r", Inject(Fault::Reset)),
            ("p", Action::TogglePause),
            ("space", Action::TogglePause),
            ("l", Action::ToggleLoad),
            ("v", Action::NextCommandType),
            ("?", Toggle(Popup::Help)),
            ("PgUp", Scroll(1)),
            ("q", Action::Quit),
            // Not the cable's.
            ("Ctrl-C", Action::Quit),
            ("4", End(Fault::NoAck)),
        ];
        let types: &[(&str, Action)] = &[
            ("space", Action::ToggleType),
            ("Enter", Action::ShowAllTypes),
            ("up", Select(-1)),
            ("down", Select(1)),
            ("4", End(Fault::NoAck)),
        ];
        let faults: &[(&str, Action)] =
            &[("4", Inject(Fault::NoAck)), ("A", Inject(Fault::ErrorStorm))];
        let help: &[(&str, Action)] = &[("4", End(Fault::NoAck)), ("Ctrl-Z", Action::Suspend)];
        for (popup, rows) in POPUPS.into_iter().zip([no_list, faults, types, help]) {
            for (name, expected) in rows.iter().chain(&[("Esc", Action::Close)]) {
                let found = action(keys_in(name)[0], popup);
                assert_eq!(found, Some(*expected), "{name} in {popup:?}");
            }
        }
        let without_action =
            [(None, "z"), (None, "Enter"), (None, "up"), (None, "down"), (None, "A")];
        for (popup, name) in
            without_action.into_iter().chain(["0", "Z"].map(|name| (Some(Popup::Faults), name)))
        {
            assert_eq!(action(keys_in(name)[0], popup), None, "{name} in {popup:?}");
        }
    }

    #[test]
    fn each_fault_names_its_key() {
        for (name, key) in [
            ("cable", 'c'),
            ("silence", 'a'),
            ("disarm", 'd'),
            ("bit-error", '1'),
            ("stuck-dominant", '5'),
            ("error-storm", 'A'),
        ] {
            assert_eq!(key_of(name.parse().unwrap()), Some(key), "{name}");
        }
        let mut keys: Vec<char> = ALL.into_iter().map(|fault| key_of(fault).unwrap()).collect();
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), ALL.len(), "each fault has its own key");
    }

    /// Some terminals report a key twice, when it is pressed and when it is released.
    #[test]
    fn a_released_key_does_nothing() {
        let mut key = KeyEvent::new(KeyCode::Char('r'), KeyModifiers::NONE);
        key.kind = KeyEventKind::Release;
        assert_eq!(action(key, None), None);
    }

    /// The keys in a line of the help.
    fn keys_in(names: &str) -> Vec<KeyEvent> {
        let plain = |code| KeyEvent::new(code, KeyModifiers::NONE);
        let key = |name: &str| match name {
            "left" => vec![plain(KeyCode::Left)],
            "right" => vec![plain(KeyCode::Right)],
            "up" => vec![plain(KeyCode::Up)],
            "down" => vec![plain(KeyCode::Down)],
            "space" => vec![plain(KeyCode::Char(' '))],
            "Enter" => vec![plain(KeyCode::Enter)],
            "PgUp" => vec![plain(KeyCode::PageUp)],
            "PgDn" => vec![plain(KeyCode::PageDown)],
            "End" => vec![plain(KeyCode::End)],
            "Esc" => vec![plain(KeyCode::Esc)],
            "Ctrl-C" => vec![KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL)],
            "Ctrl-Z" => vec![KeyEvent::new(KeyCode::Char('z'), KeyModifiers::CONTROL)],
            "A..P" => ('A'..='P').map(|letter| plain(KeyCode::Char(letter))).collect(),
            "1..9" => ('1'..='9').map(|digit| plain(KeyCode::Char(digit))).collect(),
            _ => {
                assert_eq!(name.len(), 1, "{name} is not a key");
                name.chars().map(|letter| plain(KeyCode::Char(letter))).collect()
            }
        };
        names.split(' ').flat_map(key).collect()
    }

    #[test]
    fn each_key_of_the_help_has_an_action() {
        for (names, _) in HELP {
            for key in keys_in(names) {
                assert!(
                    POPUPS.iter().any(|popup| action(key, *popup).is_some()),
                    "{names}: {key:?} does nothing"
                );
            }
        }
    }

    /// `--help` and the live view both print the table `HELP`.
    #[test]
    fn the_help_names_every_key_that_has_an_action() {
        let named: Vec<KeyEvent> = HELP.iter().flat_map(|(names, _)| keys_in(names)).collect();
        let characters = (' '..='~').map(KeyCode::Char);
        let others = [
            KeyCode::Left,
            KeyCode::Right,
            KeyCode::Up,
            KeyCode::Down,
            KeyCode::PageUp,
            KeyCode::PageDown,
            KeyCode::Home,
            KeyCode::End,
            KeyCode::Enter,
            KeyCode::Tab,
            KeyCode::Backspace,
            KeyCode::Delete,
            KeyCode::Esc,
        ];
        for code in characters.chain(others) {
            let key = KeyEvent::new(code, KeyModifiers::NONE);
            if POPUPS.iter().any(|popup| action(key, *popup).is_some()) {
                assert!(named.contains(&key), "{code} is not in the help");
            }
        }
    }

    #[test]
    fn the_readme_names_the_key_that_shows_the_others() {
        assert!(HELP.iter().any(|(names, _)| names.split(' ').any(|name| name == "h")));
        assert!(include_str!("../../../README.md").contains("h shows the keys"));
    }
}
