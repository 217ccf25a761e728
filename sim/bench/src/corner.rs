//! The corners of a real chip: the values in which one board differs from the next, all in
//! [`TABLE`], and the boards at its edges.
//!
//! A board without a corner has the typical values. Source: Microchip DS40002061B (ATmega328P) and
//! DS20001801J (MCP2515), by section; for what is neither chip, the part of an Arduino Uno.
//!
//! Limit: INT follows the chip at once. DS20001801J has no value for its delay.

use std::fmt;
use std::str::FromStr;

use crate::F_CPU_HZ;
use crate::avr::Silicon;
use sim_base::Noise;

/// Which of its limits a value has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    Lowest,
    Highest,
}
use End::{Highest, Lowest};

/// One row of [`TABLE`].
#[derive(Debug)]
pub struct Tolerance {
    value: Value,
    /// Its name on the command line; the unit is the end of it.
    pub name: &'static str,
    pub lowest: f64,
    /// `None`: another one for each seed of a chip.
    pub typical: Option<f64>,
    pub highest: f64,
    pub source: &'static str,
    slow: End,
    fast: End,
    worst: End,
}

/// The values that differ from board to board: lowest, typical, highest; slow, fast, worst; source.
macro_rules! tolerances {
    ($(
        $value:ident $name:literal [$lowest:expr, $typical:expr, $highest:expr]
            [$slow:ident $fast:ident $worst:ident] $source:literal;
    )*) => {
        /// A value that differs from board to board.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Value {
            $($value),*
        }

        /// Number of rows.
        const VALUES: usize = [$(Value::$value),*].len();

        /// All tolerances, in the order of [`Value`].
        pub const TABLE: [Tolerance; VALUES] = [$(Tolerance {
            value: Value::$value,
            name: $name,
            lowest: $lowest,
            typical: $typical,
            highest: $highest,
            source: $source,
            slow: $slow,
            fast: $fast,
            worst: $worst,
        }),*];
    };
}

tolerances! {
    Clock "clock-%" [-0.5, Some(0.0), 0.5] [Lowest Highest Lowest]
        "Murata CSTCE16M0V53, initial tolerance: resonator of the Uno";
    StartUp "start-ms" [0.0, Some(0.0), 73.0] [Highest Lowest Highest]
        "DS40002061B 9.3, table 9-4: 14 CK to 16K CK + 14 CK + 65 ms; 10 % of the RC oscillator";
    Eeprom "eeprom-ms" [3.06, Some(3.4), 3.74] [Highest Lowest Highest]
        "DS40002061B 8.6.3, table 8-1; \"Calibrated Internal RC Oscillator Accuracy\": 10 %";
    Flash "flash-ms" [3.7, Some(4.5), 4.5] [Highest Lowest Highest]
        "DS40002061B 27, \"Programming Time for Flash when Using SPM\"; typical: its highest";
    Watchdog "watchdog-%" [-10.0, None, 10.0] [Highest Lowest Lowest]
        "DS40002061B 9.7 and table 11-2, a time-out; by the chip's seed";
    Reference "reference-mv" [1000.0, Some(1100.0), 1200.0] [Highest Lowest Lowest]
        "DS40002061B, \"System and Reset Characteristics\": VBG";
    Adc "adc-lsb" [-2.0, Some(0.0), 2.0] [Lowest Highest Highest]
        "DS40002061B, \"ADC Characteristics\": absolute accuracy";
    BrownOut "brown-out-v" [2.5, Some(2.7), 2.9] [Lowest Highest Lowest]
        "DS40002061B, BODLEVEL 101; below 2.7 V the MCP2515 loses its registers first";
    Serial "serial-%" [-0.5, Some(0.0), 0.5] [Highest Lowest Highest]
        "the clock at the other end of the serial port: a second resonator";
    CanClock "can-clock-%" [-0.1, Some(0.0), 0.1] [Lowest Highest Highest]
        "the MCP2515's crystal; DS20001801J, \"Oscillator Tolerance\"";
    CanStartUp "can-start-ms" [0.0, Some(0.0), 10.0] [Highest Lowest Highest]
        "DS20001801J 8.1: 128 periods once the crystal is stable, which takes this";
    Floating "floating" [0.0, Some(0.0), 1.0] [Highest Highest Highest]
        "inputs that nothing drives: 0 keep their level, 1 read as noise";
}

/// Lowest supply of the MCP2515 (DS20001801J 13.0).
const MCP2515_LOWEST_V: f64 = 2.7;

/// The values of one board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corner {
    values: [Option<f64>; VALUES],
}

