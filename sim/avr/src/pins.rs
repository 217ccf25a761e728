//! The pins: levels, who watches them, and what drives them from outside.
//!
//! A pin that is an output has the level of its PORT bit; an input has the level it is driven to
//! from outside, else that of its pull-up, else the last one. The outputs of Timer1 are not seen
//! here but in `timer1`.

use std::cell::{Cell, RefCell};
use std::ffi::c_void;
use std::rc::Rc;

use simavr_ffi as ffi;

use super::machine::Machine;
use super::regs;
use sim_base::Cycles;

/// Is told each new level of a pin.
pub type PinWatcher = Box<dyn FnMut(bool, Cycles)>;

const PORTS: [char; 3] = ['B', 'C', 'D'];

struct Watch {
    machine: *const Machine,
    port: usize,
    bit: u8,
    level: Cell<bool>,
    watcher: RefCell<Option<PinWatcher>>,
}

/// See the module.
#[derive(Default)]
pub(super) struct Pins {
    driven: [Cell<u8>; 3],
    levels: [Cell<u8>; 3],
    watches: RefCell<Vec<Rc<Watch>>>,
}

/// Index of a port in simavr's order.
pub(super) fn port_index(port: char) -> usize {
    PORTS.iter().position(|name| *name == port).unwrap_or_else(|| panic!("the chip has no port {port}"))
}

impl Pins {
    /// The level of a pin.
    pub fn level(&self, machine: &Machine, port: usize, bit: u8) -> bool {
        let pin_register = regs::pin_register(PORTS[port]);
        let mask = 1 << bit;
        let [pin, ddr, latch] = [0, 1, 2].map(|offset| machine.core.get(pin_register + offset) & mask != 0);
        if ddr {
            latch
        } else if self.driven[port].get() & mask != 0 {
            self.levels[port].get() & mask != 0
        } else {
            latch && machine.core.get(regs::MCUCR) & regs::PUD == 0 || pin
        }
    }

    /// Drives a pin from outside, or lets it go.
    pub fn drive(&self, machine: &Machine, port: usize, bit: u8, level: Option<bool>) {
        let mask = 1u8 << bit;
        let set = |cell: &Cell<u8>, on: bool| cell.set(cell.get() & !mask | if on { mask } else { 0 });
        set(&self.driven[port], level.is_some());
        set(&self.levels[port], level == Some(true));
        machine.core.set_external(port, self.driven[port].get(), self.levels[port].get());
        self.apply(machine, port, bit);
    }

    /// Calls `watcher` at each change of the pin from now on.
    pub fn watch(&self, machine: &Machine, port: usize, bit: u8, watcher: PinWatcher) {
        let level = Cell::new(self.level(machine, port, bit));
        let watch = Rc::new(Watch { machine, port, bit, level, watcher: RefCell::new(Some(watcher)) });
        machine.core.hook_pin(port, bit, Some(on_pin), Rc::as_ptr(&watch).cast_mut().cast());
        self.watches.borrow_mut().push(watch);
    }

    /// After a reset all pins are inputs, and simavr has forgotten what drives them.
    pub fn reapply(&self, machine: &Machine) {
        for port in 0..PORTS.len() {
            for bit in (0..8).filter(|bit| self.driven[port].get() & 1 << bit != 0) {
                self.apply(machine, port, bit);
            }
        }
        let watches = self.watches.borrow().clone();
        for watch in watches {
            watch.look(machine);
        }
    }

    /// Gives an input its level. For an output simavr would mistake this for its own, so it waits
    /// until the pin is an input.
    fn apply(&self, machine: &Machine, port: usize, bit: u8) {
        if machine.core.get(regs::pin_register(PORTS[port]) + 1) & 1 << bit == 0 {
            machine.core.drive_pin(port, bit, self.level(machine, port, bit));
        }
    }
}

impl Watch {
    fn look(&self, machine: &Machine) {
        let level = machine.pins.level(machine, self.port, self.bit);
        if self.level.replace(level) != level {
            let watcher = self.watcher.take();
            if let Some(mut watcher) = watcher {
                watcher(level, machine.now());
                self.watcher.replace(Some(watcher));
            }
        }
    }
}

unsafe extern "C" fn on_pin(_: *mut ffi::avr_irq_t, _: u32, parameter: *mut c_void) {
    // Safety: the parameter is a `Watch` that `Pins` keeps until the machine is dropped, and
    // callbacks come from the machine's core only, so the machine that the watch points to is alive
    // too.
    let (watch, machine) = unsafe {
        let watch = &*parameter.cast::<Watch>();
        (watch, &*watch.machine)
    };
    machine.guard((), || watch.look(machine));
}
