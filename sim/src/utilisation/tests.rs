//! Tests of the command as a user types it.

use super::*;
use crate::links::scratch::Scratch;
use clap::{CommandFactory, Parser};

#[derive(Debug, Parser)]
struct Line {
    #[command(flatten)]
    args: Args,
}

/// Splits a line like a shell, as far as the examples need it.
fn words(line: &str) -> Vec<String> {
    let quoted = line.split('"').enumerate();
    quoted
        .flat_map(|(part, text)| match part % 2 {
            0 => text.split_whitespace().map(str::to_owned).collect(),
            _ => vec![text.to_owned()],
        })
        .collect()
}

#[track_caller]
fn typed(line: &str) -> Result<String> {
    let args = Line::try_parse_from(words(line))?.args;
    let mut out = Vec::new();
    run(&args, &mut out)?;
    Ok(String::from_utf8(out)?)
}

/// The words of the first line of the table that contains `label`.
#[track_caller]
fn row<'a>(text: &'a str, label: &str) -> Vec<&'a str> {
    let line = text
        .lines()
        .find(|line| line.contains(label))
        .unwrap_or_else(|| panic!("no {label}: {text}"));
    line.split_whitespace().collect()
}

/// A file with a text, in a directory that is removed on drop.
fn file(text: &str) -> (Scratch, String) {
    let scratch = Scratch::new();
    let path = scratch.path("vehicle.txt");
    std::fs::write(&path, text).unwrap();
    (scratch, path.to_str().unwrap().to_owned())
}

#[test]
fn the_command_line_is_consistent() {
    Line::command().debug_assert();
}

#[test]
fn every_example_of_the_help_works() {
    let (_scratch, vehicle) = file("NodeStatus@1\n");
    let lines: Vec<_> =
        EXAMPLES.lines().filter_map(|line| line.trim().strip_prefix("sim utilisation ")).collect();
    assert!(lines.len() >= 6);
    for line in lines {
        let line = line.replace("vehicle.txt", &vehicle);
        assert!(!typed(&format!("utilisation {line}")).unwrap().is_empty(), "{line}");
    }
}

#[test]
fn the_help_has_the_form_of_a_message_and_the_examples() {
    let help = Line::command().render_long_help().to_string();
    for expected in
        ["[NODESx] TYPE[COUNT]@RATE", "--example quadcopter", "stuff bit", "ardupilot-15-servos"]
    {
        assert!(help.contains(expected), "{expected} is missing: {help}");
    }
}

/// The published total at 1 Mbit/s is 7.176 %. That is our minimum, because the rule has no stuff
/// bits.
#[test]
fn the_quadcopter_takes_at_least_what_is_published() {
    let text = typed("utilisation --example quadcopter").unwrap();
    let total = row(&text, " total");
    assert_eq!(total[2], "7.176", "{text}");
    for (bit_rate, percent) in [("125000", "57.408"), ("250000", "28.704"), ("500000", "14.352")] {
        assert_eq!(row(&text, &format!("{bit_rate} bit/s"))[2], percent, "{text}");
    }
    assert!(text.contains("Fine"), "{text}");
}

#[test]
fn every_example_can_be_planned_and_an_overloaded_bus_causes_a_warning() {
    for example in ["quadcopter", "thesis", "ardupilot-15-servos"] {
        let text = typed(&format!("utilisation --example {example}")).unwrap();
        assert!(text.contains("Fine"), "{text}");
    }
    let text = typed("utilisation --example quadcopter --bit-rate 125000").unwrap();
    assert!(text.contains("WARNING"), "{text}");
    assert!(text.contains("The heaviest is esc.RawCommand[4]"), "{text}");
}

#[test]
fn a_file_gives_messages_and_bit_rate_and_options_come_on_top() {
    let text = "# my vehicle\nbit-rate 250000\n4x esc.Status@50   # ESCs\n\nNodeStatus@1\n";
    let (_scratch, path) = file(text);
    let text = typed(&format!("utilisation --file {path} --message Temperature@1")).unwrap();
    assert!(text.contains("at 250000 bit/s"), "{text}");
    assert_eq!(row(&text, "esc.Status")[..6], ["4", "esc.Status", "50", "14", "3", "353"]);
    assert_eq!(row(&text, "Temperature")[..6], ["1", "Temperature", "1", "5", "1", "115"]);
    let text = typed(&format!("utilisation --file {path} --bit-rate 500000")).unwrap();
    assert!(text.contains("at 500000 bit/s"), "{text}");
}

#[test]
fn mistakes_in_a_file_are_reported_with_their_line() {
    for (content, place) in
        [("NodeStatus@1\nNonsense@1\n", "line 2"), ("bit-rate fast\n", "10000 to 1000000")]
    {
        let (_scratch, path) = file(content);
        let error = typed(&format!("utilisation --file {path}")).unwrap_err();
        assert!(format!("{error:#}").contains(place), "{error:#}");
    }
    let error = typed("utilisation --file /nonexistent/plan").unwrap_err();
    assert!(format!("{error:#}").contains("cannot read /nonexistent/plan"), "{error:#}");
}

#[test]
fn without_messages_the_error_has_a_remedy() {
    let error = typed("utilisation").unwrap_err();
    assert!(error.to_string().contains("--example"), "{error}");
    assert!(typed("utilisation --bit-rate 0 --example thesis").is_err());
    let error = typed("utilisation --message NodeStatus").unwrap_err();
    assert!(error.to_string().contains("give a rate"), "{error}");
}

/// Each known type, with the longest payload and by its number.
#[test]
fn every_listed_type_can_be_planned_by_its_name() {
    let text = typed("utilisation --list").unwrap();
    let names: Vec<&str> =
        text.lines().skip(1).map(|line| line.split_whitespace().nth(1).unwrap()).collect();
    assert_eq!(names.len(), KNOWN.len());
    for name in names {
        let entry = format!("{name}@1").parse::<Entry>();
        assert!(entry.is_ok(), "{name}: {entry:?}");
    }
}
