//! The pins: their levels, their watchers, and the levels that are driven from outside.
//!
//! An output has the level of the compare unit that drives it, else that of its PORT bit. An input
//! has the level that is driven from outside, else that of its pull-up, else its last one.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use super::core::Core;
use super::processor::PinWatcher;
use super::regs::{self, port_register};
use sim_base::Cycles;

const PORTS: [char; 3] = ['B', 'C', 'D'];
/// The levels that the timers' compare units drive on outputs, in place of PORTx.
#[derive(Default)]
pub(super) struct Overrides {
    driven: [Cell<u8>; 3],
    levels: [Cell<u8>; 3],
    /// Time of the edge that simavr is told of; watchers get it in place of the present time.
    edge_at: Cell<Option<Cycles>>,
}

impl Overrides {
    /// The level that a compare unit drives on a pin.
    pub fn level(&self, port: usize, bit: u8) -> Option<bool> {
        let mask = 1 << bit;
        (self.driven[port].get() & mask != 0).then(|| self.levels[port].get() & mask != 0)
    }

    /// The pins of a port that compare units drive.
    pub fn driven(&self, port: usize) -> u8 {
        self.driven[port].get()
    }

    /// Sets the level that a compare unit drives on a pin.
    pub fn set(&self, port: usize, bit: u8, level: Option<bool>) {
        set_bit(&self.driven[port], bit, level.is_some());
        set_bit(&self.levels[port], bit, level == Some(true));
    }

    /// Tells simavr of an edge at this time.
    pub fn with_edge_at(&self, at: Cycles, tell: impl FnOnce()) {
        self.edge_at.set(Some(at));
        tell();
        self.edge_at.set(None);
    }
}

fn set_bit(cell: &Cell<u8>, bit: u8, on: bool) {
    let mask = 1 << bit;
    cell.set(cell.get() & !mask | if on { mask } else { 0 });
}

struct Watch {
    port: usize,
    bit: u8,
    level: Cell<bool>,
    watcher: RefCell<Option<PinWatcher>>,
}

/// The pins that are driven from outside, and their levels: a bit for each pin of each port.
#[derive(Default)]
struct Drive {
    driven: [Cell<u8>; 3],
    levels: [Cell<u8>; 3],
    overrides: Rc<Overrides>,
}

/// The pins of a chip.
pub(super) struct Pins {
    drive: Drive,
    watches: RefCell<Vec<Watch>>,
}

/// Index of a port in simavr's order.
pub(super) fn port_index(port: char) -> usize {
    PORTS
        .iter()
        .position(|name| *name == port)
        .unwrap_or_else(|| panic!("the chip has no port {port}"))
}

impl Drive {
    /// True if a pin is high.
    fn level(&self, core: &Core, port: usize, bit: u8) -> bool {
        self.all_levels(core, port) & 1 << bit != 0
    }

    /// The levels of all pins of a port.
    fn all_levels(&self, core: &Core, port: usize) -> u8 {
        let latch_register = port_register(port);
        let get = |address| core.get(address);
        let (pin, ddr, latch) =
            (get(latch_register - 2), get(latch_register - 1), get(latch_register));
        let has_pull_ups = core.get(regs::MCUCR) & regs::PUD == 0;
        let undriven = if has_pull_ups { latch | pin } else { pin };
        let inputs = choose(self.driven[port].get(), self.levels[port].get(), undriven);
        let overrides = &self.overrides;
        let levels = choose(ddr, latch, inputs);
        choose(overrides.driven[port].get(), overrides.levels[port].get(), levels)
    }
}

/// The bits of `a` where `mask` is one, else those of `b`.
fn choose(mask: u8, a: u8, b: u8) -> u8 {
    a & mask | b & !mask
}

impl Pins {
    /// The pins of a chip whose timers drive these levels.
    pub fn new(overrides: Rc<Overrides>) -> Pins {
        let drive = Drive { overrides, ..Drive::default() };
        Pins { drive, watches: RefCell::default() }
    }

    /// The levels of a port's pins: the value of PINx.
    pub fn levels(&self, core: &Core, port: usize) -> u8 {
        self.drive.all_levels(core, port)
    }

    /// The pins of a port whose level nothing determines.
    pub fn floating(&self, core: &Core, port: usize) -> u8 {
        let latch_register = port_register(port);
        let has_pull_ups = core.get(regs::MCUCR) & regs::PUD == 0;
        let pulled_up = if has_pull_ups { core.get(latch_register) } else { 0 };
        let Drive { driven, overrides, .. } = &self.drive;
        let outputs = core.get(latch_register - 1) | overrides.driven[port].get();
        !(outputs | driven[port].get() | pulled_up)
    }

    /// True if a pin is high.
    pub fn level(&self, core: &Core, port: usize, bit: u8) -> bool {
        self.drive.level(core, port, bit)
    }

    /// Notes that a pin is driven from outside, or no longer. Returns which pins of the port are,
    /// and their levels.
    pub fn set_outside(&self, port: usize, bit: u8, level: Option<bool>) -> (u8, u8) {
        let Drive { driven, levels, .. } = &self.drive;
        set_bit(&driven[port], bit, level.is_some());
        set_bit(&levels[port], bit, level == Some(true));
        (driven[port].get(), levels[port].get())
    }

    /// The pins of a port that are driven from outside.
    pub fn driven_outside(&self, port: usize) -> u8 {
        self.drive.driven[port].get()
    }

    /// Calls `watcher` at each change of the pin from now on.
    pub fn watch(&self, core: &Core, port: usize, bit: u8, watcher: PinWatcher) {
        let level = Cell::new(self.level(core, port, bit));
        let watcher = RefCell::new(Some(watcher));
        self.watches.borrow_mut().push(Watch { port, bit, level, watcher });
    }

    /// Calls the watchers of pins of a port whose levels have changed, of those in `mask`.
    pub fn check_watches(&self, core: &Core, now: Cycles, port: usize, mask: u8) {
        for watch in self.watches.borrow().iter() {
            if watch.port == port && mask & 1 << watch.bit != 0 {
                watch.check(core, now, &self.drive);
            }
        }
    }
}

impl Watch {
    /// Calls the watcher if the level of the pin has changed.
    fn check(&self, core: &Core, now: Cycles, drive: &Drive) {
        let level = drive.level(core, self.port, self.bit);
        if self.level.replace(level) != level {
            let watcher = self.watcher.take();
            if let Some(mut watcher) = watcher {
                let at = drive.overrides.edge_at.get();
                watcher(level, at.unwrap_or(now));
                self.watcher.replace(Some(watcher));
            }
        }
    }
}
