//! The data types that the node receives: one table, from which come their IDs, the seeds of their CRCs, how they are put together,
//! and the filters of the controller ([`acceptance`](super::acceptance)).
//!
//! A seed is what the CRC amounts to after the signature of the type (see [`crc`](super::crc)).

/// In the number of a [`Kind`], above its ID: a request.
const REQUEST: u16 = 1 << 15;

/// In the number of a [`Kind`], above its ID: a transfer can be several frames.
const LONG: u16 = 1 << 14;

/// In the number of a [`Kind`]: the ID of the data type or service.
const ID: u16 = LONG - 1;

macro_rules! received {
    ($($(#[doc = $doc:literal])* $(#[cfg($if:meta)])? $kind:ident = $space:ident $id:literal, $form:ident, $seed:literal;)*) => {
        /// What a received transfer is. Its number is the ID of the data type or service, and of what kind it is.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u16)]
        pub enum Kind {
            /// Nothing that the node takes.
            Unknown = 0,
            $($(#[doc = $doc])* $(#[cfg($if)])? $kind = received!(@$space) | received!(@$form) | $id,)*
        }

        impl Kind {
            /// All of them.
            pub const ALL: &[Self] = &[$($(#[cfg($if)])? Self::$kind,)*];

            #[inline(always)]
            const fn of(space_and_id: u16) -> Self {
                $($(#[cfg($if)])? if space_and_id == received!(@$space) | $id {
                    return Self::$kind;
                })*
                Self::Unknown
            }

            /// Where the CRC of a transfer of several frames begins, also that of the response; 0 where there is never more than one.
            #[inline(never)]
            pub const fn seed(self) -> u16 {
                $($(#[cfg($if)])? if $seed != 0 && self as u16 == Self::$kind as u16 {
                    return $seed;
                })*
                0
            }
        }
    };
    (@message) => { 0 };
    (@request) => { REQUEST };
    (@short) => { 0 };
    (@long) => { LONG };
}

received! {
    /// uavcan.equipment.actuator.ArrayCommand
    ArrayCommand = message 1010, long, 0x5E37;
    /// uavcan.protocol.NodeStatus
    NodeStatus = message 341, short, 0;
    /// thesis.ServoCommand
    ServoCommand = message 1111, short, 0;
    /// uavcan.equipment.safety.ArmingStatus
    #[cfg(feature = "standard")]
    ArmingStatus = message 1100, short, 0;
    /// uavcan.equipment.indication.LightsCommand
    #[cfg(feature = "lights")]
    LightsCommand = message 1081, long, 0x9E31;
    /// uavcan.protocol.dynamic_node_id.Allocation
    #[cfg(feature = "allocation")]
    Allocation = message 1, long, 0xF258;
    /// uavcan.protocol.GetNodeInfo
    GetNodeInfo = request 1, short, 0xD9A7;
    /// uavcan.protocol.RestartNode
    RestartNode = request 5, short, 0;
    /// uavcan.protocol.param.GetSet
    #[cfg(feature = "standard")]
    GetSet = request 11, long, 0xFB10;
    /// uavcan.protocol.param.ExecuteOpcode
    #[cfg(feature = "standard")]
    ExecuteOpcode = request 10, short, 0;
    /// uavcan.protocol.file.BeginFirmwareUpdate
    #[cfg(feature = "standard")]
    BeginFirmwareUpdate = request 40, long, 0x729E;
    /// uavcan.protocol.GetTransportStats
    #[cfg(feature = "stats")]
    GetTransportStats = request 4, short, 0x4D73;
    /// ArrayCommand of the draft of 2014: entries of three bytes, without a type.
    #[cfg(feature = "draft")]
    DraftCommand = message 265, long, 0xBFEF;
}

impl Kind {
    /// The message with this data type ID.
    #[inline(always)]
    pub const fn of_message(data_type: u16) -> Self {
        match Self::of(data_type & !REQUEST) {
            // In DroneCAN v0 that is another type.
            #[cfg(feature = "draft")]
            Self::DraftCommand => Self::Unknown,
            _ if data_type >= LONG => Self::Unknown,
            kind => kind,
        }
    }

    /// The request with this service ID.
    #[inline(always)]
    pub const fn of_request(service: u8) -> Self {
        Self::of(REQUEST | service as u16)
    }

    /// The ID of the data type or service.
    #[inline(always)]
    pub const fn id(self) -> u16 {
        self as u16 & ID
    }

    /// A request to this node.
    #[inline(always)]
    pub const fn is_request(self) -> bool {
        self as u16 & REQUEST != 0
    }

    /// A transfer can be several frames.
    #[inline(always)]
    pub const fn is_long(self) -> bool {
        self as u16 & LONG != 0
    }

    /// Of a list, of which only the entries with this node's ID are kept: the bytes of an entry. Otherwise 0.
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

    /// Of a list, of which only the entries with this node's ID are kept.
    #[inline(always)]
    pub const fn is_list(self) -> bool {
        self.entry_len() != 0
    }

    /// A command for the actuator.
    #[inline(always)]
    pub const fn is_command(self) -> bool {
        match self {
            Self::ArrayCommand | Self::ServoCommand => true,
            #[cfg(feature = "draft")]
            Self::DraftCommand => true,
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests;
