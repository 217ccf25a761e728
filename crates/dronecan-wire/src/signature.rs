//! The signature of a data type, from its definition in DSDL: for types of your own. It is computed
//! at compile time, so that a microcontroller has the seed only.
//!
//! ```
//! use dronecan_wire::signature;
//! use dronecan_wire::types::Message;
//!
//! /// The numbers from 20,000 on are for types of vendors.
//! const BEACON: Message = Message::new(20_100, signature::of(
//!     "com.example.Beacon",
//!     "uint16 serial          # of the device
//!      float16[<=8] levels",
//!     &[],
//! ));
//! ```
//!
//! Source: DroneCAN specification, "Data structure description language", section "Signature".

/// The word before a signature that a definition has itself, in place of that of its text.
const OVERRIDE: &[u8] = b"OVERRIDE_SIGNATURE";

/// The CRC-64-WE of the normalised definition, and of the signatures of the types within.
struct Hash(u64);

impl Hash {
    const POLYNOMIAL: u64 = 0x42F0_E1EB_A9EA_3693;

    const fn add(&mut self, byte: u8) {
        self.0 ^= (byte as u64) << 56;
        let mut bit = 0;
        while bit < 8 {
            let carry = self.0 >> 63;
            self.0 = (self.0 << 1) ^ (carry * Self::POLYNOMIAL);
            bit += 1;
        }
    }

    const fn add_all(&mut self, bytes: &[u8]) {
        let mut at = 0;
        while at < bytes.len() {
            self.add(bytes[at]);
            at += 1;
        }
    }

    const fn value(&self) -> u64 {
        !self.0
    }

    const fn add_number(&mut self, number: usize) {
        if number > 9 {
            self.add_number(number / 10);
        }
        self.add(b'0' + (number % 10) as u8);
    }

    /// Adds the type of a field, normalised. Returns true if it is not a primitive type.
    const fn add_type(&mut self, space: &[u8], name: &[u8], has_cast: bool) -> bool {
        let bracket = find(name, b'[');
        let (base, array) = name.split_at(bracket);
        let is_compound = !is_primitive(base) && !is_void(base);
        if is_compound && find(base, b'.') == base.len() {
            self.add_all(space);
        } else if is_primitive(base) && !has_cast {
            self.add_all(b"saturated ");
        }
        self.add_all(base);
        match array {
            // Less than N is at most N - 1.
            [b'[', b'<', first, ..] if *first != b'=' => {
                self.add_all(b"[<=");
                self.add_number(number(array.split_at(2).1) - 1);
                self.add(b']');
            }
            array => self.add_all(array),
        }
        is_compound
    }

    /// Adds a line of a definition, without spaces at its ends. Returns true if it is a field whose
    /// type is not a primitive one.
    const fn add_line(&mut self, space: &[u8], line: &[u8]) -> bool {
        self.add(b'\n');
        let (first, rest) = split_word(line);
        if equal(first, b"---") || equal(first, b"@union") {
            self.add_all(first);
            return false;
        }
        let has_cast = equal(first, b"saturated") || equal(first, b"truncated");
        let (kind, name) = if has_cast { split_word(rest) } else { (first, rest) };
        if has_cast {
            self.add_all(first);
            self.add(b' ');
        }
        let is_compound = self.add_type(space, kind, has_cast);
        if !name.is_empty() {
            self.add(b' ');
            self.add_all(name);
        }
        is_compound
    }
}

