//! No bootloader of `boot/`: the program has no updates over the bus.

use firmware::handover::REQUEST_LEN;

/// False.
pub fn is_there() -> bool {
    false
}

/// False.
pub fn count_restart() -> bool {
    false
}

/// Does nothing.
pub fn forget_restarts() {}

/// Does nothing: there is nothing to enter.
pub fn enter(_request: Option<&[u8; REQUEST_LEN]>) {}
