//! The format of inputs of the target `node`. The lower three bits of a step's first byte are its
//! kind, the upper five a number; further bytes follow by kind. Every byte sequence is valid, so
//! that the fuzzer wastes no inputs.
//!
//! | kind | number | then |
//! | --- | --- | --- |
//! | 0 any frame | length, modulo 9 | 4 bytes of the identifier, data |
//! | 1 frame of a known type | length, modulo 9 | type, source, data |
//! | 2 transfer | transfer ID | type, source, length, payload |
//! | 3 damaged transfer | transfer ID | damage, frame, then as a transfer |
//! | 4 milliseconds | how many less one | |
//! | 5 twentieths of a second | how many less one | |
//! | 6 frames may leave | how many; 0 is all | |
//! | 7 input | [`Input`], modulo 6 | 2 bytes for those that have a value |

/// The types that a transfer can have: those that the node receives, and two that it does not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Type {
    ArrayCommand,
    ThesisCommand,
    ArmingStatus,
    LightsCommand,
    NodeStatus,
    Allocation,
    GetNodeInfo,
    GetSet,
    ExecuteOpcode,
    RestartNode,
    BeginFirmwareUpdate,
    GetTransportStats,
    RawCommand,
    /// A message for other nodes.
    Temperature,
    /// A service that the node does not have: file.Read.
    FileRead,
}

impl Type {
    /// In the order of their numbers in the input.
    pub const ALL: [Type; 15] = [
        Type::ArrayCommand,
        Type::ThesisCommand,
        Type::ArmingStatus,
        Type::LightsCommand,
        Type::NodeStatus,
        Type::Allocation,
        Type::GetNodeInfo,
        Type::GetSet,
        Type::ExecuteOpcode,
        Type::RestartNode,
        Type::BeginFirmwareUpdate,
        Type::GetTransportStats,
        Type::RawCommand,
        Type::Temperature,
        Type::FileRead,
    ];
}

/// Damage to a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Damage {
    /// The frame is lost.
    Lost,
    /// The frame is repeated.
    Twice,
    /// The frame comes first.
    First,
    /// The frame is the last; the rest is lost.
    Last,
    /// The frame lacks a byte.
    Short,
    /// The frame's toggle bit is inverted.
    Toggle,
    /// A bit of the frame's first byte is inverted.
    Bit,
    /// The frame's transfer ID is one higher.
    Number,
}

impl Damage {
    const ALL: [Damage; 8] = [
        Damage::Lost,
        Damage::Twice,
        Damage::First,
        Damage::Last,
        Damage::Short,
        Damage::Toggle,
        Damage::Bit,
        Damage::Number,
    ];
}

/// Events other than frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    Pressed,
    Released,
    /// A question mark is typed on the serial monitor.
    Question,
    Reset,
    /// The new reading of the sensor.
    Sensor(u16),
    /// A notice of the controller: the event, modulo the number of events, and its value.
    Controller(u8, u8),
}

/// A transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sent {
    pub what: Type,
    /// 0 to 127; 0 is anonymous.
    pub source: u8,
    /// 0 to 31.
    pub number: u8,
    pub payload: Vec<u8>,
}

/// A step of an input.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    Frame {
        id: [u8; 4],
        data: Vec<u8>,
    },
    Known {
        what: Type,
        source: u8,
        data: Vec<u8>,
    },
    Transfer {
        sent: Sent,
        damage: Option<(Damage, u8)>,
    },
    /// Milliseconds.
    Wait(u16),
    Leave(u8),
    Input(Input),
}

/// Milliseconds in a twentieth of a second.
const LONG_MS: u16 = 50;

/// The steps of an input. A step that is truncated at the end has the bytes that are left.
pub fn steps(mut input: &[u8]) -> Vec<Step> {
    let mut steps = Vec::new();
    while let Some(step) = next(&mut input) {
        steps.push(step);
    }
    steps
}

fn next(input: &mut &[u8]) -> Option<Step> {
    let first = byte(input)?;
    let number = first >> 3;
    Some(match first & 7 {
        0 => Step::Frame {
            id: [byte(input)?, byte(input)?, byte(input)?, byte(input)?],
            data: bytes(input, number % 9),
        },
        1 => Step::Known {
            what: what(input)?,
            source: byte(input)? & 0x7F,
            data: bytes(input, number % 9),
        },
        2 => Step::Transfer { sent: sent(input, number)?, damage: None },
        3 => {
            let damage = (Damage::ALL[usize::from(byte(input)? % 8)], byte(input)?);
            Step::Transfer { sent: sent(input, number)?, damage: Some(damage) }
        }
        4 => Step::Wait(u16::from(number) + 1),
        5 => Step::Wait((u16::from(number) + 1) * LONG_MS),
        6 => Step::Leave(number),
        _ => Step::Input(match number % 6 {
            0 => Input::Pressed,
            1 => Input::Released,
            2 => Input::Question,
            3 => Input::Reset,
            4 => Input::Sensor(u16::from_be_bytes([byte(input)?, byte(input)?]) & 0x3FF),
            _ => Input::Controller(byte(input)?, byte(input)?),
        }),
    })
}

fn byte(input: &mut &[u8]) -> Option<u8> {
    let (byte, rest) = input.split_first()?;
    *input = rest;
    Some(*byte)
}

fn bytes(input: &mut &[u8], len: u8) -> Vec<u8> {
    let (bytes, rest) = input.split_at(usize::from(len).min(input.len()));
    *input = rest;
    bytes.to_vec()
}

fn what(input: &mut &[u8]) -> Option<Type> {
    Some(Type::ALL[usize::from(byte(input)?) % Type::ALL.len()])
}

fn sent(input: &mut &[u8], number: u8) -> Option<Sent> {
    let (what, source, len) = (what(input)?, byte(input)? & 0x7F, byte(input)?);
    Some(Sent { what, source, number, payload: bytes(input, len) })
}
