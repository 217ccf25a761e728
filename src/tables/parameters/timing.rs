//! When the outputs have their pulses: what OUT_COUNT, OUT_RATE, ESC_RATE, ESC_PWM_TYPE and the
//! types of the outputs ask for.

use super::{OutputParameter, Parameter, Parameters};
use crate::hardware::{HAS_ESCS, OUTPUTS, SLOT_US};

/// How the pulses of several outputs lie in a period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// One after the other, each in a slot of its own.
    Slots,
    /// At the same time, the shortest first. For at most four motors.
    Overlapping,
    /// OneShot125: an eighth of a servo's pulse. Each begins when the one before it ends.
    Chain,
}

/// Why values of parameters do not go together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Conflict {
    /// The pulses of so many outputs have no room in a period.
    NoRoom,
    /// A servo is in use, and motors should have pulses that it must not have.
    Servo,
}

/// Widths in ticks of half a microsecond.
impl Layout {
    /// The longest pulse of [`Layout::Overlapping`]: 2,000 us.
    pub const LONGEST_OVERLAPPING: u16 = 4000;
    /// The shortest and the longest pulse of OneShot125: 125 and 250 us.
    pub const SHORTEST_ONESHOT125: u16 = 250;
    /// See [`SHORTEST_ONESHOT125`](Self::SHORTEST_ONESHOT125).
    pub const LONGEST_ONESHOT125: u16 = 500;

    /// The width that an output has for a pulse of this width; 0 is no pulse.
    pub fn width(self, pulse: u16) -> u16 {
        match self {
            _ if !HAS_ESCS || pulse == 0 => pulse,
            Self::Slots => pulse,
            Self::Overlapping => pulse.min(Self::LONGEST_OVERLAPPING),
            Self::Chain => {
                ((pulse + 4) / 8).clamp(Self::SHORTEST_ONESHOT125, Self::LONGEST_ONESHOT125)
            }
        }
    }
}

/// OUTn_TYPE of a motor.
const MOTOR: u16 = 1;
/// ESC_PWM_TYPE of OneShot125.
const ONESHOT125: u8 = 3;
/// The least ESC_RATE, and its default.
const LEAST_RATE_HZ: u16 = 50;
/// Motors whose pulses may overlap: 100 us from each edge to the next.
const MOST_OVERLAPPING: u8 = 4;
/// Slots in a second.
const SLOTS_PER_S: u16 = (1_000_000 / SLOT_US) as u16;

impl Parameters {
    /// True if all outputs in use are motors.
    #[inline(never)]
    fn has_motors_only(&self) -> bool {
        (0..self.get(Parameter::OutCount) as u8)
            .all(|output| self.of(output.into(), OutputParameter::Type) == MOTOR)
    }

    /// Pulses of each output a second.
    pub fn rate_hz(&self) -> u16 {
        let is_of_motors = HAS_ESCS && self.has_motors_only();
        self.get(if is_of_motors { Parameter::EscRate } else { Parameter::OutRate })
    }

    /// How the pulses lie in a period, or why the values do not go together.
    #[inline(never)]
    fn asked_layout(&self) -> Result<Layout, Conflict> {
        let count = self.get(Parameter::OutCount) as u8;
        let is_oneshot125 = self.get(Parameter::EscPwmType) as u8 == ONESHOT125;
        let has_motors_only = HAS_ESCS && self.has_motors_only();
        if HAS_ESCS && (is_oneshot125 || self.get(Parameter::EscRate) != LEAST_RATE_HZ) {
            if !has_motors_only {
                return Err(Conflict::Servo);
            }
            if is_oneshot125 {
                return Ok(Layout::Chain);
            }
        }
        // The pulse of a single output needs no slot. A count out of the range is refused anyway.
        if count == 1 || u16::from(count).wrapping_mul(self.rate_hz()) <= SLOTS_PER_S {
            Ok(Layout::Slots)
        } else if has_motors_only && count <= MOST_OVERLAPPING {
            Ok(Layout::Overlapping)
        } else {
            Err(Conflict::NoRoom)
        }
    }

