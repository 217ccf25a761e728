//! The table of data types that the node receives. A row has all that depends on the type: its ID
//! and the seed of its CRC, how its frames are reassembled, which filter of the controller lets it
//! pass ([`acceptance`](crate::node::acceptance)), and the name of the method that acts on it,
//! which `node::dispatch` calls.

use dronecan_wire::Received;
use dronecan_wire::types;

use crate::hardware::OUTPUTS;
use crate::progmem::Progmem;
use crate::tables::types::SERVO_COMMAND;

/// The tag of a GetSet's value that is a text.
const TEXT: u8 = 4;

/// Bit of a [`Kind`]'s number: the transfer is a request.
const REQUEST: u8 = 1 << 7;

/// Bit of a [`Kind`]'s number: the transfer can have several frames.
const LONG: u8 = 1 << 6;

/// Bit of a [`Kind`]'s number: the transfer is a list, or a command that has the lanes of lists.
const COMMAND: u8 = 1 << 5;

/// Where the controller's filters let a message pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// Into RXB0, from which a frame rolls over to RXB1: messages that come in bursts.
    Rxb0,
    /// Into RXB1.
    Rxb1,
    /// Into RXB1 of a node with motors.
    WithMotors,
    /// Into both of a node without an ID.
    WithoutId,
    /// A request: see [`acceptance`](crate::node::acceptance).
    Request,
}

