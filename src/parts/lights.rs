//! The light that LightsCommand sets.

use dronecan_wire::Slot;

use crate::tables::parameters::{Parameter, Parameters};

/// The light. It has one colour; its brightness is that of the brightest of the three colours in a
/// command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lights {
    /// LIGHT_ID.
    id: u8,
    brightness: u8,
}

impl Lights {
    /// A light that is off.
    pub const fn new() -> Self {
        Self { id: 0, brightness: 0 }
    }

    /// Applies LIGHT_ID.
    pub fn update(&mut self, parameters: &Parameters) {
        self.id = parameters.get(Parameter::LightId) as u8;
    }

    /// The slot in which the receiver keeps an entry with this ID.
    pub fn slot_of(&self, id: u8) -> Option<Slot> {
        (id == self.id).then_some(Slot::new(0))
    }

    /// The brightness: 0 is off, 255 is full.
    pub fn brightness(&self) -> u8 {
        self.brightness
    }

    /// Acts on the entry of a LightsCommand for this light: its ID, then five bits of red, six of
    /// green and five of blue (DSDL uavcan/equipment/indication/RGB565.uavcan). Ignores an
    /// entry of any other length.
    pub fn act_on_command(&mut self, entry: &[u8]) {
        let &[_, high, low] = entry else { return };
        let red = high & 0xF8;
        let green = high << 5 | (low & 0xE0) >> 3;
        let blue = low << 3;
        let brightest = red.max(green).max(blue);
        // Fills the low bits, so that full colour is 255.
        self.brightness = brightest | brightest >> 5;
    }
}
