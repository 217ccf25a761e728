//! Payloads of the services that manage a node: information, parameters, restart, update, counters.
//!
//! Layouts from the public DSDL (uavcan/protocol and uavcan/protocol/param), little endian. Every
//! field begins at a byte boundary; void bits precede fields that are shorter than a byte.

use super::bits::{Reader, Writer};
use super::fields::{Field, decode, encode, payload};
use super::id::UNIQUE_ID_LEN;
use super::status::NodeStatus;
use super::text::hex;
use std::fmt;

fn text(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| byte.escape_ascii().to_string()).collect()
}

/// Removes the first `N` bytes.
fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (front, rest) = bytes.split_first_chunk()?;
    *bytes = rest;
    Some(*front)
}

fn byte(bytes: &mut &[u8]) -> Option<u8> {
    take::<1>(bytes).map(|[byte]| byte)
}

/// protocol.GetNodeInfo, response: `NodeStatus | SoftwareVersion | HardwareVersion | name`. All but
/// the status is the same in both dialects.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NodeInfo<S = NodeStatus> {
    pub status: S,
    pub software: (u8, u8),
    /// The commit from which the software was built.
    pub commit: Option<u32>,
    pub image_crc: Option<u64>,
    pub hardware: (u8, u8),
    pub unique_id: [u8; UNIQUE_ID_LEN],
    pub certificate: Vec<u8>,
    pub name: Vec<u8>,
}

const FLAG_COMMIT: u8 = 1 << 0;
const FLAG_CRC: u8 = 1 << 1;

impl<S: Field> NodeInfo<S> {
    /// `None` if the payload is too short.
    pub fn decode(payload: &[u8]) -> Option<NodeInfo<S>> {
        let mut bits = Reader::new(payload);
        let status = S::take(&mut bits, S::BITS)?;
        let rest = &mut &bits.rest()[..];
        let software = (byte(rest)?, byte(rest)?);
        let flags = byte(rest)?;
        let commit = u32::from_le_bytes(take(rest)?);
        let image_crc = u64::from_le_bytes(take(rest)?);
        let hardware = (byte(rest)?, byte(rest)?);
        let unique_id = take(rest)?;
        let certificate_len = usize::from(byte(rest)?);
        let (certificate, name) = rest.split_at_checked(certificate_len)?;
        Some(NodeInfo {
            status,
            software,
            commit: (flags & FLAG_COMMIT != 0).then_some(commit),
            image_crc: (flags & FLAG_CRC != 0).then_some(image_crc),
            hardware,
            unique_id,
            certificate: certificate.to_vec(),
            name: name.to_vec(),
        })
    }

    /// The payload.
    pub fn encode(&self) -> Vec<u8> {
        let mut payload = encode(&self.status);
        payload.extend([self.software.0, self.software.1]);
        let flag = |given: bool, flag: u8| if given { flag } else { 0 };
        payload.push(
            flag(self.commit.is_some(), FLAG_COMMIT) | flag(self.image_crc.is_some(), FLAG_CRC),
        );
        payload.extend(self.commit.unwrap_or(0).to_le_bytes());
        payload.extend(self.image_crc.unwrap_or(0).to_le_bytes());
        payload.extend([self.hardware.0, self.hardware.1]);
        payload.extend(self.unique_id);
        payload.push(self.certificate.len() as u8);
        payload.extend(&self.certificate);
        payload.extend(&self.name);
        payload
    }
}

impl<S> NodeInfo<S> {
    /// The name as text.
    pub fn name(&self) -> String {
        text(&self.name)
    }
}

impl<S> fmt::Display for NodeInfo<S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} software {}.{}", self.name(), self.software.0, self.software.1)?;
        if let Some(commit) = self.commit {
            write!(f, " commit {commit:08x}")?;
        }
        write!(
            f,
            " hardware {}.{} unique ID {}",
            self.hardware.0,
            self.hardware.1,
            hex(&self.unique_id)
        )
    }
}

/// protocol.param.Value and NumericValue: a tag, and what it says. That of a NumericValue has
/// two bits.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Value {
    #[default]
    Empty,
    Integer(i64),
    Real(f32),
    Boolean(bool),
    Text(Vec<u8>),
}

