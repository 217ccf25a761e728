//! The parameters in the last page of the flash, and the unique ID of the chip.
//!
//! While the page is erased, for 20 to 40 ms, the program stands.

use own_node::{PARAMETERS, Storage};
use stm32f1xx_hal::flash::{FlashSize, FlashWriter, Parts, SectorSize};

/// The last page of 64 KiB, for which `memory.x` leaves room.
const PAGE: u32 = 63 * 1024;
const NUMBER_LEN: usize = size_of::<i32>();
/// The unique device ID of 96 bits (RM0008, 30.2).
const UNIQUE_ID: *const [u32; 3] = 0x1FFF_F7E8 as *const _;

pub struct Flash(pub Parts);

impl Flash {
    fn writer(&mut self) -> FlashWriter<'_> {
        self.0.writer(SectorSize::Sz1K, FlashSize::Sz64K)
    }
}

impl Storage for Flash {
    fn load(&mut self, at: usize) -> Option<i32> {
        let writer = self.writer();
        let bytes = writer.read(PAGE + (NUMBER_LEN * at) as u32, NUMBER_LEN).ok()?;
        Some(i32::from_le_bytes(bytes.try_into().ok()?))
    }

    fn store(&mut self, values: &[i32; PARAMETERS.len()]) -> bool {
        let mut writer = self.writer();
        let mut address = PAGE;
        let mut is_stored = writer.page_erase(PAGE).is_ok();
        for value in values {
            is_stored = is_stored && writer.write(address, &value.to_le_bytes()).is_ok();
            address += NUMBER_LEN as u32;
        }
        is_stored
    }
}

/// The unique ID of twelve bytes, and zeros.
pub fn unique_id() -> [u8; 16] {
    // SAFETY: each chip has these words, which never change.
    let words = unsafe { UNIQUE_ID.read_volatile() };
    let mut id = [0; 16];
    for (place, word) in id.chunks_exact_mut(4).zip(words) {
        place.copy_from_slice(&word.to_le_bytes());
    }
    id
}
