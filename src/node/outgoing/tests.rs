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

#[cfg(feature = "allocation")]
#[test]
fn the_sum_is_that_of_the_kept_bytes_from_0xffff() {
    // The golden request 1E974D00 has its discriminator from these bytes: bits 1 to 14 of the CRC.
    let outgoing = kept(&[0x01, 0, 1, 2, 3, 4, 5]);
    assert_eq!(u32::from(outgoing.sum()) >> 1 & 0x3FFF, 0x1E97_4D00 >> 10 & 0x3FFF);
    let check = kept(b"12345678");
    assert_eq!(check.sum(), 0xA12B);
}
