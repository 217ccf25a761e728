//! The data types that DroneCAN does not have: those of the thesis.

use dronecan_wire::types::{self, Message};

/// thesis.ServoCommand. Its transfers have one frame, and no CRC.
pub const SERVO_COMMAND: Message = Message { id: 1111, seed: 0 };

/// NodeStatus of the draft.
pub const DRAFT_NODE_STATUS: Message = Message { id: 550, seed: 0 };

/// The thesis's measurement in the draft. Its transfers have one frame, and no CRC.
pub const DRAFT_MEASUREMENT: Message = Message { id: 761, seed: 0 };

/// The NodeStatus that the node sends.
pub const NODE_STATUS: Message =
    if cfg!(feature = "draft") { DRAFT_NODE_STATUS } else { types::NODE_STATUS };
