//! The parameters that can be set over the bus: names, ranges and defaults (docs/parameters.md).

use dronecan_wire::crc;

use crate::node::bit_rate::HIGHEST_RATE;
use crate::progmem::Progmem;

#[cfg(feature = "outputs")]
mod outputs;

/// Name, minimum, maximum and default of a parameter.
type Row = (&'static str, i32, i32, i32);

macro_rules! parameters {
    ($($(#[doc = $doc:literal])* $(#[cfg($if:meta)])? $id:ident $name:literal $min:literal .. $max:tt = $default:expr,)*) => {
        /// A parameter. Its number is its index on the bus.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Parameter {
            $($(#[doc = $doc])* $(#[cfg($if)])? $id,)*
        }

        /// The parameters of [`Parameter`].
        const SINGLE: &[Row] = &[$($(#[cfg($if)])? ($name, $min, $max, $default),)*];
    };
}

parameters! {
    /// The node ID; 0 requests one from an allocator.
    CanNode "CAN_NODE" 0..125 = 120,
    /// Bit rate: 125 kbit/s, doubled so many times. On the bus it is in bit/s. The default is the highest rate of the CAN board.
    CanBaudrate "CAN_BAUDRATE" 0..HIGHEST_RATE = (HIGHEST_RATE),
    /// The actuator ID of the servo output.
    Out1Id "OUT1_ID" 0..255 = 1,
    /// One end of the travel, in microseconds.
    Out1Min "OUT1_MIN" 500..2500 = 1000,
    /// The pulse for no deflection, in microseconds.
    Out1Trim "OUT1_TRIM" 500..2500 = 1500,
    /// The other end of the travel, in microseconds.
    Out1Max "OUT1_MAX" 500..2500 = 2000,
    /// 1 reverses the direction.
    Out1Reversed "OUT1_REVERSED" 0..1 = 0,
    /// Pulses a second.
    OutRate "OUT_RATE" 50..333 = 50,
    /// The whole travel in degrees, for position commands.
    Out1Range "OUT1_RANGE" 10..360 = 90,
    /// Time without a command until the failsafe, in milliseconds; 0 disables it.
    Out1Timeout "OUT1_TIMEOUT" 0..10000 = 1000,
    /// The failsafe: 0 holds the pulse, 1 goes to the trim, 2 to OUT1_FS_PWM, 3 ends the pulses.
    Out1Fs "OUT1_FS" 0..3 = 0,
    /// The pulse for OUT1_FS 2, in microseconds.
    Out1FsPwm "OUT1_FS_PWM" 500..2500 = 1500,
    /// 1 follows commands only while the vehicle is armed.
    #[cfg(feature = "standard")]
    ArmReq "ARM_REQ" 0..1 = 0,
    /// Rate of actuator.Status, in messages a second.
    #[cfg(feature = "standard")]
    TelemRate "TELEM_RATE" 0..50 = 10,
    /// Rate of device.Temperature, in messages a second.
    TempRate "TEMP_RATE" 0..50 = 1,
    /// The device ID of the temperature sensor.
    TempId "TEMP_ID" 0..65535 = 1,
    /// The temperature sensor: 0 there is none, 1 if it is found, 2 it is required.
    TempSensor "TEMP_SENSOR" 0..2 = 1,
    /// The reference voltage of the ADC: 0 is 5 V, 1 is 1.1 V.
    TempRef "TEMP_REF" 0..1 = 0,
    /// Voltage of the sensor at 0 degrees Celsius, in millivolts.
    TempOffset "TEMP_OFFSET" -500..1500 = 0,
    /// Slope of the sensor, in tenths of a millivolt per kelvin.
    TempSlope "TEMP_SLOPE" 10..500 = 100,
    /// Lower limit of the temperature, in degrees Celsius.
    TempMin "TEMP_MIN" -55..150 = -40,
    /// Upper limit of the temperature, in degrees Celsius.
    TempMax "TEMP_MAX" -55..150 = 85,
    /// Conditions that make the health WARNING.
    WarnMask "WARN_MASK" 0..65535 = 0x1BF7,
    /// Conditions that make the health ERROR.
    ErrorMask "ERROR_MASK" 0..65535 = 0x0400,
    /// Conditions that make the health CRITICAL.
    CritMask "CRIT_MASK" 0..65535 = 0x2000,
    /// The ID of the light.
    #[cfg(feature = "lights")]
    LightId "LIGHT_ID" 0..255 = 0,
    /// Rate of CanStats, in messages a second.
    #[cfg(feature = "stats")]
    StatsRate "STATS_RATE" 0..10 = 0,
    /// The dialect: 0 chooses by the received messages, 1 is DroneCAN v0, 2 is the draft of 2014.
    #[cfg(feature = "draft")]
    Dialect "DIALECT" 0..2 = if cfg!(feature = "standard") { 0 } else { 2 },
    /// What the output does while the safety switch is on: 0 holds the pulse, 1 ends the pulses.
    #[cfg(feature = "safety")]
    SafeMode "SAFE_MODE" 0..1 = 1,
    /// Outputs in use.
    #[cfg(feature = "outputs")]
    OutCount "OUT_COUNT" 1..8 = 1,
    /// 0 is a servo, which follows ArrayCommand, 1 a motor, which follows esc.RawCommand.
    #[cfg(feature = "outputs")]
    Out1Type "OUT1_TYPE" 0..1 = 0,
    /// Rate of CircuitStatus, in messages a second; 0 does not measure the circuit.
    #[cfg(feature = "power")]
    PwrRate "PWR_RATE" 0..50 = 0,
    /// The ID of the circuit.
    #[cfg(feature = "power")]
    Pwr1Id "PWR1_ID" 0..65535 = 1,
    /// Volts of the circuit for a volt at the pin, in thousandths: 11000 for a divider of 10 and 1 kOhm.
    #[cfg(feature = "power")]
    Pwr1VoltMult "PWR1_VOLT_MULT" 100..65535 = 1000,
    /// Voltage at the pin for a circuit of 0 V, in millivolts.
    #[cfg(feature = "power")]
    Pwr1VoltOfs "PWR1_VOLT_OFS" -1000..1000 = 0,
    /// Amperes for a volt at the pin, in hundredths.
    #[cfg(feature = "power")]
    Pwr1AmpPervlt "PWR1_AMP_PERVLT" 1..65535 = 1000,
    /// Voltage at the pin without a current, in millivolts.
    #[cfg(feature = "power")]
    Pwr1AmpOffset "PWR1_AMP_OFFSET" -1000..5000 = 0,
    /// Lower limit of the voltage, in millivolts; 0 is none.
    #[cfg(feature = "power")]
    Pwr1VoltMin "PWR1_VOLT_MIN" 0..65535 = 0,
    /// Upper limit of the voltage, in millivolts; 0 is none.
    #[cfg(feature = "power")]
    Pwr1VoltMax "PWR1_VOLT_MAX" 0..65535 = 0,
    /// Upper limit of the current, in hundredths of an ampere; 0 is none.
    #[cfg(feature = "power")]
    Pwr1AmpMax "PWR1_AMP_MAX" 0..32767 = 0,
    /// The output that the circuit feeds, whose actuator.Status has the current in percent of PWR1_AMP_MAX; 0 is none.
    #[cfg(feature = "power")]
    Pwr1Out "PWR1_OUT" 0..8 = 0,
}

/// All parameters: those of [`Parameter`], then those of the outputs from the second on, output by
/// output.
#[cfg(not(feature = "outputs"))]
const TABLE: &[Row] = SINGLE;
#[cfg(feature = "outputs")]
const TABLE: &[Row] = &{
    let mut table = [SINGLE[0]; SINGLE.len() + outputs::ROWS.len()];
    let mut n = 0;
    while n < table.len() {
        table[n] = if n < SINGLE.len() { SINGLE[n] } else { outputs::ROWS[n - SINGLE.len()] };
        n += 1;
    }
    table
};

/// A parameter that each output has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum OutputParameter {
    /// OUTn_ID.
    Id,
    /// OUTn_MIN.
    Min,
    /// OUTn_TRIM.
    Trim,
    /// OUTn_MAX.
    Max,
    /// OUTn_REVERSED.
    Reversed,
    /// OUTn_RANGE.
    Range,
    /// OUTn_TIMEOUT.
    Timeout,
    /// OUTn_FS.
    Fs,
    /// OUTn_FS_PWM.
    FsPwm,
    /// OUTn_TYPE.
    #[cfg(feature = "outputs")]
    Type,
}

impl OutputParameter {
    /// The index of this parameter of an output.
    #[inline(always)]
    pub const fn index(self, output: usize) -> usize {
        #[cfg(feature = "outputs")]
        if let Some(output) = output.checked_sub(1) {
            return SINGLE.len() + output * outputs::PARAMETERS + self as usize;
        }
        let _ = output;
        // The parameters of the first output are in the order in which they came to be.
        (match self {
            Self::Id => Parameter::Out1Id,
            Self::Min => Parameter::Out1Min,
            Self::Trim => Parameter::Out1Trim,
            Self::Max => Parameter::Out1Max,
            Self::Reversed => Parameter::Out1Reversed,
            Self::Range => Parameter::Out1Range,
            Self::Timeout => Parameter::Out1Timeout,
            Self::Fs => Parameter::Out1Fs,
            Self::FsPwm => Parameter::Out1FsPwm,
            #[cfg(feature = "outputs")]
            Self::Type => Parameter::Out1Type,
        }) as usize
    }
}

/// The table in flash: [`PACKED`].
pub struct Descriptions;

/// Number of parameters.
pub const COUNT: usize = TABLE.len();

/// An index that no parameter has.
pub const NONE: u8 = 0xFF;

/// Maximum length of a name, as in ArduPilot.
const MAX_NAME_LEN: usize = 16;

/// Bytes of a value, in RAM and in EEPROM: little-endian, two's complement if the minimum is
/// negative.
const VALUE_LEN: u8 = 2;

/// Bytes of the values of all parameters.
pub(super) const VALUES_LEN: u8 = VALUE_LEN * COUNT as u8;

// Layout of the flash: all defaults, all maxima, all minima, then all names, each with its length
// before it.
const DEFAULTS: u16 = 0;
const MAXIMA: u16 = DEFAULTS + VALUES_LEN as u16;
const MINIMA: u16 = MAXIMA + VALUES_LEN as u16;
/// Start of the names in the flash, each with its length before it.
pub const NAMES: u16 = MINIMA + VALUES_LEN as u16;

const LEN: usize = {
    let mut len = 3 * VALUES_LEN as usize;
    let mut n = 0;
    while n < COUNT {
        len += 1 + TABLE[n].0.len();
        n += 1;
    }
    len
};

/// The table. A range may begin below zero or end above 32,767. So the code compares distances from
/// the minimum, modulo 65,536.
pub const PACKED: [u8; LEN] = {
    let mut packed = [0; LEN];
    let mut at = 3 * VALUES_LEN as usize;
    let mut n = 0;
    while n < COUNT {
        let (name, min, max, default) = TABLE[n];
        assert!(!name.is_empty() && name.len() <= MAX_NAME_LEN);
        assert!(
            i16::MIN as i32 <= min
                && min <= default
                && default <= max
                && max - min <= u16::MAX as i32
        );
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

/// The CRC of all names and ranges.
pub const DIGEST: u16 = {
    let mut digest = 0xFFFF;
    let mut n = 0;
    while n < COUNT {
        let (name, min, max, _) = TABLE[n];
        let [min_low, min_high] = (min as u16).to_le_bytes();
        let [max_low, max_high] = (max as u16).to_le_bytes();
        let range = [min_low, min_high, max_low, max_high];
        let mut at = 0;
        while at < name.len() + range.len() {
            let byte = if at < name.len() { name.as_bytes()[at] } else { range[at - name.len()] };
            digest = crc::step(digest, byte);
            at += 1;
        }
        n += 1;
    }
    digest
};

/// The bit rate in bit/s for a value of CAN_BAUDRATE.
#[inline(never)]
fn rate(doublings: u8) -> u32 {
    let mut rate = 125_000;
    for _ in 0..doublings {
        rate <<= 1;
    }
    rate
}

/// The bits above the lower 16 of a value: its sign if the minimum is negative (then the maximum is
/// below 32,768).
fn sign(low: u16, min: u16) -> u16 {
    ((low & min) as i16 >> 15) as u16
}

/// True if a value is in the range of the parameter whose default is at `default_at`.
#[inline(never)]
fn is_in_range(value: u16, default_at: u16, flash: impl Progmem<Descriptions>) -> bool {
    let min = flash.word(default_at.wrapping_add(MINIMA - DEFAULTS));
    value.wrapping_sub(min)
        <= flash.word(default_at.wrapping_add(MAXIMA - DEFAULTS)).wrapping_sub(min)
}

/// The place of a parameter in a table of values.
fn place(table: u16, index: u8) -> u16 {
    table.wrapping_add(u16::from(index.wrapping_mul(VALUE_LEN)))
}

/// The place of a parameter's name in the flash. The byte before it is the length.
pub fn name_at(index: u8, flash: impl Progmem<Descriptions>) -> u16 {
    let mut at = NAMES + 1;
    for _ in 0..index {
        at = at.wrapping_add(u16::from(flash.byte(at.wrapping_sub(1)))).wrapping_add(1);
    }
    at
}

/// Bytes of a number in a GetSet response: a tag, then eight bytes.
const NUMBER_LEN: u8 = 9;
const TAG_INTEGER: u8 = 1;

/// Bytes of a GetSet response before the name: value, default, maximum and minimum.
pub const NUMBERS_LEN: u8 = 4 * NUMBER_LEN;

/// A byte of a GetSet response, before the name, for the parameter with this index and a value of
/// it.
pub fn response_byte(mut at: u8, value: u16, index: u8, flash: impl Progmem<Descriptions>) -> u8 {
    let mut low = value;
    let mut number_at = place(DEFAULTS, index);
    while at >= NUMBER_LEN {
        at = at.wrapping_sub(NUMBER_LEN);
        low = flash.word(number_at);
        number_at = number_at.wrapping_add(u16::from(VALUES_LEN));
    }
    let mut high = sign(low, flash.word(place(MINIMA, index))) as u8;
    if index == Parameter::CanBaudrate as u8 {
        let [b0, b1, b2, _] = rate(low as u8).to_le_bytes();
        low = u16::from_le_bytes([b0, b1]);
        if at == 3 {
            high = b2;
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
    /// True if a value may have changed since the last [`take_change`](Self::take_change).
    has_changed: bool,
}

impl Parameters {
    /// All values zero, until they are loaded.
    pub const fn new() -> Self {
        Self { values: [[0; VALUE_LEN as usize]; COUNT], has_changed: false }
    }

    /// The value of a parameter, in two's complement if its minimum is negative.
    #[inline(always)]
    pub fn get(&self, parameter: Parameter) -> u16 {
        u16::from_le_bytes(self.values[parameter as usize])
    }

    /// The value of a parameter of an output.
    #[inline(always)]
    pub fn of(&self, output: usize, parameter: OutputParameter) -> u16 {
        u16::from_le_bytes(self.values.get(parameter.index(output)).copied().unwrap_or_default())
    }

    /// True if a parameter is not zero. For parameters below 256 only.
    #[inline(always)]
    pub fn is_on(&self, parameter: Parameter) -> bool {
        self.values[parameter as usize][0] != 0
    }

    /// The values for the store, two bytes each.
    pub(super) fn bytes(&mut self) -> &mut [u8] {
        self.values.as_flattened_mut()
    }

    /// True if a value may have changed since the last call.
    pub(super) fn take_change(&mut self) -> bool {
        core::mem::take(&mut self.has_changed)
    }

    /// The index of the parameter with this name; [`NONE`] if no parameter has it.
    pub fn find(name: &[u8], flash: impl Progmem<Descriptions>) -> u8 {
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

    /// Sets a parameter to a number. Returns false, and changes nothing, if the index does not
    /// exist or the number is out of range.
    pub fn set(&mut self, index: u8, mut number: i32, flash: impl Progmem<Descriptions>) -> bool {
        if usize::from(index) >= COUNT {
            return false;
        }
        if index == Parameter::CanBaudrate as u8 {
            let mut doublings = 0;
            while doublings <= HIGHEST_RATE as u8 && rate(doublings) != number as u32 {
                doublings += 1;
            }
            number = i32::from(doublings);
        }
        let (low, high) = (number as u16, (number >> 16) as u16);
        if !is_in_range(low, place(DEFAULTS, index), flash)
            || high != sign(low, flash.word(place(MINIMA, index)))
        {
            return false;
        }
        #[cfg(feature = "outputs")]
        if self.has_no_room(index, low) {
            return false;
        }
        self.values[usize::from(index)] = low.to_le_bytes();
        self.has_changed = true;
        true
    }

    /// The value of the parameter with this index. `None` if the index does not exist.
    pub fn value(&self, index: u8) -> Option<u16> {
        self.values.get(usize::from(index)).map(|&value| u16::from_le_bytes(value))
    }

    /// Sets parameters to their defaults: those with a value out of its range, and if `all`, all.
    /// Returns true if it set one.
    fn reset(&mut self, all: bool, flash: impl Progmem<Descriptions>) -> bool {
        let mut at = DEFAULTS;
        let mut has_reset = false;
        for value in &mut self.values {
            if all || !is_in_range(u16::from_le_bytes(*value), at, flash) {
                *value = flash.word(at).to_le_bytes();
                has_reset = true;
            }
            at = at.wrapping_add(u16::from(VALUE_LEN));
        }
        self.has_changed |= has_reset;
        has_reset
    }

    /// Sets the parameters with values out of range to their defaults. Returns true if there are
    /// any.
    #[inline(always)]
    pub fn repair(&mut self, flash: impl Progmem<Descriptions>) -> bool {
        self.reset(false, flash)
    }

    /// Sets all parameters to their defaults.
    #[inline(always)]
    pub fn set_defaults(&mut self, flash: impl Progmem<Descriptions>) {
        self.reset(true, flash);
    }
}

impl Default for Parameters {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::InMemory;

    #[test]
    fn the_digest_is_the_crc_of_all_names_and_ranges() {
        let range =
            |min: i32, max: i32| [(min as u16).to_le_bytes(), (max as u16).to_le_bytes()].concat();
        let bytes = TABLE
            .iter()
            .flat_map(|&(name, min, max, _)| [name.as_bytes(), &range(min, max)].concat());
        assert_eq!(DIGEST, bytes.fold(0xFFFF, crc::step));
    }

    /// Sets a parameter to a number. Returns false if it does not fit in 32 bits.
    fn set(parameters: &mut Parameters, index: u8, number: i64) -> bool {
        i32::try_from(number).is_ok_and(|number| parameters.set(index, number, InMemory))
    }

    fn fresh() -> Parameters {
        let mut parameters = Parameters::new();
        parameters.set_defaults(InMemory);
        parameters
    }

    /// The value on the bus for a number of the table.
    fn on_the_bus(index: usize, number: i32) -> i64 {
        if index == Parameter::CanBaudrate as usize { 125_000 << number } else { number.into() }
    }

    fn response(parameters: &Parameters, index: u8) -> std::vec::Vec<u8> {
        let value = parameters.value(index).unwrap();
        (0..NUMBERS_LEN).map(|at| response_byte(at, value, index, InMemory)).collect()
    }

    /// The four numbers of a response. Checks their tags.
    fn numbers(parameters: &Parameters, index: u8) -> [i64; 4] {
        let response = response(parameters, index);
        core::array::from_fn(|n| {
            assert_eq!(response[9 * n], 1, "the tag of an integer");
            i64::from_le_bytes(response[9 * n + 1..9 * n + 9].try_into().unwrap())
        })
    }

    #[test]
    fn every_parameter_answers_with_value_default_maximum_and_minimum() {
        for (index, &(name, min, max, default)) in TABLE.iter().enumerate() {
            let [min, max, default] = [min, max, default].map(|number| on_the_bus(index, number));
            assert_eq!(numbers(&fresh(), index as u8), [default, default, max, min], "{name}");
        }
    }

    #[test]
    fn a_response_is_laid_out_as_pydronecan_does() {
        // CAN_NODE = 42, default 120, maximum 125, minimum 0.
        let mut parameters = fresh();
        assert!(set(&mut parameters, 0, 42));
        let mut expected = [0; 36];
        for (number, value) in [42, 120, 125, 0].into_iter().enumerate() {
            expected[9 * number] = 1;
            expected[9 * number + 1] = value;
        }
        assert_eq!(response(&parameters, 0), expected);
    }

    #[test]
    fn all_of_a_range_can_be_set_and_nothing_else() {
        for (index, &(name, min, max, _)) in TABLE.iter().enumerate() {
            if index == Parameter::CanBaudrate as usize {
                continue;
            }
            let mut parameters = fresh();
            for number in -67_000..70_000 {
                let before = parameters;
                let is_set = set(&mut parameters, index as u8, number.into());
                assert_eq!(is_set, (min..=max).contains(&number), "{name} {number}");
                if is_set {
                    assert_eq!(parameters.value(index as u8), Some(number as u16));
                } else {
                    assert_eq!(parameters, before, "{name} {number}");
                }
            }
            for number in [
                i32::MIN,
                i32::MIN + 500,
                -0x7FFF_0000,
                0x0002_0001,
                0x00FF_0000,
                0x7FFF_FE0C,
                i32::MAX,
            ] {
                assert!(!set(&mut parameters, index as u8, number.into()), "{name} {number}");
            }
        }
    }

    #[test]
    fn what_is_set_is_answered() {
        for (index, &(name, min, max, default)) in TABLE.iter().enumerate() {
            // Afresh, because not every number of outputs goes with every rate.
            let mut parameters = fresh();
            for number in [min, max, default, (min + max) / 2] {
                let [number, min, max, default] =
                    [number, min, max, default].map(|number| on_the_bus(index, number));
                if set(&mut parameters, index as u8, number) {
                    assert_eq!(
                        numbers(&parameters, index as u8),
                        [number, default, max, min],
                        "{name}"
                    );
                } else {
                    assert_eq!(name, "CAN_BAUDRATE", "half of the sum of its ends is no bit rate");
                }
            }
        }
    }

    #[test]
    fn the_bit_rate_is_one_of_the_board_s_in_bits_per_second() {
        let index = Parameter::CanBaudrate as u8;
        let highest =
            if crate::hardware::CAN_CRYSTAL_HZ == 8_000_000 { 500_000 } else { 1_000_000 };
        let mut parameters = fresh();
        let mut rates = vec![];
        for (rate, units) in [(125_000, 0), (250_000, 1), (500_000, 2), (1_000_000, 3)] {
            if rate > highest {
                continue;
            }
            assert!(set(&mut parameters, index, rate), "{rate}");
            assert_eq!(parameters.get(Parameter::CanBaudrate), units);
            assert_eq!(numbers(&parameters, index), [rate, highest, highest, 125_000]);
            rates.push(rate);
        }
        let before = parameters;
        for rate in (-70_000..2_100_000).chain((1..256).map(|high| 125_000 | high << 24)) {
            if !rates.contains(&rate) {
                assert!(!set(&mut parameters, index, rate), "{rate}");
            }
        }
        assert_eq!(parameters, before);
    }

    #[test]
    fn values_out_of_range_are_replaced_by_the_defaults_and_no_others() {
        for (index, &(name, min, max, default)) in TABLE.iter().enumerate() {
            // All values around the ends of each range, and some of all the others.
            let around = |end: i32| (end - 3..=end + 3).map(|number| number as u16);
            for value in (0..=u16::MAX)
                .step_by(97)
                .chain(around(min))
                .chain(around(max))
                .chain([i16::MAX as u16, u16::MAX])
            {
                let number = if min < 0 { i32::from(value as i16) } else { i32::from(value) };
                let mut parameters = fresh();
                parameters.values[index] = value.to_le_bytes();
                let is_good = (min..=max).contains(&number);
                assert_eq!(parameters.repair(InMemory), !is_good, "{name} {number}");
                let expected = if is_good { value } else { default as u16 };
                assert_eq!(parameters.value(index as u8), Some(expected), "{name} {number}");
            }
        }
    }

    #[test]
    fn every_parameter_is_found_by_its_name_and_has_it() {
        for (index, (name, ..)) in TABLE.iter().enumerate() {
            assert_eq!(Parameters::find(name.as_bytes(), InMemory), index as u8, "{name}");
            let at = name_at(index as u8, InMemory);
            let byte = |at| Progmem::<Descriptions>::byte(InMemory, at);
            assert_eq!(byte(at - 1), name.len() as u8);
            let stored: std::vec::Vec<u8> = (0..name.len() as u16).map(|n| byte(at + n)).collect();
            assert_eq!(stored, name.as_bytes());
        }
    }

    #[test]
    fn names_of_nothing_are_not_found() {
        for name in [
            "",
            "C",
            "CAN_NOD",
            "CAN_NODE ",
            "CAN_NODEX",
            "can_node",
            "OUT1_MIX",
            "SEVENTEEN_LETTERS",
            "\0",
        ] {
            assert_eq!(Parameters::find(name.as_bytes(), InMemory), NONE, "{name:?}");
        }
    }

    #[test]
    fn there_is_no_parameter_after_the_last() {
        let mut parameters = fresh();
        for index in COUNT as u8..=255 {
            assert_eq!(parameters.value(index), None);
            assert!(!set(&mut parameters, index, 0));
        }
        assert_eq!(parameters, fresh());
    }

    #[test]
    fn names_are_unique_and_those_of_ardupilot_where_it_has_one() {
        let names: std::collections::HashSet<_> = TABLE.iter().map(|entry| entry.0).collect();
        assert_eq!(names.len(), COUNT);
        for name in names {
            assert!(
                name.len() <= 16
                    && name.bytes().all(|byte| byte.is_ascii_uppercase()
                        || byte.is_ascii_digit()
                        || byte == b'_'),
                "{name}"
            );
        }
    }

    #[test]
    fn values_below_zero_come_back_below_zero() {
        let mut parameters = fresh();
        assert!(set(&mut parameters, Parameter::TempMin as u8, -55));
        assert_eq!(parameters.get(Parameter::TempMin) as i16, -55);
        assert_eq!(numbers(&parameters, Parameter::TempMin as u8), [-55, -40, 150, -55]);
    }

    #[test]
    fn a_change_is_noted_once_and_a_refusal_is_none() {
        let mut parameters = fresh();
        assert!(parameters.take_change(), "defaults are a change");
        assert!(!parameters.take_change());
        assert!(!set(&mut parameters, Parameter::Out1Min as u8, 3000));
        assert!(!parameters.take_change());
        assert!(set(&mut parameters, Parameter::Out1Min as u8, 900));
        assert!(parameters.take_change());
    }
}
