//! The data types that the node receives and sends: their IDs and the seeds of their CRCs (DSDL, folder uavcan).
//!
//! A seed is what the CRC amounts to after the signature of the type (see [`crc`](super::crc)); types whose transfers always
//! fit in one frame have none.

use crate::progmem::{KINDS, Progmem};

macro_rules! kinds {
    ($($(#[doc = $doc:literal])* $id:ident = $space:ident $data_type:literal, $seed:literal;)*) => {
        /// A data type in one role: the place in the table.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        #[repr(u8)]
        #[allow(clippy::upper_case_acronyms, reason = "only the constants below are used by these names")]
        enum Place { $($id,)* }

        /// What a transfer is: one of the constants here.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        pub struct Kind(pub u8);

        impl Kind {
            $($(#[doc = $doc])* pub const $id: Self = Self(Place::$id as u8);)*
        }

        const TABLE: &[(bool, u16, u16)] = &[$((kinds!(@ $space), $data_type, $seed),)*];
    };
    (@ message) => { false };
    (@ service) => { true };
}

#[allow(non_camel_case_types)]
mod table {
    kinds! {
        /// uavcan.equipment.actuator.ArrayCommand. The first six can be longer than a frame.
        ARRAY_COMMAND = message 1010, 0x5E37;
        /// uavcan.equipment.indication.LightsCommand
        LIGHTS_COMMAND = message 1081, 0x9E31;
        /// uavcan.protocol.dynamic_node_id.Allocation
        ALLOCATION = message 1, 0xF258;
        /// ArrayCommand of the draft, which has another form.
        DRAFT_COMMAND = message 265, 0xBFEF;
        /// uavcan.protocol.param.GetSet. From here to GetTransportStats all are services.
        GET_SET = service 11, 0xFB10;
        /// uavcan.protocol.file.BeginFirmwareUpdate
        BEGIN_FIRMWARE_UPDATE = service 40, 0x729E;
        /// uavcan.protocol.GetNodeInfo
        GET_NODE_INFO = service 1, 0xD9A7;
        /// uavcan.protocol.RestartNode
        RESTART_NODE = service 5, 0;
        /// uavcan.protocol.param.ExecuteOpcode
        EXECUTE_OPCODE = service 10, 0;
        /// uavcan.protocol.GetTransportStats
        GET_TRANSPORT_STATS = service 4, 0x4D73;
        /// uavcan.protocol.NodeStatus
        NODE_STATUS = message 341, 0;
        /// thesis.ServoCommand
        SERVO_COMMAND = message 1111, 0;
        /// uavcan.equipment.safety.ArmingStatus
        ARMING_STATUS = message 1100, 0;
        /// NodeStatus, as the node sends it. From here on what it sends, in the order in which it goes.
        OWN_STATUS = message 341, 0;
        /// thesis.DegreesCelsius
        DEGREES_CELSIUS = message 1112, 0;
        /// uavcan.equipment.actuator.Status
        ACTUATOR_STATUS = message 1011, 0x9A63;
        /// uavcan.equipment.device.Temperature
        TEMPERATURE = message 1110, 0;
        /// dronecan.protocol.CanStats
        CAN_STATS = message 343, 0xE601;
        /// uavcan.protocol.debug.KeyValue
        KEY_VALUE = message 16370, 0;
    }

    impl Kind {
        /// The data type ID, where it is known at compile time.
        pub const fn data_type(self) -> u16 {
            TABLE[self.0 as usize].1
        }
    }

    /// Bytes of an entry.
    const ENTRY_LEN: usize = 4;

    /// The table: for each the ID (of a service its low byte, with 0xFF above it) and the seed, 16 bits each, little-endian.
    pub const PACKED: [u8; TABLE.len() * ENTRY_LEN] = {
        let mut packed = [0; TABLE.len() * ENTRY_LEN];
        let mut n = 0;
        while n < TABLE.len() {
            let (is_service, data_type, seed) = TABLE[n];
            let data_type = if is_service { 0xFF00 | data_type } else { data_type };
            [packed[4 * n], packed[4 * n + 1]] = data_type.to_le_bytes();
            [packed[4 * n + 2], packed[4 * n + 3]] = seed.to_le_bytes();
            n += 1;
        }
        packed
    };
}
pub use table::{Kind, PACKED};

/// The upper byte of a service in the table.
const SERVICE: u8 = 0xFF;

impl Kind {
    /// Received, but of no kind that the node knows.
    pub const UNKNOWN: Self = Self::OWN_STATUS;

    /// Whether it is a request to this node.
    pub const fn is_request(self) -> bool {
        self.0 >= Self::GET_SET.0 && self.0 < Self::NODE_STATUS.0
    }

    fn at(self) -> u16 {
        KINDS.wrapping_add(u16::from(self.0) << 2)
    }

    /// The received message with this data type ID.
    #[inline(always)]
    pub fn of_message([high, low]: [u8; 2], flash: impl Progmem) -> Self {
        // The low bytes differ: quicker than to go through the table. The last one is looked for first.
        let mut kind = Self::UNKNOWN;
        kind = if low == Self::SERVO_COMMAND.data_type() as u8 { Self::SERVO_COMMAND } else { kind };
        kind = if low == Self::ARMING_STATUS.data_type() as u8 { Self::ARMING_STATUS } else { kind };
        kind = if low == Self::LIGHTS_COMMAND.data_type() as u8 { Self::LIGHTS_COMMAND } else { kind };
        kind = if low == Self::ALLOCATION.data_type() as u8 { Self::ALLOCATION } else { kind };
        kind = if low == Self::NODE_STATUS.data_type() as u8 { Self::NODE_STATUS } else { kind };
        kind = if low == Self::ARRAY_COMMAND.data_type() as u8 { Self::ARRAY_COMMAND } else { kind };
        if kind.id_high(flash) == high { kind } else { Self::UNKNOWN }
    }

    /// The request with this data type ID.
    #[inline(never)]
    pub fn of_service(data_type: u8, flash: impl Progmem) -> Self {
        let mut kind = Self::GET_SET;
        while kind != Self::UNKNOWN && !(kind.id_low(flash) == data_type && kind.id_high(flash) == SERVICE) {
            kind.0 = kind.0.wrapping_add(1);
        }
        kind
    }

    /// The data type ID.
    pub fn id(self, flash: impl Progmem) -> u16 {
        let id = flash.word(self.at());
        if id >= u16::from(SERVICE) << 8 { id & 0xFF } else { id }
    }

    /// The low byte of the data type ID.
    pub fn id_low(self, flash: impl Progmem) -> u8 {
        flash.byte(self.at())
    }

    /// The high byte of the data type ID of a message.
    pub fn id_high(self, flash: impl Progmem) -> u8 {
        flash.byte(self.at().wrapping_add(1))
    }

    /// Where the CRC of a longer transfer begins.
    pub fn seed(self, flash: impl Progmem) -> u16 {
        flash.word(self.at().wrapping_add(2))
    }
}

#[cfg(test)]
mod tests;