impl Default for Corner {
    /// The typical board.
    fn default() -> Corner {
        Corner { values: TABLE.map(|row| row.typical) }
    }
}

impl Corner {
    fn at(end: impl Fn(&Tolerance) -> End) -> Corner {
        let value = |row: Tolerance| match end(&row) {
            Lowest => row.lowest,
            Highest => row.highest,
        };
        Corner { values: TABLE.map(|row| Some(value(row))) }
    }

    /// A board with values by chance, each between its limits.
    pub fn random(seed: u64) -> Corner {
        const STEPS: u64 = 1 << 32;
        let mut noise = Noise::new(seed);
        let mut share = || noise.below(STEPS + 1) as f64 / STEPS as f64;
        let values = TABLE.map(|row| Some(row.lowest + (row.highest - row.lowest) * share()));
        Corner { values }
    }

    /// Sets one value, which may be beyond its limits.
    pub fn set(&mut self, setting: &Setting) {
        self.values[setting.value as usize] = Some(setting.to);
    }

    /// The same with the typical values of the ADC: for tests of what does not concern it.
    pub fn with_typical_adc(mut self) -> Corner {
        for value in [Value::Reference, Value::Adc] {
            self.values[value as usize] = TABLE[value as usize].typical;
        }
        self
    }

    fn get(&self, value: Value) -> f64 {
        self.values[value as usize].unwrap_or_default()
    }

    /// The values of the processor.
    pub fn silicon(&self) -> Silicon {
        let get = |value| self.get(value);
        let ppm = |value| per_million(self.get(value));
        let microseconds = |value| (self.get(value) * 1000.0).round() as u32;
        Silicon {
            clock_ppm: ppm(Value::Clock),
            start_up_us: microseconds(Value::StartUp),
            eeprom_us: microseconds(Value::Eeprom),
            flash_us: microseconds(Value::Flash),
            watchdog_ppm: self.values[Value::Watchdog as usize].map(per_million),
            reference_mv: get(Value::Reference).round() as u32,
            adc_offset: get(Value::Adc).round() as i32,
            line_ppm: ppm(Value::Serial),
            is_floating: get(Value::Floating) >= 0.5,
        }
    }

    /// Deviation of the MCP2515's crystal in parts per million, and the time that it needs to
    /// become stable, in cycles.
    pub fn can_oscillator(&self) -> (i32, u64) {
        let settling = self.get(Value::CanStartUp) * F_CPU_HZ as f64 / 1000.0;
        (per_million(self.get(Value::CanClock)), settling.round() as u64)
    }

    /// Cycles of the processor's clock in one of 16 MHz.
    pub fn clock_rate(&self) -> f64 {
        1.0 + self.get(Value::Clock) / 100.0
    }

    /// Milliseconds in which a byte of EEPROM is erased and written.
    pub fn eeprom_ms(&self) -> f64 {
        self.get(Value::Eeprom)
    }

    /// Milliseconds from a reset of the processor to its first instruction.
    pub fn start_ms(&self) -> u64 {
        self.get(Value::StartUp).ceil() as u64
    }

    /// True if the MCP2515 has lost its registers when the processor's brown-out detector resets.
    pub fn browns_out_late(&self) -> bool {
        self.get(Value::BrownOut) < MCP2515_LOWEST_V
    }
}

fn per_million(percent: f64) -> i32 {
    (percent * 10_000.0).round() as i32
}

impl FromStr for Corner {
    type Err = String;

    fn from_str(text: &str) -> Result<Corner, String> {
        match text {
            "typical" => Ok(Corner::default()),
            "slow" => Ok(Corner::at(|row| row.slow)),
            "fast" => Ok(Corner::at(|row| row.fast)),
            "worst" => Ok(Corner::at(|row| row.worst)),
            _ => match text.strip_prefix("random:").map(str::parse) {
                Some(Ok(seed)) => Ok(Corner::random(seed)),
                _ => Err(format!(
                    "no corner is called \"{text}\": use typical, slow, fast, worst or \
                     random:SEED, such as random:7"
                )),
            },
        }
    }
}

/// One value of a board: "eeprom-ms=3.8".
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setting {
    value: Value,
    to: f64,
}

impl Setting {
    /// The setting of a value by a number, with or without its unit at the end.
    ///
    /// # Errors
    /// If it is no number, or far beyond what is possible.
    pub fn parse(value: Value, number: &str) -> Result<Setting, String> {
        let name = TABLE[value as usize].name;
        let unit = name.rsplit('-').next().unwrap_or_default();
        let (least, most) = match unit {
            "%" => (-20.0, 20.0),
            "ms" => (0.0, 60_000.0),
            "mv" => (500.0, 2000.0),
            "lsb" => (-512.0, 512.0),
            "v" => (0.0, 5.0),
            _ => (0.0, 1.0),
        };
        let digits = number.strip_suffix(unit).unwrap_or(number);
        match digits.parse::<f64>() {
            Ok(to) if (least..=most).contains(&to) => Ok(Setting { value, to }),
            _ => Err(format!("{name} is \"{number}\": use a number from {least} to {most}")),
        }
    }
}

