//! A periodic message of a plan, and its text form.
//!
//! ```text
//! [NODESx] TYPE [ [COUNT] | :BYTES | =HEX ] @RATE
//!
//! for example: 4x esc.Status@50   ArrayCommand[8]@50   20100:12@5
//! ```
//! A service has two streams, its request and its response. COUNT, BYTES and HEX then apply to the
//! response.

use bench::dronecan::types::{DataType, KNOWN, Kind, Layout};
use bench::dronecan::{CanId, NodeId};
use std::str::FromStr;

/// Maximum number of nodes.
const NODES_MAX: u16 = 127;
/// Longer than the longest payload of the DSDL.
const PAYLOAD_MAX: usize = 512;
/// More than any bus can carry: larger numbers are typing errors.
const RATE_MAX_HZ: f64 = 1e6;
/// A middle priority. It changes the positions of stuff bits, but hardly their mean number.
const PRIORITY: u8 = 16;

/// The kind of transfer, for the identifier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    Message(u16),
    Request(u8),
    Response(u8),
}

/// A transfer that some nodes send at a constant rate.
#[derive(Clone, Debug, PartialEq)]
pub struct Stream {
    pub label: String,
    /// Number of sending nodes, 1 to 127.
    pub nodes: u8,
    /// Transfers per second of each node.
    pub rate_hz: f64,
    pub channel: Channel,
    /// Signature of the data type, for the transfer CRC; 0 if it is unknown.
    pub seed: u16,
    pub payload_bytes: usize,
    /// The payload, if it was given.
    pub payload: Option<Vec<u8>>,
}

impl Stream {
    /// The identifier when node `source` sends it.
    pub fn id(&self, source: NodeId) -> CanId {
        let peer = |id| NodeId::new(id).expect("a node ID");
        let destination = if source == peer(127) { peer(126) } else { peer(127) };
        let service = |service_id, request| CanId::Service {
            priority: PRIORITY,
            service_id,
            request,
            destination,
            source,
        };
        match self.channel {
            Channel::Message(type_id) => CanId::Message { priority: PRIORITY, type_id, source },
            Channel::Request(service_id) => service(service_id, true),
            Channel::Response(service_id) => service(service_id, false),
        }
    }
}

/// The streams of a `--message`: one, or the two of a service.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry(pub Vec<Stream>);

impl FromStr for Entry {
    type Err = String;

    fn from_str(text: &str) -> Result<Entry, String> {
        let (what, rate) = text
            .rsplit_once('@')
            .ok_or("give a rate, as in \"NodeStatus@1\": transfers per second")?;
        let rate_hz = match rate.trim().parse() {
            Ok(rate_hz) if 0.0 < rate_hz && rate_hz <= RATE_MAX_HZ => rate_hz,
            _ => {
                return Err(format!(
                    "\"{rate}\" is not a rate: use transfers per second, such as 50 or 0.5"
                ));
            }
        };
        let (nodes, what) = nodes(what.trim())?;
        let (name, length) = Length::split(what)?;
        Subject::find(name)?.streams(&length, nodes, rate_hz).map(Entry)
    }
}

