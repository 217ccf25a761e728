//! The records in EEPROM: the unique ID of the node, and the bus. A board that has no unique ID yet
//! gets one, which the program keeps: both tell the same one at all times.
//!
//! Its random bits are from the jitter of the watchdog's oscillator against the crystal, as those
//! of the program (src/board/jitter.rs in the root). The loop that counts takes 6 cycles. Each byte
//! has four samples of 16 ms, of which one random bit each is enough. The record is as
//! src/node/store.rs has it: the ID, its CRC, and a marker of 0. After a cut it is not valid, and
//! the next start makes it again.

use core::arch::{asm, global_asm};

use firmware::handover::{
    BUS, BUS_LEN, UNIQUE_ID, UNIQUE_ID_CRC_START, UNIQUE_ID_LEN, UNIQUE_ID_RECORD_LEN,
};

use crate::registers::{WDIE, WDIF};

// `read_records` copies the EEPROM from the unique ID to the end of the record of the bus to X. It
// changes X, r18 to r22, r24, r25 and the T flag, which is set while it makes a unique ID.
//
// EECR is 0x1F, EEDR 0x20, EEARL 0x21, EEARH 0x22, WDTCSR 0x60. r19 is the address in EEPROM, r22
// the byte, and r25:r24 the CRC so far. A write that the program had begun goes on in a reset, and
// ends within 4 ms, as one of these does before the next sample.
global_asm!(
    "read_records:",
    "    clt",
    "    movw r30, r26",
    ".Lagain:",
    "    movw r26, r30",
    "    ldi r19, {id}",
    "    ldi r24, lo8({seed})",
    "    ldi r25, hi8({seed})",
    ".Lnext_byte:",
    "    brtc .Lread_byte",
    "    ldi r20, 4",
    ".Lsample:",
    "    lsl r22",
    "    lsl r22",
    // Interrupt mode without interrupts: the timeout sets WDIF, and 1 clears it.
    "    ldi r21, {wdif_wdie}",
    "    sts 0x60, r21",
    ".Lcount:",
    "    inc r22",
    "    lds r21, 0x60",
    "    sbrs r21, 7",
    "    rjmp .Lcount",
    "    dec r20",
    "    brne .Lsample",
    "    cpi r19, {id} + {id_len}",
    "    brcs .Lwrite_byte",
    // Adding the high byte of the CRC to it moves the low one there, and then 0, the marker.
    "    mov r22, r25",
    ".Lwrite_byte:",
    "    out 0x21, r19",
    "    out 0x20, r22",
    // EEPE must follow EEMPE within four cycles (datasheet 8.6.3).
    "    sbi 0x1F, 2",
    "    sbi 0x1F, 1",
    "    rjmp .Lstore_byte",
    ".Lread_byte:",
    "    sbic 0x1F, 1",
    "    rjmp .Lread_byte",
    "    out 0x22, r1",
    "    out 0x21, r19",
    "    sbi 0x1F, 0",
    "    in r22, 0x20",
    ".Lstore_byte:",
    "    st X+, r22",
    "    rcall crc_add",
    "    inc r19",
    "    cpi r19, {id} + {record_len}",
    "    brne .Lafter_id",
    "    set",
    "    sbiw r24, 0",
    "    brne .Lagain",
    "    clt",
    ".Lafter_id:",
    "    cpi r19, {end}",
    "    brne .Lnext_byte",
    "    ret",
    id = const UNIQUE_ID,
    id_len = const UNIQUE_ID_LEN,
    record_len = const UNIQUE_ID_RECORD_LEN,
    seed = const UNIQUE_ID_CRC_START,
    end = const BUS + BUS_LEN,
    wdif_wdie = const WDIF | WDIE,
);

/// Copies the EEPROM, from [`UNIQUE_ID`] to the end of the record of the bus. Makes the unique ID
/// if there is none, in 1.2 seconds.
///
/// # Safety
///
/// `to` must have room for it.
#[inline(always)]
pub unsafe fn read_records(to: *mut u8) {
    // SAFETY: the caller guarantees the room. The block changes only the registers that
    // `read_records` names.
    unsafe {
        asm!("rcall read_records", inout("X") to => _, out("Z") _, out("r18") _, out("r19") _,
            out("r20") _, out("r21") _, out("r22") _, out("r24") _, out("r25") _);
    }
}
