//! Keys of the live view and what they do.

use crate::fault::{Fault, MENU};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// What a key asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Moves the servo by this many hundredths of full deflection, and holds it there.
    Nudge(i8),
    ToggleSweep,
    /// Changes the temperature at the sensor by this many degrees Celsius.
    Warm(i8),
    Inject(Fault),
    ToggleFaultMenu,
    TogglePause,
    /// Shows the load of the bus by node and type in place of the traffic, or the traffic again.
    ToggleLoad,
    NextCommandType,
    ToggleHelp,
    /// Scrolls the traffic back (positive) or forth by this many pages.
    Scroll(i8),
    /// Shows the newest traffic again.
    ScrollEnd,
    Quit,
}

/// One line of help for each key, in the order in which they are worth knowing.
pub const HELP: &[(&str, &str)] = &[
    ("left right", "move the servo and hold it (with shift: fast)"),
    ("s", "sweep on, or hold where it is"),
    ("v", "command type: unitless, position, PWM, thesis"),
    ("t T", "temperature at the sensor down, up"),
    ("c", "pull the node's bus cable, or plug it"),
    ("a", "silence the autopilot, or let it speak"),
    ("d", "disarm the vehicle, or arm it"),
    ("o", "replace the autopilot by one of the other dialect"),
    ("f 1..9", "inject a fault; what lasts is ended by the same key"),
    ("r", "press the board's reset button"),
    ("l", "load of the bus by node and type, or the traffic"),
    ("p space", "pause and resume simulated time"),
    ("PgUp PgDn End", "scroll the bus traffic; End shows the newest"),
    ("h ?", "this help"),
    ("q Ctrl-C", "quit"),
];

const STEP: i8 = 5;
const FAST_STEP: i8 = 25;

/// What `key` means; `menu` says whether the fault menu is open, where digits choose.
pub fn action(key: KeyEvent, menu: bool) -> Option<Action> {
    if key.kind == KeyEventKind::Release {
        return None;
    }
    let step = if key.modifiers.contains(KeyModifiers::SHIFT) { FAST_STEP } else { STEP };
    if key.modifiers.contains(KeyModifiers::CONTROL) {
        return (key.code == KeyCode::Char('c')).then_some(Action::Quit);
    }
    Some(match key.code {
        KeyCode::Left => Action::Nudge(-step),
        KeyCode::Right => Action::Nudge(step),
        KeyCode::PageUp => Action::Scroll(1),
        KeyCode::PageDown => Action::Scroll(-1),
        KeyCode::End => Action::ScrollEnd,
        KeyCode::Esc if menu => Action::ToggleFaultMenu,
        KeyCode::Char(digit @ '1'..='9') if menu => Action::Inject(*MENU.get(digit as usize - '1' as usize)?),
        KeyCode::Char('s') => Action::ToggleSweep,
        KeyCode::Char('t') => Action::Warm(-1),
        KeyCode::Char('T') => Action::Warm(1),
        KeyCode::Char('c') => Action::Inject(Fault::Cable),
        KeyCode::Char('a') => Action::Inject(Fault::Silence),
        KeyCode::Char('d') => Action::Inject(Fault::Disarm),
        KeyCode::Char('o') => Action::Inject(Fault::OtherDialect),
        KeyCode::Char('f') => Action::ToggleFaultMenu,
        KeyCode::Char('r') => Action::Inject(Fault::Reset),
        KeyCode::Char('p' | ' ') => Action::TogglePause,
        KeyCode::Char('l') => Action::ToggleLoad,
        KeyCode::Char('v') => Action::NextCommandType,
        KeyCode::Char('h' | '?') => Action::ToggleHelp,
        KeyCode::Char('q') => Action::Quit,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn press(code: KeyCode) -> Option<Action> {
        action(KeyEvent::new(code, KeyModifiers::NONE), false)
    }

    #[test]
    fn each_key_has_its_action() {
        let cases = [
            (KeyCode::Left, Action::Nudge(-5)),
            (KeyCode::Right, Action::Nudge(5)),
            (KeyCode::Char('s'), Action::ToggleSweep),
            (KeyCode::Char('t'), Action::Warm(-1)),
            (KeyCode::Char('T'), Action::Warm(1)),
            (KeyCode::Char('c'), Action::Inject(Fault::Cable)),
            (KeyCode::Char('a'), Action::Inject(Fault::Silence)),
            (KeyCode::Char('o'), Action::Inject(Fault::OtherDialect)),
            (KeyCode::Char('f'), Action::ToggleFaultMenu),
            (KeyCode::Char('r'), Action::Inject(Fault::Reset)),
            (KeyCode::Char('p'), Action::TogglePause),
            (KeyCode::Char('l'), Action::ToggleLoad),
            (KeyCode::Char('v'), Action::NextCommandType),
            (KeyCode::Char('?'), Action::ToggleHelp),
            (KeyCode::PageUp, Action::Scroll(1)),
            (KeyCode::Char('q'), Action::Quit),
        ];
        for (code, expected) in cases {
            assert_eq!(press(code), Some(expected), "{code}");
        }
        assert_eq!(press(KeyCode::Char('z')), None);
    }

    #[test]
    fn control_c_quits_and_does_not_pull_the_cable() {
        let key = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(action(key, false), Some(Action::Quit));
    }

    #[test]
    fn digits_choose_faults_only_in_the_menu() {
        let key = |digit| KeyEvent::new(KeyCode::Char(digit), KeyModifiers::NONE);
        assert_eq!(action(key('4'), false), None);
        assert_eq!(action(key('4'), true), Some(Action::Inject(Fault::NoAck)));
        assert_eq!(action(key('0'), true), None);
    }

    /// Terminals that report releases must not act twice.
    #[test]
    fn a_released_key_does_nothing() {
        let mut key = KeyEvent::new(KeyCode::Char('r'), KeyModifiers::NONE);
        key.kind = KeyEventKind::Release;
        assert_eq!(action(key, false), None);
    }

    /// The help of `--help` and of the live view is this one table.
    #[test]
    fn help_names_every_letter_that_acts() {
        for letter in ('a'..='z').chain('A'..='Z') {
            if press(KeyCode::Char(letter)).is_some() {
                let key = letter.to_string();
                let named = HELP.iter().any(|(keys, _)| keys.split(' ').any(|k| k == key));
                assert!(named, "{letter} is not in the help");
            }
        }
    }
}
