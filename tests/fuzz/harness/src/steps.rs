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

/// Encodes steps, for inputs that a program makes.
pub fn bytes_of(steps: &[Step]) -> Vec<u8> {
    let mut input = Vec::new();
    for step in steps {
        match step {
            Step::Frame { id, data } => {
                input.push((data.len() as u8) << 3);
                input.extend(id);
                input.extend(data);
            }
            Step::Known { what, source, data } => {
                input.extend([(data.len() as u8) << 3 | 1, *what as u8, *source]);
                input.extend(data);
            }
            Step::Transfer { sent, damage } => {
                input.push(sent.number << 3 | if damage.is_some() { 3 } else { 2 });
                if let Some((damage, frame)) = damage {
                    input.extend([*damage as u8, *frame]);
                }
                input.extend([sent.what as u8, sent.source, sent.payload.len() as u8]);
                input.extend(&sent.payload);
            }
            Step::Wait(ms) => {
                for _ in 0..ms / LONG_MS / 32 {
                    input.push(31 << 3 | 5);
                }
                match ms / LONG_MS % 32 {
                    0 => {}
                    long => input.push((long as u8 - 1) << 3 | 5),
                }
                for _ in 0..ms % LONG_MS / 32 {
                    input.push(31 << 3 | 4);
                }
                match ms % LONG_MS % 32 {
                    0 => {}
                    short => input.push((short as u8 - 1) << 3 | 4),
                }
            }
            Step::Leave(frames) => input.push(frames << 3 | 6),
            Step::Input(what) => {
                let (number, value) = match *what {
                    Input::Pressed => (0, None),
                    Input::Released => (1, None),
                    Input::Question => (2, None),
                    Input::Reset => (3, None),
                    Input::Sensor(reading) => (4, Some(reading.to_be_bytes())),
                    Input::Controller(event, value) => (5, Some([event, value])),
                };
                input.push(number << 3 | 7);
                input.extend(value.into_iter().flatten());
            }
        }
    }
    input
}

#[cfg(test)]
mod tests {
    use super::*;

    fn transfer(damage: Option<(Damage, u8)>) -> Step {
        let sent = Sent { what: Type::GetSet, source: 127, number: 31, payload: vec![1, 2, 3] };
        Step::Transfer { sent, damage }
    }

    #[test]
    fn steps_survive_a_round_trip() {
        let all = [
            Step::Frame { id: [0x9F, 0, 0, 1], data: vec![1; 8] },
            Step::Known { what: Type::FileRead, source: 1, data: vec![] },
            transfer(None),
            transfer(Some((Damage::Number, 2))),
            Step::Wait(32),
            Step::Wait(1600),
            Step::Leave(0),
            Step::Input(Input::Pressed),
            Step::Input(Input::Released),
            Step::Input(Input::Question),
            Step::Input(Input::Reset),
            Step::Input(Input::Sensor(1023)),
            Step::Input(Input::Controller(2, 3)),
        ];
        assert_eq!(steps(&bytes_of(&all)), all);
    }

    #[test]
    fn a_long_wait_takes_several_steps_with_the_same_sum() {
        for ms in [1, 31, 33, 49, 50, 99, 1650, 20_000] {
            let waits = steps(&bytes_of(&[Step::Wait(ms)]));
            let sum: u16 =
                waits.iter().map(|wait| if let Step::Wait(ms) = wait { *ms } else { 0 }).sum();
            assert_eq!(sum, ms);
        }
    }

    #[test]
    fn types_have_the_numbers_of_their_order() {
        assert!(Type::ALL.iter().enumerate().all(|(number, what)| *what as usize == number));
        assert!(Damage::ALL.iter().enumerate().all(|(number, damage)| *damage as usize == number));
    }
}
