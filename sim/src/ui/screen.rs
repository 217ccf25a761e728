//! The state of the screen: the list that is open, the types of traffic that are hidden, and the
//! scroll position.

use super::keys::{Action, Popup};
use super::pace::Measured;
use super::traffic::{Hidden, Traffic};

/// The state of the screen, and how fast time goes.
#[derive(Clone, Debug, Default)]
pub struct Screen {
    pub is_paused: bool,
    /// The list that is open.
    pub popup: Option<Popup>,
    /// True: show the load by node and type in place of the traffic.
    pub shows_load: bool,
    /// Number of the last line of traffic on the screen; `None` for the newest line.
    pub until: Option<u64>,
    /// Types of traffic that are hidden.
    pub hidden: Hidden,
    /// Index of the type under the cursor of [`Popup::Types`].
    pub selected: usize,
    /// Number of the hints that were acknowledged.
    pub acknowledged: usize,
    pub speed: Measured,
}

impl Screen {
    /// Applies an action to the screen, on which `page` lines of traffic fit. Actions on the bench
    /// change nothing here.
    pub fn apply(&mut self, action: Action, traffic: &Traffic, page: usize) {
        let types = traffic.types();
        match action {
            Action::Toggle(popup) => self.popup = (self.popup != Some(popup)).then_some(popup),
            Action::Close if self.popup.is_some() => self.popup = None,
            Action::Close => self.shows_load = false,
            Action::ToggleLoad => self.shows_load = !self.shows_load,
            Action::Scroll(pages) => {
                let lines = usize::from(pages.unsigned_abs()) * page.max(1);
                self.until = if pages > 0 {
                    traffic.back(self.until, lines, page, &self.hidden)
                } else {
                    traffic.forth(self.until, lines, &self.hidden)
                };
            }
            Action::ScrollEnd => self.until = None,
            Action::Select(steps) => {
                let last = types.len().saturating_sub(1);
                self.selected = self.selected.saturating_add_signed(isize::from(steps)).min(last);
            }
            Action::ToggleType => {
                if let Some(selected) = types.get(self.selected)
                    && !self.hidden.remove(&selected.name)
                {
                    self.hidden.insert(selected.name.clone());
                }
            }
            Action::ShowAllTypes => self.hidden.clear(),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::traffic::TrafficLine;
    use super::*;

    fn traffic(names: &[&str]) -> Traffic {
        let mut traffic = Traffic::default();
        names.iter().for_each(|name| traffic.push(TrafficLine::sample(0, name, name)));
        traffic
    }

    #[test]
    fn close_closes_first_the_list_and_then_the_load() {
        let traffic = Traffic::default();
        for popup in [Popup::Faults, Popup::Types, Popup::Help] {
            let mut screen = Screen { shows_load: true, ..Screen::default() };
            screen.apply(Action::Toggle(popup), &traffic, 5);
            assert_eq!((screen.popup, screen.shows_load), (Some(popup), true));
            screen.apply(Action::Close, &traffic, 5);
            assert_eq!((screen.popup, screen.shows_load), (None, true));
            screen.apply(Action::Close, &traffic, 5);
            assert_eq!((screen.popup, screen.shows_load), (None, false));
            screen.apply(Action::Close, &traffic, 5);
            assert_eq!((screen.popup, screen.shows_load), (None, false), "nothing is open");
        }
    }

    #[test]
    fn a_popup_closes_by_its_own_key_and_replaces_another() {
        let (traffic, mut screen) = (Traffic::default(), Screen::default());
        for (popup, open) in [
            (Popup::Help, Some(Popup::Help)),
            (Popup::Faults, Some(Popup::Faults)),
            (Popup::Faults, None),
        ] {
            screen.apply(Action::Toggle(popup), &traffic, 5);
            assert_eq!(screen.popup, open);
        }
    }

    #[test]
    fn the_selected_type_is_hidden_and_shown() {
        let traffic = traffic(&["command", "status"]);
        let mut screen = Screen::default();
        let hidden = |screen: &Screen| screen.hidden.iter().cloned().collect::<Vec<_>>();
        screen.apply(Action::ToggleType, &traffic, 5);
        assert_eq!(hidden(&screen), ["command"]);
        (0..5).for_each(|_| screen.apply(Action::Select(1), &traffic, 5));
        screen.apply(Action::ToggleType, &traffic, 5);
        assert_eq!(hidden(&screen), ["command", "status"]);
        screen.apply(Action::ToggleType, &traffic, 5);
        assert_eq!(hidden(&screen), ["command"]);
        screen.apply(Action::ShowAllTypes, &traffic, 5);
        assert!(screen.hidden.is_empty());
        (0..5).for_each(|_| screen.apply(Action::Select(-1), &traffic, 5));
        assert_eq!(screen.selected, 0);
    }

    #[test]
    fn without_traffic_there_is_nothing_to_hide() {
        let mut screen = Screen::default();
        for action in [Action::Select(1), Action::ToggleType, Action::Scroll(1), Action::Scroll(-1)]
        {
            screen.apply(action, &Traffic::default(), 0);
        }
        assert!(screen.hidden.is_empty() && screen.until.is_none());
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
