//! The light that LightsCommand sets.

/// The light. It has one colour; its brightness is that of the brightest of the three colours in a
/// command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lights {
    brightness: u8,
}

impl Lights {
    /// A light that is off.
    pub const fn new() -> Self {
        Self { brightness: 0 }
    }

    /// The brightness: 0 is off, 255 is full.
    pub fn brightness(&self) -> u8 {
        self.brightness
    }

    /// Takes the entry of a LightsCommand for this light: its ID, then five bits of red, six of
    /// green and five of blue (DSDL uavcan/equipment/indication/RGB565.uavcan). Ignores an
    /// entry of any other length.
    pub fn take(&mut self, entry: &[u8]) {
        let &[_, high, low] = entry else { return };
        let red = high & 0xF8;
        let green = high << 5 | (low & 0xE0) >> 3;
        let blue = low << 3;
        let brightest = red.max(green).max(blue);
        // Fills the low bits, so that full colour is 255.
        self.brightness = brightest | brightest >> 5;
    }
}

impl Default for Lights {
    fn default() -> Self {
        Self::new()
    }
}
