//! Target `node`, the firmware's library: any frames at any time, with restarts, the button, the
//! sensor and the controller's notices in between. [`crate::rig`] has the checks, [`crate::steps`]
//! the format of the input.

use firmware::desk::Memory;

use crate::rig::Rig;
use crate::steps::steps;

/// Runs the steps of the input. Afterwards the node must answer a request and follow a command.
pub fn run(input: &[u8]) {
    let mut rig = Rig::new(Memory::blank());
    for step in steps(input) {
        rig.step(&step);
    }
    rig.still_works();
    assert!(
        rig.node_info().is_none_or(|info| info.unique_id != [0; 16]),
        "the unique ID must not be zero"
    );
}
