//! The firmware's library: anything on the bus, at any time, with restarts, the button, the sensor and the controller's
//! notices in between. See [`crate::rig`] for what must hold meanwhile, and [`crate::steps`] for the input.

use node::desk::Memory;

use crate::rig::Rig;
use crate::steps::steps;

/// Runs the steps of the input. After them the node must answer a request, and follow a command.
pub fn run(input: &[u8]) {
    let mut rig = Rig::new(Memory::blank());
    for step in steps(input) {
        rig.step(&step);
    }
    rig.still_works();
    assert!(rig.who().is_none_or(|info| info.unique_id != [0; 16]), "a unique ID of zeros");
}
