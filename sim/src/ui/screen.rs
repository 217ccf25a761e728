//! What the user has opened and scrolled in the live view, and how keys change it.

use super::keys::Action;
use super::pace::Measured;
use super::traffic::{Hidden, Traffic};

/// A list over the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Popup {
    Faults,
    Help,
}

/// The state of the screen, and how fast time goes.
#[derive(Clone, Debug, Default)]
pub struct Screen {
    pub paused: bool,
    /// At most one is open.
    pub popup: Option<Popup>,
    /// The load by node and type is shown in place of the traffic.
    pub load: bool,
    /// Number of the last line of traffic shown; without it the newest is.
    pub until: Option<u64>,
    pub speed: Measured,
}

impl Screen {
    /// Does what a key asks of the screen. `page` is the number of lines of traffic that fit. Actions that are not the screen's change
    /// nothing.
    pub fn apply(&mut self, action: Action, traffic: &Traffic, page: usize) {
        match action {
            Action::Toggle(popup) => self.popup = (self.popup != Some(popup)).then_some(popup),
            Action::Close if self.popup.is_some() => self.popup = None,
            Action::Close => self.load = false,
            Action::ToggleLoad => self.load = !self.load,
            Action::Scroll(pages) => {
                let lines = usize::from(pages.unsigned_abs()) * page.max(1);
                self.until = if pages > 0 {
                    traffic.back(self.until, lines, page, &Hidden::new())
                } else {
                    traffic.forth(self.until, lines, &Hidden::new())
                };
            }
            Action::ScrollEnd => self.until = None,
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::state::{Origin, TrafficLine};
    use super::*;

    fn traffic(names: &[&str]) -> Traffic {
        let mut traffic = Traffic::default();
        for name in names {
            let (who, text) = (String::from("1"), name.to_string());
            traffic.push(TrafficLine { at: 0, origin: Origin::Other, who, name: text.clone(), text });
        }
        traffic
    }

    #[test]
    fn close_closes_what_is_open_one_at_a_time() {
        let traffic = Traffic::default();
        for popup in [Popup::Faults, Popup::Help] {
            let mut screen = Screen { load: true, ..Screen::default() };
            screen.apply(Action::Toggle(popup), &traffic, 5);
            assert_eq!((screen.popup, screen.load), (Some(popup), true));
            screen.apply(Action::Close, &traffic, 5);
            assert_eq!((screen.popup, screen.load), (None, true));
            screen.apply(Action::Close, &traffic, 5);
            assert_eq!((screen.popup, screen.load), (None, false));
            screen.apply(Action::Close, &traffic, 5);
            assert_eq!((screen.popup, screen.load), (None, false), "nothing is open");
        }
    }

    #[test]
    fn a_popup_closes_by_its_own_key_and_replaces_another() {
        let (traffic, mut screen) = (Traffic::default(), Screen::default());
        for (popup, open) in
            [(Popup::Help, Some(Popup::Help)), (Popup::Faults, Some(Popup::Faults)), (Popup::Faults, None)]
        {
            screen.apply(Action::Toggle(popup), &traffic, 5);
            assert_eq!(screen.popup, open);
        }
    }

    #[test]
    fn without_traffic_there_is_nothing_to_scroll() {
        let mut screen = Screen::default();
        for action in [Action::Scroll(1), Action::Scroll(-1)] {
            screen.apply(action, &Traffic::default(), 0);
        }
        assert!(screen.until.is_none());
    }

    #[test]
    fn pages_scroll_back_and_forth() {
        let traffic = traffic(&["status"; 20]);
        let mut screen = Screen::default();
        screen.apply(Action::Scroll(1), &traffic, 5);
        screen.apply(Action::Scroll(1), &traffic, 5);
        assert_eq!(screen.until, Some(9));
        screen.apply(Action::Scroll(-1), &traffic, 5);
        assert_eq!(screen.until, Some(14));
        screen.apply(Action::Scroll(-1), &traffic, 5);
        assert_eq!(screen.until, None);
        screen.apply(Action::Scroll(1), &traffic, 5);
        screen.apply(Action::ScrollEnd, &traffic, 5);
        assert_eq!(screen.until, None);
    }
}
