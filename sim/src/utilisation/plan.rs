//! A planned bus: its streams with their costs, the sums, and an assessment.

use super::cost::{Bits, Cost};
use super::stream::Stream;
use anyhow::Result;
use std::io::Write;

/// Load in percent above which a burst, a retransmission or a node's start delays less urgent
/// messages.
const COMFORTABLE_PERCENT: f64 = 50.0;
/// Load in percent above which there is no room for errors. Each costs the frame and up to 23 bits
/// of error frame.
const TIGHT_PERCENT: f64 = 60.0;
/// The bit rates of DroneCAN.
const BIT_RATES: [u32; 4] = [125_000, 250_000, 500_000, 1_000_000];

/// A line of a plan.
#[derive(Clone, Debug)]
pub struct Row {
    pub stream: Stream,
    pub cost: Cost,
}

impl Row {
    /// Bits per second of all its nodes.
    pub fn bits_per_second(&self) -> Bits {
        let transfers = f64::from(self.stream.nodes) * self.stream.rate_hz;
        self.cost.bits.map(|bits| bits * transfers)
    }
}

/// The assessment of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    Comfortable,
    /// Above [`COMFORTABLE_PERCENT`].
    High,
    /// No room for errors and bursts.
    TooHigh,
    /// More than the bus can carry.
    Impossible,
}

/// The streams on a bus.
#[derive(Clone, Debug)]
pub struct Plan {
    pub bit_rate: u32,
    pub rows: Vec<Row>,
}

impl Plan {
    /// Counts the cost of each stream.
    pub fn new(bit_rate: u32, streams: Vec<Stream>) -> Plan {
        let rows =
            streams.into_iter().map(|stream| Row { cost: Cost::of(&stream), stream }).collect();
        Plan { bit_rate, rows }
    }

    /// Bits per second of all streams.
    pub fn bits_per_second(&self) -> Bits {
        self.rows.iter().fold(Bits::default(), |sum, row| sum.plus(row.bits_per_second()))
    }

    /// Load of all streams as a share of the bus.
    pub fn percent(&self) -> Bits {
        percent(self.bits_per_second(), self.bit_rate)
    }

    /// Uses the typical load; it is comfortable only if the load with the most stuff bits is, too.
    pub fn verdict(&self) -> Verdict {
        let Bits { typical, most, .. } = self.percent();
        if typical > 100.0 {
            Verdict::Impossible
        } else if typical > TIGHT_PERCENT {
            Verdict::TooHigh
        } else if most > COMFORTABLE_PERCENT {
            Verdict::High
        } else {
            Verdict::Comfortable
        }
    }

    /// Prints the plan.
    ///
    /// # Errors
    /// If `out` cannot be written.
    pub fn print(&self, mut out: impl Write) -> Result<()> {
        writeln!(out, "Planned bus at {} bit/s\n", self.bit_rate)?;
        self.print_rows(&mut out)?;
        self.print_bit_rates(&mut out)?;
        self.print_advice(&mut out)
    }

    fn print_rows(&self, out: &mut impl Write) -> Result<()> {
        let labels = self.rows.iter().map(|row| row.stream.label.len());
        let wide = labels.max().unwrap_or(0).max("message".len());
        let mut line = |label: &str, cells: [&str; 11]| -> Result<()> {
            let [nodes, rate, bytes, frames, bits @ .., per_second, least, typical, most] = cells;
            let [bits_least, bits_typical, bits_most] = bits;
            let front = format!("{nodes:>5} {label:wide$} {rate:>7} {bytes:>5} {frames:>6}");
            let bits = format!("{bits_least:>7} {bits_typical:>7} {bits_most:>7} {per_second:>9}");
            let text = format!("{front}  {bits}  {least:>7} {typical:>7} {most:>7}");
            Ok(writeln!(out, "{}", text.trim_end())?)
        };
        line("", ["", "", "", "", "bits:", "", "", "bit/s:", "load %:", "", ""])?;
        let header = [
            "nodes", "Hz", "bytes", "frames", "least", "typical", "most", "typical", "least",
            "typical", "most",
        ];
        line("message", header)?;
        for row in &self.rows {
            let Row { stream, cost } = row;
            let (sum, bits) = (row.bits_per_second(), cost.bits);
            let share = percent(sum, self.bit_rate);
            let cells = [
                stream.nodes.to_string(),
                rate(stream.rate_hz),
                stream.payload_bytes.to_string(),
                cost.frames.to_string(),
                format!("{:.0}", bits.least),
                format!("{:.1}", bits.typical),
                format!("{:.0}", bits.most),
                format!("{:.0}", sum.typical),
                format!("{:.3}", share.least),
                format!("{:.3}", share.typical),
                format!("{:.3}", share.most),
            ];
            line(&stream.label, cells.each_ref().map(String::as_str))?;
        }
        let (sum, share) = (self.bits_per_second(), self.percent());
        let [typical, shares @ ..] = [
            format!("{:.0}", sum.typical),
            format!("{:.3}", share.least),
            format!("{:.3}", share.typical),
            format!("{:.3}", share.most),
        ];
        line("total", ["", "", "", "", "", "", "", &typical, &shares[0], &shares[1], &shares[2]])
    }

