//! What the firmware's library needs of a board: the constants in flash, and an EEPROM.

use std::cell::Cell;

use node::node::store::Eeprom;
use node::progmem::{BEGIN, IMAGE, Progmem};

/// The constants, as the chip has them in flash.
#[derive(Clone, Copy)]
pub struct Flash;

impl Progmem for Flash {
    fn byte(self, at: u16) -> u8 {
        IMAGE[usize::from(at - BEGIN)]
    }
}

/// How often it is asked until a byte is written: at every tick of a millisecond, and a byte takes 3.4 ms (datasheet 2545,
/// section 8.4).
const BUSY_FOR: u8 = 4;

/// An EEPROM whose supply can fail.
pub struct Memory {
    /// What it holds.
    pub cells: [u8; 256],
    /// Writes until the supply fails, and what becomes of the byte that is being written then. What comes later is lost.
    pub fails_after: Option<(u16, u8)>,
    busy_for: Cell<u8>,
}

impl Memory {
    /// As it leaves the factory.
    pub fn blank() -> Memory {
        Memory { cells: [0xFF; 256], fails_after: None, busy_for: Cell::new(0) }
    }

    /// Waits for a byte that is being written, as the board does at a start.
    pub fn settle(&mut self) {
        self.busy_for.set(0);
    }
}

impl Eeprom for Memory {
    fn read(&self, at: u8) -> u8 {
        assert_eq!(self.busy_for.get(), 0, "read while a byte is being written");
        self.cells[usize::from(at)]
    }

    fn is_busy(&self) -> bool {
        self.busy_for.set(self.busy_for.get().saturating_sub(1));
        self.busy_for.get() != 0
    }

    fn begin_write(&mut self, at: u8, byte: u8) {
        assert_eq!(self.busy_for.get(), 0, "written while a byte is being written");
        self.busy_for.set(BUSY_FOR);
        let cell = &mut self.cells[usize::from(at)];
        match &mut self.fails_after {
            None => *cell = byte,
            Some((0, _)) => {}
            Some((left, garbage)) => {
                *left -= 1;
                *cell = if *left == 0 { *garbage } else { byte };
            }
        }
    }
}
