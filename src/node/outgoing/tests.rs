use super::*;
use crate::golden;
use crate::hardware::{HARDWARE_MAJOR, HARDWARE_MINOR, NODE_NAME};
use crate::image::InMemory;
#[cfg(feature = "standard")]
use crate::tables::parameters::Parameter;

const UNIQUE_ID: [u8; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

/// The CRC after the signature of the type.
fn seed(signature: u64) -> u16 {
    golden::crc(signature, &[])
}

/// The signature of a type with transfers of several frames, for transfers of kept bytes.
const SIGNATURE: u64 = golden::ACTUATOR_STATUS;

/// Hands over frames until the last. Returns the frames, and the steps that each took.
fn sent(outgoing: &mut Outgoing) -> (Vec<Frame>, Vec<usize>) {
    let (mut frames, mut steps) = (vec![], vec![]);
    let mut n = 0;
    while outgoing.is_busy() {
        assert!(!outgoing.is_ready());
        outgoing.step(&UNIQUE_ID, InMemory);
        n += 1;
        if outgoing.is_ready() {
            frames.push(outgoing.frame);
            steps.push(core::mem::take(&mut n));
            assert_eq!(outgoing.handed_over(), !outgoing.is_busy());
        }
        assert!(n < 100);
    }
    (frames, steps)
}

fn new(form: Form) -> Outgoing {
    let mut outgoing = Outgoing::new();
    outgoing.clear();
    outgoing.payload.form = form;
    outgoing
}

fn kept(bytes: &[u8]) -> Outgoing {
    let mut outgoing = new(Form::Kept);
    for &byte in bytes {
        outgoing.put8(byte);
    }
    outgoing
}

/// Begins a transfer with this identifier and the signature of a type.
fn begin(outgoing: &mut Outgoing, id: u32, transfer_id: u8, signature: u64) {
    outgoing.begin(id.to_be_bytes(), transfer_id, seed(signature));
}

#[test]
fn kept_bytes_of_every_length_go_as_the_specification_has_it() {
    for len in 0..=KEPT {
        let bytes: Vec<u8> = (0..len).map(|n| (n * 37 + 5) as u8).collect();
        for transfer_id in [0, 1, 31] {
            let mut outgoing = kept(&bytes);
            begin(&mut outgoing, 0x1801_5778, transfer_id, SIGNATURE);
            let expected = golden::transfer(0x1801_5778, SIGNATURE, transfer_id, &bytes);
            assert_eq!(
                golden::text(&sent(&mut outgoing).0),
                golden::text(&expected),
                "{len} bytes"
            );
        }
    }
}

#[test]
fn golden_transfers_of_kept_bytes_come_out_byte_for_byte() {
    for (golden, signature, transfer_id) in [
        ("1801552A 78 56 34 12 40 EF BE C5", golden::NODE_STATUS, 5),
        ("1803F32A 67 C0 01 00 34 FF 7F 81 | FF 7F 7F 61", golden::ACTUATOR_STATUS, 1),
        ("1804562A 01 00 A9 5C 00 C2", 0, 2),
        ("1E0A7FF8 00 00 00 00 00 00 80 C4", 0, 4),
        ("1E057FF8 80 C6", 0, 6),
        ("1E0B7FF8 00 00 00 00 C2", golden::GET_SET, 2),
        #[cfg(feature = "stats")]
        (
            "18015778 73 A5 00 01 00 02 00 80 | 02 00 03 00 04 00 05 20 | 00 06 00 07 00 08 00 00 \
             | 08 00 09 00 0A 00 60",
            golden::CAN_STATS,
            0,
        ),
    ] {
        let frames = golden::frames(golden);
        let mut outgoing = kept(&golden::payload(signature, &frames).0);
        begin(&mut outgoing, golden::id(&frames[0]), transfer_id, signature);
        assert_eq!(golden::text(&sent(&mut outgoing).0), golden);
    }
}

#[test]
fn numbers_are_kept_low_byte_first() {
    let mut outgoing = new(Form::Kept);
    outgoing.put16(0x1234);
    outgoing.put8(0x40);
    outgoing.put16(0xBEEF);
    assert_eq!(
        (outgoing.payload.len, &outgoing.payload.kept[..5]),
        (5, &[0x34, 0x12, 0x40, 0xEF, 0xBE][..])
    );
}

#[test]
fn a_step_makes_four_bytes_and_the_crc_takes_as_many_steps_more() {
    for len in 0..=KEPT {
        let mut outgoing = kept(&vec![0xA5; len]);
        begin(&mut outgoing, 0, 0, SIGNATURE);
        let (frames, steps) = sent(&mut outgoing);
        let is_long = len > 7;
        let mut left = len;
        for (n, &steps) in steps.iter().enumerate() {
            let room = if n == 0 && is_long { 5 } else { 7 };
            let payload = left.min(room);
            left -= payload;
            let summing = if n == 0 && is_long { len.div_ceil(4).max(1) } else { 0 };
            assert_eq!(steps, payload.div_ceil(4).max(1) + summing, "frame {n} of {len} bytes");
        }
        assert_eq!(frames.len(), if len > 7 { (len + 2).div_ceil(7) } else { 1 });
    }
}

#[test]
fn a_frame_stays_until_it_is_handed_over() {
    let mut outgoing = kept(&[1; KEPT]);
    begin(&mut outgoing, 0, 3, SIGNATURE);
    while !outgoing.is_ready() {
        outgoing.step(&UNIQUE_ID, InMemory);
    }
    assert!(outgoing.is_ready() && outgoing.is_busy());
    assert!(!outgoing.handed_over(), "there is more");
    assert!(!outgoing.is_ready() && outgoing.is_busy());
}

#[test]
fn nothing_of_an_earlier_transfer_shows_in_a_later_one() {
    let mut outgoing = kept(&[0xFF; KEPT]);
    begin(&mut outgoing, 0x1E0A_7FF8, 31, SIGNATURE);
    sent(&mut outgoing);
    outgoing.clear();
    outgoing.put8(0x80);
    begin(&mut outgoing, 0x1E0A_7FF8, 6, 0);
    assert_eq!(golden::text(&sent(&mut outgoing).0), "1E0A7FF8 80 C6");
}

#[cfg(feature = "stats")]
#[test]
fn transport_stats_have_48_bits_for_each_number() {
    let mut outgoing = new(Form::Kept);
    for (low, high) in [(1, 0), (2, 0), (3, 0), (0x1234, 1), (0x5678, 2), (0x9ABC, 3)] {
        outgoing.put48(low, high);
    }
    begin(&mut outgoing, 0x1E04_7FF8, 5, golden::GET_TRANSPORT_STATS);
    assert_eq!(
        golden::text(&sent(&mut outgoing).0),
        "1E047FF8 FE 5C 01 00 00 00 00 85 | 00 02 00 00 00 00 00 25 | 03 00 00 00 00 00 34 05 | \
         12 01 00 00 00 78 56 25 | 02 00 00 \
         00 BC 9A 03 05 | 00 00 00 65"
    );
}

#[cfg(feature = "standard")]
fn parameter(parameter: Parameter, value: i16, transfer_id: u8) -> String {
    let mut outgoing = new(Form::Parameter);
    (outgoing.payload.parameter, outgoing.payload.len) =
        Response::new(parameter.index(), value as u16, InMemory);
    begin(&mut outgoing, 0x1E0B_7FF8, transfer_id, golden::GET_SET);
    golden::text(&sent(&mut outgoing).0)
}

#[cfg(feature = "standard")]
#[test]
fn golden_parameters_come_out_byte_for_byte() {
    assert_eq!(
        parameter(Parameter::CanNode, 42, 1),
        "1E0B7FF8 47 0A 01 2A 00 00 00 81 | 00 00 00 00 01 78 00 21 | 00 00 00 00 00 00 01 01 | \
         7D 00 00 00 00 00 00 21 | 00 01 00 \
         00 00 00 00 01 | 00 00 00 43 41 4E 5F 21 | 4E 4F 44 45 41"
    );
    assert_eq!(parameter(Parameter::CanBaudrate, 2, 2), golden::BAUDRATE_IS_500_KBIT);
    #[cfg(feature = "sensors")]
    assert_eq!(
        parameter(Parameter::TempOffset, -50, 3),
        "1E0B7FF8 F5 05 01 CE FF FF FF 83 | FF FF FF FF 01 00 00 23 | 00 00 00 00 00 00 01 03 | \
         DC 05 00 00 00 00 00 23 | 00 01 0C \
         FE FF FF FF 03 | FF FF FF 54 45 4D 50 23 | 5F 4F 46 46 53 45 54 43"
    );
    #[cfg(feature = "masks")]
    assert_eq!(
        parameter(Parameter::WarnMask, 0x1BF7, 4),
        "1E0B7FF8 EE 66 01 F7 1B 00 00 84 | 00 00 00 00 01 F7 1B 24 | 00 00 00 00 00 00 01 04 | \
         FF FF 00 00 00 00 00 24 | 00 01 00 \
         00 00 00 00 04 | 00 00 00 57 41 52 4E 24 | 5F 4D 41 53 4B 44"
    );
}

#[test]
fn the_answer_to_get_node_info_has_status_versions_unique_id_and_name() {
    let mut outgoing = kept(&[0x0A, 0, 0, 0, 0, 0, 0, 0x80]);
    outgoing.payload.form = Form::NodeInfo;
    outgoing.payload.len = information::NODE_INFO_LEN;
    begin(&mut outgoing, 0x1E01_7FF8, 3, golden::GET_NODE_INFO);
    let (payload, transfer_id) = golden::payload(golden::GET_NODE_INFO, &sent(&mut outgoing).0);
    assert_eq!(transfer_id, 3);
    assert_eq!(payload[..7], [0x0A, 0, 0, 0, 0, 0, 0]);
    let version = |text: &str| text.parse::<u8>().unwrap();
    let software = [env!("CARGO_PKG_VERSION_MAJOR"), env!("CARGO_PKG_VERSION_MINOR")].map(version);
    assert_eq!(payload[7..9], software);
    let commit = u32::from_str_radix(env!("NODE_COMMIT"), 16).unwrap();
    assert_eq!(payload[9], u8::from(commit != 0), "whether there is a commit");
    assert_eq!(payload[10..14], commit.to_le_bytes());
    assert_eq!(payload[14..22], [0; 8], "no CRC of the image");
    assert_eq!(payload[22..24], [HARDWARE_MAJOR | 0x80, HARDWARE_MINOR], "it takes no updates");
    assert_eq!(payload[24..40], UNIQUE_ID);
    assert_eq!(payload[40], 0, "no certificate");
    assert_eq!(&payload[41..], NODE_NAME.as_bytes());
}

#[cfg(feature = "update")]
#[test]
fn the_golden_refusal_of_an_update_comes_out_byte_for_byte() {
    let mut outgoing = kept(&[1]);
    outgoing.payload.form = Form::Text;
    let (text_at, text_len) = information::text(0);
    outgoing.payload.text_at = text_at;
    outgoing.payload.len = 1 + text_len;
    begin(&mut outgoing, 0x1E28_7FF8, 9, golden::BEGIN_FIRMWARE_UPDATE);
    assert_eq!(
        golden::text(&sent(&mut outgoing).0),
        "1E287FF8 07 C4 01 75 70 64 61 89 | 74 65 20 6F 76 65 72 29 | 20 55 53 42 20 73 65 09 | \
         72 69 61 6C 69"
    );
}

#[cfg(feature = "allocation")]
#[test]
fn the_sum_is_that_of_the_kept_bytes_from_0xffff() {
    // The golden request 1E974D00 has its discriminator from these bytes: bits 1 to 14 of the CRC.
    let outgoing = kept(&[0x01, 0, 1, 2, 3, 4, 5]);
    assert_eq!(u32::from(outgoing.sum()) >> 1 & 0x3FFF, 0x1E97_4D00 >> 10 & 0x3FFF);
    let check = kept(b"12345678");
    assert_eq!(check.sum(), 0xA12B);
}
