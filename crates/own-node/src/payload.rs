//! The bytes of a message or a response.

use crate::Parameter;

/// Enough for a response with a name of 60 bytes.
const MAX_LEN: usize = 101;

/// Up to [`MAX_LEN`] bytes.
pub struct Payload {
    bytes: [u8; MAX_LEN],
    len: usize,
}

impl Payload {
    pub const EMPTY: Self = Self { bytes: [0; MAX_LEN], len: 0 };
    /// The response of GetSet without a parameter: value, default, maximum and minimum are nothing.
    pub const NO_PARAMETER: Self = Self { bytes: [0; MAX_LEN], len: 4 };

    /// Joins the parts. What does not fit is left out.
    pub fn new(parts: &[&[u8]]) -> Self {
        let mut payload = Self::EMPTY;
        for byte in parts.iter().copied().flatten() {
            if let Some(place) = payload.bytes.get_mut(payload.len) {
                *place = *byte;
                payload.len += 1;
            }
        }
        payload
    }

    /// The response of GetSet: value, default, maximum, minimum and name. Each number follows the
    /// tag of a whole number.
    pub fn of_parameter(parameter: &Parameter, value: i64) -> Self {
        let &Parameter { name, default, min, max } = parameter;
        let [value, default, max, min] = [value, default, max, min].map(i64::to_le_bytes);
        Self::new(&[&[1], &value, &[1], &default, &[1], &max, &[1], &min, name])
    }

    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..self.len]
    }
}
