//! The parameters as docs/parameters.md lists them. The page is written by hand, so the tests
//! notice a mistake in the firmware's own table.

use std::sync::LazyLock;

use super::{board, has_all_features};

const PAGE: &str = include_str!("../../docs/parameters.md");
const MANIFEST: &str = include_str!("../../Cargo.toml");

/// A parameter: name, default, minimum and maximum.
pub type Documented = (&'static str, i64, i64, i64);

/// The parameters of the preset of the board's chip, in order.
pub fn parameters() -> &'static [Documented] {
    static ALL: LazyLock<Vec<Documented>> =
        LazyLock::new(|| of_preset(if has_all_features() { "full" } else { "default" }));
    &ALL
}

fn of_preset(preset: &str) -> Vec<Documented> {
    let features = features(preset);
    let rows = PAGE.lines().filter_map(|line| row(line, &features));
    let (of_output, mut all): (Vec<_>, Vec<_>) = rows.partition(|row| row.0.starts_with("OUT1_"));
    all.iter_mut().filter(|row| row.0 == "CAN_BAUDRATE").for_each(limit_to_board);
    let outputs = if features.iter().any(|feature| feature == "outputs") { 8 } else { 1 };
    all.extend((1..=outputs).flat_map(|n| of_output.iter().map(move |row| of_nth(n, *row))));
    all
}

/// The features of a preset.
fn features(preset: &str) -> Vec<String> {
    let manifest: toml::Table = MANIFEST.parse().expect("Cargo.toml");
    let listed = manifest["features"][preset].as_array().expect("a list of features");
    listed.iter().map(|feature| feature.as_str().expect("a name").to_owned()).collect()
}

/// The parameter in a line of the page. `None` if the line has none, or if the parameter needs
/// another feature.
fn row(line: &'static str, features: &[String]) -> Option<Documented> {
    let has = |feature: &str| features.iter().any(|each| each == feature);
    let cells: Vec<_> = line.split('|').map(str::trim).collect();
    let [_, _, name, _unit, range, default, ..] = cells[..] else { return None };
    let (name, feature) = name.strip_prefix('`')?.split_once('`')?;
    if feature.split('`').nth(1).is_some_and(|feature| !has(feature)) {
        return None;
    }
    // As in "500 to 2500, with `outputs` 500 to 2400".
    let range = match range.split('`').collect::<Vec<_>>()[..] {
        [_, feature, range] if has(feature) => range,
        [range, ..] => range,
        [] => return None,
    };
    let mut numbers = range.split([' ', ',']).filter_map(|word| word.parse().ok());
    let least = numbers.next()?;
    Some((name, default.split(' ').next()?.parse().ok()?, least, numbers.next_back()?))
}

/// The page has the rates of a CAN board with a crystal of 16 MHz.
fn limit_to_board((_, default, _, greatest): &mut Documented) {
    let fastest: i64 = board().fastest_bit_rate().into();
    *default = fastest.min(*default);
    *greatest = fastest.min(*greatest);
}

/// A parameter of output `n` from that of output 1.
fn of_nth(n: i64, (name, default, least, greatest): Documented) -> Documented {
    let name: &str = name.replacen('1', &n.to_string(), 1).leak();
    (name, if name.ends_with("_ID") { n } else { default }, least, greatest)
}
