//! The pins of the timers: OCnA and OCnB.
//!
//! A compare unit that is connected to a pin which is an output overrides the pin's PORT bit. The
//! pin's level then comes from `Overrides`, and simavr's own writes to the pin are blocked.

use std::collections::VecDeque;

use super::Timers;
use super::layout::LAYOUTS;
use crate::base::Base;
use crate::regs::{self, PORT_D, port_register};
use sim_base::Cycles;

/// Most edges that are kept; then the oldest are dropped. Enough for more than 5 h of servo pulses.
const EDGE_LIMIT: usize = 1 << 21;

/// A pin that a compare unit can drive.
#[derive(Debug)]
pub struct Output {
    /// Bit of DDRx.
    is_output: bool,
    /// Bit of PORTx.
    port_level: bool,
    level: bool,
    /// The edges that were not taken; `None`: they are not recorded.
    edges: Option<VecDeque<(Cycles, bool)>>,
}

impl Output {
    /// A pin after a reset.
    pub fn new(records_edges: bool) -> Output {
        let edges = records_edges.then(VecDeque::new);
        Output { is_output: false, port_level: false, level: false, edges }
    }

    /// Sets the pin's bits of DDRx and PORTx.
    pub fn set_port(&mut self, is_output: bool, port_level: bool) {
        self.is_output = is_output;
        self.port_level = port_level;
    }

    /// Records an edge if the level of the pin has changed. `output` is the level of a connected
    /// compare unit. A pin that is not an output counts as low.
    pub fn record(&mut self, output: Option<bool>, at: Cycles) {
        let level = self.is_output && output.unwrap_or(self.port_level);
        if std::mem::replace(&mut self.level, level) == level {
            return;
        }
        if let Some(edges) = &mut self.edges {
            if edges.len() == EDGE_LIMIT {
                edges.pop_front();
            }
            edges.push_back((at, level));
        }
    }

    /// Removes and returns the recorded edges.
    pub fn take_edges(&mut self) -> Vec<(Cycles, bool)> {
        self.edges.iter_mut().flat_map(|edges| edges.drain(..)).collect()
    }
}

impl Timers {
    /// True if an edge of this pin has an effect at once: a watcher, a pin change interrupt, or
    /// INT1.
    pub(super) fn is_observed(&self, base: &Base, port: usize, bit: u8) -> bool {
        let mask = 1 << bit;
        let changes = base.core.get(regs::PCMSK0 + port as u16);
        (self.watched[port].get() | changes) & mask != 0
            || (port, bit) == (PORT_D, 3) && base.core.get(regs::EICRA) & regs::ISC1 != 0
    }

    /// Gives a pin the level of its compare unit, or returns it to the port.
    pub(super) fn update_output(&self, base: &Base, n: usize, index: usize, at: Cycles) {
        let (port, bit) = LAYOUTS[n].pins[index];
        let mut unit = self.units[n].borrow_mut();
        let output = unit.counter.output(index);
        unit.outputs[index].record(output, at);
        let driven = output.filter(|_| unit.outputs[index].is_output);
        drop(unit);
        let before = self.overrides.level(port, bit);
        if driven == before {
            return;
        }
        self.overrides.set(port, bit, driven);
        match driven {
            Some(level) if before.is_none() || self.is_observed(base, port, bit) => {
                self.overrides.with_edge_at(at, || base.hold_pin(port, bit, level));
            }
            Some(_) => {}
            None => {
                base.release_pin(port, bit);
                let register = port_register(port);
                self.overrides.with_edge_at(at, || base.forward(register, base.core.get(register)));
            }
        }
    }

    /// Tells simavr the levels of the driven pins that nobody has observed so far.
    pub(super) fn synchronise_pins(&self, base: &Base) {
        for (n, layout) in LAYOUTS.iter().enumerate() {
            self.advance(base, n, base.now());
            for (port, bit) in layout.pins {
                if let Some(level) = self.overrides.level(port, bit) {
                    base.hold_pin(port, bit, level);
                }
            }
        }
    }

    /// Writes PINx, DDRx or PORTx.
    pub(super) fn write_port(&self, base: &Base, port: usize, address: u16, value: u8, at: Cycles) {
        let port_register = port_register(port);
        let [ddr_register, pin_register] = [port_register - 1, port_register - 2];
        let (ddr_before, port_before) = (base.core.get(ddr_register), base.core.get(port_register));
        let (ddr, latch) = match address {
            _ if address == pin_register => (ddr_before, port_before ^ base.with_single_bit(value)),
            _ if address == ddr_register => (value, port_before),
            _ => (ddr_before, value),
        };
        let changed = (ddr ^ ddr_before) | (latch ^ port_before);
        // A pin that becomes an output has the compare unit's level from the start, so it gets it
        // before simavr handles the write; a pin that becomes an input gets simavr's after it.
        let update = |becomes_input: bool| {
            for (n, layout) in LAYOUTS.iter().enumerate() {
                for (index, (owner, bit)) in layout.pins.into_iter().enumerate() {
                    let mask = 1 << bit;
                    let falls = ddr_before & !ddr & mask != 0;
                    if owner != port || changed & mask == 0 || falls != becomes_input {
                        continue;
                    }
                    self.advance(base, n, at);
                    self.units[n].borrow_mut().outputs[index]
                        .set_port(ddr & mask != 0, latch & mask != 0);
                    self.update_output(base, n, index, at);
                    self.schedule(base, n);
                }
            }
        };
        if changed & layout_mask(port) == 0 {
            forward(base, address, pin_register, value);
            return;
        }
        update(false);
        forward(base, address, pin_register, value);
        update(true);
    }
}

/// Bits of a port that timers can drive.
fn layout_mask(port: usize) -> u8 {
    let pins = LAYOUTS.iter().flat_map(|layout| layout.pins);
    pins.filter(|pin| pin.0 == port).fold(0, |mask, pin| mask | 1 << pin.1)
}

/// Hands a write of a port's register to simavr. A write of PINx toggles the bits of PORTx.
fn forward(base: &Base, address: u16, pin_register: u16, value: u8) {
    let value = if address == pin_register { base.with_single_bit(value) } else { value };
    base.forward(address, value);
}
