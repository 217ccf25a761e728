//! What can be set over the bus: names, ranges and defaults (docs/parameters.md).

use crate::progmem::{PARAMETERS, Progmem};

macro_rules! parameters {
    ($($(#[doc = $doc:literal])* $id:ident $name:literal $min:literal .. $max:literal = $default:literal,)*) => {
        /// A parameter: its index on the bus.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Parameter {
            $($(#[doc = $doc])* $id,)*
        }

        const TABLE: &[(&str, i32, i32, i32)] = &[$(($name, $min, $max, $default),)*];
    };
}

parameters! {
    /// The node ID; 0 asks an allocator for one.
    CanNode "CAN_NODE" 0..125 = 120,
    /// Bit rate, in units of 125 kbit/s: 1, 2, 4 or 8. On the bus it is in bit/s.
    CanBaudrate "CAN_BAUDRATE" 1..8 = 8,
    /// The actuator that the node is.
    SrvId "SRV_ID" 0..255 = 1,
    /// One end of the travel, in microseconds.
    SrvMin "SRV_MIN" 500..2500 = 1000,
    /// The pulse for no deflection, in microseconds.
    SrvTrim "SRV_TRIM" 500..2500 = 1500,
    /// The other end of the travel, in microseconds.
    SrvMax "SRV_MAX" 500..2500 = 2000,
    /// Whether the direction is turned around.
    SrvReversed "SRV_REVERSED" 0..1 = 0,
    /// Pulses a second.
    SrvRate "SRV_RATE" 50..333 = 50,
    /// The whole travel in degrees, for commands of position.
    SrvRange "SRV_RANGE" 10..360 = 90,
    /// Without a command for so many milliseconds the output fails safe; 0 is never.
    SrvTimeout "SRV_TIMEOUT" 0..10000 = 1000,
    /// How: 0 holds the pulse, 1 goes to the trim, 2 to SRV_FS_PWM, 3 ends the pulses.
    SrvFailsafe "SRV_FAILSAFE" 0..3 = 0,
    /// The pulse for SRV_FAILSAFE 2, in microseconds.
    SrvFsPwm "SRV_FS_PWM" 500..2500 = 1500,
    /// Whether commands are followed only while the vehicle is armed.
    ArmReq "ARM_REQ" 0..1 = 0,
    /// actuator.Status a second.
    TelemRate "TELEM_RATE" 0..50 = 10,
    /// device.Temperature a second.
    TempRate "TEMP_RATE" 0..50 = 1,
    /// The device that the temperature is of.
    TempId "TEMP_ID" 0..65535 = 1,
    /// What the sensor is measured against: 0 is 5 V, 1 is 1.1 V.
    TempRef "TEMP_REF" 0..1 = 0,
    /// Voltage of the sensor at 0 degrees Celsius, in millivolts.
    TempOffset "TEMP_OFFSET" -500..1500 = 0,
    /// Tenths of a millivolt a kelvin.
    TempSlope "TEMP_SLOPE" 10..500 = 100,
    /// Below so many degrees Celsius the temperature is out of range.
    TempMin "TEMP_MIN" -55..150 = -40,
    /// Above so many.
    TempMax "TEMP_MAX" -55..150 = 85,
    /// The light that the node is.
    LightId "LIGHT_ID" 0..255 = 0,
    /// CanStats a second.
    StatsRate "STATS_RATE" 0..10 = 0,
    /// Conditions that make the health WARNING.
    WarnMask "WARN_MASK" 0..65535 = 0xABFF,
    /// Conditions that make it ERROR.
    ErrorMask "ERROR_MASK" 0..65535 = 0x1400,
    /// Conditions that make it CRITICAL.
    CritMask "CRIT_MASK" 0..65535 = 0x2000,
}

/// How many there are.
pub const COUNT: usize = TABLE.len();

/// The index of no parameter.
pub const NONE: u8 = 0xFF;

/// A name has no more characters than ArduPilot's.
const MAX_NAME_LEN: usize = 16;

/// Bytes of a value, here and in EEPROM: little-endian, two's complement where it can be negative.
const VALUE_LEN: u8 = 2;

/// Bytes of a value of each parameter.
pub(super) const VALUES_LEN: u8 = VALUE_LEN * COUNT as u8;

// In the flash: all defaults, all maxima, all minima, and all names, with its length before each.
const DEFAULTS: u16 = PARAMETERS;
const MAXIMA: u16 = DEFAULTS + VALUES_LEN as u16;
const MINIMA: u16 = MAXIMA + VALUES_LEN as u16;
const NAMES: u16 = MINIMA + VALUES_LEN as u16;

const LEN: usize = {
    let mut len = 3 * VALUES_LEN as usize;
    let mut n = 0;
    while n < COUNT {
        len += 1 + TABLE[n].0.len();
        n += 1;
    }
    len
};

/// The table. A range may begin below zero or end above 32,767, so what is compared is always how far a value is above the
/// minimum, modulo 65,536.
pub const PACKED: [u8; LEN] = {
    let mut packed = [0; LEN];
    let mut at = 3 * VALUES_LEN as usize;
    let mut n = 0;
    while n < COUNT {
        let (name, min, max, default) = TABLE[n];
        assert!(!name.is_empty() && name.len() <= MAX_NAME_LEN);
        assert!(i16::MIN as i32 <= min && min <= default && default <= max && max - min <= u16::MAX as i32);
        assert!(min >= 0 || max <= i16::MAX as i32);
        let values = [default, max, min];
        let mut value = 0;
        while value < values.len() {
            let place = value * VALUES_LEN as usize + n * VALUE_LEN as usize;
            [packed[place], packed[place + 1]] = (values[value] as u16).to_le_bytes();
            value += 1;
        }
        packed[at] = name.len() as u8;
        at += 1;
        let mut c = 0;
        while c < name.len() {
            packed[at] = name.as_bytes()[c];
            at += 1;
            c += 1;
        }
        n += 1;
    }
    packed
};

/// A bit rate is kept as a number of units of 125 kbit/s. The lower 16 bits of the rate, from the number of half units: 2, 4,
/// 8 or 16. The bits above those are one less than that: 1, 3, 7 or 15.
#[inline(never)]
fn rate(mut halves: u8) -> u16 {
    let mut low = 62_500;
    while halves > 1 {
        halves >>= 1;
        low <<= 1;
    }
    low
}

/// What is above the lower 16 bits of a value: its sign if the minimum is negative (the maximum is below 32,768 then).
fn sign(low: u16, min: u16) -> u16 {
    ((low & min) as i16 >> 15) as u16
}

/// The place of a parameter in a table of values.
fn place(table: u16, index: u8) -> u16 {
    table.wrapping_add(u16::from(index.wrapping_mul(VALUE_LEN)))
}

/// Where the name of a parameter is in the flash; its length is the byte before.
pub fn name_at(index: u8, flash: impl Progmem) -> u16 {
    let mut at = NAMES + 1;
    for _ in 0..index {
        at = at.wrapping_add(u16::from(flash.byte(at.wrapping_sub(1)))).wrapping_add(1);
    }
    at
}

/// A number in a GetSet response: a tag, then eight bytes.
const NUMBER_LEN: u8 = 9;
const TAG_INTEGER: u8 = 1;

/// Bytes of a GetSet response before the name: value, default, maximum and minimum.
pub const NUMBERS_LEN: u8 = 4 * NUMBER_LEN;

/// A byte of a GetSet response, before the name, about the parameter with this index and a value of it.
pub fn response_byte(mut at: u8, value: u16, index: u8, flash: impl Progmem) -> u8 {
    let mut low = value;
    let mut number_at = place(DEFAULTS, index);
    while at >= NUMBER_LEN {
        at = at.wrapping_sub(NUMBER_LEN);
        low = flash.word(number_at);
        number_at = number_at.wrapping_add(u16::from(VALUES_LEN));
    }
    let mut high = sign(low, flash.word(place(MINIMA, index))) as u8;
    if index == Parameter::CanBaudrate as u8 {
        let halves = (low as u8) << 1;
        low = rate(halves);
        if at == 3 {
            high = halves.wrapping_sub(1);
        }
    }
    match at {
        0 => TAG_INTEGER,
        1 => low as u8,
        2 => (low >> 8) as u8,
        _ => high,
    }
}

/// The values in force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameters {
    values: [[u8; VALUE_LEN as usize]; COUNT],
    /// Whether one was changed since that was last asked.
    has_changed: bool,
}

impl Parameters {
    /// All zero, until they are loaded.
    pub const fn new() -> Self {
        Self { values: [[0; VALUE_LEN as usize]; COUNT], has_changed: false }
    }

    /// The value of a parameter; as two's complement where it can be negative.
    #[inline(always)]
    pub fn get(&self, parameter: Parameter) -> u16 {
        u16::from_le_bytes(self.values[parameter as usize])
    }

    /// Whether a parameter is not zero, for those below 256.
    #[inline(always)]
    pub fn is_on(&self, parameter: Parameter) -> bool {
        self.values[parameter as usize][0] != 0
    }

    /// The values for the store, two bytes each.
    pub(super) fn bytes(&mut self) -> &mut [u8] {
        self.values.as_flattened_mut()
    }

    /// Whether a value may have been changed since this was last asked.
    pub(super) fn take_change(&mut self) -> bool {
        core::mem::take(&mut self.has_changed)
    }

    /// The parameter of this name; [`NONE`] if there is none.
    pub fn find(name: &[u8], flash: impl Progmem) -> u8 {
        let mut at = NAMES;
        for index in 0..COUNT as u8 {
            let len = flash.byte(at);
            at = at.wrapping_add(1);
            let mut byte_at = at;
            if usize::from(len) == name.len()
                && name.iter().all(|&byte| {
                    let expected = flash.byte(byte_at);
                    byte_at = byte_at.wrapping_add(1);
                    byte == expected
                })
            {
                return index;
            }
            at = at.wrapping_add(u16::from(len));
        }
        NONE
    }

    /// Sets a parameter to a number, in two's complement: its lower and upper 16 bits. Whether it was in range; else nothing changes.
    pub fn set(&mut self, index: u8, mut low: u16, mut high: u16, flash: impl Progmem) -> bool {
        let Some(value) = self.values.get_mut(usize::from(index)) else { return false };
        if index == Parameter::CanBaudrate as u8 {
            let halves = (high as u8).wrapping_add(1);
            if low != rate(halves) || halves & high as u8 != 0 {
                return false;
            }
            low = u16::from(halves >> 1);
            high &= 0xFF00;
        }
        let min = flash.word(place(MINIMA, index));
        let span = flash.word(place(MAXIMA, index)).wrapping_sub(min);
        if low.wrapping_sub(min) > span || high != sign(low, min) {
            return false;
        }
        *value = low.to_le_bytes();
        self.has_changed = true;
        true
    }

    /// The value of the parameter with this index, if there is one.
    pub fn value(&self, index: u8) -> Option<u16> {
        self.values.get(usize::from(index)).map(|&value| u16::from_le_bytes(value))
    }

    /// Sets all to their defaults.
    #[inline(never)]
    pub fn set_defaults(&mut self, flash: impl Progmem) {
        let mut at = DEFAULTS;
        for byte in self.bytes() {
            *byte = flash.byte(at);
            at = at.wrapping_add(1);
        }
        self.has_changed = true;
    }
}

impl Default for Parameters {
    fn default() -> Self {
        Self::new()
    }
}
