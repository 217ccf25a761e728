//! The main loop, and the answers to requests.

use core::mem::{MaybeUninit, offset_of};
use core::panic::PanicInfo;

use dronecan_wire::types::{
    BEGIN_FIRMWARE_UPDATE, FILE_READ, GET_NODE_INFO, NODE_STATUS, RESTART_NODE,
};
use dronecan_wire::{Id, Tail};
use firmware::handover::{CRC_START, REQUEST, RESTARTS, SHARED_RAM};

use crate::can::{self, EXIDE, Frame, NODE_ID, SERVICE};
use crate::node_info::{Information, MAINTENANCE, MODE};
use crate::start;
use crate::transfer::{self, Outgoing, RECEIVED_LEN};
use crate::update::{self, Update};
use crate::{clock, crc};

/// The response of RestartNode, if it restarts.
const WILL_RESTART: u8 = 1 << 7;

/// uavcan.protocol.file.BeginFirmwareUpdate, the errors of the response.
mod error {
    pub const OK: u8 = 0;
    pub const IN_PROGRESS: u8 = 2;
    pub const UNKNOWN: u8 = 255;
}

/// The variables, but for some bytes in [`idle`](crate::registers::idle) registers.
#[repr(C)]
pub struct Loader {
    pub frame: Frame,
    /// Buffer for the responses of one byte.
    pub response: [u8; 3],
    pub received: [u8; RECEIVED_LEN],
    pub information: Information,
    /// Ends with the request for an update, where the shared RAM begins.
    pub update: Update,
}

/// The end of the RAM.
#[repr(C)]
struct EndOfRam {
    loader: Loader,
    /// Count of watchdog restarts.
    restarts: u8,
}

/// The linker places it so that the request and the count are in the part that the program leaves
/// alone (build.rs).
#[unsafe(link_section = ".noinit")]
static mut END_OF_RAM: MaybeUninit<EndOfRam> = MaybeUninit::uninit();

/// Bytes of the variables before the request.
const BEFORE_REQUEST: usize = offset_of!(Loader, update.request);

/// Address of the variables.
pub const ADDRESS: u16 = decimal(env!("RAM_END")) - SHARED_RAM - BEFORE_REQUEST as u16;

const _: () = assert!(
    ADDRESS == decimal(env!("VARIABLES")),
    "boot/build.rs has another length of the variables"
);
const _: () =
    assert!(REQUEST == 0 && RESTARTS as usize == offset_of!(EndOfRam, restarts) - BEFORE_REQUEST);

/// The count of watchdog restarts.
#[inline(always)]
pub fn restarts() -> *mut u8 {
    let end_of_ram = (&raw mut END_OF_RAM).cast::<EndOfRam>();
    // SAFETY: the pointer is to a static, so the field is valid.
    unsafe { &raw mut (*end_of_ram).restarts }
}

/// The number with these digits.
pub const fn decimal(digits: &str) -> u16 {
    match u16::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => panic!("a number of avr-specs is not from 0 to 65535"),
    }
}

/// SIDH and SIDL of the identifier with these first two bytes.
const fn sid(id: Id) -> [u8; 2] {
    let [first, second, ..] = id.to_bytes();
    [first << 3 | second >> 5, second << 3 & 0xE0 | EXIDE | second & 3]
}

/// SIDH without the priority, and SIDL, of a service.
const fn sid_of_service(service: u8) -> [u8; 2] {
    sid(Id::request(0, service, 0, 0))
}

const SID_OF_STATUS: [u8; 2] = sid(Id::message(24, NODE_STATUS.id, 0));
const SID_OF_READ: [u8; 2] = sid(Id::request(30, FILE_READ.id, 0, 0));

/// CRC of the magic number of RestartNode, 0xACCE551B1E. To compare that costs less than to compare
/// the number.
const CRC_OF_MAGIC: u16 = {
    let (magic, mut crc, mut n) = ([0x1E, 0x1B, 0x55, 0xCE, 0xAC], CRC_START, 0);
    while n < magic.len() {
        crc = dronecan_wire::crc::step(crc, magic[n]);
        n += 1;
    }
    crc
};

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    let variables = (&raw mut END_OF_RAM).cast::<Loader>();
    // SAFETY: this is the only reference, and any bytes are valid. The loop clears all but what the
    // program has left.
    let loader = unsafe {
        let mut byte = variables.cast::<u8>();
        let mut left = BEFORE_REQUEST as u16;
        loop {
            byte.write_volatile(0);
            byte = byte.add(1);
            left -= 1;
            if left == 0 {
                break;
            }
        }
        &mut *variables
    };
    MODE.write(MAINTENANCE);
    if start::decide(loader) {
        update::begin();
    }
    can::set_up_spi();
    clock::start();
    loader.information.set_up();
    loop {
        can::configure(loader.information.node_id, &loader.information.cnf);
        loop {
            // Before the second, which counts as one of silence.
            let outgoing = if update::is_read_due() {
                Some(read_request(loader))
            } else if clock::take_second() {
                if !can::is_on_bus() {
                    break;
                }
                update::tick();
                Some(status(loader))
            } else if can::receive(&mut loader.frame) {
                take_frame(loader)
            } else {
                None
            };
            if let Some(outgoing) = outgoing {
                // SAFETY: the buffer is a field of the loader.
                unsafe { transfer::send(outgoing) };
            }
        }
    }
}