/// What the rows of [`for_received`] are.
macro_rules! received {
    ($(if $if:meta {
        $($(#[doc = $doc:literal])*
        $kind:ident = $space:ident $type:path, $form:ident $(($entry_len:literal, $most:literal))?,
            $behind:ident => $action:ident $(. $method:ident)? $(, $response:ident)?;)*
    })*) => {
        /// The numbers of the rows.
        #[repr(u8)]
        enum Row {
            _Unknown,
            $($(#[cfg($if)] $kind,)*)*
        }

        /// The kind of a received transfer. Its number is that of the row, and the bits `REQUEST`,
        /// `LONG` and `COMMAND`. Those of a part that the build leaves out are `Unknown`.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Kind {
            /// A type that the node does not take.
            Unknown = 0,
            $($(
                $(#[doc = $doc])*
                #[cfg($if)]
                $kind = Row::$kind as u8 | received!(@space $space) | received!(@form $form),
            )*)*
        }

        #[allow(non_upper_case_globals, reason = "they stand for variants")]
        impl Kind {
            $($(
                $(#[doc = $doc])*
                #[cfg(not($if))]
                pub const $kind: Self = Self::Unknown;
            )*)*
        }

        impl Kind {
            /// All kinds except `Unknown`.
            pub const ALL: &[Self] = &[$($(#[cfg($if)] Self::$kind,)*)*];

            /// True if a type of message besides lists has the lanes of lists.
            const HAS_COMMAND: bool =
                is_any(&[$($(#[cfg($if)] received!(@is_command $form),)*)*]);

            /// The kind of a message with this data type ID.
            #[inline(always)]
            pub const fn of_message(data_type: u16) -> Self {
                $($(#[cfg($if)] if !received!(@is_request $space) && data_type == $type.id as u16 {
                    return Self::$kind;
                })*)*
                Self::Unknown
            }

            /// The kind of a request with this service ID.
            #[inline(always)]
            pub const fn of_request(service: u8) -> Self {
                $($(#[cfg($if)] if received!(@is_request $space) && service == $type.id as u8 {
                    return Self::$kind;
                })*)*
                Self::Unknown
            }

            /// The ID of the data type or service, for constants. A program reads
            /// [`data_type`](Self::data_type).
            pub const fn id(self) -> u16 {
                $($(#[cfg($if)] if self as u8 == Self::$kind as u8 {
                    return $type.id as u16;
                })*)*
                0
            }

            /// The initial CRC of a transfer of several frames, also of the response. 0 if no
            /// transfer has more than one frame.
            #[inline(never)]
            pub const fn seed(self) -> u16 {
                $($(#[cfg($if)] if received!(@has_seed $form $behind)
                    && self as u8 == Self::$kind as u8
                {
                    return $type.seed;
                })*)*
                0
            }

            /// Bytes of an entry of a list; 0 for other transfers.
            #[inline(always)]
            pub const fn entry_len(self) -> u8 {
                if self as u8 & COMMAND == 0 {
                    return 0;
                }
                $($($(#[cfg($if)] if self as u8 == Self::$kind as u8 {
                    return $entry_len;
                })?)*)*
                0
            }

            /// The largest number of entries of a list.
            #[inline(always)]
            const fn most(self) -> u8 {
                $($($(#[cfg($if)] if self as u8 == Self::$kind as u8 {
                    return $most;
                })?)*)*
                0
            }

            /// Where the controller's filters let it pass.
            pub const fn filter(self) -> Filter {
                match self {
                    Self::Unknown => Filter::Request,
                    $($(#[cfg($if)] Self::$kind => received!(@filter $space $behind),)*)*
                }
            }
        }

        const _: () = assert!(Kind::ALL.len() < COMMAND as usize, "its bits are taken");
    };
    (@space message) => { 0 };
    (@space request) => { REQUEST };
    (@is_request request) => { true };
    (@is_request $space:ident) => { false };
    (@is_command command) => { true };
    (@is_command $form:ident) => { false };
    (@form short) => { 0 };
    (@form long) => { LONG };
    (@form $form:ident) => { LONG | COMMAND };
    (@has_seed short short) => { false };
    (@has_seed short long) => { true };
    (@has_seed short $filter:ident) => { false };
    (@has_seed $form:ident $behind:ident) => { true };
    (@filter request $form:ident) => { Filter::Request };
    (@filter $space:ident $filter:ident) => { Filter::$filter };
}

/// The [table in flash](crate::progmem) of the IDs of the data types and services.
pub struct DataTypes;

/// The IDs, in the order of the rows, low byte first.
pub const PACKED: [u8; 2 * Kind::ALL.len()] = {
    let mut packed = [0; _];
    let mut row = 0;
    while row < Kind::ALL.len() {
        [packed[2 * row], packed[2 * row + 1]] = Kind::ALL[row].id().to_le_bytes();
        row += 1;
    }
    packed
};

/// True if one of the values is true.
const fn is_any(values: &[bool]) -> bool {
    let mut n = 0;
    while n < values.len() {
        if values[n] {
            return true;
        }
        n += 1;
    }
    false
}

/// Gives the rows to the macro with this name. This module makes the kinds of them, and
/// `node::dispatch` the calls of their methods.
///
/// The rows are in groups, `if condition { rows }`. A row of a message is
///
/// `name = message type, form, filter => method;`
///
/// or `group.method` for a method of a group of fields of the node, and a row of a request
///
/// `name = request type, form of the request, form of the response => method, method;`
///
/// where the second method begins the response. A transfer of the form `short` has one frame, of
/// the form `long` one or several. A `list(bytes, most)` is a message of entries of so many bytes,
/// at most `most` of them, of which the receiver keeps those for this node; a `command` is no list
/// and has the lanes of lists.
macro_rules! for_received {
    ($make:ident) => { $make! {
        if not(feature = "draft") {
            /// uavcan.equipment.actuator.ArrayCommand
            ArrayCommand = message types::ARRAY_COMMAND, list(4, 15), Rxb0
                => control.act_on_array_command;
        }
        if feature = "outputs" {
            /// uavcan.equipment.esc.RawCommand
            RawCommand = message types::ESC_RAW_COMMAND, command, WithMotors
                => control.act_on_raw_command;
        }
        if all() {
            /// uavcan.protocol.NodeStatus
            NodeStatus = message types::NODE_STATUS, short, Rxb1 => control.act_on_status;
            /// thesis.ServoCommand
            ServoCommand = message SERVO_COMMAND, short, Rxb1 => control.act_on_servo_command;
        }
        if feature = "standard" {
            /// uavcan.equipment.safety.ArmingStatus
            ArmingStatus = message types::ARMING_STATUS, short, Rxb1
                => control.act_on_arming_status;
        }
        if feature = "safety" {
            /// ardupilot.indication.SafetyState
            SafetyState = message types::SAFETY_STATE, short, Rxb1 => control.act_on_safety_state;
        }
        if feature = "relay" {
            /// uavcan.equipment.hardpoint.Command
            HardpointCommand = message types::HARDPOINT_COMMAND, short, Rxb1
                => control.act_on_hardpoint_command;
        }
        if feature = "lights" {
            /// uavcan.equipment.indication.LightsCommand
            LightsCommand = message types::LIGHTS_COMMAND, list(3, 20), Rxb1
                => control.act_on_lights_command;
        }
        if feature = "tunnel" {
            /// uavcan.tunnel.Targetted
            Targetted = message types::TUNNEL_TARGETTED, short, Rxb1 => act_on_targetted;
        }
        if feature = "allocation" {
            /// uavcan.protocol.dynamic_node_id.Allocation
            Allocation = message types::ALLOCATION, long, WithoutId => identity.act_on_allocation;
        }
        if not(feature = "draft") {
            /// uavcan.protocol.GetNodeInfo
            GetNodeInfo = request types::GET_NODE_INFO, short, long => accept, respond_node_info;
            /// uavcan.protocol.RestartNode
            RestartNode = request types::RESTART_NODE, short, short => act_on_restart, respond_ok;
        }
        if feature = "standard" {
            /// uavcan.protocol.param.GetSet
            GetSet = request types::GET_SET, long, long => act_on_get_set, respond_get_set;
            /// uavcan.protocol.param.ExecuteOpcode
            ExecuteOpcode = request types::EXECUTE_OPCODE, short, short
                => act_on_opcode, respond_opcode;
            /// uavcan.protocol.file.BeginFirmwareUpdate
            BeginFirmwareUpdate = request types::BEGIN_FIRMWARE_UPDATE, long, long
                => act_on_update, respond_update;
        }
        if feature = "stats" {
            /// uavcan.protocol.GetTransportStats
            GetTransportStats = request types::GET_TRANSPORT_STATS, short, long
                => accept, respond_stats;
        }
    } };
}
pub(crate) use for_received;

for_received!(received);

impl Kind {
    /// The ID of the data type or service. Not of [`Unknown`](Self::Unknown).
    #[inline(never)]
    pub fn data_type(self, flash: impl Progmem<DataTypes>) -> u16 {
        let at = 2 * (u16::from(self as u8 & (COMMAND - 1)) - 1);
        flash.word(at)
    }

    /// True for a request to this node.
    #[inline(always)]
    pub const fn is_request(self) -> bool {
        self as u8 & REQUEST != 0
    }

    /// True for a list, and for a command that has the lanes of lists.
    #[inline(always)]
    pub const fn is_command(self) -> bool {
        self as u8 & COMMAND != 0
    }

    /// True if a transfer can have several frames.
    #[inline(always)]
    pub const fn is_long(self) -> bool {
        self as u8 & LONG != 0
    }
}

impl Received for Kind {
    const UNKNOWN: Self = Self::Unknown;

    /// ArrayCommand and RawCommand.
    const LANE_FOR_EACH_TYPE: bool = Self::HAS_COMMAND;

    /// With several outputs a full bus leaves no time to spare, and the chip has the flash.
    const TAKES_ENTRIES: bool = OUTPUTS > 1;

    #[inline(always)]
    fn of_message(data_type: u16) -> Self {
        Self::of_message(data_type)
    }

    #[inline(always)]
    fn of_request(service: u8) -> Self {
        Self::of_request(service)
    }

    /// A node without an ID receives the Allocation requests of other nodes.
    #[inline(always)]
    fn of_anonymous(data_type: u8, node: u8) -> Self {
        let is_allocation = u16::from(data_type) == Self::Allocation.id();
        if node == 0 && is_allocation { Self::Allocation } else { Self::Unknown }
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
        self.is_command()
    }

    #[inline(always)]
    fn most_entries(self) -> u8 {
        self.most()
    }

    /// The text of a GetSet: no parameter is a text.
    #[inline(always)]
    fn left_out(self, head: &[u8]) -> u8 {
        match head {
            &[_, index_and_tag, len, ..] if self == Self::GetSet && index_and_tag & 7 == TEXT => {
                len
            }
            _ => 0,
        }
    }

    #[inline(always)]
    fn seed(self) -> u16 {
        self.seed()
    }
}

#[cfg(all(test, not(feature = "draft")))]
mod tests;
