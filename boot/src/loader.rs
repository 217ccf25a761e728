//! The main loop, and the answers to requests.

use core::panic::PanicInfo;

use dronecan_wire::types::{
    BEGIN_FIRMWARE_UPDATE, FILE_READ, GET_NODE_INFO, NODE_STATUS, RESTART_NODE,
};
use dronecan_wire::{Id, Tail};
use firmware::handover::CRC_START;

use crate::can::{self, EXIDE, NODE_ID_BITS, SERVICE};
use crate::clock::Timeout;
use crate::layout::Information;
use crate::listen::Next;
use crate::node_info::{self, MAINTENANCE, MODE};
use crate::transfer::{self, Outgoing};
use crate::variables::*;
use crate::{clock, crc, listen, start, update};

/// The response of RestartNode, if it restarts.
const WILL_RESTART: u8 = 1 << 7;

/// uavcan.protocol.file.BeginFirmwareUpdate, the errors of the response.
mod error {
    pub const OK: u8 = 0;
    pub const IN_PROGRESS: u8 = 2;
    pub const UNKNOWN: u8 = 255;
}

/// SIDH and SIDL of the identifier with these first two bytes.
const fn sid(id: Id) -> [u8; 2] {
    let [first, second, ..] = id.to_bytes();
    [first << 3 | second >> 5, second << 3 & 0xE0 | EXIDE | second & 3]
}

/// The service in SIDH and SIDL: its lowest and its highest three bits as in SIDL, between which
/// SIDL has room, beside EXIDE, for those of SIDH.
const fn service(sidh: u8, sidl: u8) -> u8 {
    sidl ^ (sidh & 7) << 2
}

/// What [`service`] is for this service.
const fn with_id(id: u8) -> u8 {
    let [sidh, sidl] = sid(Id::request(0, id, 0, 0));
    service(sidh, sidl)
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
    clear();
    MODE.write(MAINTENANCE);
    if start::decide() {
        update::begin();
    }
    can::set_up_spi();
    clock::start();
    listen::begin();
    loop {
        node_info::set_up();
        stay_on_bus();
    }
}

/// Does all that there is to do, until the bit rate of the record is to be used.
#[inline(always)]
fn stay_on_bus() {
    loop {
        can::configure();
        loop {
            if listen::is_unsure() {
                match listen::turn() {
                    Next::Send => {}
                    Next::Listen => continue,
                    Next::Configure => break,
                    Next::UseRecord => return,
                }
            }
            // Before the second, which counts as one of silence.
            let outgoing = if update::is_read_due() {
                Some(read_file())
            } else if clock::take_second() {
                if !can::is_on_bus() {
                    break;
                }
                update::tick();
                Some(status())
            } else if can::receive() {
                if listen::is_unsure() {
                    listen::trust();
                }
                take_frame()
            } else {
                None
            };
            if let Some(outgoing) = outgoing {
                // SAFETY: the buffer is a variable, with room for the transfer.
                unsafe { transfer::send(outgoing) };
            }
        }
    }
}

/// The NodeStatus of this second.
#[inline(always)]
fn status() -> Outgoing {
    Outgoing {
        sidh: SID_OF_STATUS[0],
        sidl: SID_OF_STATUS[1],
        eid8: NODE_STATUS.id as u8,
        eid0: NODE_ID.read(),
        // There is one in each second.
        transfer_id: node_info::tick() & Tail::TRANSFER_ID,
        buffer: information().cast(),
        len: Information::STATUS_LEN,
        seed: 0,
    }
}

/// The request for the next part of the file.
#[inline(always)]
fn read_file() -> Outgoing {
    Outgoing {
        sidh: SID_OF_READ[0],
        sidl: SID_OF_READ[1],
        eid8: can::REQUEST | SERVER.read(),
        eid0: SERVICE | NODE_ID.read(),
        transfer_id: update::begin_request(),
        buffer: read_request(),
        len: update::request_len(),
        seed: FILE_READ.seed,
    }
}

/// Takes the frame. Returns the response if it completes a request.
#[inline(always)]
fn take_frame() -> Option<Outgoing> {
    let len = FRAME_LEN.read().wrapping_sub(1);
    // A longer one is a remote frame.
    if len >= 8 {
        return None;
    }
    // SAFETY: the index is less than 8.
    let tail = unsafe { *can::data().add(len.into()) };
    let service = service(FRAME_SIDH.read(), FRAME_SIDL.read());
    let is_request = FRAME_EID8.read() & can::REQUEST != 0;
    let mut response = Outgoing {
        sidh: 0,
        sidl: 0,
        eid8: 0,
        eid0: 0,
        transfer_id: tail & Tail::TRANSFER_ID,
        buffer: response(),
        len: 1,
        // Only the response of GetNodeInfo has more than one frame.
        seed: GET_NODE_INFO.seed,
    };
    let mut byte = 0;
    if is_request && service == const { with_id(GET_NODE_INFO.id) } {
        response.buffer = information().cast();
        response.len = Information::LEN;
    } else if is_request && service == const { with_id(RESTART_NODE.id) } {
        // SAFETY: the data is longer than the number.
        if unsafe { crc::of(CRC_START, can::data(), 5) } == CRC_OF_MAGIC {
            // On a full bus the response has to wait.
            clock::set_watchdog(Timeout::Second);
            byte = WILL_RESTART;
        }
    } else if is_request
        && update::is_active()
        && service == const { with_id(BEGIN_FIRMWARE_UPDATE.id) }
    {
        if tail & Tail::END == 0 {
            return None;
        }
        byte = error::IN_PROGRESS;
    } else {
        let source = FRAME_EID0.read() & NODE_ID_BITS;
        let seed = if update::is_active() {
            if is_request || service != const { with_id(FILE_READ.id) } || !update::is_answer(tail)
            {
                return None;
            }
            FILE_READ.seed
        } else {
            if !is_request || service != const { with_id(BEGIN_FIRMWARE_UPDATE.id) } {
                return None;
            }
            if tail & Tail::START != 0 {
                SERVER.write(source);
            }
            BEGIN_FIRMWARE_UPDATE.seed
        };
        if source != SERVER.read() {
            return None;
        }
        let len = transfer::take(len, tail, seed)?;
        if update::is_active() {
            update::take_answer(len);
            return None;
        }
        byte = error::UNKNOWN;
        if update::take_request(len) {
            update::begin();
            byte = error::OK;
        }
    }
    RESPONSE.write(byte);
    response.sidh = FRAME_SIDH.read();
    response.sidl = FRAME_SIDL.read();
    response.eid8 = FRAME_EID0.read() & NODE_ID_BITS;
    response.eid0 = SERVICE | NODE_ID.read();
    Some(response)
}

#[panic_handler]
fn panic(_info: &PanicInfo) -> ! {
    loop {}
}