/// "4x esc.Status" means four nodes. Without a number it is one.
fn nodes(text: &str) -> Result<(u8, &str), String> {
    let Some((count, rest)) = text.split_once(['x', 'X']).filter(|(count, _)| is_number(count))
    else {
        return Ok((1, text));
    };
    match count.parse() {
        Ok(count @ 1..=NODES_MAX) => Ok((count as u8, rest.trim_start())),
        _ => Err(format!("a bus has 1 to {NODES_MAX} nodes, not {count}")),
    }
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// The requested length of the payload.
#[derive(Clone, Debug, PartialEq)]
enum Length {
    /// The longest of the type.
    Longest,
    Elements(u16),
    Bytes(usize),
    Payload(Vec<u8>),
}

impl Length {
    fn split(text: &str) -> Result<(&str, Length), String> {
        if let Some((name, count)) = text.split_once('[') {
            let count = count.strip_suffix(']').and_then(|count| count.parse().ok());
            let count =
                count.ok_or_else(|| format!("\"{text}\": use for example ArrayCommand[8]"))?;
            return Ok((name, Length::Elements(count)));
        }
        if let Some((name, bytes)) = text.split_once(':') {
            return match bytes.parse() {
                Ok(bytes @ 0..=PAYLOAD_MAX) => Ok((name, Length::Bytes(bytes))),
                _ => Err(format!("\"{bytes}\" is not a length: use 0 to {PAYLOAD_MAX} bytes")),
            };
        }
        if let Some((name, digits)) = text.split_once('=') {
            let payload = hex(digits)
                .ok_or_else(|| format!("\"{digits}\" is not a payload: use pairs of hex digits"))?;
            return Ok((name, Length::Payload(payload)));
        }
        Ok((text, Length::Longest))
    }

    /// Length of the payload, and the payload if it was given.
    fn resolve(
        &self,
        name: &str,
        layout: Option<Layout>,
    ) -> Result<(usize, Option<Vec<u8>>), String> {
        match (self, layout) {
            (Length::Bytes(bytes), layout) => Ok((possible(name, layout, *bytes)?, None)),
            (Length::Payload(payload), layout) => {
                Ok((possible(name, layout, payload.len())?, Some(payload.clone())))
            }
            (_, None) => {
                Err(format!("type {name} is not known here: give its length, as in {name}:12@5"))
            }
            (Length::Longest, Some(layout)) => Ok((layout.bytes(layout.elements_max), None)),
            (Length::Elements(_), Some(Layout { elements_max: 0, .. })) => {
                Err(format!("{name} has no list at its end: leave out the [..]"))
            }
            (Length::Elements(count), Some(layout)) if *count <= layout.elements_max => {
                Ok((layout.bytes(*count), None))
            }
            (Length::Elements(count), Some(layout)) => {
                Err(format!("{name} holds at most {} elements, not {count}", layout.elements_max))
            }
        }
    }
}

/// The length, if the type can have it.
fn possible(name: &str, layout: Option<Layout>, bytes: usize) -> Result<usize, String> {
    let Some(layout) = layout else { return Ok(bytes) };
    match (layout.bytes(0), layout.bytes(layout.elements_max)) {
        (least, most) if (least..=most).contains(&bytes) => Ok(bytes),
        (least, most) if least == most => Err(format!("{name} has {most} bytes, not {bytes}")),
        (least, most) => Err(format!("{name} has {least} to {most} bytes, not {bytes}")),
    }
}

fn hex(digits: &str) -> Option<Vec<u8>> {
    let good = digits.len().is_multiple_of(2)
        && digits.len() <= 2 * PAYLOAD_MAX
        && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    let pair = |at: usize| u8::from_str_radix(&digits[at..at + 2], 16).ok();
    if good { (0..digits.len()).step_by(2).map(pair).collect() } else { None }
}

/// A known type, or the ID of a message that is not known.
enum Subject {
    Known(&'static DataType),
    Unknown(u16),
}

impl Subject {
    fn find(name: &str) -> Result<Subject, String> {
        if is_number(name) {
            let id: u16 = name
                .parse()
                .map_err(|_| format!("{name} is not a message type: the highest is 65535"))?;
            let known = KNOWN.iter().find(|known| known.kind == Kind::Message && known.id == id);
            return Ok(known.map_or(Subject::Unknown(id), Subject::Known));
        }
        match DataType::by_name(name).as_slice() {
            [known] => Ok(Subject::Known(known)),
            [] => Err(format!(
                "\"{name}\" is not known here: --list shows the names; or use its number, as in \
                 20100:12@5"
            )),
            several => {
                let names: Vec<_> = several.iter().map(|known| known.name).collect();
                Err(format!("\"{name}\" may be {}: say which", names.join(" or ")))
            }
        }
    }

    fn streams(&self, length: &Length, nodes: u8, rate_hz: f64) -> Result<Vec<Stream>, String> {
        let known = match *self {
            Subject::Known(known) => known,
            Subject::Unknown(id) => {
                let name = id.to_string();
                let (payload_bytes, payload) = length.resolve(&name, None)?;
                let (label, channel) = (format!("message {name}"), Channel::Message(id));
                return Ok(vec![Stream {
                    label,
                    nodes,
                    rate_hz,
                    channel,
                    seed: 0,
                    payload_bytes,
                    payload,
                }]);
            }
        };
        let stream = |suffix: &str, channel, length: &Length, layout| -> Result<Stream, String> {
            let (payload_bytes, payload) = length.resolve(known.name, Some(layout))?;
            let list = match length {
                Length::Elements(count) => format!("[{count}]"),
                Length::Longest if layout.elements_max > 0 => format!("[{}]", layout.elements_max),
                _ => String::new(),
            };
            let label = format!("{}{suffix}{list}", known.name);
            let seed = known.seed.unwrap_or(0);
            Ok(Stream { label, nodes, rate_hz, channel, seed, payload_bytes, payload })
        };
        match known.response {
            None => Ok(vec![stream("", Channel::Message(known.id), length, known.payload)?]),
            Some(response) => {
                let service_id = known.id as u8;
                Ok(vec![
                    stream(
                        " request",
                        Channel::Request(service_id),
                        &Length::Longest,
                        known.payload,
                    )?,
                    stream(" response", Channel::Response(service_id), length, response)?,
                ])
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn streams(text: &str) -> Vec<Stream> {
        text.parse::<Entry>().unwrap().0
    }

    #[track_caller]
    fn stream(text: &str) -> Stream {
        let mut all = streams(text);
        assert_eq!(all.len(), 1, "{text}");
        all.remove(0)
    }

    #[test]
    fn nodes_name_list_and_rate_are_parsed() {
        let status = stream("4x esc.Status@50");
        assert_eq!((status.nodes, status.rate_hz, status.payload_bytes), (4, 50.0, 14));
        assert_eq!(status.channel, Channel::Message(1034));
        let command = stream("ArrayCommand[8]@50");
        assert_eq!(
            (command.nodes, command.payload_bytes, command.label.as_str()),
            (1, 32, "ArrayCommand[8]")
        );
        assert_eq!(stream("ArrayCommand@0.5").payload_bytes, 60);
        assert_eq!(stream("ArrayCommand[0]@1").payload_bytes, 0);
    }

    #[test]
    fn a_type_may_be_named_in_full_by_its_end_or_by_number() {
        for text in
            ["uavcan.equipment.esc.RawCommand[6]@1", "RAWCOMMAND[6]@1", "1030[6]@1", "1x1030[6]@1"]
        {
            let command = stream(text);
            assert_eq!(
                (command.channel, command.payload_bytes),
                (Channel::Message(1030), 11),
                "{text}"
            );
        }
    }

    #[test]
    fn lengths_and_payloads_may_be_given() {
        assert_eq!(stream("20100:12@5").payload_bytes, 12);
        assert_eq!(stream("debug.LogMessage:30@1").payload_bytes, 30);
        assert_eq!(stream("NodeStatus=01000000000000@1").payload, Some(vec![1, 0, 0, 0, 0, 0, 0]));
    }

    #[test]
    fn a_service_is_two_streams() {
        let info = streams("3x GetNodeInfo[24]@0.1");
        let view: Vec<_> =
            info.iter().map(|s| (s.label.as_str(), s.channel, s.payload_bytes, s.nodes)).collect();
        let request = ("GetNodeInfo request", Channel::Request(1), 0, 3);
        let response = ("GetNodeInfo response[24]", Channel::Response(1), 41 + 24, 3);
        assert_eq!(view, [request, response]);
    }

    #[test]
    fn mistakes_are_answered_with_a_remedy() {
        for (text, advice) in [
            ("NodeStatus", "give a rate"),
            ("NodeStatus@often", "transfers per second"),
            ("NodeStatus@-1", "transfers per second"),
            ("NodeStatus@NaN", "transfers per second"),
            ("0x NodeStatus@1", "1 to 127"),
            ("128x NodeStatus@1", "1 to 127"),
            ("Nonsense@1", "--list"),
            ("Status@1", "esc.Status"),
            ("com.hobbywing.esc.RawCommand@1", "not known"),
            ("20100@1", "20100:12@5"),
            ("70000:1@1", "65535"),
            ("ArrayCommand[16]@1", "at most 15"),
            ("ArrayCommand[8@1", "ArrayCommand[8]"),
            ("NodeStatus[1]@1", "no list"),
            ("NodeStatus=123@1", "pairs"),
            ("NodeStatus:513@1", "0 to 512"),
            ("NodeStatus:8@1", "7 bytes, not 8"),
            ("ArrayCommand:61@1", "not 61"),
            ("NodeStatus=2A00000000000000@1", "7 bytes, not 8"),
            ("debug.LogMessage:0@1", "not 0"),
            ("GetNodeInfo:500@1", "not 500"),
            ("NodeStatus@0", "transfers per second"),
            ("", "give a rate"),
            ("@", "transfers per second"),
        ] {
            let error = text.parse::<Entry>().unwrap_err();
            assert!(error.contains(advice), "{text}: {error}");
        }
    }
}
