//! BatteryInfo, from the readings of the ADC to the frames.

use super::*;

const BATTERY_INFO: u32 = 0x1804_4478;
const SIGNATURE: u64 = 0x249C_2654_8A71_1966;

/// 12.5 V and 10 A: both inputs are at 2.5 V.
fn with_circuit(values: &[(Parameter, i32)]) -> Rig {
    let circuit = [
        (Parameter::Pwr1VoltMult, 5000),
        (Parameter::Pwr1AmpPervlt, 400),
        (Parameter::BattRate, 1),
    ];
    let mut rig = Rig::with(&[&circuit[..], values].concat());
    rig.circuit = [512, 512];
    rig
}

/// The payloads of the BatteryInfos, with their transfer IDs.
fn infos(rig: &Rig) -> Vec<(Vec<u8>, u8)> {
    let transfers = rig.transfers(BATTERY_INFO, SIGNATURE);
    transfers.into_iter().map(|(_, payload, transfer_id)| (payload, transfer_id)).collect()
}

/// What pydronecan sends, whose NaN is 7FFF and ours 7E00.
fn golden_info(text: &str) -> (Vec<u8>, u8) {
    let (mut payload, transfer_id) = golden::payload(SIGNATURE, &golden::frames(text));
    for number in payload[..14].chunks_mut(2).filter(|number| number == &[0xFF, 0x7F]) {
        number.copy_from_slice(&[0x00, 0x7E]);
    }
    (payload, transfer_id)
}

#[test]
fn the_golden_battery_info_is_sent() {
    let mut rig = with_circuit(&[
        (Parameter::BattCapacity, 1300),
        (Parameter::BattId, 7),
        (Parameter::BattTemp, 1),
        (Parameter::Pwr1AmpMax, 999),
    ]);
    rig.run(36_500);
    // 100 mAh were drawn, and 1.2 Ah at 12.5 V are left.
    assert_eq!(
        infos(&rig).pop().unwrap(),
        golden_info(
            "18044478 77 12 A9 5C 40 4A 00 83 | 49 FF 7F 80 4B 10 4C 23 | 00 00 21 1F EE 7F 07 03 \
             | 00 00 00 00 63"
        )
    );
}

#[test]
fn the_charge_of_a_time_without_measurements_is_not_known() {
    let mut rig = with_circuit(&[(Parameter::BattCapacity, 1000)]);
    let charge_percent = |rig: &mut Rig| {
        rig.run(1000);
        let (payload, _) = infos(rig).pop().unwrap();
        (payload[16] & 0x3F) << 1 | payload[17] >> 7
    };
    rig.run(35_000);
    assert_eq!(charge_percent(&mut rig), 90);
    rig.set(Parameter::BattRate, 0);
    rig.run(90_000);
    rig.set(Parameter::BattRate, 1);
    assert_eq!(charge_percent(&mut rig), 90);
}
