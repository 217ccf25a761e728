//! The bytes of a message or a response.

/// Up to `N` bytes. They are made in place: a copy of a response takes 60 bytes of stack.
pub struct Payload<const N: usize> {
    bytes: [u8; N],
    len: u8,
}

impl<const N: usize> Payload<N> {
    pub const EMPTY: Self = Self { bytes: [0; N], len: 0 };

    pub fn set(&mut self, part: &[u8]) {
        self.len = 0;
        self.add(part);
    }

    /// Adds bytes. What does not fit is left out.
    #[inline(never)]
    pub fn add(&mut self, part: &[u8]) {
        for byte in part {
            if let Some(place) = self.bytes.get_mut(usize::from(self.len)) {
                *place = *byte;
                self.len += 1;
            }
        }
    }

    /// Adds a whole number of 64 bits, after its tag.
    #[inline(never)]
    pub fn add_number(&mut self, number: i32) {
        self.add(&[1]);
        self.add(&number.to_le_bytes());
        self.add(&[if number < 0 { 0xFF } else { 0 }; 4]);
    }

    pub fn bytes(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or(&self.bytes)
    }
}