impl Field for Value {
    const BITS: u32 = 3;

    fn take(from: &mut Reader<'_>, bits: u32) -> Option<Value> {
        Some(match from.take(bits)? {
            0 => Value::Empty,
            1 => Value::Integer(from.take(64)? as i64),
            2 => Value::Real(f32::take(from, 32)?),
            3 => Value::Boolean(bool::take(from, 8)?),
            4 => {
                let len = from.take(8)? as usize;
                Value::Text(from.take_bytes(len)?)
            }
            _ => return None,
        })
    }

    fn put(&self, to: &mut Writer, bits: u32) {
        let mut tag = |number| to.put(number, bits);
        match self {
            Value::Empty => tag(0),
            Value::Integer(number) => {
                tag(1);
                to.put(*number as u64, 64);
            }
            Value::Real(number) => {
                tag(2);
                number.put(to, 32);
            }
            Value::Boolean(boolean) => {
                tag(3);
                boolean.put(to, 8);
            }
            Value::Text(text) => {
                tag(4);
                to.put(text.len() as u64, 8);
                to.put_bytes(text);
            }
        }
    }
}

impl Value {
    /// True if there is no value.
    pub fn is_empty(&self) -> bool {
        *self == Value::Empty
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Value::Empty => write!(f, "-"),
            Value::Integer(number) => write!(f, "{number}"),
            Value::Real(number) => write!(f, "{number:?}"),
            Value::Boolean(boolean) => write!(f, "{boolean}"),
            Value::Text(bytes) => write!(f, "\"{}\"", text(bytes)),
        }
    }
}

payload! {
    /// protocol.param.GetSet, request. If there is a name, it is used and not the index. An empty
    /// value only reads.
    #[derive(Clone, Debug, Default, PartialEq)]
    pub struct ParameterRequest {
        pub index: u16 as 13,
        pub value: Value,
        pub name: Vec<u8>,
    }
}

impl fmt::Display for ParameterRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.name.is_empty() {
            write!(f, "index {}", self.index)?;
        } else {
            write!(f, "{}", text(&self.name))?;
        }
        if self.value.is_empty() { Ok(()) } else { write!(f, " = {}", self.value) }
    }
}

payload! {
    /// protocol.param.GetSet, response. All are empty if the parameter does not exist.
    #[derive(Clone, Debug, Default, PartialEq)]
    pub struct ParameterResponse {
        void 5,
        pub value: Value,
        void 5,
        pub default: Value,
        void 6,
        pub max: Value as 2,
        void 6,
        pub min: Value as 2,
        pub name: Vec<u8>,
    }
}

impl ParameterResponse {
    /// The name as text.
    pub fn name(&self) -> String {
        text(&self.name)
    }
}

impl fmt::Display for ParameterResponse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.name.is_empty() && self.value.is_empty() {
            return write!(f, "no such parameter");
        }
        write!(f, "{} = {}", self.name(), self.value)?;
        match (&self.min, &self.max, &self.default) {
            (Value::Empty, Value::Empty, Value::Empty) => Ok(()),
            (min, max, default) => write!(f, " ({min} to {max}, default {default})"),
        }
    }
}

/// protocol.param.ExecuteOpcode, request: `opcode u8 | argument i48`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Opcode(pub u8);

impl Opcode {
    pub const SAVE: Opcode = Opcode(0);
    pub const ERASE: Opcode = Opcode(1);
    const LEN: usize = 7;

    /// `None` unless the payload has seven bytes. The argument has no meaning.
    pub fn decode(payload: &[u8]) -> Option<Opcode> {
        (payload.len() == Opcode::LEN).then(|| Opcode(payload[0]))
    }

    /// The payload.
    pub fn encode(&self) -> Vec<u8> {
        let mut payload = vec![self.0];
        payload.resize(Opcode::LEN, 0);
        payload
    }
}

impl fmt::Display for Opcode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Opcode::SAVE => f.pad("SAVE"),
            Opcode::ERASE => f.pad("ERASE"),
            Opcode(other) => write!(f, "opcode {other}"),
        }
    }
}

/// The bit "ok" of a response: the most significant bit of its last byte.
const OK: u8 = 1 << 7;

