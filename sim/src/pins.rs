//! What `--watch` sees at the pins of a user's own circuit.

use bench::board::Board;
use bench::wiring::Pin;
use bench::{Cycles, F_CPU_HZ};
use std::cell::RefCell;
use std::fmt;
use std::rc::Rc;

/// Edges of a pin are shown one by one up to this many in a window; beyond, as a tone.
const EDGES_SHOWN: usize = 4;
const WINDOW: Cycles = F_CPU_HZ / 10;
/// A tone whose frequency or share changes by less than this part is the same.
const SAME_WITHIN: f64 = 0.02;
/// The same of the share of bursts, which differs from window to window.
const SAME_SHARE_WITHIN: f64 = 0.5;
/// A period of at least this many medians is a gap between bursts.
const GAP: Cycles = 4;

/// The state of a watched pin, as it was shown last.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shown {
    Level(bool),
    /// Frequency in Hz, share of the periods in which the pin is high, and share of the time that
    /// has periods: less than 1 if they come in bursts.
    Tone {
        hz: f64,
        high: f64,
        share: f64,
    },
}

impl Shown {
    fn is_same(self, other: Shown) -> bool {
        match (self, other) {
            (
                Shown::Tone { hz, high, share },
                Shown::Tone { hz: hz2, high: high2, share: share2 },
            ) => {
                (hz - hz2).abs() <= hz * SAME_WITHIN
                    && (high - high2).abs() <= SAME_WITHIN
                    && (share - share2).abs() <= SAME_SHARE_WITHIN
            }
            _ => self == other,
        }
    }
}

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Shown::Level(false) => write!(f, "low"),
            Shown::Level(true) => write!(f, "high"),
            Shown::Tone { hz, high, share } => {
                write!(f, "{hz:.0} Hz, high {:.0} %", high * 100.0)?;
                match *share {
                    1.0 => Ok(()),
                    share => write!(f, ", in bursts: {:.0} % of the time", share * 100.0),
                }
            }
        }
    }
}

/// A pin that the user watches: its levels, and tones and brightness of faster signals.
pub struct Watched {
    pin: Pin,
    edges: Rc<RefCell<Vec<(Cycles, bool)>>>,
    /// Edges of this window.
    window: Vec<(Cycles, bool)>,
    window_from: Cycles,
    level: bool,
    shown: Shown,
}

impl Watched {
    /// Begins to watch a pin of the board.
    pub fn attach(pin: Pin, board: &mut Board) -> Watched {
        let edges = Rc::new(RefCell::new(Vec::new()));
        let seen = Rc::clone(&edges);
        let now = board.now();
        let level = board.pin(pin);
        board.avr_mut().watch_pin(
            pin.port(),
            pin.bit(),
            Box::new(move |level, at| seen.borrow_mut().push((at, level))),
        );
        let shown = Shown::Level(level);
        Watched { pin, edges, window: Vec::new(), window_from: now, level, shown }
    }

    /// The pin and its state, for the screen and for the first line.
    pub fn text(&self) -> String {
        format!("{} {}", self.pin, self.shown)
    }

    /// Returns what changed until `now`: times and texts.
    pub fn take(&mut self, now: Cycles) -> Vec<(Cycles, String)> {
        let mut lines = Vec::new();
        for (at, level) in self.edges.take() {
            self.end_windows(at, &mut lines);
            self.level = level;
            self.window.push((at, level));
            if self.window.len() <= EDGES_SHOWN && matches!(self.shown, Shown::Level(_)) {
                self.show(at, Shown::Level(level), &mut lines);
            }
        }
        self.end_windows(now, &mut lines);
        lines
    }

    /// Ends the windows until `now`.
    fn end_windows(&mut self, now: Cycles, lines: &mut Vec<(Cycles, String)>) {
        while now >= self.window_from + WINDOW {
            self.window_from += WINDOW;
            let edges = std::mem::take(&mut self.window);
            let shown = if edges.len() > EDGES_SHOWN {
                tone(&edges).unwrap_or(self.shown)
            } else {
                Shown::Level(self.level)
            };
            self.show(self.window_from, shown, lines);
        }
    }

    fn show(&mut self, at: Cycles, shown: Shown, lines: &mut Vec<(Cycles, String)>) {
        if !self.shown.is_same(shown) {
            self.shown = shown;
            lines.push((at, self.text()));
        }
    }
}

/// Frequency and share of the whole periods in these edges, without the gaps between bursts.
fn tone(edges: &[(Cycles, bool)]) -> Option<Shown> {
    let rises = edges.iter().enumerate().filter(|(_, (_, level))| *level);
    let rises: Vec<(usize, Cycles)> = rises.map(|(index, (at, _))| (index, *at)).collect();
    let mut periods: Vec<Cycles> = rises.windows(2).map(|pair| pair[1].1 - pair[0].1).collect();
    periods.sort_unstable();
    let median = *periods.get(periods.len() / 2)?;
    let (mut count, mut time, mut high) = (0, 0, 0);
    for pair in rises.windows(2) {
        let [(index, start), (_, end)] = [pair[0], pair[1]];
        if end - start < GAP * median {
            count += 1;
            time += end - start;
            high += edges.get(index + 1).map_or(end, |(fall, _)| *fall) - start;
        }
    }
    let whole = rises.last()?.1 - rises.first()?.1;
    (time > 0).then(|| Shown::Tone {
        hz: f64::from(count) * F_CPU_HZ as f64 / time as f64,
        high: high as f64 / time as f64,
        share: if time == whole { 1.0 } else { time as f64 / WINDOW as f64 },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fast_signal_is_one_line_with_its_frequency() {
        let pin = "D8".parse().unwrap();
        let edges = Rc::new(RefCell::new(Vec::new()));
        let mut watched = Watched {
            pin,
            edges: Rc::clone(&edges),
            window: Vec::new(),
            window_from: 0,
            level: false,
            shown: Shown::Level(false),
        };
        edges.borrow_mut().push((1000, true));
        assert_eq!(watched.take(2000), [(1000, "D8 high".to_owned())]);
        // 500 Hz, a quarter of the time high, for 300 ms.
        for period in 0..150 {
            let at = WINDOW + period * 32_000;
            edges.borrow_mut().extend([(at, true), (at + 8000, false)]);
        }
        let lines = watched.take(5 * WINDOW);
        let texts: Vec<&str> = lines.iter().map(|(_, text)| &**text).collect();
        assert_eq!(texts[texts.len() - 2..], ["D8 500 Hz, high 25 %", "D8 low"]);
        assert!(texts.len() <= 2 + EDGES_SHOWN, "{texts:?}");
    }

    /// As an infrared remote control sends: marks of 38.4 kHz, and spaces.
    #[test]
    fn bursts_have_the_frequency_within_and_their_share_of_the_time() {
        let period = F_CPU_HZ / 38_400;
        let bursts = (0..20).map(|burst| burst * WINDOW / 20);
        let edges: Vec<_> = bursts
            .flat_map(|start| (0..40).map(move |number| start + number * period))
            .flat_map(|at| [(at, true), (at + period / 3, false)])
            .collect();
        let shown = tone(&edges).unwrap();
        assert_eq!(shown.to_string(), "38462 Hz, high 33 %, in bursts: 20 % of the time");
    }
}
