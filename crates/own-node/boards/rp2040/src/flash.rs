//! The parameters in the last sector of the flash, and the unique ID of the flash: the RP2040 has
//! none of its own.
//!
//! While a sector is erased, for about 50 ms, the program stands.

use own_node::{PARAMETERS, Storage};
use rp2040_flash::flash;

/// Where the flash is in the memory.
const XIP_BASE: usize = 0x1000_0000;
/// The last sector of 8 MiB, for which `memory.x` leaves room.
const SECTOR: u32 = 8192 * 1024 - SECTOR_LEN;
const SECTOR_LEN: u32 = 4096;
/// What is written at once.
const PAGE_LEN: usize = 256;

pub struct Flash;

impl Storage for Flash {
    fn load(&mut self, at: usize) -> Option<i32> {
        if at >= PARAMETERS.len() {
            return None;
        }
        let number = (XIP_BASE + SECTOR as usize + size_of::<i32>() * at) as *const i32;
        // SAFETY: the address is in the sector, and every four bytes are a number.
        Some(unsafe { number.read_volatile() })
    }

    fn store(&mut self, values: &[i32; PARAMETERS.len()]) -> bool {
        let mut page = [0xFF; PAGE_LEN];
        for (place, value) in page.chunks_exact_mut(size_of::<i32>()).zip(values) {
            place.copy_from_slice(&value.to_le_bytes());
        }
        cortex_m::interrupt::free(|_| {
            // SAFETY: nothing else reads the flash meanwhile, because interrupts are disabled, and
            // neither the second core nor the DMA is in use. The sector is aligned and no part of
            // the program.
            unsafe {
                flash::flash_range_erase(SECTOR, SECTOR_LEN, true);
                flash::flash_range_program(SECTOR, &page, true);
            }
        });
        values.iter().enumerate().all(|(at, &value)| self.load(at) == Some(value))
    }
}

/// The unique ID of eight bytes, and zeros.
pub fn unique_id() -> [u8; 16] {
    let mut id = [0; 16];
    cortex_m::interrupt::free(|_| {
        // SAFETY: as above, nothing else reads the flash meanwhile.
        unsafe { flash::flash_unique_id(&mut id[..8], true) }
    });
    id
}