    /// How the pulses lie in a period.
    pub fn layout(&self) -> Layout {
        self.asked_layout().unwrap_or(Layout::Slots)
    }

    /// The number of outputs in use: one if the EEPROM had values that do not go together.
    pub fn outputs(&self) -> u8 {
        if OUTPUTS == 1 || self.asked_layout().is_err() {
            return 1;
        }
        self.get(Parameter::OutCount) as u8
    }

    /// Why a value in the range of the parameter with this index does not go with the values in
    /// force. `None` if it does.
    pub(crate) fn conflict(&mut self, index: u8, value: u16) -> Option<Conflict> {
        if OUTPUTS == 1 {
            return None;
        }
        let place = self.values.get_mut(usize::from(index))?;
        let before = core::mem::replace(place, value.to_le_bytes());
        let conflict = self.asked_layout().err();
        self.values[usize::from(index)] = before;
        conflict
    }
}

#[cfg(all(test, feature = "escs"))]
mod tests {
    use super::*;
    use crate::image::InMemory;

    /// Parameters with so many outputs, all motors, and these values.
    fn motors(count: i32, pwm_type: i32, rate_hz: i32) -> Option<Parameters> {
        let mut parameters = Parameters::new();
        parameters.set_defaults(InMemory);
        for output in 0..OUTPUTS {
            assert!(parameters.set(OutputParameter::Type.index(output), 1, InMemory));
        }
        let values = [
            (Parameter::OutCount, count),
            (Parameter::EscPwmType, pwm_type),
            (Parameter::EscRate, rate_hz),
        ];
        let is_set = values.map(|(name, value)| parameters.set(name.index(), value, InMemory));
        is_set.iter().all(|is_set| *is_set).then_some(parameters)
    }

    #[test]
    fn so_many_motors_have_these_layouts() {
        for (count, pwm_type, rate_hz, layout) in [
            (1, 1, 400, Some(Layout::Slots)),
            (1, 3, 400, Some(Layout::Chain)),
            (2, 1, 200, Some(Layout::Slots)),
            (2, 1, 201, Some(Layout::Overlapping)),
            (4, 1, 100, Some(Layout::Slots)),
            (4, 2, 400, Some(Layout::Overlapping)),
            (5, 1, 80, Some(Layout::Slots)),
            (5, 1, 81, None),
            (8, 1, 50, Some(Layout::Slots)),
            (8, 3, 50, Some(Layout::Chain)),
            (8, 3, 400, Some(Layout::Chain)),
        ] {
            let parameters = motors(count, pwm_type, rate_hz);
            assert_eq!(parameters.map(|parameters| parameters.layout()), layout, "{count}");
            if let Some(parameters) = motors(count, pwm_type, rate_hz) {
                assert_eq!(parameters.outputs(), count as u8);
                assert_eq!(parameters.rate_hz(), rate_hz as u16);
            }
        }
    }

    #[test]
    fn a_servo_takes_the_rate_of_servos_and_refuses_other_pulses() {
        let mut parameters = motors(4, 1, 50).unwrap();
        let type_of_third = OutputParameter::Type.index(2);
        assert!(parameters.set(type_of_third, 0, InMemory));
        assert!(parameters.set(Parameter::OutRate.index(), 100, InMemory));
        assert_eq!(parameters.rate_hz(), 100);
        assert_eq!(parameters.conflict(Parameter::EscRate.index(), 60), Some(Conflict::Servo));
        assert_eq!(parameters.conflict(Parameter::EscPwmType.index(), 3), Some(Conflict::Servo));
        assert_eq!(parameters.conflict(Parameter::OutRate.index(), 101), Some(Conflict::NoRoom));
        let mut fast = motors(4, 1, 400).unwrap();
        assert_eq!(fast.conflict(type_of_third, 0), Some(Conflict::Servo));
        assert_eq!(fast.conflict(Parameter::OutCount.index(), 5), Some(Conflict::NoRoom));
        assert_eq!(fast.conflict(Parameter::OutCount.index(), 3), None);
    }
}
