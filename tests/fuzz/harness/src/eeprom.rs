//! Target `eeprom`: any contents of the EEPROM when the node starts, and a power failure during a
//! save.
//!
//! Bytes of the input: the records that get a valid CRC, index and two values of a parameter, time
//! of the power failure, value of the byte that it interrupts; then the EEPROM from its first
//! address, filled with 0xFF.
//!
//! The node must start twice with this EEPROM. If it then has a usable node ID, it must keep the
//! values that it reports as saved, keep its unique ID, and have the old value or the new one after
//! the failure.

use dronecan_host::{Message, Value, crc};
use firmware::desk::Memory;
use firmware::eeprom::EEPROM_LEN;
use firmware::hardware::OUTPUTS;
use firmware::tables::condition::ResetCause;
use firmware::tables::parameters::{self, OutputParameter, Parameter};

use crate::rig::Rig;
use crate::steps::Type;

/// The records (docs/parameters.md, EEPROM): first address, length, start of the CRC, and the bit
/// of the input that requests a valid CRC.
const RECORDS: [(usize, usize, u16, u8); 3] = [
    (0x04, 16, 0x0100, 1 << 0),
    (0x20, parameters::CELLS, parameters::DIGEST, 1 << 1),
    (SECOND_COPY, parameters::CELLS, parameters::DIGEST, 1 << 2),
];

const SECOND_COPY: usize = if OUTPUTS == 1 { 0xA0 } else { 0x220 };

/// Writes a valid CRC into a record.
fn write_valid_crc(cells: &mut [u8; EEPROM_LEN], start: usize, len: usize, sum: u16) {
    let crc = crc::feed(sum, &cells[start..start + len]);
    cells[start + len..start + len + 2].copy_from_slice(&crc.to_be_bytes());
}

/// Sets a parameter. Returns its value after that.
fn set(rig: &mut Rig, index: u8, number: u16) -> u16 {
    let [low, high] = number.to_le_bytes();
    rig.ask(Type::GetSet, &[index, 1, low, high, 0, 0, 0, 0, 0, 0]);
    rig.parameter(index).expect("a parameter")
}

/// Saves the parameters.
fn save(rig: &mut Rig) {
    let answer = rig.ask(Type::ExecuteOpcode, &[0; 7]);
    assert_eq!(answer, Some(Message::OpcodeExecuted(true)));
}

/// True if the parameters that commands depend on are within their ranges (docs/parameters.md). The
/// node trusts a record with a valid CRC, so the parameters of a record that got its CRC from this
/// harness can have any value.
fn has_travel(rig: &Rig) -> bool {
    const RANGES: [(Parameter, std::ops::RangeInclusive<u16>); 9] = [
        (OutputParameter::Id.of(0), 0..=255),
        (OutputParameter::Min.of(0), 500..=2500),
        (OutputParameter::Trim.of(0), 500..=2500),
        (OutputParameter::Max.of(0), 500..=2500),
        (OutputParameter::Reversed.of(0), 0..=1),
        (OutputParameter::Range.of(0), 10..=360),
        (OutputParameter::Fs.of(0), 0..=3),
        (OutputParameter::FsPwm.of(0), 500..=2500),
        (Parameter::ArmReq, 0..=1),
    ];
    RANGES
        .iter()
        .all(|(parameter, range)| range.contains(&rig.parameter(parameter.index()).unwrap_or(0)))
}

/// Restarts the node, as after a power cut.
fn restart(rig: &mut Rig) {
    rig.desk.memory.fails_after = None;
    rig.start(ResetCause::POWER_ON);
}

/// Runs an input.
pub fn run(input: &[u8]) {
    let Some((&[right, index, a0, a1, b0, b1, failure, garbage], cells)) =
        input.split_first_chunk()
    else {
        return;
    };
    let mut memory = Memory::blank();
    for (cell, &byte) in memory.cells.iter_mut().zip(cells) {
        *cell = byte;
    }
    for (start, len, sum, bit) in RECORDS {
        if right & bit != 0 {
            write_valid_crc(&mut memory.cells, start, len, sum);
        }
    }
    let mut rig = Rig::new(memory);
    rig.wait(1100);
    if rig.id() > 125 {
        return;
    }
    rig.leave(100);
    if rig.id() == 0 {
        return;
    }

    let id = rig.node_info().map(|info| info.unique_id);
    let index = index % parameters::COUNT as u8;
    let first = set(&mut rig, index, u16::from_le_bytes([a0, a1]));
    let response = rig.ask(Type::GetSet, &[index, 0]);
    assert!(matches!(
        response,
        Some(Message::ParameterResponse(response))
            if matches!(response.value, Value::Integer(_))
    ));
    save(&mut rig);
    restart(&mut rig);
    assert_eq!(rig.parameter(index), Some(first), "a saved value must be kept");
    if !(1..=125).contains(&rig.id()) {
        return;
    }
    assert_eq!(rig.node_info().map(|info| info.unique_id), id, "the unique ID must be kept");

    let second = set(&mut rig, index, u16::from_le_bytes([b0, b1]));
    rig.desk.memory.fails_after = Some((failure.into(), garbage));
    // The node may report that it cannot save.
    rig.ask(Type::ExecuteOpcode, &[0; 7]);
    restart(&mut rig);
    let kept = rig.parameter(index);
    assert!(
        [Some(first), Some(second)].contains(&kept),
        "{kept:?} is neither {first} nor {second}"
    );
    if has_travel(&rig) {
        rig.still_works();
    }
}