    fn print_bit_rates(&self, out: &mut impl Write) -> Result<()> {
        writeln!(
            out,
            "\nThe same at    {:>10} {:>10} {:>10}   % of the bus",
            "least", "typical", "most"
        )?;
        for bit_rate in BIT_RATES {
            let Bits { least, typical, most } = percent(self.bits_per_second(), bit_rate);
            writeln!(out, "{bit_rate:>9} bit/s {least:10.3} {typical:10.3} {most:10.3}")?;
        }
        Ok(())
    }

    fn print_advice(&self, out: &mut impl Write) -> Result<()> {
        let Bits { typical, most, .. } = self.percent();
        writeln!(out)?;
        match self.verdict() {
            Verdict::Comfortable => writeln!(
                out,
                "Fine: at most {most:.2} %, so that {COMFORTABLE_PERCENT} % or more stay free for \
                 bursts, services and errors."
            )?,
            Verdict::High => writeln!(
                out,
                "WARNING: {typical:.1} %, with most stuffing {most:.1} %: above \
                 {COMFORTABLE_PERCENT} % urgent messages delay the others noticeably."
            )?,
            Verdict::TooHigh => writeln!(
                out,
                "WARNING: {typical:.1} % is too much: above {TIGHT_PERCENT} % bursts and \
                 retransmissions make messages late, and the least urgent may starve."
            )?,
            Verdict::Impossible => {
                writeln!(out, "WARNING: {typical:.1} % cannot work: the bus carries 100 %.")?
            }
        }
        if self.verdict() != Verdict::Comfortable {
            self.print_remedies(out)?;
        }
        Ok(())
    }

    fn print_remedies(&self, out: &mut impl Write) -> Result<()> {
        let load = |row: &&Row| row.bits_per_second().typical;
        if let Some(row) = self.rows.iter().max_by(|a, b| load(a).total_cmp(&load(b))) {
            let share = percent(row.bits_per_second(), self.bit_rate).typical;
            writeln!(
                out,
                "The heaviest is {}, {share:.1} %: a lower rate helps there first.",
                row.stream.label
            )?;
        }
        let comfortable =
            |rate: &&u32| percent(self.bits_per_second(), **rate).most <= COMFORTABLE_PERCENT;
        match BIT_RATES.iter().find(comfortable) {
            Some(rate) if *rate > self.bit_rate => {
                writeln!(out, "At {rate} bit/s it would be comfortable.")?
            }
            _ => writeln!(
                out,
                "No bit rate of the dialect makes it comfortable: use two buses, or lower rates."
            )?,
        }
        Ok(())
    }
}

fn percent(bits_per_second: Bits, bit_rate: u32) -> Bits {
    bits_per_second.map(|bits| bits * 100.0 / f64::from(bit_rate))
}

/// A number with only as many digits as it needs.
fn rate(rate_hz: f64) -> String {
    let text = format!("{rate_hz:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::super::stream::Entry;
    use super::*;

    fn plan(bit_rate: u32, messages: &[&str]) -> Plan {
        Plan::new(
            bit_rate,
            messages.iter().flat_map(|text| text.parse::<Entry>().unwrap().0).collect(),
        )
    }

    fn text(plan: &Plan) -> String {
        let mut out = Vec::new();
        plan.print(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn nodes_and_rate_multiply_and_rows_add_up() {
        let plan = plan(1_000_000, &["4x NodeStatus@10", "NodeStatus@5"]);
        assert_eq!(plan.bits_per_second().least, 131.0 * 45.0);
        assert!((plan.percent().most - 160.0 * 45.0 / 10_000.0).abs() < 1e-12);
    }

    /// 131 to 160 bits each: 350 a second are 46 to 56 % of 100 kbit/s.
    #[test]
    fn the_verdict_turns_with_the_load() {
        for (rate, expected) in [
            (300, Verdict::Comfortable),
            (350, Verdict::High),
            (500, Verdict::TooHigh),
            (800, Verdict::Impossible),
        ] {
            let plan = plan(100_000, &[&format!("NodeStatus@{rate}")]);
            assert_eq!(plan.verdict(), expected, "{rate} Hz");
            assert_eq!(text(&plan).contains("WARNING"), expected != Verdict::Comfortable);
        }
    }

    #[test]
    fn remedies_name_the_heaviest_message_and_a_sufficient_bit_rate() {
        let text = text(&plan(125_000, &["NodeStatus@100", "4x esc.Status@50"]));
        assert!(text.contains("The heaviest is esc.Status"), "{text}");
        assert!(text.contains("At 250000 bit/s it would be comfortable"), "{text}");
    }

    #[test]
    fn too_much_for_any_bit_rate_is_said() {
        let text = text(&plan(1_000_000, &["NodeStatus@7000"]));
        assert!(text.contains("No bit rate"), "{text}");
    }

    #[test]
    fn lines_fit_a_usual_terminal() {
        let text = text(&plan(1_000_000, &["120x BeginFirmwareUpdate@1"]));
        assert!(text.lines().all(|line| line.len() <= 120), "{text}");
    }
}