/// protocol.param.ExecuteOpcode, response: `argument i48 | ok bool`. True if the opcode was
/// executed.
pub(crate) fn decode_executed(payload: &[u8]) -> Option<bool> {
    (payload.len() == Opcode::LEN).then(|| payload[Opcode::LEN - 1] & OK != 0)
}

/// Encodes the response.
pub(crate) fn encode_executed(ok: &bool) -> Vec<u8> {
    let mut payload = vec![0; Opcode::LEN];
    payload[Opcode::LEN - 1] = if *ok { OK } else { 0 };
    payload
}

/// protocol.RestartNode, request: the magic number, in five bytes.
pub const RESTART_MAGIC: u64 = 0xAC_CE55_1B1E;

/// Writes a wrong magic number, and nothing for the right one.
pub(crate) fn write_magic(f: &mut fmt::Formatter<'_>, magic: &u64) -> fmt::Result {
    if *magic == RESTART_MAGIC { Ok(()) } else { write!(f, " with the wrong number {magic:#012X}") }
}

/// Writes "ok" or "FAILED".
pub(crate) fn write_ok(f: &mut fmt::Formatter<'_>, ok: &bool) -> fmt::Result {
    write!(f, " {}", if *ok { "ok" } else { "FAILED" })
}

pub(crate) fn decode_restart(payload: &[u8]) -> Option<u64> {
    decode(payload, 40)
}

pub(crate) fn encode_restart(magic: &u64) -> Vec<u8> {
    magic.to_le_bytes()[..5].to_vec()
}

/// protocol.RestartNode, response: `ok bool`.
pub(crate) fn decode_restarted(payload: &[u8]) -> Option<bool> {
    let [byte] = payload else { return None };
    Some(byte & OK != 0)
}

pub(crate) fn encode_restarted(ok: &bool) -> Vec<u8> {
    vec![if *ok { OK } else { 0 }]
}

payload! {
    /// protocol.file.BeginFirmwareUpdate, request: `source node u8 | path`; response: `error u8 |
    /// text`.
    #[derive(Clone, Debug, Default, PartialEq, Eq)]
    pub struct NumberAndText {
        pub number: u8,
        pub text: Vec<u8>,
    }
}

impl NumberAndText {
    /// The text.
    pub fn text(&self) -> String {
        text(&self.text)
    }

    /// Name of the error in a response.
    fn error(&self) -> String {
        match self.number {
            0 => String::from("OK"),
            1 => String::from("INVALID_MODE"),
            2 => String::from("IN_PROGRESS"),
            255 => String::from("UNKNOWN"),
            other => format!("error {other}"),
        }
    }
}

/// Writes the request of an update.
pub(crate) fn write_update(f: &mut fmt::Formatter<'_>, update: &NumberAndText) -> fmt::Result {
    write!(f, " of \"{}\" from node {}", update.text(), update.number)
}

/// Writes the response to the request of an update.
pub(crate) fn write_result(f: &mut fmt::Formatter<'_>, result: &NumberAndText) -> fmt::Result {
    write!(f, " {} \"{}\"", result.error(), result.text())
}

/// Counters of one interface: frames sent, frames received, errors.
pub type InterfaceStats = [u64; 3];

payload! {
    /// protocol.GetTransportStats, response.
    #[derive(Clone, Debug, Default, PartialEq, Eq)]
    pub struct TransportStats {
        pub transfers_tx: u64 as 48,
        pub transfers_rx: u64 as 48,
        pub transfer_errors: u64 as 48,
        pub interfaces: Vec<InterfaceStats> as 3,
    }
}

impl Field for InterfaceStats {
    const BITS: u32 = 48;

    fn take(from: &mut Reader<'_>, bits: u32) -> Option<InterfaceStats> {
        Some([from.take(bits)?, from.take(bits)?, from.take(bits)?])
    }

    fn put(&self, to: &mut Writer, bits: u32) {
        self.iter().for_each(|number| to.put(*number, bits));
    }
}

impl fmt::Display for TransportStats {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "transfers out {} in {} errors {}",
            self.transfers_tx, self.transfers_rx, self.transfer_errors
        )?;
        self.interfaces
            .iter()
            .try_for_each(|[tx, rx, errors]| write!(f, ", frames out {tx} in {rx} errors {errors}"))
    }
}
