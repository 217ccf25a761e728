//! Stand-ins for the chip, with which tests on the host run `transfer.rs`.
//!
//! All memory that it may touch is the transfer that is being received. The bytes behind it must
//! stay as they are. Reading beyond it panics.

use std::cell::{Cell, RefCell, UnsafeCell};

use crate::layout::RECEIVED_LEN;

/// Bytes behind the received transfer.
const GUARD: usize = 64;
const UNTOUCHED: u8 = 0xA5;

thread_local! {
    static RECEIVED: UnsafeCell<[u8; RECEIVED_LEN + GUARD]> =
        const { UnsafeCell::new([UNTOUCHED; RECEIVED_LEN + GUARD]) };
    static FRAME: UnsafeCell<[u8; 8]> = const { UnsafeCell::new([0; 8]) };
    static RECEIVED_END: Cell<u16> = const { Cell::new(0) };
    static GPIOR1: Cell<u8> = const { Cell::new(0) };
    static SENT: RefCell<Vec<Vec<u8>>> = const { RefCell::new(Vec::new()) };
}

/// The bytes that must stay as they are.
pub fn assert_nothing_behind_is_touched() {
    let received = RECEIVED.with(UnsafeCell::get);
    // SAFETY: no reference to the array exists in this thread.
    assert_eq!(unsafe { (&*received)[RECEIVED_LEN..].to_vec() }, [UNTOUCHED; GUARD]);
}

/// Puts the data of a frame where the controller leaves them.
pub fn set_data(data: &[u8]) {
    let frame = FRAME.with(UnsafeCell::get);
    // SAFETY: no reference to the array exists in this thread.
    unsafe { (&mut *frame)[..data.len()].copy_from_slice(data) };
}

/// The received transfer, from its start on.
pub fn received_bytes(range: std::ops::Range<usize>) -> Vec<u8> {
    let received = RECEIVED.with(UnsafeCell::get);
    // SAFETY: no reference to the array exists in this thread.
    unsafe { (&*received)[range].to_vec() }
}

/// The data of the frames that were sent.
pub fn take_sent() -> Vec<Vec<u8>> {
    SENT.take()
}

pub mod registers {
    use super::GPIOR1;

    pub struct Register;

    impl Register {
        pub fn read(self) -> u8 {
            GPIOR1.get()
        }

        pub fn write(self, value: u8) {
            GPIOR1.set(value);
        }
    }

    pub mod idle {
        pub const GPIOR1: super::Register = super::Register;
    }
}

pub mod variables {
    use super::{RECEIVED, RECEIVED_LEN};

    pub struct ReceivedEnd;
    pub const RECEIVED_END: ReceivedEnd = ReceivedEnd;

    impl ReceivedEnd {
        pub fn read(self) -> u16 {
            super::RECEIVED_END.get()
        }

        pub fn write(self, value: u16) {
            super::RECEIVED_END.set(value);
        }
    }

    pub fn received() -> *mut u8 {
        RECEIVED.with(std::cell::UnsafeCell::get).cast()
    }

    pub fn received_word(n: usize) -> u16 {
        assert!(n + 2 <= RECEIVED_LEN);
        // SAFETY: both bytes are in the array.
        unsafe { received().add(n).cast::<u16>().read_unaligned() }
    }
}

pub mod can {
    use super::{FRAME, SENT};

    pub fn data() -> *const u8 {
        FRAME.with(std::cell::UnsafeCell::get).cast()
    }

    pub fn wait_for_room() -> bool {
        true
    }

    pub fn begin_frame(_sidh: u8, _sidl: u8, _eid8: u8, _eid0: u8) {
        SENT.with_borrow_mut(|sent| sent.push(Vec::new()));
    }

    /// A byte of the frame: first its length, then the data.
    pub fn exchange(byte: u8) -> u8 {
        SENT.with_borrow_mut(|sent| sent.last_mut().expect("a frame").push(byte));
        0
    }

    pub fn send() {
        SENT.with_borrow_mut(|sent| {
            let frame = sent.last_mut().expect("a frame");
            assert_eq!(usize::from(frame.remove(0)), frame.len());
        });
    }
}

pub mod crc {
    /// The CRC of bytes of the received transfer, or of any others of at most 300.
    ///
    /// # Safety
    ///
    /// The bytes must be readable.
    pub unsafe fn of(seed: u16, bytes: *const u8, len: u16) -> u16 {
        assert!(len != 0 && len <= 300, "{len} bytes");
        let begin = super::variables::received().addr();
        let end = begin + super::RECEIVED_LEN;
        let (from, to) = (bytes.addr(), bytes.addr() + usize::from(len));
        assert!(to <= begin || from >= end || (from >= begin && to <= end), "beyond the transfer");
        // SAFETY: the caller guarantees that the bytes are readable.
        let bytes = unsafe { std::slice::from_raw_parts(bytes, len.into()) };
        bytes.iter().fold(seed, |crc, byte| dronecan_wire::crc::step(crc, *byte))
    }
}
