//! The variables in RAM, but for some bytes in [`idle`](crate::registers::idle) registers.
//!
//! The linker places them so that the request for an update and the count of restarts are in the
//! part of the RAM that the program leaves alone (`build.rs`, [`firmware::handover`]).
//!
//! Y points to [`Information::node_id`]: `start.rs` sets it, and nothing changes it, because the
//! compiler keeps Y free for functions with variables on the stack, of which the loader has none
//! (scripts/boot checks that). Instructions that reach a variable from Y are half as long as those
//! with an address. [`Near`] is such a variable.

use core::arch::asm;
use core::mem::{MaybeUninit, offset_of};

use firmware::handover::{PATH_LEN, REQUEST, RESTARTS, SHARED_RAM};

use crate::layout::{Frame, Information, RECEIVED_LEN, Update};

#[repr(C)]
struct Variables {
    received: [u8; RECEIVED_LEN],
    information: Information,
    frame: Frame,
    response: [u8; 3],
    received_end: u16,
    /// Seconds of listening without a frame or an error.
    quiet_s: u8,
    /// Ends with the request for an update, where the shared RAM begins.
    update: Update,
    /// Count of watchdog restarts.
    restarts: u8,
}

#[unsafe(link_section = ".noinit")]
static mut VARIABLES: MaybeUninit<Variables> = MaybeUninit::uninit();

/// Bytes of the variables before the request.
const BEFORE_REQUEST: usize = offset_of!(Variables, update.request);

/// Address of the variables. The stack is below.
pub const ADDRESS: u16 = decimal(env!("RAM_END")) - SHARED_RAM - BEFORE_REQUEST as u16;

const _: () = assert!(
    ADDRESS == decimal(env!("VARIABLES")),
    "boot/build.rs has another length of the variables"
);
const _: () =
    assert!(REQUEST == 0 && RESTARTS as usize == offset_of!(Variables, restarts) - BEFORE_REQUEST);

/// Offset in the variables of the address in Y.
const Y: usize = offset_of!(Variables, information.node_id);

/// The address in Y.
pub const ADDRESS_IN_Y: u16 = ADDRESS + Y as u16;

/// The number with these digits.
const fn decimal(digits: &str) -> u16 {
    match u16::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => panic!("a number of avr-specs is not from 0 to 65535"),
    }
}

/// A byte of the variables, by its distance from the address in Y.
#[derive(Clone, Copy)]
pub struct Near<const DISTANCE: usize>;

impl<const DISTANCE: usize> Near<DISTANCE> {
    /// Reads the variable.
    #[inline(always)]
    pub fn read(self) -> u8 {
        const { assert!(DISTANCE < 64, "LDD and STD reach 64 bytes") };
        let value;
        // SAFETY: Y points to the variables, of which only raw pointers exist.
        unsafe {
            asm!("ldd {0}, Y+{1}", out(reg) value, const DISTANCE,
                options(readonly, nostack, preserves_flags));
        }
        value
    }

    /// Writes the variable.
    #[inline(always)]
    pub fn write(self, value: u8) {
        const { assert!(DISTANCE < 64, "LDD and STD reach 64 bytes") };
        // SAFETY: as in `read`.
        unsafe {
            asm!("std Y+{1}, {0}", in(reg) value, const DISTANCE,
                options(nostack, preserves_flags));
        }
    }
}

/// A word of the variables, little-endian, by its distance from the address in Y.
#[derive(Clone, Copy)]
pub struct NearWord<const DISTANCE: usize>;

impl<const DISTANCE: usize> NearWord<DISTANCE> {
    /// Reads the variable.
    #[inline(always)]
    pub fn read(self) -> u16 {
        const { assert!(DISTANCE < 63, "LDD and STD reach 64 bytes") };
        let value;
        // SAFETY: as in `Near::read`.
        unsafe {
            asm!("ldd {0:l}, Y+{1}", "ldd {0:h}, Y+{1}+1", out(reg_pair) value, const DISTANCE,
                options(readonly, nostack, preserves_flags));
        }
        value
    }

