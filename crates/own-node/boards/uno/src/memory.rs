//! The parameters in the EEPROM. A byte takes 3.4 ms, in which the node goes on.

use core::cell::{Cell, RefCell};

use arduino_hal::Eeprom;
use avr_device::interrupt;
use own_node::{PARAMETERS, Storage};

/// The time that the write of a byte takes, and one more for the beginning of a millisecond.
const WRITE_MS: u8 = 5;

type Values = [[u8; 4]; PARAMETERS.len()];

pub struct Memory {
    eeprom: RefCell<Eeprom>,
    /// What is being written.
    values: Cell<Option<Values>>,
    /// The next byte, and when the one before was written.
    next: Cell<u8>,
    written_ms: Cell<u8>,
}

impl Memory {
    pub fn new(eeprom: Eeprom) -> Self {
        Self {
            eeprom: RefCell::new(eeprom),
            values: Cell::new(None),
            next: Cell::new(0),
            written_ms: Cell::new(0),
        }
    }

    /// Writes the next byte, if the one before is written: arduino-hal would wait for it.
    pub fn step(&self, now_ms: u32) {
        let Some(values) = self.values.get() else { return };
        let now_ms = now_ms as u8;
        if now_ms.wrapping_sub(self.written_ms.get()) < WRITE_MS {
            return;
        }
        self.written_ms.set(now_ms);
        let at = self.next.get();
        match values.as_flattened().get(usize::from(at)) {
            // The second write to EECR must follow within four cycles of the first.
            Some(&byte) => {
                interrupt::free(|_| self.eeprom.borrow_mut().write_byte(at.into(), byte))
            }
            None => self.values.set(None),
        }
        self.next.set(at + 1);
    }

    /// True if values are not written yet.
    pub fn is_busy(&self) -> bool {
        self.values.get().is_some()
    }
}

impl Storage for &Memory {
    fn load(&mut self, at: usize) -> Option<i32> {
        let mut bytes = [0; size_of::<i32>()];
        self.eeprom.borrow().read((size_of::<i32>() * at) as u16, &mut bytes).ok()?;
        Some(i32::from_le_bytes(bytes))
    }

    /// They are stored within 50 ms.
    fn store(&mut self, values: &[i32; PARAMETERS.len()]) -> bool {
        self.values.set(Some(values.map(i32::to_le_bytes)));
        self.next.set(0);
        true
    }
}