/// The signature of the type with this full name and this text in DSDL. `nested` has the signature
/// of each field, and of each array, whose type is not a primitive one, in the order of the text.
///
/// # Panics
/// If `nested` has another number of signatures than the text has such fields.
pub const fn of(full_name: &str, definition: &str, nested: &[u64]) -> u64 {
    let (name, text) = (full_name.as_bytes(), definition.as_bytes());
    let space = name.split_at(after_last_dot(name)).0;
    let mut hash = Hash(u64::MAX);
    hash.add_all(name);
    let (mut rest, mut compounds, mut other) = (text, 0, None);
    while !rest.is_empty() {
        let (line, behind) = rest.split_at(find(rest, b'\n'));
        rest = if behind.is_empty() { behind } else { behind.split_at(1).1 };
        let line = line.split_at(find(line, b'#')).0.trim_ascii();
        if starts_with(line, OVERRIDE) {
            other = Some(hexadecimal(split_word(line).1));
        } else if !line.is_empty() && !is_constant(line) {
            compounds += hash.add_line(space, line) as usize;
        }
    }
    if let Some(other) = other {
        hash.0 = !other;
    }
    assert!(compounds == nested.len(), "a signature is missing, or there is one too many");
    let mut at = 0;
    while at < nested.len() {
        let so_far = hash.value();
        hash.add_all(&nested[at].to_le_bytes());
        hash.add_all(&so_far.to_le_bytes());
        at += 1;
    }
    hash.value()
}

/// The index of the first such byte, or the length.
const fn find(bytes: &[u8], wanted: u8) -> usize {
    let mut at = 0;
    while at < bytes.len() && bytes[at] != wanted {
        at += 1;
    }
    at
}

const fn after_last_dot(name: &[u8]) -> usize {
    let mut at = name.len();
    while at > 0 && name[at - 1] != b'.' {
        at -= 1;
    }
    at
}

/// The first word of a line, and the rest.
const fn split_word(line: &[u8]) -> (&[u8], &[u8]) {
    let mut at = 0;
    while at < line.len() && !line[at].is_ascii_whitespace() {
        at += 1;
    }
    let (word, rest) = line.split_at(at);
    (word, rest.trim_ascii())
}

const fn equal(one: &[u8], other: &[u8]) -> bool {
    starts_with(one, other) && one.len() == other.len()
}

const fn starts_with(bytes: &[u8], start: &[u8]) -> bool {
    let mut at = 0;
    while at < start.len() {
        if at >= bytes.len() || bytes[at] != start[at] {
            return false;
        }
        at += 1;
    }
    true
}

/// True for a constant: a `=` that is not that of `[<=8]`.
const fn is_constant(line: &[u8]) -> bool {
    let at = find(line, b'=');
    at < line.len() && at > 0 && line[at - 1] != b'<'
}

const fn is_primitive(base: &[u8]) -> bool {
    equal(base, b"bool")
        || is_numbered(base, b"uint")
        || is_numbered(base, b"int")
        || is_numbered(base, b"float")
}

const fn is_void(base: &[u8]) -> bool {
    is_numbered(base, b"void")
}

/// True for this name with a number behind it.
const fn is_numbered(base: &[u8], name: &[u8]) -> bool {
    base.len() > name.len() && starts_with(base, name) && base[name.len()].is_ascii_digit()
}

/// The hexadecimal number in a text, after `0x`.
const fn hexadecimal(text: &[u8]) -> u64 {
    let (mut value, mut at) = (0, 2);
    while at < text.len() {
        let digit = match text[at].to_ascii_lowercase() {
            digit @ b'0'..=b'9' => digit - b'0',
            letter @ b'a'..=b'f' => letter - b'a' + 10,
            _ => panic!("a signature is written as 0x0123456789ABCDEF"),
        };
        value = value << 4 | digit as u64;
        at += 1;
    }
    value
}

