//! The job of every firmware here, with any driver: receive, answer, report, and count.
//!
//! The answer to a frame has the next ID and the complemented data (a remote frame for a remote
//! frame). Every 25 overflows of the clock, about 102 ms, the firmware sends a counter frame.
//! Reports on the serial port:
//!
//! ```text
//! I                            the chip is configured and in normal mode
//! R 04D2 12345601#DEADBEEF     frame received, in candump's notation, 0x04D2 cycles in the crate
//! E                            the crate rejected what it read from the chip
//! X                            the crate rejected the frame to send
//! ```
//!
//! If D4 is low at the start, the firmware only receives.
//!
//! A report takes about 3 ms, twenty frame times. Frames that arrive meanwhile wait in the two
//! receive buffers.

use crate::board::{Clock, Serial, Task};
use embedded_can::{ExtendedId, Frame, Id, StandardId};

/// Mask of RXB0: all but the low byte of an extended ID.
pub const MASK_0: Id = extended(0x1FFF_FF00);
/// Mask of RXB1: the upper 13 bits of an extended ID, all 11 of a standard one. Its EID8 and EID0
/// must stay 0, because the MCP2515 applies these two to the first two data bytes of a standard
/// frame (DS20001801, section 4.5).
pub const MASK_1: Id = extended(0x1FFF_0000);
/// Filters RXF0 to RXF5; the first two belong to RXB0.
pub const FILTERS: [Id; 6] = [
    extended(0x1234_5600),
    extended(0x0ABC_DE00),
    extended(0x1555_0000),
    standard(0x321),
    extended(0x0111_0000),
    standard(0x0F0),
];

const COUNTER_ID: Id = extended(0x18C0_FFEE);
const OVERFLOWS_PER_COUNT: u8 = 25;

/// The functions of a third-party driver that the job needs.
pub trait Driver {
    type Frame: Frame;
    fn receive(&mut self) -> Received<Self::Frame>;
    /// Returns false if the driver rejects the frame.
    fn send(&mut self, frame: &Self::Frame) -> bool;
}

/// The result of a read. Not each crate can reject a frame.
pub enum Received<F> {
    Frame(F),
    Nothing,
    Refused,
}

/// Runs the job for ever. The chip must be configured and in normal mode.
pub fn run<D: Driver>(mut driver: D, mut serial: Serial, mut clock: Clock, task: Task) -> ! {
    let mut overflows: u8 = 0;
    let mut count: u16 = 0;
    report(&mut serial, b'I');
    if task == Task::ReceiveOnly {
        loop {
            if let Received::Frame(frame) = driver.receive() {
                core::hint::black_box(frame);
            }
        }
    }
    loop {
        let start = clock.cycles();
        let received = driver.receive();
        let cycles = clock.cycles().wrapping_sub(start);
        match received {
            Received::Frame(frame) => {
                if !answer::<D::Frame>(&frame).is_some_and(|answer| driver.send(&answer)) {
                    report(&mut serial, b'X');
                }
                report_frame(&mut serial, cycles, &frame);
            }
            Received::Nothing => {}
            Received::Refused => report(&mut serial, b'E'),
        }
        if clock.overflowed() {
            overflows += 1;
        }
        if overflows == OVERFLOWS_PER_COUNT {
            overflows = 0;
            count = count.wrapping_add(1);
            if !Frame::new(COUNTER_ID, &count.to_be_bytes())
                .is_some_and(|frame| driver.send(&frame))
            {
                report(&mut serial, b'X');
            }
        }
    }
}

const fn extended(id: u32) -> Id {
    match ExtendedId::new(id) {
        Some(id) => Id::Extended(id),
        None => panic!("not a 29-bit ID"),
    }
}

const fn standard(id: u16) -> Id {
    match StandardId::new(id) {
        Some(id) => Id::Standard(id),
        None => panic!("not an 11-bit ID"),
    }
}

fn answer<F: Frame>(frame: &F) -> Option<F> {
    let id = match frame.id() {
        Id::Extended(id) => Id::Extended(ExtendedId::new(id.as_raw().wrapping_add(1))?),
        Id::Standard(id) => Id::Standard(StandardId::new(id.as_raw().wrapping_add(1))?),
    };
    if frame.is_remote_frame() {
        return F::new_remote(id, frame.dlc());
    }
    let mut data = [0; 8];
    let data = data.get_mut(..frame.dlc())?;
    for (to, from) in data.iter_mut().zip(frame.data()) {
        *to = !from;
    }
    F::new(id, data)
}

fn report(serial: &mut Serial, event: u8) {
    serial.write(event);
    serial.write(b'\n');
}

fn report_frame(serial: &mut Serial, cycles: u16, frame: &impl Frame) {
    serial.write(b'R');
    serial.write(b' ');
    hex(serial, cycles.into(), 4);
    serial.write(b' ');
    match frame.id() {
        Id::Extended(id) => hex(serial, id.as_raw(), 8),
        Id::Standard(id) => hex(serial, id.as_raw().into(), 3),
    }
    serial.write(b'#');
    if frame.is_remote_frame() {
        serial.write(b'R');
        if frame.dlc() > 0 {
            hex(serial, frame.dlc() as u32, 1);
        }
    } else {
        for &byte in frame.data() {
            hex(serial, byte.into(), 2);
        }
    }
    serial.write(b'\n');
}

fn hex(serial: &mut Serial, value: u32, digits: u8) {
    for digit in (0..digits).rev() {
        serial.write(match (value >> (4 * digit)) as u8 & 0xF {
            nibble @ 0..=9 => b'0' + nibble,
            nibble => b'A' + (nibble - 10),
        });
    }
}
