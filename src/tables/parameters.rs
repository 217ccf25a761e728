//! The parameters that can be set over the bus: names, ranges and defaults (docs/parameters.md).

use crate::hardware::{HAS_ESCS, OUTPUTS, SLOT_US};
use crate::tables::bit_rate::{HIGHEST_RATE, LOWEST};
#[allow(unused_imports, reason = "a build may have no masks")]
use crate::tables::condition::{CRIT_MASK, ERROR_MASK, WARN_MASK};
#[allow(unused_imports, reason = "a build may have no OUTn_TYPE")]
use crate::tables::output_kinds::GREATEST_TYPE;
pub use descriptions::*;
pub use timing::{Conflict, Layout};
pub use values::Parameters;

mod descriptions;
mod timing;
mod values;

/// The default of TEMP_SLOPE, that of an LM35; without the feature `sensors` its value.
pub const TEMP_SLOPE: u16 = 100;

/// The lowest CAN_NODE.
const LOWEST_ID: i32 = if cfg!(feature = "allocation") { 0 } else { 1 };

/// Name, minimum, maximum and default of a parameter.
type Row = (&'static str, i32, i32, i32);

/// A table of groups: `if condition { rows }`.
macro_rules! parameters {
    ($(if $if:meta {
        $($(#[doc = $doc:literal])*
        $id:ident $name:literal $min:tt .. $max:tt = $default:expr,)*
    })*) => {
        /// A parameter that the node has once. The constants here are the only values; those of a
        /// part that the build leaves out are no parameter, and have the value 0.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct Parameter(u8);

        numbered! { Parameter, Self(NONE); $(if $if { $($(#[doc = $doc])* $id;)* })* }

        /// The parameters of [`Parameter`].
        const SINGLE: &[Row] = &[$($(#[cfg($if)] ($name, $min, $max, $default),)*)*];
    };
}

/// The parameters of an output, as `parameters!`. The default of a row `= n` is the number of the
/// output.
macro_rules! output_parameters {
    ($(if $if:meta {
        $($(#[doc = $doc:literal])* $id:ident $name:literal $min:literal .. $max:tt = $default:tt,)*
    })*) => {
        /// A parameter that each output has. As [`Parameter`].
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct OutputParameter(u8);

        numbered! { OutputParameter, Self(NONE); $(if $if { $($(#[doc = $doc])* $id;)* })* }

        /// The parameters of an output. Their names follow `OUTn_`.
        const TEMPLATE: &[Row] =
            &[$($(#[cfg($if)] ($name, $min, $max, output_parameters!(@$default)),)*)*];
    };
    (@n) => { 1 };
    (@$default:literal) => { $default };
}

parameters! {
    if all() {
        /// The node ID; with the feature `allocation` 0 requests one from an allocator. Without it
        /// a node with ID 0 would never be heard again.
        CanNode "CAN_NODE" (LOWEST_ID)..125 = 120,
        /// Bit rate: see [`bit_rate`](crate::tables::bit_rate). On the bus it is in bit/s. The
        /// default is the highest rate of the CAN board.
        CanBaudrate "CAN_BAUDRATE" (LOWEST)..HIGHEST_RATE = (HIGHEST_RATE),
        /// Pulses a second.
        OutRate "OUT_RATE" 50..333 = 50,
        /// Rate of device.Temperature, in messages a second.
        TempRate "TEMP_RATE" 0..50 = 1,
        /// The device ID of the temperature sensor.
        TempId "TEMP_ID" 0..65535 = 1,
        /// The temperature sensor: 0 there is none, 1 if it is found, 2 it is required.
        TempSensor "TEMP_SENSOR" 0..2 = 1,
    }
    if feature = "sensors" {
        /// The reference voltage of the ADC: 0 is 5 V, 1 is 1.1 V.
        TempRef "TEMP_REF" 0..1 = 0,
        /// Voltage of the sensor at 0 degrees Celsius, in millivolts.
        TempOffset "TEMP_OFFSET" (-500)..1500 = 0,
        /// Slope of the sensor, in tenths of a millivolt per kelvin.
        TempSlope "TEMP_SLOPE" 10..500 = (TEMP_SLOPE as i32),
    }
    if all() {
        /// Lower limit of the temperature, in degrees Celsius.
        TempMin "TEMP_MIN" (-55)..150 = -40,
        /// Upper limit of the temperature, in degrees Celsius.
        TempMax "TEMP_MAX" (-55)..150 = 85,
    }
    if feature = "masks" {
        /// Conditions that make the health WARNING.
        WarnMask "WARN_MASK" 0..65535 = (WARN_MASK as i32),
        /// Conditions that make the health ERROR.
        ErrorMask "ERROR_MASK" 0..65535 = (ERROR_MASK as i32),
        /// Conditions that make the health CRITICAL.
        CritMask "CRIT_MASK" 0..65535 = (CRIT_MASK as i32),
    }
    if feature = "standard" {
        /// 1 follows commands only while the vehicle is armed.
        ArmReq "ARM_REQ" 0..1 = 0,
        /// Rate of actuator.Status, in messages a second.
        TelemRate "TELEM_RATE" 0..50 = 10,
    }
    if feature = "lights" {
        /// The ID of the light.
        LightId "LIGHT_ID" 0..255 = 0,
    }
    if feature = "stats" {
        /// Rate of CanStats, in messages a second.
        StatsRate "STATS_RATE" 0..10 = 0,
    }
    if feature = "safety" {
        /// What the output does while the safety switch is on: 0 holds the pulse, 1 ends the
        /// pulses.
        SafeMode "SAFE_MODE" 0..1 = 1,
    }
    if feature = "outputs" {
        /// Outputs in use.
        OutCount "OUT_COUNT" 1..8 = 1,
        /// 1 gives motors the pulse OUTn_MIN from the first esc.RawCommand on, also while the
        /// vehicle is disarmed; 0 gives no pulse before it is armed.
        MotIdle "MOT_IDLE" 0..1 = 1,
        /// Time without a command until a motor stops, in milliseconds.
        MotTimeout "MOT_TIMEOUT" 50..10000 = 200,
    }
    if feature = "escs" {
        /// The pulses of motors: 1 and 2 as wide as a servo's, 3 an eighth of that, OneShot125.
        EscPwmType "ESC_PWM_TYPE" 1..3 = 1,
        /// Pulses of a motor a second, if all outputs in use are motors.
        EscRate "ESC_RATE" 50..400 = 50,
    }
    if feature = "power" {
        /// Rate of CircuitStatus, in messages a second; 0 does not measure the circuit.
        PwrRate "PWR_RATE" 0..50 = 0,
        /// The ID of the circuit.
        Pwr1Id "PWR1_ID" 0..65535 = 1,
        /// Volts of the circuit for a volt at the pin, in thousandths: 11000 for a divider of 10
        /// and 1 kOhm.
        Pwr1VoltMult "PWR1_VOLT_MULT" 100..65535 = 1000,
        /// Voltage at the pin for a circuit of 0 V, in millivolts.
        Pwr1VoltOfs "PWR1_VOLT_OFS" (-1000)..1000 = 0,
        /// Amperes for a volt at the pin, in hundredths.
        Pwr1AmpPervlt "PWR1_AMP_PERVLT" 1..65535 = 1000,
        /// Voltage at the pin without a current, in millivolts.
        Pwr1AmpOffset "PWR1_AMP_OFFSET" (-1000)..5000 = 0,
        /// Lower limit of the voltage, in millivolts; 0 is none.
        Pwr1VoltMin "PWR1_VOLT_MIN" 0..65535 = 0,
        /// Upper limit of the voltage, in millivolts; 0 is none.
        Pwr1VoltMax "PWR1_VOLT_MAX" 0..65535 = 0,
        /// Upper limit of the current, in hundredths of an ampere; 0 is none.
        Pwr1AmpMax "PWR1_AMP_MAX" 0..32767 = 0,
        /// The output that the circuit feeds, whose actuator.Status has the current in percent of
        /// PWR1_AMP_MAX; 0 is none.
        Pwr1Out "PWR1_OUT" 0..8 = 0,
    }
    if feature = "relay" {
        /// Rate of hardpoint.Status, in messages a second.
        RelayRate "RELAY_RATE" 0..10 = 1,
        /// Relays that hold at the start, and after RELAY_TIMEOUT: bit 0 is output 1.
        RelayStart "RELAY_START" 0..255 = 0,
        /// Time without a hardpoint.Command for a relay until it goes to its state of RELAY_START,
        /// in seconds; 0 is never.
        RelayTimeout "RELAY_TIMEOUT" 0..255 = 0,
    }
    if feature = "battery" {
        /// Rate of BatteryInfo, in messages a second.
        BattRate "BATT_RATE" 0..10 = 0,
        /// The ID of the battery.
        BattId "BATT_ID" 0..255 = 0,
        /// The charge of the full battery, in mAh; 0 is unknown.
        BattCapacity "BATT_CAPACITY" 0..65535 = 0,
        /// 1 if the temperature sensor is at the battery.
        BattTemp "BATT_TEMP" 0..1 = 0,
    }
    if feature = "rpm" {
        /// Rate of sensors.rpm.RPM, in messages a second; 0 does not count pulses.
        RpmRate "RPM_RATE" 0..50 = 0,
        /// The ID of the sensor.
        RpmId "RPM_ID" 0..255 = 0,
        /// Pulses in a revolution of the shaft.
        RpmPulses "RPM_PULSES" 1..255 = 1,
    }
}

/// The longest pulse, in microseconds. Between the end of a pulse and the pulse of the next output
/// there has to be a pause. The pulse of a single output may be as long as a slot.
const LONGEST_PULSE_US: i32 = SLOT_US as i32 - if OUTPUTS == 1 { 0 } else { 100 };

output_parameters! {
    if all() {
        /// The actuator ID of a servo, or the index of a motor's command.
        Id "ID" 0..255 = n,
        /// One end of the travel, in microseconds.
        Min "MIN" 500..LONGEST_PULSE_US = 1000,
        /// The pulse for no deflection, in microseconds.
        Trim "TRIM" 500..LONGEST_PULSE_US = 1500,
        /// The other end of the travel, in microseconds.
        Max "MAX" 500..LONGEST_PULSE_US = 2000,
        /// 1 reverses the direction.
        Reversed "REVERSED" 0..1 = 0,
        /// The whole travel in degrees, for position commands.
        Range "RANGE" 10..360 = 90,
        /// Time without a command until the failsafe, in milliseconds; 0 disables it.
        Timeout "TIMEOUT" 0..10000 = 1000,
        /// The failsafe: 0 holds the pulse, 1 goes to the trim, 2 to OUTn_FS_PWM, 3 ends the
        /// pulses.
        Fs "FS" 0..3 = 0,
        /// The pulse for OUTn_FS 2, in microseconds.
        FsPwm "FS_PWM" 500..LONGEST_PULSE_US = 1500,
    }
    if feature = "outputs" {
        /// 0 is a servo, which follows ArrayCommand, 1 a motor, which follows esc.RawCommand, 2 a
        /// relay, which follows hardpoint.Command.
        Type "TYPE" 0..GREATEST_TYPE = 0,
    }
}

/// An index that no parameter has.
pub const NONE: u8 = 0xFF;

/// The rows in flash: those of [`SINGLE`], then those of [`TEMPLATE`].
const ROWS: usize = SINGLE.len() + TEMPLATE.len();

/// A row of the table in flash.
const fn row(n: usize) -> Row {
    if n < SINGLE.len() { SINGLE[n] } else { TEMPLATE[n - SINGLE.len()] }
}

/// The number of parameters: those of [`SINGLE`], then those of each output.
pub const COUNT: usize = SINGLE.len() + OUTPUTS * TEMPLATE.len();

const _: () = assert!(COUNT <= NONE as usize);

impl Parameter {
    /// True if the build has the parameter.
    pub const fn is_built(self) -> bool {
        self.0 != NONE
    }

    /// The index of the parameter on the bus; [`NONE`] if the build leaves it out.
    pub const fn index(self) -> u8 {
        self.0
    }
}

impl OutputParameter {
    /// This parameter of an output, counted from 0.
    pub const fn of(self, output: usize) -> Parameter {
        Parameter(self.index(output))
    }

    /// The index of this parameter of an output, counted from 0; [`NONE`] if the build leaves it
    /// out.
    pub const fn index(self, output: usize) -> u8 {
        if self.0 == NONE {
            return NONE;
        }
        let before = if OUTPUTS == 1 { 0 } else { output * TEMPLATE.len() };
        (SINGLE.len() + before) as u8 + self.0
    }
}

/// True if the flash has the names of the outputs' parameters without their `OUTn_`, once for all
/// outputs. The names of a single output are complete.
const HAS_PREFIX: bool = OUTPUTS > 1;

/// Where a parameter is: the row in flash, and the output from 1; 0 for one of [`SINGLE`], and for
/// those of a single output.
#[derive(Clone, Copy)]
struct At {
    row: u8,
    output: u8,
}

/// The row in flash of the parameter with this index, and the output whose `OUTn_` goes before its
/// name there, from 1; 0 for none.
pub fn row_and_output(index: u8) -> (u8, u8) {
    let At { row, output } = At::new(index);
    (row, output)
}

/// True if the parameter with this index says what an output is, or which pulses motors have:
/// OUT_COUNT, OUTn_TYPE, OUTn_ID, ESC_PWM_TYPE or ESC_RATE.
pub fn is_of_outputs(index: u8) -> bool {
    let row = At::new(index).row;
    row == Parameter::OutCount.index()
        || HAS_ESCS && row == Parameter::EscPwmType.index()
        || HAS_ESCS && row == Parameter::EscRate.index()
        || row == OutputParameter::Type.index(0)
        || row == OutputParameter::Id.index(0)
}

impl At {
    #[inline(never)]
    fn new(index: u8) -> Self {
        let mut at = Self { row: index, output: 0 };
        if HAS_PREFIX && at.row >= SINGLE.len() as u8 {
            at.output = 1;
            while at.row >= ROWS as u8 {
                at.row -= TEMPLATE.len() as u8;
                at.output += 1;
            }
        }
        at
    }

    /// What the default is above that in flash: OUTn_ID has the number of the output.
    fn above_default(self) -> u16 {
        if HAS_PREFIX && self.row == SINGLE.len() as u8 + OutputParameter::Id.0 {
            u16::from(self.output - 1)
        } else {
            0
        }
    }
}

#[cfg(test)]
mod tests;
