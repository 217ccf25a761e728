//! The bits of a frame as an oscilloscope shows them, with the field of each and the stuff bits.
//!
//! Source: Bosch CAN 2.0B, "Frame formats", "Bit stream coding".

use bench::can::{Frame, Id, Level, OnWire};

/// Number of equal bits after which a stuff bit follows.
const STUFF_AFTER: u32 = 5;
const CRC_BITS: usize = 15;
/// The bits after the CRC sequence, which are not stuffed.
const TAIL: [(&str, usize); 4] =
    [("CRC delimiter", 1), ("ACK", 1), ("ACK delimiter", 1), ("EOF", 7)];

/// What the receivers made of the ACK slot of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ack {
    Given,
    Missing,
    /// Nobody has told it: an SLCAN adapter does not.
    Unknown,
}

impl Ack {
    /// That of a frame whose ACK slot was seen.
    pub fn seen(is_given: bool) -> Ack {
        if is_given { Ack::Given } else { Ack::Missing }
    }

    fn text(self) -> &'static str {
        match self {
            Ack::Given => "yes",
            Ack::Missing => "none",
            Ack::Unknown => "not known",
        }
    }
}

/// One bit on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bit {
    /// True if recessive; `None` if it is not known.
    pub level: Option<bool>,
    /// True if the sender inserted it so that receivers stay in step.
    pub is_stuff: bool,
    /// Index in [`Bits::fields`].
    pub field: usize,
}

/// The bits of a frame, from SOF to the end of frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bits {
    /// Name and value of each field.
    pub fields: Vec<(&'static str, String)>,
    pub bits: Vec<Bit>,
}

/// The fields of a frame between SOF and the CRC delimiter, and their lengths in bits.
fn fields(frame: &Frame) -> Vec<(&'static str, usize)> {
    let mut fields = match frame.id {
        Id::Standard(_) => {
            vec![("SOF", 1), ("ID", 11), ("RTR", 1), ("IDE", 1), ("r0", 1), ("DLC", 4)]
        }
        Id::Extended(_) => vec![
            ("SOF", 1),
            ("ID 28..18", 11),
            ("SRR", 1),
            ("IDE", 1),
            ("ID 17..0", 18),
            ("RTR", 1),
            ("r1, r0", 2),
            ("DLC", 4),
        ],
    };
    if !frame.remote {
        fields.extend(frame.data().iter().map(|_| ("data", 8)));
    }
    fields.push(("CRC", CRC_BITS));
    fields
}

impl Bits {
    /// The bits that the sender of a frame drives, with the level of the ACK slot.
    pub fn of(frame: &Frame, acknowledgement: Ack) -> Bits {
        let levels = frame.wire_bits();
        let mut bits = Vec::with_capacity(levels.len());
        let mut named = Vec::new();
        let mut wire = levels.iter().map(|level| *level == Level::Recessive);
        let (mut run, mut last) = (0, true);
        let mut take = |field: usize, bits: &mut Vec<Bit>, stuffed: bool| {
            let mut next = |is_stuff: bool| {
                let level = wire.next().unwrap_or(true);
                run = if level == last { run + 1 } else { 1 };
                last = level;
                bits.push(Bit { level: Some(level), is_stuff, field });
                (level, run)
            };
            let (level, equal) = next(false);
            if stuffed && equal == STUFF_AFTER {
                next(true);
            }
            level
        };
        for (name, length) in fields(frame) {
            let field = named.len();
            let value = (0..length)
                .fold(0_u32, |value, _| value << 1 | u32::from(take(field, &mut bits, true)));
            let digits = 2 + length.div_ceil(4);
            let text = if length > 4 { format!("{value:#0digits$x}") } else { value.to_string() };
            named.push((name, text));
        }
        for (name, length) in TAIL {
            let field = named.len();
            (0..length).for_each(|_| {
                take(field, &mut bits, false);
            });
            named.push((name, String::new()));
        }
        let ack = named.iter().position(|(name, _)| *name == "ACK");
        if let Some(bit) = bits.iter_mut().find(|bit| Some(bit.field) == ack) {
            bit.level = match acknowledgement {
                Ack::Given => Some(false),
                Ack::Missing => Some(true),
                Ack::Unknown => None,
            };
        }
        if let Some(ack) = ack {
            named[ack].1 = acknowledgement.text().into();
        }
        Bits { fields: named, bits }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A NodeStatus: many zeros, so many stuff bits.
    fn status() -> Frame {
        Frame::extended(0x1801_550A, &[0, 0, 0, 0, 0, 0, 0, 0xC0])
    }

    #[test]
    fn the_bits_are_those_on_the_wire_and_the_fields_have_their_lengths_without_stuff_bits() {
        for frame in [status(), Frame::standard(0x123, &[]), Frame::extended(7, &[0xFF; 8])] {
            let bits = Bits::of(&frame, Ack::Missing);
            let wire: Vec<Option<bool>> =
                frame.wire_bits().iter().map(|level| Some(*level == Level::Recessive)).collect();
            assert_eq!(bits.bits.iter().map(|bit| bit.level).collect::<Vec<_>>(), wire);
            for (index, (name, length)) in fields(&frame).into_iter().chain(TAIL).enumerate() {
                let own = bits.bits.iter().filter(|bit| bit.field == index && !bit.is_stuff);
                assert_eq!(own.count(), length, "{name}");
            }
        }
    }

    #[test]
    fn a_stuff_bit_differs_from_the_five_bits_before_it() {
        let bits = Bits::of(&status(), Ack::Given).bits;
        let mut stuffed = 0;
        for (at, _) in bits.iter().enumerate().filter(|(_, bit)| bit.is_stuff) {
            assert!((1..=5).all(|back| bits[at - back].level != bits[at].level), "bit {at}");
            stuffed += 1;
        }
        assert!(stuffed > 5, "{stuffed}");
    }

    #[test]
    fn the_values_are_those_of_the_frame() {
        let fields = Bits::of(&Frame::extended(0x1801_550A, &[0x5A]), Ack::Given).fields;
        let value = |name: &str| {
            let found = fields.iter().find(|(known, _)| *known == name);
            found.map(|(_, value)| value.as_str())
        };
        assert_eq!(value("ID 28..18"), Some(format!("{:#x}", 0x1801_550A >> 18).as_str()));
        assert_eq!(value("ID 17..0"), Some(format!("{:#x}", 0x1801_550A & 0x3_FFFF).as_str()));
        assert_eq!(value("DLC"), Some("1"));
        assert_eq!(value("data"), Some("0x5a"));
        assert_eq!(value("ACK"), Some("yes"));
    }

    #[test]
    fn only_the_level_of_an_acknowledgement_that_nobody_has_told_is_not_known() {
        let (given, unknown) = (Bits::of(&status(), Ack::Given), Bits::of(&status(), Ack::Unknown));
        let differ: Vec<_> =
            given.bits.iter().zip(&unknown.bits).filter(|(one, other)| one != other).collect();
        let [(one, other)] = differ[..] else { panic!("{differ:?}") };
        assert_eq!((one.level, other.level), (Some(false), None));
        assert_eq!(unknown.fields[other.field], ("ACK", String::from("not known")));
    }
}
