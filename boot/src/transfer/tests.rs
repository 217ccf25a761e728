//! Tests on the host, with the stand-ins of `on_host.rs`.

use super::*;
use crate::on_host::*;

const SEED: u16 = 0x1234;

/// Takes a frame. Returns the payload if it completes a transfer.
fn take_frame(data: &[u8], tail: u8) -> Option<Vec<u8>> {
    set_data(data);
    let len = take(data.len() as u8, tail, SEED)?;
    let (begin, len) = (usize::from(CRC_LEN), usize::from(len));
    assert!(len != 0 && begin + len <= RECEIVED_LEN, "{len} bytes");
    Some(received_bytes(begin..begin + len))
}

#[test]
fn what_is_sent_is_received_for_each_length() {
    for len in 1..=255 - CRC_LEN as u8 {
        let mut buffer = [0, 0].to_vec();
        buffer.extend((0..len).map(|n| n.wrapping_mul(31)));
        let outgoing = Outgoing {
            sidh: 0,
            sidl: 0,
            eid8: 0,
            eid0: 0,
            transfer_id: len % 32,
            buffer: buffer.as_mut_ptr(),
            len,
            seed: SEED,
        };
        // SAFETY: the buffer has room for the CRC and the payload.
        unsafe { send(outgoing) };
        let frames = take_sent();
        let mut payloads = Vec::new();
        for frame in frames {
            let (tail, data) = frame.split_last().unwrap();
            payloads.extend(take_frame(data, *tail));
        }
        assert_eq!(payloads, [&buffer[2..]], "{len} bytes");
    }
}

/// All three frames, each with up to seven bytes and each tail of two transfer IDs.
#[test]
fn no_three_frames_touch_what_is_not_the_transfer() {
    let tails: Vec<u8> = (0..16).map(|bits: u8| bits >> 1 << 5 | bits & 1).collect();
    let frames: Vec<(usize, u8)> =
        (0..=7).flat_map(|len| tails.iter().map(move |tail| (len, *tail))).collect();
    for first in &frames {
        for second in &frames {
            for third in &frames {
                for (len, tail) in [first, second, third] {
                    take_frame(&[0x80; 7][..*len], *tail);
                }
            }
        }
    }
    assert_nothing_behind_is_touched();
}

/// Long transfers, whose frames have all lengths.
#[test]
fn no_long_transfer_touches_what_is_not_the_transfer() {
    // A linear congruential generator (Numerical Recipes).
    let mut seed = 1u32;
    let mut random = |limit: u32| {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 16) % limit
    };
    for _ in 0..5000 {
        let mut tail = 0x80;
        for _ in 0..random(80) + 1 {
            let len = if random(4) == 0 { random(8) } else { 7 };
            if random(60) == 0 {
                tail |= 0x40;
            }
            take_frame(&[0x5A; 7][..len as usize], tail);
            tail = tail & 0x20 ^ 0x20;
        }
    }
    assert_nothing_behind_is_touched();
}

/// Frames [80] and [55 60] once made the length of the payload 65,535.
#[test]
fn a_transfer_that_is_shorter_than_its_crc_is_none() {
    for (first, second) in [(0, 0), (0, 1), (1, 0), (0, 2), (1, 1), (2, 0)] {
        assert_eq!(take_frame(&[0x55; 7][..first], 0x80), None);
        assert_eq!(take_frame(&[0x55; 7][..second], 0x60), None);
    }
}
