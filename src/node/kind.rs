//! The table of data types that the node receives. It defines their IDs, the seeds of their CRCs,
//! their reassembly, and the filters of the controller ([`acceptance`](super::acceptance)).

use dronecan_wire::Received;
use dronecan_wire::types::{self, Message};

/// Bit of a [`Kind`]'s number: the transfer is a request.
const REQUEST: u16 = 1 << 15;

/// Bit of a [`Kind`]'s number: the transfer can have several frames.
const LONG: u16 = 1 << 14;

/// Mask of a [`Kind`]'s number: the ID of the data type or service.
const ID: u16 = LONG - 1;

/// Bits of a [`Kind`]'s number: the transfer is a message of a vendor, with an ID from 16384 to
/// 24575. (A service ID has eight bits only.)
#[cfg(feature = "safety")]
const VENDOR: u16 = REQUEST | 1 << 13;

/// Mask of a vendor's [`Kind`]: the ID less [`LONG`], its first.
#[cfg(feature = "safety")]
const VENDOR_ID: u16 = (1 << 13) - 1;

/// A row is `name = space type, form;`, or for a request `name = space type, form of the request,
/// form of the response;`. The space `draft` is for messages that only the UAVCAN draft has,
/// `vendor` for the IDs of vendors. A transfer of the form `short` has one frame.
macro_rules! received {
    ($($(#[doc = $doc:literal])* $(#[cfg($if:meta)])? $kind:ident = $space:ident $type:path, $form:ident $(, $response:ident)?;)*) => {
        /// The kind of a received transfer. Its number is the ID of the data type or service, and the bits `REQUEST` and `LONG`.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u16)]
        pub enum Kind {
            /// A type that the node does not take.
            Unknown = 0,
            $($(#[doc = $doc])* $(#[cfg($if)])? $kind = received!(@$space $type) | received!(@$form),)*
        }

        impl Kind {
            /// All kinds except `Unknown`.
            pub const ALL: &[Self] = &[$($(#[cfg($if)])? Self::$kind,)*];

            #[inline(always)]
            const fn of(space_and_id: u16) -> Self {
                $($(#[cfg($if)])? if received!(@is_v0 $space) && space_and_id == received!(@$space $type) {
                    return Self::$kind;
                })*
                Self::Unknown
            }

            /// The initial CRC of a transfer of several frames, also of the response. 0 if no transfer has more than one frame.
            #[inline(never)]
            pub const fn seed(self) -> u16 {
                $($(#[cfg($if)])? if (received!(@is_long $form) $(|| received!(@is_long $response))?) && self as u16 == Self::$kind as u16 {
                    return $type.seed;
                })*
                0
            }
        }

        const _: () = {
            $($(#[cfg($if)])? assert!(Kind::$kind.id() == $type.id as u16, "its bits are taken");)*
        };
    };
    (@message $type:path) => { $type.id as u16 };
    (@draft $type:path) => { $type.id as u16 };
    (@request $type:path) => { REQUEST | $type.id as u16 };
    (@vendor $type:path) => { VENDOR | $type.id as u16 & VENDOR_ID };
    (@is_v0 draft) => { false };
    (@is_v0 $space:ident) => { true };
    (@is_long long) => { true };
    (@is_long short) => { false };
    (@short) => { 0 };
    (@long) => { LONG };
}

/// thesis.ServoCommand. Its transfers have one frame, and no CRC.
const SERVO_COMMAND: Message = Message { id: 1111, seed: 0 };

/// ArrayCommand of the draft of 2014.
#[cfg(feature = "draft")]
const DRAFT_COMMAND: Message = Message { id: 265, seed: 0xBFEF };

received! {
    /// uavcan.equipment.actuator.ArrayCommand
    ArrayCommand = message types::ARRAY_COMMAND, long;
    /// uavcan.equipment.esc.RawCommand
    #[cfg(feature = "outputs")]
    RawCommand = message types::ESC_RAW_COMMAND, long;
    /// uavcan.protocol.NodeStatus
    NodeStatus = message types::NODE_STATUS, short;
    /// thesis.ServoCommand
    ServoCommand = message SERVO_COMMAND, short;
    /// uavcan.equipment.safety.ArmingStatus
    #[cfg(feature = "standard")]
    ArmingStatus = message types::ARMING_STATUS, short;
    /// ardupilot.indication.SafetyState
    #[cfg(feature = "safety")]
    SafetyState = vendor types::SAFETY_STATE, short;
    /// uavcan.equipment.indication.LightsCommand
    #[cfg(feature = "lights")]
    LightsCommand = message types::LIGHTS_COMMAND, long;
    /// uavcan.tunnel.Targetted
    #[cfg(feature = "tunnel")]
    Targetted = message types::TUNNEL_TARGETTED, short;
    /// uavcan.protocol.dynamic_node_id.Allocation
    #[cfg(feature = "allocation")]
    Allocation = message types::ALLOCATION, long;
    /// uavcan.protocol.GetNodeInfo
    GetNodeInfo = request types::GET_NODE_INFO, short, long;
    /// uavcan.protocol.RestartNode
    RestartNode = request types::RESTART_NODE, short, short;
    /// uavcan.protocol.param.GetSet
    #[cfg(feature = "standard")]
    GetSet = request types::GET_SET, long, long;
    /// uavcan.protocol.param.ExecuteOpcode
    #[cfg(feature = "standard")]
    ExecuteOpcode = request types::EXECUTE_OPCODE, short, short;
    /// uavcan.protocol.file.BeginFirmwareUpdate
    #[cfg(feature = "standard")]
    BeginFirmwareUpdate = request types::BEGIN_FIRMWARE_UPDATE, long, long;
    /// uavcan.protocol.GetTransportStats
    #[cfg(feature = "stats")]
    GetTransportStats = request types::GET_TRANSPORT_STATS, short, long;
    /// ArrayCommand of the draft of 2014: entries of three bytes, without a command type.
    #[cfg(feature = "draft")]
    DraftCommand = draft DRAFT_COMMAND, long;
}

impl Kind {
    /// The kind of a message with this data type ID.
    #[inline(always)]
    pub const fn of_message(data_type: u16) -> Self {
        #[cfg(feature = "safety")]
        if data_type & !VENDOR_ID == LONG {
            return Self::of(VENDOR | data_type & VENDOR_ID);
        }
        match Self::of(data_type & !REQUEST) {
            _ if data_type >= LONG => Self::Unknown,
            kind => kind,
        }
    }

    /// The kind of a request with this service ID.
    #[inline(always)]
    pub const fn of_request(service: u8) -> Self {
        Self::of(REQUEST | service as u16)
    }

    /// The ID of the data type or service.
    #[inline(always)]
    pub const fn id(self) -> u16 {
        #[cfg(feature = "safety")]
        if self as u16 & VENDOR == VENDOR {
            return LONG | self as u16 & VENDOR_ID;
        }
        self as u16 & ID
    }

    /// True for a request to this node.
    #[inline(always)]
    pub const fn is_request(self) -> bool {
        #[cfg(feature = "safety")]
        return self as u16 & VENDOR == REQUEST;
        #[cfg(not(feature = "safety"))]
        return self as u16 & REQUEST != 0;
    }

    /// True if a transfer can have several frames.
    #[inline(always)]
    pub const fn is_long(self) -> bool {
        self as u16 & LONG != 0
    }

    /// Bytes of an entry for a list, of which the node keeps only the entries with its own ID; 0
    /// for other transfers.
    #[inline(always)]
    pub const fn entry_len(self) -> u8 {
        match self {
            Self::ArrayCommand => 4,
            #[cfg(feature = "lights")]
            Self::LightsCommand => 3,
            #[cfg(feature = "draft")]
            Self::DraftCommand => 3,
            _ => 0,
        }
    }

    /// True for a list, of which the node keeps only the entries with its own ID.
    #[inline(always)]
    pub const fn is_list(self) -> bool {
        self.entry_len() != 0
    }

    /// True for a command for an output.
    #[inline(always)]
    pub const fn is_command(self) -> bool {
        match self {
            Self::ArrayCommand | Self::ServoCommand => true,
            #[cfg(feature = "outputs")]
            Self::RawCommand => true,
            #[cfg(feature = "draft")]
            Self::DraftCommand => true,
            _ => false,
        }
    }
}

impl Received for Kind {
    const UNKNOWN: Self = Self::Unknown;

    /// ArrayCommand and RawCommand.
    const LANE_FOR_EACH_TYPE: bool = cfg!(feature = "outputs");

    #[inline(always)]
    fn of_message(data_type: u16) -> Self {
        Self::of_message(data_type)
    }

    #[inline(always)]
    fn of_request(service: u8) -> Self {
        Self::of_request(service)
    }

    /// A node without an ID receives the Allocation requests of other nodes.
    #[cfg(feature = "allocation")]
    #[inline(always)]
    fn of_anonymous(data_type: u8, node: u8) -> Self {
        if node == 0 && u16::from(data_type) == Self::Allocation.id() {
            Self::Allocation
        } else {
            Self::Unknown
        }
    }

    #[inline(always)]
    fn is_request(self) -> bool {
        self.is_request()
    }

    #[inline(always)]
    fn is_multi_frame(self) -> bool {
        self.is_long()
    }

    #[inline(always)]
    fn entry_len(self) -> u8 {
        self.entry_len()
    }

    #[inline(always)]
    fn has_own_lanes(self) -> bool {
        #[cfg(feature = "outputs")]
        return self.is_list() || self == Self::RawCommand;
        #[cfg(not(feature = "outputs"))]
        self.is_list()
    }

    /// DSDL: 1010.ArrayCommand.uavcan, 1081.LightsCommand.uavcan.
    #[inline(always)]
    fn most_entries(self) -> u8 {
        match self {
            #[cfg(feature = "lights")]
            Self::LightsCommand => 20,
            _ => 15,
        }
    }

    #[inline(always)]
    fn seed(self) -> u16 {
        self.seed()
    }
}

#[cfg(test)]
mod tests;