/// The number at the beginning of a text.
const fn number(text: &[u8]) -> usize {
    let (mut value, mut at) = (0, 0);
    while at < text.len() && text[at].is_ascii_digit() {
        value = value * 10 + (text[at] - b'0') as usize;
        at += 1;
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crc;
    use crate::types;

    /// The check value of CRC-64-WE.
    #[test]
    fn the_hash_is_that_of_the_specification() {
        let mut hash = Hash(u64::MAX);
        hash.add_all(b"123456789");
        assert_eq!(hash.value(), 0x62EC_59E3_F1A4_F00A);
    }

    /// Computed at compile time, as a program has it.
    const NODE_STATUS: u64 = of(
        "uavcan.protocol.NodeStatus",
        "uint32 uptime_sec      # seconds
         uint2 HEALTH_OK = 0    # a constant
         uint2 health
         uint3 mode

         uint3 sub_mode
         uint16 vendor_specific_status_code",
        &[],
    );
    const HARDWARE: u64 = of(
        "uavcan.protocol.HardwareVersion",
        "uint8 major\nuint8 minor\nuint8[16] unique_id\nuint8[<=255] certificate_of_authenticity",
        &[],
    );
    const SOFTWARE: u64 = of(
        "uavcan.protocol.SoftwareVersion",
        "uint8 major\nuint8 minor\nuint8 optional_field_flags\nuint32 vcs_commit\nuint64 image_crc",
        &[],
    );

    #[test]
    fn the_seeds_of_standard_types_follow_from_their_definitions() {
        let seed = crc::seed;
        assert_eq!(seed(NODE_STATUS), types::NODE_STATUS.seed);
        // A service with an empty request, and types of its own name space.
        let info = of(
            "uavcan.protocol.GetNodeInfo",
            "---\nNodeStatus status\nuavcan.protocol.SoftwareVersion software_version\n\
             HardwareVersion hardware_version\nuint8[<=80] name",
            &[NODE_STATUS, SOFTWARE, HARDWARE],
        );
        assert_eq!(seed(info), types::GET_NODE_INFO.seed);
        // An array of another type, and arrays shorter than a number.
        let command = of(
            "uavcan.equipment.actuator.Command",
            "uint8 actuator_id\nuint8 command_type\nfloat16 command_value",
            &[],
        );
        let name = "uavcan.equipment.actuator.ArrayCommand";
        for commands in ["Command[<=15] commands", "Command[<16]  commands"] {
            assert_eq!(seed(of(name, commands, &[command])), types::ARRAY_COMMAND.seed);
        }
        // Unions, void and truncated fields.
        let empty = of("uavcan.protocol.param.Empty", "", &[]);
        let value = of(
            "uavcan.protocol.param.Value",
            "@union\nEmpty empty\nint64 integer_value\nfloat32 real_value\nuint8 boolean_value\n\
             uint8[<=128] string_value",
            &[empty],
        );
        let numeric = of(
            "uavcan.protocol.param.NumericValue",
            "@union\nEmpty empty\nint64 integer_value\nfloat32 real_value",
            &[empty],
        );
        let get_set = of(
            "uavcan.protocol.param.GetSet",
            "uint13 index\nValue value\nuint8[<=92] name\n---\nvoid5\nValue value\nvoid5\n\
             Value default_value\nvoid6\nNumericValue max_value\nvoid6\nNumericValue min_value\n\
             uint8[<=92] name",
            &[value, value, value, numeric, numeric],
        );
        assert_eq!(seed(get_set), types::GET_SET.seed);
        let sync = of(
            "uavcan.protocol.GlobalTimeSync",
            "truncated uint56 previous_transmission_timestamp_usec",
            &[],
        );
        assert_eq!(seed(sync), types::GLOBAL_TIME_SYNC.seed);
    }

    /// As in the definitions of com.hobbywing, with its type in another name space.
    #[test]
    fn a_definition_can_have_its_signature_itself() {
        let text = "OVERRIDE_SIGNATURE 0x60F5464E1CA03449\nuint8 requirement";
        assert_eq!(of("com.example.Request", text, &[]), 0x60F5_464E_1CA0_3449);
    }

    #[test]
    #[should_panic = "a signature is missing"]
    fn a_type_without_the_signature_of_a_field_is_rejected() {
        of("com.example.Both", "Other other", &[]);
    }
}