    /// Writes the variable.
    #[inline(always)]
    pub fn write(self, value: u16) {
        const { assert!(DISTANCE < 63, "LDD and STD reach 64 bytes") };
        // SAFETY: as in `Near::read`.
        unsafe {
            asm!("std Y+{1}, {0:l}", "std Y+{1}+1, {0:h}", in(reg_pair) value, const DISTANCE,
                options(nostack, preserves_flags));
        }
    }
}

macro_rules! near {
    ($($(#[$doc:meta])* $name:ident = $($field:tt).+ $(+ $n:expr)?;)*) => {
        $(
            $(#[$doc])*
            pub const $name: Near<{ offset_of!(Variables, $($field).+) - Y $(+ $n)? }> = Near;
        )*
    };
}

near! {
    /// ID of this node.
    NODE_ID = information.node_id;
    CNF3 = information.cnf;
    CNF2 = information.cnf + 1;
    CNF1 = information.cnf + 2;
    /// The last received frame.
    FRAME_SIDH = frame.id;
    FRAME_SIDL = frame.id + 1;
    FRAME_EID8 = frame.id + 2;
    FRAME_EID0 = frame.id + 3;
    FRAME_LEN = frame.len;
    /// The payload of a response of one byte.
    RESPONSE = response + 2;
    /// High byte of [`OFFSET`].
    OFFSET_HIGH = update.offset + 1;
    /// Length of the path of the file.
    REQUEST_PATH_LEN = update.request + PATH_LEN;
    /// The node that has the file. While the loader waits for a request of BeginFirmwareUpdate: its
    /// sender.
    SERVER = update.request + PATH_LEN + 1;
    /// Last byte of the request.
    REQUEST_END = update.request + PATH_LEN + 3;
    RESTART_COUNT = restarts;
    QUIET_S = quiet_s;
}

/// Length of the program that is being read. Zero until the first answer.
pub const PROGRAM_LEN: NearWord<{ offset_of!(Variables, update.length) - Y }> = NearWord;
/// Offset in the file of the next answer.
pub const OFFSET: NearWord<{ offset_of!(Variables, update.offset) - Y }> = NearWord;
/// Index in the received transfer behind its last byte.
pub const RECEIVED_END: NearWord<{ offset_of!(Variables, received_end) - Y }> = NearWord;

/// Address of a field.
macro_rules! address_of {
    ($($field:tt).+) => {{
        let variables = (&raw mut VARIABLES).cast::<Variables>();
        // SAFETY: the pointer is to a static, so the field is valid.
        unsafe { &raw mut (*variables).$($field).+ }
    }};
}

/// The last received frame.
#[inline(always)]
pub fn frame() -> *mut Frame {
    address_of!(frame)
}

/// The transfer that is being received.
#[inline(always)]
pub fn received() -> *mut u8 {
    address_of!(received).cast()
}

/// Byte `n` of [`received`], from a constant address.
#[inline(always)]
pub fn received_byte(n: usize) -> u8 {
    // SAFETY: callers pass constants that are less than `RECEIVED_LEN`.
    unsafe { received().add(n).read() }
}

/// The word from byte `n` of [`received`] on, little-endian.
#[inline(always)]
pub fn received_word(n: usize) -> u16 {
    // SAFETY: as in `received_byte`.
    unsafe { received().add(n).cast::<u16>().read_unaligned() }
}

/// The buffer for the responses of one byte.
#[inline(always)]
pub fn response() -> *mut u8 {
    address_of!(response).cast()
}

/// What the node says about itself.
#[inline(always)]
pub fn information() -> *mut Information {
    address_of!(information)
}

/// The request of file.Read: room for the CRC, and the payload behind it.
#[inline(always)]
pub fn read_request() -> *mut u8 {
    address_of!(update.crc).cast()
}

/// The request for an update.
#[inline(always)]
pub fn request() -> *mut u8 {
    address_of!(update.request).cast()
}

/// Clears all variables but what the program has left.
#[inline(always)]
pub fn clear() {
    // SAFETY: the loop writes the bytes before the request, of which any value is valid.
    unsafe {
        asm!("2: st X+, r1", "sbiw {left}, 1", "brne 2b",
            inout("X") (&raw mut VARIABLES).cast::<u8>() => _,
            left = inout(reg_iw) BEFORE_REQUEST => _, options(nostack));
    }
}