/// The NodeStatus of this second.
#[inline(always)]
fn status(loader: &mut Loader) -> Outgoing {
    loader.information.tick();
    Outgoing {
        sidh: SID_OF_STATUS[0],
        sidl: SID_OF_STATUS[1],
        eid8: NODE_STATUS.id as u8,
        eid0: loader.information.node_id,
        // There is one in each second.
        transfer_id: loader.information.uptime_s[0] & Tail::TRANSFER_ID,
        buffer: loader.information.buffer(),
        len: Information::STATUS_LEN,
        seed: 0,
    }
}

/// The request for the next part of the file.
#[inline(always)]
fn read_request(loader: &mut Loader) -> Outgoing {
    Outgoing {
        sidh: SID_OF_READ[0],
        sidl: SID_OF_READ[1],
        eid8: can::REQUEST | *loader.update.server(),
        eid0: SERVICE | loader.information.node_id,
        transfer_id: update::next_transfer_id(),
        buffer: loader.update.buffer(),
        len: loader.update.len(),
        seed: FILE_READ.seed,
    }
}

/// Takes a frame. Returns the response if the frame completes a request.
#[inline(always)]
fn take_frame(loader: &mut Loader) -> Option<Outgoing> {
    let frame = &loader.frame;
    let len = frame.len.wrapping_sub(1);
    // A longer one is a remote frame.
    if len >= 8 {
        return None;
    }
    // SAFETY: the index is less than 8.
    let tail = unsafe { *frame.data.get_unchecked(usize::from(len)) };
    let [sidh, sidl, destination, source] = frame.id;
    let source = source & NODE_ID;
    let is_request = destination & can::REQUEST != 0;
    let is_service =
        |service| sidh & 7 == sid_of_service(service)[0] && sidl == sid_of_service(service)[1];
    let mut response = Outgoing {
        sidh: 0,
        sidl: 0,
        eid8: 0,
        eid0: 0,
        transfer_id: tail & Tail::TRANSFER_ID,
        buffer: (&raw mut loader.response).cast::<u8>(),
        len: 1,
        // Only the response of GetNodeInfo has more than one frame.
        seed: GET_NODE_INFO.seed,
    };
    let mut byte = 0;
    if is_request && is_service(GET_NODE_INFO.id) {
        response.buffer = loader.information.buffer();
        response.len = Information::LEN;
    } else if is_request && is_service(RESTART_NODE.id) {
        // SAFETY: the data is longer than the number.
        if unsafe { crc::of(CRC_START, frame.data.as_ptr(), 5) } == CRC_OF_MAGIC {
            start::restart_soon();
            byte = WILL_RESTART;
        }
    } else if is_request && update::is_active() && is_service(BEGIN_FIRMWARE_UPDATE.id) {
        if tail & Tail::END == 0 {
            return None;
        }
        byte = error::IN_PROGRESS;
    } else {
        let seed;
        if update::is_active() {
            if is_request || !is_service(FILE_READ.id) || !update::is_answer(tail) {
                return None;
            }
            seed = FILE_READ.seed;
        } else {
            if !is_request || !is_service(BEGIN_FIRMWARE_UPDATE.id) {
                return None;
            }
            if tail & Tail::START != 0 {
                *loader.update.server() = source;
            }
            seed = BEGIN_FIRMWARE_UPDATE.seed;
        }
        if source != *loader.update.server() {
            return None;
        }
        let len = transfer::take(&mut loader.received, &frame.data, len, tail, seed)?.get();
        if update::is_active() {
            loader.update.take_answer(&loader.received, len);
            return None;
        }
        byte = error::UNKNOWN;
        if loader.update.take_request(&loader.received, len) {
            update::begin();
            byte = error::OK;
        }
    }
    loader.response[2] = byte;
    // Reads the identifier again: to keep it in registers takes more instructions.
    // SAFETY: the field is valid.
    [response.sidh, response.sidl, _, response.eid8] =
        unsafe { (&raw const loader.frame.id).read_volatile() };
    response.eid8 &= NODE_ID;
    response.eid0 = SERVICE | loader.information.node_id;
    Some(response)
}

#[panic_handler]
fn panic(_info: &PanicInfo) -> ! {
    loop {}
}
