//! What the bus sees of a node.

use super::wire::Level;
use sim_base::Cycles;
use std::cell::RefCell;
use std::rc::Rc;

/// A node on the wire: asked for a level at the start of each bit, told the result at its end.
pub trait Station {
    /// A bit begins at `at`: the level the station drives in it. What its owner asked for later than
    /// `at` must not show yet: owners may have run ahead of the bus, up to [`Bus::horizon`].
    ///
    /// [`Bus::horizon`]: super::Bus::horizon
    fn drive(&mut self, at: Cycles) -> Level;

    /// The bit that ends at `at` had this level.
    fn sample(&mut self, level: Level, at: Cycles);

    /// True if the station has nothing to send at `at` and nothing in progress, so that idle bits up to
    /// there may be skipped. Once false it stays false for later times until bits pass: the bus looks
    /// for the first bit at which it is false.
    fn quiet(&self, at: Cycles) -> bool;

    /// True while the station sends a frame of its own, from SOF to the last bit, a loss or an error.
    fn transmitting(&self) -> bool;

    /// Its own nominal bit time in picoseconds (1 Mbit/s: 1 000 000). None: not on the bus.
    fn bit_time_ps(&self) -> Option<u64>;

    /// That many recessive bits passed unsimulated. Called only after `quiet` allowed it.
    fn skip_idle(&mut self, bits: u64);
}

/// A station shared between the bus and its owner. Neither may hold a borrow across a call of the other.
pub type StationRef = Rc<RefCell<dyn Station>>;
