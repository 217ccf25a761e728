//! The rule of thumb and the tables that Vertiq publishes for motor modules, to compare with the
//! exact bits.
//!
//! The rule: a frame takes 67 bits plus 8 for each data byte, so a full one takes 131. It omits
//! stuff bits, and counts 14 bits for each command of a RawCommand without padding the last byte.
//! Source: Vertiq, "DroneCAN", section "Calculating DroneCAN Bus Utilization".

use super::cost::Bits;
use super::plan::Plan;
use super::stream::Entry;
use anyhow::Result;
use std::io::Write;

/// Bits of a frame without data bytes.
const EMPTY_FRAME: f64 = 67.0;
/// Bits of a frame with seven payload bytes and the tail byte.
const FULL_FRAME: f64 = 131.0;
/// Bit rates of the tables' columns.
const BIT_RATES: [u32; 4] = [125_000, 250_000, 500_000, 1_000_000];

/// Bits of a frame with this number of data bytes, including the tail byte, by the rule.
fn frame_bits(data_bytes: f64) -> f64 {
    EMPTY_FRAME + 8.0 * data_bytes
}

/// StatusExtended in one full frame; esc.Status in two and one with two bytes and the tail byte.
fn telemetry_bits() -> f64 {
    FULL_FRAME + (2.0 * FULL_FRAME + frame_bits(3.0))
}

/// Bits of a RawCommand with this number of commands, by the rule.
fn raw_command_bits(commands: u32) -> f64 {
    if commands <= 4 {
        return FULL_FRAME - f64::from(4 - commands) * 14.0;
    }
    let bytes = 1.75 * f64::from(commands) + 2.0;
    let full_frames = (bytes / 7.0).floor();
    FULL_FRAME * full_frames + frame_bits(bytes - 7.0 * full_frames + 1.0)
}

/// A published table: a load at several rates and four bit rates.
struct Table {
    title: &'static str,
    /// Transfers per second, one line for each.
    rates_hz: &'static [u32],
    /// Bits of one period of the rate, by the rule.
    bits: f64,
    /// The messages of these bits, at 1 Hz.
    messages: &'static [&'static str],
}

impl Table {
    /// The table's value, in percent.
    fn percent(&self, rate_hz: u32, bit_rate: u32) -> f64 {
        self.bits * f64::from(rate_hz) / f64::from(bit_rate) * 100.0
    }

    /// The exact bits of the messages.
    fn exact(&self) -> Bits {
        let streams =
            self.messages.iter().flat_map(|text| text.parse::<Entry>().expect("a known message").0);
        Plan::new(1, streams.collect()).bits_per_second()
    }
}

/// The tables in the order of the document, without the sum at its end.
fn tables() -> Vec<Table> {
    let raw_command = |title, commands, rates_hz, messages| Table {
        title,
        rates_hz,
        bits: raw_command_bits(commands),
        messages,
    };
    vec![
        Table {
            title: "Telemetry of one module: esc.Status and esc.StatusExtended",
            rates_hz: &[1, 10, 50, 100, 250, 500],
            bits: telemetry_bits(),
            messages: &["esc.Status@1", "esc.StatusExtended@1"],
        },
        raw_command(
            "RawCommand with 4 commands",
            4,
            &[1, 10, 50, 100, 400, 600],
            &["RawCommand[4]@1"],
        ),
        raw_command(
            "RawCommand with 6 commands",
            6,
            &[1, 10, 50, 100, 300, 600],
            &["RawCommand[6]@1"],
        ),
        raw_command(
            "RawCommand with 8 commands",
            8,
            &[1, 10, 50, 100, 300, 600],
            &["RawCommand[8]@1"],
        ),
        raw_command("Quadcopter: its RawCommand", 4, &[400], &["RawCommand[4]@1"]),
        Table {
            title: "Quadcopter: telemetry of its 4 modules",
            rates_hz: &[10],
            bits: 4.0 * telemetry_bits(),
            messages: &["4x esc.Status@1", "4x esc.StatusExtended@1"],
        },
    ]
}

/// Prints the tables as published, each with its exact bits.
///
/// # Errors
/// If `out` cannot be written.
pub fn print(mut out: impl Write) -> Result<()> {
    writeln!(
        out,
        "Bus load in per cent by the published rule: 67 bits a frame, 8 more a byte, no stuff \
         bits."
    )?;
    let mut total = [0.0; BIT_RATES.len()];
    for table in tables() {
        writeln!(out, "\n{}", table.title)?;
        header(&mut out)?;
        for &rate_hz in table.rates_hz {
            line(
                &mut out,
                &rate_hz.to_string(),
                BIT_RATES.map(|bit_rate| table.percent(rate_hz, bit_rate)),
            )?;
        }
        if let [rate_hz] = table.rates_hz {
            total
                .iter_mut()
                .zip(BIT_RATES)
                .for_each(|(sum, bit_rate)| *sum += table.percent(*rate_hz, bit_rate));
        }
        let Bits { least, typical, most } = table.exact();
        let (rule, more) = (table.bits, (typical / table.bits - 1.0) * 100.0);
        writeln!(
            out,
            "  by the rule {rule:.0} bits; exactly {least:.0} to {most:.0}, typically \
             {typical:.1} ({more:+.1} %)"
        )?;
    }
    writeln!(out, "\nQuadcopter: total")?;
    header(&mut out)?;
    line(&mut out, "", total)?;
    writeln!(
        out,
        "\nTypical are random payloads. Where the exact bits differ, and why: docs/utilisation.md."
    )?;
    Ok(())
}

