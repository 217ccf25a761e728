//! The recording of a logic analyser: a value change dump (IEEE 1364, 18), as sigrok-cli writes it.
//! The signals are SERVO, INT and CS.

use crate::check::measure::deviation;
use std::fmt::Display;
use std::io::Read;
use vcd::{Command, IdCode, Parser, ScopeItem, Value};

/// The pulses of a servo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pulses {
    pub width_us: f64,
    pub period_ms: f64,
    /// Standard deviation of the width.
    pub jitter_us: f64,
}

/// The times in microseconds at which a signal changes, and what it is then.
type Edges = Vec<(f64, bool)>;

/// Returns the pulses, if there are any, and the longest time in microseconds from the edge of INT
/// to that of CS.
///
/// # Errors
/// If the text is no recording.
pub fn measure(text: &str) -> Result<(Option<Pulses>, Option<f64>), String> {
    let wrong = |why: &dyn Display| format!("the recording of the analyser cannot be used: {why}");
    // sigrok-cli can print the sample rate before the recording. The parser needs the last line's
    // end.
    let text = &text[text.find('$').unwrap_or(text.len())..];
    let mut recording = Parser::new(text.as_bytes().chain(&b"\n"[..]));
    let header = recording.parse_header().map_err(|error| wrong(&error))?;
    let (count, unit) = header.timescale.ok_or_else(|| wrong(&"it has no time scale"))?;
    let unit_us = f64::from(count) * 1e6 / unit.divisor() as f64;
    let signals = ["SERVO", "INT", "CS"].map(|name| signal(&header.items, name));
    if signals[0].is_none() {
        return Err(wrong(&"it has no SERVO"));
    }
    let mut edges = [(); 3].map(|()| Edges::new());
    let mut now = 0.0;
    for command in recording {
        match command.map_err(|error| wrong(&error))? {
            Command::Timestamp(units) => now = units as f64 * unit_us,
            Command::ChangeScalar(id, level @ (Value::V0 | Value::V1)) => {
                if let Some(at) = signals.iter().position(|signal| *signal == Some(id)) {
                    edges[at].push((now, level == Value::V1));
                }
            }
            _ => {}
        }
    }
    let [servo, int, cs] = edges;
    Ok((pulses(&servo), latency(&int, &cs)))
}

/// The identifier of a signal, in any scope.
fn signal(items: &[ScopeItem], name: &str) -> Option<IdCode> {
    items.iter().find_map(|item| match item {
        ScopeItem::Var(var) => (var.reference == name).then_some(var.code),
        ScopeItem::Scope(scope) => signal(&scope.items, name),
        _ => None,
    })
}

fn pulses(edges: &Edges) -> Option<Pulses> {
    // The first one may have begun before the recording.
    let rises: Vec<usize> = (1..edges.len()).filter(|n| edges[*n].1 && !edges[n - 1].1).collect();
    let widths: Vec<f64> = rises
        .iter()
        .filter(|n| **n + 1 < edges.len())
        .map(|n| edges[n + 1].0 - edges[*n].0)
        .collect();
    let (first, last) = (*rises.first()?, *rises.last()?);
    if widths.len() < 2 {
        return None;
    }
    Some(Pulses {
        width_us: widths.iter().sum::<f64>() / widths.len() as f64,
        period_ms: (edges[last].0 - edges[first].0) / (rises.len() - 1) as f64 / 1e3,
        jitter_us: deviation(&widths),
    })
}

/// The longest time from a falling edge of INT to that of CS behind it.
fn latency(int: &Edges, cs: &Edges) -> Option<f64> {
    let falls = |edges: &Edges| -> Vec<f64> {
        edges.windows(2).filter(|pair| pair[0].1 && !pair[1].1).map(|pair| pair[1].0).collect()
    };
    let cs = falls(cs);
    falls(int)
        .iter()
        .filter_map(|int| cs.iter().find(|cs| *cs >= int).map(|cs| cs - int))
        .max_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pulses_and_the_latency_of_cs_are_measured() {
        let mut text = String::from(
            "META samplerate: 16000000\n$timescale 1 ns $end\n$var wire 1 ! SERVO $end\n\
             $var wire 1 \" INT $end\n$var wire 1 # CS $end\n$enddefinitions $end\n#0 0! 1\" 1#\n",
        );
        for n in 0..5u64 {
            let at = 1000 + n * 20_000_000;
            text += &format!(
                "#{at} 1! 0\"\n#{} 0#\n#{} 0! 1\" 1#\n",
                at + 9000 + n * 1000,
                at + 1_500_000
            );
        }
        let (pulses, latency) = measure(text.trim_end()).unwrap();
        let pulses = pulses.unwrap();
        assert!((pulses.width_us - 1500.0).abs() < 1e-6 && pulses.jitter_us < 1e-6);
        assert!((pulses.period_ms - 20.0).abs() < 1e-9);
        assert!((latency.unwrap() - 13.0).abs() < 1e-6);
        assert!(measure("hello").is_err());
    }
}