impl FromStr for Setting {
    type Err = String;

    fn from_str(text: &str) -> Result<Setting, String> {
        let (name, number) = text.split_once('=').unwrap_or((text, ""));
        match TABLE.iter().find(|row| row.name == name) {
            Some(row) => Setting::parse(row.value, number),
            None => {
                let names = TABLE.map(|row| row.name).join(", ");
                Err(format!("no value is called \"{name}\": use NAME=NUMBER with one of {names}"))
            }
        }
    }
}

/// The lines of [`TABLE`], for `--help`.
pub fn table() -> String {
    let heading =
        format!("  {:14}{:>8}{:>9}{:>9}  source\n", "name", "lowest", "typical", "highest");
    let lines = TABLE.iter().map(|row| {
        let typical = row.typical.map_or_else(|| String::from("seed"), |value| value.to_string());
        let Tolerance { name, lowest, highest, source, .. } = row;
        format!("  {name:14}{lowest:>8}{typical:>9}{highest:>9}  {source}\n")
    });
    heading + &lines.collect::<String>()
}

/// The values that differ from the typical ones: "clock-% 0.4, eeprom-ms 3.8".
impl fmt::Display for Corner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rows = TABLE.iter().zip(self.values);
        let other = rows.filter(|(row, value)| row.typical != *value);
        let texts = other.filter_map(|(row, value)| Some(format!("{} {:.3}", row.name, value?)));
        let trim = |text: String| text.trim_end_matches('0').trim_end_matches('.').to_owned();
        f.write_str(&texts.map(trim).collect::<Vec<_>>().join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_typical_value_is_between_its_limits() {
        for row in &TABLE {
            let typical = row.typical.unwrap_or(0.0);
            assert!((row.lowest..=row.highest).contains(&typical), "{}", row.name);
        }
    }

    #[test]
    fn a_typical_board_has_the_values_of_a_chip_without_a_corner() {
        let typical: Corner = "typical".parse().unwrap();
        assert_eq!(typical.silicon(), Silicon::default());
        assert_eq!(typical.can_oscillator(), (0, 0));
        assert!(!typical.browns_out_late() && typical.to_string().is_empty());
    }

    #[test]
    fn the_corners_are_at_the_limits_and_a_random_board_between_them() {
        let silicon = |corner: &str| corner.parse::<Corner>().unwrap().silicon();
        assert_eq!((silicon("slow").clock_ppm, silicon("slow").eeprom_us), (-5_000, 3_740));
        assert_eq!((silicon("fast").clock_ppm, silicon("fast").eeprom_us), (5_000, 3_060));
        assert_eq!(silicon("worst").watchdog_ppm, Some(-100_000));
        for seed in 0..200 {
            let corner = Corner::random(seed);
            for (row, value) in TABLE.iter().zip(corner.values) {
                assert!((row.lowest..=row.highest).contains(&value.unwrap()), "{}", row.name);
            }
            assert_ne!(corner, Corner::random(seed + 1));
        }
        let error = "best".parse::<Corner>().unwrap_err();
        assert!(error.ends_with("random:SEED, such as random:7"), "{error}");
        assert!("random:x".parse::<Corner>().is_err());
    }

    #[test]
    fn a_single_value_may_be_beyond_its_limits_but_not_impossible() {
        let mut corner = Corner::default();
        for setting in ["clock-%=+2%", "eeprom-ms=5", "can-start-ms=2000"] {
            corner.set(&setting.parse().unwrap());
        }
        assert_eq!((corner.silicon().clock_ppm, corner.silicon().eeprom_us), (20_000, 5_000));
        assert_eq!(corner.can_oscillator().1, 2 * F_CPU_HZ);
        assert_eq!(corner.to_string(), "clock-% 2, eeprom-ms 5, can-start-ms 2000");
        for (text, advice) in [
            ("eeprom=5", "eeprom-ms"),
            ("eeprom-ms", "from 0 to 60000"),
            ("clock-%=nan", "from -20 to 20"),
            ("clock-%=50", "from -20 to 20"),
        ] {
            let error = text.parse::<Setting>().unwrap_err();
            assert!(error.contains(advice), "{error}");
        }
    }
}
