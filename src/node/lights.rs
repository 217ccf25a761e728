//! The light.

/// The light. It has one colour, so of a command the brightest of the three counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lights {
    brightness: u8,
}

impl Lights {
    /// Dark.
    pub const fn new() -> Self {
        Self { brightness: 0 }
    }

    /// 0 is off, 255 full.
    pub fn brightness(&self) -> u8 {
        self.brightness
    }

    /// Takes the entry of a LightsCommand for this light: its ID, and five bits of red, six of green and five of blue (DSDL
    /// uavcan/equipment/indication/RGB565.uavcan). Anything else is no entry.
    pub fn take(&mut self, entry: &[u8]) {
        let &[_, high, low] = entry else { return };
        let red = high & 0xF8;
        let green = high << 5 | (low & 0xE0) >> 3;
        let blue = low << 3;
        let brightest = red.max(green).max(blue);
        // All bits set where the five or six are.
        self.brightness = brightest | brightest >> 5;
    }
}

impl Default for Lights {
    fn default() -> Self {
        Self::new()
    }
}
