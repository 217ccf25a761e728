//! The draft's param.GetSet. Requests and responses have the same meaning as in v0, but other
//! bytes.
//!
//! ```text
//! Value    : list of up to one bool, of up to one int64, one float32, one string of up to 63
//!            bytes; each list after its length
//! request  : Value, index u8, name
//! response : Value, default Value, maximum Value, minimum Value, name
//! ```
//! If several lists have a value, the first is used; if none has, the Value is empty. The layout is
//! the one with signature 0xDD4BB39E5963C2C1.

use crate::bits::{Reader, Writer};
use crate::management::{ParameterRequest, ParameterResponse, Value};

/// Width of the length of a list of at most one element, and of a string.
const LIST_LEN_BITS: u32 = 1;
const TEXT_LEN_BITS: u32 = 6;
/// Maximum length of a string in a Value.
const TEXT_MAX: usize = 63;
/// Maximum length of a parameter's name.
const NAME_MAX: usize = 92;

fn put_value(bits: &mut Writer, value: &Value) {
    let is = |given: bool| u64::from(given);
    bits.put(is(matches!(value, Value::Boolean(_))), LIST_LEN_BITS);
    if let Value::Boolean(boolean) = value {
        bits.put(u64::from(*boolean), 1);
    }
    bits.put(is(matches!(value, Value::Integer(_))), LIST_LEN_BITS);
    if let Value::Integer(number) = value {
        bits.put(*number as u64, 64);
    }
    bits.put(is(matches!(value, Value::Real(_))), LIST_LEN_BITS);
    if let Value::Real(number) = value {
        bits.put(u64::from(number.to_bits()), 32);
    }
    bits.put(is(matches!(value, Value::Text(_))), LIST_LEN_BITS);
    if let Value::Text(text) = value {
        let text = &text[..text.len().min(TEXT_MAX)];
        bits.put(text.len() as u64, TEXT_LEN_BITS);
        bits.put_bytes(text);
    }
}

fn take_value(bits: &mut Reader<'_>) -> Option<Value> {
    let mut found = Vec::new();
    if bits.take(LIST_LEN_BITS)? != 0 {
        found.push(Value::Boolean(bits.take(1)? != 0));
    }
    if bits.take(LIST_LEN_BITS)? != 0 {
        found.push(Value::Integer(bits.take(64)? as i64));
    }
    if bits.take(LIST_LEN_BITS)? != 0 {
        found.push(Value::Real(f32::from_bits(bits.take(32)? as u32)));
    }
    if bits.take(LIST_LEN_BITS)? != 0 {
        let len = bits.take(TEXT_LEN_BITS)? as usize;
        found.push(Value::Text(bits.take_bytes(len)?));
    }
    Some(found.into_iter().next().unwrap_or_default())
}

fn take_name(mut bits: Reader<'_>) -> Option<Vec<u8>> {
    Some(bits.rest()).filter(|name| name.len() <= NAME_MAX)
}

/// `None` if the payload is too short or the name too long.
pub fn decode_request(payload: &[u8]) -> Option<ParameterRequest> {
    let mut bits = Reader::new(payload);
    let value = take_value(&mut bits)?;
    let index = bits.take(8)? as u16;
    Some(ParameterRequest { index, value, name: take_name(bits)? })
}

/// Encodes the request with the low eight bits of the index.
pub fn encode_request(request: &ParameterRequest) -> Vec<u8> {
    let mut bits = Writer::default();
    put_value(&mut bits, &request.value);
    bits.put(u64::from(request.index), 8);
    bits.put_bytes(&request.name);
    bits.into_bytes()
}

/// `None` if the payload is too short or the name too long.
pub fn decode_response(payload: &[u8]) -> Option<ParameterResponse> {
    let mut bits = Reader::new(payload);
    let mut value = || take_value(&mut bits);
    let (value, default, max, min) = (value()?, value()?, value()?, value()?);
    Some(ParameterResponse { value, default, max, min, name: take_name(bits)? })
}

/// Encodes the response.
pub fn encode_response(response: &ParameterResponse) -> Vec<u8> {
    let mut bits = Writer::default();
    for value in [&response.value, &response.default, &response.max, &response.min] {
        put_value(&mut bits, value);
    }
    bits.put_bytes(&response.name);
    bits.into_bytes()
}
