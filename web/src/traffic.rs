//! What the page shows of a frame, on the simulated bus as on the real one.

use std::time::Duration;

use bench::can::{Frame, Id, Record};
use bench::dronecan::text::visible;
use bench::dronecan::{CanId, DataType, Decoded, Dialect, Message, Observation, Observer};
use bench::{Cycles, F_CPU_HZ};
use serde_json::{Value as Json, json};

use crate::bits::{Ack, Bits};
use crate::meaning::meaning;

/// Longest text of a frame, in characters: that of a transfer of 70 bytes that is not decoded.
const TEXT_MAX: usize = 240;
/// What a status without a vendor-specific code says of it.
const NO_CODE: &str = " vendor 0x0000";
/// Levels of LogMessage.
const LEVELS: [&str; 4] = ["DEBUG", "INFO", "WARNING", "ERROR"];

/// A frame in words.
pub struct Described {
    pub text: String,
    /// `transfer`, `part` of one, or `foreign`.
    pub kind: &'static str,
    /// Name of the data type.
    pub name: Option<String>,
    /// The transfer that the frame completes.
    pub decoded: Option<Decoded>,
}

impl Described {
    /// The frame as a JSON object for the page.
    pub fn event(&self, number: u64, from: &str, record: &Record) -> Json {
        let mut event = json!({
            "kind": "frame", "number": number, "frame": self.kind, "from": from,
            "text": self.text, "name": self.name,
            "start": seconds(record.start), "end": seconds(record.end),
        });
        if let Some(Decoded::V0(transfer, Message::LogMessage(message))) = &self.decoded {
            let text = |bytes: &[u8]| shown(&String::from_utf8_lossy(bytes), TEXT_MAX);
            event["log"] = json!({
                "node": transfer.id.source().map(|node| node.get()),
                "level": LEVELS.get(usize::from(message.level)).unwrap_or(&"ERROR"),
                "source": text(&message.source),
                "text": text(&message.text),
            });
        }
        event
    }
}

/// A time for the page.
pub fn seconds(cycles: Cycles) -> f64 {
    cycles as f64 / F_CPU_HZ as f64
}

/// Describes the next frame of a bus, which ended at `at`.
pub fn describe(observer: &mut Observer, frame: &Frame, at: Duration) -> Described {
    let foreign = |why: &str| Described {
        text: format!("{frame} (not DroneCAN: {why})"),
        kind: "foreign",
        name: None,
        decoded: None,
    };
    let id = match frame.id {
        Id::Standard(_) => return foreign("11-bit identifier"),
        Id::Extended(_) if frame.remote => return foreign("remote frame"),
        Id::Extended(id) => id,
    };
    match observer.push(id, frame.data(), at) {
        Observation::Complete(decoded) => Described {
            text: shown(
                &format!("{}: {}", decoded.endpoints(), words(&decoded)).replace(NO_CODE, ""),
                TEXT_MAX,
            ),
            kind: "transfer",
            name: Some(decoded.name()),
            decoded: Some(decoded),
        },
        Observation::Partial => {
            let name = CanId::parse(id)
                .and_then(DataType::of)
                .map_or_else(|| String::from("?"), |known| known.name.to_owned());
            Described { text: format!("{name}, a part"), kind: "part", name: None, decoded: None }
        }
        Observation::Invalid(why) => foreign(why),
    }
}

/// A transfer in the words of the page: requests and answers about parameters as what they do.
fn words(decoded: &Decoded) -> String {
    match decoded {
        Decoded::V0(_, Message::ParameterRequest(request)) => {
            let verb = if request.value.is_empty() { "asks for" } else { "sets" };
            let what = request.to_string();
            // Without a name it is "index 113". A name of another node's may begin like that, too.
            let number = what.strip_prefix("index ").filter(|_| request.name.is_empty());
            format!("{verb} parameter {}", number.unwrap_or(&what))
        }
        Decoded::V0(_, Message::ParameterResponse(response)) => {
            let is_none = response.name.is_empty() && response.value.is_empty();
            if is_none { response.to_string() } else { format!("parameter {response}") }
        }
        _ => decoded.to_string(),
    }
}

/// A text of unknown origin as the page shows it: its control characters visible, and cut.
pub fn shown(text: &str, max: usize) -> String {
    let text = visible(text);
    match text.char_indices().nth(max) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.into_owned(),
    }
}

/// The bits of a frame, its fields, and what they mean, a JSON object.
pub fn wire(frame: &Frame, acknowledgement: Ack, dialect: Dialect) -> Json {
    let Bits { fields, bits } = Bits::of(frame, acknowledgement);
    let meaning = match dialect {
        Dialect::V0 => meaning(frame),
        Dialect::Draft => Vec::new(),
    };
    json!({
        "frame": frame.to_string(),
        "meaning": meaning,
        "fields": fields,
        "bits": bits.iter().map(|bit| {
            json!([bit.level.map(u8::from), u8::from(bit.is_stuff), bit.field])
        }).collect::<Json>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_for_parameters_are_told_by_what_they_do() {
        let mut observer = Observer::new();
        // GetSet, service 11, of node 127 to node 120: a read of index 113, and the answer that
        // there is none.
        let of = |observer: &mut Observer, id, data: &[u8]| {
            describe(observer, &Frame::extended(id, data), Duration::ZERO).text
        };
        let request = of(&mut observer, 0x1E0B_F8FF, &[113, 0, 0xC0]);
        assert_eq!(request, "127>120: asks for parameter 113");
        let named = of(&mut observer, 0x1E0B_F8FF, b"\0\0index\xC1");
        assert_eq!(named, "127>120: asks for parameter index");
        let answer = of(&mut observer, 0x1E0B_7FF8, &[0, 0, 0, 0, 0xC0]);
        assert_eq!(answer, "120>127: no such parameter");
    }

    #[test]
    fn a_text_of_unknown_origin_is_cut_and_has_no_control_characters() {
        assert_eq!(shown("\u{1b}[2Jnode", 80), "\\x1b[2Jnode");
        assert_eq!(shown("ßßßß", 3), "ßßß…");
        assert_eq!(shown("ßßß", 3), "ßßß");
    }
}