fn header(out: &mut impl Write) -> Result<()> {
    let columns =
        BIT_RATES.map(|bit_rate| format!("{:>12}", format!("{} kbit/s", bit_rate / 1000))).concat();
    Ok(writeln!(out, "  {:>6}{columns}", "Hz")?)
}

fn line(out: &mut impl Write, rate: &str, percents: [f64; 4]) -> Result<()> {
    Ok(writeln!(
        out,
        "  {rate:>6}{}",
        percents.map(|percent| format!("{percent:>12}", percent = digits(percent))).concat()
    )?)
}

/// Four decimals as in the document, without trailing zeros.
fn digits(percent: f64) -> String {
    format!("{percent:.4}").trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The published tables: rate, then per cent at 125, 250, 500 and 1000 kbit/s.
    const PUBLISHED: [&str; 6] = [
        "1 0.3872 0.1936 0.0968 0.0484\n10 3.872 1.936 0.968 0.484\n50 19.36 9.68 4.84 2.42\n100 \
         38.72 19.36 9.68 4.84\n250 96.8 48.4 24.2 12.1\n500 193.6 96.8 48.4 24.2",
        "1 0.1048 0.0524 0.0262 0.0131\n10 1.048 0.524 0.262 0.131\n50 5.24 2.62 1.31 0.655\n100 \
         10.48 5.24 2.62 1.31\n400 41.92 20.96 10.48 5.24\n600 62.88 31.44 15.72 7.86",
        "1 0.2 0.1 0.05 0.025\n10 2 1 0.5 0.25\n50 10 5 2.5 1.25\n100 20 10 5 2.5\n300 60 30 15 \
         7.5\n600 120 60 30 15",
        "1 0.2824 0.1412 0.0706 0.0353\n10 2.824 1.412 0.706 0.353\n50 14.12 7.06 3.53 1.765\n100 \
         28.24 14.12 7.06 3.53\n300 84.72 42.36 21.18 10.59\n600 169.44 84.72 42.36 21.18",
        "400 41.92 20.96 10.48 5.24",
        "10 15.488 7.744 3.872 1.936",
    ];

    #[test]
    fn every_value_of_the_published_tables_is_computed() {
        for (table, published) in tables().iter().zip(PUBLISHED) {
            let computed: Vec<String> = table
                .rates_hz
                .iter()
                .map(|&rate_hz| {
                    let percents =
                        BIT_RATES.map(|bit_rate| digits(table.percent(rate_hz, bit_rate)));
                    format!("{rate_hz} {}", percents.join(" "))
                })
                .collect();
            assert_eq!(computed.join("\n"), published, "{}", table.title);
        }
        assert_eq!(tables().len(), PUBLISHED.len());
    }

    #[test]
    fn the_printed_total_is_that_of_the_quadcopter() {
        let mut out = Vec::new();
        print(&mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        let (_, after) = text.split_once("total").unwrap();
        let total: Vec<&str> = after.lines().nth(2).unwrap().split_whitespace().collect();
        assert_eq!(total, ["57.408", "28.704", "14.352", "7.176"]);
    }

    #[test]
    fn the_numbers_of_the_published_text_are_computed() {
        assert_eq!((frame_bits(0.0), frame_bits(8.0), FULL_FRAME), (67.0, 131.0, 131.0));
        assert_eq!(telemetry_bits(), 484.0);
        assert_eq!((raw_command_bits(8), raw_command_bits(6)), (353.0, 250.0));
    }

    /// All frames have whole bytes and a tail byte. The rule is right, or too low by up to six
    /// bits.
    #[test]
    fn the_least_exact_bits_differ_from_the_rule_where_commands_do_not_fill_bytes() {
        let differs = |commands: u32| {
            let text = format!("RawCommand[{commands}]@1");
            let exact = Plan::new(1, text.parse::<Entry>().unwrap().0).bits_per_second().least;
            exact - raw_command_bits(commands)
        };
        assert_eq!([1, 2, 3, 4, 5, 6, 7, 8].map(differs), [2.0, 4.0, 6.0, 0.0, 2.0, 4.0, 6.0, 0.0]);
        let telemetry = &tables()[0];
        assert_eq!(telemetry.exact().least, telemetry.bits);
    }
}
