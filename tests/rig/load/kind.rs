//! The loads: what the frames are, their priority and their pace.

use bench::Cycles;

use super::super::{board, has_all_features};

/// True if the node may lose some frames of a bus full of `kind` at 1 Mbit/s. It accepts both
/// dialects and assembles two transfers at a time, so a command of the thesis takes longer than its
/// frame lasts (docs/decisions.md).
pub fn may_lose_commands(kind: Kind) -> bool {
    has_all_features() && board().fastest_bit_rate() == 1_000_000 && kind == Kind::Thesis
}

/// The frames of a load. RXB0 and RXB1 are the buffers whose filters accept them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// ArrayCommand in one frame of so many bytes; 5 of them are a valid command. RXB0, and RXB1
    /// when RXB0 is full.
    Command(usize),
    /// ArrayCommand of one position, 5 bytes. The node needs a division for it.
    Position,
    /// ArrayCommands of 15 commands, nine frames each.
    LongCommand,
    /// esc.RawCommands for eight motors, three frames each. RXB1.
    RawCommand,
    /// First frames of ArrayCommands that never continue.
    Beginning,
    /// NodeStatus in a frame of so many bytes; 8 of them are a valid status. RXB1 only.
    Status(usize),
    /// The thesis's command, 2 bytes. RXB1.
    Thesis,
    /// ArmingStatus, 2 bytes. RXB1.
    Arming,
    /// GetNodeInfo request. RXB0.
    Request,
    /// GetSet request for a parameter by index, 3 bytes.
    ParameterRequest,
    /// GetSet request for a parameter by name, three frames.
    LongRequest,
    /// ExecuteOpcode request to save the parameters, 8 bytes.
    OpcodeRequest,
    /// RestartNode request with a wrong magic number, 6 bytes.
    RestartRequest,
    /// BeginFirmwareUpdate request, four frames.
    UpdateRequest,
    /// Frame of so many bytes of another message whose type has the low byte of ArrayCommand's.
    /// RXB0 and RXB1.
    LookAlike(usize),
    /// Request of so many bytes for a service that the node does not have. RXB0 and RXB1.
    UnknownRequest(usize),
    /// Anonymous request for a node ID whose identifier looks like a NodeStatus. RXB1.
    Anonymous,
    /// Command from a sender with the node's own ID.
    OwnId,
    /// Random kinds except positions. Transfers of several frames are sent whole.
    Mixed,
    /// Message of 8 bytes for other nodes.
    Foreign,
    /// Frame of so many bytes that the firmwares of `tests/third-party/` accept.
    ThirdParty(usize),
}

impl Kind {
    /// All kinds that the node's filters let through (`src/node/acceptance.rs`): those that the
    /// node uses, and those that it rejects after reading them. The latter are other messages
    /// whose type has the low byte of ArrayCommand's, requests for services that the node does not
    /// have, messages of the node's types from an anonymous sender or from its own ID, and
    /// frames of wrong lengths.
    ///
    /// [`Position`](Self::Position) has its own tests.
    pub const MATCHING: [Kind; 28] = [
        Kind::Command(0),
        Kind::Command(1),
        Kind::Command(2),
        Kind::Command(5),
        Kind::Command(7),
        Kind::Command(8),
        Kind::LongCommand,
        Kind::Beginning,
        Kind::Status(0),
        Kind::Status(1),
        Kind::Status(2),
        Kind::Status(7),
        Kind::Status(8),
        Kind::Thesis,
        Kind::Arming,
        Kind::Request,
        Kind::ParameterRequest,
        Kind::LongRequest,
        Kind::OpcodeRequest,
        Kind::RestartRequest,
        Kind::UpdateRequest,
        Kind::LookAlike(1),
        Kind::LookAlike(2),
        Kind::LookAlike(8),
        Kind::UnknownRequest(1),
        Kind::Anonymous,
        Kind::OwnId,
        Kind::Mixed,
    ];

    /// True if some of the frames move the servo.
    pub fn moves_servo(self) -> bool {
        matches!(
            self,
            Kind::Command(5) | Kind::Position | Kind::LongCommand | Kind::Thesis | Kind::Mixed
        )
    }
}

/// Frames that fill the bus.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    pub kind: Kind,
    /// Priority: 0 wins every arbitration against the node, 31 loses every one.
    pub priority: u8,
    pub pace: Pace,
}

/// The distance between frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Back to back.
    Full,
    /// Bursts of 1 to 40 frames between silences of up to 10 ms.
    Bursts,
    /// One frame in so many cycles.
    Every(Cycles),
}
