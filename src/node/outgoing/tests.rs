use super::*;
use crate::golden;
use crate::image::InMemory;

const UNIQUE_ID: [u8; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

/// The CRC after the signature of the type.
fn seed(signature: u64) -> u16 {
    golden::crc(signature, &[])
}

/// The signature of a type with transfers of several frames, for transfers of kept bytes.
const SIGNATURE: u64 = golden::ACTUATOR_STATUS;

/// Hands over frames until the last. Returns their text.
fn sent(outgoing: &mut Outgoing) -> String {
    let mut frames = vec![];
    for _ in 0..200 {
        if !outgoing.is_busy() {
            return golden::text(&frames);
        }
        assert!(!outgoing.is_ready());
        outgoing.step(&UNIQUE_ID, InMemory);
        if outgoing.is_ready() {
            frames.push(outgoing.frame);
            assert_eq!(outgoing.handed_over(), !outgoing.is_busy());
        }
    }
    panic!("{} frames, and no end", frames.len());
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
            assert_eq!(sent(&mut outgoing), golden::text(&expected), "{len} bytes");
        }
    }
}

#[test]
fn nothing_of_an_earlier_transfer_shows_in_a_later_one() {
    let mut outgoing = kept(&[0xFF; KEPT]);
    begin(&mut outgoing, 0x1E0A_7FF8, 31, SIGNATURE);
    sent(&mut outgoing);
    outgoing.clear();
    outgoing.put8(0x80);
    begin(&mut outgoing, 0x1E0A_7FF8, 6, 0);
    assert_eq!(sent(&mut outgoing), "1E0A7FF8 80 C6");
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
