//! The recording of a logic analyser: a value change dump (IEEE 1364, 18), as sigrok-cli writes it.
//! The signals are SERVO, INT and CS.

use crate::check::measure::deviation;

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
    let unit = timescale_us(text).ok_or("the recording of the analyser has no time scale")?;
    let edges = |name: &str| edges(text, name, unit);
    let servo = edges("SERVO").ok_or("the recording of the analyser has no SERVO")?;
    let latency = edges("INT").zip(edges("CS")).and_then(|(int, cs)| latency(&int, &cs));
    Ok((pulses(&servo), latency))
}

fn timescale_us(text: &str) -> Option<f64> {
    let scale = text.split_once("$timescale")?.1.split_once("$end")?.0;
    let scale: String = scale.split_whitespace().collect();
    let at = scale.find(|c: char| !c.is_ascii_digit())?;
    let unit = [("s", 1e6), ("ms", 1e3), ("us", 1.0), ("ns", 1e-3), ("ps", 1e-6)];
    let (_, unit) = unit.into_iter().find(|(name, _)| *name == &scale[at..])?;
    Some(scale[..at].parse::<f64>().ok()? * unit)
}

fn edges(text: &str, name: &str, unit: f64) -> Option<Edges> {
    let declared = text
        .lines()
        .find(|line| line.starts_with("$var") && line.split_whitespace().nth(4) == Some(name))?;
    let id = declared.split_whitespace().nth(3)?;
    let (mut now, mut edges) = (0.0, Edges::new());
    for word in text.split_once("$enddefinitions")?.1.split_whitespace() {
        if let Some(time) = word.strip_prefix('#') {
            now = time.parse::<f64>().ok()? * unit;
        } else if let Some(level) =
            word.strip_suffix(id).filter(|level| matches!(*level, "0" | "1"))
        {
            edges.push((now, level == "1"));
        }
    }
    Some(edges)
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
            "$timescale 1 ns $end\n$var wire 1 ! SERVO $end\n$var wire 1 \" INT $end\n\
             $var wire 1 # CS $end\n$enddefinitions $end\n#0 0! 1\" 1#\n",
        );
        for n in 0..5u64 {
            let at = 1000 + n * 20_000_000;
            text += &format!(
                "#{at} 1! 0\"\n#{} 0#\n#{} 0! 1\" 1#\n",
                at + 9000 + n * 1000,
                at + 1_500_000
            );
        }
        let (pulses, latency) = measure(&text).unwrap();
        let pulses = pulses.unwrap();
        assert!((pulses.width_us - 1500.0).abs() < 1e-6 && pulses.jitter_us < 1e-6);
        assert!((pulses.period_ms - 20.0).abs() < 1e-9);
        assert!((latency.unwrap() - 13.0).abs() < 1e-6);
        assert!(measure("hello").is_err());
    }
}
