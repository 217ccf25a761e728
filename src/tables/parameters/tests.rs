//! Every parameter, in every build.

use dronecan_wire::crc;

use super::*;
use crate::image::InMemory;

/// Name, minimum, maximum and default of every parameter, in the order of their indices.
fn table() -> std::vec::Vec<(std::string::String, i32, i32, i32)> {
    let mut table = std::vec::Vec::new();
    table.extend(SINGLE.iter().map(|&(name, min, max, value)| (name.to_owned(), min, max, value)));
    for output in 1..=OUTPUTS as i32 {
        for &(name, min, max, value) in TEMPLATE {
            let value = if name == "ID" { output } else { value };
            table.push((format!("OUT{output}_{name}"), min, max, value));
        }
    }
    table
}

#[test]
fn the_digest_is_the_crc_of_layout_number_of_outputs_and_all_names_and_ranges() {
    let range =
        |min: i32, max: i32| [(min as u16).to_le_bytes(), (max as u16).to_le_bytes()].concat();
    let rows = SINGLE.iter().chain(TEMPLATE);
    let bytes = rows.flat_map(|&(name, min, max, _)| {
        // A build that finds the rate takes what another one has saved.
        let min = if name == "CAN_BAUDRATE" { 0 } else { min };
        [name.as_bytes(), &range(min, max)].concat()
    });
    assert_eq!(DIGEST, [LAYOUT, OUTPUTS as u8].into_iter().chain(bytes).fold(0xFFFF, crc::step));
}

/// Sets a parameter to a number. Returns false if it does not fit in 32 bits.
fn set(parameters: &mut Parameters, index: u8, number: i64) -> bool {
    i32::try_from(number).is_ok_and(|number| parameters.set(index, number, InMemory))
}

fn fresh() -> Parameters {
    let mut parameters = Parameters::new();
    parameters.set_defaults(InMemory);
    parameters
}

/// Fresh ones in which the parameter with this name can have each value of its range: those of
/// motors need a motor.
fn fresh_for(name: &str) -> Parameters {
    let mut parameters = fresh();
    if name.starts_with("ESC_") {
        assert!(set(&mut parameters, OutputParameter::Type.index(0), 1));
    }
    parameters
}

#[test]
fn all_of_a_range_can_be_set_and_nothing_else() {
    for (index, (name, min, max, _)) in table().into_iter().enumerate() {
        if index == usize::from(Parameter::CanBaudrate.index()) {
            continue;
        }
        let mut parameters = fresh_for(&name);
        for number in -67_000..70_000 {
            let before = parameters;
            let is_set = set(&mut parameters, index as u8, number.into());
            assert_eq!(is_set, (min..=max).contains(&number), "{name} {number}");
            if is_set {
                assert_eq!(parameters.value(index as u8), Some(number as u16));
            } else {
                assert_eq!(parameters, before, "{name} {number}");
            }
        }
        for number in [
            i32::MIN,
            i32::MIN + 500,
            -0x7FFF_0000,
            0x0002_0001,
            0x00FF_0000,
            0x7FFF_FE0C,
            i32::MAX,
        ] {
            assert!(!set(&mut parameters, index as u8, number.into()), "{name} {number}");
        }
    }
}

#[test]
fn values_out_of_range_are_replaced_by_the_defaults_and_no_others() {
    for (index, (name, min, max, default)) in table().into_iter().enumerate() {
        // All values around the ends of each range, and some of all the others.
        let around = |end: i32| (end - 3..=end + 3).map(|number| number as u16);
        for value in (0..=u16::MAX)
            .step_by(97)
            .chain(around(min))
            .chain(around(max))
            .chain([i16::MAX as u16, u16::MAX])
        {
            let number = if min < 0 { i32::from(value as i16) } else { i32::from(value) };
            let mut parameters = fresh();
            parameters.bytes()[2 * index..][..2].copy_from_slice(&value.to_le_bytes());
            let is_good = (min..=max).contains(&number);
            assert_eq!(parameters.repair(InMemory), !is_good, "{name} {number}");
            let expected = if is_good { value } else { default as u16 };
            assert_eq!(parameters.value(index as u8), Some(expected), "{name} {number}");
        }
    }
}

#[test]
fn every_parameter_is_found_by_its_name_and_has_it() {
    for (index, (name, ..)) in table().into_iter().enumerate() {
        assert_eq!(Parameters::find(name.as_bytes(), InMemory), index as u8, "{name}");
        let (response, len) = Response::new(index as u8, 0, InMemory);
        let stored: std::vec::Vec<u8> =
            (NUMBERS_LEN..len).map(|at| response.byte(at, InMemory)).collect();
        assert_eq!(stored, name.as_bytes());
    }
}
