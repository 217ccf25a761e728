//! The interface between a node and the bus.

use super::engine::Engine;
use super::wire::Level;
use sim_base::Cycles;
use std::cell::RefCell;
use std::rc::Rc;

/// A node on the wire. The bus calls it at the start of each bit for a level, and at the end with
/// the result.
pub trait Station {
    /// A bit begins at `at`. Returns the level that the station drives in it. Requests of its owner
    /// later than `at` must not take effect yet: owners may have run ahead of the bus, up to
    /// [`Bus::horizon`].
    ///
    /// [`Bus::horizon`]: super::Bus::horizon
    fn drive(&mut self, at: Cycles) -> Level;

    /// The bit that ended at `at` had this level.
    fn sample(&mut self, level: Level, at: Cycles);

    /// True if the station has nothing to send at `at` and no frame in progress, so that idle bits
    /// up to `at` may be skipped. Once false it must stay false for later times until bits
    /// pass: the bus searches the first bit in which it is false.
    fn quiet(&self, at: Cycles) -> bool;

    /// True while the station sends its own frame: from SOF to the last bit, a lost arbitration or
    /// an error.
    fn transmitting(&self) -> bool;

    /// Its nominal bit time in picoseconds (1 Mbit/s: 1 000 000). `None` if it is not on the bus.
    fn bit_time_ps(&self) -> Option<u64>;

    /// Notes that this number of recessive bits was skipped. Called only after `quiet` returned
    /// true.
    fn skip_idle(&mut self, bits: u64);

    /// The station's engine, if up to the end of the frame on the wire `drive` and `sample`
    /// would do nothing but call it. Then the bus may step many bits of the frame at once, without
    /// these calls. `None`: each bit is a call.
    fn follower(&mut self) -> Option<&mut Engine> {
        None
    }
}

/// A station shared between the bus and its owner. Neither may hold a borrow across a call of the
/// other.
pub type StationRef = Rc<RefCell<dyn Station>>;
