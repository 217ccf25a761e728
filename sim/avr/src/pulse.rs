//! Measures the pulses of a pin from its edges.

use sim_base::Cycles;

/// A high pulse that has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pulse {
    /// Time of the rising edge.
    pub start: Cycles,
    /// Time from the rising to the falling edge, in CPU cycles.
    pub width_cycles: u64,
    /// Time from the last rising edge to this one, in CPU cycles; `None` for the first pulse.
    pub period_cycles: Option<u64>,
}

impl Pulse {
    /// Width in microseconds.
    pub fn width_us(&self) -> f64 {
        self.width_cycles as f64 * 1e6 / sim_base::F_CPU_HZ as f64
    }
}

/// Measures pulses. Feed it each edge once, in order of time.
#[derive(Debug, Default)]
pub struct PulseMeter {
    rise: Option<Cycles>,
    earlier_rise: Option<Cycles>,
}

impl PulseMeter {
    /// A meter before the first edge.
    pub fn new() -> PulseMeter {
        PulseMeter::default()
    }

    /// Takes edges and returns the pulses that ended with them.
    pub fn feed(&mut self, edges: impl IntoIterator<Item = (Cycles, bool)>) -> Vec<Pulse> {
        let mut pulses = Vec::new();
        for (at, level) in edges {
            if level {
                self.rise.get_or_insert(at);
            } else if let Some(start) = self.rise.take() {
                let period_cycles = self.earlier_rise.map(|earlier| start - earlier);
                self.earlier_rise = Some(start);
                pulses.push(Pulse { start, width_cycles: at - start, period_cycles });
            }
        }
        pulses
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_is_reported_when_it_ends() {
        let mut meter = PulseMeter::new();
        assert_eq!(meter.feed([(10, true)]), []);
        assert_eq!(
            meter.feed([(30, false)]),
            [Pulse { start: 10, width_cycles: 20, period_cycles: None }]
        );
        assert_eq!(
            meter.feed([(110, true), (135, false)]),
            [Pulse { start: 110, width_cycles: 25, period_cycles: Some(100) }]
        );
    }

    #[test]
    fn a_falling_edge_alone_is_not_a_pulse() {
        assert_eq!(PulseMeter::new().feed([(5, false)]), []);
    }
}
