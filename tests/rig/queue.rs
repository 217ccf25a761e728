//! How full the firmware's queue of received frames becomes, read from its RAM.

use bench::avr::Avr;

/// A place has a frame: an identifier of four bytes, a length, and eight bytes of data.
const FRAME: u32 = 13;

/// The queue of `src/board/bus.rs`: its counters of frames written and read, modulo 256.
#[derive(Clone, Copy, Debug)]
pub struct Queue {
    written: u16,
    read: u16,
    /// Number of places.
    pub places: u8,
}

impl Queue {
    /// The queue of the program that the ELF's symbols describe.
    ///
    /// # Panics
    /// If the ELF has no such symbols.
    #[track_caller]
    pub fn of(avr: &Avr) -> Queue {
        let find = |name: &str| {
            avr.symbol_with(name).unwrap_or_else(|| panic!("no symbol {name} in the ELF"))
        };
        let (queue, written, read) = (find("bus5QUEUE"), find("bus7WRITTEN"), find("bus4READ"));
        // The number is a power of two.
        let places = (queue.size / FRAME).max(1).ilog2();
        Queue { written: written.address as u16, read: read.address as u16, places: 1 << places }
    }

    /// Number of frames in the queue now, with the one that the main loop is reading.
    pub fn depth(&self, avr: &Avr) -> u8 {
        avr.sram(self.written).wrapping_sub(avr.sram(self.read))
    }
}
