//! A sensor at a shaft, such as a Hall sensor with an open collector: it pulls the node's input low
//! for half of the time from one pulse to the next.

use crate::Cycles;

/// The shaft and its sensor.
#[derive(Debug, Clone, Copy, Default)]
pub struct Shaft {
    /// Time from one pulse to the next; 0 while the shaft stands still.
    period: Cycles,
    /// Times of the last and the next edge of the signal.
    last_at: Cycles,
    next_at: Cycles,
    is_low: bool,
}

impl Shaft {
    /// Changes the time from one pulse to the next at the time `now`; 0 stops the shaft. The signal
    /// goes on from its last edge.
    pub fn set_period(&mut self, period: Cycles, now: Cycles) {
        self.period = period;
        self.next_at = now.max(self.last_at + self.half_period());
    }

    /// Time of the next edge of the signal; `None` while the shaft stands still.
    pub fn next_edge(&self) -> Option<Cycles> {
        (self.period != 0).then_some(self.next_at)
    }

    /// The next edge has come. Returns the level of the signal from then on.
    pub fn pass_edge(&mut self) -> bool {
        self.is_low = !self.is_low;
        self.last_at = self.next_at;
        self.next_at += self.half_period();
        !self.is_low
    }

    fn half_period(&self) -> Cycles {
        let low = self.period / 2;
        if self.is_low { low } else { self.period - low }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The edges until a time, with their levels.
    fn edges(shaft: &mut Shaft, until: Cycles) -> Vec<(Cycles, bool)> {
        let mut edges = Vec::new();
        while let Some(at) = shaft.next_edge().filter(|&at| at < until) {
            edges.push((at, shaft.pass_edge()));
        }
        edges
    }

    #[test]
    fn the_signal_is_low_for_half_of_each_period() {
        let mut shaft = Shaft::default();
        assert_eq!(edges(&mut shaft, 1000), []);
        shaft.set_period(101, 1000);
        assert_eq!(
            edges(&mut shaft, 1202),
            [(1000, false), (1050, true), (1101, false), (1151, true)]
        );
    }

    #[test]
    fn another_speed_goes_on_from_the_last_edge_and_a_stop_keeps_the_level() {
        let mut shaft = Shaft::default();
        shaft.set_period(1000, 0);
        assert_eq!(edges(&mut shaft, 1400), [(500, false), (1000, true)]);
        shaft.set_period(200, 1400);
        assert_eq!(edges(&mut shaft, 1501), [(1400, false), (1500, true)]);
        shaft.set_period(0, 1550);
        assert_eq!(edges(&mut shaft, 9000), []);
        shaft.set_period(4000, 9000);
        assert_eq!(edges(&mut shaft, 11_001), [(9000, false), (11_000, true)]);
    }
}
